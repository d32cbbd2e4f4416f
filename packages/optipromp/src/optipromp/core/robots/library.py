"""Robots by name or by file: resolved robot files here, descriptions by their readers."""

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import Any, TypedDict, Unpack

import numpy as np

from optipromp.core.errors import InvalidRobotError
from optipromp.core.files import check_inside, homes, is_file
from optipromp.core.robots.description import Arm
from optipromp.core.robots.model import Robot
from optipromp.core.robots.resolved import SUFFIX, read_resolved

SAME_JOINTS = 1e-4  # [m or -] chosen: rounded angles make files of one robot differ by less
READERS = "optipromp.robot_readers"
"""Group of entry points, each named by a suffix without its dot: a function of a path, a
:class:`Choice` and a :data:`Check` that returns the :class:`Robot` of a description."""

Check = Callable[[Path], Path]
"""Returns the path of a file if it may be read, else raises InvalidRobotError."""

_DATA = Path(__file__).resolve().parent / "data"


@lru_cache
def robot_names() -> tuple[str, ...]:
    """The built-in robots."""
    return tuple(sorted(path.stem for path in _DATA.glob(f"*{SUFFIX}")))


Argument = str | float | bool
"""The value of an argument of a xacro; xacro sees it as text, a bool as ``true`` or ``false``."""


@dataclass(frozen=True)
class Choice:
    """The caller's choice of the arm in a robot file or description.

    Where a value is None, the robot file decides, else the rule of the reader.

    Args:
        tip: the flange link.
        base: the link that the arm begins at; joints before it are held.
        srdf: an SRDF whose groups determine the arm; None: the SRDF beside the URDF, if any.
        hold: values [rad or m] of joints that are not of the arm, such as fingers; other such
            joints stand at zero, or at the limit nearest to zero.
        arm: name of the arm, in place of ``tip`` and ``base``: a group of the SRDF, or a part
            of the name of the arm's group, its tip or all its joints, such as ``left``.
        package_dirs: folders that hold the packages of ``package://`` names, or are packages;
            searched before the folders above the URDF, AMENT_PREFIX_PATH and ROS_PACKAGE_PATH.
            Relative paths start where the robot's does.
        args: of a xacro, by name, in place of the defaults in its file.
        untrusted: whether a file or a message named the robot, not the user. The robot's files must
            then lie where that file's may, and no xacro is expanded. Ignored by comparisons.
    """

    tip: str | None = None
    base: str | None = None
    srdf: str | Path | None = None
    hold: Mapping[str, float] = field(default_factory=dict)
    package_dirs: tuple[str | Path, ...] = ()
    arm: str | None = None
    args: Mapping[str, Argument] = field(default_factory=dict)
    untrusted: bool = field(default=False, repr=False, compare=False)


CHOICES = "arm, tip, base, srdf, hold, packages or args"
NOTHING = Choice()
UNTRUSTED = Choice(untrusted=True)


class ChoiceKeys(TypedDict, total=False):
    """The keywords of :func:`load_robot`; see :class:`Choice`."""

    tip: str | None
    base: str | None
    srdf: str | Path | None
    hold: Mapping[str, float] | None
    package_dirs: Sequence[str | Path]
    arm: str | None
    args: Mapping[str, Argument] | None


def load_robot(
    name_or_path: str | Path, base_dir: Path | None = None, **choice: Unpack[ChoiceKeys]
) -> Robot:
    """A robot without a tool: a built-in one by name, or from a file.

    A ``.robot`` file is a resolved robot (:func:`optipromp.core.robots.resolved.save_robot`). The
    entry points ``optipromp.robot_readers`` read files of other suffixes; those of this package:
    ``.urdf``, xacro, MJCF (``.xml``) and robot files (``.yaml``). The arm of a bare URDF is chosen
    by a rule, and spheres cover its geometry. Its limits of acceleration and jerk are assumed, with
    a warning (10 rad/s², 2 m/s²; ten times as much a second), unless a robot file states them, or
    "none". Its home is zero, or the limit nearest to zero.

    Args:
        name_or_path: of the robot; a relative path starts at ``base_dir``.
        base_dir: default: the working directory.
        **choice: ``tip``, ``base``, ``srdf``, ``hold``, ``package_dirs``, ``arm`` and ``args`` of
            :class:`Choice`.

    Raises:
        InvalidRobotError: no such robot (the message lists the built-in names), a description that
            cannot be used, a xacro that a robot file names although
            :data:`optipromp.core.files.ALLOW_XACRO` is not set, or several arms that are alike (the
            message lists them).
    """
    if unknown := choice.keys() - ChoiceKeys.__optional_keys__:
        raise TypeError(f"load_robot has no argument {', '.join(sorted(unknown))}")
    stated: dict[str, Any] = {name: value for name, value in choice.items() if value is not None}
    stated["package_dirs"] = tuple(stated.get("package_dirs", ()))
    return load_arm(name_or_path, base_dir, Choice(**stated))[0]


def load_arm(
    name_or_path: str | Path, base_dir: Path | None = None, choice: Choice = NOTHING
) -> tuple[Robot, Arm]:
    """The robot as :func:`load_robot` returns it, and its arm: why it was chosen, and others."""
    if isinstance(name_or_path, str) and name_or_path in robot_names():
        if choice != NOTHING:
            raise InvalidRobotError(f"robot '{name_or_path}' is built in: it takes no {CHOICES}")
        robot = _built_in(name_or_path)
        return robot, robot.arm
    folder = base_dir or Path()
    packages = tuple(folder / each for each in choice.package_dirs)
    srdf = None if choice.srdf is None else folder / choice.srdf
    choice = replace(choice, srdf=srdf, package_dirs=packages)
    check: Check = Path
    if choice.untrusted:
        more = *packages, *folders_of("AMENT_PREFIX_PATH"), *folders_of("ROS_PACKAGE_PATH")
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
        raise InvalidRobotError(f"{path} is resolved: it takes no {CHOICES}")
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
    """The :data:`Check` of a robot that a file in ``folder`` names.

    The robot's files may lie in the ``homes`` of that file, which distinguish two checks in caches,
    and in the folders ``more``.
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


@lru_cache(maxsize=32)  # compares robots by identity
def built_in_twin(robot: Robot, names: tuple[str, ...]) -> str | None:
    """The robot among built-in ``names`` whose joints have the names, order, kinds, axes and places
    of ``robot``'s.

    Names of robots, flanges, tools, limits and bodies are not compared.
    """
    for name in names:
        other = _built_in(name)
        if other.joint_names == robot.joint_names and all(
            mine.shape == theirs.shape and np.allclose(mine, theirs, rtol=0.0, atol=SAME_JOINTS)
            for mine, theirs in zip(robot.kinematics, other.kinematics, strict=True)
        ):
            return name
    return None


def files_of(name_or_path: str | Path, choice: Choice = NOTHING) -> list[Path]:
    """The files and folders that are read for this robot with this choice.

    Raises InvalidRobotError as :func:`load_robot`.
    """
    seen = list[Path]()

    def check(path: Path) -> Path:
        seen.append(path)
        return path

    path = Path(name_or_path)
    _read(path, choice, check)
    chosen = [*([choice.srdf] if choice.srdf else []), *choice.package_dirs]
    return list(dict.fromkeys([path, *seen, *map(Path, chosen)]))
