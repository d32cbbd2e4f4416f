"""``optipromp simulate``: execute a plan in the physics simulation and tell what happened."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from optipromp.cli.check import scene_or_plan
from optipromp.cli.command import FAILED, OK, Report, command
from optipromp.cli.console import ChosenStrategy, Seed, Strategy, say_if_compiling, waiting
from optipromp.cli.robot import ArmOptions, InPlace, Named
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import is_folder

if TYPE_CHECKING:
    from optipromp.core.planning import Picked, Plan
    from optipromp.core.scenes.scene import Scene
    from optipromp.laboratory.simulation import DetectorParameters, Loop, Run, SimulationParameters


@dataclass(frozen=True)
class Disturbed:
    """The options of what moves the fruits; no planner is told of it.

    Attributes:
        sway (METRES): Bound of the sway of the plants' roots.
        sway_frequency (A:B): Of the sway, in Hz, from A to B (0.3:1.6).
        shift (METRES): Fruits hang that far aside of where seen.
        jump (METRES): Fruits jump that far aside after 3 s.
    """

    sway: float = 0.0
    sway_frequency: str | None = None
    shift: float = 0.0
    jump: float = 0.0

    def of(self, parameters: "SimulationParameters") -> "SimulationParameters":
        """The parameters with these disturbances."""
        from optipromp.laboratory.experiments.situations import JUMP_AT

        values: dict[str, Any] = {"sway": self.sway, "shift": self.shift, "jump": self.jump}
        if self.jump > 0.0:
            values["jump_at"] = JUMP_AT
        if self.sway_frequency is not None:
            if self.sway == 0.0:
                raise InvalidRequestError("--sway-frequency is of a sway: state --sway, too")
            values |= _frequencies(self.sway_frequency)
        return replace(parameters, disturbance=replace(parameters.disturbance, **values))


@dataclass(frozen=True)
class LoopOptions:
    """The options of the closed loop and its camera.

    Attributes:
        closed_loop: Look, plan, look again from near, and correct the motion with every look.
        looks_only: Of the loop: execute the plan made at the second look blind.
        noise (NAME): Of the looks: perfect, zero-mean, detector (perfect).
        latency (SECONDS): Of the looks: how late they come (0.06).
        camera (MOUNT): Of the looks: palm, hand or beside (palm).
    """

    closed_loop: bool = False
    looks_only: bool = False
    noise: str | None = None
    latency: float | None = None
    camera: str | None = None

    def check(self, further: dict[str, object]) -> None:
        """Refuse options that are of a loop where there is none, or of a plan in a loop.

        ``further``: options that are of a plan, by name; None where they are not given.
        """
        ours = {
            "--looks-only": self.looks_only or None,
            "--noise": self.noise,
            "--latency": self.latency,
            "--camera": self.camera,
        }
        wrong = [name for name, given in (further if self else ours).items() if given is not None]
        if wrong and self:
            raise InvalidRequestError(f"{', '.join(wrong)}: not with --closed-loop, which plans")
        if wrong:
            raise InvalidRequestError(f"{', '.join(wrong)}: only with --closed-loop")

    def __bool__(self) -> bool:
        return self.closed_loop

    def detector(self) -> "DetectorParameters":
        """The camera and its detector."""
        from optipromp.core.scenes.values import suggest
        from optipromp.laboratory.simulation import DETECTORS

        noise = self.noise or "perfect"
        if noise not in DETECTORS:
            raise InvalidRequestError(f"noise is {noise!r}: {suggest(noise, DETECTORS)}")
        values: dict[str, Any] = {"latency": self.latency, "mount": self.camera}
        given = {name: value for name, value in values.items() if value is not None}
        return replace(DETECTORS[noise], **given)


def pick(
    seen: "Scene",
    truth: "Scene | None",
    parameters: "SimulationParameters",
    eyes: LoopOptions,
    seed: int,
) -> "Loop":
    """A pick in closed loop. Where plants sway, the first look comes 4 s after the beginning.

    ``seen``: the scene; without ``truth`` it is the true one, and is first seen with the errors of
    the noise. ``truth``: the true scene; None: see above. ``parameters``: of the physics. ``eyes``:
    the options of the loop. ``seed``: of everything random.
    """
    from optipromp.laboratory.experiments.loops import picked
    from optipromp.laboratory.experiments.situations import SETTLE, Situation, seen_at_once
    from optipromp.laboratory.generate import NOISES, noisy

    detector, known = eyes.detector(), truth is not None
    truth = truth or seen
    if truth.target is None:
        raise InvalidRequestError(f"{truth.name} has no target, which --closed-loop looks for")
    if not known and eyes.noise in NOISES:
        seen = noisy(seen, seed, NOISES[eyes.noise])
    if parameters.disturbance.sway > 0.0:
        moving = replace(parameters.disturbance, jump_at=parameters.disturbance.jump_at + SETTLE)
        engine = replace(parameters.engine, settle=SETTLE)
        parameters = replace(parameters, disturbance=moving, engine=engine)
        if not known:
            alone = replace(parameters, disturbance=replace(moving, shift=0.0, jump=0.0))
            seen = seen_at_once(seen, truth, seed, alone)
    return picked(Situation(truth, seen, detector, parameters), seed, servo=not eyes.looks_only)


def loop_document(loop: "Loop") -> dict[str, Any]:
    """What is told of a loop: result, decisions, cycles [s], innovations, executed curve."""
    from optipromp.laboratory.experiments.loops import loop_figures

    made = loop.controller.plans
    return {
        "planner": "opti-promp",
        "plan_status": made[-1].status if made else None,
        "loop": "closed" if loop.controller.servo else "looks",
        "result": loop.result,
        "stage": loop.stage,
        "decisions": [
            {"time": event.time, "stage": event.stage, "why": event.why}
            for event in loop.controller.history
        ],
        "legs": {} if loop.picked is None else {k: v.status for k, v in loop.picked.legs.items()},
        "cycles": len(loop.controller.cycles),
        **loop_figures(loop),
    }


def loop_lines(document: dict[str, Any]) -> list[str]:
    """The decisions and the figures of a loop, for people."""
    words = [
        f"  {item['time']:7.2f} s  {item['stage']:<8} {item['why']}"
        for item in document["decisions"]
    ]
    nis = document["nis"]
    told = "no update" if nis is None else f"{nis:.2f} (3 where its covariances are true)"
    cycles = (
        f"{document['cycles']}, median {1e3 * document['cycle_median']:.1f} ms, "
        f"99 % {1e3 * document['cycle_p99']:.1f} ms"
    )
    figures = (
        *((name, str(status)) for name, status in document["legs"].items()),
        ("looks", str(document["looks"])),
        ("cycles", cycles),
        ("tracker's NIS", told),
        ("largest jump", f"{document['worst_jump']:.1e} at takeovers"),
        ("largest share of a limit", f"{100 * document['worst_limit']:.0f} %"),
    )
    return [*words, *(f"  {name:<26}{text}" for name, text in figures)]


def _frequencies(text: str) -> dict[str, float]:
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        low = high = float("nan")
    if not 0.0 < low <= high < float("inf"):
        raise InvalidRequestError(f"--sway-frequency is {text!r}; write it as 0.5:1.6 [Hz]")
    return {"sway_frequency": low, "sway_fastest": high}


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
    scene_or_plan: str,
    /,
    planner: str = "opti-promp",
    strategy: ChosenStrategy = "joint",
    true_scene: str | None = None,
    speed: float | None = None,
    seed: Seed = 0,
    out: Path | None = None,
    video: bool = False,
    mp4: bool = False,
    gif: bool = False,
    slow: float = 1.0,
    failed_leg: bool = False,
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

    Args:
        scene_or_plan (SCENE|PLAN_DIR): A scene to plan for, or a folder that 'plan --out' left, to
            execute as it is.
        planner (NAME): Of a scene; a plan's folder has its plan.
        true_scene (--in SCENE): Execute in this world instead of the plan's own.
        speed (SHARE): Of the velocity limits that the motion uses (0.5).
        out (DIR): Leave outcome.json, rollout.npz, films, of a loop loop.npz here; else in
            PLAN_DIR, or in out.
        video: Draw a film of it: run.webm (VP9).
        mp4: And as run.mp4 (H.264), by x264, which is GPL.
        gif: And as an animation: run.gif.
        slow (FACTOR): How many times slower a film runs.
        failed_leg: Of a pick whose retreat or carry failed: execute that leg, too.
    """
    from optipromp.core.files import check_folder
    from optipromp.core.planning import Picked
    from optipromp.core.robots.model import warn_of_gravity
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
    from optipromp.laboratory.simulation.files import write_loop, write_run

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
