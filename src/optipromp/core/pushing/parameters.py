"""Every tuned number of the push models, of their rules and of the candidate paths.

The numbers cannot be set: the kernels are compiled with them. The simulation takes from here the
numbers that it shares with the models; where it has another value, the source says so.
``docs/decisions.md`` tells the measurements that the sources name.
"""

from dataclasses import dataclass

from optipromp.core.parameters import GRAVITY, Checked, parameter
from optipromp.core.pushing.calibration import DETECTED, KNOWN, PACKS, Calibration


@dataclass(frozen=True)
class BeamParameters(Checked):
    """Stems as beams with a fruit at the end (:mod:`optipromp.core.pushing.stems.bending`)."""

    youngs_modulus: float = parameter(
        50e6, "Pa", "guess", "green stems and peduncles are reported between 10 and 100 MPa"
    )
    stiffness_spread: float = parameter(
        2.0, "1", "reported",
        "factor by which stems whose stiffness nobody told may be softer, or stiffer: a standard "
        "deviation, where 10-100 MPa are two of them; with 2 as many of 48 runs succeed as with 1",
    )  # fmt: skip
    diameter: float = parameter(
        0.0025, "m", "reported", "of the elastic beam; strawberry peduncles are 2-3 mm thick"
    )
    truss_diameter: float = parameter(
        0.004, "m", "reported",
        "the same of a stem that carries others; strawberry inflorescence axes are 3-5 mm thick",
    )  # fmt: skip
    grown_turn: float = parameter(
        0.5, "rad", "guess", "turn, root to tip, by which a stem springs back without its fruit"
    )
    bow_least: float = parameter(
        0.01, "1", "guess",
        "least bow of a stem, middle off its line over length; drawn evenly between this and the "
        "next. Axes of strawberries are off their stems by 4, 9 and 15 degrees (25, 50, 75 % of "
        "1,704 labelled fruits, StrawDI): an arc that ends so has a bow of 2, 4 and 7 %",
    )  # fmt: skip
    bow_most: float = parameter(0.05, "1", "guess", "largest bow of a stem; as above")
    parting_sweeps: int = parameter(
        20, "1", "choice", "over the pairs of fruits that overlap as they are seen"
    )
    parting_gap: float = parameter(1e-5, "m", "choice", "between fruits that were pushed apart")
    fruit_density: float = parameter(
        950.0, "kg/m^3", "reported", "strawberries float barely: 0.9-1.0 g/cm^3"
    )
    gravity: float = parameter(GRAVITY, "m/s^2", "choice", "standard")
    stiff_end: float = parameter(
        100.0, "1", "choice", "stiffness of a fruit over that of its stem: as good as rigid"
    )
    loaded: tuple[float, ...] = parameter(
        (5 / 12, 0.75, 1.0), "1", "choice",
        "shares of the length at which a stem's deflection is known, the last the fruit's centre",
    )  # fmt: skip
    elements: int = parameter(
        24, "1", "choice", "elements of the grid on which contacts are looked up"
    )
    finer: int = parameter(
        2, "1", "choice",
        "factor on the elements when the beam is solved: the fruit's weight turns it sharply",
    )  # fmt: skip


@dataclass(frozen=True)
class SwingParameters(Checked):
    """Contacts of fruits and their equilibrium (``stems/equilibrium.py``)."""

    stiffness: float = parameter(3000.0, "N/m", "choice", "of a contact: 10 N press 3 mm")
    friction: float = parameter(
        0.15, "1", "guess", "of the cup on fruits; in the simulation tool 0.35, fruits 0.4"
    )
    skin_friction: float = parameter(
        0.3, "1", "measured",
        "of fruits on fruits and on stems; with it and the next, 227 of 240 runs succeed, 222 "
        "without; in the simulation 0.4",
    )  # fmt: skip
    stem_friction: float = parameter(
        0.3, "1", "measured", "of the cup on stems, across its axis; in the simulation 0.35"
    )
    stuck: float = parameter(
        3e-4, "m", "choice", "largest slip in a step of a fruit that sticks to the cup"
    )
    iterations: int = parameter(
        6, "1", "measured", "per step; 24 runs: median error 4.5 mm; with 12 4.7, with 30 5.0 mm"
    )
    settled: float = parameter(
        1e-4, "m", "choice", "largest change of a deflection that ends the iterations"
    )
    farthest: float = parameter(
        0.004, "m", "measured", "of a point in an iteration; with 8 mm the error is 6.7, not 4.5 mm"
    )
    reversal: float = parameter(
        0.5, "1", "choice", "a step back of more than this share of the last one is halved"
    )
    kept_speed: float = parameter(
        0.9, "1", "guess", "share of its speed that a fruit keeps from one step to the next"
    )
    close: float = parameter(
        0.016, "m", "choice", "largest gap of a contact that is looked at within a step"
    )
    stirred: float = parameter(
        0.007, "m", "choice", "motion in a step after which contacts are looked up again"
    )
    listed: float = parameter(0.08, "m", "choice", "largest gap of a static object that is listed")
    wandered: float = parameter(
        0.04, "m", "choice", "motion of a fruit after which they are listed again: half that gap"
    )
    neck: float = parameter(
        0.03, "m", "choice", "length of the neck, from the cup down, that stems are kept off"
    )
    barely: float = parameter(
        0.003, "m", "choice", "depth below the rim at which a fruit begins to count as inside"
    )


