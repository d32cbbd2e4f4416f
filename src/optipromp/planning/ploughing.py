"""Plans for a hand that goes through things standing on a board: along a way found beforehand.

The way is decided in the quasi-static model (:mod:`optipromp.pushing.channel`); here the arm
follows it: by inverse kinematics from the start on, then optimised like every other plan, with the
tool held to the way.
"""

import functools
import itertools
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from optipromp import metrics
from optipromp.arrays import FloatArray
from optipromp.metrics import Judgement
from optipromp.planning import joint
from optipromp.planning.build import Knots
from optipromp.planning.options import PlanOptions
from optipromp.planning.primitives import led_through
from optipromp.planning.setup import Setup
from optipromp.planning.stages import Outcome
from optipromp.planning.starts import Start, Starts, sides
from optipromp.promp.model import ProMP
from optipromp.pushing.channel import ways
from optipromp.pushing.plane import ploughs
from optipromp.pushing.sides import Drift
from optipromp.pushing.thread import evenly, length
from optipromp.robots import ik
from optipromp.robots.roll import level
from optipromp.robots.tools import FrankaHand
from optipromp.scenes.scene import Scene
from optipromp.trajectory import Trajectory

STEP = 0.0025  # [m] of the tool point between knots of the way
SPEED = 0.015  # [m/s] of the tool along the way: packs are pushed, not knocked
WAYS = 3  # that are planned for
ALIKE = 1.2  # a way this much worse than the best is as good, where the best cannot be followed
AMONG = 0.3  # [m] behind the target within which the arm may meet packs
SEARCHED = 0.6  # share of the time that the search for ways may take
REACH = 0.02  # [m] of the tool point between knots on the way there, at the most
FOLLOWED = 1e-4  # [m]
FEWEST = 25  # knots of the reach
VIA = 6  # points of the way that the ProMP is conditioned on


def applies(setup: Setup) -> bool:
    """Whether this is how a setup is planned."""
    return setup.goal_joints is None and ploughs(setup.scene, setup.robot.tool)


def without_packs(setup: Setup) -> Setup:
    """The setup once the hand has pushed everything aside: nothing stands in the wrist's way."""
    scene = emptied(setup.scene)
    return replace(setup, scene=scene, standing=scene)


@functools.lru_cache(maxsize=4)
def emptied(scene: Scene) -> Scene:
    """The scene without its pushables."""
    return replace(scene, objects=tuple(t for t in scene.objects if t.role != "pushable"))


def plan_ploughed(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    seed: int,
    deadline: float,
) -> Outcome:
    """Find ways, follow them, optimise, keep the best.

    Args:
        setup: that this :func:`applies` to.
        promp: supplies the initial trajectory.
        options: see :class:`PlanOptions`.
        goals: (m, n) goal configurations, best first, for where the way cannot be followed from
            the start.
        seed: of the draws of ways and of samples of the ProMP.
        deadline: ``time.perf_counter()`` to stop at.
    """
    began = time.perf_counter()
    tool = setup.robot.tool
    assert isinstance(tool, FrankaHand)
    rng = np.random.default_rng(seed)
    until = began + SEARCHED * (deadline - began)
    ways_found = ways(setup.scene, tool, rng, WAYS, until, wrist(setup))
    found = [w for w in ways_found if w.cost <= ALIKE * ways_found[0].cost]
    searched = time.perf_counter()
    freed = replace(setup, standing=emptied(setup.scene))
    heard: dict[int, Judgement] = {}

    def slowed(q: FloatArray) -> Trajectory:
        made = joint.trajectory_of(setup, options, q, len(q) - 1)
        return made if options.duration is not None else made.with_dt(max(made.dt, STEP / SPEED))

    def verify(trajectory: Trajectory, a: joint.Attempt) -> bool:
        heard[id(a)] = metrics.judge(setup.scene, setup.robot, slowed(a.q), setup.start)
        # a link that pushes a pack was foreseen to: no other start does better
        faults = {str(c) for c in heard[id(a)].contacts if c.role == "pushable"}
        return faults.issuperset(heard[id(a)].violations)

    starts = (begun(freed, promp, way.corners, goals) for way in found)
    without = Starts(freed, promp, options, goals).batches(sides(freed, options), rng=rng)
    made = itertools.chain((batch for batch in starts if batch), without)
    best, _ = joint.Solver(freed, options, deadline).solve(verify, made)
    seconds = time.perf_counter() - searched
    times = {"way": searched - began, "joint": seconds}
    return joint.outcome_of(
        best, slowed(best.start.initial), slowed(best.q), seconds, times, heard.get(id(best))
    )


