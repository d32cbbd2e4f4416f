"""``optipromp export`` and ``report``: scenes and plans for other programs and people."""

from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import optipromp
from optipromp.cli.check import Kind, kind_of, scene_or_plan
from optipromp.cli.command import Report, command
from optipromp.cli.console import waiting
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.files import is_file, is_folder, write_atomically
from optipromp.parts import part

if TYPE_CHECKING:
    from optipromp.core.arrays import FloatArray


_UNWRITTEN: dict[str, object] = {"status": None, "message": None, "item": None, "files": {}}


@command(failure=lambda asked: _UNWRITTEN | {"item": asked["scene_or_plan"]})
def export(
    scene_or_plan: str,
    /,
    mjcf: Path | None = None,
    mcap: Path | None = None,
    robot: Path | None = None,
    rate: float = 1000.0,
    prefix: str = "",
) -> Report:
    """Write a scene or a plan in the formats of other programs.

    At least one format must be asked for. --mjcf needs the package optipromp-sim,
    --mcap optipromp-ros.

    Examples:
        optipromp export scenario-3 --mjcf scene.xml
        optipromp export pick --mjcf pick.xml
        optipromp export pick --mcap pick.mcap
        optipromp export my-arm.urdf --robot my-arm.robot

    Args:
        scene_or_plan (SCENE|PLAN_DIR): A scene, or a folder that 'plan --out' left; for --robot
            alone also a robot.
        mjcf (FILE.xml): Write a MuJoCo model: robot with servos, tool, objects, fruits on stems.
        mcap (FILE.mcap): Write a bag of ROS 2 messages: the planning scene; of a plan, the
            trajectory of each leg.
        robot (FILE.robot): Write the robot, without a tool, resolved.
        rate (HZ): Of the JointTrajectory's points in the bag.
        prefix (TEXT): Before the joints' names in the bag, as in fr3_.
    """
    wanted = [
        ("--mjcf", mjcf, ".xml", _mjcf),
        ("--mcap", mcap, ".mcap", lambda content, path: _mcap(content, path, rate, prefix)),
        ("--robot", robot, ".robot", _robot),
    ]
    chosen = [(name, path, end, write) for name, path, end, write in wanted if path is not None]
    if not chosen:
        names = ", ".join(f"{name} FILE{end}" for name, _, end, _ in wanted)
        raise InvalidRequestError(f"nothing to write: give at least one of {names}")
    for name, path, end, _ in chosen:
        if path.suffix.lower() != end:
            raise InvalidRequestError(f"{name} is {str(path)!r}: its name must end in {end}")
    content = _read(scene_or_plan, robots=all(write is _robot for *_, write in chosen))
    for _, path, _, write in chosen:
        with waiting(f"writing {path} ..."):
            write(content, path)
    files = {name.removeprefix("--"): str(path) for name, path, _, _ in chosen}
    document = {"status": Code.SUCCESS, "message": "", "item": scene_or_plan, "files": files}
    return Report(document, [f"wrote {', '.join(files.values())}"])


class _Content(NamedTuple):
    robot: "optipromp.Robot"
    start: "FloatArray"
    scene: "optipromp.Scene | None" = None  # of a robot
    curves: "tuple[tuple[str, optipromp.Trajectory], ...]" = ()  # of a plan, with its leg


def _read(item: str, robots: bool) -> _Content:
    """The content of a scene or plan; of a robot only where ``robots`` is true."""
    from optipromp.core.planning.legs import legs_of
    from optipromp.core.planning.task import posed

    if robots and kind_of(item) is Kind.ROBOT:
        bare = optipromp.load_robot(item)
        return _Content(bare, bare.home)
    found = scene_or_plan(item, "export")
    if not isinstance(found, optipromp.Scene):
        reach = legs_of(found)["reach"]
        curves = tuple((name, leg.trajectory) for name, leg in legs_of(found).items())
        return _Content(reach.robot, reach.trajectory.positions[0], reach.scene, curves)
    robot, state = posed(found)
    return _Content(robot, state.q, found)


def _mjcf(content: _Content, path: Path) -> None:
    assert content.scene is not None
    text = part("mjcf")(content.scene, content.robot, content.start)
    write_atomically(path, text.encode("utf-8"))


def _mcap(content: _Content, path: Path, rate: float, prefix: str) -> None:
    assert content.scene is not None
    write = part("write_plan")
    write(path, content.scene, content.robot.name, content.curves, rate, prefix)


def _robot(content: _Content, path: Path) -> None:
    from optipromp.core.robots.resolved import save_robot
    from optipromp.core.robots.tools import without_tool

    save_robot(without_tool(content.robot), path)


@command()
def report(item: Path, /, out: Path | None = None) -> Report:
    """Write one HTML file about a plan, a run or a study: no network, at most 5 MB.

    Of a plan: 3-D, pictures, metrics beside the paper's, settings, versions,
    the command; with outcome and film where 'simulate' left them there. Of a
    run: scene, outcome, film. Of a study: rates with intervals, causes, and
    the worst cases with pictures.
    3-D needs the extra 'view', pictures of worst cases the package 'optipromp-sim'.

    Examples:
        optipromp plan scenario-4 --out pick
        optipromp simulate pick --video
        optipromp report pick --out pick.html

    Args:
        item (PLAN_DIR|ROLLOUT_DIR|STUDY_DIR): What 'plan', 'simulate' or 'bench study' left.
        out (FILE.html): Where the report goes; else beside what it reports.
    """
    from optipromp.core.output import ROWS
    from optipromp.looks.reports import plan_report, run_report

    folder = item if is_folder(item) else item.parent
    path = out or folder / "report.html"
    if path.suffix.lower() != ".html":
        raise InvalidRequestError(f"--out is {str(path)!r}: its name must end in .html")
    with waiting("writing the report") as say:
        if is_file(folder / "plan.json"):
            content = plan_report(folder)
        elif is_file(folder / ROWS):
            content = part("study_report")(folder, progress=say)
        elif is_file(folder / "rollout.npz"):
            content = run_report(folder)
        else:
            raise InvalidRequestError(
                f"{item} holds no plan (plan.json), no run (rollout.npz) and no study ({ROWS})"
            )
        write_atomically(path, content)
    size = len(content)
    document = {"status": Code.SUCCESS, "message": "", "file": str(path), "bytes": size}
    return Report(document, [f"wrote {path} ({size / 1e6:.1f} MB)"])
