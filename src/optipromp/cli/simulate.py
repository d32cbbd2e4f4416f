"""``optipromp simulate``: execute a plan in the physics simulation and tell what happened."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optipromp.cli.check import scene_or_plan
from optipromp.cli.closed_loop import Disturbed, LoopOptions, loop_document, loop_lines, pick
from optipromp.cli.command import FAILED, OK, Report, command
from optipromp.cli.console import ChosenStrategy, Seed, Strategy, say_if_compiling, waiting
from optipromp.cli.robot import ArmOptions, InPlace, Named
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import is_folder

if TYPE_CHECKING:
    from optipromp.core.planning import Picked, Plan
    from optipromp.core.scenes.scene import Scene
    from optipromp.laboratory.simulation import Loop, Run


def failed_run(error: OptiPrompError, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a run that raised an error."""
    return {
        "scene": arguments["scene_or_plan"],
        "success": False,
        "cause": None,
        "status": error.code,
        "message": error.message,
    }


@command(failure=failed_run)
def simulate(
    scene_or_plan: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|PLAN_DIR",
            help="A scene to plan for, or a folder that 'plan --out' left, to execute as it is.",
        ),
    ],
    planner: Annotated[
        str, typer.Option(metavar="NAME", help="Of a scene; a plan's folder has its plan.")
    ] = "opti-promp",
    strategy: ChosenStrategy = "joint",
    true_scene: Annotated[
        str | None,
        typer.Option(
            "--in", metavar="SCENE", help="Execute in this world instead of the plan's own."
        ),
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(metavar="SHARE", help="Of the velocity limits that the motion uses (0.5)."),
    ] = None,
    seed: Seed = 0,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Leave outcome.json, rollout.npz, films, of a loop loop.npz here; else in "
            "PLAN_DIR, or in out.",
        ),
    ] = None,
    video: Annotated[
        bool, typer.Option("--video", help="Draw a film of it: run.webm (VP9).")
    ] = False,
    mp4: Annotated[
        bool, typer.Option("--mp4", help="And as run.mp4 (H.264), by x264, which is GPL.")
    ] = False,
    gif: Annotated[bool, typer.Option("--gif", help="And as an animation: run.gif.")] = False,
    slow: Annotated[
        float, typer.Option(metavar="FACTOR", help="How many times slower a film runs.")
    ] = 1.0,
    failed_leg: Annotated[
        bool,
        typer.Option(
            "--failed-leg", help="Of a pick whose retreat or carry failed: execute that leg, too."
        ),
    ] = False,
    *,
    disturbed: Disturbed,
    eyes: LoopOptions,
    robot: InPlace = None,
    arm: ArmOptions,
) -> Report:
    """Execute a plan in the physics simulation and judge what happened there.

    The exit code is 0 only when the target alone ended in the gripper and nothing was harmed; 1
    otherwise; 2 when the input is wrong. Needs the extra 'sim': pip install -e '.\\[sim]'.

    [bold]Examples[/bold]

    \b
    optipromp simulate scenario-3 --video
    optipromp simulate reach --slow 4 --gif
    optipromp simulate my-scene.yaml --planner i-promp --json
    optipromp simulate scenario-3 --closed-loop --sway 0.01 --noise zero-mean --video
    """
    from optipromp.core.files import check_folder
    from optipromp.core.planning import Picked
    from optipromp.core.robots.dynamics import warn_of_gravity
    from optipromp.core.scenes.io import load_scene
    from optipromp.laboratory.simulation import SimulationParameters
    from optipromp.laboratory.simulation import simulate as execute
    from optipromp.laboratory.simulation.engine import engine

    engine()  # where MuJoCo is missing, refuse before planning
    folder = _folder(scene_or_plan) if out is None else out
    if not 0.05 <= slow <= 50.0:
        raise InvalidRequestError(f"--slow is {slow:g}; it must be between 0.05 and 50")
    check_folder(folder)
    eyes.check(
        {
            "--planner": None if planner == "opti-promp" else planner,
            "--strategy": None if strategy == "joint" else strategy,
            "--speed": speed,
            "--failed-leg": failed_leg or None,
        }
    )
    parameters = disturbed.of(SimulationParameters())
    if speed is not None:
        parameters = replace(parameters, control=replace(parameters.control, speed=speed))
    truth = None if true_scene is None else load_scene(true_scene)
    kinds = [kind for kind, on in (("webm", video), ("mp4", mp4), ("gif", gif)) if on]
    leave = partial(_leave, folder=folder, kinds=kinds, slow=slow)
    if eyes:
        seen = _scene(scene_or_plan, arm.of(robot))
        say_if_compiling()
        with waiting(f"picking in {(truth or seen).name} ..."):
            loop = pick(seen, truth, parameters, eyes, seed)
        return _picked(loop, leave(loop.run, loop=loop), folder)
    plan = _plan(scene_or_plan, planner, strategy, seed, arm.of(robot))
    legs = plan.legs if isinstance(plan, Picked) else {"": plan}
    for leg in legs.values():
        warn_of_gravity(leg.robot, leg.trajectory.positions, leg.scene.up, "on the way")
    (first, *_) = legs.values()
    with waiting(f"executing in {(truth or first.scene).name} ..."):
        run = execute(plan, truth, parameters=parameters, seed=seed, failed_leg=failed_leg)
    return _executed(run, (first.planner, plan.status), leave(run), folder)


