"""The numbers of the closed loop."""

from dataclasses import dataclass

from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class LoopParameters(Checked):
    """Timing, looks, decisions and retreats of the controller."""

    period: float = parameter(0.02, "s", "choice", "of a cycle: 50 Hz")
    lead: float = parameter(
        0.02, "s", "choice", "from the begin of a cycle to the takeover of its curve: its budget"
    )
    slice_steps: int = parameter(
        6, "1", "measured", "steps of a search that a cycle does; a step takes 1 ms in the median"
    )
    slice_seconds: float = parameter(0.008, "s", "choice", "time that a search gets in a cycle")
    allowance: float = parameter(
        0.12, "s", "choice", "from the begin of a search in motion to the state it plans from"
    )
    first_look: float = parameter(0.4, "s", "choice", "of looking from the start before a plan")
    look: float = parameter(0.5, "s", "choice", "of looking from the camera point")
    settled: float = parameter(
        0.004, "m", "choice", "standard deviation of rests with which a look from there is enough"
    )
    patient: float = parameter(2.5, "s", "choice", "longest look from there at a plant that sways")
    longest_look: float = parameter(3.0, "s", "choice", "of looking for a target from the start")
    views: tuple[float, ...] = parameter(
        (25.0, 50.0), "deg", "choice", "turns of the tool to four sides, to look for a target"
    )
    known: float = parameter(
        0.003, "m", "choice", "standard deviation of a fruit that a scene states without one"
    )
    tries: int = parameter(3, "1", "choice", "looks again, after a retreat or a refused plan")
    accepted: float = parameter(
        2.5, "1", "choice", "predicted harm over that of a success with which the last try begins"
    )
    hopeless: float = parameter(
        4.2, "1", "choice", "the same of a push under way, with which the tool retreats"
    )
    checked: float = parameter(
        0.1, "s", "choice", "shortest time between two predictions of the push under way"
    )
    changed: float = parameter(
        0.002, "m", "choice", "motion of a fruit against the others that asks for a prediction"
    )
    still: float = parameter(
        2e-4, "m", "choice", "displacement of the path below which the running curve goes on"
    )
    field: float = parameter(
        0.05, "m", "choice", "distance at which the displacement of a fruit counts 1/e for a path"
    )
    blends: tuple[float, ...] = parameter(
        (0.1, 0.2, 0.4, 0.8, 1.5), "s", "choice", "tried times until a curve meets the moved path"
    )
    rates: tuple[float, ...] = parameter(
        (1.0, 1.3, 2.0, 3.0), "1", "choice", "tried factors of the time of the rest of a path"
    )
    tail: float = parameter(0.3, "s", "choice", "in which a curve comes to rest with the plant")
    felt: float = parameter(
        0.3, "N", "guess", "deviation of the force on the tool from that of the push model's stems"
    )
    learnt: float = parameter(
        0.01, "m", "choice", "of the tool's path between two observations of the stems' stiffness"
    )
    reach: float = parameter(
        0.025, "m", "choice", "largest distance of a pushed fruit's detection from its track"
    )
    told: float = parameter(
        1.8, "1", "choice", "spread of the stems' stiffness below which plans are told of it"
    )
    yielded: float = parameter(
        0.006, "m", "choice", "least displacement of a fruit that tells of its stem"
    )
    hold: float = parameter(0.5, "s", "choice", "that the tool moves with the plant at the target")
    stuck: float = parameter(
        1.0,
        "s",
        "choice",
        "of waiting for a course onto a route, which is then given up",
    )
    picture_moved: float = parameter(
        0.001, "m", "choice", "motion of the camera after which an equal picture stands still"
    )
    picture_turned: float = parameter(0.005, "rad", "choice", "turn of the camera, likewise")
    picture_still: float = parameter(
        0.2, "s", "choice", "of pictures that stand still, after which the tool stops in a push"
    )
    picture_wait: float = parameter(
        0.5, "s", "choice", "for which it then waits for other pictures, before it backs out"
    )
    stamp: float = parameter(0.04, "s", "choice", "least shift of stamps that is told")
    stamp_most: float = parameter(0.3, "s", "choice", "largest shift that is corrected")
    stamp_error: float = parameter(
        0.01, "s", "choice", "standard deviation of a shift, with which it counts"
    )
    stamp_changes: int = parameter(2, "1", "choice", "of the shift, beyond which it is refused")
    explained: float = parameter(
        0.6, "1", "choice", "share of the fruits' apparent motion that a shift must explain"
    )
    remembered: float = parameter(4.0, "s", "choice", "of the arm's motion, for looks")
    fall: float = parameter(
        0.4, "m/s", "choice", "downward speed above that of a plant: the target falls"
    )
    dropped: float = parameter(0.02, "m", "choice", "of the target below its place, likewise")
    restless: float = parameter(
        0.005, "m", "choice", "predicted swing above which no harm over a success is accepted"
    )
    retreat_speed: float = parameter(0.1, "m/s", "choice", "of the tool on its way back")


CONTROL = LoopParameters()
