"""Robots by name or by file."""

from functools import lru_cache
from pathlib import Path

from optipromp.errors import InvalidRobotError
from optipromp.robots.files import robot_from_file, robot_from_urdf
from optipromp.robots.model import Robot

_DATA = Path(__file__).resolve().parent / "data"


@lru_cache
def robot_names() -> tuple[str, ...]:
    """The built-in robots."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.yaml")))


def load_robot(name_or_path: str | Path, base_dir: Path | None = None) -> Robot:
    """A robot without a tool: a built-in one by name, or from a ``.urdf`` or ``.yaml`` robot file.

    A relative path starts at ``base_dir`` (default: the working directory).

    Raises:
        InvalidRobotError: no such robot (the message lists the built-in names), or a description
            that cannot be used.
    """
    if isinstance(name_or_path, str) and name_or_path in robot_names():
        return _built_in(name_or_path)
    path = (base_dir or Path()) / name_or_path
    suffix = path.suffix.lower()
    names = ", ".join(robot_names())
    if suffix not in (".urdf", ".yaml", ".yml"):
        raise InvalidRobotError(
            f"no robot '{name_or_path}'; built-in: {names}; or the path of a .urdf or .yaml file"
        )
    if not path.is_file():
        raise InvalidRobotError(f"{path}: no such file; built-in robots: {names}")
    return robot_from_urdf(path) if suffix == ".urdf" else robot_from_file(path)


@lru_cache
def _built_in(name: str) -> Robot:
    return robot_from_file(_DATA / f"{name}.yaml")
