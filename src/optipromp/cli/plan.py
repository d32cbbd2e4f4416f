"""``optipromp plan``: one scene, one plan; or a folder of scenes, on all cores."""

import math
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from optipromp.cli.console import (
    OK,
    AsJson,
    ChosenStrategy,
    Recorded,
    Seed,
    Workers,
    command,
    exit_code,
    grid,
    plan_report,
    print_json,
    progress_bar,
    say_if_compiling,
    stdout,
    waiting,
)
from optipromp.cli.robot import Named, names_robot
from optipromp.errors import Code, InvalidRequestError, OptiPrompError
from optipromp.files import is_folder, is_there
from optipromp.shown import printable

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.planning import Plan


_SUFFIXES = (".yaml", ".yml", ".json")

SceneOrFolder = Annotated[
    str,
    typer.Argument(
        metavar="SCENE|DIR",
        help="A scene file, a built-in scene's name, or a folder of scene files.",
    ),
]
ChosenPlanner = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="promp: as learnt; i-promp: pushing by geometry; opti-promp: optimised; or another "
        "that 'optipromp list' names.",
    ),
]
Duration = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="Of the motion; the shortest within limits if left out."),
]
ChosenConstraints = Annotated[
    Literal["push-model", "paper"],
    typer.Option(help="push-model: least predicted harm; paper: the paper's constraints 1-4."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Any other setting of the planner, as often as you like; 'optipromp list' names them.",
    ),
]
Previous = Annotated[
    Path | None,
    typer.Option(metavar="PLAN_DIR", help="A plan that runs: go on from it, at --at seconds."),
]
At = Annotated[float | None, typer.Option(metavar="SECONDS", help="Time in the plan that runs.")]
Targets = Annotated[
    str | None,
    typer.Option(
        metavar="IDS",
        help="Ripe fruits, separated by commas: choose their order, and plan each pick; of --out, "
        "in a folder each.",
    ),
]
Timeout = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Give up planning after this long.")
]
PlanFolder = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Leave plan.json, trajectory.csv and .npz, waypoints.npz and figures; of a folder's "
        "scenes, in a folder each.",
    ),
]
Rate = Annotated[
    float,
    typer.Option(metavar="HZ", help="Of the rows in trajectory.csv and .npz."),
]
Figures = Annotated[
    bool | None,
    typer.Option(
        "--figures/--no-figures",
        help="Draw figures into --out; by default for one scene, not for a folder's.",
        show_default=False,
    ),
]