def wrist(setup: Setup) -> list[FloatArray]:
    """What of the arm is among the packs as the hand is at the target: a box (4, 2) a link.

    In the coordinates of :meth:`FrankaHand.outline`, for the arm as it gets there from the start.
    """
    robot, scene, goal, axis = setup.robot, setup.scene, setup.goal_position, setup.goal_axis
    assert goal is not None
    assert axis is not None
    point, pointing = robot.tool_pose(setup.start)
    share = np.linspace(0.0, 1.0, 1 + int(np.ceil(np.linalg.norm(goal - point) / REACH)))[1:, None]
    axes = pointing + share * (axis - pointing)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    q, errors = ik.track(robot, point + share * (goal - point), axes, setup.start)
    if errors[-1] > FOLLOWED:
        return []
    local = (robot.sphere_centers(q[-1]) - goal) @ scene.frame.T
    radius, link = np.asarray(robot.spheres.radius), np.asarray(robot.spheres.link)
    packs = [(thing.position - goal) @ scene.frame[0] for thing in scene.pushables]
    tall = max(thing.radius for thing in scene.pushables)
    level_with = (local[:, 0] + radius > min(packs) - tall) & (
        local[:, 0] - radius < max(packs) + tall
    )
    near = level_with & (local[:, 2] + radius > -AMONG) & (link != len(robot.link_names) - 1)
    out = []
    for one in np.unique(link[near]):
        mine = near & (link == one)
        flat = local[mine][:, [2, 1]]
        (u0, v0), (u1, v1) = (
            (flat - radius[mine, None]).min(axis=0), (flat + radius[mine, None]).max(axis=0)
        )  # fmt: skip
        out.append(np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]))
    return out


def begun(setup: Setup, promp: ProMP, corners: FloatArray, goals: FloatArray) -> list[Start]:
    """Starts of the optimiser that follow a way (k, 3): from the start on, else to each goal."""
    out = []
    for reach, along in followed(setup, corners, goals):
        q = np.vstack([reach, along])
        knots = Knots(len(q), len(reach) / (len(q) - 1))
        at = np.linspace(len(reach), len(q) - 1, VIA).round().astype(int)
        variances = np.append(np.full(VIA - 1, 1e-6), 0.0)
        initial = led_through(promp, setup.start, at / (len(q) - 1), q[at], variances, len(q))
        out.append(Start(initial, q, NOWHERE, knots))
    return out


def followed(
    setup: Setup, corners: FloatArray, goals: FloatArray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Configurations of the reach (r, n), the start first, and of the way (m, n)."""
    robot, axis = setup.robot, setup.goal_axis
    assert axis is not None
    normal = setup.scene.frame[0]
    points = evenly(corners, max(2, int(np.ceil(length(corners) / STEP)) + 1))
    point, pointing = robot.tool_pose(setup.start)
    count = max(FEWEST, int(np.ceil(2.0 * np.linalg.norm(points[0] - point) / REACH)))
    share = np.linspace(0.0, 1.0, count + 1)[:, None]
    share = share * (2.0 - share)  # slower and slower
    line, axes = point + share * (points[0] - point), pointing + share * (axis - pointing)
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    whole = np.vstack([line[1:], points[1:]])
    q, errors = ik.track(
        robot, whole, np.vstack([axes[1:], np.tile(axis, (len(points) - 1, 1))]), setup.start
    )
    q = level(robot, np.vstack([setup.start, q]), normal, path=True)
    q[0] = setup.start
    if errors.max() < FOLLOWED:
        yield q[:count], q[count:]
        return
    for goal in goals:
        back, errors = ik.track(robot, points[-2::-1], np.tile(axis, (len(points) - 1, 1)), goal)
        if errors.max() < FOLLOWED:
            along = level(robot, np.vstack([goal, back]), normal, path=True)[::-1]
            yield setup.start + share[:-1] * (along[0] - setup.start), along


NOWHERE = Drift((), np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)))
"""No drift: the way says where the tool goes."""
