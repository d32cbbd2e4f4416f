"""Random beds: mushrooms and asparagus, which stand on stems from below."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Box, Capsule, Sphere
from optipromp.core.scenes.objects import least_of, mass_of
from optipromp.core.scenes.scene import Approach, Role, Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.generate.bunches import upward
from optipromp_sim.generate.checks import OverlapError

UP = np.array([0.0, 0.0, 1.0])
Grow = Callable[[str, Role, FloatArray, np.random.Generator], SceneObject]

# choices; a number between two ends is sampled uniformly; lengths in [m]
MIDDLE_LOW, MIDDLE_HIGH = (0.42, -0.08), (0.52, 0.08)  # x and y of the target
BED = (0.40, 0.50, 0.02)  # size of what they grow from
ROOT = 0.01  # of the roots over the bed, which the stems do not touch
STIFFER = (1.0, 5.0)  # stiffness of a stem over the least one that stands: a guess
PLACES_TRIED = 100  # for a fruit before the bed is sampled again
CAP_TOP, SPEAR_TOP = (0.05, 0.15), (0.20, 0.28)  # height of a bed of mushrooms, of asparagus
CAP, CAP_LENGTH = (0.015, 0.025), (0.015, 0.035)  # radius of a cap, a ball; stem under it
CAP_STEM = 0.007  # radius of a mushroom's stem
CAP_GAP, SPEAR_GAP = (0.002, 0.025), (0.02, 0.10)  # between neighbours, level
SPEAR, SPEAR_LENGTH = (0.005, 0.008), (0.12, 0.18)  # radius and whole length of a spear
SPEAR_STEM = (0.02, 0.04)  # length of what bends under a spear, which is as thick
SPEAR_LEAN = np.deg2rad(5.0)  # [rad] of a spear from plumb, at most


def mushrooms(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` pushables and a target, taken from above by a suction cup."""
    tool = ToolSpec("suction", {"radius": 0.012})
    fruits, ground = _bed(count, CAP_TOP, _mushroom, CAP_GAP, rng)
    return Scene(name, "panda", (*fruits, ground), tool=tool, approach=Approach(direction=-UP))


def asparagus(name: str, count: int, rng: np.random.Generator) -> Scene:
    """One sample of ``count`` pushables and a target, taken from the side by fingers."""
    tool = ToolSpec("finger_gripper", {"opening": 0.05, "finger_length": 0.06, "palm_length": 0.05})
    fruits, ground = _bed(count, SPEAR_TOP, _spear, SPEAR_GAP, rng)
    approach = Approach(direction=np.array([1.0, 0.0, 0.0]))
    return Scene(name, "panda", (*fruits, ground), tool=tool, approach=approach)


def _bed(
    count: int, top: tuple[float, float], grow: Grow, gap: tuple[float, float],
    rng: np.random.Generator,
) -> tuple[list[SceneObject], SceneObject]:  # fmt: skip
    """A target and ``count`` pushables, each stem of a stiffness of its own, and the bed."""
    middle = np.append(rng.uniform(MIDDLE_LOW, MIDDLE_HIGH), float(rng.uniform(*top)))
    roots, fruits = [middle + ROOT * UP], list[SceneObject]()
    fruits.append(grow("ripe", "target", roots[0], rng))
    for _ in range(PLACES_TRIED * count):
        near, turn = int(rng.integers(len(fruits))), float(rng.uniform(0.0, 2.0 * np.pi))
        made = grow(f"n{len(fruits)}", "pushable", np.zeros(3), rng)
        wide = made.shape.measure.half[0] + np.array(
            [each.shape.measure.half[0] for each in fruits]
        )
        away = wide[near] + float(rng.uniform(*gap))
        root = roots[near] + away * np.array([np.cos(turn), np.sin(turn), 0.0])
        made = made.shifted(root)
        off = np.linalg.norm([(made.position - each.position)[:2] for each in fruits], axis=1)
        if (off > wide + gap[0]).all():
            roots, fruits = [*roots, root], [*fruits, made]
        if len(fruits) > count:
            break
    else:
        raise OverlapError("no place for a fruit")
    for k, item in enumerate(fruits):
        stiff = float(rng.uniform(*STIFFER)) * least_of(item, mass_of(item), UP)
        fruits[k] = replace(item, physical={"stem_stiffness": stiff})
    return fruits, SceneObject("bed", "static", Box(BED), middle - 0.5 * BED[2] * UP)


def _mushroom(name: str, role: Role, root: FloatArray, rng: np.random.Generator) -> SceneObject:
    radius = float(rng.uniform(*CAP))
    top = root + (float(rng.uniform(*CAP_LENGTH)) + radius) * UP
    return SceneObject(name, role, Sphere(radius), top, stem=Stem(np.array([top, root]), CAP_STEM))


def _spear(name: str, role: Role, root: FloatArray, rng: np.random.Generator) -> SceneObject:
    radius, length = float(rng.uniform(*SPEAR)), float(rng.uniform(*SPEAR_LENGTH))
    line = upward(rng, SPEAR_LEAN)
    foot = root + float(rng.uniform(*SPEAR_STEM)) * line
    turn = np.append(1.0 + line[2], np.cross(UP, line))
    shape, stem = Capsule(radius, length - 2.0 * radius), Stem(np.array([foot, root]), radius)
    middle = foot + 0.5 * length * line
    return SceneObject(name, role, shape, middle, turn / np.linalg.norm(turn), stem)
