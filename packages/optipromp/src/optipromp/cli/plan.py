"""``optipromp plan``: a pick; those of a folder of scenes; several ripe fruits of one scene. Of a
folder, each plan is written into a folder of its own, and all cores plan."""

import math
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optipromp
from optipromp.cli import console
from optipromp.cli.command import FAILED, OK, Report, Shown, command, exit_code
from optipromp.cli.robot import ArmOptions, InPlace
from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError, printable
from optipromp.core.files import file_name, is_folder, is_there, json_text, write_atomically

if TYPE_CHECKING:
    from rich.table import Table

    from optipromp.cli.robot import Named
    from optipromp.core.planning import Picked, Plan
    from optipromp.core.planning.sequence import PickSequence, Result
    from optipromp.core.promp import ProMP
    from optipromp.core.scenes.scene import Scene, SceneObject

_SUFFIXES = (".yaml", ".yml", ".json")
ORDER = "sequence.json"


Request = dict[str, Any]  # The arguments of ``optipromp.plan`` that all its variants take, by name


@dataclass(frozen=True)
class Wanted:
    """The options that say how to plan.

    Attributes:
        planner (NAME): promp: as learnt; i-promp: pushing by geometry; opti-promp: optimised; or
            another that 'optipromp list' names.
        duration (SECONDS): Of the motion; the shortest within limits if left out.
        velocity_scaling (SHARE): Of the joints' velocity limits that the motion uses, up to 1.
        acceleration_scaling (SHARE): Of their limits of acceleration and jerk, likewise.
        setting (--set KEY=VALUE): Any other setting of the planner, as often as you like;
            'optipromp list' names them.
        timeout (SECONDS): Give up planning after this long.
    """

    planner: str = "opti-promp"
    demonstrations: console.Recorded = None
    seed: console.Seed = 0
    duration: float | None = None
    velocity_scaling: float | None = None
    acceleration_scaling: float | None = None
    setting: list[str] | None = None
    timeout: float | None = None

    def request(self) -> Request:
        """The request of these options; a learnt primitive is read from its file."""
        from optipromp.cli.catalogue import asked

        stated = {
            "duration": self.duration,
            "velocity_scaling": self.velocity_scaling,
            "acceleration_scaling": self.acceleration_scaling,
            "timeout": self.timeout,
        }
        found = asked(self.planner, self.setting or [], stated)
        return {**found, "demonstrations": read_primitive(self.demonstrations), "seed": self.seed}


@dataclass(frozen=True)
class Variant:
    """The options of a plan that is not one motion from the start to the scene's target.

    Attributes:
        previous (PLAN_DIR): A plan that runs: go on from it, at --at seconds, with a reach alone.
        at (SECONDS): Time in the plan that runs.
        targets (IDS): Ripe fruits, separated by commas: choose their order, and plan each pick; of
            --out, in a folder each.
        reach: Plan the reach alone, without the way out and the way to the scene's place.
    """

    previous: Path | None = None
    at: float | None = None
    targets: str | None = None
    reach: bool = False


@dataclass(frozen=True)
class Output:
    """The options of the files that are written.

    Attributes:
        out (DIR): Leave plan.json, trajectory.csv and .npz, waypoints.npz, retreat.csv and .npz,
            and figures; of a folder's scenes, in a folder each.
        rate (HZ): Of the rows in the .csv files and trajectory.npz.
        figures (--figures/--no-figures): Draw figures into --out; by default for one scene, not for
            a folder's.
        details: Print the figures of a success, too: M_c, M_p, clearances, costs.
    """

    out: Path | None = None
    rate: float = 1000.0
    figures: bool | None = None
    details: bool = False

    def check(self) -> None:
        """Refuse a folder that cannot be written into, and a rate that is not above 0."""
        if self.out is not None:
            from optipromp.core.files import check_folder

            check_folder(self.out)
        if not 0.0 < self.rate < math.inf:
            raise InvalidRequestError(f"--rate is {self.rate:g}: must be above 0 [Hz]")

    def write(
        self, result: "Plan | Picked", folder: Path, *, figures: bool = False
    ) -> tuple[str, ...]:
        """Write a plan, or all legs of a pick, and figures; the names of the files. ``figures``:
        whether figures are drawn where the user does not say."""
        from optipromp.core.planning.legs import legs_of

        whole = optipromp.Picked(dict(legs_of(result)))
        written = optipromp.write_pick(whole, folder, rate=self.rate)
        if not (figures if self.figures is None else self.figures):
            return written
        from optipromp.looks.viewer.figures import plan_figures

        pictures = plan_figures(result)  # after the plan is written: they may fail
        for name, content in pictures.items():
            write_atomically(folder / name, content)
        return *written, *pictures