def failed_plan(error: OptiPrompError, request: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a plan that could not be tried: a plan's keys, with the error's code."""
    from optipromp.planning.planner import label

    planner = label(request["planner"])
    return {
        "scene": request["scene"],
        "planner": planner,
        "strategy": request["strategy"] if planner == "opti-promp" else None,
        "status": error.code,
        "message": error.message,
        **dict.fromkeys(("metrics", "terms", "time")),
    }


@command(failure=failed_plan)
@names_robot("In place of the scene's: built-in name or file.")
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
    previous: Previous = None,
    at: At = None,
    targets: Targets = None,
    out: PlanFolder = None,
    rate: Rate = 1000.0,
    figures: Figures = None,
    workers: Workers = None,
    as_json: AsJson = False,
    *,
    named: Named,
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
    optipromp plan paper-3 --constraints paper --strategy sequential
    optipromp plan scenario-3 --set static_clearance=0.02 --set max_step=0.03
    optipromp plan scenario-3 --demonstrations recorded.npz
    optipromp plan my-scene.yaml --robot ur5.urdf --tip tool0
    optipromp plan scenes --out plans
    optipromp plan seen-again.yaml --previous reach --at 1.5
    optipromp plan my-scene.yaml --targets ripe,n1,n3 --out picks
    """
    from optipromp.cli.catalogue import asked
    from optipromp.planning import plan as make_plan
    from optipromp.scenes.io import load_scene, scene_names

    if out is not None:
        from optipromp.files import check_folder

        check_folder(out)
    if not 0.0 < rate < math.inf:
        raise InvalidRequestError(f"--rate is {rate:g}: must be above 0 [Hz]")
    stated = {"duration": duration, "timeout": timeout, "constraints": constraints}
    request: dict[str, Any] = {
        **asked(planner, strategy, setting or [], stated),
        "demonstrations": None if demonstrations is None else read_primitive(demonstrations),
        "seed": seed,
    }
    if scene not in scene_names() and is_folder(Path(scene)):
        if previous is not None or targets is not None:
            name = "--previous" if targets is None else "--targets"
            raise InvalidRequestError(f"{name} goes with one scene, not with a folder of them")
        return plan_folder(Path(scene), out, rate, bool(figures), workers, as_json, request, named)
    loaded = named.of(load_scene(scene))
    say_if_compiling()
    if targets is not None:
        from optipromp.cli.sequence import plan_targets

        if previous is not None:
            raise InvalidRequestError("--previous goes with one target, not with --targets")
        return plan_targets(loaded, targets, out, rate, bool(figures), as_json, request)
    running = None
    if previous is not None:
        from optipromp.output import load_plan

        running = load_plan(previous)
    with waiting(f"planning {loaded.name} ...") as say:
        result = make_plan(loaded, progress=say, previous=running, at=at, **request)
    return tell(result, out, figures is not False, rate, as_json)


def tell(result: "Plan", out: Path | None, figures: bool, rate: float, as_json: bool) -> int:
    """Write the plan, print what it is, and return its exit code."""
    written: tuple[str, ...] = ()
    if out is not None:
        with waiting("drawing ..."):
            written = write(result, out, figures, rate)
    if as_json:
        print_json(result.to_dict())
    else:
        console = stdout()
        console.print(plan_report(result))
        if out is not None:
            console.print(f"wrote {', '.join(written)} to {out}")
    return exit_code(result.status)


def read_primitive(path: Path) -> Any:
    """A learnt ProMP where ``path`` is one that was saved; else the path, to be learnt from."""
    from optipromp.promp.model import ProMP, is_primitive

    return ProMP.load(path) if is_primitive(path) else path


def write(
    result: "Plan", folder: Path, figures: bool = True, rate: float = 1000.0
) -> tuple[str, ...]:
    """Write the plan, and figures of it; returns the names of the files."""
    from optipromp.output import write_plan

    written = write_plan(result, folder, rate=rate)  # before what may take long, or fail
    if not figures:
        return written
    from optipromp.files import write_atomically
    from optipromp.viewer.figures import plan_figures

    pictures = plan_figures(result)
    for name, content in pictures.items():
        write_atomically(folder / name, content)
    return *written, *pictures


@dataclass(frozen=True)
class Entry:
    """A scene file, where its plan goes, and what came of it."""

    file: Path
    out: Path | None
    result: "Plan | OptiPrompError"

    @property
    def status(self) -> Code:
        """The plan's, or the error's."""
        return self.result.code if isinstance(self.result, OptiPrompError) else self.result.status

    def to_dict(self, request: Mapping[str, Any]) -> dict[str, Any]:
        """The plan's document with the names of its files; an error's has the same keys."""
        if isinstance(self.result, OptiPrompError):
            told = failed_plan(self.result, {"scene": self.file.stem, **request})
        else:
            told = self.result.to_dict()
        return {"file": str(self.file), "out": self.out and str(self.out), **told}


def scene_files(folder: Path) -> list[Path]:
    """The scene files in ``folder``, by name; robot files and plans beside them are passed over.

    Raises:
        InvalidRequestError: there is none, or the folder cannot be read.
    """
    from optipromp.cli.check import Kind, kind_of

    try:
        files = sorted(path for path in folder.iterdir() if path.suffix.lower() in _SUFFIXES)
    except OSError as error:
        raise InvalidRequestError(f"cannot read {folder}: {error.strerror or error}") from error
    kinds = [kind_of(str(path)) for path in files]
    scenes = [path for path, kind in zip(files, kinds, strict=True) if kind is Kind.SCENE]
    for path, kind in zip(files, kinds, strict=True):
        if kind is not Kind.SCENE:
            sys.stderr.write(f"passed over {printable(str(path))}: a {kind}, not a scene\n")
    if not scenes:
        hint = "; it holds a plan, for 'simulate'" if is_there(folder / "plan.json") else ""
        raise InvalidRequestError(f"no scene file ({', '.join(_SUFFIXES)}) in {folder}{hint}")
    return scenes


def outputs(files: Sequence[Path], folder: Path) -> list[Path]:
    """A folder for the plan of each file: its stem, or its whole name where two share a stem."""
    stems = [path.stem for path in files]
    return [folder / (path.name if stems.count(path.stem) > 1 else path.stem) for path in files]


def plan_folder(
    folder: Path,
    out: Path | None,
    rate: float,
    figures: bool,
    workers: int | None,
    as_json: bool,
    request: dict[str, Any],
    named: Named,
) -> int:
    """Plan every scene in ``folder``; ``request`` is what :func:`plan_many` takes besides."""
    from optipromp.planning import plan_many
    from optipromp.scenes.io import load_scene

    files = scene_files(folder)
    homes: Sequence[Path | None] = [None] * len(files) if out is None else outputs(files, out)
    say_if_compiling()
    began = time.perf_counter()
    done_so_far, good = 0, 0
    with progress_bar(10) as shown:

        def done(index: int, result: "Plan | OptiPrompError") -> None:
            nonlocal done_so_far, good
            home = homes[index]
            if home is not None and not isinstance(result, OptiPrompError):
                write(result, home, figures, rate)
            done_so_far, good = done_so_far + 1, good + getattr(result, "success", False)
            words = f"{done_so_far} of {len(files)} planned, {good} succeeded"
            shown(done_so_far, len(files), words)

        stated = [named.of(load_scene(file)) for file in files] if named else files
        results = plan_many(stated, workers=workers, progress=done, **request)
    seconds = time.perf_counter() - began
    entries = [Entry(*item) for item in zip(files, homes, results, strict=True)]
    succeeded = sum(entry.status is Code.SUCCESS for entry in entries)
    if as_json:
        scenes = [entry.to_dict(request) for entry in entries]
        print_json({"folder": str(folder), "succeeded": succeeded, "of": len(entries),
                    "seconds": seconds, "scenes": scenes})  # fmt: skip
    else:
        console = stdout()
        console.print(table(entries))
        console.print(f"{succeeded} of {len(entries)} plans succeeded, in {seconds:.1f} s")
        if out is not None:
            console.print(f"wrote a folder for each plan to {out}")
    return max((exit_code(entry.status) for entry in entries), default=OK)


def table(entries: Sequence[Entry]) -> "Table":
    """One line a scene: what came of it, and the figures that matter most."""
    out = grid(("scene", "status"), ("time, ms", "room, mm", "off, mm", "motion, s"))
    for entry in entries:
        cells = ["", "", "", ""]
        if not isinstance(entry.result, OptiPrompError):
            m = entry.result.metrics
            rooms = m.clearance_static, m.clearance_avoid, m.clearance_pushable, m.clearance_self
            room = min((value for value in rooms if value is not None), default=math.inf)
            cells = [
                f"{1e3 * entry.result.time['total']:.0f}",
                f"{1e3 * room:.1f}" if math.isfinite(room) else "–",
                f"{1e3 * m.goal_error:.2f}",
                f"{m.duration:.2f}",
            ]
        out.add_row(printable(entry.file.stem), str(entry.status), *cells)
    return out
