"""Any policy may move the arm: the judge's word on what was executed, and the guard's reasons."""

from collections.abc import Callable
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Box, PointCloudShape, Sphere
from optipromp.core.judging import RATES, extremes, judge
from optipromp.core.planning import plan
from optipromp.core.planning.task import posed, tool_motion
from optipromp.core.pushing import Hanging
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import JointGoal
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Role, Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control.plant import first_tracks
from optipromp_loop.control.tracker import Tracker
from optipromp_loop.guard import Guard, GuardParameters, Safe, joints_for
from optipromp_loop.guard.motion import Change, fastest, later, nearest, stopping
from optipromp_loop.guard.plant import seen_scene, stays, unchanged
from optipromp_sim.generate import generate

PERIOD = GuardParameters.period
HOME = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]
FREE = Scene(name="free", robot="panda", objects=(), goal=JointGoal(np.array(HOME)))
Policy = Callable[[int, State], FloatArray]


def driven(
    guard: Guard, start: State, policy: Policy, steps: int, *, seen: Scene | None = None,
    silent: range = range(0),
) -> tuple[Trajectory, list[Safe]]:  # fmt: skip
    """What an arm executes that follows the guard exactly, and stops at the end.

    ``seen``: shown by looks; None: there are none, and no time. ``silent``: steps without a state.
    """
    states, told, state = [start], [], start
    for k in range(steps):
        time, looks = None if seen is None else PERIOD * k, list[Look]()
        if seen is not None and k % 4 == 0:
            looks = [shown(PERIOD * k, *(o for o in seen.objects if o.role != "static"))]
        asked = None if k in silent else policy(k, state)
        safe = guard.blind("silent") if asked is None else guard(asked, state, looks, time)
        assert safe is not None
        told.append(safe)
        state = safe.reference
        states.append(state)
    last = told[-1].curve
    rest = [last.at(time) for time in last.times[2:]]
    times = np.append(PERIOD * np.arange(steps + 1), PERIOD * (steps - 1) + last.times[2:])
    rows = [np.array([getattr(s, name) for s in [*states, *rest]])
            for name in ("q", "velocity", "acceleration")]  # fmt: skip
    return Trajectory(times, *rows, guard.robot.joint_names), told


def assert_within(scene: Scene, robot: Robot, motion: Trajectory, start: State) -> None:
    """The judge finds no limit exceeded, and nothing touched that stands or is avoided."""
    most = extremes(motion)
    assert (most.lowest >= robot.lower - 1e-6).all()
    assert (most.highest <= robot.upper + 1e-6).all()
    limits = np.array([getattr(robot, name) for name in RATES])
    assert (most.largest <= limits * (1.0 + 1e-6)).all()
    judged = judge(scene, robot, motion, start)
    assert not [v for v in judged.violations if v.kind in ("contact", "unchecked")]
    assert motion.velocities[-1] == pytest.approx(0.0)


def wild_policy(seed: int, robot: Robot, strength: float) -> Policy:
    """Random velocities, up to twice the limits, that last between 1 and 40 periods."""
    rng = np.random.default_rng(seed)
    wish, until = np.zeros(robot.n_joints), 0

    def act(k: int, state: State) -> FloatArray:
        nonlocal wish, until
        if k >= until:
            speed = np.minimum(robot.velocity, 3.0) * strength
            wish, until = rng.uniform(-1.0, 1.0, robot.n_joints) * speed, k + rng.integers(1, 40)
        return wish

    return act


def walled(seed: int) -> Scene:
    """The arm among boxes that stand and boxes to avoid, none of which it touches at first."""
    rng = np.random.default_rng(seed)
    robot, start = posed(FREE)
    spheres, radius = robot.sphere_centers(start.q), robot.spheres.radius
    items: list[SceneObject] = []
    while len(items) < 8:
        place, size = rng.uniform((-0.6, -0.7, 0.0), (0.8, 0.7, 1.1)), rng.uniform(0.05, 0.3, 3)
        if (np.linalg.norm(spheres - place, axis=1) > radius + np.linalg.norm(size)).all():
            role = "static" if len(items) % 2 else "avoid"
            items.append(SceneObject(f"box{len(items)}", role, Box(tuple(size)), place))
    return replace(FREE, objects=tuple(items))


