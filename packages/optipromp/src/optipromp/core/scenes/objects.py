"""Objects of a scene, their motions, their stems (also those that nobody saw) and trusses."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Annotated, Literal, Self, TypeAlias, get_args

import numpy as np
from annotated_types import Ge, Le, Unit
from numpy.typing import ArrayLike
from pydantic import AfterValidator

from optipromp.core.arrays import FloatArray, frame_along, frozen, lengths
from optipromp.core.errors import InvalidSceneError, suggest
from optipromp.core.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere
from optipromp.core.parameters import FRUIT_DENSITY, GRAVITY
from optipromp.core.scenes.pose import (
    POINTS,
    Array,
    Framed,
    Length,
    Padding,
    Point,
    Pose,
    Quantity,
    Turn,
    array,
    unit,
)
from optipromp.core.scenes.rotations import IDENTITY, from_quaternion
from optipromp.core.values import Name, Positive, refuse, value

FOR_EVER = 600.0  # [s] a choice: for so long an object with a velocity moves
FASTEST = 10.0  # [m/s] chosen: a larger speed is a number in millimetres


@dataclass(frozen=True, eq=False)
class ObjectMotion(Framed, label="motion."):
    """A curve of straight pieces. Before and after it, the object stands at the curve's ends.

    Time 0 is the begin of a plan's trajectory. The object does not turn.

    Args:
        times: (k,) increasing [s], k >= 2.
        positions: (k, 3) of the object at these times, in the base frame [m].

    Raises:
        InvalidSceneError: times that do not increase, arrays that do not fit, or a speed above
            :data:`FASTEST`.
    """

    times: Annotated[FloatArray, Array(None)]
    positions: Annotated[FloatArray, POINTS]

    def __post_init__(self) -> None:
        super().__post_init__()
        times, positions = self.times, self.positions
        if len(times) < 2 or len(positions) != len(times):
            raise InvalidSceneError(
                f"motion has times {times.shape} and positions {positions.shape}: must be (k,) "
                "and (k, 3), k >= 2"
            )
        if (np.diff(times) <= 0.0).any():
            raise InvalidSceneError(f"motion.times are {times.tolist()}: must increase")
        if self.fastest > FASTEST:
            raise InvalidSceneError(
                f"motion reaches {self.fastest:.3g} m/s: must be at most {FASTEST:g} [m/s]; "
                "millimetres? then write scale: 0.001 at the top"
            )

    @classmethod
    def steady(cls, position: FloatArray, velocity: FloatArray) -> Self:
        """From ``position`` (3,) [m] at time 0 with a ``velocity`` (3,) [m/s], for 600 s."""
        begin, by = array("position", position, 3), array("velocity", velocity, 3)
        return cls(np.array([0.0, FOR_EVER]), np.array([begin, begin + FOR_EVER * by]))

    def at(self, times: FloatArray) -> FloatArray:
        """Positions (M, 3) at ``times`` (M,) [m]."""
        return np.stack([np.interp(times, self.times, one) for one in self.positions.T], axis=-1)

    @property
    def fastest(self) -> float:
        """The largest speed [m/s]."""
        gone = lengths(np.diff(self.positions, axis=0))
        return float((gone / np.diff(self.times)).max())

    def later(self, time: float) -> ObjectMotion:
        """The same motion for one to whom ``time`` [s] is time 0."""
        return replace(self, times=self.times - time)

    def shifted(self, by: FloatArray) -> ObjectMotion:
        """The same motion, displaced ``by`` (3,) [m]."""
        return replace(self, positions=self.positions + by)


Role: TypeAlias = Literal["target", "pushable", "avoid", "static"]
ROLES: tuple[Role, ...] = get_args(Role)

PHYSICAL = (
    "mass", "density", "friction", "stem_stiffness", "stem_stiffness_spread", "abscission_force",
)  # fmt: skip
"""Keys of an object's ``physical``: [kg], [kg/m³], [-], EI [N m²], [-], [N]."""

STEM_RADIUS = 0.003  # default radius of a stem [m], chosen

UNSEEN_TILT = 20.0
"""Standard deviation of each tilt of a stem that nobody saw [degrees]: a choice. In pictures of
1,704 strawberries, many of them on beds, the median tilt is 18 degrees, of hanging fruit less."""
UNSEEN_LENGTH = 0.15  # likeliest length of a stem that nobody saw [m]: a choice
UNSEEN_SPREAD = 0.35  # standard deviation of the logarithm of its length: a choice
STEEPEST = 60.0  # [degrees] chosen: largest standard deviation of a tilt

