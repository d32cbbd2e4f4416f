"""Changes to a scene: the grips by which objects are dragged, and the scene after a move."""

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
    """Objects, or parts of them, that are dragged together."""

    name: str  # shown to the user; unique in the scene
    ids: tuple[str, ...]  # of the objects
    # ``object`` (the root of its stem stays), ``root`` (of its stem), or ``whole`` (the object and
    # its stem)
    part: str = "object"


def grips(scene: Scene) -> dict[str, Grip]:
    """All grips of a scene by name; the target comes first."""
    first = sorted(scene.objects, key=lambda item: item.role != "target")
    found = [Grip(item.id, (item.id,)) for item in first]
    hanging = tuple(item.id for item in first if item.stem is not None)
    found += [Grip(f"{name}: stem root", (name,), "root") for name in hanging]
    if len(hanging) > 1:
        found.append(Grip(FRUITS, hanging, "whole"))
    return {grip.name: grip for grip in found}


def place(scene: Scene, grip: Grip) -> FloatArray:
    """The position (3,) of a grip [m]: the object's, the root's, or the mean of several."""
    items = [item for item in scene.objects if item.id in grip.ids]
    points = [
        item.stem.root if grip.part == "root" and item.stem else item.position for item in items
    ]
    return np.asarray(np.mean(points, axis=0))


def moved(scene: Scene, grip: Grip, to: FloatArray) -> Scene:
    """The scene with a grip at ``to`` (3,) [m]."""
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
    motion = item.motion and item.motion.shifted(position - item.position)
    return replace(item, position=position, stem=stem, motion=motion)


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
    variances = [
        np.trace(item.covariance) / 3.0 for item in scene.objects if item.covariance is not None
    ]
    return float(np.sqrt(max(variances, default=0.0)))


def with_sigma(scene: Scene, value: float) -> Scene:
    """The scene whose target and pushables were detected with this standard deviation [m]."""
    objects = (
        replace(item, covariance=None, sigma=value or None)
        if item.role in ("target", "pushable")
        else item
        for item in scene.objects
    )
    return replace(scene, objects=tuple(objects))


def culprit(scene: Scene, found: Plan | OptiPrompError, dragged: Grip | None) -> FloatArray:
    """The position (3,) of the cause of a failure [m].

    It is that of the object that the plan touches, or of the first object that the message names;
    else of the grip that was dragged last, the target, or the last tool point.
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