@given(
    seed=st.integers(0, 10_000), strength=st.sampled_from([0.1, 0.5, 1.0, 2.0]),
    jerk=st.sampled_from([0.003, 0.03, 1.0, 1.0, np.inf]),
)  # fmt: skip
@example(seed=111, strength=2.0, jerk=1.0)  # along what is to be avoided
@settings(max_examples=18, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_no_policy_breaks_a_limit_or_touches_what_stands(seed, strength, jerk):
    """Of arms of little and of any jerk, too."""
    scene = walled(seed)
    robot, start = posed(scene)
    robot = replace(robot, jerk=robot.jerk * jerk)
    motion, _ = driven(Guard(scene, robot), start, wild_policy(seed, robot, strength), 150)
    assert_within(scene, robot, motion, start)
    assert np.ptp(motion.positions, axis=0).max() > 0.01 * min(jerk, 1.0)  # it moves


def test_a_wish_that_harms_nothing_is_executed_to_the_bit() -> None:
    _, start = posed(FREE)
    wish = np.array([0.05, -0.02, 0.0, 0.03, 0.0, 0.1, -0.1])
    _, told = driven(Guard(FREE), start, lambda k, state: wish, 10)
    assert not any(safe.acted for safe in told)
    assert (told[-1].velocity == wish).all()


def before_a_wall(room: float, role: Role = "static") -> tuple[Scene, Robot, State]:
    """A wall before the arm, so far from its foremost sphere [m]."""
    robot, start = posed(FREE)
    wall = SceneObject(
        "wall", role, Box((0.02, 4.0, 4.0)), [foremost(robot, start.q) + room + 0.01, 0, 0]
    )
    return replace(FREE, objects=(wall,)), robot, start


def foremost(robot: Robot, q: FloatArray) -> float:
    return float((robot.sphere_centers(q)[:, 0] + robot.spheres.radius).max())


@pytest.mark.parametrize("role", ["static", "avoid"])
def test_the_arm_slides_along_a_wall_that_a_policy_pushes_it_into(role: Role) -> None:
    scene, robot, start = before_a_wall(0.04, role)
    face = foremost(robot, start.q) + 0.04
    point, _ = robot.tool_pose(start.q)

    def into(k: int, state: State) -> FloatArray:
        return joints_for(robot, state.q, np.array([0.2, 0.1, 0.0]))

    motion, told = driven(Guard(scene), start, into, 100)
    assert_within(scene, robot, motion, start)
    end, _ = robot.tool_pose(motion.positions[-1])
    assert end[1] - point[1] > 0.1  # it slid
    assert foremost(robot, motion.positions[-1]) < face
    words = "what stands" if role == "static" else "what is to be avoided"
    assert any("wall" in safe.reason or words in safe.reason for safe in told)


def test_what_a_look_shows_and_nothing_explains_stops_the_arm() -> None:
    """A board before the arm, of which a look shows points, as it does of the arm itself."""
    _, robot, start = before_a_wall(0.04)
    board = np.mgrid[0:1, -60:61, 0:100].reshape(3, -1).T * 0.01
    board += [foremost(robot, start.q) + 0.08, 0.0, 0.0]
    points = np.concatenate([board, robot.sphere_centers(start.q)])
    thing = SceneObject("unknown1", "static", PointCloudShape(points, 0.005), [0] * 3)
    guard = Guard(FREE)
    guard(np.zeros(7), start, [shown(0.0, thing)])
    into = np.array([0.2, 0.0, 0.0])
    motion, told = driven(guard, start, lambda k, state: joints_for(robot, state.q, into), 100)
    assert 0.0 < board[0, 0] - 0.005 - foremost(robot, motion.positions[-1]) < 0.03
    assert any("seen1" in safe.reason or "what stands" in safe.reason for safe in told)
    guard(np.zeros(7), motion.at(motion.times[-1]), [shown(1.0)])  # where nothing stands any more
    assert not guard.scene.objects


def test_an_arm_that_touches_something_at_first_may_leave_it() -> None:
    scene, robot, start = before_a_wall(-0.01)
    guard = Guard(scene)
    safe = guard(joints_for(robot, start.q, np.array([0.1, 0.0, 0.0])), start)
    assert safe.acted  # not deeper
    motion, _ = driven(
        guard, safe.reference, lambda k, s: joints_for(robot, s.q, np.array([-0.2, 0.0, 0.0])), 50
    )
    assert foremost(robot, motion.positions[-1]) < foremost(robot, start.q) - 0.02


def test_looks_do_not_let_the_arm_come_ever_nearer(cluster: Scene) -> None:
    """Each look moves a fruit, so the scene is another one each time."""
    scene, robot, start = before_a_wall(0.0025)
    guard = Guard(scene)
    state, (fruit,), places = start, cluster.pushables, set[tuple[float, ...]]()
    for k in range(400):
        by = np.array([0.0, 0.01 * (k // 20 % 2), 0.0])
        looks = [shown(PERIOD * k, fruit.shifted(by))] if k % 2 == 0 else ()
        state = guard(joints_for(robot, state.q, np.array([5e-4, 0, 0])), state, looks).reference
        places |= {tuple(o.position) for o in guard.scene.objects}
    away = foremost(robot, start.q) + 0.0025 - foremost(robot, state.q)
    assert len(places) > 20
    assert 0.00199 < away < 0.0021


def test_a_policy_that_gives_no_number_stops_the_arm() -> None:
    _, start = posed(FREE)
    motion, told = driven(
        Guard(FREE), start, lambda k, s: np.full(7, 0.3 if k < 20 else np.nan), 60
    )
    assert told[-1].reason == "the action is not finite"
    assert (motion.velocities[-5:] == 0.0).all()


def test_what_a_caller_gives_wrongly_is_told_and_the_next_call_goes_on() -> None:
    guard, still, state = Guard(FREE), np.zeros(7), State(np.array(HOME))
    short, other = State(np.zeros(3)), "must be of"
    for _ in range(2):  # also while a curve runs
        for wrong, words in (
            ((np.zeros(3), state), r"action has shape \(3,\): must be \(7,\)"),
            (({"x": 1.0}, state), r"action is \{'x': 1.0\}: must be \(7,\)"),
            ((None, state), r"action has shape \(\): must be \(7,\)"),
            ((still, short), "state has 3 joints; panda has 7"),
            ((still, None), f"state is None: {other} State"),
            ((still, state, None), f"looks is None: {other} Iterable"),
            ((still, state, [1]), f"a look is 1: {other} Look"),
            ((still, state, (), np.nan), "time is nan: must be finite"),
        ):
            with pytest.raises(InvalidRequestError, match=words):
                guard(*wrong)
        assert not guard(still, state).acted
    for tool, words in (((np.zeros(2), state), "linear has"), ((still[:3], short), "state has 3")):
        with pytest.raises(InvalidRequestError, match=words):
            guard.tool(*tool)


def test_a_change_of_velocity_is_as_short_as_the_limits_allow() -> None:
    robot = load_robot("panda")
    rng = np.random.default_rng(1)
    for _ in range(50):
        begin = State(robot.home, 0.9 * robot.velocity * rng.uniform(-1, 1, 7),
                      0.9 * robot.acceleration * rng.uniform(-1, 1, 7))  # fmt: skip
        step = Change.of(robot, begin, robot.velocity * rng.uniform(-1, 1, 7), PERIOD)
        curve = stopping(robot, step, PERIOD)
        most = extremes(curve)
        assert (most.largest[1] <= robot.acceleration * (1 + 1e-6)).all()
        assert (most.largest[2] <= robot.jerk * (1 + 1e-6)).all()
        rest = later(curve, PERIOD)  # the same curve, from a period later on
        times = np.linspace(0.0, rest.duration, 50)
        for one, other in zip(rest.sample(times), curve.sample(times + PERIOD), strict=True):
            np.testing.assert_allclose(one, other, rtol=0, atol=1e-8)


def test_the_nearest_velocities_are_those_of_a_quadratic_program() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        slopes, least = rng.normal(size=(6, 4)), rng.normal(size=6) - 1.0
        wanted = rng.normal(size=4)
        best = nearest(wanted, slopes, least)
        assert best is not None
        assert (slopes @ best >= least - 1e-9).all()
        for other in best + 0.1 * rng.normal(size=(200, 4)):  # none that is allowed is nearer
            if (slopes @ other >= least).all():
                assert np.linalg.norm(other - wanted) >= np.linalg.norm(best - wanted) - 1e-9
    assert nearest(np.zeros(1), np.array([[1.0], [-1.0]]), np.array([1.0, 1.0])) is None


def test_a_joint_stops_within_the_room_for_which_it_is_fast() -> None:
    room = np.array([0.001, 0.1, 1.0, np.inf])
    for acceleration, jerk in ((5.0, 1000.0), (5.0, 5.0), (np.inf, 50.0)):
        speed = fastest(room, np.full(4, acceleration), np.full(4, jerk))
        lasting = np.maximum(1.5 * speed / acceleration, np.sqrt(6.0 * speed / jerk))
        assert (0.5 * speed * lasting <= room * (1.0 + 1e-9)).all()


# -- fruits


def following(curve: Trajectory) -> Policy:
    def follow(k: int, state: State) -> FloatArray:
        (q,), (velocity,), _ = curve.sample(min((k + 1) * PERIOD, curve.duration))
        return np.asarray(velocity + 2.0 * (q - state.q - PERIOD * state.velocity))

    return follow


def across_a_stem(robot: Robot, fruit: SceneObject) -> Policy:
    """Up to a fruit within 4 s, and 0.3 m farther."""
    beyond = fruit.position + np.array([0.0, 0.3, 0.03])

    def across(k: int, state: State) -> FloatArray:
        point, axis = robot.tool_pose(state.q)
        by = beyond - np.array([0.0, 0.3 * (k < 200), 0.0]) - point
        return joints_for(robot, state.q, 0.09 * by / max(float(np.linalg.norm(by)), 0.05), axis)

    return across


@pytest.fixture(scope="module")
def cluster() -> Scene:
    return generate("cluster", 7)


def test_a_plan_of_ours_passes_and_the_same_path_through_a_fruit_does_not(cluster: Scene) -> None:
    made = plan(cluster, seed=1)
    assert made.success
    robot, curve = made.robot, made.trajectory

    steps = int(curve.duration / PERIOD) + 50
    motion, told = driven(Guard(cluster), made.task.state, following(curve), steps)
    assert np.mean([safe.acted for safe in told]) < 0.05
    assert cluster.target is not None
    end, _ = robot.tool_pose(motion.positions[-1])
    assert np.linalg.norm(end - cluster.target.position) < 0.01


def test_a_sweep_across_a_stem_harms_less_than_it_would(cluster: Scene) -> None:
    made = plan(cluster, seed=1)
    robot, (fruit,) = made.robot, cluster.pushables
    across = across_a_stem(robot, fruit)
    model = made.task.push_model(made.task.start)
    assert isinstance(model, Hanging)

    def harm(motion: Trajectory) -> float:
        way = tool_motion(robot, motion.positions)
        return model.leaving(len(way[0]) - 1).harm(*way, GuardParameters.states)

    start, states = made.task.state, [made.task.state.q]
    for k in range(500):
        states.append(states[-1] + PERIOD * across(k, State(states[-1])))
    unguarded = Trajectory.through(np.array(states), PERIOD, robot.joint_names)
    motion, told = driven(Guard(cluster), start, across, 500)
    most = model.calibration.allowed(GuardParameters.risk)
    assert harm(unguarded) > 2.0 * most
    assert harm(motion) <= most
    assert any("harm" in safe.reason for safe in told)
    assert any(safe.probability > 0.0 for safe in told)


def to(guard: Guard, by: FloatArray, state: State, speed: float = 0.15) -> FloatArray:
    """The action that leads the tool point on by ``by`` (3,)."""
    return guard.tool(speed * by / max(float(np.linalg.norm(by)), 0.05), state)


def test_a_wish_that_was_refused_does_not_pass_from_rest() -> None:
    """From rest it reaches less far, so less harm is predicted."""
    scene = generate("cluster", 185_562)
    guard, (_, start) = Guard(scene), posed(scene)
    assert scene.target is not None
    place = scene.target.position

    def straight(k: int, state: State) -> FloatArray:
        return to(guard, place - guard.robot.tool_pose(state.q)[0], state, 0.1)

    _, told = driven(guard, start, straight, 350)
    refused = ["harm is predicted" in safe.reason for safe in told].index(True)
    assert all(safe.braked for safe in told[refused:])


def test_the_tool_is_slow_among_fruits(cluster: Scene) -> None:
    made = plan(cluster, seed=1)
    robot, fast = made.robot, made.trajectory.slowed(0.4)

    steps = int(fast.duration / PERIOD)
    motion, told = driven(Guard(cluster), made.task.state, following(fast), steps)
    judged = judge(cluster, robot, motion, made.task.state)
    assert not [v for v in judged.violations if v.kind == "speed"]
    assert any("m/s among fruits" in safe.reason for safe in told)


def test_a_fruit_that_no_model_knows_is_not_touched(cluster: Scene) -> None:
    robot, start = posed(cluster)
    point, _ = robot.tool_pose(start.q)
    ball = SceneObject("stray", "pushable", Sphere(0.02), point + np.array([0.0, -0.4, 0.0]))
    assert cluster.target is not None
    assert np.linalg.norm(ball.position - cluster.target.position) > 0.4
    scene = replace(cluster, objects=(*cluster.objects, ball))

    def towards(k: int, state: State) -> FloatArray:
        return joints_for(robot, state.q, np.array([0.0, -0.15, 0.0]))

    _, told = driven(Guard(scene), start, towards, 150)
    assert any("stray" in safe.reason or "what stands" in safe.reason for safe in told)


def test_nothing_comes_near_the_root_of_a_stem(cluster: Scene) -> None:
    scene = cluster.each(lambda item: item.shifted(np.array([0.2, 0.2, -0.3])))
    robot, start = posed(scene)
    assert scene.target is not None
    assert scene.target.stem is not None
    root = scene.target.stem.points[-1]
    beside = root - 0.2 * root * [1.0, 1.0, 0.0] / np.linalg.norm(root[:2])  # where no fruit hangs

    def to_the_root(k: int, state: State) -> FloatArray:
        off = (beside if k < 100 else root) - robot.tool_pose(state.q)[0]
        return joints_for(robot, state.q, 3.0 * off)

    motion, told = driven(Guard(scene), start, to_the_root, 200)
    spheres = robot.sphere_centers(motion.positions)
    away = np.linalg.norm(spheres - root, axis=-1) - robot.spheres.radius
    assert 0.005 <= away.min() < 0.02
    assert "tool would touch ripe/root" in {one.reason for one in told}


def shown(time: float, *items: SceneObject) -> Look:
    """A look at items in the base frame, known to 1 mm; nothing explains those that are points."""
    eye = Pose(np.array([0.5, -0.3, -0.2]), np.eye(3))
    there = [replace(o.transformed(eye.inverse()), stem=None) for o in items]
    solids = tuple(o for o in there if isinstance(o.shape, PointCloudShape))
    known = tuple(replace(o, covariance=1e-6 * np.eye(3)) for o in there if o not in solids)
    return Look(time, eye, known, view=3.0, solids=solids)


def test_looks_move_the_fruits_that_the_guard_knows(cluster: Scene) -> None:
    _, start = posed(cluster)
    guard, by = Guard(cluster), np.array([0.0, 0.02, 0.0])
    for k in range(30):
        guard(np.zeros(7), start, [shown(0.1 * k, *(o.shifted(by) for o in cluster.objects))])
    assert guard.scene.target is not None
    assert cluster.target is not None
    assert guard.scene.target.position - cluster.target.position == pytest.approx(by, abs=0.005)


@pytest.mark.parametrize(("by", "same"), [(1e-3, True), (2e-2, False)])
def test_objects_of_a_look_are_made_where_something_changed(
    cluster: Scene, by: float, same: bool
) -> None:
    """What is told without the objects is what the objects tell."""
    tracker = Tracker(cluster, first=first_tracks(cluster, 0.003))
    moved = [item.shifted(np.array([0.0, by, 0.0])) for item in cluster.objects]
    for k in range(30):
        tracker.add(shown(0.1 * k, *moved))
    seen, most = tracker.at(3.0), GuardParameters().changed
    assert unchanged(cluster, cluster, seen, most, frozenset()) == same
    before = {item.id: item for item in cluster.objects}
    made = seen_scene(cluster, cluster, seen, most).objects
    assert all(stays(item, before[item.id], most) for item in made) == same
    fewer = replace(
        cluster, objects=(*cluster.objects, replace(made[0], id="new", role="pushable"))
    )
    assert not unchanged(cluster, fewer, seen, most, frozenset())
    assert unchanged(cluster, fewer, seen, most, frozenset({"new"})) == same


def test_a_target_that_no_look_shows_stays_and_the_rest_is_seen(cluster: Scene) -> None:
    """As behind the tool, or picked."""
    guard, (_, start) = Guard(cluster), posed(cluster)
    wire = SceneObject("wire", "avoid", Sphere(0.03), np.array([0.5, 0.1, 0.4]))
    (moved,) = [fruit.shifted(np.array([0.0, 0.0, -0.02])) for fruit in cluster.pushables]
    for k in range(40):
        guard(np.zeros(7), start, [shown(0.1 * k, moved, wire)])
    assert cluster.target is not None
    assert guard.scene.target is not None
    assert (guard.scene.target.position == cluster.target.position).all()
    seen = {item.role: item.position for item in guard.scene.objects}
    assert seen["avoid"] == pytest.approx(wire.position, abs=0.002)
    assert seen["pushable"] == pytest.approx(moved.position, abs=0.002)


def test_a_scene_with_a_goal_alone_takes_looks(cluster: Scene) -> None:
    guard = Guard(FREE)
    for k in range(3):
        guard(np.zeros(7), State(HOME), [shown(0.1 * k, *cluster.pushables)])
    assert [item.role for item in guard.scene.objects] == ["pushable"]


@pytest.mark.parametrize("role", ["avoid", "static"], ids=["detected", "points"])
def test_what_a_look_shows_during_a_push_is_not_touched(cluster: Scene, role: Role) -> None:
    (robot, state), (fruit,) = posed(cluster), cluster.pushables
    across, guard = across_a_stem(robot, fruit), Guard(cluster)
    items, wire, place = list(cluster.objects), Sphere(0.03), np.zeros(3)
    behind, gaps = ~robot.spheres.distal, list[float]()

    def gap(q: FloatArray, place: FloatArray) -> float:
        away = lengths(robot.sphere_centers(q) - place) - robot.spheres.radius - wire.radius
        return float(away[behind].min())

    for k in range(330):
        wish = across(k, state)
        if k == 230:  # the tool is among the fruits
            now, soon = (robot.sphere_centers(q)[behind] for q in (state.q, state.q + wish))
            far = int(np.argmax(lengths(soon - now)))
            ways = now[far] + np.linspace(0.0, 0.5, 100)[:, None] * (soon - now)[far] / 0.09
            place = next(each for each in ways if gap(state.q, each) > 0.03)
            points = Sphere(0.025).surface().reshape(-1, 3)
            shape = wire if role == "avoid" else PointCloudShape(points, 0.005)
            items.append(SceneObject("wire", role, shape, place))
        state = guard(wish, state, [shown(PERIOD * k, *items)] if k % 4 == 0 else ()).reference
        gaps += [gap(state.q, place)] if k >= 230 else []
    assert 0.001 < min(gaps) < 0.01


def test_the_same_actions_give_the_same_motion(cluster: Scene) -> None:
    robot, start = posed(cluster)
    one, other = (
        driven(Guard(cluster), start, wild_policy(3, robot, 0.5), 80)[0] for _ in range(2)
    )
    assert (one.positions == other.positions).all()


@pytest.mark.parametrize("limit", [np.inf, 2.0 * np.pi], ids=["without limits", "a turn each way"])
def test_a_wrist_that_is_reported_within_a_turn_makes_no_step(limit: float) -> None:
    """The guard gives what it gives where the wrist is reported as it is."""
    scene = generate("cluster", 3)
    robot, start = posed(scene)
    lower, upper = robot.lower.copy(), robot.upper.copy()
    lower[6], upper[6] = -limit, limit
    robot = replace(robot, lower=lower, upper=upper)
    q, wish = np.array(start.q), np.zeros(7)
    q[6], wish[6] = np.pi - 0.05, 0.3
    made = []
    for told in (lambda x: x, lambda x: (x + np.pi) % (2.0 * np.pi) - np.pi):
        guard, state, out = Guard(scene, robot), State(q), []
        for k in range(40):
            at = np.append(state.q[:6], told(state.q[6]))
            state = guard(wish, State(at), (), PERIOD * k).reference
            out.append(state.q[6])
        made.append(out)
    np.testing.assert_allclose(made[1], made[0], atol=1e-9)
    assert made[0][-1] > np.pi


# -- the loop takes over; in the physics: packages/optipromp-bench/tests/guard/test_takeover.py


def movers(told: list[Safe]) -> list[tuple[str, int]]:
    """Who moved the arm, for how many periods, in order."""
    return [(name, len([*some])) for name, some in groupby(told, lambda safe: safe.mover)]


def test_the_loop_picks_where_harm_is_predicted_and_the_policy_has_the_arm_again() -> None:
    """It goes straight at the fruit, and back once the loop has had the arm.

    While the loop pushes, states of the arm are missing for a second.
    """
    scene = generate("cluster", 941_000)
    guard, (robot, start) = Guard(scene, takes_over=True), posed(scene)
    assert scene.target is not None
    place, up, led = scene.target.position, scene.frame[2], False

    def straight(k: int, state: State) -> FloatArray:
        nonlocal led
        led = led or guard.leads
        by = -0.02 * up if led else place - guard.robot.tool_pose(state.q)[0]
        return to(guard, by, state)

    motion, told = driven(guard, start, straight, 620, seen=scene, silent=range(280, 330))
    # the looks go on to show a target that is not taken, by which the guard may act again
    assert [name for name, _ in movers(told)][:4] == ["policy", "guard", "loop", "policy"]
    assert told[279].reason == "the loop has the arm (push): harm is predicted"
    assert told[279].probability > 0.0
    assert told[279].reference.moving
    assert not told[329].reference.moving
    away = lengths(guard.robot.tool_pose(motion.positions)[0] - place)
    assert away.min() < 0.01
    assert away[-1] > 0.08  # out again
    held = [safe.holding for safe in told].index(True)
    assert abs(held - int(away.argmin())) < 30
    limits = np.array([getattr(robot, name) for name in RATES])
    assert (extremes(motion).largest[:2] <= limits[:2] * (1.0 + 1e-6)).all()


def test_a_policy_held_up_for_a_second_hands_over_to_a_loop_that_may_give_up_twice() -> None:
    """A wrist is turned beyond its range; the fruits are out of reach."""
    far = generate("cluster", 7).each(lambda item: item.shifted(np.array([1.5, 0.0, 0.0])))
    guard = Guard(far, takes_over=True, parameters=GuardParameters(takeovers=2))
    wish, start = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]), posed(far)[1]
    _, told = driven(guard, start, lambda k, state: wish, 700, seen=far)
    names, spells = zip(*movers(told), strict=True)
    assert names == ("policy", *2 * ("guard", "loop"), "guard")
    assert 50 < spells[1] < 100
    assert spells[3] in (50, 51)
    assert spells[-1] > 100
    with pytest.raises(InvalidRequestError, match="time is None: a guard that takes over needs it"):
        guard(wish, told[-1].reference)