_LARGEST_SIGMA = 10.0  # [m] chosen
FASTEST_ROOT = 0.1  # [m/s] of a stem's root: as slow as the tool for which pushes are predicted
STEM_SLACK = 0.005  # [m] chosen: largest distance of a stem's ends from its fruit and its parent


@dataclass(frozen=True, eq=False)
class Stem(Framed, label="stem."):
    """The stem of a fruit.

    Args:
        points: (k, 3) in the robot's base frame [m], fruit first, root last, k >= 2.
        radius: [m].
        parent: id of the object from whose stem this stem grows, at its root; None if the root is
            fixed. Fruits on stems that grow from one another share a truss.
        tilt: standard deviation of each of its two tilts [degrees]; None: that of a detected stem.
        unseen: whether nobody saw the stem. Its points are then the likeliest: plans hold for stems
            of all tilts and lengths about them; see :func:`unseen`.

    Raises:
        InvalidSceneError: there are fewer than two points, a piece has no length, or the radius is
            not positive.
    """

    points: Annotated[FloatArray, POINTS]
    radius: Length = STEM_RADIUS
    parent: str | None = None
    tilt: Annotated[float | None, Ge(0.0), Le(STEEPEST), Unit("degrees")] = None
    unseen: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.points) < 2:
            raise InvalidSceneError("stem.points has 1 entry: must have at least 2")
        short = np.flatnonzero(lengths(np.diff(self.points, axis=0)) < 1e-9)
        if short.size:
            raise InvalidSceneError(
                f"stem piece {short[0]} has no length: neighbouring points (the fruit's position "
                "is the first) must differ"
            )

    @classmethod
    def along(
        cls, position: FloatArray, direction: FloatArray, length: float, radius: float = STEM_RADIUS
    ) -> Stem:
        """A straight stem of ``length`` [m] from the fruit's ``position`` (3,).

        ``direction`` (3,): from the fruit to the root, of any length above 0.
        """
        length = value("stem.length", length, Length, InvalidSceneError)
        begin = array("position", position, 3)
        return cls(np.array([begin, begin + length * unit("stem.direction", direction)]), radius)

    @classmethod
    def hidden(
        cls, position: FloatArray, up: FloatArray, length: float | None = None,
        tilt: float | None = None, radius: float = STEM_RADIUS,
    ) -> Stem:  # fmt: skip
        """A stem that nobody saw, about ``up`` (3,) from the fruit's ``position`` (3,).

        Args:
            position: (3,) of the fruit [m].
            up: (3,) likeliest direction.
            length: likeliest length [m]; None: :data:`UNSEEN_LENGTH`. The logarithm of the length
                has the standard deviation :data:`UNSEEN_SPREAD`.
            tilt: standard deviation of each of two tilts [degrees]; None: :data:`UNSEEN_TILT`.
            radius: [m].
        """
        straight = cls.along(position, up, UNSEEN_LENGTH if length is None else length, radius)
        return replace(straight, tilt=UNSEEN_TILT if tilt is None else tilt, unseen=True)

    def likely(self) -> Iterator[Stem]:
        """The stem; of one that nobody saw, also those that lean by one deviation to four sides."""
        yield self
        if not self.unseen:
            return
        axes = frame_along(self.vector / np.linalg.norm(self.vector))
        lean = math.tan(math.radians(self.tilt or 0.0))
        for aside in (axes[:, 0], -axes[:, 0], axes[:, 1], -axes[:, 1]):
            way = axes[:, 2] + lean * aside
            yield Stem.along(self.points[0], way, self.length, self.radius)

    def pieces(self) -> Iterator[tuple[Capsule, FloatArray, FloatArray]]:
        """Each straight piece: a capsule, its middle (3,) [m], and its rotation (3, 3)."""
        for low, high in pairwise(self.points):
            length = float(np.linalg.norm(high - low))
            yield (
                Capsule(self.radius, length),
                0.5 * (low + high),
                frame_along((high - low) / length),
            )

    @property
    def vector(self) -> FloatArray:
        """(3,) the stem vector S_n of the paper: from the fruit to the next point [m]."""
        return frozen(self.points[1] - self.points[0])

    @property
    def root(self) -> FloatArray:
        """(3,) the fixed end of the stem [m]."""
        return frozen(self.points[-1])

    @property
    def length(self) -> float:
        """Length along the stem [m]."""
        return float(np.linalg.norm(np.diff(self.points, axis=0), axis=1).sum())


