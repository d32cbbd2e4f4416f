"""The optimisation problem: costs and constraints over the free waypoints of a trajectory."""

import functools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frozen, read_only
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.optimization import kernels
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.costs.joints import smoothness
from optipromp.core.optimization.evaluation import BodyPoints, Evaluation, body_points
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, packed, rows_around

FARTHER = 0.1  # [m] beyond its reach, where objects still concern the arm: a choice
NEAR = 0.065  # [m] cells list obstacles this near to a body sphere: more than GOAL.room
ANCHOR = 1e3  # [1/T⁴] weight of ∫‖δ‖² dt beside ∫‖δ̈‖² dt in the metric: a choice for slow bends


@dataclass(frozen=True)
class Special:
    """Obstacles that spheres keep another distance from than contact."""

    field: str  # ``static`` or ``dynamic``
    obstacles: Obstacles  # without cells
    shared: int  # number of those that concern all spheres, of a dynamic field
    # (B,) of the body spheres, larger by that distance [m]; minus infinity where an obstacle does
    # not count
    radius: FloatArray
    bound: FloatArray  # (L,) of the links' bounding spheres, likewise [m]


@dataclass(frozen=True)
class Surroundings:
    """Obstacles by role, ready for the kernels.

    Attributes:
        static: obstacles of every body sphere.
        dynamic: objects to avoid, then pushables. Pushables, from index ``shared`` on, concern only
            B_d (all links but the last one and the tool).
        shared: number of avoid objects.
        special: padded obstacles, and those that some links may touch; they are in no other list.
    """

    static: Obstacles
    dynamic: Obstacles
    shared: int
    special: tuple[Special, ...] = ()

    def measure(self, e: Evaluation, cutoff: float) -> None:
        """Fill both fields of an evaluation, up to distances of ``cutoff`` [m]."""
        e.static.measure(e, self.static, len(self.static.kind), cutoff)
        e.dynamic.measure(e, self.dynamic, self.shared, cutoff)
        for one in self.special:
            field = e.static if one.field == "static" else e.dynamic
            sizes = one.radius, one.bound
            field.measure_too(e, one.obstacles, one.shared, cutoff, sizes)


@functools.lru_cache(maxsize=32)
def reach(robot: Robot) -> float:
    """Largest distance of any point of the robot from the base origin, in any configuration [m]."""
    kin = robot.kinematics
    far = float(np.linalg.norm(kin.translation, axis=1).sum())
    slide = np.maximum(np.abs(robot.lower), np.abs(robot.upper))[kin.dof]
    slide = np.abs(kin.multiplier) * slide + np.abs(kin.offset)
    far += float(slide[kin.kind == 1].sum())
    spheres = np.linalg.norm(robot.spheres.center, axis=1) + robot.spheres.radius
    return far + max(float(spheres.max(initial=0.0)), float(np.linalg.norm(robot.tool_point)))


@functools.lru_cache(maxsize=4)
def surroundings_of(scene: Scene, robot: Robot) -> Surroundings:
    """The obstacles of a scene within the reach of a robot."""
    far = reach(robot) + FARTHER
    asked = NEAR + float(np.max(robot.spheres.radius, initial=0.0))
    static, avoid, push = (
        rows_around(scene, np.zeros(3), far, role) for role in ("static", "avoid", "pushable")
    )
    if scene.target is not None and scene.target.stem is not None:  # the arm keeps off it, too
        push = np.append(push, scene.rows("target"))
    apart = [is_special(scene, robot, rows) for rows in (static, avoid, push)]
    special: tuple[Special, ...] = ()
    if any(own.any() for own in apart):
        other = np.concatenate([avoid[apart[1]], push[apart[2]]]), int(apart[1].sum())
        special = tuple(specials(scene, robot, body_points(robot), static[apart[0]], other))
        static, avoid, push = static[~apart[0]], avoid[~apart[1]], push[~apart[2]]
    return Surroundings(
        static=packed(scene, static, reach=asked, within=far),
        dynamic=packed(scene, np.concatenate([avoid, push]), reach=asked, within=far),
        shared=len(avoid),
        special=special,
    )


def rooms(scene: Scene, robot: Robot, rows: IntArray) -> FloatArray:
    """The room (L, K) of the links with spheres from the objects in ``rows`` (K,).

    It is the distance that a link keeps from an object beyond contact [m]: the padding, or minus
    infinity where the two may touch.
    """
    links = [robot.link_names[k] for k in np.unique(robot.spheres.link)]
    out = np.zeros((len(links), len(rows)))
    for column, item in enumerate(scene.objects_at(rows)):
        out[:, column] = scene.padding_of(item)
        if scene.may_touch:
            spared = [scene.may_meet(name, item.id) for name in links]
            out[spared, column] = -np.inf
    return out


def is_special(scene: Scene, robot: Robot, rows: IntArray) -> BoolArray:
    """Which of the objects in ``rows`` (K,) have a room that is not 0."""
    if scene.touches_alike:
        return np.zeros(len(rows), dtype=np.bool_)
    return np.asarray(rooms(scene, robot, rows).any(axis=0))


