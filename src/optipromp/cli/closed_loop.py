"""The closed loop of ``optipromp simulate``: its options, its pick, and what is told of it."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from optipromp.core.errors import InvalidRequestError

if TYPE_CHECKING:
    from optipromp.core.scenes.scene import Scene
    from optipromp.laboratory.simulation import DetectorParameters, Loop, SimulationParameters


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
        from optipromp.laboratory.experiments.conditions import ASIDE

        values: dict[str, Any] = {"sway": self.sway, "shift": self.shift, "jump": self.jump}
        if self.jump > 0.0:
            values["jump_at"] = ASIDE["jump_at"]
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
    from optipromp.laboratory.experiments.conditions import SETTLE, Situation, seen_at_once
    from optipromp.laboratory.experiments.loops import picked
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
            for event in loop.controller.events
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