def failed_plan(request: Mapping[str, Any]) -> dict[str, Any]:
    """The document of a plan that raised an error: a plan's keys, without the error's."""
    from optipromp.core.planning.planners import label

    return {
        "scene": request["scene"],
        "planner": label(request["planner"]),
        **dict.fromkeys(("status", "message", "metrics", "terms", "time")),
    }


@command(failure=failed_plan)
def plan(
    scene: str,
    /,
    wanted: Wanted,
    variant: Variant,
    output: Output,
    workers: console.Workers = None,
    progress: console.Progress = None,
    *,
    robot: InPlace = None,
    arm: ArmOptions,
) -> Report:
    """Plan the pick of the target of SCENE, with its way out, and judge it.

    Where no tool takes a target, or with --reach, a reach alone. The exit
    code is 0 only when the plan reaches the target, leaves with it, keeps every
    limit and touches nothing it must not; 1 when no such plan was found;
    2 when the input is wrong. Of a folder's scenes, the largest of these.

    Examples:
        optipromp plan scenario-4 --out pick
        optipromp plan scenario-4 --planner paper --set strategy=joint --json
        optipromp plan scenario-3 --planner paper --set drift_offset=0.03
        optipromp plan scenario-3 --set static_clearance=0.02 --set max_step=0.03
        optipromp plan scenario-3 --demonstrations recorded.npz
        optipromp plan my-scene.yaml --robot ur5.urdf --tip tool0
        optipromp plan scenes --out plans
        optipromp plan seen-again.yaml --previous reach --at 1.5
        optipromp plan my-scene.yaml --targets ripe,n1,n3 --out picks

    Args:
        scene (SCENE|DIR): A scene file, a built-in scene's name, or a folder of scene files.
    """
    from optipromp.core.scenes.io import scene_names

    output.check()
    request, named = wanted.request(), arm.of(robot)
    if scene not in scene_names() and is_folder(Path(scene)):
        if name := "--previous" * bool(variant.previous) or "--targets" * bool(variant.targets):
            raise InvalidRequestError(f"{name} goes with one scene, not with a folder of them")
        return plan_folder(Path(scene), request, output, named, workers, progress, variant.reach)
    loaded = named.of(optipromp.load_scene(scene))
    if variant.reach or variant.previous is not None:
        loaded = replace(loaded, place=None)
    console.say_if_compiling(progress)
    if variant.targets is None:
        report = plan_one(loaded, request, output, variant, progress)
        if output.out is not None:
            _keep_picture(Path(scene), output.out)
        return report
    if variant.previous is not None:
        raise InvalidRequestError("--previous goes with one target, not with --targets")
    return plan_targets(loaded, variant.targets, request, output, progress)


def _keep_picture(scene: Path, folder: Path) -> None:
    """Keep the picture that ``see`` left beside the scene, for ``view``; an earlier one goes."""
    from optipromp.core.files import is_file, read_bytes
    from optipromp.core.output import OVERLAY

    picture, kept = scene.with_suffix(OVERLAY), folder / f"seen{OVERLAY}"
    if is_file(picture):
        write_atomically(kept, read_bytes(picture, InvalidRequestError))
    else:
        kept.unlink(missing_ok=True)


def plan_one(
    scene: "Scene", request: Request, output: Output, variant: Variant, progress: bool | None = None
) -> Report:
    """Plan the pick of ``scene`` with all its legs, or one motion, and write it."""
    from optipromp.core.planning.legs import plan_whole

    at, previous = variant.at, variant.previous
    running = None if previous is None else optipromp.load_plan(previous)

    def planned(scene: "Scene") -> "Plan | Picked":
        with console.waiting(f"planning {scene.name}", progress) as say:
            if not variant.reach and running is None and at is None:
                return plan_whole(scene, progress=say, **request)
            return optipromp.plan(scene, progress=say, previous=running, at=at, **request)

    result = planned(scene)
    advice = ""
    unsure = any(each.covariance is not None for each in scene.objects)
    if unsure and exit_code(result.status) == FAILED and result.status is not Code.TIMEOUT:
        advice = SECOND if exit_code(planned(better_known(scene)).status) != FAILED else ""
    written: tuple[str, ...] = ()
    if output.out is not None:
        with console.waiting("drawing", progress):
            written = output.write(result, output.out, figures=True)
    document = result.to_dict() | ({"advice": advice} if advice else {})
    lines = [*shown(result, written, output), *([advice] if advice else [])]
    return Report(document, lines, exit_code(result.status))


