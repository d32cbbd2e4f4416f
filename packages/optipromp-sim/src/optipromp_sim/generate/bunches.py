"""Random clusters: a ripe fruit, unripe fruits on stems before it, neighbours and a gutter."""

import itertools
from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Box, Capsule, Shape, Sphere
from optipromp.core.scenes.scene import STEM_RADIUS, Approach, Scene, SceneObject, Stem, ToolSpec

GutterSide = Literal["+x", "-x", "+y", "-y", "above"]
GUTTER_SIDES: tuple[GutterSide, ...] = get_args(GutterSide)

BELOW_BUNCH = (1.42, 1.10, -1.26, -2.42, -1.69, 1.02, 0.8)
"""Panda with the tool upright at (0.45, 0, 0.50), as in scenarios 3 and 4 [rad]."""

# choices; a number between two ends is sampled uniformly; lengths in [m]
TARGET_LOW, TARGET_HIGH = (0.40, -0.06, 0.85), (0.50, 0.06, 0.93)
START = (0.45, 0.0, 0.50)  # tool point
LOWEST = 0.60  # height of the tool on its approach: below the lowest pushable
GRIPPER_RADIUS = (0.02, 0.03)
FRUIT_RADII = (0.015, 0.020)
NECK = 0.10  # length of the cup's neck
MOUTH_CLEARANCE = 0.004  # between the target and the cup's outer wall, at least
BEFORE = (0.03, 0.15)  # of a pushable before the target, centre to centre
STEM_LENGTH = (0.10, 0.30)
INCLINATION = np.deg2rad(25.0)  # [rad] of a stem from plumb, at most
PLUMB = np.deg2rad(2.0)  # [rad] of a limp stem from plumb, at most

TIGHT_GAP = (0.0, 0.012)  # between two fruits, surface to surface
TIGHT_HEIGHT = (-0.012, 0.012)  # of a fruit above the target

ELONGATION = (1.2, 1.4)  # length of a long fruit over its width; picked strawberries: about 1.3

NEIGHBOUR_DISTANCE = (0.12, 0.25)  # to a side, centre to centre
NEIGHBOUR_RADIUS = (0.05, 0.10)
NEIGHBOUR_HEIGHT = (-0.12, 0.06)  # above the target
NEIGHBOUR_SHIFT = 0.05  # along the other lateral direction, at most

GUTTER_DISTANCE = (0.03, 0.08)  # from the target's centre to the gutter's surface
GUTTER_LENGTH = 1.0
GUTTER_WIDTH = (0.08, 0.20)
GUTTER_HEIGHT = (0.06, 0.16)
GUTTER_BOTTOM = (-0.08, 0.02)  # of a gutter beside the target, above the target


def way() -> FloatArray:
    """Tool points (P, 3) from the start to the far ends of the box of targets [m]."""
    ends = itertools.product(*zip(TARGET_LOW[:2], TARGET_HIGH[:2], strict=True))
    lines = [[(x, y, LOWEST), (x, y, TARGET_HIGH[2])] for x, y in ends]
    return np.array([START, *itertools.chain(*lines)])


def sample(
    name: str, count: int, rng: np.random.Generator, *, sides: bool = False,
    gutter: GutterSide | None = None, inclination: float = INCLINATION,
) -> Scene:  # fmt: skip
    """One sample of ``count`` pushables and a target, possible or not.

    ``sides`` adds a neighbouring cluster on either side, ``gutter`` a gutter on the named side.
    Stems lean by up to ``inclination`` [rad].
    """
    gripper = float(rng.uniform(*GRIPPER_RADIUS))
    target = rng.uniform(TARGET_LOW, TARGET_HIGH)
    objects: list[SceneObject] = []
    roof: float | None = None
    if gutter is not None:
        box = _gutter(target, gutter, rng)
        objects.append(box)
        if gutter == "above":
            roof = float(box.position[2] - box.shape.measure.half[2])
    if sides:
        objects += [_neighbour("left", target, 1.0, rng), _neighbour("right", target, -1.0, rng)]
    largest = min(FRUIT_RADII[1], gripper - MOUTH_CLEARANCE)
    radius = float(rng.uniform(FRUIT_RADII[0], largest))
    # under a gutter that is nearer than its stem is long, the target hangs on the gutter
    ripe = SceneObject(
        "ripe", "target", Sphere(radius), target, stem=_stem(target, rng, roof, inclination)
    )
    fruits = [ripe]
    for i in range(count):
        offset = np.array([*rng.uniform(-gripper, gripper, 2), -rng.uniform(*BEFORE)])
        position = target + offset
        shape = Sphere(float(rng.uniform(*FRUIT_RADII)))
        stem = _stem(position, rng, None, inclination)
        fruits.append(SceneObject(f"n{i + 1}", "pushable", shape, position, stem=stem))
    return Scene(
        name=name,
        robot="panda",
        tool=ToolSpec("cup", {"radius": gripper, "height": 0.05, "length": NECK}),
        start=np.array(BELOW_BUNCH),
        objects=(*fruits, *objects),
        approach=Approach(),
    )


