"""Random plants: fruits on one truss, of several shapes, of sampled physical parameters."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.geometry.shapes import Capsule, Cone, Ellipsoid, Shape, Sphere
from optipromp.core.parameters import GRAVITY
from optipromp.core.robots.tools import Cup
from optipromp.core.scenes.crops import Crop
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.generate import bunches
from optipromp_sim.generate.checks import OverlapError

# choices; a number between two ends is sampled uniformly (the modulus: its logarithm)
TRUSS_LENGTH = (0.12, 0.28)  # [m] of a truss from its root to the fruit at its end
NODE = (0.35, 0.9)  # share of the truss, from the root, at which a side branch begins
BRANCH_LENGTH = (0.04, 0.10)  # [m] of a side branch, from the truss to its fruit's centre
BRANCH_LEAN = np.deg2rad(35.0)  # largest, of a side branch from plumb

ELLIPSOID_LENGTH = (1.05, 1.35)  # length of an ellipsoid over its width
CONE_LENGTH = (1.15, 1.45)  # length of a cone over its width
TIP = (0.35, 0.7)  # radius of a cone's tip over that of its shoulder
CROOKED = np.deg2rad(10.0)  # largest angle between a fruit and its stem

MODULUS = (20e6, 150e6)  # [Pa] of green stems
THICKNESS = (0.002, 0.003), (0.003, 0.005)  # [m] of a stem, and of one that carries others
TURN = (0.3, 0.8)  # [rad] that a stem turns when its load is taken off
DENSITY = (850.0, 1000.0)  # [kg/m³] of fruits
FRICTION = (0.2, 0.6)
ABSCISSION = (4.0, 8.0)  # [N] pull that tears a fruit off


def truss(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` pushables and a target on one truss.

    The truss ends in a fruit; the other fruits hang on branches from its axis. The ripe fruit is
    sampled too.
    """
    scene = bunches.sample(name, 0, rng)
    ripe = scene.objects[0]
    axis = bunches.upward(rng, bunches.INCLINATION)
    length = float(rng.uniform(*TRUSS_LENGTH))
    ends, roots = [np.zeros(3)], [length * axis]
    for _ in range(count):
        node = (1.0 - float(rng.uniform(*NODE))) * length * axis
        roots.append(node)
        ends.append(node - float(rng.uniform(*BRANCH_LENGTH)) * bunches.upward(rng, BRANCH_LEAN))
    chosen = int(rng.integers(count + 1))
    names = [f"n{k}" for k in range(1, count + 1)]
    names.insert(chosen, ripe.id)
    fruits = []
    for k, (id_, end, root) in enumerate(zip(names, ends, roots, strict=True)):
        radius = ripe.radius if k == chosen else float(rng.uniform(*bunches.FRUIT_RADII))
        points = np.array([end, root]) + ripe.position - ends[chosen]
        stem = Stem(points, parent=None if k == 0 else names[0])
        role = ripe.role if k == chosen else "pushable"
        fruits.append(SceneObject(id_, role, Sphere(radius), points[0], stem=stem))
    return replace(scene, objects=tuple(fruits))


def field(
    sample: Callable[[str, int, np.random.Generator], Scene], name: str, count: int,
    rng: np.random.Generator,
) -> Scene:  # fmt: skip
    """One sample of a cluster, tight cluster or truss with fruits of several shapes.

    Each fruit and each stem has its own physical parameters.
    """
    scene = sample(name, count, rng)
    fruits = [_shaped(item, rng) for item in scene.objects]
    return replace(scene, objects=rooted(physical(fruits, rng)))


def physical(fruits: Sequence[SceneObject], rng: np.random.Generator) -> list[SceneObject]:
    """The fruits, each with its own density, friction, stiffness of its stem and abscission."""
    density = [float(rng.uniform(*DENSITY)) for _ in fruits]
    volumes = (4.0 / 3.0 * np.pi * item.radius**3 for item in fruits)
    mass = [rho * volume for rho, volume in zip(density, volumes, strict=True)]
    parents = {item.stem.parent for item in fruits if item.stem is not None}
    drawn = []
    for k, item in enumerate(fruits):
        carries = item.id in parents
        assert item.stem is not None
        held = sum(mass) if carries else mass[k]
        own = {
            "density": density[k],
            "friction": float(rng.uniform(*FRICTION)),
            "abscission_force": float(rng.uniform(*ABSCISSION)),
            "stem_stiffness": _stiffness(item.stem, held, carries, rng),
        }
        drawn.append(replace(item, physical=own))
    return drawn