SECOND = (
    "a second picture would help: take one from aside (70 degrees about the vertical), look at "
    "both with 'optipromp see FOLDER --together', and plan in that"
)
"""Advice where a plan is found once places are known as two pictures tell them."""


def better_known(scene: "Scene") -> "Scene":
    """The scene as a second picture would tell it: half the variances of places, and of the tilts
    of stems that were not seen."""

    def better(item: "SceneObject") -> "SceneObject":
        if item.covariance is not None:
            item = replace(item, covariance=0.5 * item.covariance)
        if item.stem is not None and item.stem.tilt is not None:
            item = replace(item, stem=replace(item.stem, tilt=math.sqrt(0.5) * item.stem.tilt))
        return item

    return scene.each(better)


def shown(result: "Plan | Picked", written: tuple[str, ...], output: Output) -> Shown:
    """Name, status and message of a plan; of a success what it does, and its figures if wanted."""
    from rich.table import Table

    from optipromp.core.planning.legs import legs_of
    from optipromp.looks.viewer.drawn import pushed
    from optipromp.looks.viewer.sentences import sentences
    from optipromp.looks.viewer.words import plan_rows, seconds

    plan, *later = legs_of(result).values()
    yield console.headline(
        (plan.scene.name, "bold"),
        f"  {plan.planner}  ",
        (result.status, f"bold {'green' if result.success else 'red'}"),
        f" in {seconds(sum(leg.time.get('total', math.nan) for leg in (plan, *later)))}",
    )
    if result.message:
        yield result.message
    if result.success:
        yield from sentences(result, pushed(result).shifts())
    if plan.success and output.details:
        table = Table(box=None, show_header=False, padding=(0, 2))
        for row in plan_rows(result):
            table.add_row(*row)
        yield table
    if output.out is not None:
        yield f"wrote {', '.join(written)} to {output.out}"


def read_primitive(path: Path | None) -> "ProMP | Path | None":
    """A learnt ProMP where ``path`` is one that was saved; else the path, to be learnt from."""
    if path is None:
        return None
    from optipromp.core.promp.model import is_primitive

    return optipromp.ProMP.load(path) if is_primitive(path) else path


@dataclass(frozen=True)
class Entry:
    """A scene file, the folder of its plan, and the plan or the error."""

    file: Path
    out: Path | None
    result: "Result"

    @property
    def status(self) -> Code:
        """The status of the plan, or the code of the error."""
        return self.result.code if isinstance(self.result, OptiPrompError) else self.result.status

    def to_dict(self, request: Request) -> dict[str, Any]:
        """The plan's document with the paths of its files; an error's has the same keys."""
        if isinstance(self.result, OptiPrompError):
            told = failed_plan({"scene": self.file.stem, **request})
            told |= {"status": self.result.code, "message": self.result.message}
        else:
            told = self.result.to_dict()
        return {"file": str(self.file), "out": self.out and str(self.out), **told}


