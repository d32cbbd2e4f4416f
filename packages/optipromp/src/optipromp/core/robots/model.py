"""The robot as arrays: kinematics, limits, body spheres and their pairs, tool, masses, gravity."""

import warnings
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, all_finite, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.parameters import GRAVITY
from optipromp.core.robots import kernels
from optipromp.core.robots.description import NOT_TOLD, Arm, LeftOut, LinkGeometry
from optipromp.core.robots.kernels import PRISMATIC, Kinematics, distances_between
from optipromp.core.robots.mounted import weight_of
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.robots.turns import Turns
from optipromp.core.shown import Shown

__all__ = ["BodySpheres", "Kinematics", "Robot"]


class BodySpheres(NamedTuple):
    """Spheres that cover every link and the tool: the paper's body points, with radii."""

    segment: IntArray  # (B,) segment that carries the sphere, -1 for the fixed base
    center: FloatArray  # (B, 3) [m] in that segment's moving frame, the world frame for -1
    radius: FloatArray  # (B,) [m]
    link: IntArray  # (B,) index into Robot.link_names
    distal: BoolArray  # (B,) last link or tool: in B_s but not in B_d


class Dynamics(NamedTuple):
    """Effort limit and inertia of each of the S moving segments with the links it carries.

    ``mass`` is 0 if the file states none, ``inertia`` is 0 if it states no tensor.
    """

    effort: FloatArray  # (S,) limit of the joint's torque or force [N m or N], may be infinite
    mass: FloatArray  # (S,) [kg]
    center: FloatArray  # (S, 3) of mass [m], in the segment's frame
    inertia: FloatArray  # (S, 3, 3) about the centre of mass [kg m²], in the segment's axes


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
    self_slack: FloatArray  # (P,) [m] that a pair may overlap; negative: that it must keep apart
    flange_rotation: FloatArray  # (3, 3) in the last segment's frame
    flange_translation: FloatArray  # (3,)
    tool_point: FloatArray  # (3,)
    tool_axis: FloatArray  # (3,) unit
    gripper_radius: float
    home: FloatArray
    tool: Tool | None = None
    tool_links: int = 0  # of the tool and what it holds, the last of link_names
    held_joints: tuple[str, ...] = ()
    excess: Mapping[str, float] = field(default_factory=dict)  # [m] of fitted covers, by link
    left_out: tuple[LeftOut, ...] = ()
    geometry: tuple[LinkGeometry, ...] = ()  # of the links of its file
    dynamics: Dynamics | None = None
    arm: Arm = NOT_TOLD
    told: tuple[str, ...] = ()  # warnings of its description, each after the path

    def _words(self) -> str:
        tool = "no tool" if self.tool is None else type(self.tool).__name__
        return f"{self.name}: {self.n_joints} joints, {tool}, {len(self.spheres.radius)} spheres"

    @property
    def n_joints(self) -> int:
        """Number of independent joints."""
        return len(self.joint_names)

    @cached_property
    def turns(self) -> Turns:
        """Of which joints a whole turn changes nothing."""
        return Turns.of(self.kinematics, self.lower, self.upper)

    def apart(self, q: FloatArray, other: FloatArray) -> FloatArray:
        """How far ``q`` (..., n) is from ``other`` (..., n), without whole turns [rad or m]."""
        return self.turns.apart(q, other)

    def limits(self, margin: float) -> tuple[FloatArray, FloatArray]:
        """Limits (n,) drawn in by ``margin`` [rad or m], or by a quarter of a narrow range."""
        inner = np.minimum(margin, 0.25 * (self.upper - self.lower))
        return self.lower + inner, self.upper - inner

    @property
    def n_own_links(self) -> int:
        """Number of links without the tool and what it holds, which come last."""
        return len(self.link_names) - self.tool_links

    @property
    def n_segments(self) -> int:
        """Number of moving segments (more than joints where joints mimic one another)."""
        return int(self.kinematics.kind.shape[0])

    @cached_property
    def tool_rotation(self) -> FloatArray:
        """(3, 3) the tool's frame in that of the last segment: z the tool axis, y the opening."""
        turn = self.flange_rotation
        return turn if self.tool is None else frozen(turn @ self.tool.rotation)

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
        tool = self.tool_point, self.tool_axis
        points, directions = self._at(q, kernels.tool_poses, tool, (3,), (3,))
        return points, directions

    def tool_jacobian(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Jacobians (..., 3, n) of the tool point and of the tool axis at ``q`` (..., n)."""
        _, _, jp, ja = self.tool_map(q)
        return jp, ja

    def tool_map(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Tool point and axis (..., 3) and their Jacobians (..., 3, n): a ``task_map``."""
        tool, slopes = (self.tool_point, self.tool_axis), (3, self.n_joints)
        points, directions, jp, ja = self._at(
            q, kernels.tool_jacobians, tool, (3,), (3,), slopes, slopes
        )
        return points, directions, jp, ja

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
        return _gaps(self, q, self.self_pairs) + self.self_slack

    def _frames(self, q: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        s = self.n_segments
        origins, rotations, axes = self._at(q, kernels.frames, (), (s, 3), (s, 3, 3), (s, 3))
        return origins, rotations, axes

    def _at(
        self, q: FloatArray, kernel: Callable[..., None], settings: tuple[FloatArray, ...],
        *shapes: tuple[int, ...],
    ) -> list[FloatArray]:  # fmt: skip
        """What a kernel writes at ``q`` (..., n): arrays (..., *shape) for each of ``shapes``."""
        array = self.check_configuration(q)
        flat = array.reshape(-1, self.n_joints)
        out = [np.empty((len(flat), *shape)) for shape in shapes]
        kernel(self.kinematics, flat, *settings, *out)
        lead = array.shape[:-1]
        return [each.reshape(*lead, *shape) for each, shape in zip(out, shapes, strict=True)]


def gravity_load(robot: Robot, q: FloatArray, up: FloatArray) -> FloatArray:
    """Torque or force (m, S) [N m or N] that holds each segment at ``q`` (m, n) against gravity.

    ``up``: (3,) the upward vertical in the base frame. The tool has no weight; what it holds has
    (:func:`optipromp.core.robots.mounted.weight_of`). Zero for a robot without masses.
    """
    origins, rotations = robot.segment_frames(q)
    if robot.dynamics is None:
        return np.zeros(origins.shape[:2])
    kin, mass = robot.kinematics, robot.dynamics.mass
    center = robot.dynamics.center
    held, at = weight_of(robot.tool)
    if held:
        mass, center = np.array(mass), np.array(center)
        place = robot.flange_translation + robot.flange_rotation @ at
        center[-1] = (mass[-1] * center[-1] + held * place) / (mass[-1] + held)
        mass[-1] += held
    middles = origins + np.einsum("msij,sj->msi", rotations, center)
    axes = np.einsum("msij,sj->msi", rotations, kin.axis)
    beyond = np.cumsum(mass[::-1])[::-1]  # of each segment and all after it
    moments = np.cumsum((mass[:, None] * middles)[:, ::-1], axis=1)[:, ::-1]
    arms = moments - beyond[:, None] * origins
    turning = GRAVITY * np.einsum("msi,msi->ms", axes, np.cross(arms, up))
    sliding = GRAVITY * beyond * (axes @ up)
    return np.asarray(np.where(kin.kind == PRISMATIC, sliding, turning))


def warn_of_gravity(robot: Robot, q: FloatArray, up: FloatArray, where: str) -> None:
    """Warn, once for all joints, if gravity asks for more than a joint's effort limit.

    ``q`` (m, n): configurations; ``where``: describes them in the message.
    """
    if robot.dynamics is None:
        return
    load, effort = np.abs(gravity_load(robot, q, up)).max(axis=0), robot.dynamics.effort
    told = []
    for s in np.flatnonzero(load > effort):
        unit = "N" if robot.kinematics.kind[s] == PRISMATIC else "N m"
        joint = robot.joint_names[int(robot.kinematics.dof[s])]
        told.append(f"{joint} needs {load[s]:.3g} {unit} (at most {effort[s]:.3g})")
    if told:
        warnings.warn(
            f"{robot.name} cannot hold itself {where}: gravity asks for more than the effort "
            f"limits of its file: {', '.join(told)}; in the simulation the arm falls",
            stacklevel=2,
        )


SAMPLED_POSTURES = 200  # configurations, chosen: links that overlap at all of them always do


def random_postures(robot: Robot, count: int) -> FloatArray:
    """Random configurations (count, n) within the limits; continuous joints turn once."""
    rng = np.random.default_rng(0)
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.asarray(rng.uniform(low, high, size=(count, robot.n_joints)))


def candidate_pairs(robot: Robot, allowed: Collection[tuple[str, str]] = ()) -> IntArray:
    """Sphere index pairs (P, 2) of links two or more joints apart and not ``allowed`` to touch."""
    segment, link = robot.spheres.segment, robot.spheres.link
    index = {name: i for i, name in enumerate(robot.link_names)}
    names = len(index)
    codes = {min(index[a], index[b]) * names + max(index[a], index[b]) for a, b in allowed}
    first, second = np.nonzero(np.triu(np.abs(segment[:, None] - segment) >= 2, 1))
    code = np.minimum(link[first], link[second]) * names + np.maximum(link[first], link[second])
    free = ~np.isin(code, list(codes))
    return np.column_stack([first[free], second[free]])


def letting_touch(robot: Robot, pairs: Iterable[tuple[str, str]]) -> Robot:
    """``robot`` without the pairs of spheres of links that may touch, by their names."""
    link, index = robot.spheres.link, {name: i for i, name in enumerate(robot.link_names)}
    both = np.sort(link[robot.self_pairs], axis=1)
    free = np.ones(len(both), dtype=np.bool_)
    for one, other in pairs:
        if one in index and other in index:
            low, high = sorted((index[one], index[other]))
            free &= (both[:, 0] != low) | (both[:, 1] != high)
    if free.all():
        return robot
    pairs, slack = frozen(robot.self_pairs[free], np.int64), frozen(robot.self_slack[free])
    return replace(robot, self_pairs=pairs, self_slack=slack)


def drop_always_touching(robot: Robot, pairs: IntArray) -> IntArray:
    """``pairs`` (P, 2) without those of links that overlap at every sampled configuration."""
    if not len(pairs):
        return pairs
    link = robot.spheres.link
    code = link[pairs[:, 0]] * len(robot.link_names) + link[pairs[:, 1]]
    kept = np.arange(len(pairs))  # pairs of links that have touched in every sample so far
    for q in random_postures(robot, SAMPLED_POSTURES):
        touched = np.zeros(len(robot.link_names) ** 2, dtype=bool)
        touched[code[kept][_gaps(robot, q, pairs[kept]) < 0.0]] = True
        kept = kept[touched[code[kept]]]
        if not len(kept):
            return pairs
    return np.asarray(pairs[~touched[code]])


def _gaps(robot: Robot, q: FloatArray, pairs: IntArray) -> FloatArray:
    """Surface distance (..., P) [m] of each pair at ``q`` (..., n)."""
    centers, radius = robot.sphere_centers(q), robot.spheres.radius
    flat, (i, j) = centers.reshape(-1, len(radius), 3), np.ascontiguousarray(pairs.T)
    apart = np.empty((len(flat), len(i)))
    distances_between(flat, flat, i, j, apart)
    apart -= radius[i] + radius[j]
    return apart.reshape(*centers.shape[:-2], len(i))