def _covariance(values: ArrayLike) -> FloatArray:
    """The covariance (3, 3) [m²] of a position."""
    covariance = Array(3, 3).read(values)
    scale = float(np.abs(covariance).max())
    if np.abs(covariance - covariance.T).max() > 1e-9 * scale:
        raise refuse("is not symmetric: must equal its transpose")
    if scale > _LARGEST_SIGMA**2:
        raise refuse(f"reaches {scale:g}: must be at most {_LARGEST_SIGMA**2:g} [m²]")
    least = float(np.linalg.eigvalsh(covariance)[0])
    if least < -1e-12 * scale:
        raise refuse(f"has eigenvalue {least:.3g}: must be positive semi-definite")
    return covariance


def _spread(pose: Pose, covariance: FloatArray) -> FloatArray:
    """A covariance (3, 3) in another frame."""
    turned = pose.rotation @ covariance @ pose.rotation.T
    return np.asarray(0.5 * (turned + turned.T))


def _physical(name: str) -> str:
    if name not in PHYSICAL:
        raise refuse(f"is unknown: {suggest(name, PHYSICAL)}")
    return name


SPREAD = Quantity(_covariance, _spread)
Sigma = Annotated[float, Ge(0.0), Le(_LARGEST_SIGMA), Unit("m")]


