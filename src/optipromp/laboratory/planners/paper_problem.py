"""The paper's problem (method §5) on one goal and one choice of sides.

Constraints 1 to 3 are rows, each linear in one tool point (:class:`ConstraintRows`), the same
for both strategies of :mod:`optipromp.laboratory.planners.paper_stages`.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.evaluation import Evaluation
from optipromp.core.optimization.problem import Problem
from optipromp.core.planning import collision
from optipromp.core.planning.follow import Waypoints, free_count, reach_count, within_limits
from optipromp.core.planning.goals import find
from optipromp.core.planning.parameters import GOAL, PRIMITIVE, WAYPOINT
from optipromp.core.planning.primitive import led_through, on_branch, via_points
from optipromp.core.planning.result import ViaPoint
from optipromp.core.planning.slow import paced
from optipromp.core.planning.task import Task, pushed_aside, stands
from optipromp.core.planning.timing import timed
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.rules import Drift, detection_variance, drift_choices
from optipromp.core.scenes.scene import JointGoal
from optipromp.core.scenes.values import suggest
from optipromp.core.trajectory import Trajectory
from optipromp.laboratory.planners.functionals import weighted
from optipromp.laboratory.planners.paper import Paper
from optipromp.laboratory.planners.parameters import PAPER


class ConstraintRows(Cost):
    """Constraints 1 to 3 as rows ``lower ≤ axis·fk(ξ_t) ≤ upper``, each at one waypoint.

    The cost is the quadratic penalty ½ Σ weight·v², where v is the violation of a row [m].

    Attributes:
        at: (m,) waypoint t of each row.
        axes: (m, 3) unit vectors.
        lower, upper: (m,) bounds [m].
    """

    def __init__(
        self, weight: float, at: IntArray, axes: FloatArray, lower: FloatArray, upper: FloatArray
    ) -> None:
        super().__init__("rows", weight)
        self.at = np.asarray(at, dtype=np.int64)
        self.axes, self.lower, self.upper = axes, lower, upper
        x, y, z = axes.T
        self.outer = np.stack([x * x, y * y, z * z, x * y, x * z, y * z], axis=1)

    def add(self, e: Evaluation, scale: float) -> float:
        """The penalty, with its gradient and curvature added to ``e``."""
        value = np.einsum("mi,mi->m", e.points[self.at, e.tool], self.axes)
        off = value - np.clip(value, self.lower, self.upper)
        if scale > 0.0:
            out = np.flatnonzero(off)
            force, stiffness = e.force[:, e.tool], e.stiffness[:, e.tool]
            np.add.at(force, self.at[out], scale * off[out, None] * self.axes[out])
            np.add.at(stiffness, self.at[out], scale * self.outer[out])
        return 0.5 * float(off @ off)


@dataclass(frozen=True, eq=False)
class Posed:
    """The paper's problem for one goal configuration and one choice of sides.

    Attributes:
        task: scene and robot.
        options: settings of the planner.
        waypoints: number of waypoints, and the first at or after t_1.
        drift: place of each pushable to pass, and the direction to its free side.
        offsets: (N,) lateral offset that constraint 1 asks for at each pushable [m].
        via: tool points that the ProMP was conditioned on, the target last.
        initial: (T, n) the conditioned ProMP.
        points: (T, 3) tool points of ``initial`` [m].
    """

    task: Task
    options: Paper
    waypoints: Waypoints
    drift: Drift
    offsets: FloatArray
    via: tuple[ViaPoint, ...]
    initial: FloatArray
    points: FloatArray

    def rows(self, weight: float = 0.0, every: int = 1, most: int | None = None) -> ConstraintRows:
        """Constraints 1 and 2 at ``most`` waypoints (None: all), 3 at each ``every``-th of them.

        A waypoint is in the window of a pushable where its initial height along z_g is, within the
        tolerance of constraint 3. The last waypoint, the goal, has no rows.
        """
        frame, paper = self.task.scene.frame, self.options.paper
        apart = 1 if most is None else math.ceil(self.waypoints.count / most)
        free = np.arange(self.waypoints.first, self.waypoints.count - 1)[::apart]
        rows: list[tuple[IntArray, FloatArray, FloatArray, FloatArray]] = []
        for center, direction, (low, high), offset in zip(
            self.drift.centers, self.drift.directions, self.drift.windows, self.offsets, strict=True
        ):
            height = (self.points[free] - center) @ frame[2]
            at = free[(height >= low - paper.corridor) & (height <= high + paper.corridor)]
            least = np.full(len(at), float(center @ direction) + offset + PAPER.margin)
            rows.append((at, direction, least, np.full(len(at), np.inf)))
        for axis in frame[[0, 2] if paper.drift == "paper" else [2]]:
            at = free[::every]
            middle = self.points[at] @ axis
            rows.append((at, axis, middle - paper.corridor, middle + paper.corridor))
        at, lower, upper = (np.concatenate([row[k] for row in rows]) for k in (0, 2, 3))
        axes = np.concatenate([np.tile(axis, (len(at), 1)) for at, axis, _, _ in rows])
        return ConstraintRows(weight, at, axes, lower, upper)

    def functionals(self) -> list[Cost]:
        """F_s, F_d, F_p and F_v with their weights, in the forms of the strategy."""
        sequential = self.options.strategy == "sequential"
        return weighted(self.task, self.options.paper, self.waypoints.first, sequential)

    def timed(self, q: FloatArray) -> Trajectory:
        """Waypoints ``q`` (T, n) as a trajectory, slow on the approach among what is pushed."""
        if stands(self.task):
            return paced(self.task, self.options, q, self.waypoints.first, None)
        slow = self.waypoints.first if self.task.neighbours else None
        return timed(self.task, self.options, q, slow)

    def problem(self, terms: Sequence[Cost], constraints: Sequence[Cost], ends: bool) -> Problem:
        """The problem over the waypoints; the first is fixed, with ``ends`` also the last."""
        task, options = pushed_aside(self.task), self.options  # before the arm comes
        cutoff = max(options.paper.epsilon, options.static_clearance, options.avoid_clearance)
        return Problem(
            task.robot, task.surroundings, terms, constraints, self.waypoints.count,
            cutoff=cutoff + 1e-3, end_fixed=ends, body=task.body,
        )  # fmt: skip


def drift_offsets(task: Task, options: Paper) -> FloatArray:
    """The lateral offset (N,) that constraint 1 asks for at each neighbour [m].

    It is that of the options, else of the scene, else R_gripper.
    """
    wanted = options.paper.drift_offset
    wanted = task.scene.options.get("drift_offset") if wanted is None else wanted
    wanted = task.robot.gripper_radius if wanted is None else wanted
    if not isinstance(wanted, Mapping):
        return np.full(len(task.neighbours), float(wanted))
    ids = [item.id for item in task.scene.pushables]
    for name in wanted:
        if name not in ids:
            raise InvalidRequestError(f"drift_offset of {name!r}: {suggest(name, ids)}")
    usual = task.robot.gripper_radius
    return np.array([float(wanted.get(item.id, usual)) for item in task.neighbours])


def posed_problems(
    task: Task, promp: ProMP, options: Paper, goals: FloatArray
) -> Iterator[list[Posed]]:
    """For each goal configuration of ``goals`` (m, n): the problems of all choices of sides.

    The configuration whose motion takes the fewest waypoints comes first.
    """
    positions, offsets = [obj.position for obj in task.neighbours], drift_offsets(task, options)
    names = ["camera", *(obj.id for obj in task.neighbours), "goal"]
    branches: list[tuple[FloatArray, FloatArray]] = []
    for goal in goals:
        branch = None
        if positions:
            points, deviations = via_points(task, positions, options.paper.via_deviation)
            branch = on_branch(task, points, goal)
        if branch is None:
            branches.append((goal[None], np.zeros(1)))
            continue
        variances = deviations.astype(np.float64) ** 2  # a deviation may be an integer
        variances[1:-1] += [detection_variance(obj) for obj in task.neighbours]
        branches.append((branch, variances / PRIMITIVE.lever_arm**2))
    branches.sort(key=lambda branch: spaced(task, options, branch[0]).count)
    for values, variances in branches:
        waypoints = spaced(task, options, values)
        phases = np.linspace(waypoints.phase, 1.0, len(values)) if len(values) > 1 else [1.0]
        q = led_through(promp, task.start, np.array(phases), values, variances, waypoints.count)
        met, points = (task.robot.tool_pose(one)[0] for one in (values, q))
        via = tuple(map(ViaPoint, names[-len(met) :], met))
        yield [
            Posed(task, options, waypoints, drift, offsets, via, q, points)
            for drift in drift_choices(
                task.scene, task.neighbours, options.paper.drift, window="paper"
            )
        ]


def spaced(task: Task, options: Paper, values: FloatArray) -> Waypoints:
    """Waypoints between which no joint moves much more than the wanted step.

    The step holds before t_1 and after it. ``values`` (m, n) are the configurations that the motion
    is led through after the start.
    """
    reach = values[0] - task.start
    if len(values) == 1:
        count = options.waypoints or free_count(reach, options.max_step)
        return Waypoints.at_phase(count, options.paper.camera_phase or 0.5)
    tools = task.robot.tool_pose(values)[0]
    path = float(np.linalg.norm(np.diff(tools, axis=0), axis=1).sum())
    moved = float(np.abs(np.diff(values, axis=0)).max(axis=1).sum())
    before = max(reach_count(reach, options.max_step), WAYPOINT.fewest_reach)
    after = max(
        1.6 * moved / (WAYPOINT.share * options.max_step),
        WAYPOINT.fewest_approach,
        path / WAYPOINT.tool_step,
    )
    count = options.waypoints or within_limits(10 * np.ceil((before + after) / 10))
    phase = min(max(0.2, before / (before + after)), 0.75)
    return Waypoints.at_phase(count, options.paper.camera_phase or phase)


def further(task: Task, seed: int, known: FloatArray) -> FloatArray:
    """Free goal configurations (m, n) that differ from the ``known`` ones (k, n), best first.

    More starts of inverse kinematics find them on all branches and rolls of the elbow.
    """
    if isinstance(task.goal, JointGoal):
        return known[:0]
    found = find(task, seed, PAPER.spread_starts)
    away = np.abs(found[:, None] - known).max(axis=2).min(axis=1)
    return collision.free(task, found[away > GOAL.distinct])
