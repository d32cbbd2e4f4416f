"""The robot as arrays: kinematics, limits, body spheres, tool."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, all_finite
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots import kernels
from optipromp.core.robots.description import NOT_TOLD, Arm, LeftOut, LinkGeometry
from optipromp.core.robots.dynamics import Dynamics
from optipromp.core.robots.kernels import Kinematics
from optipromp.core.robots.mounted import loads_of
from optipromp.core.shown import Shown

if TYPE_CHECKING:
    from optipromp.core.robots.tool_protocol import Tool

__all__ = ["BodySpheres", "Kinematics", "Robot"]


class BodySpheres(NamedTuple):
    """Spheres that cover every link and the tool: the paper's body points, with radii."""

    segment: IntArray  # (B,) segment that carries the sphere, -1 for the fixed base
    center: FloatArray  # (B, 3) [m] in that segment's moving frame, the world frame for -1
    radius: FloatArray  # (B,) [m]
    link: IntArray  # (B,) index into Robot.link_names
    distal: BoolArray  # (B,) last link or tool: in B_s but not in B_d


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Shown):
    """A serial robot with n independent joints and S moving segments. SI units, radians.

    Limits are (n,) arrays; ``velocity``, ``acceleration`` and ``jerk`` may be infinite where the
    description gives none, and a continuous joint has infinite position limits. The tool point and
    axis stand in the moving frame of the last segment; the axis points out of the tool's mouth.
    """

    name: str
    joint_names: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    kinematics: Kinematics
    spheres: BodySpheres
    link_names: tuple[str, ...]
    self_pairs: IntArray  # (P, 2) sphere indices of links that are not neighbours
    self_slack: FloatArray  # (P,) [m] that a pair may overlap, as its links are still apart;
    # negative: distance that it must keep, as a sphere leaves some of its link outside
    flange_rotation: FloatArray  # (3, 3) in the last segment's frame
    flange_translation: FloatArray  # (3,)
    tool_point: FloatArray  # (3,)
    tool_axis: FloatArray  # (3,) unit
    gripper_radius: float
    home: FloatArray
    tool: "Tool | None" = None
    held_joints: tuple[str, ...] = ()
    excess: Mapping[str, float] = field(default_factory=dict)  # [m] of fitted covers, by link
    left_out: tuple[LeftOut, ...] = ()
    geometry: tuple[LinkGeometry, ...] = ()  # of links that have one
    dynamics: Dynamics | None = None
    arm: Arm = NOT_TOLD

    def _words(self) -> str:
        tool = "no tool" if self.tool is None else type(self.tool).__name__
        return f"{self.name}: {self.n_joints} joints, {tool}, {len(self.spheres.radius)} spheres"

    @property
    def n_joints(self) -> int:
        """Number of independent joints."""
        return len(self.joint_names)

    def limits(self, margin: float) -> tuple[FloatArray, FloatArray]:
        """Limits (n,) drawn in by ``margin`` [rad or m], or by a quarter of a narrow range."""
        inner = np.minimum(margin, 0.25 * (self.upper - self.lower))
        return self.lower + inner, self.upper - inner

    @property
    def n_own_links(self) -> int:
        """Number of links without the tool and what it holds, which come last."""
        own = len(self.link_names) if self.tool is None else len(self.link_names) - 1
        return own - len(loads_of(self.tool))

    @property
    def n_segments(self) -> int:
        """Number of moving segments (more than joints where joints mimic one another)."""
        return int(self.kinematics.kind.shape[0])

    @property
    def tool_rotation(self) -> FloatArray:
        """(3, 3) the tool's frame in that of the last segment: z the tool axis, y the opening."""
        turn = self.flange_rotation
        return turn if self.tool is None else np.asarray(turn @ self.tool.rotation)

    def check_configuration(self, q: FloatArray) -> FloatArray:
        """Return a copy of ``q`` as a float array (..., n).

        Raises:
            InvalidRequestError: wrong joint count, or a value that is not finite (with its index).
        """
        array = np.array(q, dtype=np.float64, order="C")  # always writable: one array type
        if array.ndim == 0 or array.shape[-1] != self.n_joints:
            got = array.shape[-1] if array.ndim else 1
            raise InvalidRequestError(
                f"{self.name} has {self.n_joints} joints ({', '.join(self.joint_names)}), "
                f"but {got} values were given"
            )
        if not all_finite(array):
            bad = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise InvalidRequestError(
                f"joint value at index {bad} is {array[bad]}; it must be finite"
            )
        return array

    def segment_frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """World frames of the moving segments: origins (..., S, 3) and rotations (..., S, 3, 3)."""
        origins, rotations, _ = self._frames(q)
        return origins, rotations

    def tool_pose(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Tool point (..., 3) [m] and tool axis (..., 3) at ``q`` (..., n)."""
        array = self.check_configuration(q)
        flat = array.reshape(-1, self.n_joints)
        points, directions = np.empty((len(flat), 3)), np.empty((len(flat), 3))
        kernels.tool_poses(
            self.kinematics, flat, self.tool_point, self.tool_axis, points, directions
        )
        shape = (*array.shape[:-1], 3)
        return points.reshape(shape), directions.reshape(shape)

    def tool_jacobian(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Jacobians (..., 3, n) of the tool point and of the tool axis at ``q`` (..., n)."""
        _, _, jp, ja = self.tool_map(q)
        return jp, ja

    def tool_map(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Tool point and axis (..., 3) and their Jacobians (..., 3, n): a ``task_map``."""
        array = self.check_configuration(q)
        flat = array.reshape(-1, self.n_joints)
        m, n = flat.shape
        points, directions = np.empty((m, 3)), np.empty((m, 3))
        jp, ja = np.empty((m, 3, n)), np.empty((m, 3, n))
        kernels.tool_jacobians(
            self.kinematics, flat, self.tool_point, self.tool_axis, points, directions, jp, ja
        )
        lead = array.shape[:-1]
        return (
            points.reshape(*lead, 3),
            directions.reshape(*lead, 3),
            jp.reshape(*lead, 3, n),
            ja.reshape(*lead, 3, n),
        )

    def sphere_centers(self, q: FloatArray) -> FloatArray:
        """World centres (..., B, 3) [m] of the body spheres at ``q`` (..., n)."""
        array = self.check_configuration(q)
        origins, rotations, _ = self._frames(array)
        n_segments, n_spheres = self.n_segments, len(self.spheres.radius)
        out = np.empty((array.size // self.n_joints, n_spheres, 3))
        kernels.carried_points(
            self.spheres.segment,
            self.spheres.center,
            origins.reshape(-1, n_segments, 3),
            rotations.reshape(-1, n_segments, 3, 3),
            out,
        )
        return out.reshape(*array.shape[:-1], n_spheres, 3)

    def self_gaps(self, q: FloatArray) -> FloatArray:
        """The gap (..., P) [m] of each of ``self_pairs`` at ``q`` (..., n), with its slack."""
        centers, radius = self.sphere_centers(q), self.spheres.radius
        flat, (i, j) = centers.reshape(-1, len(radius), 3), np.ascontiguousarray(self.self_pairs.T)
        apart = np.empty((len(flat), len(i)))
        kernels.distances_between(flat, flat, i, j, apart)
        apart += self.self_slack - radius[i] - radius[j]
        return apart.reshape(*centers.shape[:-2], len(i))

    def _frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        array = self.check_configuration(q)
        flat = array.reshape(-1, self.n_joints)
        m, s = len(flat), self.n_segments
        origins, rotations, axes = np.empty((m, s, 3)), np.empty((m, s, 3, 3)), np.empty((m, s, 3))
        kernels.frames(self.kinematics, flat, origins, rotations, axes)
        lead = array.shape[:-1]
        return (
            origins.reshape(*lead, s, 3),
            rotations.reshape(*lead, s, 3, 3),
            axes.reshape(*lead, s, 3),
        )