@dataclass(frozen=True, eq=False)
class SceneObject(Framed):
    """One object of the scene.

    Args:
        id: its name, unique in the scene.
        role: ``target``, ``pushable``, ``avoid`` or ``static``.
        shape: in its local frame.
        position: (3,) of the local origin, in the robot's base frame [m].
        orientation: of the local frame: quaternion (4,) ``w, x, y, z``, or rotation matrix (3, 3),
            which is converted to a quaternion.
        stem: of a fruit, if any.
        covariance: (3, 3) covariance of the detected position [m²], if known.
        physical: further numbers; keys are those of :data:`PHYSICAL`. The simulation uses all of
            them, the push model mass and stem_stiffness. stem_stiffness_spread is the exponential
            of the standard deviation of the logarithm of the stiffness.
        sigma: in place of ``covariance``: standard deviation of each coordinate of the detected
            position [m]. It is converted to a covariance, and the attribute reads None.
        motion: of any object but the target; at time 0 the object is at its ``position``. Its
            stem moves with it. A pushable that moves hangs on a stem of its own, whose root is
            led at :data:`FASTEST_ROOT` at most.
        padding: of a static object: distance that the robot keeps from it [m]; None: the scene's.

    Raises:
        InvalidSceneError: the role is unknown, a fruit is a half space, a value is not finite or of
            the wrong shape, a padding is negative or the object is not static, a stem starts away
            from its fruit, or an object has a motion that its role does not allow.
    """

    id: Name
    role: Role
    shape: Shape
    position: Point
    orientation: Turn = field(default_factory=lambda: IDENTITY)
    stem: Stem | None = None
    covariance: Annotated[FloatArray, SPREAD] | None = None
    physical: Mapping[Annotated[str, AfterValidator(_physical)], Positive] = field(
        default_factory=dict
    )
    sigma: InitVar[float | None] = None
    motion: ObjectMotion | None = None
    padding: Padding | None = None

    def __post_init__(self, sigma: float | None) -> None:
        if sigma is not None:
            if self.covariance is not None:
                raise InvalidSceneError(
                    "covariance and sigma are given: must be one of them at most"
                )
            deviation = value("sigma", sigma, Sigma, InvalidSceneError)
            object.__setattr__(self, "covariance", deviation**2 * np.eye(3))
        super().__post_init__()
        if self.role in ("target", "pushable") and math.isinf(self.radius):
            raise InvalidSceneError(f"a {self.role} cannot be a half_space: it has no end")
        if self.padding is not None and self.role != "static":
            raise InvalidSceneError(
                f"padding is {self.padding:g} and the role is {self.role}: padding goes with "
                "static objects"
            )
        if self.stem is not None:
            gap = float(np.linalg.norm(self.stem.points[0] - self.position))
            if gap > self.shape.measure.bound + STEM_SLACK:
                raise InvalidSceneError(
                    f"stem.points[0] is {gap:.3g} m from the fruit's position: a stem must start "
                    "at its fruit"
                )
        if self.motion is not None:
            if (refused := self._immobile(self.motion)) is not None:
                raise InvalidSceneError(f"a {self.role} has a motion{refused}")
            off = float(np.linalg.norm(self.motion.at(np.zeros(1))[0] - self.position))
            if off > 1e-6:  # [m] rounding
                raise InvalidSceneError(
                    f"motion is {off:.3g} m from position at time 0: must be there"
                )
        spread = self.physical.get("stem_stiffness_spread")
        if spread is not None and not spread > 1.0:
            raise InvalidSceneError(f"physical.stem_stiffness_spread is {spread}: must be above 1")

    def _immobile(self, motion: ObjectMotion) -> str | None:
        """Why the object may not have a motion, and what to do; None: it may."""
        if self.role == "target":
            return ": it must stand; a closed loop (simulate --closed-loop) follows one that moves"
        if self.role != "pushable":
            return None
        if self.stem is None or self.stem.parent is not None:
            return " and no stem of its own: what moves is the root; state a stem without parent"
        if motion.fastest > FASTEST_ROOT * (1.0 + 1e-9):
            return f" of {motion.fastest:.3g} m/s: must be at most {FASTEST_ROOT:g}, or role avoid"
        return None

    @cached_property
    def rotation(self) -> FloatArray:
        """(3, 3), local to base: the ``orientation`` as a matrix."""
        return from_quaternion(self.orientation)

    def at(self, position: FloatArray, id: str | None = None) -> SceneObject:
        """A copy of the object at another position; its stem and its motion are moved along.

        The orientation, the covariance and the stem's parent stay. Fruits of a truss are moved
        together: a scene refuses a stem whose root has left the stem that it grows from.

        Args:
            position: (3,) of the local origin of the copy, in the robot's base frame [m].
            id: of the copy, as ids are unique in a scene; None: the same.

        Raises:
            InvalidSceneError: a position of another shape, or one that is not finite.
        """
        to = array("position", position, 3)
        name = self.id if id is None else id
        return replace(self.shifted(to - self.position), id=name, position=to)

    def shifted(self, by: FloatArray, part: str = "whole") -> SceneObject:
        """The object displaced ``by`` (3,) [m].

        ``part``: ``whole``; ``object`` with the end of the stem that is at it; or the stem's
        ``root`` alone.
        """
        position, stem, motion = self.position, self.stem, self.motion
        if part != "root":
            position, motion = position + by, motion and motion.shifted(by)
        if stem is not None:
            points = np.array(stem.points)
            points[{"whole": slice(None), "object": slice(1), "root": slice(-1, None)}[part]] += by
            stem = replace(stem, points=points)
        return replace(self, position=position, stem=stem, motion=motion)

    @property
    def course(self) -> ObjectMotion | None:
        """The motion; None where it leads nowhere, or the object has none."""
        return self.motion if self.motion is not None and self.motion.fastest > 0.0 else None

    def standing(self, time: float) -> SceneObject:
        """The object as it stands at a ``time`` [s], without its motion."""
        if self.motion is None:
            return self
        return replace(self, motion=None).at(self.motion.at(np.array([time]))[0])

    @property
    def radius(self) -> float:
        """Radius [m] of a ball about ``position`` that contains the shape."""
        return self.shape.measure.bound

    def extent(self, axis: FloatArray) -> float:
        """Half the extent [m] along a unit vector (3,); of a shape with no formula, the radius."""
        along = self.rotation.T @ axis
        match self.shape:
            case Box(size):
                return 0.5 * float(np.abs(along) @ np.array(size))
            case Cylinder(radius, length):
                return 0.5 * length * abs(float(along[2])) + radius * float(np.hypot(*along[:2]))
            case Capsule(radius, length):
                return radius + 0.5 * length * abs(float(along[2]))
        return self.radius


