"""Scenes to and from files."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from optipromp.arrays import FloatArray
from optipromp.documents import read_document
from optipromp.errors import InvalidRequestError, InvalidSceneError
from optipromp.files import write_atomically
from optipromp.geometry.shapes import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
)
from optipromp.robots.tools import make_tool
from optipromp.scenes.rotations import from_quaternion, to_quaternion
from optipromp.scenes.scene import (
    STEM_RADIUS,
    Approach,
    JointGoal,
    PoseGoal,
    Scene,
    SceneObject,
    Stem,
    ToolSpec,
    suggest,
)
from optipromp.scenes.schema import MeshToolModel, ObjectModel, SceneModel, ShapeModel, parse

_FARTHEST = 20.0  # [m] a position beyond is taken for millimetres ...
_BEYOND_MILLIMETRES = 5_000.0  # [m] ... except where it is too far even in millimetres
_LARGEST_FRUIT = 1.0  # [m]
_PRIMITIVES: dict[str, Any] = {
    "sphere": Sphere, "box": Box, "cylinder": Cylinder, "capsule": Capsule, "half_space": HalfSpace,
}  # fmt: skip
_SUFFIXES = (".yaml", ".yml", ".json")


def scene_names() -> tuple[str, ...]:
    """Names of the built-in scenes."""
    folder = resources.files("optipromp.scenes") / "data"
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".yaml")))


def load_scene(name_or_path: str | Path) -> Scene:
    """Load a built-in scene by name, or a scene file (YAML, or JSON by its suffix).

    Paths inside the file are relative to it. Lengths are metres unless the file declares a
    ``scale``, which multiplies every length it states (not joint values, nor mesh files, which
    have their own).

    Raises:
        InvalidSceneError: naming the file, the field, the value and what would be right.
    """
    name = str(name_or_path)
    if isinstance(name_or_path, str) and name in scene_names():
        built_in = resources.files("optipromp.scenes") / "data" / f"{name}.yaml"
        with resources.as_file(built_in) as path:
            return scene_from_dict(_read(path), source=f"{name}.yaml")
    path = Path(name_or_path)
    if path.suffix not in _SUFFIXES and not path.exists():
        raise InvalidSceneError(
            f"scene {name!r} is neither a file nor built in: {suggest(name, scene_names())}"
        )
    return scene_from_dict(_read(path), base_dir=path.absolute().parent, source=str(path))


def _read(path: Path) -> Any:
    return read_document(path, InvalidSceneError, "a scene (format: 1, name, robot, ...)")


def scene_from_dict(
    document: Mapping[str, Any], *, base_dir: Path | None = None, source: str = "scene"
) -> Scene:
    """Build a scene from the plain values of a scene file.

    Args:
        document: as in a scene file.
        base_dir: folder that relative paths start from; the working directory where None.
        source: named in refusals.

    Raises:
        InvalidSceneError: as :func:`load_scene`.
    """
    model = parse(document, source)
    scale = 1.0 if model.scale is None else model.scale
    where = ""
    try:
        objects: list[SceneObject] = []
        shapes: dict[tuple[object, ...], Shape] = {}
        for index, item in enumerate(model.objects):
            where = f"objects[{index}]: "
            objects.append(_object(item, scale, base_dir, shapes))
            if model.scale is None:
                _check_magnitude(objects[-1])
        where = ""
        _check_target_key(model, objects)
        if model.goal is not None and model.goal.position is not None and model.scale is None:
            _check_distance("goal.position", np.array(model.goal.position), reachable=False)
        return Scene(
            name=model.name,
            robot=model.robot,
            objects=tuple(objects),
            tool=_tool(model, scale, base_dir),
            start=None if model.start is None else np.array(model.start),
            approach=_approach(model, scale),
            goal=_goal(model, scale),
            options=model.options.model_dump(exclude_none=True),
            base_dir=base_dir,
        )
    except InvalidSceneError as error:
        raise InvalidSceneError(f"{source}: {where}{error.message}") from None


def _object(
    item: ObjectModel, scale: float, base_dir: Path | None, shapes: dict[tuple[object, ...], Shape]
) -> SceneObject:
    stem = None
    if item.stem is not None:
        points = [item.position, item.stem.root] if item.stem.root else item.stem.points
        radius = STEM_RADIUS if item.stem.radius is None else scale * item.stem.radius
        stem = Stem(scale * np.array(points), radius)
    spread = item.covariance
    if spread is None and item.sigma is not None:
        spread = (item.sigma**2 * np.eye(3)).tolist()
    return SceneObject(
        id=item.id,
        role=item.role,
        shape=_shape(item.shape, scale, base_dir, shapes),
        position=scale * np.array(item.position),
        rotation=np.eye(3) if item.orientation is None else from_quaternion(item.orientation),
        stem=stem,
        covariance=None if spread is None else scale**2 * np.array(spread),
        physical=item.physical,
    )


def _shape(
    model: ShapeModel, scale: float, base_dir: Path | None, shapes: dict[tuple[object, ...], Shape]
) -> Shape:
    """The shape; files named twice are read once, and share their distance grid."""
    (name,) = model.model_fields_set
    given = getattr(model, name).model_dump()
    if name in _PRIMITIVES:
        lengths = {key: (scale * np.array(value)).tolist() for key, value in given.items()}
        shape: Shape = _PRIMITIVES[name](**lengths)
        return shape
    from optipromp.geometry.loading import load_cloud, load_mesh

    path = (base_dir or Path()) / given["file"]
    radius = (scale * given["radius"],) if "radius" in given else ()
    key = path, *radius, given["scale"]
    if key not in shapes:
        shapes[key] = load_cloud(*key) if radius else load_mesh(*key)
    return shapes[key]


def _check_magnitude(item: SceneObject) -> None:
    if not isinstance(item.shape, HalfSpace):
        _check_distance("position", item.position, reachable=item.role != "target")
    if item.stem is not None:
        _check_distance("stem.root", item.stem.points[-1], reachable=item.role != "target")
    if isinstance(item.shape, MeshShape | PointCloudShape) and item.radius > _FARTHEST:
        raise InvalidSceneError(
            f"shape {item.shape.path} extends {item.radius:g} m (at most {_FARTHEST:g}): "
            "millimetres? then write scale: 0.001 beside its file"
        )
    if item.role in ("target", "pushable") and item.radius > _LARGEST_FRUIT:
        raise InvalidSceneError(
            f"a {item.role} of radius {item.radius:g} m is too large (at most {_LARGEST_FRUIT:g}): "
            "millimetres? then write scale: 0.001 at the top"
        )


def _check_distance(name: str, position: FloatArray, *, reachable: bool) -> None:
    """Refuse what looks like millimetres.

    A target that would be out of reach even in millimetres is no mistake of units. The planner
    reports that it is out of reach.
    """
    distance = math.hypot(*position)
    if distance <= _FARTHEST or (not reachable and distance > _BEYOND_MILLIMETRES):
        return
    raise InvalidSceneError(
        f"{name} {position.tolist()} is {distance:g} m from the robot (at most {_FARTHEST:g}): "
        "millimetres? then write scale: 0.001 at the top"
    )


def _check_target_key(model: SceneModel, objects: list[SceneObject]) -> None:
    if model.target is None:
        return
    named = next((item for item in objects if item.id == model.target), None)
    if named is None:
        ids = [item.id for item in objects]
        raise InvalidSceneError(
            f"target {model.target!r} is no object: {suggest(model.target, ids)}"
        )
    if named.role != "target":
        raise InvalidSceneError(
            f"object {named.id!r} is named as target and has role {named.role!r}: "
            "must have one role"
        )


def _tool(model: SceneModel, scale: float, base_dir: Path | None) -> ToolSpec | None:
    """The tool; it is built once to check its parameters, and the files of a mesh are read."""
    if model.tool is None:
        return None
    given = model.tool.given
    if isinstance(model.tool, MeshToolModel):
        from optipromp.geometry.loading import load_mesh

        files = given.pop("parts", None) or [given.pop("file")]
        unit = given.pop("scale")
        meshes = tuple(load_mesh((base_dir or Path()) / file, unit) for file in files)
        axis = {"tool_axis": tuple(given.pop("tool_axis"))} if "tool_axis" in given else {}
        point = tuple(scale * value for value in given.pop("tool_point"))
        fixed = {"meshes": meshes, "tool_point": point, **axis}
    else:
        fixed = {"turn": given.pop("turn")} if "turn" in given else {}
    spec = ToolSpec(model.tool.kind, {**fixed, **{k: scale * v for k, v in given.items()}})
    try:
        make_tool(spec.kind, spec.parameters)
    except InvalidRequestError as error:
        raise InvalidSceneError(error.message) from None
    return spec


def _tool_to_dict(tool: ToolSpec, base_dir: Path | None) -> dict[str, Any]:
    out: dict[str, Any] = {"kind": tool.kind, **tool.parameters}
    meshes = out.pop("meshes", ())
    out |= {name: list(value) for name, value in out.items() if isinstance(value, tuple)}
    if meshes:
        shapes = [_shape_to_dict(mesh, base_dir)["mesh"] for mesh in meshes]
        files = [shape["file"] for shape in shapes]
        out |= {"file": files[0]} if len(files) == 1 else {"parts": files}
        out |= {"scale": meshes[0].scale} if meshes[0].scale != 1.0 else {}
    return out


def _approach(model: SceneModel, scale: float) -> Approach:
    given = model.approach
    approach = Approach(np.array(given.direction), np.array(given.lateral))
    if given.camera_distance is None:
        return approach
    return replace(approach, camera_distance=scale * given.camera_distance)


def _goal(model: SceneModel, scale: float) -> JointGoal | PoseGoal | None:
    if model.goal is None:
        return None
    if model.goal.joints is not None:
        return JointGoal(np.array(model.goal.joints))
    axis = model.approach.direction if model.goal.axis is None else model.goal.axis
    return PoseGoal(scale * np.array(model.goal.position), np.array(axis))


def scene_to_dict(scene: Scene, *, base_dir: Path | None = None) -> dict[str, Any]:
    """The scene as plain values, as a scene file holds them.

    Args:
        scene: any scene.
        base_dir: folder that paths are written relative to; absolute where None.

    Raises:
        InvalidSceneError: a mesh or point cloud that came from no file.
    """
    document: dict[str, Any] = {"format": 1, "name": scene.name, "robot": _robot(scene, base_dir)}
    if scene.tool is not None:
        document["tool"] = _tool_to_dict(scene.tool, base_dir)
    if scene.start is not None:
        document["start"] = scene.start.tolist()
    if scene.target is not None:
        document["target"] = scene.target.id
    if scene.goal is not None:
        document["goal"] = _plain(vars(scene.goal))
    names = ("direction", "lateral", "camera_distance")
    document["approach"] = _plain({name: getattr(scene.approach, name) for name in names})
    if scene.options:
        document["options"] = dict(scene.options)
    document["objects"] = [_object_to_dict(item, base_dir) for item in scene.objects]
    if any(_looks_like_millimetres(item) for item in scene.objects):
        document["scale"] = 1.0  # the size is meant: without a scale, loading would refuse it
    return document


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in values.items()}


def _looks_like_millimetres(item: SceneObject) -> bool:
    try:
        _check_magnitude(item)
    except InvalidSceneError:
        return True
    return False


def _robot(scene: Scene, base_dir: Path | None) -> str:
    is_path = Path(scene.robot).suffix != "" or len(Path(scene.robot).parts) > 1
    if not is_path or scene.base_dir is None:
        return scene.robot
    return _relative(scene.base_dir / scene.robot, base_dir)


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
        entry["orientation"] = to_quaternion(item.rotation).tolist()
    if item.stem is not None:
        points = item.stem.points
        if len(points) == 2 and np.array_equal(points[0], item.position):
            entry["stem"] = {"root": points[1].tolist()}
        else:
            entry["stem"] = {"points": points.tolist()}
        if item.stem.radius != STEM_RADIUS:
            entry["stem"]["radius"] = item.stem.radius
    if item.covariance is not None:
        entry["covariance"] = item.covariance.tolist()
    if item.physical:
        entry["physical"] = dict(item.physical)
    return entry


def _shape_to_dict(shape: Shape, base_dir: Path | None) -> dict[str, Any]:
    for name, primitive in _PRIMITIVES.items():
        if isinstance(shape, primitive):
            sizes = vars(shape).items()
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


def save_scene(scene: Scene, path: str | Path) -> None:
    """Write a scene file (JSON where the suffix is ``.json``, else YAML), whole or not at all.

    Loading it gives the scene again; paths in it are relative to its folder.

    Raises:
        InvalidSceneError: a mesh or point cloud that came from no file.
        InvalidRequestError: the file cannot be written.
    """
    path = Path(path)
    document = scene_to_dict(scene, base_dir=path.absolute().parent)
    if path.suffix == ".json":
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    else:
        text = yaml.safe_dump(
            document, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
        )
    write_atomically(path, text.encode("utf-8"))
