"""Settings: each is checked, and each does what its name says."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from tests.planning.builders import END, block

from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.geometry import Sphere
from optipromp.core.optimization.costs.joints import VelocityCost
from optipromp.core.planning import ConditionedProMP, IProMP, Plan, PlanOptions, Term, judge, plan
from optipromp.core.planning.task import resolve
from optipromp.core.pushing.path import through
from optipromp.core.pushing.rules import rule_paths
from optipromp.core.scenes import JointGoal, Scene, load_scene
from optipromp.core.trajectory import Trajectory
from optipromp_paper.paper import Paper

NAN, INF = float("nan"), float("inf")
Planned = Callable[..., Plan]


# --- what is refused ---------------------------------------------------------------------------


REFUSED: dict[Any, list[tuple[str, Any]]] = {
    PlanOptions: [
        ("waypoints", 2), ("waypoints", 3.5), ("waypoints", True), ("waypoints", 20_001),
        ("duration", 0.0), ("duration", NAN), ("duration", INF), ("timeout", -1.0),
        ("prediction", 1), ("rule", "longest"), ("approach_speed", 5e-324), ("corridor", -0.01),
        ("max_step", INF), ("smoothness", -1e-9), ("static_clearance", -0.01),
        ("avoid_clearance", -0.01), ("self_clearance", -0.01), ("limit_margin", -0.01),
        ("iterations", 1.5), ("costs", (1.0,)), ("risk", 0.0), ("risk", 1.0),
        *((name, value) for name in ("timeout", "costs")
          for value in ("3", [1], {}, 10**400)),
    ],
    Paper: [
        ("alphas", (1.0, 1.0, 1.0)), ("alphas", (NAN, 1.0, 1.0, 0.0)), ("epsilon", 0.0),
        ("reduction", "mean"), ("push", "cubic"), ("drift", "left"), ("strategy", "both"),
        ("constraints", "all"), ("push_weights", (1.0, 1.0)), ("push_weights", (1.0, NAN, 1.0)),
        ("drift_offset", -0.01), ("drift_offset", {"n1": NAN}), ("drift_offset", {1: 0.1}),
        ("corridor", -0.01), ("camera_phase", 1.0), ("via_deviation", -1e-3), ("trust_radii", ()),
        ("trust_radii", (0.0,)), ("trust_radii", (0.02, 0.01)),
    ],
    IProMP: [
        ("camera_phase", 0.0), ("direction_deviation", -0.1), ("guard", 1), ("camera_point", 3),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("kind", "name", "value"), [(kind, *one) for kind, each in REFUSED.items() for one in each]
)
def test_refusals_name_the_setting(kind: Any, name: str, value: Any) -> None:
    wanted = rf"^{name}(\[0\])?.* (is .*(must be|valid are)|must have)"
    with pytest.raises(InvalidRequestError, match=wanted) as caught:
        kind(**{name: value})
    assert caught.value.code is Code.INVALID_REQUEST


@pytest.mark.parametrize("setting", ["max_step", "approach_speed"])
def test_the_least_step_and_speed_end_in_a_plan(setting: str, planned: Planned) -> None:
    made = planned("scenario-3", waypoints=60, **{setting: 1e-6})
    assert len(made.trajectory.positions) == 60
    assert np.isfinite(made.trajectory.positions).all()


def test_the_edges_are_allowed() -> None:
    PlanOptions(
        waypoints=3, timeout=INF, corridor=0.0, smoothness=0.0, static_clearance=0.0,
        avoid_clearance=0.0, self_clearance=0.0, limit_margin=0.0, iterations=0,
        costs=(VelocityCost(0.0),),
    )  # fmt: skip
    Paper(alphas=(0.0, 0.0, 0.0, 0.0), drift_offset=0.0, via_deviation=0.0)


# --- how long, how fast, how fine --------------------------------------------------------------


def test_waypoints_and_duration_are_what_was_asked_for(planned: Planned) -> None:
    for planner in ("promp", "i-promp", "opti-promp"):
        result = planned("scenario-3", planner, waypoints=77, duration=8.0)
        assert result.trajectory.n_waypoints == result.followed.n_waypoints == 77
        assert result.trajectory.duration == pytest.approx(8.0)
        assert result.metrics.duration == pytest.approx(8.0)


def test_few_waypoints_leave_constraint_1_nothing_and_the_stages_plan() -> None:
    result = plan("scenario-4", planner=Paper(constraints="push-model", waypoints=4))
    assert result.trajectory.n_waypoints == 4
    assert {stage.name for stage in result.stages} == {"push", "collision"}
    assert not result.success  # so few cannot pass the fruits; the judge says so


def test_a_duration_that_the_limits_do_not_allow_is_no_success(planned: Planned) -> None:
    result = planned("scenario-3", duration=0.3)
    assert result.status is Code.INVALID_PLAN
    assert "velocity of joint" in result.message
    assert result.metrics.velocity_ratio > 1.0
    assert result.prediction is not None  # of what is invalid the harm is told too


@pytest.mark.parametrize("planner", ["promp", "i-promp", "opti-promp"])
def test_without_a_duration_a_limit_is_used_up(planner: str, planned: Planned) -> None:
    m = planned("scenario-3", planner, approach_speed=100.0).metrics
    used = max(m.velocity_ratio, m.acceleration_ratio ** (1 / 2), m.jerk_ratio ** (1 / 3))
    assert 0.9 < used <= 1.0


def tool_speeds(result: Plan) -> np.ndarray:
    tools = result.robot.tool_pose(result.trajectory.positions)[0]
    return np.linalg.norm(np.diff(tools, axis=0), axis=1) / np.diff(result.trajectory.times)


def path_of(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """The camera point, and the rule's paths (m, P, 3) from there, finely."""
    task = resolve(scene)
    paths = rule_paths(task.scene, task.neighbours, task.robot, task.camera)
    share = np.linspace(0.0, 1.0, 20_000)
    return task.camera, np.array([through(corners, 0.1).at(share) for corners in paths])


