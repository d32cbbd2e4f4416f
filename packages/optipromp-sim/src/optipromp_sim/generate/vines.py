"""Random vines: peppers and cucumbers, whose peduncles a scissor cuts from the side."""

import math

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.geometry.shapes import Capsule, Ellipsoid, Shape
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Approach, Role, Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.generate.bunches import upward

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
SCISSOR = ToolSpec("scissor", {"opening": 0.04, "depth": 0.012})


def sample(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` pushables and a target on one vine: peppers, or cucumbers.

    Each hangs on a peduncle from a branch of the vine.
    """
    peppers, place = bool(rng.integers(2)), rng.uniform(LOW, HIGH)
    turn = math.atan2(place[1], place[0])
    angle = turn + float(rng.uniform(-BEHIND, BEHIND))
    objects, away = _fruit("ripe", "target", peppers, rng), float(rng.uniform(*AWAY))
    vine = place + (objects[0].shape.measure.half[0] + away) * _level(angle)
    objects = _grown(objects, place, vine)
    for k in range(count):
        one, away = _fruit(f"n{k + 1}", "pushable", peppers, rng), float(rng.uniform(*AWAY))
        off = _level(float(rng.uniform(0.0, 2.0 * np.pi)))
        at = vine + (one[0].shape.measure.half[0] + away) * off + float(rng.uniform(*ABOVE)) * UP
        objects += _grown(one, at, vine)
    wood = SceneObject("vine", "static", Capsule(VINE, VINE_LENGTH), vine)
    ahead = _level(turn)
    approach = Approach(direction=ahead, lateral=np.cross(UP, ahead))
    return Scene(name, "panda", (*objects, wood), tool=SCISSOR, approach=approach)


def _level(angle: float) -> FloatArray:
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _fruit(name: str, role: Role, pepper: bool, rng: np.random.Generator) -> list[SceneObject]:
    """A fruit about the origin, on its peduncle."""
    wide = float(rng.uniform(*(PEPPER if pepper else CUCUMBER)))
    half = wide * float(rng.uniform(*PEPPER_LENGTH))
    shape: Shape = Ellipsoid((wide, wide, half))
    if not pepper:
        half = 0.5 * float(rng.uniform(*CUCUMBER_LENGTH))
        shape = Capsule(wide, 2.0 * (half - wide))
    line, radius = upward(rng, LEAN), float(rng.uniform(*PEDUNCLE_RADIUS))
    stem = Stem(np.outer([half, half + float(rng.uniform(*PEDUNCLE))], line), radius)
    physical = {
        "density": PEPPER_DENSITY if pepper else CUCUMBER_DENSITY,
        "stem_stiffness": float(rng.uniform(*MODULUS)) * np.pi / 4.0 * radius**4,
        "abscission_force": HOLDS,
    }
    turn = to_quaternion(frame_along(line))
    return [SceneObject(name, role, shape, np.zeros(3), turn, stem, physical=physical)]


def _grown(fruit: list[SceneObject], place: FloatArray, vine: FloatArray) -> list[SceneObject]:
    """The fruit at its place, and the branch that holds its peduncle."""
    made = fruit[0].shifted(place)
    assert made.stem is not None
    root = made.stem.root + (made.stem.radius + BRANCH) * UP
    way = vine - root
    way[2] = 0.0
    long = float(np.linalg.norm(way))
    turn = to_quaternion(frame_along(way / long))
    branch = Capsule(BRANCH, long)
    return [made, SceneObject(f"{made.id}-branch", "static", branch, root + 0.5 * way, turn)]