def specials(
    scene: Scene, robot: Robot, body: BodyPoints, static: IntArray, dynamic: tuple[IntArray, int]
) -> Iterator[Special]:
    """The special obstacles of the optimisation, by rooms that are alike.

    ``static``: rows of special static objects. ``dynamic``: rows of special objects to avoid and
    then to push, and the number of the first.
    """
    sizes = np.diff(body.link_start)
    for name, rows, shared in (("static", static, len(static)), ("dynamic", *dynamic)):
        room = rooms(scene, robot, rows)
        for column in np.unique(room, axis=1).T:
            mine = (room == column[:, None]).all(axis=0)
            yield Special(
                name, packed(scene, rows[mine]), int(mine[:shared].sum()),
                read_only(body.radius + np.repeat(column, sizes)),
                read_only(body.link_bound + column),
            )  # fmt: skip


class RoomApart(NamedTuple):
    """All special obstacles: static ones, then those to avoid, then those to push.

    ``room`` (L, K) is minus infinity also between the last link or the tool and all that is not
    static.
    """

    obstacles: Obstacles
    room: FloatArray


@functools.lru_cache(maxsize=4)
def apart(scene: Scene, robot: Robot, far: float) -> RoomApart:
    """The special obstacles within ``far`` [m] of the base, for the search of ways."""
    found = [rows_around(scene, np.zeros(3), far, role) for role in ("static", "avoid", "pushable")]
    kept = [rows[is_special(scene, robot, rows)] for rows in found]
    rows = np.concatenate(kept)
    room = rooms(scene, robot, rows)
    links = np.unique(robot.spheres.link)
    distal = np.isin(links, robot.spheres.link[robot.spheres.distal])
    role = np.repeat(np.arange(3), [len(one) for one in kept])
    room[np.ix_(distal, role > 0)] = -np.inf
    return RoomApart(packed(scene, rows), np.ascontiguousarray(room))


@dataclass(frozen=True, eq=False)
class Value:
    """The objective at a trajectory."""

    merit: float  # the minimised sum, ``cost + scale·penalty``
    costs: dict[str, float]  # each cost by its name, without its weight
    cost: float = 0.0  # the weighted sum of the costs
    penalty: float = 0.0  # the weighted sum of the constraints, at full stiffness


class Problem:
    """Minimise Σ weight·cost + penalty_scale·Σ weight·constraint over the free waypoints.

    A constraint is a cost that is 0 where the constraint holds; a solver stiffens all constraints
    in stages. The first waypoint is fixed (the start), with ``end_fixed`` the last one too. The
    trajectory takes one unit of time, so that weights mean the same at any speed. Obstacles farther
    than ``cutoff`` [m] have no effect.
    """

    def __init__(
        self,
        robot: Robot,
        surroundings: Surroundings,
        costs: Sequence[Cost],
        constraints: Sequence[Cost],
        n_waypoints: int,
        *,
        cutoff: float,
        end_fixed: bool = False,
        evaluation: Evaluation | None = None,
    ) -> None:
        self.robot, self.surroundings, self.n_waypoints = robot, surroundings, n_waypoints
        self.costs, self.constraints = tuple(costs), tuple(constraints)
        self.cutoff = cutoff
        self.first = 1
        self.last = n_waypoints - 2 if end_fixed else n_waypoints - 1
        self.dt = 1.0 / (n_waypoints - 1)
        body = body_points(robot)
        self.evaluation = evaluation or Evaluation(robot, body, n_waypoints, self.dt)
        n = robot.n_joints
        self.matrix = np.zeros((2 * n + 1, (self.last - self.first + 1) * n))
        self.metric = _metric(n_waypoints, n, self.last)

    def evaluate(self, q: FloatArray, penalty_scale: float = 1.0) -> Value:
        """The objective at ``q`` (T, n); ``evaluation`` then has gradient and curvature."""
        e = self.evaluation
        e.move_to(q)
        self.surroundings.measure(e, self.cutoff)
        added = [(c, c.add(e, c.weight)) for c in self.costs]
        cost = sum((c.weight * value for c, value in added), 0.0)
        stiffened = [(c, c.add(e, penalty_scale * c.weight)) for c in self.constraints]
        penalty = sum((c.weight * value for c, value in stiffened), 0.0)
        values = {c.name: value for c, value in added}
        return Value(cost + penalty_scale * penalty, values, cost, penalty)

    def gradient(self) -> FloatArray:
        """Gradient (T, n) at the last evaluation; zero at the fixed waypoints."""
        gradient = self.evaluation.gradient()
        gradient[: self.first] = 0.0
        gradient[self.last + 1 :] = 0.0
        return gradient

    def curvature(self) -> FloatArray:
        """Gauss-Newton matrix of the free waypoints, in LAPACK's lower banded form ((2n+1), N)."""
        e = self.evaluation
        kernels.add_stiffness(
            self.robot.kinematics, e.body.segment[: e.tool + 2], e.points, e.stiffness,
            e.frames.origins, e.frames.axes, e.band, self.first, self.matrix,
        )  # fmt: skip
        return self.matrix


@functools.lru_cache(maxsize=32)
def _metric(n_waypoints: int, n: int, last: int) -> FloatArray:
    """The covariant metric A of waypoints 1 … ``last``, banded like :meth:`Problem.curvature`."""
    dt = 1.0 / (n_waypoints - 1)
    band = np.zeros((n_waypoints, 3, n))
    smoothness(np.zeros((n_waypoints, n)), dt, 1.0, np.zeros((n_waypoints, n)), band)
    metric = np.zeros((2 * n + 1, last * n))
    free = band[1 : last + 1]
    metric[0] = free[:, 0].ravel() + ANCHOR * dt
    metric[n, : -n or None] = free[:-1, 1].ravel()
    metric[2 * n, : -2 * n or None] = free[:-2, 2].ravel()
    return frozen(metric)