def approach_of(result: Plan) -> slice:
    """The waypoints from the camera point on."""
    tools = result.robot.tool_pose(result.trajectory.positions)[0]
    camera = resolve(result.scene).camera
    return slice(int(np.argmin(np.linalg.norm(tools - camera, axis=1))), None)


@pytest.mark.parametrize("speed", [0.05, 0.1])
def test_the_tool_is_as_slow_among_fruits_as_asked_for(speed: float, planned: Planned) -> None:
    """From the camera point on, and no slower than that; before it the tool may be faster."""
    result = planned("scenario-3", approach_speed=speed)
    speeds = tool_speeds(result)
    assert speeds[approach_of(result)].max() == pytest.approx(speed, rel=1e-9)
    m = result.metrics
    assert max(m.velocity_ratio, m.acceleration_ratio) < 1.0
    fast = planned("scenario-3", approach_speed=speed, duration=2.5)
    assert fast.trajectory.duration == pytest.approx(2.5)  # a duration overrides it
    assert tool_speeds(fast)[approach_of(fast)].max() > speed
    assert fast.status is Code.INVALID_PLAN  # a push is predicted for a slow tool


@pytest.mark.parametrize("options", [{"approach_speed": 0.2}, {"duration": 3.5}])
def test_what_is_asked_for_too_fast_among_fruits_is_made_and_no_success(options, planned):
    result = planned("scenario-3", **options)
    assert result.status is Code.INVALID_PLAN
    assert "among fruits (pushes are predicted for 0.1)" in result.message
    assert (result.metrics.approach_speed or 0.0) > 0.11
    assert planned("scenario-3", approach_speed=0.1).success


@pytest.mark.parametrize("kind", [ConditionedProMP, IProMP])
@pytest.mark.parametrize("speed", [0.05, 0.1])
def test_the_papers_tool_is_as_slow_from_t_1_on(kind: Any, speed: float) -> None:
    planner = kind(approach_speed=speed, waypoints=101, camera_phase=0.4)
    result = plan("scenario-3", planner=planner)
    assert tool_speeds(result)[40:].max() == pytest.approx(speed, rel=1e-9)


def test_steps_are_kept(planned: Planned) -> None:
    """By more waypoints, or, where their number is given, by a more even motion."""
    free, fine = planned("scenario-3"), planned("scenario-3", max_step=0.015)
    assert fine.metrics.max_step <= 0.015 < free.metrics.max_step
    assert fine.trajectory.n_waypoints > free.trajectory.n_waypoints
    few, even = (planned("scenario-3", waypoints=70, max_step=step) for step in (0.045, 0.03))
    assert even.metrics.max_step <= 0.03 < few.metrics.max_step


