"""``optipromp simulate``: execute a plan in the physics simulation and tell what happened."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import optipromp
from optipromp.cli.check import scene_or_plan as loaded
from optipromp.cli.command import FAILED, OK, Report, command
from optipromp.cli.console import Seed, say_if_compiling, waiting
from optipromp.cli.robot import ArmOptions, InPlace, Named
from optipromp.core.errors import InvalidRequestError, check_one_of
from optipromp.core.files import check_folder, is_folder

if TYPE_CHECKING:
    from optipromp_sim.simulation import DetectorParameters, Loop, Run, SimulationParameters


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
        from optipromp_sim.situations import JUMP_AT

        values: dict[str, Any] = {"sway": self.sway, "shift": self.shift, "jump": self.jump}
        if self.jump > 0.0:
            values["jump_at"] = JUMP_AT
        if self.sway_frequency is not None:
            if self.sway == 0.0:
                raise InvalidRequestError("--sway-frequency is of a sway: state --sway, too")
            try:
                low, high = (float(part) for part in self.sway_frequency.split(":"))
            except ValueError:
                low = high = float("nan")
            if not 0.0 < low <= high < float("inf"):
                told = f"--sway-frequency is {self.sway_frequency!r}; write it as 0.5:1.6 [Hz]"
                raise InvalidRequestError(told)
            values |= {"sway_frequency": low, "sway_fastest": high}
        return parameters.changed(disturbance=values)


@dataclass(frozen=True)
class LoopOptions:
    """The options of the closed loop and its camera.

    Attributes:
        closed_loop: Detect, plan, detect again from near, and correct the motion all the time.
        noise (NAME): Of the detections: perfect, zero-mean, detector (perfect).
        latency (SECONDS): Of the detections: how late they come (0.06).
        camera (MOUNT): Where the camera is: palm, hand or beside (palm).
    """

    closed_loop: bool = False
    noise: str | None = None
    latency: float | None = None
    camera: str | None = None

    def check(self, further: dict[str, object]) -> None:
        """Refuse options that are of a loop where there is none, or of a plan in a loop.
        ``further``: options that are of a plan, by name; None where they are not given."""
        ours = {"--noise": self.noise, "--latency": self.latency, "--camera": self.camera}
        asked = further if self.closed_loop else ours
        wrong = [name for name, given in asked.items() if given is not None]
        if wrong and self.closed_loop:
            raise InvalidRequestError(f"{', '.join(wrong)}: not with --closed-loop, which plans")
        if wrong:
            raise InvalidRequestError(f"{', '.join(wrong)}: only with --closed-loop")

    def detector(self) -> "DetectorParameters":
        """The camera and its detector."""
        from optipromp_sim.simulation import DETECTORS

        noise = self.noise or "perfect"
        check_one_of("noise", noise, DETECTORS)
        values: dict[str, Any] = {"latency": self.latency, "mount": self.camera}
        given = {name: value for name, value in values.items() if value is not None}
        return replace(DETECTORS[noise], **given)


def pick(
    seen: "optipromp.Scene",
    truth: "optipromp.Scene | None",
    parameters: "SimulationParameters",
    eyes: LoopOptions,
    seed: int,
) -> "Loop":
    """A pick in closed loop. Where plants sway, the first look comes 4 s after the beginning.
    Without ``truth``, ``seen`` is the true scene, and is first seen with the errors of the
    noise."""
    from optipromp_sim.generate import NOISES, noisy
    from optipromp_sim.situations import SETTLE, Situation, picked, seen_at_once

    detector, known = eyes.detector(), truth is not None
    truth = truth or seen
    if truth.target is None:
        raise InvalidRequestError(f"{truth.name} has no target, which --closed-loop looks for")
    if not known and eyes.noise in NOISES:
        seen = noisy(seen, seed, NOISES[eyes.noise])
    if parameters.disturbance.sway > 0.0:
        later = {"jump_at": parameters.disturbance.jump_at + SETTLE}
        parameters = parameters.changed(disturbance=later, engine={"settle": SETTLE})
        if not known:
            alone = parameters.changed(disturbance={"shift": 0.0, "jump": 0.0})
            seen = seen_at_once(seen, truth, seed, alone)
    return picked(Situation(truth, seen, detector, parameters), seed)


def loop_document(loop: "Loop") -> dict[str, Any]:
    """What is told of a loop: result, decisions, cycles [s], innovations, executed curve."""
    from optipromp_sim.situations import loop_figures

    made = loop.controller.plans
    return {
        "planner": "opti-promp",
        "plan_status": made[-1].status if made else None,
        "loop": "closed",
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


@command(failure=lambda asked: {"scene": asked["scene_or_plan"], "success": False, "cause": None})
def simulate(
    scene_or_plan: str,
    /,
    planner: str = "opti-promp",
    true_scene: str | None = None,
    speed: float | None = None,
    seed: Seed = 0,
    out: Path | None = None,
    video: bool = False,
    mp4: bool = False,
    gif: bool = False,
    slow: float = 1.0,
    failed_leg: bool = False,
    reach: bool = False,
    *,
    disturbed: Disturbed,
    eyes: LoopOptions,
    robot: InPlace = None,
    arm: ArmOptions,
) -> Report:
    """Execute a pick in the physics simulation, to its end, and judge what happened there.

    The exit code is 0 only when the target alone ended in the gripper and nothing was harmed; 1
    otherwise; 2 when the input is wrong.

    Examples:
        optipromp simulate scenario-4 --video
        optipromp simulate pick --slow 4 --gif
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
        reach: The reach alone, without the way out.
    """
    from optipromp.core.planning.legs import legs_of
    from optipromp.core.robots.model import warn_of_gravity
    from optipromp_sim.simulation import SimulationParameters
    from optipromp_sim.simulation import simulate as simulated
    from optipromp_sim.simulation.engine import engine

    engine()  # where MuJoCo is missing, refuse before planning
    item = Path(scene_or_plan)
    beside = item if is_folder(item) else item.parent if item.name == "plan.json" else Path("out")
    folder = out or beside
    if not 0.05 <= slow <= 50.0:
        raise InvalidRequestError(f"--slow is {slow:g}; it must be between 0.05 and 50")
    check_folder(folder)
    eyes.check(
        {
            "--planner": None if planner == "opti-promp" else planner,
            "--speed": speed,
            "--failed-leg": failed_leg or None,
            "--reach": reach or None,
        }
    )
    parameters = disturbed.of(SimulationParameters())
    if speed is not None:
        parameters = parameters.changed(control={"speed": speed})
    truth = None if true_scene is None else optipromp.load_scene(true_scene)
    kinds = [kind for kind, on in (("webm", video), ("mp4", mp4), ("gif", gif)) if on]
    leave = partial(_leave, folder=folder, kinds=kinds, slow=slow)
    if eyes.closed_loop:
        found = loaded(scene_or_plan, "simulate")
        if not isinstance(found, optipromp.Scene):
            told = f"{scene_or_plan} is a plan; --closed-loop makes its own: give the scene"
            raise InvalidRequestError(told)
        seen = arm.of(robot).of(found)
        say_if_compiling()
        with waiting(f"picking in {(truth or seen).name} ..."):
            loop = pick(seen, truth, parameters, eyes, seed)
        further = loop_document(loop)
        told = f"closed loop: {loop.result}"
        return _report(loop.run, told, further, (folder, leave(loop.run, loop=loop)))
    plan = _plan(scene_or_plan, planner, seed, arm.of(robot), reach)
    first, *later = legs_of(plan).values()
    for leg in (first, *later):
        warn_of_gravity(leg.robot, leg.trajectory.positions, leg.scene.up, "on the way")
    with waiting(f"executing in {(truth or first.scene).name} ..."):
        settings: Any = {"parameters": parameters, "seed": seed, "failed_leg": failed_leg}
        run = simulated(plan, truth, **settings)
    told = f"{first.planner} (plan: {plan.status})"
    further = {"planner": first.planner, "plan_status": plan.status}
    return _report(run, told, further, (folder, leave(run)))


def _report(
    run: "Run", told: str, further: dict[str, Any], files: tuple[Path, Sequence[str]]
) -> Report:
    """The report of a run, of which ``further`` figures are known; ``files``: folder and names."""
    from optipromp_sim.simulation.execute import run_rows
    from optipromp_sim.simulation.files import run_document

    lines = [
        f"{run.scene.name}  {told}  {run.outcome.told}",
        run.outcome.message,
        *(f"  {name:<26}{words}" for name, words in run_rows(run)),
        *(loop_lines(further) if "decisions" in further else ()),
        f"wrote {', '.join(files[1])} to {files[0]}",
    ]
    return Report({**run_document(run), **further}, lines, OK if run.success else FAILED)


def _plan(
    item: str, planner: str, seed: int, named: Named, reach: bool
) -> "optipromp.Plan | optipromp.Picked":
    from optipromp.core.planning.legs import plan_whole

    found = loaded(item, "simulate")
    if not isinstance(found, optipromp.Scene):
        if named:
            raise InvalidRequestError(f"{item} is a plan, which has its robot; name none")
        return found.reach if reach and isinstance(found, optipromp.Picked) else found
    scene = named.of(replace(found, place=None) if reach else found)
    say_if_compiling()
    verb = optipromp.plan if reach else plan_whole
    with waiting(f"planning {scene.name} ...") as say:
        return verb(scene, planner=planner, seed=seed, progress=say)


def _leave(
    run: "Run", folder: Path, kinds: Sequence[str], slow: float, loop: "Loop | None" = None
) -> tuple[str, ...]:
    """Write the files of a run or a loop; their names."""
    from optipromp_sim.simulation.files import write_loop, write_run

    films = {}
    if kinds:
        from optipromp_sim.simulation.film import animation, film

        shown = loop or run
        with waiting("drawing"):
            for kind in kinds:
                gif = kind == "gif"
                made = animation(shown, slow=slow) if gif else film(shown, slow=slow, kind=kind)
                films[f"run.{kind}"] = made
    further = (write_loop(loop, folder),) if loop else ()
    return *write_run(run, folder, films), *further
