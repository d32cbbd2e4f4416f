"""The scene as arrays: objects with roles, stems, the approach and the goal."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Gt, Le, Unit
from pydantic import BeforeValidator

from optipromp.core.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    cross,
    frame_along,
    frozen,
    joined,
    lengths,
    read_only,
)
from optipromp.core.errors import InvalidSceneError, suggest
from optipromp.core.geometry.obstacles import Measures, Obstacles, measures, packed_shapes
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.robots.library import NOTHING, Choice, load_arm
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.crops import Crop
from optipromp.core.scenes.goals import (
    Goal,
    JointGoal,
    Lines,
    PathConstraints,
    PoseGoal,
    RegionGoal,
    check_lines,
)
from optipromp.core.scenes.held import Attached, Pair, Place, check_held
from optipromp.core.scenes.objects import (
    ROLES,
    STEM_RADIUS,
    ObjectMotion,
    Role,
    SceneObject,
    Stem,
    check_trusses,
    parents_first,
)
from optipromp.core.scenes.pose import Array, Direction, Framed, Padding, Pose, Span
from optipromp.core.scenes.rotations import IDENTITY, from_quaternion
from optipromp.core.shown import Shown
from optipromp.core.values import Name

__all__ = [
    "ROLES", "STEM_RADIUS", "Approach", "Attached", "Goal", "JointGoal", "Pose", "PoseGoal",
    "RegionGoal", "Role", "Scene", "SceneObject", "Stem", "ToolSpec",
]  # fmt: skip

WIDEST_CONE = 60.0  # largest angle between an approach and its direction [degrees], chosen

MOST_GOALS = 1000
"""Most entries of a goal, chosen: the judge holds each end against all, 10 µs each."""

COLUMNS = "role", "shape", "position", "orientation", "stem", "motion", "padding"

_PARALLEL = 1e-6  # chosen: sine of the angle below which two vectors count as parallel
_ROUNDING = 1e-9  # [m] allowance for rounding
_FARTHEST_CAMERA = 20.0  # [m] chosen


@dataclass(frozen=True, eq=False)
class Approach(Framed, label="approach."):
    """The direction from which the tool comes to the target.

    Args:
        direction: (3,) z_g, along which the tool approaches, in the base frame; of any length
            above 0.
        lateral: (3,) y_g, along which the tool drifts; made orthogonal to ``direction``.
        camera_distance: from the camera point to the lowest fruit, along z_g [m].
        cone: largest angle [degrees] between ``direction`` and the axis of the approach, which the
            planner may change if the straight approach harms; None: the planner's default; 0: the
            axis does not change.
        aside: largest distance [m] of the tool point's end from the target's centre, if the
            straight approach harms; None: the planner's default.
        shift: (3,) from the target's centre to the end of the tool point [m]; the planner's choice
            in the scene of a plan.
        lead: (3,) tool axis at the begin of the path; it turns to ``direction`` on the way. The
            planner's choice in the scene of a plan; None: ``direction``.
        truss: whether a scissor cuts the target's stem above all stems that grow from it, and takes
            all of these fruits with the target.
    """

    direction: Direction = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    lateral: Direction = field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))
    camera_distance: Annotated[float, Gt(0.0), Le(_FARTHEST_CAMERA), Unit("m")] = 0.10
    cone: Annotated[float | None, Ge(0.0), Le(WIDEST_CONE), Unit("degrees")] = None
    aside: Annotated[float | None, Ge(0.0), Unit("m")] = None
    shift: Span = field(default_factory=lambda: np.zeros(3))
    lead: Direction | None = None
    truss: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        z, y, lead = self.direction, self.lateral, self.lead
        if np.linalg.norm(cross(y, z)) < _PARALLEL:
            raise InvalidSceneError(
                f"approach.lateral {y.tolist()} is parallel to direction {z.tolist()}: "
                "must point across it"
            )
        if lead is not None and lead @ z < math.cos(math.radians(WIDEST_CONE)) - 1e-9:
            raise InvalidSceneError(
                f"approach.lead {lead.tolist()} is more than {WIDEST_CONE:g} degrees off the "
                f"direction {z.tolist()}: must be less"
            )

    @cached_property
    def frame(self) -> FloatArray:
        """(3, 3) rows x_g, y_g, z_g with x_g = y_g × z_g: maps vectors to the target frame F_g."""
        z = self.direction
        x = cross(self.lateral, z)
        x /= np.linalg.norm(x)
        return frozen([x, cross(z, x), z])


@dataclass(frozen=True)
class ToolSpec:
    """The tool a scene asks for: ``kind`` and those ``parameters`` of its class that it states.

    Kinds are those of :data:`optipromp.core.robots.tools.TOOLS`; lengths are metres.
    """

    kind: str
    parameters: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        hashable = {k: tuple(v) if isinstance(v, list) else v for k, v in self.parameters.items()}
        object.__setattr__(self, "parameters", hashable)


def _as_text(path: Any) -> Any:
    return str(path) if isinstance(path, Path) else path


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Shown, Framed):
    """A scene: robot, objects, and a target or goal, in the frame of the robot's base.

    Args:
        name: of the scene.
        robot: built-in name, or path (relative to ``base_dir``) of a URDF or robot file.
        objects: see :class:`SceneObject`; exactly one ``target``, or none and a ``goal``.
        tool: None: the robot's own.
        start: (n,) configuration; None: the robot's home.
        approach: the target frame.
        goal: in place of a target; of several goals, in a tuple, one is to be reached.
        path: what the tool keeps on its whole way to the goal; None: nothing.
        waypoints: poses through which the tool goes to the goal, along straight lines; None: none.
        options: further settings of the planners.
        base_dir: folder where relative paths start.
        base: pose of the robot's base in the world. Only the direction of up depends on it.
        choice: of the arm in the robot's file; its paths are relative to ``base_dir``.
        camera: pose of the camera in the robot's base frame, if there is one; for information only.
        attached: shapes that move with the tool.
        may_touch: pairs of a link, an attached shape or ``tool``, and an object or another of
            these; neither the planner nor the judge minds their contact.
        place: where the tool is to bring the target after the pick.
        padding: distance that the robot keeps from static objects [m]; an object may state another.
        crop: of the fruits: what they are made of and what they bear, in the simulation; None: the
            simulation's own parameters and thresholds.
        metres: whether the file states its unit of length: then distances are meant as they are.
        unseen: cloud where no picture shows what is there, of cells as wide as twice its radius; no
            obstacle, but a pick that sweeps it is less sure (:attr:`Plan.failure`); None: not told.

    Raises:
        InvalidSceneError: ids repeat; there is no target, two targets, or a target and a goal; a
            padding is negative; or the root of a stem is not on its parent's stem.
    """

    name: Name
    robot: Annotated[str, BeforeValidator(_as_text)]
    objects: tuple[SceneObject, ...]
    tool: ToolSpec | None = None
    start: Annotated[FloatArray, Array(None)] | None = None
    approach: Approach = field(default_factory=Approach)
    goal: Goal | tuple[Goal, ...] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)
    base_dir: Path | None = None
    base: Pose = field(default_factory=Pose)
    camera: Pose | None = None
    choice: Choice = NOTHING
    path: PathConstraints | None = None
    waypoints: Lines | None = None
    attached: tuple[Attached, ...] = ()
    may_touch: tuple[Pair, ...] = ()
    padding: Padding = 0.0
    place: Place | None = None
    crop: Crop | None = None
    metres: bool = False
    unseen: SceneObject | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_held(self.attached, self.may_touch, [item.id for item in self.objects])
        if isinstance(self.goal, tuple) and not 0 < len(self.goal) <= MOST_GOALS:
            raise InvalidSceneError(
                f"goal has {len(self.goal)} entries: must have 1 to {MOST_GOALS}"
            )
        seen: dict[str, int] = {}
        for index, item in enumerate(self.objects):
            if item.id in seen:
                raise InvalidSceneError(
                    f"objects[{index}].id {item.id!r} is taken by objects[{seen[item.id]}]: "
                    "ids must be unique, and an object has one role"
                )
            seen[item.id] = index
        if self.unseen is not None and not isinstance(self.unseen.shape, PointCloudShape):
            raise InvalidSceneError("unseen is no point_cloud: must be one, of cells' middles")
        check_trusses(self.objects)
        targets = [item.id for item in self.objects if item.role == "target"]
        if len(targets) > 1:
            raise InvalidSceneError(f"two targets, {targets[0]!r} and {targets[1]!r}: must be one")
        if self.place is not None and not targets:
            raise InvalidSceneError("place and no target: must have a target, which is placed")
        if targets and self.goal is not None:
            raise InvalidSceneError(f"target {targets[0]!r} and a goal: must be one or the other")
        if targets and self.path is not None:
            raise InvalidSceneError(f"target {targets[0]!r} and a path: path goes with a goal")
        if not targets and self.goal is None:
            raise InvalidSceneError(
                "no target: one object must have role 'target' (or the scene a 'goal')"
            )
        if self.waypoints is not None:
            check_lines(self.waypoints, self.goals)

    def _words(self) -> str:
        counts = {role: len(rows) for role, rows in self._rows.items() if len(rows)}
        objects = ", ".join(f"{count} {role}" for role, count in counts.items())
        return f"{self.name}: {self.robot}; {objects or 'no objects'}"

    @cached_property
    def columns(self) -> Mapping[str, list[Any]]:
        """Of each of :data:`COLUMNS`, the values of all objects."""
        return {name: [*map(attrgetter(name), self.objects)] for name in COLUMNS}

    @cached_property
    def _rows(self) -> Mapping[str, IntArray]:
        codes = {role: code for code, role in enumerate(ROLES)}
        role = np.array([codes[role] for role in self.columns["role"]], dtype=np.int64)
        return {name: read_only(np.flatnonzero(role == code)) for name, code in codes.items()}

    @cached_property
    def target(self) -> SceneObject | None:
        """The object to reach; None if the scene has a goal instead."""
        return next(iter(self.objects_at(self._rows["target"])), None)

    @property
    def taken(self) -> tuple[SceneObject, ...]:
        """What a pick takes: the target; of a truss, then all fruits that hang on its stem."""
        first = self.objects_at(self._rows["target"])
        if not (first and self.approach.truss):
            return first
        others = (o for o in self.objects if self.tops.get(o.id) == first[0].id != o.id)
        return (*first, *others)

    @cached_property
    def tops(self) -> Mapping[str, str]:
        """The id of the object whose stem holds each object on a stem, itself or by its truss."""
        out: dict[str, str] = {}
        for item in parents_first(self.objects):
            if item.stem is not None:
                out[item.id] = out[item.stem.parent] if item.stem.parent else item.id
        return out

    @property
    def goals(self) -> tuple[Goal, ...]:
        """The goals, one of which is to be reached; empty where there is a target."""
        if self.goal is None:
            return ()
        return self.goal if isinstance(self.goal, tuple) else (self.goal,)

    @property
    def aim(self) -> FloatArray | None:
        """(3,) end of the tool point at the target [m]; None without a target."""
        return None if self.target is None else self.target.position + self.approach.shift

    @cached_property
    def pushables(self) -> tuple[SceneObject, ...]:
        """The objects that may be pushed, in file order."""
        return self.objects_at(self._rows["pushable"])

    @cached_property
    def avoid(self) -> tuple[SceneObject, ...]:
        """The neighbours that only the last link and the tool may touch, in file order."""
        return self.objects_at(self._rows["avoid"])

    @cached_property
    def static(self) -> tuple[SceneObject, ...]:
        """The objects that no part of the robot may touch, in file order."""
        return self.objects_at(self._rows["static"])

    @cached_property
    def movers(self) -> tuple[tuple[SceneObject, ObjectMotion], ...]:
        """The objects that move, in file order, and their motions."""
        led = self.objects_at(np.flatnonzero(self._stated("motion")))
        return tuple((item, course) for item in led if (course := item.course) is not None)

    @cached_property
    def hangs(self) -> BoolArray:
        """Whether each of the N objects has a stem."""
        return read_only(self._stated("stem"))

    def _stated(self, name: str) -> BoolArray:
        values = self.columns[name]
        if values.count(None) == len(values):  # the usual case, in a tenth of the time
            return np.zeros(len(values), dtype=np.bool_)
        return np.array([value is not None for value in values], dtype=np.bool_)

    @cached_property
    def strands(self) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
        """The S straight pieces of all stems, as capsules; of unseen stems, of all likely ones.

        Rows (S,) of their objects; middles (S, 3) [m]; rotations (S, 3, 3), local to base; sizes
        (S, 3) [m]: radius, half length and 0.
        """
        rows, stems = np.flatnonzero(self.hangs), self.columns["stem"]
        held = [(k, one) for k in rows.tolist() for one in stems[k].likely()]
        points = joined([one.points for _, one in held]).reshape(-1, 3)
        pieces = np.array([len(one.points) - 1 for _, one in held], dtype=np.int64)
        first = np.delete(np.arange(len(points)), np.cumsum(pieces + 1) - 1)
        owner = np.repeat(np.array([k for k, _ in held], dtype=np.int64), pieces)
        radius = np.repeat(np.array([one.radius for _, one in held]), pieces)
        low, high = points[first], points[first + 1]
        length = np.linalg.norm(high - low, axis=1)
        size = np.column_stack([radius, 0.5 * length, 0.0 * length])
        return owner, 0.5 * (low + high), frame_along((high - low) / length[:, None]), size

    @property
    def drifting(self) -> dict[str, ObjectMotion]:
        """The motions of the pushables that move, by id [m, s]."""
        return {item.id: course for item, course in self.movers if item.role == "pushable"}

    @cached_property
    def positions(self) -> FloatArray:
        """Positions (N, 3) of the objects [m]."""
        return joined(self.columns["position"]).reshape(-1, 3)

    @cached_property
    def rotations(self) -> FloatArray:
        """Rotations (N, 3, 3) of the objects, local to base."""
        column, out = self.columns["orientation"], np.tile(np.eye(3), (len(self.objects), 1, 1))
        turned = [k for k, one in enumerate(column) if one is not IDENTITY]
        out[turned] = from_quaternion(joined([column[k] for k in turned]).reshape(-1, 4))
        return read_only(out)

    def rows(self, role: Role) -> IntArray:
        """Indices (K,) of the ``objects`` of a role, in ascending order."""
        return self._rows[role]

    def objects_at(self, rows: IntArray) -> tuple[SceneObject, ...]:
        """The ``objects`` at indices (K,)."""
        objects = self.objects
        return tuple([objects[k] for k in rows.tolist()])

    @property
    def assumed(self) -> tuple[str, ...]:
        """What the scene does not know, in words: stems that nobody saw."""
        hanging = self.objects_at(np.flatnonzero(self.hangs))
        hidden = [o for o in hanging if o.stem is not None and o.stem.unseen]
        if not hidden:
            return ()
        tilts = sorted({f"{o.stem.tilt:g}" for o in hidden if o.stem is not None})
        names, plural = ", ".join(o.id for o in hidden), "s" * (len(hidden) > 1)
        return (
            f"the stem{plural} of {names} nobody saw: assumed to tilt by {' or '.join(tilts)} "
            "degrees (standard deviation), and checked for such stems",
        )

    @property
    def up(self) -> FloatArray:
        """(3,) the world's upward vertical in the base frame, opposite to gravity."""
        return frozen(self.base.rotation[2])

    @property
    def world(self) -> Scene:
        """The first of the scenes that differ from this one in their approach alone."""
        first: Scene = vars(self).get("_world", self)
        return first

    def approached(self, approach: Approach) -> Scene:
        """The scene with another approach. Nothing that the objects alone decide is worked out
        again, where it is asked of :attr:`world`."""
        other = copy.copy(self)
        vars(other).update(approach=approach, _world=self.world)
        return other

    def standing(self, when: Mapping[str, float]) -> Scene:
        """The scene whose objects stand where they are at times ``when`` [s], by id."""
        if not when:
            return self
        return self.each(lambda item: item.standing(when[item.id]) if item.id in when else item)

    def each(self, change: Callable[[SceneObject], SceneObject]) -> Scene:
        """The scene whose objects are as ``change`` returns them."""
        return replace(self, objects=tuple(change(item) for item in self.objects))

    def transformed(self, pose: Pose) -> Scene:
        """The same world in another frame, in which the present base has the ``pose``.

        The robot stands at the origin of the new frame. To move the robot by ``moved``, a pose in
        its present base frame, transform by ``moved.inverse()``. Joint values do not change.
        """
        camera = self.camera and pose @ self.camera
        base = self.base @ pose.inverse()
        return replace(self, base=base, camera=camera, **self.moved(pose))

    @cached_property
    def _touching(self) -> frozenset[frozenset[str]]:
        return frozenset(frozenset(pair) for pair in self.may_touch)

    def may_meet(self, one: str, other: str) -> bool:
        """Whether ``may_touch`` has this pair, in either order."""
        return bool(self.may_touch) and frozenset((one, other)) in self._touching

    @cached_property
    def touches_alike(self) -> bool:
        """Whether every contact counts alike: no pair may touch, and nothing is padded."""
        return not (self.may_touch or self.padding or self._stated("padding").any())

    def padding_of(self, item: SceneObject) -> float:
        """Distance that the robot keeps from an object of the scene [m]; 0 unless it is static."""
        if item.role != "static":
            return 0.0
        return self.padding if item.padding is None else item.padding

    @property
    def frame(self) -> FloatArray:
        """(3, 3) rows x_g, y_g, z_g of the target frame F_g."""
        return self.approach.frame


