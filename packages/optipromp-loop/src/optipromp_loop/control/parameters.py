"""The numbers of the closed loop; ``docs/closed-loop.md`` says more of each."""

from dataclasses import dataclass

from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class LoopParameters(Checked):
    """Timing, looks, decisions and retreats of the controller."""

    period: float = parameter(0.02, "s", "choice", "of a cycle: 50 Hz")
    lead: float = parameter(0.02, "s", "choice", "from a cycle to the takeover of its curve")
    slice_steps: int = parameter(6, "1", "measured", "of a search in a cycle; one takes 1 ms")
    standing_steps: int = parameter(16, "1", "choice", "of a search while the arm stands")
    slice_seconds: float = parameter(0.008, "s or inf", "choice", "that a search gets in a cycle")
    allowance: float = parameter(0.12, "s", "choice", "from a search in motion to where it begins")
    first_look: float = parameter(0.4, "s", "choice", "of looking from the start before a plan")
    look: float = parameter(0.5, "s", "choice", "of looking from the camera point")
    settled: float = parameter(0.004, "m", "choice", "deviation of rests that is small enough")
    patient: float = parameter(2.5, "s", "choice", "longest look from there at a plant that sways")
    longest_look: float = parameter(3.0, "s", "choice", "of looking for a target from the start")
    views: tuple[float, ...] = parameter((25.0, 50.0), "deg", "choice", "turns to four sides")
    known: float = parameter(0.003, "m", "choice", "deviation of a fruit that states none")
    tries: int = parameter(3, "1", "choice", "looks again, after a retreat or a refused plan")
    # of a pick that was a success: a harm that is predicted again varies by 0.1 to 0.5
    budget: float = parameter(1.25, "1", "measured", "harm over that of a success, predicted again")
    checked: float = parameter(0.1, "s", "choice", "between two predictions of a push, at least")
    changed: float = parameter(0.002, "m", "choice", "motion of a fruit that asks for a prediction")
    still: float = parameter(2e-4, "m", "choice", "of the path: below, the running curve goes on")
    field: float = parameter(0.05, "m", "choice", "where a fruit's displacement counts 1/e")
    # in which the error beside the moved path fades
    blends: tuple[float, ...] = parameter((0.1, 0.2, 0.4, 0.8, 1.5), "s", "choice", "tried")
    # of the time of the rest of a path
    rates: tuple[float, ...] = parameter((1.0, 1.3, 2.0, 3.0), "1", "choice", "factors tried")
    tail: float = parameter(0.3, "s", "choice", "in which a curve comes to rest with the plant")
    reach: float = parameter(0.025, "m", "choice", "from what is to be avoided to its detection")
    hold: float = parameter(0.5, "s", "choice", "that the tool moves with the plant at the target")
    stuck: float = parameter(1.0, "s", "choice", "of waiting for a course onto a route")
    picture_moved: float = parameter(0.001, "m", "choice", "of the camera: an equal picture is old")
    picture_turned: float = parameter(0.005, "rad", "choice", "turn of the camera, likewise")
    picture_still: float = parameter(0.2, "s", "choice", "of old pictures, then a push stops")
    picture_wait: float = parameter(0.5, "s", "choice", "for others, before the tool backs out")
    off_curve: float = parameter(0.1, "rad or m", "choice", "of a joint: beyond, as Guard.tracking")
    state_age: float = parameter(0.1, "s", "choice", "without a state of the arm: five cycles")
    look_age: float = parameter(1.0, "s", "choice", "without a look: ten of the slowest detector")
    clock_step: float = parameter(0.1, "s", "choice", "by which a clock was set, as state_age")
    stamp: float = parameter(0.04, "s", "choice", "least shift of stamps that is told")
    stamp_most: float = parameter(0.3, "s", "choice", "largest shift that is corrected")
    stamp_error: float = parameter(0.01, "s", "choice", "deviation of a shift with which it counts")
    stamp_changes: int = parameter(2, "1", "choice", "of the shift, beyond which it is refused")
    explained: float = parameter(0.6, "1", "choice", "share of motion that a shift must explain")
    remembered: float = parameter(4.0, "s", "choice", "of the arm's motion, for looks")
    fall: float = parameter(0.4, "m/s", "choice", "downwards, above that of a plant: it falls")
    dropped: float = parameter(0.02, "m", "choice", "of the target below its place, likewise")
    retreat_speed: float = parameter(0.1, "m/s", "choice", "of the tool on its way back")


CONTROL = LoopParameters()
