"""Random plants: fruits on one truss, of several shapes, of sampled physical parameters."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import rotation
from optipromp.core.geometry.shapes import Capsule, Cone, Ellipsoid, Shape, Sphere
from optipromp.core.parameters import GRAVITY
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp.core.scenes.trusses import rooted
from optipromp.laboratory.generate import bunches

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
    scene = bunches.sample(name, 0, False, None, rng)
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


def field(name: str, kind: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of a ``kind`` (cluster, tight or truss) with fruits of several shapes.

    Each fruit and each stem has its own physical parameters.
    """
    match kind:
        case "cluster":
            scene = bunches.sample(name, count, False, None, rng)
        case "tight":
            scene = bunches.tight(name, count, rng)
        case _:
            scene = truss(name, count, rng)
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


def untold(scene: Scene) -> Scene:
    """The scene without the physical parameters of its fruits, which no camera sees."""
    if not any(item.physical for item in scene.objects):
        return scene
    fruits = ("target", "pushable")
    return replace(
        scene,
        objects=tuple(
            replace(item, physical={}) if item.role in fruits else item for item in scene.objects
        ),
    )


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
            shape, half = _cone(wide, rng)
    line = item.stem.vector / float(np.linalg.norm(item.stem.vector))
    axis = np.cross(line, bunches.upward(rng, np.pi))
    axis = rotation(axis / np.linalg.norm(axis), float(rng.uniform(0.0, CROOKED))) @ line
    return bunches.hung(item, shape, half, axis)


def _cone(wide: float, rng: np.random.Generator) -> tuple[Shape, float]:
    """A cone of radius ``wide`` [m] at its shoulder, and half of its length [m]."""
    tip = wide * float(rng.uniform(*TIP))
    length = 2.0 * wide * float(rng.uniform(*CONE_LENGTH))
    # the shape's origin is midway between the centres of its balls, not between its ends
    return Cone(wide, tip, length - wide - tip), 0.5 * (length - wide - tip) + wide
