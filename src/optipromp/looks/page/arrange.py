"""Changes to a scene: what can be taken hold of, and the scene after it was moved."""

import inspect
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Plan
from optipromp.core.robots.tools import TOOLS
from optipromp.core.scenes.scene import Scene, SceneObject, ToolSpec
from optipromp.core.scenes.trusses import rooted

FRUITS = "all fruits"


@dataclass(frozen=True)
class Grip:
    """What is dragged at once.

    Attributes:
        name: shown to the user; unique in the scene.
        ids: of the objects.
        part: ``object`` (its stem's root stays), ``root`` of its stem, or ``whole``, stem and all.
    """

    name: str
    ids: tuple[str, ...]
    part: str = "object"


def grips(scene: Scene) -> dict[str, Grip]:
    """Everything that can be dragged in a scene, by name; the target comes first."""
    first = sorted(scene.objects, key=lambda item: item.role != "target")
    found = [Grip(item.id, (item.id,)) for item in first]
    hanging = tuple(item.id for item in first if item.stem is not None)
    found += [Grip(f"{name}: stem root", (name,), "root") for name in hanging]
    if len(hanging) > 1:
        found.append(Grip(FRUITS, hanging, "whole"))
    return {grip.name: grip for grip in found}


def place(scene: Scene, grip: Grip) -> FloatArray:
    """Where a grip is (3,) [m]: the object, the root, or the middle of several objects."""
    items = [item for item in scene.objects if item.id in grip.ids]
    points = [item.stem.root if grip.part == "root" and item.stem else item.position
              for item in items]  # fmt: skip
    return np.asarray(np.mean(points, axis=0))


def moved(scene: Scene, grip: Grip, to: FloatArray) -> Scene:
    """The scene with a grip at ``to`` (3,) [m].

    Raises:
        InvalidSceneError: a stem without length.
    """
    shift = np.asarray(to) - place(scene, grip)
    objects = (
        _shifted(item, shift, grip.part) if item.id in grip.ids else item for item in scene.objects
    )
    return replace(scene, objects=rooted(objects))


def _shifted(item: SceneObject, shift: FloatArray, part: str) -> SceneObject:
    position, stem = item.position, item.stem
    if part != "root":
        position = position + shift
    if stem is not None:
        points = np.array(stem.points)
        rows = {"object": slice(0, 1), "root": slice(-1, None), "whole": slice(None)}[part]
        points[rows] += shift
        stem = replace(stem, points=points)
    return replace(item, position=position, stem=stem)


def tool_radius(scene: Scene) -> float | None:
    """The radius of the scene's tool [m]; None where the scene names no tool that has one."""
    if scene.tool is None:
        return None
    known = inspect.signature(TOOLS[scene.tool.kind]).parameters
    if "radius" not in known:
        return None
    return float(scene.tool.parameters.get("radius", known["radius"].default))


def with_radius(scene: Scene, radius: float) -> Scene:
    """The scene whose tool has another radius [m]."""
    assert scene.tool is not None
    parameters = {**scene.tool.parameters, "radius": radius}
    return replace(scene, tool=ToolSpec(scene.tool.kind, parameters))


def sigma(scene: Scene) -> float:
    """Largest standard deviation of a coordinate of a fruit's detected position [m]."""
    variances = [np.trace(item.covariance) / 3.0 for item in scene.objects
                 if item.covariance is not None]  # fmt: skip
    return float(np.sqrt(max(variances, default=0.0)))


def with_sigma(scene: Scene, value: float) -> Scene:
    """The scene whose target and pushables were detected with this standard deviation [m]."""
    objects = (
        replace(item, covariance=None, sigma=value or None)
        if item.role in ("target", "pushable") else item for item in scene.objects
    )  # fmt: skip
    return replace(scene, objects=tuple(objects))


def complaint(found: Plan | OptiPrompError) -> str:
    """What the command line says of a failure; empty for a success."""
    if isinstance(found, OptiPrompError):
        return f"error {found.code}: {' '.join(found.message.split())}"
    return "" if found.success else f"{found.status}: {found.message}"


def culprit(scene: Scene, found: Plan | OptiPrompError, dragged: Grip | None) -> FloatArray:
    """Where (3,) [m] the cause of a failure is.

    It is at the object that the plan touches, or the first one that the message names; else at
    what was dragged last, the target, or the end of the tool's way.
    """
    by_id = {item.id: item for item in scene.objects}
    words = [] if isinstance(found, OptiPrompError) else [c.other for c in found.contacts]
    message = found.message.replace("'", " ").replace(",", " ").replace(":", " ").split()
    for word in [*words, *message]:
        if word in by_id:
            return by_id[word].position
    if dragged is not None and set(dragged.ids) <= by_id.keys():
        return place(scene, dragged)
    if scene.target is not None:
        return scene.target.position
    if isinstance(found, OptiPrompError):
        return np.zeros(3)
    return np.asarray(found.robot.tool_pose(found.trajectory.positions[-1])[0])