@dataclass(frozen=True)
class HarmParameters(Checked):
    """What fruits on stems bear (:mod:`optipromp.core.pushing.stems.harm`)."""

    stem_force: float = parameter(
        2.0, "N", "choice", "lasting force that a stem bears; as in the simulation"
    )
    target_force: float = parameter(5.0, "N", "guess", "lasting force that the target bears")
    fruit_force: float = parameter(
        30.0, "N", "guess", "momentary, that another fruit bears; in the simulation 10 N"
    )
    sudden_force: float = parameter(
        14.0, "N", "measured", "momentary, that counts nothing: a tenth of good runs have over 8 N"
    )
    inside_time: float = parameter(
        0.03, "s", "choice", "longest that another fruit may be inside the cup"
    )
    pinched_time: float = parameter(
        0.2, "s", "measured",
        "longest that a fruit may be pinched; in 400 runs, crushed or torn fruits were pinched for "
        "0.4-0.8 s, 97 % of the others for less than 0.1 s",
    )  # fmt: skip
    lasting: float = parameter(0.2, "s", "choice", "time in which a lasting force does not fall")
    swallowed: float = parameter(
        5.0, "1", "choice", "harm of a swallowed neighbour or a missed target"
    )
    hopeless: float = parameter(
        3.0, "1", "measured",
        "largest harm of one state; with 25 states 9 % of paths harmed, 13 % without a largest",
    )  # fmt: skip
    risk: float = parameter(
        0.03, "1", "choice", "share of promised successes that may be broken, where none is told"
    )
    good: float = parameter(
        0.2, "1", "measured",
        "harm below which a path is good enough; 231 of 240 runs succeed, 226 with 0.5",
    )  # fmt: skip