def acceleration(result: Plan) -> float:
    """RMS acceleration of the joints, in units of the motion's time."""
    q = result.trajectory.positions
    return float(np.sqrt(np.mean(np.diff(q, 2, axis=0) ** 2))) * (len(q) - 1) ** 2


def test_a_smoother_plan_accelerates_less(planned: Planned) -> None:
    values = [acceleration(planned("scenario-3", smoothness=w)) for w in (0.0, 1e-4, 1e-2)]
    assert values[1] < 0.9 * values[0]
    assert values[2] < 0.9 * values[1]


# --- how near ----------------------------------------------------------------------------------


@cache
def grazed(role: Any) -> Scene:
    """A reach in free space, with a ball 8 mm beside the wrist on its way, far from both ends."""
    free = replace(load_scene("scenario-3"), objects=(), goal=JointGoal(END))
    made = plan(free)
    robot, q = made.robot, made.trajectory.positions
    k, (low, high) = len(q) // 2, np.searchsorted(robot.spheres.link, [5, 7])
    for i in range(low, high):
        before, at, after = (robot.sphere_centers(q[j])[i] for j in (k - 1, k, k + 1))
        aside = np.cross(before - after, [0.0, 0.0, 1.0])
        aside /= np.linalg.norm(aside)
        ball = block(role, Sphere(0.03), at + (robot.spheres.radius[i] + 0.038) * aside)
        scene = replace(free, objects=(ball,))
        still = (Trajectory.through(q[[j, j, j]], 0.1, robot.joint_names) for j in (0, -1))
        ends = [judge(scene, one).judgement.metrics for one in still]
        if all(getattr(end, f"clearance_{role}") > 0.05 for end in ends):
            return scene
    raise AssertionError("no such ball")


@pytest.mark.parametrize("role", ["static", "avoid"])
def test_as_much_clearance_is_kept_as_is_asked_for(role: str) -> None:
    kept = []
    for wanted in (0.005, 0.02, 0.04):
        result = plan(grazed(role), options=PlanOptions(**{f"{role}_clearance": wanted}))
        assert result.success
        kept.append(getattr(result.metrics, f"clearance_{role}"))
        assert kept[-1] > wanted - 1e-3
    assert kept[0] < 0.02
    assert kept[1] < 0.04


def test_clearance_is_kept_among_fruits(planned: Planned) -> None:
    plain, wide = (
        planned("scenario-3", avoid_clearance=c).metrics.clearance_avoid for c in (0.012, 0.04)
    )
    assert plain < 0.05 < 0.055 < wide


def test_links_keep_the_clearance_from_one_another_that_is_asked_for() -> None:
    scene = replace(
        load_scene("scenario-3"), objects=(),
        start=np.array([-1.88, 0.93, -2.3, -2.67, -2.15, 0.84, 1.3]),
        goal=JointGoal(np.array([0.86, 0.85, 1.36, -2.62, -1.31, 3.23, 0.18])),
    )  # fmt: skip
    plain, wide = (plan(scene, options=PlanOptions(self_clearance=c)) for c in (0.005, 0.05))
    assert plain.success
    assert wide.success
    assert plain.metrics.clearance_self < 0.045
    assert wide.metrics.clearance_self > 0.049


def test_the_margin_to_the_limits_is_kept(planned: Planned) -> None:
    near = []
    for margin in (0.01, 0.63, 0.65):
        result = planned("scenario-3", limit_margin=margin)
        assert result.success
        q, robot = result.trajectory.positions, result.robot
        near.append(float(np.minimum(q - robot.lower, robot.upper - q).min()))
        assert near[-1] > margin - 1e-3
    assert near[0] < 0.63


def off_path(result: Plan) -> float:
    """How far the tool leaves the rule's path [m]."""
    _, paths = path_of(result.scene)
    tools = result.robot.tool_pose(result.trajectory.positions[approach_of(result)])[0]
    return min(
        float(np.linalg.norm(tools[:, None] - path[None], axis=2).min(axis=1).max())
        for path in paths
    )


