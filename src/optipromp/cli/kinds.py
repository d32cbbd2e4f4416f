"""What kind of input a path or name is."""

from enum import StrEnum
from pathlib import Path

from optipromp.errors import InvalidRequestError, InvalidSceneError

_SCENE_KEYS = frozenset({"objects", "robot", "target", "goal", "approach", "start"})
_PLAN_KEYS = frozenset({"planner", "status", "metrics", "terms"})


class Kind(StrEnum):
    """The kinds of input."""

    SCENE = "scene"
    ROBOT = "robot"
    DEMONSTRATIONS = "demonstrations"
    PRIMITIVE = "primitive"
    PLAN = "plan"


def kind_of(item: str) -> Kind:
    """Tell the kind by built-in name, by file name, and for YAML, JSON and NPZ by a look inside.

    Raises:
        InvalidRequestError: no such file or built-in name, or a file that is none of the kinds.
    """
    from optipromp.robots.library import robot_names
    from optipromp.scenes.io import scene_names

    if item in scene_names():
        return Kind.SCENE
    if item in robot_names():
        return Kind.ROBOT
    path = Path(item)
    if path.is_dir():
        return Kind.PLAN if (path / "plan.json").exists() else Kind.DEMONSTRATIONS
    if not path.exists():
        names = ", ".join([*scene_names(), *robot_names()])
        raise InvalidRequestError(
            f"no file and nothing built in is called {item}; there is {names}"
        )
    match path.suffix.lower():
        case ".urdf" | ".xml" | ".xacro":
            return Kind.ROBOT
        case ".csv":
            return Kind.DEMONSTRATIONS
        case ".npz":
            return Kind.PRIMITIVE if is_primitive(path) else Kind.DEMONSTRATIONS
        case ".yaml" | ".yml" | ".json":
            return _inside(path)
    raise InvalidRequestError(
        f"cannot tell what {item} is: a scene or robot file ends in .yaml, .yml or .json, "
        "a URDF in .urdf, demonstrations in .npz or .csv"
    )


def is_primitive(path: Path) -> bool:
    """Whether ``path`` is a file that ``optipromp learn`` (``ProMP.save``) wrote."""
    import zipfile

    try:
        with zipfile.ZipFile(path) as archive:
            return {"basis.npy", "mean.npy", "covariance.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _inside(path: Path) -> Kind:
    from optipromp.scenes.documents import read_document

    try:
        content = read_document(path)
    except InvalidSceneError:
        return Kind.SCENE  # its loader says what is wrong, and where
    if not isinstance(content, dict):
        return Kind.SCENE
    if content.keys() >= _PLAN_KEYS:
        return Kind.PLAN
    return Kind.SCENE if _SCENE_KEYS & content.keys() else Kind.ROBOT
