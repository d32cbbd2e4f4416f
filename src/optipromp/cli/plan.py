"""``optipromp plan``: one scene, one plan; or a folder of scenes."""

from collections.abc import Mapping
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optipromp.cli.console import (
    command,
    exit_code,
    print_json,
    say_if_compiling,
    stdout,
    waiting,
)
from optipromp.errors import OptiPrompError

if TYPE_CHECKING:
    from optipromp.planning import Plan


class Planner(StrEnum):
    """The planners, oldest first."""

    PROMP = "promp"
    I_PROMP = "i-promp"
    OPTI_PROMP = "opti-promp"


class Strategy(StrEnum):
    """How OptI-ProMP solves."""

    JOINT = "joint"
    SEQUENTIAL = "sequential"


def failed_plan(error: OptiPrompError, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a plan that could not be tried: a plan's keys, with the error's code."""
    planner = arguments["planner"]
    return {
        "scene": arguments["scene"],
        "planner": planner,
        "strategy": arguments["strategy"] if planner == Planner.OPTI_PROMP else None,
        "status": error.code,
        "message": error.message,
        "metrics": None,
        "terms": None,
        "time": None,
    }


@command(failure=failed_plan)
def plan(
    scene: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|DIR",
            help="A scene file, a built-in scene's name, or a folder of scene files.",
        ),
    ],
    planner: Annotated[
        Planner,
        typer.Option(help="promp: as learnt; i-promp: pushing by geometry; opti-promp: optimised."),
    ] = Planner.OPTI_PROMP,
    strategy: Annotated[
        Strategy,
        typer.Option(help="Of opti-promp. joint: one solve; sequential: the paper's two stages."),
    ] = Strategy.JOINT,
    demonstrations: Annotated[
        Path | None,
        typer.Option(help="NPZ, CSV or a folder of CSVs to learn from, or what 'learn' wrote."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Same seed, same plan.")] = 0,
    duration: Annotated[
        float | None,
        typer.Option(
            metavar="SECONDS", help="Of the motion; the shortest within limits if left out."
        ),
    ] = None,
    knots: Annotated[
        int | None, typer.Option(help="Number of knots of the trajectory, at least 3.")
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Give up planning after this long.")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            "--output",
            metavar="DIR",
            help="Leave plan.json, trajectory.csv and .npz, and figures; of a folder's scenes, "
            "in a folder each.",
        ),
    ] = None,
    figures: Annotated[
        bool | None,
        typer.Option(
            "--figures/--no-figures",
            help="Draw figures into --out; by default for one scene, not for a folder's.",
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(min=1, help="Processes that plan a folder's scenes; one a core if left out."),
    ] = None,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document and nothing else.")
    ] = False,
) -> int:
    """Plan a reach to the target of SCENE and judge it.

    The exit code is 0 only when the plan reaches the target, keeps every
    limit and touches nothing it must not; 1 when no such plan was found;
    2 when the input is wrong. Of a folder's scenes, the largest of these.

    [bold]Examples[/bold]

    \b
    optipromp plan scenario-3 --out reach
    optipromp plan my-scene.yaml --seed 7 --duration 4
    optipromp plan scenario-4 --strategy sequential --json
    optipromp plan scenario-3 --demonstrations recorded.npz
    optipromp plan scenes --output plans
    """
    from optipromp.planning import PlanOptions
    from optipromp.planning import plan as make_plan
    from optipromp.scenes.io import load_scene, scene_names

    if out is not None:
        from optipromp.files import check_folder

        check_folder(out)
    options = PlanOptions(duration=duration, knots=knots)
    if timeout is not None:
        options = replace(options, timeout=timeout)
    request: dict[str, Any] = {
        "planner": planner.value,
        "strategy": strategy.value,
        "demonstrations": None if demonstrations is None else read_primitive(demonstrations),
        "seed": seed,
        "options": options,
    }
    if scene not in scene_names() and Path(scene).is_dir():
        from optipromp.cli.folder import plan_folder

        return plan_folder(Path(scene), out, bool(figures), workers, as_json, request)
    loaded = load_scene(scene)
    say_if_compiling()
    with waiting(f"planning {loaded.name} ...") as say:
        result = make_plan(loaded, progress=say, **request)
    written = leave(result, out, figures is not False) if out is not None else ()
    if as_json:
        print_json(result.to_dict())
    else:
        from optipromp.cli.report import plan_report

        console = stdout()
        console.print(plan_report(result))
        if out is not None:
            console.print(f"wrote {', '.join(written)} to {out}")
    return exit_code(result.status)


def read_primitive(path: Path) -> Any:
    """A learnt ProMP where ``path`` is one that was saved; else the path, to be learnt from."""
    from optipromp.cli.kinds import is_primitive
    from optipromp.promp import ProMP

    return ProMP.load(path) if is_primitive(path) else path


def leave(result: "Plan", folder: Path, figures: bool = True) -> tuple[str, ...]:
    """Write the plan, and figures of it, and say so; returns the names of the files."""
    with waiting("drawing ..."):
        return write(result, folder, figures)


def write(result: "Plan", folder: Path, figures: bool) -> tuple[str, ...]:
    """Write the plan, and figures of it; returns the names of the files."""
    from optipromp.output import write_plan

    if not figures:
        return write_plan(result, folder)
    from optipromp.viewer.figures import plan_figures

    return write_plan(result, folder, plan_figures(result))
