"""Robots by name or by file: a resolved robot file, or what a reader makes of a description."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import numpy as np

from optipromp.core.errors import InvalidRobotError
from optipromp.core.files import check_inside, homes, is_file
from optipromp.core.robots.description import Arm
from optipromp.core.robots.model import Robot
from optipromp.core.robots.resolved import SUFFIX, read_resolved

SAME_JOINTS = (
    1e-4  # [m or -] chosen: joints of one robot differ less between files (rounded angles)
)
READERS = "optipromp.robot_readers"
"""Entry points, named by a suffix without its dot: functions of a path, a :class:`Choice` and a
:data:`Check` that give the :class:`Robot` of a description."""

Check = Callable[[Path], Path]
"""Gives the path of a file back if it may be read, else raises InvalidRobotError."""

_DATA = Path(__file__).resolve().parent / "data"


@lru_cache
def robot_names() -> tuple[str, ...]:
    """The built-in robots."""
    return tuple(sorted(path.stem for path in _DATA.glob(f"*{SUFFIX}")))


@dataclass(frozen=True)
class Choice:
    """What a caller chooses of a robot file or URDF; None leaves it to the file, then to the rule.

    ``tip``: the flange link; ``base``: the link the arm begins at; ``srdf``: a file of groups;
    ``hold``: values [rad or m] of joints that are not of the arm, such as fingers;
    ``package_dirs``: folders that hold packages. Relative paths start where the robot's does.
    ``untrusted``: a file or a message named the robot, not the user. Its files must then lie where
    that file's may, and no xacro is expanded. It is no choice: two that differ in it are equal.
    """

    tip: str | None = None
    base: str | None = None
    srdf: str | Path | None = None
    hold: Mapping[str, float] = field(default_factory=dict)
    package_dirs: tuple[str | Path, ...] = ()
    untrusted: bool = field(default=False, repr=False, compare=False)


NOTHING = Choice()
UNTRUSTED = Choice(untrusted=True)


def load_robot(
    name_or_path: str | Path,
    base_dir: Path | None = None,
    *,
    tip: str | None = None,
    base: str | None = None,
    srdf: str | Path | None = None,
    hold: Mapping[str, float] | None = None,
    package_dirs: Sequence[str | Path] = (),
) -> Robot:
    """A robot without a tool: a built-in one by name, or from a file.

    A resolved robot file (``.robot``, see :func:`optipromp.core.robots.resolved.save_robot`) is
    read here. A file of another suffix goes to its reader: the entry points
    ``optipromp.robot_readers`` name one each. Those of this package read a ``.urdf``, xacro, MJCF
    (``.xml``) or robot file (``.yaml``). A bare URDF has its arm chosen by a rule and spheres from
    its geometry; accelerations and jerks are unlimited; home is zero, or the limits nearest to it.

    Args:
        name_or_path: of the robot; a relative path starts at ``base_dir``.
        base_dir: default: the working directory.
        tip: the flange link.
        base: the link that the arm begins at; joints before it are held.
        srdf: an SRDF whose groups tell the arm; without it one beside the URDF is read.
        hold: values [rad or m] of joints that are not of the arm, such as the fingers of a gripper;
            the others stand at zero, or at the limit nearest to it.
        package_dirs: folders that hold the packages of ``package://`` names, or are such; searched
            before those over the URDF, on AMENT_PREFIX_PATH and on ROS_PACKAGE_PATH.

    Raises:
        InvalidRobotError: no such robot (the message lists the built-in names), a description that
            cannot be used, a xacro that a robot file names and
            :data:`optipromp.core.files.ALLOW_XACRO` does not allow, or several arms that are
            alike (the message lists them).
    """
    return load_arm(
        name_or_path, base_dir, Choice(tip, base, srdf, hold or {}, tuple(package_dirs))
    )[0]


def load_arm(
    name_or_path: str | Path, base_dir: Path | None = None, choice: Choice = NOTHING
) -> tuple[Robot, Arm]:
    """As :func:`load_robot`, with the arm that was chosen, why, and what else there is."""
    if isinstance(name_or_path, str) and name_or_path in robot_names():
        if choice != NOTHING:
            raise InvalidRobotError(
                f"robot '{name_or_path}' is built in: it takes no tip, base, srdf, hold or packages"
            )
        robot = _built_in(name_or_path)
        return robot, robot.arm
    folder = base_dir or Path()
    given = tuple(folder / each for each in choice.package_dirs)
    choice = replace(
        choice,
        srdf=None if choice.srdf is None else folder / choice.srdf,
        package_dirs=given,
    )
    check: Check = Path
    if choice.untrusted:
        more = *given, *folders_of("AMENT_PREFIX_PATH"), *folders_of("ROS_PACKAGE_PATH")
        check = Inside(base_dir, more, homes(base_dir))
    path = folder / name_or_path
    names, known = ", ".join(robot_names()), sorted([SUFFIX, *_readers()])
    if path.suffix.lower() not in known:
        lacking = "" if _readers() else " (no other reader is installed: install optipromp anew)"
        raise InvalidRobotError(
            f"no robot '{name_or_path}'; built-in: {names}; "
            f"or the path of a file that ends in {', '.join(known)}{lacking}"
        )
    if not is_file(check(path)):
        raise InvalidRobotError(f"{path}: no such file; built-in robots: {names}")
    robot = _read(path, choice, check)
    return robot, robot.arm


def _read(path: Path, choice: Choice, check: Check) -> Robot:
    if path.suffix.lower() != SUFFIX:
        read: Callable[[Path, Choice, Check], Robot] = _readers()[path.suffix.lower()].load()
        return read(path, choice, check)
    if choice != NOTHING:
        raise InvalidRobotError(
            f"{path} is resolved: it takes no tip, base, srdf, hold or packages"
        )
    return read_resolved(path, check)


@cache
def _readers() -> dict[str, EntryPoint]:
    """The readers of descriptions by suffix."""
    return {f".{each.name.lower()}": each for each in entry_points(group=READERS)}


@cache
def _built_in(name: str) -> Robot:
    return read_resolved(_DATA / f"{name}{SUFFIX}")


@dataclass(frozen=True)
class Inside:
    """The :data:`Check` of a robot that a file in ``folder`` names, which may stand for ``homes``.

    The robot's files may lie where that file's may, and in the folders ``more``.
    """

    folder: Path | None
    more: tuple[Path, ...]
    homes: tuple[Path, ...]

    def __call__(self, path: Path) -> Path:
        """``path``, if it may be read."""
        return check_inside(path, self.folder, InvalidRobotError, self.more)


def folders_of(variable: str) -> list[Path]:
    """The folders that an environment variable lists."""
    return [Path(part) for part in os.environ.get(variable, "").split(os.pathsep) if part]


def built_in_twin(robot: Robot) -> str | None:
    """The built-in robot with the joints of ``robot``: their names, order, kinds, axes and places.

    The name of the robot does not count, nor do its flange, tool, limits and body.
    """
    for name in robot_names():
        other = load_robot(name)
        if other.joint_names == robot.joint_names and all(
            mine.shape == theirs.shape and np.allclose(mine, theirs, rtol=0.0, atol=SAME_JOINTS)
            for mine, theirs in zip(robot.kinematics, other.kinematics, strict=True)
        ):
            return name
    return None


def files_of(name_or_path: str | Path, choice: Choice = NOTHING) -> list[Path]:
    """The files and folders that a scene reads which names this robot with this choice.

    Raises InvalidRobotError as :func:`load_robot`.
    """
    seen = list[Path]()

    def check(path: Path) -> Path:
        seen.append(path)
        return path

    path = Path(name_or_path)
    _read(path, choice, check)
    given = [*([choice.srdf] if choice.srdf else []), *choice.package_dirs]
    return list(dict.fromkeys([path, *seen, *map(Path, given)]))
