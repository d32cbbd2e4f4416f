"""``optipromp export``: a scene or a plan in the formats of other programs; a robot resolved."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from optipromp.cli.check import Kind, kind_of, scene_or_plan
from optipromp.cli.command import Report, command
from optipromp.cli.console import waiting
from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError

if TYPE_CHECKING:
    from optipromp.core.arrays import FloatArray
    from optipromp.core.robots.model import Robot
    from optipromp.core.scenes.scene import Scene
    from optipromp.core.trajectory import Trajectory


def _failed(error: OptiPrompError, arguments: Mapping[str, Any]) -> dict[str, Any]:
    item = arguments["scene_or_plan"]
    return {"status": error.code, "message": error.message, "item": item, "files": {}}


@command(failure=_failed)
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

    At least one format must be asked for. --mjcf needs the extra 'sim', --mcap
    the extra 'ros': pip install -e '.\\[sim,ros]' in the clone.

    [bold]Examples[/bold]

    \b
    optipromp export scenario-3 --mjcf scene.xml
    optipromp export reach --mjcf reach.xml
    optipromp export reach --mcap reach.mcap
    optipromp export my-arm.urdf --robot my-arm.robot

    Args:
        scene_or_plan (SCENE|PLAN_DIR): A scene, or a folder that 'plan --out' left; for --robot
            alone also a robot.
        mjcf (FILE.xml): Write a MuJoCo model: robot with servos, tool, objects, fruits on stems.
        mcap (FILE.mcap): Write a bag of ROS 2 messages: the planning scene; of a plan, its
            trajectory.
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
    robot: "Robot"
    start: "FloatArray"
    scene: "Scene | None" = None  # of a robot
    trajectory: "Trajectory | None" = None


def _read(item: str, robots: bool) -> _Content:
    """The content of a scene or plan; of a robot only where ``robots`` is true."""
    from optipromp.core.planning.task import posed
    from optipromp.core.robots.library import load_robot
    from optipromp.core.scenes.scene import Scene

    if robots and kind_of(item) is Kind.ROBOT:
        bare = load_robot(item)
        return _Content(bare, bare.home)
    found = scene_or_plan(item, "export")
    if not isinstance(found, Scene):
        return _Content(found.robot, found.trajectory.positions[0], found.scene, found.trajectory)
    robot, state = posed(found)
    return _Content(robot, state.q, found)


def _mjcf(content: _Content, path: Path) -> None:
    from optipromp.core.files import write_atomically
    from optipromp.laboratory.simulation.export import mjcf

    assert content.scene is not None
    write_atomically(path, mjcf(content.scene, content.robot, content.start).encode("utf-8"))


def _mcap(content: _Content, path: Path, rate: float, prefix: str) -> None:
    from optipromp import ros

    assert content.scene is not None
    items = [ros.Recorded("/planning_scene", ros.planning_scene(content.scene, prefix))]
    if content.trajectory is not None:
        points = ros.joint_trajectory(content.trajectory, rate, prefix)
        shown = ros.display_trajectory([content.trajectory], content.robot.name, prefix=prefix)
        items += [
            ros.Recorded("/joint_trajectory", points),
            ros.Recorded("/display_planned_path", shown),
        ]
    ros.write_bag(path, items)


def _robot(content: _Content, path: Path) -> None:
    from optipromp.core.robots.resolved import save_robot
    from optipromp.core.robots.tools import without_tool

    save_robot(without_tool(content.robot), path)