def with_fruits_of(scene: Scene, crop: Crop, rng: np.random.Generator) -> Scene:
    """The sample with the crop's fruits: drawn widths, lengths and lengths of stems.

    All else is as much farther from the target, and the cup as much larger, as fruits are wider
    than those of the presets. Trusses are as much larger, too. Fruits state no physics.
    """
    ripe, tool = scene.target, scene.tool
    assert ripe is not None
    assert tool is not None
    middle, wider = ripe.position, crop["width"] / sum(bunches.FRUIT_RADII)
    joined = any(item.stem is not None and item.stem.parent for item in scene.objects)

    def drawn(name: str) -> float:
        row = crop.rows[name]
        return row.value + row.spread * float(np.clip(rng.standard_normal(), -2.0, 2.0))

    objects = []
    for item in scene.objects:
        stem, place = item.stem, middle + wider * (item.position - middle)
        item = replace(item, position=place, stem=None, physical={})
        if stem is not None:
            wide = 0.5 * drawn("width")
            half = wide * drawn("elongation")
            line = stem.vector / float(np.linalg.norm(stem.vector))
            length = wider * stem.length if joined else drawn("stem_length")
            stem = replace(stem, points=place + np.outer([0.0, half + length], line))
            item = replace(item, stem=stem)
            item = bunches.hung(item, Ellipsoid((wide, wide, half)), half, line)
        objects.append(item)
    widest = max(item.shape.measure.half[0] for item in objects if item.role == "target")
    cup = Cup(**tool.parameters)
    sizes = {
        "radius": max(wider * cup.radius, widest + bunches.MOUTH_CLEARANCE),
        "height": wider * cup.height, "depth": wider * cup.depth, "length": cup.length,
    }  # fmt: skip
    return replace(scene, objects=rooted(objects), tool=ToolSpec("cup", sizes), crop=crop)


def untold(scene: Scene) -> Scene:
    """The scene without the physical parameters of its fruits, which no camera sees."""
    if not any(item.physical for item in scene.objects):
        return scene
    fruits = ("target", "pushable")
    return scene.each(lambda item: replace(item, physical={}) if item.role in fruits else item)


def _stiffness(stem: Stem, mass: float, carries: bool, rng: np.random.Generator) -> float:
    """EI [N m²] of green tissue, at least that at which ``mass`` [kg] turns the stem by TURN."""
    thickness = float(rng.uniform(*THICKNESS[carries]))
    tissue = float(np.exp(rng.uniform(*np.log(MODULUS)))) * np.pi / 64.0 * thickness**4
    level = float(np.linalg.norm((stem.root - stem.points[0])[:2]))
    return max(tissue, mass * GRAVITY * level * stem.length / (2.0 * float(rng.uniform(*TURN))))


def _shaped(item: SceneObject, rng: np.random.Generator) -> SceneObject:
    """The fruit as a ball, capsule, ellipsoid or cone of the same width, hung by its upper end."""
    assert item.stem is not None
    wide, shape = item.radius, item.shape
    half = wide
    match int(rng.integers(4)):
        case 1:
            half = wide * float(rng.uniform(*bunches.ELONGATION))
            shape = Capsule(wide, 2.0 * (half - wide))
        case 2:
            half = wide * float(rng.uniform(*ELLIPSOID_LENGTH))
            shape = Ellipsoid((wide, wide, half))
        case 3:
            tip = wide * float(rng.uniform(*TIP))
            shape, half = _cone(wide, tip, 2.0 * wide * float(rng.uniform(*CONE_LENGTH)))
    line = item.stem.vector / float(np.linalg.norm(item.stem.vector))
    axis = np.cross(line, bunches.upward(rng, np.pi))
    axis = rotation(axis / np.linalg.norm(axis), float(rng.uniform(0.0, CROOKED))) @ line
    return bunches.hung(item, shape, half, axis)


def _cone(wide: float, tip: float, length: float) -> tuple[Shape, float]:
    """A cone of radii ``wide`` at its shoulder and ``tip``, and half of its ``length`` [m]."""
    # the shape's origin is midway between the centres of its balls, not between its ends
    return Cone(wide, tip, length - wide - tip), 0.5 * (length - wide - tip) + wide


