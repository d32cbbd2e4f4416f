"""Scenes from the plain values of scene files."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import check_inside
from optipromp.core.geometry.shapes import PRIMITIVES, MeshShape, PointCloudShape, Shape
from optipromp.core.robots.library import UNTRUSTED, Choice, robot_names
from optipromp.core.robots.tools import make_tool
from optipromp.core.scenes import goals
from optipromp.core.scenes.crops import Crop, crop_names, load_crop
from optipromp.core.scenes.held import Place
from optipromp.core.scenes.objects import ObjectMotion, cleared
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Approach, Attached, Scene, SceneObject, Stem, ToolSpec
from optipromp.core.scenes.schema import MeshToolModel, parse, values
from optipromp.core.scenes.values import suggest, unit

_FARTHEST = 20.0  # [m] chosen: a larger distance is a number in millimetres,
_BEYOND_MILLIMETRES = 5_000.0  # [m] chosen: unless it is beyond reach even in millimetres
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
        objects: list[SceneObject] = []
        shapes: dict[tuple[object, ...], Shape] = {}
        for index, item in enumerate(model.objects):
            where = f"objects[{index}]: "
            frame = default if item.frame is None else frames[item.frame]
            up = frame.rotation.T @ frames["world"].rotation[:, 2]
            made = _object(item, scale, base_dir, shapes, up)
            objects.append(made if frame.is_identity else made.transformed(frame))
            if model.scale is None:
                check_magnitude(objects[-1], told)
        where = ""
        _check_target_key(model, objects)
        _, lateral, vertical = frames["world"].rotation.T
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


def _object(
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
        fixed = {name: given.pop(name) for name in ("turn", "angle") if name in given}
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