@dataclass(frozen=True)
class HangingParameters(Checked):
    """States and candidate paths among fruits on stems (``stems/hanging.py``)."""

    every: int = parameter(3, "1", "choice", "points of a path in a step of the model")
    screened_every: int = parameter(
        6, "1", "measured",
        "the same where candidates are compared on one state; with 3 as many plans succeed, later",
    )  # fmt: skip
    model_speed: float = parameter(0.07, "m/s", "choice", "of the tool in the model")
    speed: float = parameter(0.1, "m/s", "choice", "largest, of the tool on its path")
    states: int = parameter(
        24, "1", "measured",
        "of exactly known fruits: an outcome may hang on a millimetre. In 400 runs harm tells "
        "failures from successes with an AUC of 0.84; with the 9 of the search and others 0.77",
    )  # fmt: skip
    screened_known: int = parameter(
        3, "1", "measured", "of the search past them; with 9 as many plans succeed, later"
    )
    detected_states: int = parameter(
        32, "1", "measured",
        "of detected fruits: in 397 runs an AUC of 0.79; with the 7 of the search and 18 others, "
        "spread as wide as those, 0.71",
    )  # fmt: skip
    screened_states: int = parameter(
        7, "1", "measured", "of the search: 1,003 of 1,100 runs succeed, 1,006 with all states"
    )
    causes: int = parameter(
        12, "1", "choice", "states in the worst of which the cause of a harm is looked for"
    )
    shift: float = parameter(
        0.003, "m", "guess", "standard deviation of a position without covariance in the scene"
    )
    wider: float = parameter(
        1.5,
        "1",
        "choice",
        "factor on standard deviations in the states of the search: unlikely errors do the harm",
    )
    turn: float = parameter(1.0, "deg", "guess", "standard deviation of a stem's direction")
    detected_turn: float = parameter(4.0, "deg", "guess", "the same of a detected stem")
    around: float = parameter(
        0.4, "m", "choice", "largest distance from the target of a known fruit"
    )
    most: int = parameter(
        24, "1", "choice", "fruits beside the target: contacts grow with their square"
    )
    capture: float = parameter(
        0.005, "m", "choice", "from this far below the target a path is on the approach line"
    )
    lower: float = parameter(
        1.0, "1", "measured",
        "standard deviations by which a detected fruit may hang lower than it is seen: the tool is "
        "aside of it, and on the approach line, as much earlier; with it 74 % of 185 scenes with "
        "errors are promised and picked, 68 % without, and 73 % with 2",
    )  # fmt: skip
    apart: float = parameter(
        45.0, "deg", "choice", "between first candidates, which pass all neighbours alike"
    )
    turned: float = parameter(
        1.0, "rad", "choice", "standard deviation of a candidate's directions"
    )
    clearance: float = parameter(
        0.8, "fruit radii", "choice", "lateral clearance of the first candidates, and of the rule"
    )
    clearance_spread: float = parameter(0.3, "fruit radii", "choice", "its standard deviation")
    clearance_least: float = parameter(0.4, "fruit radii", "choice", "of a candidate")
    clearance_most: float = parameter(1.4, "fruit radii", "choice", "of a candidate")
    stem_side: float = parameter(
        0.1,
        "1",
        "choice",
        "harm by which a path on the side of a stem must be the lesser; half of a good one",
    )
    slack: float = parameter(
        0.003, "m", "choice", "clearance that the cup should keep from static objects"
    )


@dataclass(frozen=True)
class PlaneParameters(Checked):
    """Packs pushed on a plane (:mod:`optipromp.core.pushing.packs.quasi_static`)."""

    friction: float = parameter(0.4, "1", "guess", "of packs on the board; as in the simulation")
    density: float = parameter(600.0, "kg/m^3", "guess", "of packs; as in the simulation")
    settled: float = parameter(4e-4, "m", "choice", "largest overlap that counts as none")
    sweeps: int = parameter(25, "1", "choice", "largest number over the contacts in a step")
    jammed: float = parameter(
        4e-3, "m", "choice", "largest overlap after these; more means that an object jams"
    )
    ahead: float = parameter(
        0.02, "m", "choice", "gap of near bodies; listed again after a motion of a third of it"
    )
    flat: float = parameter(
        1e-3, "m", "choice", "corners of a polygon that are level to this are pressed together"
    )


@dataclass(frozen=True)
class PackParameters(Checked):
    """What a path of a hand through packs costs (:mod:`optipromp.core.pushing.packs.trials`)."""

    step: float = parameter(
        0.004, "m", "measured", "of the model; steps of 2 mm place packs better by 0.3 mm only"
    )
    far: float = parameter(0.03, "m", "choice", "motion of the target at which a trial ends")
    worst: float = parameter(
        25.0, "1", "choice", "cost of a failed trial; more where it ends early"
    )
    moved: float = parameter(0.008, "m", "choice", "motion of the target that costs 1")
    light: float = parameter(3.0, "N", "guess", "largest force that costs nothing")
    heavy: float = parameter(2.5, "N", "guess", "force beyond it that costs 1")
    wide: float = parameter(0.016, "m", "choice", "least distance to a wall that costs nothing")
    tight: float = parameter(0.004, "m", "choice", "lack of that distance that costs 1")
    behind: float = parameter(
        0.01, "m", "choice", "least distance behind the board's edge that costs nothing"
    )
    back: float = parameter(0.005, "m", "choice", "lack of that distance that costs 1")
    beyond: float = parameter(
        0.002, "m", "choice", "distance of the target past 0.4 of the fingers' reach that costs 1"
    )
    jam: float = parameter(0.002, "m", "choice", "overlap that costs 1")
    taken: float = parameter(10.0, "1", "choice", "cost of another object between the fingers")


