"""``optipromp plan``: one scene, one plan; see also ``folder`` and ``sequence``."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from optipromp.cli.command import Report, Shown, command, exit_code
from optipromp.cli.console import (
    ChosenStrategy,
    Progress,
    Recorded,
    Seed,
    Strategy,
    Workers,
    headline,
    say_if_compiling,
    waiting,
)
from optipromp.cli.robot import ArmOptions, InPlace
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import is_folder

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.core.planning import Picked, Plan, PlanOptions
    from optipromp.core.promp import ProMP
    from optipromp.core.scenes.scene import Scene


@dataclass(frozen=True)
class Request:
    """The arguments of :func:`optipromp.plan` that all its variants take."""

    planner: Any  # a name, or a planner
    strategy: Strategy
    demonstrations: "ProMP | Path | None"
    seed: int
    options: "PlanOptions"


@dataclass(frozen=True)
class Wanted:
    """The options that say how to plan.

    Attributes:
        planner (NAME): promp: as learnt; i-promp: pushing by geometry; opti-promp: optimised; or
            another that 'optipromp list' names.
        duration (SECONDS): Of the motion; the shortest within limits if left out.
        constraints: push-model: least predicted harm; paper: the paper's constraints 1-3.
        setting (--set KEY=VALUE): Any other setting of the planner, as often as you like;
            'optipromp list' names them.
        timeout (SECONDS): Give up planning after this long.
    """

    planner: str = "opti-promp"
    strategy: ChosenStrategy = "joint"
    demonstrations: Recorded = None
    seed: Seed = 0
    duration: float | None = None
    constraints: Literal["push-model", "paper"] = "push-model"
    setting: list[str] | None = None
    timeout: float | None = None

    def request(self) -> Request:
        """The request of these options; a learnt primitive is read from its file."""
        from optipromp.cli.catalogue import asked

        stated = {
            "duration": self.duration,
            "timeout": self.timeout,
            "constraints": self.constraints,
        }
        found = asked(self.planner, self.strategy, self.setting or [], stated)
        return Request(demonstrations=read_primitive(self.demonstrations), seed=self.seed, **found)


@dataclass(frozen=True)
class Variant:
    """The options of a plan that is not one motion from the start to the scene's target.

    Attributes:
        previous (PLAN_DIR): A plan that runs: go on from it, at --at seconds.
        at (SECONDS): Time in the plan that runs.
        targets (IDS): Ripe fruits, separated by commas: choose their order, and plan each pick; of
            --out, in a folder each.
    """

    previous: Path | None = None
    at: float | None = None
    targets: str | None = None


@dataclass(frozen=True)
class Output:
    """The options of the files that are written.

    Attributes:
        out (DIR): Leave plan.json, trajectory.csv and .npz, waypoints.npz and figures; of a
            folder's scenes, in a folder each.
        rate (HZ): Of the rows in trajectory.csv and .npz.
        figures (--figures/--no-figures): Draw figures into --out; by default for one scene, not for
            a folder's.
    """

    out: Path | None = None
    rate: float = 1000.0
    figures: bool | None = None

    def check(self) -> None:
        """Refuse a folder that cannot be written into, and a rate that is not above 0."""
        if self.out is not None:
            from optipromp.core.files import check_folder

            check_folder(self.out)
        if not 0.0 < self.rate < math.inf:
            raise InvalidRequestError(f"--rate is {self.rate:g}: must be above 0 [Hz]")

    def write(self, result: "Plan", folder: Path, *, figures: bool = False) -> tuple[str, ...]:
        """Write the plan and its figures; returns the names of the files.

        ``figures``: whether figures are drawn where the user does not say.
        """
        from optipromp.core.output import write_plan

        written = write_plan(result, folder, rate=self.rate)  # before the figures, which may fail
        return *written, *self.draw(result, folder, figures=figures)

    def write_legs(self, result: "Picked", folder: Path, *, figures: bool) -> tuple[str, ...]:
        """Write all legs of a pick, and the figures of its reach; see :meth:`write`."""
        from optipromp.core.output import write_pick

        written = write_pick(result, folder, rate=self.rate)
        return *written, *self.draw(result.reach, folder, figures=figures)

    def draw(self, result: "Plan", folder: Path, *, figures: bool) -> tuple[str, ...]:
        """Draw figures of a plan if they are wanted; their names."""
        if not (figures if self.figures is None else self.figures):
            return ()
        from optipromp.core.files import write_atomically
        from optipromp.looks.viewer.figures import plan_figures

        pictures = plan_figures(result)
        for name, content in pictures.items():
            write_atomically(folder / name, content)
        return tuple(pictures)


def failed_plan(error: OptiPrompError, request: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a plan that raised an error: a plan's keys, with the error's code."""
    from optipromp.core.planning.planner import label

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
def plan(
    scene: str,
    /,
    wanted: Wanted,
    variant: Variant,
    output: Output,
    workers: Workers = None,
    progress: Progress = None,
    *,
    robot: InPlace = None,
    arm: ArmOptions,
) -> Report:
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
    optipromp plan crowded-shelf.yaml --progress --timeout 30
    optipromp plan my-scene.yaml --targets ripe,n1,n3 --out picks

    Args:
        scene (SCENE|DIR): A scene file, a built-in scene's name, or a folder of scene files.
    """
    from optipromp.core.scenes.io import load_scene, scene_names

    output.check()
    request, named = wanted.request(), arm.of(robot)
    if scene not in scene_names() and is_folder(Path(scene)):
        from optipromp.cli.folder import plan_folder

        if variant.previous is not None or variant.targets is not None:
            name = "--previous" if variant.targets is None else "--targets"
            raise InvalidRequestError(f"{name} goes with one scene, not with a folder of them")
        return plan_folder(Path(scene), request, output, named, workers, progress)
    loaded = named.of(load_scene(scene))
    say_if_compiling(progress)
    if variant.targets is None:
        report = plan_one(loaded, request, output, variant, progress)
        if output.out is not None:
            _keep_picture(Path(scene), output.out)
        return report
    from optipromp.cli.sequence import plan_targets

    if variant.previous is not None:
        raise InvalidRequestError("--previous goes with one target, not with --targets")
    return plan_targets(loaded, variant.targets, request, output, progress)


def _keep_picture(scene: Path, folder: Path) -> None:
    """Keep the picture that ``see`` left beside the scene, for ``view``; an earlier one goes."""
    from optipromp.core.files import is_file, read_bytes, write_atomically
    from optipromp.perception.pictures import OVERLAY

    picture, kept = scene.with_suffix(OVERLAY), folder / f"seen{OVERLAY}"
    if is_file(picture):
        write_atomically(kept, read_bytes(picture, InvalidRequestError))
    else:
        kept.unlink(missing_ok=True)


def plan_one(
    scene: "Scene",
    request: Request,
    output: Output,
    variant: Variant,
    progress: bool | None = None,
) -> Report:
    """Plan one motion to the target of ``scene``, and write it."""
    from optipromp.core.output import load_plan
    from optipromp.core.planning import plan as make_plan

    if scene.place is not None:
        if variant.previous is not None:
            raise InvalidRequestError("--previous goes with a scene without a place")
        return plan_legs(scene, request, output, progress)
    running = None if variant.previous is None else load_plan(variant.previous)
    with waiting(f"planning {scene.name}", progress) as say:
        result = make_plan(scene, progress=say, previous=running, at=variant.at, **vars(request))
    written: tuple[str, ...] = ()
    if output.out is not None:
        with waiting("drawing", progress):
            written = output.write(result, output.out, figures=True)
    return Report(result.to_dict(), shown(result, written, output.out), exit_code(result.status))


def plan_legs(
    scene: "Scene", request: Request, output: Output, progress: bool | None = None
) -> Report:
    """Plan the pick of ``scene`` with all its legs, and write it."""
    from optipromp.core.planning import plan_pick

    with waiting(f"planning {scene.name}", progress) as say:
        result = plan_pick(scene, progress=say, **vars(request))
    written: tuple[str, ...] = ()
    if output.out is not None:
        with waiting("drawing"):
            written = output.write_legs(result, output.out, figures=True)
    lines = [*shown(result.reach, (), None), *legs_shown(result)]
    if output.out is not None:
        lines.append(f"wrote {', '.join(written)} to {output.out}")
    return Report(result.to_dict(), lines, exit_code(result.status))


def legs_shown(result: "Picked") -> Shown:
    """The status of a pick, and a line for each of its legs."""
    yield headline(("all legs  ", "bold"), (result.status, "bold"), f"  {result.message}")
    for name, leg in result.legs.items():
        harm = "" if leg.prediction is None else f", harm {leg.prediction.harm:.2f}"
        yield f"  {name:<10}{leg.status}, {leg.trajectory.duration:.2f} s{harm}"


def shown(plan: "Plan", written: tuple[str, ...], out: Path | None) -> Shown:
    """The plan's name and status; why it failed, or else the figures by which it is judged."""
    from optipromp.looks.viewer.words import seconds

    strategy = f", {plan.strategy}" if plan.strategy else ""
    colour = "green" if plan.success else "red"
    total = plan.time.get("total", math.nan)
    yield headline(
        (plan.scene.name, "bold"),
        f"  {plan.planner}{strategy}  ",
        (plan.status, f"bold {colour}"),
        f" in {seconds(total)}",
    )
    if plan.message:
        yield plan.message
    if plan.success:
        yield _figures(plan)
    if out is not None:
        yield f"wrote {', '.join(written)} to {out}"


def _figures(plan: "Plan") -> "Table":
    """The figures by which a plan is judged."""
    from rich.table import Table

    from optipromp.looks.viewer.words import plan_rows

    table = Table(box=None, show_header=False, padding=(0, 2))
    for label, value in plan_rows(plan):
        table.add_row(label, value)
    return table


def read_primitive(path: Path | None) -> "ProMP | Path | None":
    """A learnt ProMP where ``path`` is one that was saved; else the path, to be learnt from."""
    if path is None:
        return None
    from optipromp.core.promp.model import ProMP, is_primitive

    return ProMP.load(path) if is_primitive(path) else path
