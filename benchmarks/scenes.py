"""The scenes that plans are measured on: the paper's, the same perturbed, and generated ones."""

from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp_sim.generate import Preset, generate

DEVIATION = 0.005  # [m] standard deviation of every fruit's centre
GENERATED: tuple[Preset, ...] = ("cluster", "side-clusters", "table-top", "mixed")
SEEDS = 5


def perturbed(scene: Scene, rng: np.random.Generator) -> Scene:
    """The scene with its fruits moved by N(0, 5 mm); the roots of their stems stay."""
    hanging = ("target", "pushable")
    objects = tuple(
        _moved(obj, rng.normal(0.0, DEVIATION, 3)) if obj.role in hanging else obj
        for obj in scene.objects
    )
    return replace(scene, objects=objects)


def _moved(obj: SceneObject, by: FloatArray) -> SceneObject:
    stem = obj.stem
    if stem is not None:
        points = np.array(stem.points)
        points[0] += by
        stem = Stem(points, stem.radius)
    return replace(obj, position=obj.position + by, stem=stem)


def many(name: str, count: int, seed: int = 0) -> list[Scene]:
    """``count`` perturbed scenes of a built-in one."""
    rng = np.random.default_rng(seed)
    scene = load_scene(name)
    return [perturbed(scene, rng) for _ in range(count)]


def groups(quick: bool = False) -> dict[str, list[Scene]]:
    """What planners are compared on: the two scenarios, and generated clutter."""
    seeds = range(1 if quick else SEEDS)
    return {
        "scenario-3": [load_scene("scenario-3")],
        "scenario-4": [load_scene("scenario-4")],
        "generated": [generate(preset, seed) for preset in GENERATED for seed in seeds],
    }