TILTS = 8.0, 16.0, 24.0, 32.0, 40.0  # [degrees] that are tried: choices
AROUND = 12  # directions of each: a choice
ROOM = 0.002  # [m] between a stem and a fruit, at least: a choice
ALONG = 40  # points of a stem that are looked at: a choice


def cleared(objects: Iterable[SceneObject], up: FloatArray) -> tuple[SceneObject, ...]:
    """The objects, each upright stem that nobody saw tilted as little as clears the other fruits.

    An unseen stem of another direction stays, since its direction was told. Where no tilt is clear,
    the one with most room is taken.
    """
    items = tuple(objects)
    return tuple(_cleared(item, items, up) for item in items)


def _cleared(item: SceneObject, items: tuple[SceneObject, ...], up: FloatArray) -> SceneObject:
    stem = item.stem
    if stem is None or not stem.unseen:
        return item
    if stem.vector @ up < (1.0 - 1e-9) * stem.length:
        return item
    others = [one for one in items if one is not item and one.role in ("target", "pushable")]
    if not others:
        return item
    centers = np.array([one.position for one in others])
    sizes = np.array([one.radius for one in others]) + stem.radius
    best, room = stem, -math.inf
    for way in _ways(up):
        line = stem.points[0] + np.linspace(0.0, stem.length, ALONG)[:, None] * way
        gap = float((np.linalg.norm(line[:, None] - centers[None], axis=2) - sizes).min())
        if gap > room:
            made = Stem.along(stem.points[0], way, stem.length, stem.radius)
            best, room = replace(made, tilt=stem.tilt, unseen=True), gap
        if room > ROOM:
            break
    return replace(item, stem=best)


def _ways(up: FloatArray) -> Iterator[FloatArray]:
    """Directions (3,), the steepest first."""
    axes = frame_along(up)
    yield axes[:, 2]
    for tilt in np.deg2rad(TILTS):
        for turn in 2.0 * np.pi * np.arange(AROUND) / AROUND:
            flat = math.sin(tilt) * np.array([math.cos(turn), math.sin(turn)])
            yield axes @ np.append(flat, math.cos(tilt))


def nearest(points: FloatArray, point: FloatArray) -> tuple[int, FloatArray]:
    """Index of the piece of a stem (N, 3) that is nearest to ``point`` (3,), and the nearest point
    (3,) of it [m]."""
    start, pieces = points[:-1], np.diff(points, axis=0)
    share = ((point - start) * pieces).sum(axis=1) / (pieces**2).sum(axis=1)
    places = start + np.clip(share, 0.0, 1.0)[:, None] * pieces
    piece = int(np.argmin(((places - point) ** 2).sum(axis=1)))
    return piece, np.asarray(places[piece])


def parents_first(objects: Sequence[SceneObject]) -> list[SceneObject]:
    """The objects in their order, but each after its stem's parent."""
    by_id = {item.id: item for item in objects}
    out: dict[str, SceneObject] = {}
    for item in objects:
        line = [item]
        while (stem := line[-1].stem) is not None and stem.parent is not None:
            where = f"object {line[-1].id!r}: stem.parent {stem.parent!r}"
            if stem.parent not in by_id:
                raise InvalidSceneError(f"{where} is no object: {suggest(stem.parent, by_id)}")
            parent = by_id[stem.parent]
            if parent.stem is None:
                raise InvalidSceneError(f"{where} has no stem: must be an object that hangs")
            if parent in line:
                raise InvalidSceneError(f"{where} grows from it in turn: one root must be held")
            if parent.id in out:
                break
            line.append(parent)
        out |= {one.id: one for one in reversed(line)}
    return list(out.values())


def check_trusses(objects: Sequence[SceneObject]) -> None:
    """Refuse stems whose root is not on their parent's stem."""
    grown = [(item.id, item.stem) for item in objects if item.stem and item.stem.parent is not None]
    by_id = {item.id: item for item in parents_first(objects)} if grown else {}
    for name, stem in grown:
        other = by_id[stem.parent or ""]
        assert other.stem is not None
        if other.motion is not None:
            raise InvalidSceneError(
                f"object {other.id!r} has a motion and carries the stem of {name!r}: "
                "fruits of a truss must stand"
            )
        off = math.dist(nearest(other.stem.points, stem.root)[1], stem.root)
        if off > STEM_SLACK:
            raise InvalidSceneError(
                f"object {name!r}: the root of its stem is {off:.3g} m from the stem of "
                f"{other.id!r}, its parent: must be on it, to {STEM_SLACK:g} m"
            )