@lru_cache(maxsize=8)
def measures_of(world: Scene) -> Measures:
    """Kinds (N,), sizes (N, 3) and radii (N,) of a scene's shapes, see :class:`Obstacles`."""
    return measures(world.columns["shape"])


def rows_around(scene: Scene, center: FloatArray, reach: float, role: Role) -> IntArray:
    """Indices (K,) of the ``objects`` of a role whose bounding balls are within ``reach`` [m] of
    ``center`` (3,). The objects themselves may be farther away."""
    rows, (_, _, bound) = scene.rows(role), measures_of(scene.world)
    off = scene.positions[rows] - center
    return np.asarray(rows[lengths(off) - bound[rows] <= reach + _ROUNDING])


def obstacles_of(scene: Scene, *roles: Role) -> Obstacles:
    """A scene's objects of ``roles`` (by default all), packed for the kernels, in their order."""
    wanted = roles or ROLES
    for role in wanted:
        if role not in ROLES:
            raise InvalidSceneError(f"role {role!r} is unknown: {suggest(role, ROLES)}")
    return packed(scene, np.sort(np.concatenate([scene.rows(role) for role in wanted])))


def packed(scene: Scene, rows: IntArray, *, reach: float = 0.0, within: float = 0.0) -> Obstacles:
    """A scene's ``objects`` at indices (K,), packed for the kernels in that order.

    ``reach`` and ``within``: see :func:`optipromp.core.geometry.obstacles.pack`.
    """
    kind, size, bound = measures_of(scene.world)
    shapes = [scene.columns["shape"][k] for k in rows.tolist()]
    return packed_shapes(
        shapes, scene.positions[rows], scene.rotations[rows],
        (kind[rows], size[rows], bound[rows]), reach=reach, within=within,
    )  # fmt: skip


def bare_robot(scene: Scene) -> Robot:
    """The scene's robot without its tool (``optipromp.robot_of`` has it).

    Raises InvalidRobotError.
    """
    return load_arm(scene.robot, scene.base_dir, scene.choice)[0]
