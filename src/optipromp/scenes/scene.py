"""The scene as arrays: objects with roles, stems, the approach and the goal."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from optipromp.arrays import FloatArray, IntArray, frozen, joined, lengths, read_only
from optipromp.errors import InvalidSceneError
from optipromp.geometry.obstacles import Measures, Obstacles, measures, packed
from optipromp.geometry.shapes import HalfSpace, Shape, bounding_radius

Role: TypeAlias = Literal["target", "pushable", "avoid", "static"]
ROLES: tuple[Role, ...] = get_args(Role)

STEM_RADIUS = 0.003
"""Radius of a stem that says none [m]."""

_STEM_SLACK = 0.005  # a stem given by points starts at most this far outside its fruit [m]
_PARALLEL = 1e-6
_ROUNDING = 1e-9  # [m]


def suggest(name: object, valid: Iterable[str]) -> str:
    """``valid names are ...; did you mean ...?``, the second half where one comes near."""
    names = list(valid)
    near = difflib.get_close_matches(str(name), names, n=1)
    question = f"; did you mean {near[0]!r}?" if near else ""
    return f"valid are {', '.join(names)}{question}"


def _array(name: str, values: object, *shape: int | None) -> FloatArray:
    """``values`` read-only; refused where not of the ``shape`` (None: any) or not finite."""
    array = frozen(values)
    fits = [want in (None, have) for want, have in zip(shape, array.shape, strict=False)]
    if array.ndim != len(shape) or not all(fits):
        wanted = ", ".join("n" if size is None else str(size) for size in shape)
        wanted += "," if len(shape) == 1 else ""
        raise InvalidSceneError(f"{name} has shape {array.shape}: must be ({wanted})")
    if not np.isfinite(array).all():
        at = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        where = "".join(f"[{i}]" for i in at)
        raise InvalidSceneError(f"{name}{where} is {array[at]}: must be finite")
    return array


def _unit(name: str, values: object) -> FloatArray:
    vector = _array(name, values, 3)
    length = math.hypot(*vector)
    if not length > 0.0:
        raise InvalidSceneError(f"{name} is {vector.tolist()}: must have a direction")
    return frozen(vector / length)


@dataclass(frozen=True, eq=False)
class Stem:
    """The stem that a fruit hangs on.

    Args:
        points: (k, 3) world positions [m], fruit first, root last, k >= 2.
        radius: [m].
    """

    points: FloatArray
    radius: float = STEM_RADIUS

    def __post_init__(self) -> None:
        shape = np.shape(self.points)
        if len(shape) != 2 or shape[1] != 3 or shape[0] < 2:
            raise InvalidSceneError(f"stem.points has shape {shape}: must be (k, 3), k >= 2")
        points = _array("stem.points", self.points, None, 3)
        short = np.flatnonzero(np.linalg.norm(np.diff(points, axis=0), axis=1) < 1e-9)
        if short.size:
            raise InvalidSceneError(
                f"stem piece {short[0]} has no length: neighbouring points (the fruit's position "
                "is the first) must differ"
            )
        if not (math.isfinite(self.radius) and self.radius > 0.0):
            raise InvalidSceneError(f"stem.radius is {self.radius:g}: must be above 0 [m]")
        object.__setattr__(self, "points", points)

    @property
    def vector(self) -> FloatArray:
        """(3,) the stem vector S_n of the paper: from the fruit to the next point [m]."""
        return frozen(self.points[1] - self.points[0])

    @property
    def root(self) -> FloatArray:
        """(3,) where the stem is held [m]."""
        return frozen(self.points[-1])

    @property
    def length(self) -> float:
        """Length along the stem [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of the scene.

    Args:
        id: its name, unique in the scene.
        role: ``target``, ``pushable``, ``avoid`` or ``static``.
        shape: in its local frame.
        position: (3,) world position of the local origin [m].
        rotation: (3, 3) local to world.
        stem: that it hangs on, if any.
        covariance: (3, 3) covariance of the detected position [m²], if given.
        physical: further numbers by name (mass, stiffness, ...), for the simulation.
    """

    id: str
    role: Role
    shape: Shape
    position: FloatArray
    rotation: FloatArray = field(default_factory=lambda: np.eye(3))
    stem: Stem | None = None
    covariance: FloatArray | None = None
    physical: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.role not in ROLES:
            raise InvalidSceneError(f"role {self.role!r} is unknown: {suggest(self.role, ROLES)}")
        if self.role in ("target", "pushable") and isinstance(self.shape, HalfSpace):
            raise InvalidSceneError(f"a {self.role} cannot be a half_space: it has no end")
        object.__setattr__(self, "position", _array("position", self.position, 3))
        object.__setattr__(self, "rotation", _array("rotation", self.rotation, 3, 3))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", _covariance(self.covariance))
        if self.stem is not None:
            gap = float(np.linalg.norm(self.stem.points[0] - self.position))
            if gap > bounding_radius(self.shape) + _STEM_SLACK:
                raise InvalidSceneError(
                    f"stem.points[0] is {gap:.3g} m from the fruit's position: a stem must start "
                    "at its fruit"
                )
        object.__setattr__(self, "physical", dict(self.physical))

    @property
    def radius(self) -> float:
        """Radius of a ball about ``position`` that holds the shape [m]; of a sphere, its own."""
        return bounding_radius(self.shape)


def _covariance(values: FloatArray) -> FloatArray:
    covariance = _array("covariance", values, 3, 3)
    scale = float(np.abs(covariance).max())
    if np.abs(covariance - covariance.T).max() > 1e-9 * scale:
        raise InvalidSceneError("covariance is not symmetric: must equal its transpose")
    least = float(np.linalg.eigvalsh(covariance)[0])
    if least < -1e-12 * scale:
        raise InvalidSceneError(
            f"covariance has eigenvalue {least:.3g}: must be positive semi-definite"
        )
    return covariance


@dataclass(frozen=True, eq=False)
class Approach:
    """The direction from which the tool comes to the target.

    Args:
        direction: (3,) z_g, along which the tool approaches; any length above 0.
        lateral: (3,) y_g, along which the tool drifts; made orthogonal to ``direction``.
        camera_distance: from the camera point to the lowest fruit, along z_g [m].
    """

    direction: FloatArray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    lateral: FloatArray = field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))
    camera_distance: float = 0.10

    def __post_init__(self) -> None:
        z = _unit("approach.direction", self.direction)
        y = _unit("approach.lateral", self.lateral)
        if np.linalg.norm(np.cross(y, z)) < _PARALLEL:
            raise InvalidSceneError(
                f"approach.lateral {y.tolist()} is parallel to direction {z.tolist()}: "
                "must point across it"
            )
        if not (math.isfinite(self.camera_distance) and self.camera_distance > 0.0):
            raise InvalidSceneError(
                f"approach.camera_distance is {self.camera_distance:g}: must be above 0 [m]"
            )
        object.__setattr__(self, "direction", z)
        object.__setattr__(self, "lateral", y)

    @cached_property
    def frame(self) -> FloatArray:
        """(3, 3) rows x_g, y_g, z_g with x_g = y_g × z_g: maps world vectors into F_g."""
        z = self.direction
        x = np.cross(self.lateral, z)
        x /= np.linalg.norm(x)
        return frozen([x, np.cross(z, x), z])


@dataclass(frozen=True, eq=False)
class JointGoal:
    """A goal in joint space: ``joints`` (n,) [rad or m]."""

    joints: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", _array("goal.joints", self.joints, None))


@dataclass(frozen=True, eq=False)
class PoseGoal:
    """A goal for the tool: ``position`` (3,) [m] of its point, ``axis`` (3,) unit, of its axis."""

    position: FloatArray
    axis: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", _array("goal.position", self.position, 3))
        object.__setattr__(self, "axis", _unit("goal.axis", self.axis))


@dataclass(frozen=True)
class ToolSpec:
    """The tool a scene asks for: ``kind`` and those ``parameters`` of its class that it states.

    Kinds are those of :data:`optipromp.robots.tools.TOOLS`; lengths are metres.
    """

    kind: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        hashable = {k: tuple(v) if isinstance(v, list) else v for k, v in self.parameters.items()}
        object.__setattr__(self, "parameters", hashable)


@dataclass(frozen=True, eq=False)
class Scene:
    """A scene: robot, objects, and a target or goal.

    Args:
        name: of the scene.
        robot: built-in name, or path (relative to ``base_dir``) of a URDF or robot file.
        objects: see :class:`SceneObject`; exactly one ``target``, or none and a ``goal``.
        tool: None: the robot's own.
        start: (n,) configuration; None: the robot's home.
        approach: the target frame.
        goal: in place of a target.
        options: further settings of the planners.
        base_dir: folder that relative paths start from.

    Raises:
        InvalidSceneError: duplicate ids, no target, two targets, target and goal together.
    """

    name: str
    robot: str
    objects: tuple[SceneObject, ...]
    tool: ToolSpec | None = None
    start: FloatArray | None = None
    approach: Approach = field(default_factory=Approach)
    goal: JointGoal | PoseGoal | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    base_dir: Path | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "objects", tuple(self.objects))
        object.__setattr__(self, "options", dict(self.options))
        if self.start is not None:
            object.__setattr__(self, "start", _array("start", self.start, None))
        seen: dict[str, int] = {}
        for index, item in enumerate(self.objects):
            if item.id in seen:
                raise InvalidSceneError(
                    f"objects[{index}].id {item.id!r} is taken by objects[{seen[item.id]}]: "
                    "ids must be unique, and an object has one role"
                )
            seen[item.id] = index
        targets = [item.id for item in self.objects if item.role == "target"]
        if len(targets) > 1:
            raise InvalidSceneError(f"two targets, {targets[0]!r} and {targets[1]!r}: must be one")
        if targets and self.goal is not None:
            raise InvalidSceneError(f"target {targets[0]!r} and a goal: must be one or the other")
        if not targets and self.goal is None:
            raise InvalidSceneError(
                "no target: one object must have role 'target' (or the scene a 'goal')"
            )

    @cached_property
    def _rows(self) -> Mapping[str, IntArray]:
        codes = {role: code for code, role in enumerate(ROLES)}
        role = np.array([codes[item.role] for item in self.objects], dtype=np.int64)
        return {name: read_only(np.flatnonzero(role == code)) for name, code in codes.items()}

    @cached_property
    def _by_role(self) -> Mapping[str, tuple[SceneObject, ...]]:
        return {role: self.objects_at(rows) for role, rows in self._rows.items()}

    @property
    def target(self) -> SceneObject | None:
        """The object to reach; None where the scene has a goal instead."""
        return next(iter(self._by_role["target"]), None)

    @property
    def pushables(self) -> tuple[SceneObject, ...]:
        """The objects that may be pushed, in file order."""
        return self._by_role["pushable"]

    @property
    def avoid(self) -> tuple[SceneObject, ...]:
        """The neighbours that only the last link and the tool may brush, in file order."""
        return self._by_role["avoid"]

    @property
    def static(self) -> tuple[SceneObject, ...]:
        """The objects that nothing may touch, in file order."""
        return self._by_role["static"]

    @cached_property
    def positions(self) -> FloatArray:
        """Positions (N, 3) of the objects [m]."""
        return joined([item.position for item in self.objects]).reshape(-1, 3)

    @cached_property
    def rotations(self) -> FloatArray:
        """Rotations (N, 3, 3) of the objects, local to world."""
        return joined([item.rotation for item in self.objects]).reshape(-1, 3, 3)

    @cached_property
    def _measures(self) -> Measures:
        kind, size, bound = measures([item.shape for item in self.objects])
        return read_only(kind), read_only(size), read_only(bound)

    @property
    def bounds(self) -> FloatArray:
        """Radii (N,) of balls about the positions that contain the shapes [m]."""
        return self._measures[2]

    def rows(self, role: Role) -> IntArray:
        """Indices (K,) of the ``objects`` of a role, in ascending order."""
        return self._rows[role]

    def around(self, center: FloatArray, reach: float, role: Role) -> IntArray:
        """Indices (K,) of the ``objects`` of a role that may be within ``reach`` [m] of a point.

        By bounding balls: some objects may be farther away, none is missed.
        """
        rows = self._rows[role]
        if not len(rows):
            return rows
        off = self.positions[rows] - center
        return np.asarray(rows[lengths(off) - self.bounds[rows] <= reach + _ROUNDING])

    def objects_at(self, rows: IntArray) -> tuple[SceneObject, ...]:
        """The ``objects`` at indices (K,)."""
        objects = self.objects
        return tuple([objects[k] for k in rows.tolist()])

    @property
    def frame(self) -> FloatArray:
        """(3, 3) rows x_g, y_g, z_g of the target frame F_g."""
        return self.approach.frame

    def obstacles(self, *roles: Role) -> Obstacles:
        """Objects of the given roles (all objects where none is given), packed for the kernels.

        Order: that of ``objects``, whatever the order of ``roles``.
        """
        wanted = roles or ROLES
        for role in wanted:
            if role not in ROLES:
                raise InvalidSceneError(f"role {role!r} is unknown: {suggest(role, ROLES)}")
        return self.packed(np.sort(np.concatenate([self._rows[role] for role in wanted])))

    def packed(self, rows: IntArray, *, reach: float = 0.0, within: float = 0.0) -> Obstacles:
        """The ``objects`` at indices (K,), packed for the kernels in that order.

        ``reach`` and ``within``: see :func:`optipromp.geometry.obstacles.pack`.
        """
        kind, size, bound = self._measures
        shapes = [obj.shape for obj in self.objects_at(rows)]
        return packed(
            shapes, self.positions[rows], self.rotations[rows],
            (kind[rows], size[rows], bound[rows]), reach=reach, within=within,
        )  # fmt: skip
