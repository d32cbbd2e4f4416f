"""Scenes to and from files."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import built_in, read_named, write_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError, suggest
from optipromp.core.files import check_inside
from optipromp.core.geometry.shapes import PRIMITIVES, MeshShape, PointCloudShape, Shape
from optipromp.core.robots.library import NOTHING, UNTRUSTED, Choice, robot_names
from optipromp.core.robots.tools import make_tool
from optipromp.core.scenes import goals
from optipromp.core.scenes.crops import Crop, crop_in_scene, crop_names, load_crop
from optipromp.core.scenes.goals import Goal, RegionGoal
from optipromp.core.scenes.held import Place
from optipromp.core.scenes.objects import ObjectMotion, cleared
from optipromp.core.scenes.pose import Pose, unit
from optipromp.core.scenes.scene import (
    STEM_RADIUS,
    Approach,
    Attached,
    Scene,
    SceneObject,
    Stem,
    ToolSpec,
)
from optipromp.core.scenes.schema import MeshToolModel, parse, values

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
        InvalidSceneError: a mesh or point cloud was made in memory; lengths look like millimetres,
            and the scene does not state that they are ``metres``.
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
    stated += [name for name in ("shift", "lead", "truss") if np.any(getattr(scene.approach, name))]
    document["approach"] = _plain(scene.approach, stated)
    if scene.options:
        document["options"] = dict(scene.options)
    document["objects"] = [_object_to_dict(item, base_dir) for item in scene.objects]
    if scene.unseen is not None:
        document["unseen"] = _object_to_dict(scene.unseen, base_dir)
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
    try:
        for item in scene.objects:
            check_magnitude(item)  # as loading does
    except InvalidSceneError:
        if not scene.metres:
            raise
        document["scale"] = 1.0
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


_FARTHEST = 20.0  # [m] chosen: a larger distance is a number in millimetres,
_BEYOND_MILLIMETRES = 5_000.0  # [m] chosen: unless it is beyond reach even in millimetres
TWINS = 0.5  # of the smaller radius, the least distance of two fruits' centres, chosen
_LARGEST_FRUIT = 1.0  # [m] chosen


def scene_from_dict(
    document: Mapping[str, Any], *, base_dir: Path | None = None, source: str = "scene"
) -> Scene:
    """Build a scene from the plain values of a scene file.

    Args:
        document: the content of a scene file.
        base_dir: folder where relative paths start; None: the working directory.
        source: the name of the document in messages.

    Raises:
        InvalidSceneError: as :func:`load_scene`.
    """
    model = parse(document, source)
    scale = 1.0 if model.scale is None else model.scale
    where = ""
    try:
        frames = _frames(model, scale)
        default = frames[model.frame]
        told = " in the base's frame" if model.base is not None or model.camera is not None else ""
        made: list[SceneObject] = []
        shapes: dict[tuple[object, ...], Shape] = {}
        last = [] if model.unseen is None else [model.unseen]
        for index, item in enumerate([*model.objects, *last]):
            where = f"objects[{index}]: " if index < len(model.objects) else "unseen: "
            frame = default if item.frame is None else frames[item.frame]
            up = frame.rotation.T @ frames["world"].rotation[:, 2]
            read = object_of(item, scale, base_dir, shapes, up)
            made.append(read if frame.is_identity else read.transformed(frame))
            if model.scale is None:
                check_magnitude(made[-1], told)
        where, objects = "", made[: len(model.objects)]
        _tell_twins(objects, source)
        _check_target_key(model, objects)
        _, lateral, vertical = frames["world"].rotation.T
        _tell_standing(objects, vertical, source)
        usual = {"direction": vertical, "lateral": lateral}
        given = model.goal
        wanted = tuple(
            _goal_of(one, scale, default)
            for one in (given if isinstance(given, list) else [given])
            if one is not None
        )
        for one in wanted:
            if not isinstance(one, goals.JointGoal) and model.scale is None:
                _check_distance("goal.position", one.position, told, reachable=False)
        lines = _lines_of(model.waypoints, scale, default)
        for k, point in enumerate([] if lines is None or model.scale is not None else lines.points):
            _check_distance(f"waypoints[{k}].position", point.position, told, reachable=False)
        return Scene(
            name=model.name,
            robot=model.robot if isinstance(model.robot, str) else model.robot.file,
            choice=_choice(model.robot, base_dir),
            objects=cleared(objects, vertical),
            tool=_tool(model, scale, base_dir),
            start=None if model.start is None else np.array(model.start),
            approach=Approach(**(usual | values(model.approach, scale, default))),
            goal=wanted if isinstance(given, list) else next(iter(wanted), None),
            path=_path_of(model.path, scale, default, frames["world"]),
            waypoints=lines,
            options=values(model.options, scale),
            base_dir=base_dir,
            base=Pose() if model.base is None else Pose(**values(model.base, scale)),
            camera=None if model.camera is None else frames["camera"],
            attached=tuple(
                Attached(**_shaped(item, scale, base_dir, shapes)) for item in model.attached
            ),
            may_touch=tuple((a, b) for a, b in model.may_touch),
            padding=scale * model.padding,
            place=None if model.place is None else Place(**values(model.place, scale, default)),
            crop=None if model.crop is None else _crop(model.crop, base_dir),
            metres=model.scale is not None,
            unseen=next(iter(made[len(objects) :]), None),
        )
    except InvalidSceneError as error:
        raise InvalidSceneError(f"{source}: {where}{error.message}") from None


def _inside(name: str, base_dir: Path | None) -> Path:
    """The path of a file that the scene names; refused outside the allowed folders."""
    return check_inside((base_dir or Path()) / name, base_dir, InvalidSceneError)


def _crop(crop: Any, base_dir: Path | None) -> Crop:
    is_file = isinstance(crop, str) and crop not in crop_names()
    return load_crop(_inside(crop, base_dir) if is_file else crop)


def _choice(robot: Any, base_dir: Path | None) -> Choice:
    if isinstance(robot, str):
        if robot not in robot_names():
            _inside(robot, base_dir)
        return UNTRUSTED
    for name in (robot.file, *([robot.srdf] if robot.srdf else []), *robot.package_dirs):
        _inside(name, base_dir)
    stated = values(robot, 1.0)
    del stated["file"]
    folders = tuple(stated.pop("package_dirs", ()))
    return Choice(**stated, package_dirs=folders, untrusted=True)


def _frames(model: Any, scale: float) -> dict[str, Pose]:
    """The poses, in the base frame, of the frames in which the file may state values."""
    poses = {}
    for name, given in (("base", model.base), ("camera", model.camera)):
        try:
            poses[name] = Pose() if given is None else Pose(**values(given, scale))
        except InvalidSceneError as error:
            raise InvalidSceneError(f"{name}.{error.message}") from None
    world = Pose() if model.base is None else poses["base"].inverse()
    return {"base": Pose(), "world": world, "camera": world @ poses["camera"]}


def _shaped(
    item: Any, scale: float, base_dir: Path | None, shapes: dict[tuple[object, ...], Shape]
) -> dict[str, Any]:
    """The values of an item that has a shape, in the frame of its values in the file."""
    return values(item, scale) | {"shape": _shape(item.shape, scale, base_dir, shapes)}


def object_of(
    item: Any, scale: float, base_dir: Path | None,
    shapes: dict[tuple[object, ...], Shape], up: FloatArray,
) -> SceneObject:  # fmt: skip
    """The object, in the frame of its values in the file, in which ``up`` (3,) is upwards."""
    stated = _shaped(item, scale, base_dir, shapes)
    stated.pop("frame", None)
    position, velocity = stated["position"], stated.pop("velocity", None)
    if item.stem is not None:
        stated["stem"] = _stem(values(item.stem, scale), position, up)
    if velocity is not None:
        stated["motion"] = ObjectMotion.steady(position, velocity)
    elif item.motion is not None:
        stated["motion"] = ObjectMotion(**values(item.motion, scale))
    return SceneObject(**stated)


def _stem(stated: dict[str, Any], position: FloatArray, up: FloatArray) -> Stem:
    """The stem of a fruit at ``position`` (3,), in whose frame ``up`` (3,) is upwards."""
    unseen, way = stated.pop("unseen"), stated.pop("direction", None)
    if unseen:
        return Stem.hidden(position, up if way is None else way, **stated)
    if way is not None:
        along = stated.pop("length") * unit("stem.direction", way)
        stated["points"] = np.array([position, position + along])
    elif "root" in stated:
        stated["points"] = np.array([position, stated.pop("root")])
    return Stem(**stated)


def _shape(
    model: Any, scale: float, base_dir: Path | None, shapes: dict[tuple[object, ...], Shape]
) -> Shape:
    """The shape. A file that several objects name is read once; they share its distance grid."""
    (name,) = model.model_fields_set
    given = values(getattr(model, name), scale)
    if name in PRIMITIVES:
        shape: Shape = PRIMITIVES[name](**given)
        return shape
    from optipromp.core.geometry.loading import load_cloud, load_mesh

    path = _inside(given["file"], base_dir)
    radius = (given["radius"],) if "radius" in given else ()
    key = path, *radius, given["scale"]
    if key not in shapes:
        shapes[key] = load_cloud(*key) if radius else load_mesh(*key)
    return shapes[key]


def check_magnitude(item: SceneObject, told: str = "") -> None:
    """Refuse an object whose numbers look like millimetres; ``told`` names their frame."""
    reachable = item.role != "target"
    if math.isfinite(item.radius):
        _check_distance("position", item.position, told, reachable=reachable)
    if item.stem is not None:
        _check_distance("stem.root", item.stem.root, told, reachable=reachable)
    if isinstance(item.shape, MeshShape | PointCloudShape) and item.radius > _FARTHEST:
        raise InvalidSceneError(
            f"shape {item.shape.path} extends {item.radius:g} m (at most {_FARTHEST:g}): "
            "millimetres? then write scale: 0.001 beside its file"
        )
    if _FARTHEST < item.radius < math.inf:  # a floor may be large
        warnings.warn(
            f"object {item.id!r} reaches {item.radius:g} m: millimetres? then write scale: 0.001 "
            "at the top",
            stacklevel=2,
        )
    if item.role in ("target", "pushable") and item.radius > _LARGEST_FRUIT:
        raise InvalidSceneError(
            f"a {item.role} of radius {item.radius:g} m is too large (at most {_LARGEST_FRUIT:g}): "
            "millimetres? then write scale: 0.001 at the top"
        )


def _check_distance(name: str, position: FloatArray, told: str, *, reachable: bool) -> None:
    """Refuse a position that looks like millimetres.

    A target beyond :data:`_BEYOND_MILLIMETRES` is no mistake of units: the planner reports that it
    is out of reach.
    """
    distance = math.hypot(*position)
    if distance <= _FARTHEST or (not reachable and distance > _BEYOND_MILLIMETRES):
        return
    raise InvalidSceneError(
        f"{name} {position.tolist()}{told} is {distance:g} m from the robot "
        f"(at most {_FARTHEST:g}): millimetres? then write scale: 0.001 at the top"
    )


def _tell_twins(objects: Sequence[SceneObject], source: str) -> None:
    """Warn of the first fruit whose centre is inside another: probably it was detected twice."""
    fruits = [item for item in objects if item.role in ("target", "pushable")]
    places = np.array([item.position for item in fruits]).reshape(-1, 3)
    sizes = np.array([item.radius for item in fruits])
    for k, item in enumerate(fruits):
        away = np.linalg.norm(places[:k] - places[k], axis=1)
        inside = np.flatnonzero(away < TWINS * np.minimum(sizes[:k], sizes[k]))
        if len(inside):
            other = int(inside[0])
            warnings.warn(
                f"{source}: the centres of {fruits[other].id!r} and {item.id!r} are "
                f"{1e3 * away[other]:.0f} mm apart: one fruit that was detected twice? leave "
                "out one",
                stacklevel=4,
            )
            return


def _tell_standing(objects: Sequence[SceneObject], up: FloatArray, source: str) -> None:
    """Warn of fruits that stand on their stems while others hang."""
    rise = {i.id: float(i.stem.vector @ up) / i.radius for i in objects if i.stem is not None}
    low = [name for name, share in rise.items() if share < -1.0]
    if low and max(rise.values()) > 1.0:
        told = f"{source}: {', '.join(low)} would stand, while others hang: is a root too low?"
        warnings.warn(told, stacklevel=4)


def _check_target_key(model: Any, objects: list[SceneObject]) -> None:
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


def _tool(model: Any, scale: float, base_dir: Path | None) -> ToolSpec | None:
    """The tool. It is built once to check its parameters; mesh files are read."""
    if model.tool is None:
        return None
    given = model.tool.given
    if isinstance(model.tool, MeshToolModel):
        from optipromp.core.geometry.loading import load_mesh

        unit = given.pop("scale")

        def loaded(files: list[str]) -> tuple[MeshShape, ...]:
            return tuple(load_mesh(_inside(file, base_dir), unit) for file in files)

        whole = [given.pop("file")] if "file" in given else given.pop("parts", [])
        meshes, sides = loaded(whole), loaded(given.pop("fingers", []))
        axis = {"tool_axis": tuple(given.pop("tool_axis"))} if "tool_axis" in given else {}
        point = tuple(scale * value for value in given.pop("tool_point"))
        fixed = {"meshes": meshes, "tool_point": point, **axis}
        fixed |= {"finger_meshes": sides} if sides else {}
    else:
        fixed = {name: given.pop(name) for name in ("turn", "angle", "taper") if name in given}
    if (mount := model.tool.mount) is not None:
        at = tuple(scale * value for value in mount.position)
        fixed["mount"] = at, tuple(mount.orientation)
    spec = ToolSpec(model.tool.kind, {**fixed, **{k: scale * v for k, v in given.items()}})
    try:
        make_tool(spec.kind, spec.parameters)
    except InvalidRequestError as error:
        raise InvalidSceneError(error.message) from None
    return spec


def _goal_of(given: Any, scale: float, frame: Pose) -> goals.Goal:
    """The goal in the base frame."""
    if given.joints is not None:
        return goals.JointGoal(np.array(given.joints))
    if given.axis and given.tolerance is None:
        return goals.PoseGoal(**values(given, scale, frame))
    stated, allowed = values(given, scale), {}
    if given.tolerance is not None:
        allowed = values(stated.pop("tolerance"), scale)
    keys = {"within": "position", "angle": "angle", "box": "orientation"}
    stated |= {name: allowed[key] for name, key in keys.items() if key in allowed}
    if len(within := stated.get("within", ())) == 1:
        stated["within"] = float(within[0])
    region = goals.RegionGoal(**stated)
    return region if frame.is_identity else region.transformed(frame)


def _lines_of(given: Any, scale: float, frame: Pose) -> goals.Lines | None:
    """The way points in the base frame."""
    if given is None:
        return None
    points = []
    for k, one in enumerate(given.points):
        try:
            pose = goals.RegionGoal(**values(one, scale))
        except InvalidSceneError as error:
            words = error.message.removeprefix("goal.")
            raise InvalidSceneError(f"waypoints[{k}].{words}") from None
        points.append(pose if frame.is_identity else pose.transformed(frame))
    return goals.Lines(**(values(given, scale) | {"points": tuple(points)}))


def _path_of(given: Any, scale: float, frame: Pose, world: Pose) -> goals.PathConstraints | None:
    """The constraints of the path in the base frame; upright is by default up in the world."""
    if given is None:
        return None
    upright = plane = None
    if given.upright is not None:
        up = {"direction": world.rotation[:, 2]}
        upright = goals.HeldUpright(**(up | values(given.upright, scale, frame)))
    if given.plane is not None:
        plane = goals.OnPlane(**values(given.plane, scale, frame))
    return goals.PathConstraints(upright, plane)