STANDS = 2.0  # least stiffness of a stem that stands over that which buckles, chosen


def least_stiffness(
    mass: ArrayLike, height: ArrayLike, bends: ArrayLike, rigid: ArrayLike
) -> FloatArray:
    """The least bending stiffness EI of stems that stand (N,) [N m²]; 0 of stems that hang.

    A straight stem bends along a length ``bends``, a; its fruit is a ``rigid`` length b up to the
    ``mass`` m [kg], a ``height`` h over the root [m]. The weight presses along the stem with
    P = m g h / (a + b). With k² = P / EI its end is δ (1 - cos ka) aside where the mass is δ aside,
    so it buckles where (b / a) u tan u = 1, u = ka: at EI = P a² / u², which without a rigid length
    is Euler's 4 m g L² / π². The least stiffness is :data:`STANDS` times that.
    """
    mass, height, a, b = np.broadcast_arrays(mass, height, bends, rigid)
    low, high = np.zeros(mass.shape), np.full(mass.shape, np.pi / 2.0)
    for _ in range(40 if (height > 0.0).any() else 0):
        u = 0.5 * (low + high)
        short = b * u * np.sin(u) < a * np.cos(u)
        low, high = np.where(short, u, low), np.where(short, high, u)
    pressing = mass * GRAVITY * np.maximum(height, 0.0) / (a + b)
    return np.asarray(STANDS * pressing * (a / high) ** 2)


def mass_of(item: SceneObject, density: float = FRUIT_DENSITY) -> float:
    """Mass of a fruit [kg]: stated, else of its volume and its stated density, else ``density``."""
    given = item.physical
    return float(given.get("mass") or given.get("density", density) * item.shape.volume)


def least_of(item: SceneObject, load: float, up: FloatArray) -> float:
    """:func:`least_stiffness` of a fruit's stem under a ``load`` [kg]; ``up``: (3,) vertical."""
    assert item.stem is not None
    rigid, long = float(np.linalg.norm(item.stem.points[0] - item.position)), item.stem.length
    inside = item.radius if isinstance(item.shape, Sphere) and rigid == 0.0 else 0.0
    height = float((item.position - item.stem.root) @ up)
    return float(least_stiffness(load, height, max(long - inside, 0.2 * long), rigid + inside))


def check_upright(objects: Sequence[SceneObject], up: FloatArray, density: float) -> None:
    """Refuse fruits of a known place whose stem is stated to be softer than it must be to stand."""
    if not any("stem_stiffness" in item.physical for item in objects):
        return
    carried = {item.id: 0.0 for item in objects}
    for item in reversed(parents_first(objects)):
        if item.stem is None:
            continue
        carried[item.id] += mass_of(item, density)
        if item.stem.parent is not None:
            carried[item.stem.parent] += carried[item.id]
        stated, load = item.physical.get("stem_stiffness", np.inf), carried[item.id]
        if item.covariance is None and stated < (1.0 - 1e-6) * (least := least_of(item, load, up)):
            raise InvalidSceneError(
                f"object {item.id!r}: physical.stem_stiffness is {stated:.3g}: its stem stands, "
                f"carries {1e3 * load:.3g} g and buckles below {least / STANDS:.3g}; must be at "
                f"least {least:.3g} [N m²], or not stated: then it is as stiff as it needs"
            )


def rooted(objects: Iterable[SceneObject]) -> tuple[SceneObject, ...]:
    """The objects with the root of each stem moved to the nearest point of its parent's stem.

    For objects that have moved one by one. A stem whose parent is missing gets a fixed root.
    """
    items = list(objects)
    here = {item.id: item for item in items}
    for item in items:
        stem = item.stem
        if stem is not None and stem.parent is not None and stem.parent not in here:
            here[item.id] = replace(item, stem=replace(stem, parent=None))
    for item in parents_first(list(here.values())):
        if item.stem is None or item.stem.parent is None:
            continue
        other = here[item.stem.parent].stem
        assert other is not None
        points = np.array(item.stem.points)
        _, points[-1] = nearest(other.points, points[-1])
        here[item.id] = replace(item, stem=replace(item.stem, points=points))
    return tuple(here[item.id] for item in items)