def tight(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` pushables close to the target and to one another, at its height."""
    scene = sample(name, 0, rng)
    fruits = [scene.objects[0]]
    for i in range(count):
        radius, beside = float(rng.uniform(*FRUIT_RADII)), fruits[int(rng.integers(len(fruits)))]
        turn, gap = float(rng.uniform(0.0, 2.0 * np.pi)), float(rng.uniform(*TIGHT_GAP))
        drop = float(rng.uniform(*TIGHT_HEIGHT))
        apart = radius + beside.radius + gap
        height = float(np.clip(fruits[0].position[2] + drop - beside.position[2], -apart, apart))
        level = np.sqrt(apart**2 - height**2)
        position = beside.position + [level * np.cos(turn), level * np.sin(turn), height]
        shape, stem = Sphere(radius), _stem(position, rng)
        fruits.append(SceneObject(f"n{i + 1}", "pushable", shape, position, stem=stem))
    return replace(scene, objects=tuple(fruits))


def elongated(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of fruits that are long along their stems, which begin at the upper ends."""
    scene = sample(name, count, rng)
    return scene.each(lambda item: item if item.stem is None else _longer(item, rng))


def upward(rng: np.random.Generator, lean: float) -> FloatArray:
    """(3,) unit, off the vertical by at most ``lean`` [rad]."""
    tilt, turn = float(rng.uniform(0.0, lean)), float(rng.uniform(0.0, 2.0 * np.pi))
    return np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])


def hung(item: SceneObject, shape: Shape, half: float, axis: FloatArray) -> SceneObject:
    """The fruit with another shape whose z points along ``axis`` (3,), hung by its upper end.

    ``half`` is the distance of that end from the shape's origin [m].
    """
    assert item.stem is not None
    points = np.array(item.stem.points)
    points[0] += half * axis
    turn = np.append(1.0 + axis[2], np.cross([0.0, 0.0, 1.0], axis))
    turn /= np.linalg.norm(turn)
    return replace(item, shape=shape, orientation=turn, stem=replace(item.stem, points=points))


def _longer(item: SceneObject, rng: np.random.Generator) -> SceneObject:
    assert item.stem is not None
    factor, width = float(rng.uniform(*ELONGATION)), item.radius
    line = item.stem.vector / float(np.linalg.norm(item.stem.vector))
    return hung(item, Capsule(width, 2.0 * (factor - 1.0) * width), factor * width, line)


def _stem(
    position: FloatArray,
    rng: np.random.Generator,
    roof: float | None = None,
    inclination: float = INCLINATION,
) -> Stem:
    """A straight stem from ``position`` (3,), which ends below the height of a ``roof`` [m]."""
    length = float(rng.uniform(*STEM_LENGTH))
    line = upward(rng, inclination)
    if roof is not None:
        length = min(length, (roof - position[2] - STEM_RADIUS - 1e-3) / line[2])
    return Stem(np.array([position, position + length * line]))


def _neighbour(name: str, target: FloatArray, side: float, rng: np.random.Generator) -> SceneObject:
    shift = float(rng.uniform(-NEIGHBOUR_SHIFT, NEIGHBOUR_SHIFT))
    aside = side * float(rng.uniform(*NEIGHBOUR_DISTANCE))
    height = float(rng.uniform(*NEIGHBOUR_HEIGHT))
    shape = Sphere(float(rng.uniform(*NEIGHBOUR_RADIUS)))
    return SceneObject(name, "avoid", shape, target + np.array([shift, aside, height]))


def _gutter(target: FloatArray, side: GutterSide, rng: np.random.Generator) -> SceneObject:
    """A box whose surface is :data:`GUTTER_DISTANCE` from the target's centre."""
    distance = float(rng.uniform(*GUTTER_DISTANCE))
    width, height = float(rng.uniform(*GUTTER_WIDTH)), float(rng.uniform(*GUTTER_HEIGHT))
    bottom, share = float(rng.uniform(*GUTTER_BOTTOM)), float(rng.uniform(-0.5, 0.5))
    along = float(rng.uniform(-0.2, 0.2))
    across = int(rng.integers(2))  # axis of the width of a gutter above
    if side == "above":
        offset = np.array([0.0, 0.0, distance + 0.5 * height])
        offset[across], offset[1 - across] = share * width, along
    else:
        across = 0 if side[1] == "x" else 1
        gap = float(np.sqrt(distance**2 - max(0.0, bottom) ** 2))
        offset = np.array([0.0, 0.0, bottom + 0.5 * height])
        offset[across] = (1.0 if side[0] == "+" else -1.0) * (gap + 0.5 * width)
        offset[1 - across] = along
    size = [GUTTER_LENGTH, GUTTER_LENGTH, height]
    size[across] = width
    return SceneObject("gutter", "static", Box((size[0], size[1], size[2])), target + offset)
