"""Where the joint strategy begins: conditioned ProMPs, their approach led along the tool's way.

Starts differ in the inverse-kinematics branch of the goal, in the side on which undecided pushables
are passed and, where those are not enough, in samples of the ProMP.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from optipromp.arrays import FloatArray
from optipromp.planning.build import Knots, capture_height, widths
from optipromp.planning.options import PlanOptions
from optipromp.planning.primitives import (
    camera_point,
    led_through,
    on_branch,
    via_points,
)
from optipromp.planning.setup import Setup
from optipromp.promp.conditioning import condition
from optipromp.promp.model import ProMP
from optipromp.promp.points import JointPoint
from optipromp.pushing.neighbours import detection_variance
from optipromp.pushing.sides import Drift, drift_choices
from optipromp.pushing.thread import evenly, length, thread
from optipromp.robots import ik

LEVER_ARM = 0.4  # [m] turns a deviation of the tool into one of the joints
TOOL_STEP = 0.005  # [m] of the tool point between knots of the approach
FOLLOWED = 1e-4  # [m] largest error of a followed tool point
PEAK = 1.9  # largest over mean speed of a smooth reach
FEWEST, MOST = 60, 600  # knots
LONGER = 1.5  # a motion with this many times the knots of the shortest waits for a later batch
SAMPLE_ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Start:
    """A conditioned ProMP (T, n), the trajectory to begin from, and the sides to pass on."""

    initial: FloatArray
    q: FloatArray
    drift: Drift
    knots: Knots


def knots_for(
    setup: Setup,
    options: PlanOptions,
    via: FloatArray | None,
    goal: FloatArray,
    path: float,
) -> Knots:
    """Knots such that no joint moves much over the wanted step, before t_1 and after alike.

    ``path`` is the length of the tool's way from the camera point to the goal [m].
    """
    step = 0.8 * options.max_step
    if via is None or len(via) < 2:
        reach = PEAK * float(np.max(np.abs(goal - setup.start))) / step
        count = options.knots or min(max(FEWEST, math.ceil(reach) + 1), MOST)
        return Knots(count, options.camera_phase or 0.5)
    reach, approach = _motion(setup.start, via)
    reach = max(PEAK * reach / step, 25.0)
    approach = max(1.6 * approach / step, 40.0, path / TOOL_STEP)
    count = options.knots or min(max(FEWEST, 10 * math.ceil((reach + approach) / 10)), MOST)
    phase = options.camera_phase or min(max(0.2, reach / (reach + approach)), 0.75)
    return Knots(count, phase)


@njit(cache=True, error_model="numpy", nogil=True)
def _motion(start: FloatArray, via: FloatArray) -> tuple[float, float]:
    """Largest motion of a joint to the first of configurations (m, n), and from there on."""
    reach = approach = 0.0
    for j in range(len(start)):
        reach = max(reach, abs(via[0, j] - start[j]))
    for k in range(1, len(via)):
        largest = 0.0
        for j in range(len(start)):
            largest = max(largest, abs(via[k, j] - via[k - 1, j]))
        approach += largest
    return reach, approach


@dataclass(frozen=True, eq=False)
class Branch:
    """A goal configuration (n,) and, where they can be followed, those of the via points (m, n)."""

    goal: FloatArray
    via: FloatArray | None
    deviations: FloatArray
    knots: Knots


def sides(setup: Setup, options: PlanOptions) -> tuple[Drift, ...]:
    """Every choice of sides for the neighbours of a setup."""
    return drift_choices(
        setup.scene,
        setup.neighbours,
        options.drift,
        window=options.window,
        depth=getattr(setup.robot.tool, "depth", 0.0),
        gripper_radius=setup.robot.gripper_radius,
    )


def tool_path(setup: Setup, options: PlanOptions, drift: Drift) -> FloatArray:
    """Corners (k, 3) of the tool's way from the camera point past the neighbours to the goal."""
    if not drift.ids or setup.goal_position is None:
        return np.zeros((1, 3))
    return thread(
        drift,
        widths(setup, options, drift)[1],
        setup.goal_position,
        setup.scene.frame,
        camera_point(setup),
        capture_height(setup),
    )


def threaded(
    setup: Setup, options: PlanOptions, branch: Branch, path: FloatArray, q: FloatArray
) -> FloatArray:
    """``q`` (T, n) with its approach led along the tool ``path`` past the neighbours.

    The approach is followed by inverse kinematics from the goal back, on the branch; the reach
    before it is bent to meet it. ``q`` itself where the path cannot be followed.
    """
    if branch.via is None or options.window == "paper":
        return q
    assert setup.goal_axis is not None
    first = branch.knots.first
    points = evenly(path, len(q) - first)
    axes = np.full_like(points[1:], setup.goal_axis)
    back, errors = ik.track(setup.robot, points[-2::-1], axes, branch.goal)
    if errors.max() > FOLLOWED:
        return q
    out = np.array(q)
    out[first:-1] = back[::-1]
    share = np.linspace(0.0, 1.0, first + 1)[:, None]
    out[: first + 1] = q[: first + 1] + share**2 * (3.0 - 2.0 * share) * (out[first] - q[first])
    return out


