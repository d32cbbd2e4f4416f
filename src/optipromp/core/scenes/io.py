"""Scenes to and from files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.documents import built_in, read_named, write_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.geometry.shapes import PRIMITIVES, MeshShape, PointCloudShape, Shape
from optipromp.core.robots.library import NOTHING
from optipromp.core.scenes.crops import crop_in_scene
from optipromp.core.scenes.goals import Goal, RegionGoal
from optipromp.core.scenes.reading import check_magnitude, scene_from_dict
from optipromp.core.scenes.scene import STEM_RADIUS, Scene, SceneObject, ToolSpec

__all__ = ["load_scene", "save_scene", "scene_from_dict", "scene_names", "scene_to_dict"]

_FOLDER = "data"


def scene_names() -> tuple[str, ...]:
    """Names of the built-in scenes."""
    return tuple(built_in(_FOLDER))


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a built-in scene by name, or a scene file (YAML, or JSON by its suffix).

    Paths inside the file are relative to its folder. Lengths are metres unless the file states a
    ``scale``, which multiplies every length in it, but not joint values, nor mesh files, which have
    a scale of their own.

    Raises:
        InvalidSceneError: the scene cannot be used; names the file, the field and the value.
        InvalidRequestError: ``name_or_path`` is neither a name nor a path.
    """
    value: object = name_or_path
    if not isinstance(value, str | Path):
        kind = type(value).__name__
        raise InvalidRequestError(f"a scene is given as {kind}: must be a name or a path")
    holds = "a scene (format: 1, name, robot, ...)"
    document, source, path = read_named(name_or_path, _FOLDER, InvalidSceneError, holds)
    base_dir = None if path is None else path.absolute().parent
    return scene_from_dict(document, base_dir=base_dir, source=source)