def _picked(loop: "Loop", written: Sequence[str], folder: Path) -> Report:
    """The report of a pick in closed loop."""
    from optipromp.laboratory.simulation.files import run_document

    document = {**run_document(loop.run), **loop_document(loop)}
    told = f"{document['loop']} loop: {loop.result}"
    lines = [*_shown(loop.run, told), *loop_lines(document), _wrote(written, folder)]
    return Report(document, lines, OK if loop.run.success else FAILED)


def _executed(run: "Run", plan: tuple[str, str], written: Sequence[str], folder: Path) -> Report:
    """The report of the execution of a plan, of which planner and status are given."""
    from optipromp.laboratory.simulation.files import run_document

    planner, status = plan
    document = {**run_document(run), "planner": planner, "plan_status": status}
    told = f"{planner} (plan: {status})"
    lines = [*_shown(run, told), _wrote(written, folder)]
    return Report(document, lines, OK if run.success else FAILED)


def _wrote(written: Sequence[str], folder: Path) -> str:
    return f"wrote {', '.join(written)} to {folder}"


def _folder(item: str) -> Path:
    path = Path(item)
    if is_folder(path):
        return path
    return path.parent if path.name == "plan.json" else Path("out")


def _plan(item: str, planner: str, strategy: Strategy, seed: int, named: Named) -> "Plan | Picked":
    from optipromp.core.output import load_pick
    from optipromp.core.planning import Plan, plan_pick
    from optipromp.core.planning import plan as make_plan

    found = scene_or_plan(item, "simulate")
    if isinstance(found, Plan):
        if named:
            raise InvalidRequestError(f"{item} is a plan, which has its robot; name none")
        return load_pick(item)
    scene = named.of(found)
    say_if_compiling()
    verb = make_plan if scene.place is None else plan_pick
    with waiting(f"planning {scene.name} ...") as say:
        return verb(scene, planner=planner, strategy=strategy, seed=seed, progress=say)


def _scene(item: str, named: Named) -> "Scene":
    from optipromp.core.planning import Plan

    found = scene_or_plan(item, "simulate")
    if isinstance(found, Plan):
        raise InvalidRequestError(f"{item} is a plan; --closed-loop makes its own: give the scene")
    return named.of(found)


def _leave(
    run: "Run", folder: Path, kinds: Sequence[str], slow: float, loop: "Loop | None" = None
) -> tuple[str, ...]:
    """Write the files of a run or a loop; their names."""
    from optipromp.laboratory.simulation.files import write_run
    from optipromp.laboratory.simulation.loop_files import write_loop

    films = {}
    if kinds:
        from optipromp.laboratory.simulation.film import animation, film, loop_animation, loop_film

        with waiting("drawing"):
            for kind in kinds:
                if kind == "gif":
                    made = loop_animation(loop, slow=slow) if loop else animation(run, slow=slow)
                elif loop:
                    made = loop_film(loop, slow=slow, kind=kind)
                else:
                    made = film(run, slow=slow, kind=kind)
                films[f"run.{kind}"] = made
    further = (write_loop(loop, folder),) if loop else ()
    return *write_run(run, folder, films), *further


def _shown(run: "Run", told: str) -> list[str]:
    from optipromp.laboratory.simulation.execute import run_rows

    return [
        f"{run.scene.name}  {told}  {run.outcome.told}",
        run.outcome.message,
        *(f"  {name:<26}{words}" for name, words in run_rows(run)),
    ]