def scene_files(folder: Path) -> list[Path]:
    """The scene files in ``folder``, by name; robot files and plans are passed over."""
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
    request: Request,
    output: Output,
    named: "Named",
    workers: int | None = None,
    progress: bool | None = None,
    reach: bool = False,
) -> Report:
    """Plan every scene in ``folder``, with the robot that is named, and write each plan."""
    from optipromp.core.errors import NoPlanError
    from optipromp.core.processes import cores, run_each

    files, out = scene_files(folder), output.out
    homes: Sequence[Path | None] = [None] * len(files) if out is None else outputs(files, out)
    console.say_if_compiling(progress)
    began = time.perf_counter()
    results, good = dict[int, "Result"](), 0
    with console.progress_bar(10, progress) as shown:

        def done(index: int, result: "Result | BrokenProcessPool") -> None:
            nonlocal good
            home = homes[index]
            if isinstance(result, BrokenProcessPool):
                result = NoPlanError(str(result))
            elif home is not None and not isinstance(result, OptiPrompError):
                output.write(result, home)
            results[index], good = result, good + getattr(result, "success", False)
            words = f"{len(results)} of {len(files)} planned, {good} succeeded"
            shown(len(results), len(files), words)

        stated = [named.of(optipromp.load_scene(file)) for file in files] if named else files
        tasks = [(scene, request, reach) for scene in stated]
        run_each(planned, tasks, done, workers=workers or cores())
    seconds = time.perf_counter() - began
    entries = [Entry(*item, results[k]) for k, item in enumerate(zip(files, homes, strict=True))]
    document = {
        "folder": str(folder),
        "succeeded": good,
        "of": len(entries),
        "seconds": seconds,
        "scenes": [entry.to_dict(request) for entry in entries],
    }
    lines: list[Any] = [table(entries)]
    lines.append(f"{good} of {len(entries)} plans succeeded, in {seconds:.1f} s")
    if out is not None:
        lines.append(f"wrote a folder for each plan to {out}")
    return Report(document, lines, max((exit_code(entry.status) for entry in entries), default=OK))


def planned(scene: "Scene | Path", request: Request, reach: bool) -> "Result":
    """The pick of a scene, or its ``reach`` alone, or the error."""
    from optipromp.core.planning.legs import plan_whole

    try:
        return optipromp.plan(scene, **request) if reach else plan_whole(scene, **request)
    except OptiPrompError as error:
        return error.with_traceback(None)


def table(entries: Sequence[Entry]) -> "Table":
    """The status and the main figures of each scene; the motion is that of all its legs."""
    from optipromp.looks.viewer.words import least

    out = console.grid(("scene", "status"), ("time, ms", "room, mm", "off, mm", "motion, s"))
    for entry in entries:
        cells = ["", "", "", ""]
        if not isinstance(entry.result, OptiPrompError):
            made = entry.result
            reach = made if isinstance(made, optipromp.Plan) else made.reach
            m = reach.metrics
            room = least(
                m.clearance_static, m.clearance_avoid, m.clearance_pushable, m.clearance_self
            )
            cells = [
                f"{1e3 * reach.time['total']:.0f}",
                "–" if room is None else f"{1e3 * room:.1f}",
                f"{1e3 * reach.metrics.goal_error:.2f}",
                f"{made.duration:.2f}",
            ]
        out.add_row(printable(entry.file.stem), str(entry.status), *cells)
    return out


def plan_targets(
    scene: "Scene", targets: str, request: Request, output: Output, progress: bool | None = None
) -> Report:
    """Plan the picks of ``targets`` (ids, separated by commas), and write each plan."""
    ids = [part.strip() for part in targets.split(",") if part.strip()]
    with console.waiting(f"planning {scene.name}", progress) as say:
        found = optipromp.plan_sequence(scene, ids, progress=say, **request)
    document, out = found.to_dict(), output.out
    written = []
    if out is not None:
        homes = [file_name(f"{i + 1}-{id_}") for i, id_ in enumerate(found.order)]
        homes += [file_name(f"left-{left.id}") for left in found.left]
        made = [*found.whole, *(left.made for left in found.left)]
        tolds = [*document["picks"], *document["left"]]
        for home, pick, told in zip(homes, made, tolds, strict=True):
            output.write(pick, out / home)
            told["out"] = str(out / home)
        write_atomically(out / ORDER, json_text(document).encode("utf-8"))
        written = [f"wrote {', '.join([*homes, ORDER])} to {out}"]
    lines = [
        *(f"{left.id} stays: {left.message}" for left in found.left),
        f"{len(found.picks)} of {len(ids)} planned",
        *written,
    ]
    return Report(document, _order(found, lines), OK if found.success else FAILED)


def _order(found: "PickSequence", lines: Sequence[str]) -> Shown:
    table = console.grid(("pick", "status"), ("not clean", "motion, s"))
    for id_, pick, made in zip(found.order, found.picks, found.whole, strict=True):
        failure = "–" if math.isnan(made.failure) else f"{100.0 * made.failure:.0f} %"
        table.add_row(id_, str(pick.status), failure, f"{made.duration:.2f}")
    for left in found.left:
        table.add_row(left.id, str(left.status), "–", "–")
    yield table
    yield from lines
