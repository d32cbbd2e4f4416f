"""The options of every command that names a robot."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from optipromp.core.errors import InvalidRequestError

if TYPE_CHECKING:
    from optipromp.core.robots.library import Choice
    from optipromp.core.scenes.scene import Scene

InPlace = Annotated[
    str | None,
    typer.Option(metavar="ROBOT", help="In place of the scene's: built-in name or file."),
]
Whose = Annotated[
    str | None, typer.Option(metavar="ROBOT", help="Whose scenes: built-in name or file (panda).")
]


@dataclass(frozen=True)
class Named:
    """The robot that a command's options name."""

    name: str | None  # of the robot, or path; None: not named
    choice: "Choice"  # of the arm in its file; relative paths start at the working directory

    def __bool__(self) -> bool:
        from optipromp.core.robots.library import NOTHING

        return self.name is not None or self.choice != NOTHING

    def of(self, scene: "Scene") -> "Scene":
        """The scene with this robot; where none is named, with its own robot by this choice."""
        if not self:
            return scene
        if self.name is None:
            choice = replace(self.choice, untrusted=scene.choice.untrusted)
            return replace(scene, choice=choice)
        name = str(Path(self.name).absolute()) if Path(self.name).suffix else self.name
        return replace(scene, robot=name, choice=self.choice)


@dataclass(frozen=True)
class ArmOptions:
    """The options that choose the arm in a robot's file.

    Attributes:
        arm (NAME): Of the robot: a group, or a part of a name such as left.
        tip (LINK): Of the robot: the flange link.
        base (LINK): Of the robot: joints before it are held.
        srdf: Of the robot: its groups, one of which is the arm.
        package_dir (FOLDER): Of the robot: holds packages of package:// names.
        robot_arg (NAME:=VALUE): Of the robot's xacro: an argument.
    """

    arm: str | None = None
    tip: str | None = None
    base: str | None = None
    srdf: Path | None = None
    package_dir: list[Path] | None = None
    robot_arg: list[str] | None = None

    def of(self, robot: str | None) -> Named:
        """The robot of that name, if any, with the choice of these options."""
        from optipromp.core.robots.library import Choice

        choice = Choice(
            self.tip,
            self.base,
            self.srdf and self.srdf.absolute(),
            package_dirs=tuple(folder.absolute() for folder in self.package_dir or ()),
            arm=self.arm,
            args=dict(map(_argument, self.robot_arg or ())),
        )
        return Named(robot, choice)


def _argument(text: str) -> tuple[str, str]:
    """Name and value of an argument of a xacro."""
    name, sign, value = text.partition(":=")
    if not sign or not name.strip():
        raise InvalidRequestError(f"--robot-arg is {text!r}: must be name:=value")
    return name.strip(), value
