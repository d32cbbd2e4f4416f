"""The evaluation of a trajectory: kinematics run once; then every cost adds its gradient.

:class:`Cost` is the contract of a cost.
"""

import functools
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.optimization import kernels
from optipromp.core.robots import kernels as robot_kernels
from optipromp.core.robots.model import Robot

LEVER = 0.1  # [m] from the tool point to the tip, the second point on the tool axis: a choice


class BodyPoints:
    """The points of a robot that the planning loop follows, grouped by link for the broad phase.

    Points are ordered: B body spheres (sorted by link), the tool point (index ``tool``), the tip on
    the tool axis (``tool + 1``), and the bounding-sphere centre of each link that has spheres.
    """

    def __init__(self, robot: Robot) -> None:
        spheres = robot.spheres
        order = np.argsort(spheres.link, kind="stable")
        links = np.unique(spheres.link)
        center, radius = spheres.center[order], spheres.radius[order]
        segment, link = spheres.segment[order], spheres.link[order]
        self.radius: FloatArray = frozen(radius)
        self.largest = float(np.max(radius, initial=0.0))
        self.distal: BoolArray = frozen(spheres.distal[order], np.bool_)
        self.link_start: IntArray = frozen(
            np.append(np.searchsorted(link, links), len(link)), np.int64
        )
        bound_centers, bound_radii, begins = [], [], self.link_start[:-1]
        for low, high in zip(begins, self.link_start[1:], strict=True):
            own, around = center[low:high], radius[low:high, None]
            middle = 0.5 * ((own - around).min(axis=0) + (own + around).max(axis=0))
            reach = np.linalg.norm(own - middle, axis=1) + radius[low:high]
            bound_centers.append(middle)
            bound_radii.append(reach.max())
        last = robot.n_segments - 1
        tool = np.stack([robot.tool_point, robot.tool_point + LEVER * robot.tool_axis])
        self.tool = len(radius)
        self.local: FloatArray = frozen(
            np.vstack([center, tool, np.reshape(bound_centers, (-1, 3))])
        )
        self.segment: IntArray = frozen(
            np.concatenate([segment, [last, last], segment[begins]]), np.int64
        )
        kept, apart = np.zeros(len(links)), robot.self_slack < 0.0
        paired = np.searchsorted(links, spheres.link[robot.self_pairs[apart]])
        np.maximum.at(kept, paired, -robot.self_slack[apart, None])
        self.link_bound: FloatArray = frozen(np.add(bound_radii, kept))
        self.link_distal: BoolArray = frozen(self.distal[begins], np.bool_)
        self.groups, self.pairs, by = _grouped_pairs(robot.self_pairs, order, link, links)
        self.slack: FloatArray = frozen(robot.self_slack[by])

    def __len__(self) -> int:
        return len(self.segment)


body_points = functools.lru_cache(maxsize=32)(BodyPoints)  # compares robots by identity


def _grouped_pairs(
    self_pairs: IntArray, order: IntArray, link: IntArray, links: IntArray
) -> tuple[IntArray, IntArray, IntArray]:
    """Self-collision pairs (P, 2) of the sorted spheres, grouped by their two links.

    Returns the groups (G, 4) of :func:`costs.obstacles.self_penalty`, the pairs, and the index of
    each pair (P,) in ``self_pairs``.
    """
    place = np.empty(len(order), dtype=np.int64)
    place[order] = np.arange(len(order))
    pairs = np.sort(place[self_pairs], axis=1)
    first, second = np.searchsorted(links, link)[pairs].T
    code = first * len(links) + second
    by_links = np.argsort((code * len(link) + pairs[:, 0]) * len(link) + pairs[:, 1])
    code, starts, counts = np.unique(code[by_links], return_index=True, return_counts=True)
    groups = np.column_stack([*np.divmod(code, len(links)), starts, starts + counts])
    return frozen(groups, np.int64), frozen(pairs[by_links], np.int64), by_links


class Frames(NamedTuple):
    """Where S segments are at T waypoints."""

    origins: FloatArray  # (T, S, 3) [m]
    rotations: FloatArray  # (T, S, 3, 3)
    axes: FloatArray  # (T, S, 3) of the joints


