"""The options of every command that names a robot."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from optipromp.robots.library import Choice
    from optipromp.scenes.scene import Scene

Tip = Annotated[str | None, typer.Option(metavar="LINK", help="Of the robot: the flange link.")]
Base = Annotated[
    str | None, typer.Option(metavar="LINK", help="Of the robot: joints before it are held.")
]
Srdf = Annotated[Path | None, typer.Option(help="Of the robot: groups that tell the arm.")]
PackageDirs = Annotated[
    list[Path] | None,
    typer.Option(metavar="FOLDER", help="Of the robot: holds packages of package:// names."),
]


@dataclass(frozen=True)
class Named:
    """What a command was told of a robot; ``name`` is None where it was not named.

    ``choice`` is of the robot's file; relative paths start at the working directory.
    """

    name: str | None
    choice: "Choice"

    def __bool__(self) -> bool:
        from optipromp.robots.library import NOTHING

        return self.name is not None or self.choice != NOTHING

    def of(self, scene: "Scene") -> "Scene":
        """The scene with this robot; with its own robot, chosen from so, where none was named."""
        if not self:
            return scene
        if self.name is None:
            choice = replace(self.choice, untrusted=scene.choice.untrusted)
            return replace(scene, choice=choice)
        name = str(Path(self.name).absolute()) if Path(self.name).suffix else self.name
        return replace(scene, robot=name, choice=self.choice)


def names_robot(
    robot: str | None = None,
) -> Callable[[Callable[..., int]], Callable[..., int]]:
    """Give a command the options ``--tip``, ``--base``, ``--srdf`` and ``--package-dir``.

    The command takes them as ``named``, a :class:`Named`. ``robot`` is the help of ``--robot``;
    without it the command names the robot in another way.
    """
    options: dict[str, Any] = {"tip": Tip, "base": Base, "srdf": Srdf, "package_dir": PackageDirs}
    if robot is not None:
        told = typer.Option(metavar="ROBOT", help=robot)
        options = {"robot": Annotated[str | None, told], **options}

    def decorate(function: Callable[..., int]) -> Callable[..., int]:
        @wraps(function)
        def run(*args: Any, **kwargs: Any) -> int:
            from optipromp.robots.library import Choice

            given = {name: kwargs.pop(name, None) for name in options}
            srdf, folders = given["srdf"], given["package_dir"] or ()
            choice = Choice(
                given["tip"], given["base"], srdf and srdf.absolute(),
                package_dirs=tuple(folder.absolute() for folder in folders),
            )  # fmt: skip
            return function(*args, named=Named(given.get("robot"), choice), **kwargs)

        signature = inspect.signature(function)
        kept = [each for each in signature.parameters.values() if each.name != "named"]
        kind = inspect.Parameter.KEYWORD_ONLY
        added = [
            inspect.Parameter(name, kind, default=None, annotation=annotation)
            for name, annotation in options.items()
        ]
        run.__signature__ = signature.replace(parameters=[*kept, *added])  # type: ignore[attr-defined]
        annotations = {k: v for k, v in function.__annotations__.items() if k != "named"}
        run.__annotations__ = annotations | options
        return run

    return decorate