def initial(setup: Setup, promp: ProMP, branch: Branch) -> FloatArray:
    """The ProMP conditioned on start, camera point, pushables and one goal configuration (T, n)."""
    if branch.via is None:
        phases, values, variances = np.array([1.0]), branch.goal[None], np.zeros(1)
    else:
        values = branch.via
        phases = np.linspace(branch.knots.camera_phase, 1.0, len(values))
        variances = (branch.deviations / LEVER_ARM) ** 2
        variances[1:-1] += [detection_variance(t) / LEVER_ARM**2 for t in setup.neighbours]
    q = led_through(promp, setup.start, phases, values, variances, branch.knots.count)
    q[-1] = branch.goal
    return q


def settled(q: FloatArray, start: FloatArray, goal: FloatArray) -> FloatArray:
    """``q`` with exact ends (a conditioned ProMP meets them to rounding)."""
    out = np.array(q)
    out[0], out[-1] = start, goal
    return out


def sampled(setup: Setup, promp: ProMP, branch: Branch, rng: np.random.Generator) -> FloatArray:
    """A draw (T, n) from the ProMP conditioned on its ends only."""
    ends = condition(promp, [JointPoint(0.0, setup.start), JointPoint(1.0, branch.goal)])
    (q,) = ends.sample(rng, 1, branch.knots.count)
    robot = setup.robot
    return settled(np.clip(q, robot.lower, robot.upper), setup.start, branch.goal)


class Starts:
    """The starts of one scene, for any choice of sides.

    What does not depend on the sides is made once, however many choices are tried.

    Args:
        setup: scene and robot.
        promp: supplies the initial trajectories.
        options: see :class:`PlanOptions`.
        goals: (m, n) goal configurations, best first.
    """

    def __init__(
        self,
        setup: Setup,
        promp: ProMP,
        options: PlanOptions,
        goals: FloatArray,
    ) -> None:
        self.setup, self.promp, self.options, self.goals = setup, promp, options, goals
        self._followed: list[tuple[FloatArray | None, FloatArray]] | None = None
        self._initial: dict[tuple[bytes, Knots], FloatArray] = {}

    def branches(self, paths: Sequence[FloatArray]) -> list[Branch]:
        """The branches of the goal configurations, shortest motion first.

        ``paths`` are the tool's ways for every choice of sides, see :func:`tool_path`.
        """
        if self._followed is None:
            self._followed = self._follow()
        longest = max(length(path) for path in paths)
        out = []
        for goal, (via, deviations) in zip(self.goals, self._followed, strict=True):
            knots = knots_for(self.setup, self.options, via, goal, longest)
            out.append(Branch(goal, via, deviations, knots))
        return sorted(out, key=lambda branch: branch.knots.count)

    def _follow(self) -> list[tuple[FloatArray | None, FloatArray]]:
        """Configurations (m, n) at the via points and their deviations (m,), for every goal."""
        setup = self.setup
        if not setup.neighbours:
            return [(None, np.zeros(1))] * len(self.goals)
        positions = [thing.position for thing in setup.neighbours]
        points = via_points(setup, positions, 0.5, self.options.via_deviation)
        return [(on_branch(setup, points, goal), points.deviations) for goal in self.goals]

    def initial(self, branch: Branch) -> FloatArray:
        """:func:`initial` of a branch (T, n)."""
        key = branch.goal.tobytes(), branch.knots
        if key not in self._initial:
            self._initial[key] = initial(self.setup, self.promp, branch)
        return self._initial[key]

    def batches(
        self,
        choices: Sequence[Drift],
        paths: Sequence[FloatArray] | None = None,
        rng: np.random.Generator | None = None,
    ) -> Iterator[list[Start]]:
        """Starts to solve together, for every choice of sides, the most promising batch first.

        ``paths`` are the tool's ways for these choices, where they are known.

        Branches whose motion is much longer than the shortest one wait for a later batch. Where
        ``rng`` is given, :data:`SAMPLE_ROUNDS` samples of the ProMP for each come when every branch
        has failed.
        """
        setup, options = self.setup, self.options
        if paths is None:
            paths = [tool_path(setup, options, drift) for drift in choices]
        waiting = self.branches(paths)
        order = list(waiting)
        while waiting:
            reach = LONGER * waiting[0].knots.count
            batch = [branch for branch in waiting[: options.starts] if branch.knots.count <= reach]
            waiting = waiting[len(batch) :]
            yield [
                Start(q, threaded(setup, options, branch, path, q), drift, branch.knots)
                for branch in batch
                for q in (self.initial(branch),)
                for drift, path in zip(choices, paths, strict=True)
            ]
        if rng is None:
            return
        for _ in range(SAMPLE_ROUNDS):
            for low in range(0, len(order), options.starts):
                yield [
                    Start(q, q, drift, branch.knots)
                    for branch in order[low : low + options.starts]
                    for q in (sampled(setup, self.promp, branch, rng),)
                    for drift in choices
                ]