class Evaluation:
    """Arrays of an evaluation at T waypoints, made once and overwritten by each evaluation.

    Costs read ``q`` (T, n), ``dt``, ``points`` (T, P, 3) in the order of :class:`BodyPoints`,
    ``tool`` (index of the tool point), and the fields ``static`` and ``dynamic``. Costs add to
    ``force`` (T, B+2, 3), the gradient with respect to points, and to ``joint_gradient`` (T, n).
    Costs may add a curvature: to ``stiffness`` (T, B+2, 6) at points, positive semi-definite, and
    to ``band`` (T, 3, n) in the joints. Masks (B,) of the body spheres are ``every``, ``proximal``
    (B_d), and ``distal`` (the last link and the tool).
    """

    def __init__(self, robot: Robot, body: BodyPoints, n_waypoints: int, dt: float) -> None:
        n, segments, spheres = robot.n_joints, robot.n_segments, body.tool
        self.robot, self.body, self.dt = robot, body, dt
        self.q = np.zeros((n_waypoints, n))
        shapes = (segments, 3), (segments, 3, 3), (segments, 3)
        self.frames = Frames(*(np.empty((n_waypoints, *shape)) for shape in shapes))
        self.points = np.empty((n_waypoints, len(body), 3))
        self.force = np.zeros((n_waypoints, spheres + 2, 3))
        self.stiffness = np.zeros((n_waypoints, spheres + 2, 6))
        self.joint_gradient = np.zeros((n_waypoints, n))
        self.band = np.zeros((n_waypoints, 3, n))
        self.every = np.ones(spheres, dtype=np.bool_)
        self.distal = np.array(body.distal)
        self.proximal = ~self.distal
        self.static = Field(n_waypoints, spheres)
        self.dynamic = Field(n_waypoints, spheres)

    def move_to(self, q: FloatArray) -> None:
        """Run the kinematics of the trajectory ``q`` (T, n), and :meth:`clear`."""
        self.q[:] = q
        robot_kernels.frames(self.robot.kinematics, self.q, *self.frames)
        robot_kernels.carried_points(
            self.body.segment, self.body.local, *self.frames[:2], self.points
        )
        self.clear()

    def clear(self) -> None:
        """Set the arrays that costs add to back to zero."""
        self.force[:] = 0.0
        self.stiffness[:] = 0.0
        self.joint_gradient[:] = 0.0
        self.band[:] = 0.0

    @property
    def tool(self) -> int:
        """Index of the tool point among the points."""
        return self.body.tool

    @property
    def tool_points(self) -> FloatArray:
        """Tool point at every waypoint (T, 3) [m]."""
        return self.points[:, self.tool]

    def at_points(self, kernel: Callable[..., Any], scale: float, *settings: Any) -> float:
        """Value of a kernel of the points; the kernel adds ``scale`` times its gradient."""
        return float(kernel(self.points, self.tool, *settings, scale, self.force, self.stiffness))

    def in_joints(self, kernel: Callable[..., Any], scale: float, *settings: Any) -> float:
        """Value of a kernel of the joints; the kernel adds ``scale`` times its gradient."""
        return float(kernel(self.q, *settings, scale, self.joint_gradient, self.band))

    def gradient(self) -> FloatArray:
        """Sum of the costs' gradients, pulled back to the joints (T, n)."""
        out = self.joint_gradient.copy()
        robot_kernels.pull_back(
            self.robot.kinematics,
            self.body.segment[: self.tool + 2],
            self.points[:, : self.tool + 2],
            self.force,
            self.frames.origins,
            self.frames.axes,
            out,
        )
        return out


class Field:
    """Distance (T, B) and normal (T, B, 3) from the nearest obstacle of a role to a body sphere."""

    def __init__(self, n_waypoints: int, n_spheres: int) -> None:
        self.distance = np.zeros((n_waypoints, n_spheres))
        self.normal = np.zeros((n_waypoints, n_spheres, 3))

    def measure(self, e: Evaluation, obstacles: Obstacles, shared: int, cutoff: float) -> None:
        """Fill the field from the evaluation's points; see :func:`kernels.clearance_field`."""
        body = e.body
        if obstacles.cells.reach >= cutoff + body.largest:
            kernels.clearance_in_cells(
                e.points, body.radius, body.link_start, body.link_distal, obstacles, shared, cutoff,
                self.distance, self.normal,
            )  # fmt: skip
        else:
            kernels.clearance_field(
                e.points, body.radius, body.link_start, body.link_bound, body.link_distal,
                obstacles, shared, cutoff, self.distance, self.normal,
            )  # fmt: skip

    def measure_too(
        self, e: Evaluation, obstacles: Obstacles, shared: int, cutoff: float,
        sizes: tuple[FloatArray, FloatArray],
    ) -> None:  # fmt: skip
        """Take in further obstacles, for other radii (B,) and bounds (L,) of the body [m]."""
        further, body = Field(*self.distance.shape), e.body
        kernels.clearance_field(
            e.points, sizes[0], body.link_start, sizes[1], body.link_distal, obstacles, shared,
            cutoff, further.distance, further.normal,
        )  # fmt: skip
        nearer = further.distance < self.distance
        self.distance[nearer] = further.distance[nearer]
        self.normal[nearer] = further.normal[nearer]


class Cost(ABC):
    """A cost of a trajectory: a quantity to minimise, or the penalty of a constraint.

    The penalty is 0 where the constraint holds. A subclass is a dataclass, or calls
    ``super().__init__(name, weight)``.

    Attributes:
        name: the key of the reported values.
        weight: factor of the cost in the objective, for a constraint its stiffness; not negative.
    """

    name: str
    weight: float

    def __init__(self, name: str, weight: float) -> None:
        self.name, self.weight = name, weight
        self.__post_init__()

    def __post_init__(self) -> None:
        """Check the weight.

        Raises:
            InvalidRequestError: the weight is negative or not a number.
        """
        if not self.weight >= 0.0:
            raise InvalidRequestError(
                f"the weight of {self.name} is {self.weight}; it must not be negative"
            )

    @abstractmethod
    def add(self, e: Evaluation, scale: float) -> float:
        """Return the value, without weight, and add ``scale`` times its gradient to ``e``.

        The gradient is with respect to the joints or the points, whichever the cost depends on. A
        curvature may be added too; without it, the solver's metric takes its place. ``scale`` is
        the weight; for a constraint, the weight times the stage of the penalty.
        """