def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene file (JSON if the suffix is ``.json``, else YAML), whole or not at all.

    Loading the file returns the same scene; paths in it are relative to its folder.

    Raises:
        InvalidSceneError: a mesh or point cloud was made in memory.
        InvalidRequestError: the file cannot be written.
    """
    path = Path(path)
    write_document(scene_to_dict(scene, base_dir=path.absolute().parent), path)


POSE = ("position", "orientation")


def scene_to_dict(scene: Scene, *, base_dir: Path | None = None) -> dict[str, Any]:
    """The scene as the plain values of a scene file.

    Everything but ``base`` and ``camera`` is in the frame of the robot's base.

    Args:
        scene: any scene.
        base_dir: folder to which paths are relative; None: absolute paths.

    Raises:
        InvalidSceneError: a mesh or point cloud was made in memory.
    """
    document: dict[str, Any] = {"format": 1, "name": scene.name, "robot": _robot(scene, base_dir)}
    if not scene.base.is_identity:
        document |= {"base": _plain(scene.base, POSE), "frame": "base"}
    if scene.camera is not None:
        document["camera"] = _plain(scene.base @ scene.camera, POSE)
    if scene.tool is not None:
        document["tool"] = _tool_to_dict(scene.tool, base_dir)
    document |= _plain(scene, ["start"])
    if scene.target is not None:
        document["target"] = scene.target.id
    if scene.crop is not None:
        document["crop"] = crop_in_scene(scene.crop)
    if scene.goal is not None:
        goals = [_goal_to_dict(goal) for goal in scene.goals]
        document["goal"] = goals if isinstance(scene.goal, tuple) else goals[0]
    if scene.path is not None:
        parts = {name: part for name, part in vars(scene.path).items() if part is not None}
        document["path"] = {name: _plain(part, list(vars(part))) for name, part in parts.items()}
    if scene.waypoints is not None:
        points = [_goal_to_dict(point) for point in scene.waypoints.points]
        document["waypoints"] = {"points": points} | _plain(scene.waypoints, ["speed", "within"])
    stated = ["direction", "lateral", "camera_distance", "cone", "aside"]
    stated += [name for name in ("shift", "lead") if np.any(getattr(scene.approach, name))]
    document["approach"] = _plain(scene.approach, stated)
    if scene.options:
        document["options"] = dict(scene.options)
    document["objects"] = [_object_to_dict(item, base_dir) for item in scene.objects]
    if scene.place is not None:
        document["place"] = _plain(scene.place, ["position", "axis", "retreat"])
    if scene.attached:
        document["attached"] = [
            {"id": item.id, "shape": _shape_to_dict(item.shape, base_dir)}
            | _plain(item, (*POSE, "mass"))
            for item in scene.attached
        ]
    if scene.may_touch:
        document["may_touch"] = [list(pair) for pair in scene.may_touch]
    if scene.padding:
        document["padding"] = scene.padding
    if any(_looks_like_millimetres(item) for item in scene.objects):
        document["scale"] = 1.0  # states that lengths are metres; loading would refuse them else
    return document


def _goal_to_dict(goal: Goal) -> dict[str, Any]:
    entry = _plain(goal, [item.name for item in fields(goal)])
    if isinstance(goal, RegionGoal):
        keys = {"within": "position", "angle": "angle", "box": "orientation"}
        tolerance = {key: entry.pop(name) for name, key in keys.items() if name in entry}
        entry |= {"axis": "free"} if goal.direction is None else {}
        entry |= {"tolerance": tolerance} if tolerance else {}
    return entry


def _plain(value: object, names: Sequence[str]) -> dict[str, Any]:
    """The attributes of these names that are not None, arrays as lists."""
    given = {name: getattr(value, name) for name in names}
    stated = {name: one for name, one in given.items() if one is not None}
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in stated.items()}


def _looks_like_millimetres(item: SceneObject) -> bool:
    try:
        check_magnitude(item)
    except InvalidSceneError:
        return True
    return False


def _robot(scene: Scene, base_dir: Path | None) -> str | dict[str, Any]:
    def moved(path: str | Path) -> str:
        return _relative((scene.base_dir or Path()) / path, base_dir)

    is_path = Path(scene.robot).suffix != "" or len(Path(scene.robot).parts) > 1
    robot = moved(scene.robot) if is_path else scene.robot
    if scene.choice == NOTHING:
        return robot
    chosen = vars(scene.choice) | {
        "srdf": None if scene.choice.srdf is None else moved(scene.choice.srdf),
        "hold": dict(scene.choice.hold),
        "args": dict(scene.choice.args),
        "package_dirs": [moved(folder) for folder in scene.choice.package_dirs],
    }
    del chosen["untrusted"]
    return {"file": robot} | {name: value for name, value in chosen.items() if value}


def _relative(path: Path, base_dir: Path | None) -> str:
    if base_dir is None:
        return os.path.abspath(path)  # noqa: PTH100 - resolve() would follow links
    return Path(os.path.relpath(path.absolute(), base_dir.absolute())).as_posix()


def _object_to_dict(item: SceneObject, base_dir: Path | None) -> dict[str, Any]:
    entry: dict[str, Any] = {
        "id": item.id,
        "role": item.role,
        "shape": _shape_to_dict(item.shape, base_dir),
        "position": item.position.tolist(),
    }
    if not np.array_equal(item.rotation, np.eye(3)):
        entry["orientation"] = item.orientation.tolist()
    if item.stem is not None:
        points = item.stem.points
        if item.stem.unseen:
            entry["stem"] = {
                "unseen": True, "direction": item.stem.vector.tolist(), "length": item.stem.length,
            }  # fmt: skip
        elif len(points) == 2 and np.array_equal(points[0], item.position):
            entry["stem"] = {"root": points[1].tolist()}
        else:
            entry["stem"] = {"points": points.tolist()}
        if item.stem.radius != STEM_RADIUS:
            entry["stem"]["radius"] = item.stem.radius
        entry["stem"] |= _plain(item.stem, ["tilt", "parent"])
    entry |= _plain(item, ["covariance"])
    if item.motion is not None:
        entry["motion"] = _plain(item.motion, ("times", "positions"))
    entry |= _plain(item, ["padding"])
    if item.physical:
        entry["physical"] = dict(item.physical)
    return entry


def _shape_to_dict(shape: Shape, base_dir: Path | None) -> dict[str, Any]:
    for name, primitive in PRIMITIVES.items():
        if isinstance(shape, primitive):
            sizes = [(item.name, getattr(shape, item.name)) for item in fields(shape)]
            return {name: {k: list(v) if isinstance(v, tuple) else v for k, v in sizes}}
    assert isinstance(shape, MeshShape | PointCloudShape)
    if shape.path is None:
        raise InvalidSceneError("a mesh or point cloud made in memory has no file to refer to")
    entry: dict[str, Any] = {"file": _relative(shape.path, base_dir)}
    if shape.scale != 1.0:
        entry["scale"] = shape.scale
    if isinstance(shape, MeshShape):
        return {"mesh": entry}
    return {"point_cloud": {**entry, "radius": shape.radius}}


def _tool_to_dict(tool: ToolSpec, base_dir: Path | None) -> dict[str, Any]:
    out: dict[str, Any] = {"kind": tool.kind, **tool.parameters}
    meshes, fingers = out.pop("meshes", ()), out.pop("finger_meshes", ())
    mount = out.pop("mount", None)
    out |= {name: list(value) for name, value in out.items() if isinstance(value, tuple)}
    if mount is not None:
        out["mount"] = {"position": list(mount[0]), "orientation": list(mount[1])}
    files, sides = (
        [_shape_to_dict(mesh, base_dir)["mesh"]["file"] for mesh in each]
        for each in (meshes, fingers)
    )
    if files:
        out |= {"file": files[0]} if len(files) == 1 else {"parts": files}
    out |= {"fingers": sides} if sides else {}
    for mesh in (*meshes, *fingers)[:1]:
        out |= {"scale": mesh.scale} if mesh.scale != 1.0 else {}
    return out