def test_a_tighter_corridor_keeps_the_tool_nearer_to_its_path(planned: Planned) -> None:
    """Where other costs lead it away: a very smooth plan would cut the corners."""
    away = [
        off_path(planned("scenario-4", prediction=False, smoothness=1e-2, corridor=corridor))
        for corridor in (1e-4, 5e-4, 2e-3, 2e-2)
    ]
    assert (np.diff(away) > 0.0).all()
    assert away[0] < 5e-4
    assert away[3] > 1e-2
    assert off_path(planned("scenario-4", prediction=False)) < 0.002  # as a rule, within it


# --- what is optimised -------------------------------------------------------------------------


@pytest.mark.parametrize("prediction", [True, False])
def test_zero_iterations_return_the_followed_trajectory_and_say_so(prediction, planned):
    result = planned("scenario-3", iterations=0, prediction=prediction)
    np.testing.assert_array_equal(result.trajectory.positions, result.followed.positions)
    assert not np.array_equal(result.followed.positions, result.initial.positions)
    assert "not optimised" in result.message
    assert result.stages == ()
    full = planned("scenario-3", prediction=prediction)
    assert "not optimised" not in full.message
    np.testing.assert_array_equal(full.followed.positions, result.followed.positions)
    assert not np.array_equal(full.trajectory.positions, full.followed.positions)


@pytest.mark.parametrize("iterations", [1, 2, 3])
def test_iterations_are_counted(iterations: int, planned: Planned) -> None:
    (stage,) = planned("scenario-3", iterations=iterations).stages
    assert 1 < len(stage.history) <= iterations + 1


def test_without_prediction_the_tool_goes_the_rules_way(planned: Planned) -> None:
    """All the way to the target; what that does is predicted all the same."""
    ruled, own = planned("scenario-4", prediction=False), planned("scenario-4")
    assert off_path(ruled) < np.sqrt(3.0) * 0.002 < 0.01 < off_path(own)
    assert own.prediction.harm < 0.5 * ruled.prediction.harm


# --- the paper's -------------------------------------------------------------------------------


def test_the_camera_phase_divides_the_motion() -> None:
    """At t_1 the tool is at the camera point, below the lowest fruit."""
    for phase in (0.4, 0.7):
        result = plan("scenario-3", planner=ConditionedProMP(camera_phase=phase))
        tools = result.robot.tool_pose(result.trajectory.positions)[0]
        waypoint = round(phase * (len(tools) - 1))
        lowest = min(o.position[2] for o in result.scene.pushables) - 0.015
        np.testing.assert_allclose(tools[waypoint], [0.45, 0.0, lowest - 0.1], atol=2e-3)


def test_a_smaller_deviation_leads_the_tool_nearer_to_the_pushables() -> None:
    """I-ProMP passes each pushable's own place as closely as it is told."""
    away = []
    for deviation in (1e-3, 1.0):
        result = plan("scenario-3", planner=IProMP(waypoints=600, via_deviation=deviation))
        tools = result.robot.tool_pose(result.trajectory.positions)[0]
        away.append(
            max(np.linalg.norm(tools - o.position, axis=1).min() for o in result.scene.pushables)
        )
    assert away[0] < 1e-3
    assert away[1] > 1e-2


def papers(**settings: Any) -> Mapping[str, Term]:
    """The functionals of what the paper's planner begins with."""
    return plan("scenario-3", planner=Paper(iterations=0, **settings)).terms


def test_epsilon_reduction_and_push_change_what_is_reported() -> None:
    """The functionals along the same trajectory; what they are is tested with the costs."""
    near, far, most = (
        papers(epsilon=epsilon, reduction=kind)["avoid"]
        for epsilon, kind in ((0.01, "sum"), (0.2, "sum"), (0.2, "max"))
    )
    assert far.final > near.final
    assert 0.0 < most.final < far.final
    push = [papers(push=form)["push"].final for form in ("quadratic", "reciprocal")]
    assert push[0] != push[1]
    lateral = papers(push="quadratic", push_weights=(0.0, 2.0, 0.0))["push"].final
    single = papers(push="quadratic", push_weights=(0.0, 1.0, 0.0))["push"].final
    assert lateral == pytest.approx(2.0 * single)


def test_what_is_not_optimised_has_no_history() -> None:
    for term in papers().values():
        assert term.history == ()
        assert term.stage == ""
        assert term.followed == term.final
