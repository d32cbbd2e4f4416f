"""Where the scenes of a study are from: a preset draws them, or they are files of a folder."""

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from optipromp.core.robots.library import Choice
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.generate import Noise, Preset, generate_with_report, noisy
from optipromp.laboratory.generate.noise import perceived

Source = Preset | Path
"""A preset, or the path of a scene file."""

OWN = ""
"""In place of a robot's name: the robot that a scene file names."""


def source_name(source: Source) -> str:
    """By which rows name a source: the preset, or the file's name."""
    return source.name if isinstance(source, Path) else source


def drawn(source: Source, seed: int, robot: str | Path, choice: Choice) -> tuple[Scene, int]:
    """The true scene of a source and a seed, and the number of scenes drawn before it.

    A scene file gives the same scene for every seed. ``robot`` takes the place of its own, unless
    it is :data:`OWN`; ``choice`` is of the arm in the robot's file.
    """
    if not isinstance(source, Path):
        scene, report = generate_with_report(source, seed, robot, choice)
        return scene, report.redraws
    scene = load_scene(source)
    if robot != OWN:
        name = str(Path(robot).absolute()) if Path(robot).suffix else str(robot)
        return replace(scene, robot=name, choice=choice), 0
    return replace(scene, choice=replace(choice, untrusted=scene.choice.untrusted)), 0


def detected(source: Source, scene: Scene, seed: int, errors: Noise) -> Scene:
    """A scene as the planner sees it.

    The physical parameters that a preset drew are hidden from the planner. Those that a scene file
    states are known, and without errors of detection the file is seen as it is.
    """
    if not isinstance(source, Path):
        return noisy(scene, seed, errors)
    if errors == Noise():
        return scene
    return perceived(scene, np.random.default_rng([seed, 1]), errors)


def digests(files: Sequence[Path]) -> Mapping[str, str]:
    """A digest of each file's content, by the file's name."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest()[:16] for file in files}