@dataclass(frozen=True)
class StandingParameters(Checked):
    """States and candidate paths among packs (:mod:`optipromp.core.pushing.packs.standing`)."""

    speed: float = parameter(
        0.015, "m/s", "measured", "slow, so as not to knock packs; 18 mm/s press a tenth harder"
    )
    sideways: float = parameter(0.12, "m", "choice", "largest distance of a path to the side")
    first_corners: int = parameter(3, "1", "choice", "of a path in the first run of the search")
    corners: int = parameter(4, "1", "choice", "of a path in later runs")
    spread_along: float = parameter(0.05, "m", "choice", "standard deviation of a corner along u")
    spread_aside: float = parameter(0.06, "m", "choice", "standard deviation of a corner along v")
    samples: int = parameter(30, "1", "choice", "states besides the perceived one")
    unsure: float = parameter(
        0.006, "m", "measured",
        "least standard deviation of a position: after a path one pack in four is 13 mm off",
    )  # fmt: skip
    slippery_least: float = parameter(
        0.4, "1", "choice", "least friction of a state over the expected one"
    )
    slippery_most: float = parameter(
        1.4, "1", "choice", "largest friction of a state over the expected one"
    )
    good: float = parameter(
        1.6, "1", "measured",
        "harm below which a path is good enough; with half the candidates and 3 runs for 5 as many "
        "of 30 shelves stay below 8 as with 1.2, in a third of the time",
    )  # fmt: skip
    tilt: float = parameter(
        5.0, "deg", "choice", "largest, of the approach from the level and of a can from upright"
    )
    before: float = parameter(
        0.025, "m", "choice", "distance before all packs at which a path begins"
    )
    sure: float = parameter(
        2.0, "1", "choice", "standard deviations by which a pack may be nearer to the hand"
    )
    low: float = parameter(
        0.006, "m", "choice", "of the hand's spheres over the board: packs pushed low do not topple"
    )
    touching: float = parameter(0.01, "m", "choice", "largest gap between the target and its board")
    around: float = parameter(
        1.0, "m", "choice", "largest distance from the target of a known pack"
    )
    most: int = parameter(
        100, "1", "choice", "largest number of packs: a trial asks every pair of them"
    )


@dataclass(frozen=True)
class RuleParameters(Checked):
    """Neighbours, and the side and height at which the tool passes them."""

    search_radius: float = parameter(0.2, "m", "published", "around the target; method, section 4")
    plane_factor: float = parameter(
        1.5, "gripper radii", "published", "D_plane, from the approach line; method, section 4"
    )
    unsure: float = parameter(
        2.0, "1", "measured", "standard deviations by which a detected neighbour may be farther out"
    )
    least_inclination: float = parameter(1.0, "deg", "choice", "of a stem that decides the side")
    upright: float = parameter(
        4.0, "deg", "choice", "a stem that leans less leaves both sides free"
    )
    widest_turn: float = parameter(
        60.0, "deg", "choice", "largest, from the direction away from the stem"
    )
    centred: float = parameter(
        0.5, "gripper radii", "choice", "a fruit nearer to the approach line gives no direction"
    )
    release: float = parameter(
        0.5, "fruit radii", "choice", "from this far past a pushable's centre the rim may come back"
    )
    under: float = parameter(
        0.006, "m", "choice", "that a slightly tilted rim stays below a fruit it crosses beneath"
    )
    room_to_turn: float = parameter(0.02, "m", "choice", "height in which the tool changes sides")
    alike: float = parameter(0.7, "1", "choice", "cosine from which two directions are one")
    most_choices: int = parameter(8, "1", "choice", "largest number of choices of sides")
    level: float = parameter(0.001, "m", "choice", "between the heights that are looked at")
    sweeps: int = parameter(40, "1", "choice", "over the half-planes at a height")
    rounding: float = parameter(
        0.01, "m", "choice", "width of each moving average; it cuts a corner of 30 degrees by 1 mm"
    )
    point_step: float = parameter(
        0.001,
        "m",
        "choice",
        "of a path's points; less than the 2 mm within which an arm keeps to it",
    )


@dataclass(frozen=True)
class PushParameters:
    """All numbers of the push models and rules."""

    beam: BeamParameters = BeamParameters()
    swing: SwingParameters = SwingParameters()
    harm: HarmParameters = HarmParameters()
    known: Calibration = KNOWN
    detected: Calibration = DETECTED
    packs: Calibration = PACKS
    hanging: HangingParameters = HangingParameters()
    plane: PlaneParameters = PlaneParameters()
    pack: PackParameters = PackParameters()
    standing: StandingParameters = StandingParameters()
    rule: RuleParameters = RuleParameters()


PUSH = PushParameters()
"""The numbers that the library works with."""