# The preset ``wild``: bunches as in pictures of plantations. The quantiles are counted from the
# labels of 1,704 strawberries in 300 public pictures (StrawDI with key points; Tafuro et al., ICRA
# 2022), as a standing camera sees them: across is y, up is z. Many of those fruits lie on beds,
# whose stems may be level. A fruit that hangs pulls its stem down, so the tail of the inclinations
# (73 degrees at 90 %) ends at STEEPEST; the quantiles up to 75 % hold. Leaves of rich pictures hide
# ends of stems (optipromp_sim/simulation/studio.py).
STEEPEST = np.deg2rad(60.0)  # [rad] of a hanging stem off the vertical, as seen: a choice
WILD_SHARES = (0.0, 0.10, 0.25, 0.50, 0.75, 0.90, 1.0)
LONGER = (1.05, 1.12, 1.23, 1.37, 1.56, 1.89, 2.0)  # length over width; the ends: choices
LEAN = np.minimum(np.deg2rad((0.0, 3.0, 8.0, 18.0, 40.0, 73.0, 90.0)), STEEPEST)  # [rad]
WILD_CROOKED = np.deg2rad((0.0, 1.5, 4.0, 9.0, 15.0, 24.0, 30.0))  # [rad] of a fruit off its stem
WILD_FRUITS = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 9.0)
"""Besides the target: 3, 5 and 9 in all at 10, 50 and 90 %."""
NEAR_SHARES = (0.0, 0.05, 0.10, 0.25, 0.50, 1.0)
NEAR = (0.62, 0.70, 0.87, 1.21, 2.10, 5.2)
"""So that the nearest neighbours are 0.67, 0.78, 1.03 and 1.6 widths away at 5, 10, 25 and 50 %."""
APART = 0.001  # [m] between the bounding balls of two neighbours: a choice
DEEPER = 0.012  # [m] standard deviation of a fruit's depth behind another: a choice
PLACES_TRIED = 60  # tries to place a fruit before the scene is sampled again: a choice


def of_quantiles(rng: np.random.Generator, values: FloatArray | tuple[float, ...]) -> float:
    """A number whose quantiles at :data:`WILD_SHARES` are ``values``."""
    return float(np.interp(rng.random(), WILD_SHARES, values))


def wild(name: str, pushables: int, rng: np.random.Generator) -> Scene:
    """One sample of a target and ``pushables`` fruits."""
    scene = bunches.sample(name, 0, rng)
    ripe = scene.objects[0]
    fruits = [_hung("ripe", "target", ripe.radius, ripe.position, rng)]
    for k in range(pushables):
        wide = float(rng.uniform(*bunches.FRUIT_RADII))
        fruits.append(_beside(f"n{k + 1}", wide, fruits, rng))
    return replace(scene, objects=tuple(physical(fruits, rng)))


def _beside(
    name: str, wide: float, fruits: list[SceneObject], rng: np.random.Generator
) -> SceneObject:
    """A fruit beside one of ``fruits``, as far from it in the picture as neighbours are."""
    for _ in range(PLACES_TRIED):
        near = fruits[int(rng.integers(len(fruits)))]
        away = float(np.interp(rng.random(), NEAR_SHARES, NEAR)) * 2.0 * wide
        turn = float(rng.uniform(0.0, 2.0 * np.pi))
        flat = away * np.array([0.0, np.cos(turn), np.sin(turn)])
        made = _hung(name, "pushable", wide, near.position + flat, rng)
        room = near.shape.measure.bound + made.shape.measure.bound + APART
        least = np.sqrt(max(room**2 - away**2, 0.0))  # behind or before, so that they do not touch
        deep = (1.0 if rng.random() < 0.5 else -1.0) * (least + abs(DEEPER * rng.standard_normal()))
        made = made.transformed(Pose(np.array([deep, 0.0, 0.0]), np.eye(3)))
        if all(_free(made, other) for other in fruits):
            return made
    raise OverlapError("no place for a fruit")


def _free(one: SceneObject, other: SceneObject) -> bool:
    """Whether two fruits surely do not touch."""
    away = float(np.linalg.norm(one.position - other.position))
    return away > one.shape.measure.bound + other.shape.measure.bound + APART


def _hung(
    name: str, role: str, wide: float, position: FloatArray, rng: np.random.Generator
) -> SceneObject:
    """A fruit of radius ``wide`` [m] on a stem that leans across the picture, and into it."""
    lean = [of_quantiles(rng, LEAN) * (1.0 if rng.random() < 0.5 else -1.0) for _ in range(2)]
    line = np.array([np.tan(lean[1]), np.tan(lean[0]), 1.0])
    line /= np.linalg.norm(line)
    length = float(rng.uniform(*bunches.STEM_LENGTH))
    stem = Stem(np.array([position, position + length * line]))
    ball = SceneObject(name, role, Sphere(wide), position, stem=stem)  # type: ignore[arg-type]
    half = of_quantiles(rng, LONGER) * wide
    if rng.random() < 0.5:
        shape: Shape = Ellipsoid((wide, wide, half))
    else:
        shape, half = _cone(wide, wide * float(rng.uniform(*TIP)), 2.0 * half)
    turn = float(rng.uniform(0.0, 2.0 * np.pi))
    across = frame_along(line)[:, :2] @ [np.cos(turn), np.sin(turn)]
    made = bunches.hung(ball, shape, half, rotation(across, of_quantiles(rng, WILD_CROOKED)) @ line)
    assert made.stem is not None
    return replace(made, stem=Stem(made.stem.points[0] + np.outer([0.0, length], line)))
