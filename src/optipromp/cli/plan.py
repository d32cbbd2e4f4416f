"""``optipromp plan``: one scene, one plan; or a folder of scenes."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optipromp.cli.console import (
    command,
    exit_code,
    print_json,
    say_if_compiling,
    stdout,
    waiting,
)
from optipromp.cli.options import (
    AsJson,
    ChosenConstraints,
    ChosenPlanner,
    ChosenStrategy,
    Duration,
    Figures,
    PlanFolder,
    Recorded,
    SceneOrFolder,
    Seed,
    Settings,
    Timeout,
    Workers,
)
from optipromp.errors import OptiPrompError

if TYPE_CHECKING:
    from optipromp.planning import Plan


def failed_plan(error: OptiPrompError, arguments: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a plan that could not be tried: a plan's keys, with the error's code."""
    planner = arguments["planner"]
    return {
        "scene": arguments["scene"],
        "planner": planner,
        "strategy": arguments["strategy"] if planner == "opti-promp" else None,
        "status": error.code,
        "message": error.message,
        **dict.fromkeys(("metrics", "terms", "time")),
    }


@command(failure=failed_plan)
def plan(
    scene: SceneOrFolder,
    planner: ChosenPlanner = "opti-promp",
    strategy: ChosenStrategy = "joint",
    demonstrations: Recorded = None,
    seed: Seed = 0,
    duration: Duration = None,
    constraints: ChosenConstraints = "push-model",
    setting: Settings = None,
    timeout: Timeout = None,
    out: PlanFolder = None,
    figures: Figures = None,
    workers: Workers = None,
    as_json: AsJson = False,
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
    optipromp plan scenario-3 --constraints paper --set paper.drift_offset=0.03
    optipromp plan scenario-3 --set static_clearance=0.02 --set max_step=0.03
    optipromp plan scenario-3 --demonstrations recorded.npz
    optipromp plan scenes --out plans
    """
    from optipromp.cli.settings import settings
    from optipromp.planning import plan as make_plan
    from optipromp.scenes.io import load_scene, scene_names

    if out is not None:
        from optipromp.files import check_folder

        check_folder(out)
    options = settings(setting or [], duration=duration, timeout=timeout, constraints=constraints)
    request: dict[str, Any] = {
        "planner": planner,
        "strategy": strategy,
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
