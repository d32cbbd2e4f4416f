"""Random vines: peppers, cucumbers and trusses, whose peduncles a scissor cuts from the side."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.geometry.shapes import Capsule, Ellipsoid, Shape, Sphere
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Approach, Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.generate.bunches import upward
from optipromp_sim.generate.plants import physical

UP = np.array([0.0, 0.0, 1.0])

# choices; a number between two ends is sampled uniformly; lengths in [m]
LOW, HIGH = (0.44, -0.12, 0.30), (0.54, 0.12, 0.50)  # of the target's centre
VINE, VINE_LENGTH, BRANCH = 0.007, 1.0, 0.004  # radius and length of the vine; radius of a branch
AWAY = (0.015, 0.04)  # between a fruit and the vine
BEHIND = np.deg2rad(100.0)  # [rad] largest, of the vine from behind the target
ABOVE = (-0.3, 0.3)  # height of a neighbour over the target
PEPPER, PEPPER_LENGTH, PEPPER_DENSITY = (0.028, 0.040), (1.0, 1.4), 500.0  # radius; over its width
CUCUMBER, CUCUMBER_LENGTH, CUCUMBER_DENSITY = (0.016, 0.022), (0.12, 0.18), 950.0
PEDUNCLE, PEDUNCLE_RADIUS = (0.045, 0.075), (0.0025, 0.004)
LEAN = np.deg2rad(6.0)  # [rad] largest, of a fruit and its peduncle from plumb
MODULUS = (50e6, 150e6)  # [Pa] of a peduncle: a guess, of green stems
HOLDS = 40.0  # [N] pull that tears a fruit off: a guess; such fruits are cut
TOMATO, FRUITS = (0.013, 0.018), (2, 5)  # radius; on pedicels of a truss, fewest and too many
NODES, LOWEST = (0.024, 0.035), 0.015  # between nodes; the lowest is so much farther from the end
RACHIS, PEDICEL = 0.002, (0.006, 0.015)  # radius of stems of a truss; from its axis to a fruit
SLOPE, TURN = np.deg2rad([55.0, 80.0]), np.deg2rad(30.0)  # [rad] of a pedicel from plumb; off the
# plane of the truss, at most
SCISSOR = ToolSpec("scissor", {"opening": 0.04, "depth": 0.012})


def sample(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` pushables and a target on one vine: peppers, or cucumbers.

    Each hangs on a peduncle from a branch of the vine.
    """
    peppers = bool(rng.integers(2))
    return _planted(name, lambda id_: _fruit(id_, peppers, rng), count, rng)


def trusses(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of a truss that is cut as a whole, the target at its end, and ``count`` others."""
    scene = _planted(name, lambda id_: _truss(id_, rng), count, rng)
    return replace(scene, approach=replace(scene.approach, truss=True))


def _planted(
    name: str, grow: Callable[[str], list[SceneObject]], beside: int, rng: np.random.Generator
) -> Scene:
    """A vine with what ``grow`` makes of an id: first the target, then ``beside`` others."""
    place = rng.uniform(LOW, HIGH)
    turn = math.atan2(place[1], place[0])
    angle, ripe = turn + float(rng.uniform(-BEHIND, BEHIND)), grow("ripe")
    ripe[0] = replace(ripe[0], role="target")
    vine = place + (_wide(ripe) + float(rng.uniform(*AWAY))) * _level(angle)
    objects = _grown(ripe, place, vine)
    for k in range(beside):
        one, away = grow(f"n{k + 1}"), float(rng.uniform(*AWAY))
        off = _level(float(rng.uniform(0.0, 2.0 * np.pi)))
        at = vine + (_wide(one) + away) * off + float(rng.uniform(*ABOVE)) * UP
        objects += _grown(one, at, vine)
    wood = SceneObject("vine", "static", Capsule(VINE, VINE_LENGTH), vine)
    ahead = _level(turn)
    approach = Approach(direction=ahead, lateral=np.cross(UP, ahead))
    return Scene(name, "panda", (*objects, wood), tool=SCISSOR, approach=approach)


def _wide(grown: list[SceneObject]) -> float:
    """Largest level extent of what grows about the origin [m]."""
    return max(math.hypot(*item.position[:2]) + float(item.shape.measure.half[0]) for item in grown)


def _level(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _fruit(name: str, pepper: bool, rng: np.random.Generator) -> list[SceneObject]:
    """A fruit about the origin, on its peduncle."""
    wide = float(rng.uniform(*(PEPPER if pepper else CUCUMBER)))
    half = wide * float(rng.uniform(*PEPPER_LENGTH))
    shape: Shape = Ellipsoid((wide, wide, half))
    if not pepper:
        half = 0.5 * float(rng.uniform(*CUCUMBER_LENGTH))
        shape = Capsule(wide, 2.0 * (half - wide))
    line, radius = upward(rng, LEAN), float(rng.uniform(*PEDUNCLE_RADIUS))
    stem = Stem(np.outer([half, half + float(rng.uniform(*PEDUNCLE))], line), radius)
    known = {
        "density": PEPPER_DENSITY if pepper else CUCUMBER_DENSITY,
        "stem_stiffness": float(rng.uniform(*MODULUS)) * np.pi / 4.0 * radius**4,
        "abscission_force": HOLDS,
    }
    turn = to_quaternion(frame_along(line))
    return [SceneObject(name, "pushable", shape, np.zeros(3), turn, stem, physical=known)]


def _truss(name: str, rng: np.random.Generator) -> list[SceneObject]:
    """A truss about the fruit at its end; the others alternate above, on pedicels."""
    line, turn = upward(rng, LEAN), float(rng.uniform(0.0, 2.0 * np.pi))
    nodes = LOWEST + np.cumsum(rng.uniform(*NODES, int(rng.integers(*FRUITS))))
    root = (nodes[-1] + float(rng.uniform(*PEDUNCLE))) * line
    wide = rng.uniform(*TOMATO, len(nodes) + 1)
    stem = Stem(np.array([0.0 * UP, root]), RACHIS)
    out = [SceneObject(name, "pushable", Sphere(wide[0]), np.zeros(3), stem=stem)]
    for k, node in enumerate(nodes, 1):
        slope, aside = float(rng.uniform(*SLOPE)), k * np.pi + float(rng.uniform(-TURN, TURN))
        way = math.sin(slope) * _level(turn + aside) - math.cos(slope) * UP
        end = node * line + (wide[k] + float(rng.uniform(*PEDICEL))) * way
        stem = Stem(np.array([end, node * line]), RACHIS, parent=name)
        out.append(SceneObject(f"{name}-{k}", "pushable", Sphere(wide[k]), end, stem=stem))
    return physical(out, rng)


def _grown(fruits: list[SceneObject], place: FloatArray, vine: FloatArray) -> list[SceneObject]:
    """The fruits at their place, and the branch that holds the peduncle of the first."""
    made, *others = (fruit.shifted(place) for fruit in fruits)
    assert made.stem is not None
    root = made.stem.root + (made.stem.radius + BRANCH) * UP
    way = vine - root
    way[2] = 0.0
    long = float(np.linalg.norm(way))
    turn = to_quaternion(frame_along(way / long))
    branch, at = Capsule(BRANCH, long), root + 0.5 * way
    return [made, *others, SceneObject(f"{made.id}-branch", "static", branch, at, turn)]
