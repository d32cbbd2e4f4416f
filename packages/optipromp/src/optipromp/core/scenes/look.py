"""Looks: what a detector saw at one moment; the door of every camera."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from annotated_types import Ge, Gt, Le, Unit

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.distances import distances
from optipromp.core.geometry.obstacles import pack
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import IDENTITY
from optipromp.core.scenes.scene import Scene
from optipromp.core.values import Validated


@dataclass(frozen=True, eq=False)
class Look(Validated):
    """The detections of one picture.

    A detection is a :class:`SceneObject` in the frame of the camera, whose z axis points forward,
    with the covariance of its position. Its role is what the detector takes the object for. Its id
    is the detector's own, and need not mean the same object in another look. A fruit whose stem was
    not seen has none.

    Attributes:
        time: of the exposure, by the clock of the controller [s].
        camera: pose of the camera in the robot's base frame at that time.
        detections: all objects that were found, static ones left out.
        view: full opening angle of the camera's cone of view [rad]; an object outside the cone is
            not missed.
        near: distance from the camera below which it measures nothing [m]; 0: not known.
        far: distance from the camera above which it measures nothing [m]; infinite: not known.
        solids: what it measures that is no detection: ``static``, or ``avoid`` what yields, in the
            frame of the camera. What is known and the arm are among it: :func:`unexplained`.

    Raises:
        InvalidRequestError: a detection without a covariance, an angle outside 0 to pi, or limits
            that are negative, not a number, or leave no distance between them.
    """

    time: float
    camera: Pose
    detections: tuple[SceneObject, ...]
    view: Annotated[float, Gt(0.0), Le(3.15), Unit("rad")] = 1.2
    near: Annotated[float, Ge(0.0), Unit("m")] = 0.0
    far: Annotated[float, Gt(0.0), Unit("m or inf")] = math.inf
    solids: tuple[SceneObject, ...] = ()

    def __post_init__(self) -> None:
        super().__post_init__()
        for item in self.detections:
            if item.covariance is None:
                raise InvalidRequestError(
                    f"detection {item.id} has no covariance: give covariance or sigma [m]"
                )
        if not self.near < self.far:
            raise InvalidRequestError(f"far is {self.far:g}: must be above near, {self.near:g} [m]")

    def in_base(self) -> tuple[SceneObject, ...]:
        """The detections in the robot's base frame."""
        return tuple(item.transformed(self.camera) for item in self.detections)


BESIDE = 0.01  # [m] from what is known, within which a point is of it: a choice
BY_ARM = 0.02  # [m] from the arm's cover, the same: cables and covers: a choice
BEHIND = 0.0, 0.01, 0.02, 0.03  # [m] so far behind what is known, nobody saw: a choice
FEWEST = 4  # points of a solid that are left: a choice
HIDDEN = 0.10  # [m] behind what is hard, that may be of it: a board seen on its edge: a choice
NEAR_FRUITS = 0.15  # [m] from a fruit, where this counts: a choice


def unexplained(
    look: Look, known: Scene, fruits: Sequence[SceneObject], arm: FloatArray, reach: float,
    beside: float = BESIDE,
) -> Iterator[SceneObject]:  # fmt: skip
    """The solids of a look, in the base frame, less what is known and what the arm cannot reach.

    A point of a cloud is left out beside, or close behind, a static object of ``known``, one of the
    ``fruits`` or the arm, and beyond ``reach``. A solid of another shape is left out where a fruit
    lies in it.

    Args:
        look: whose solids are meant.
        known: the scene without the look.
        fruits: that were measured, in the base frame.
        arm: balls (B, 4) of the arm at the time of the look, centres and radii [m].
        reach: distance of the arm's farthest point from its base, in any configuration [m].
        beside: distance from what is known within which a point is of it [m].
    """
    around = pack([(o.shape, o.position, o.rotation) for o in (*known.static, *fruits)])
    middles = np.array([item.position for item in fruits]).reshape(-1, 3)
    for item in look.solids:
        there = item.transformed(look.camera)
        if not isinstance(there.shape, PointCloudShape):
            local = np.abs((middles - there.position) @ there.rotation)
            if not (local <= there.shape.measure.half).all(axis=1).any():
                yield there
            continue
        points = there.position + there.shape.points @ there.rotation.T
        points = points[lengths(points) < reach]
        far = beside + (there.padding or 0.0)
        for behind in BEHIND:
            ways = points - look.camera.position
            before = points - behind * ways / lengths(ways)[:, None]
            free = distances(around, before)[0].min(axis=1, initial=np.inf) > far
            for ball in arm:
                free &= lengths(before - ball[:3]) > ball[3] + BY_ARM
            points = points[free]
        if len(points) >= FEWEST:
            yield clouded(there, points)


def with_hidden(
    items: Sequence[SceneObject], look: Look, known: Scene, fruits: Sequence[SceneObject],
    arm: FloatArray, reach: float, beside: float = BESIDE,
    free: Callable[[FloatArray], BoolArray] = lambda points: np.zeros(len(points), dtype=bool),
) -> list[SceneObject]:  # fmt: skip
    """Things that :func:`unexplained` made of a look, each with what nobody saw behind it.

    That is up to :data:`HIDDEN` behind hard clouds within :data:`NEAR_FRUITS` of a fruit, less what
    is known, and less the points (N, 3) in the base frame that are ``free``, as another look shows.
    """
    middles, shades = np.array([item.position for item in fruits]).reshape(-1, 3), []
    for item in items:
        if item.role != "static" or not isinstance(item.shape, PointCloudShape):
            continue
        points, side = points_of(item), 2.0 * item.shape.radius
        away = np.linalg.norm(points[:, None] - middles, axis=2).min(axis=1, initial=np.inf)
        points = points[away < NEAR_FRUITS]
        ways = points - look.camera.position
        ways /= lengths(ways)[:, None]
        points = (points + np.arange(side, HIDDEN, side)[:, None, None] * ways).reshape(-1, 3)
        points = side * (np.unique(np.floor(points / side), axis=0) + 0.5)
        points = points[~free(points)]
        if len(points):
            shades.append(clouded(item, points).transformed(look.camera.inverse()))
    shaded = replace(look, solids=tuple(shades))
    hidden = {o.id: o for o in unexplained(shaded, known, fruits, arm, reach, beside)}
    return [
        clouded(item, points_of(item), points_of(hidden[item.id])) if item.id in hidden else item
        for item in items
    ]


def points_of(item: SceneObject) -> FloatArray:
    """Points (N, 3) of an object in the frame of its position [m]: of its cloud, or surface."""
    cloud = item.shape if isinstance(item.shape, PointCloudShape) else None
    points = item.shape.surface().reshape(-1, 3) if cloud is None else cloud.points
    return np.asarray(item.position + points @ item.rotation.T)


def clouded(item: SceneObject, *clouds: FloatArray) -> SceneObject:
    """A cloud of other points (N, 3), in the frame of its position."""
    assert isinstance(item.shape, PointCloudShape)
    points, middle = np.concatenate(clouds), np.concatenate(clouds).mean(axis=0)
    shape = replace(item.shape, points=points - middle)
    return replace(item, shape=shape, position=middle, orientation=IDENTITY)
