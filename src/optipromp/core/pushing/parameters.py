"""Every tuned number of the push models, the rules and the candidate paths.

The numbers cannot be set: the kernels are compiled with them. The simulation shares some of them;
where it has another value, the source says so. ``docs/decisions.md`` has the measurements.

:class:`Calibration` holds the probability of an unclean pick for a predicted harm, and the largest
harm of a promise.
"""

from dataclasses import dataclass

import numpy as np

from optipromp.core.parameters import GRAVITY, Checked, parameter


@dataclass(frozen=True)
class Calibration(Checked):
    """Tables of predicted harm against simulated runs; interpolated, constant beyond the ends."""

    harm: tuple[float, ...] = parameter((), "1", "choice", "ascending abscissae of ``failed``")
    failed: tuple[float, ...] = parameter(
        (), "1", "measured", "share of runs that are not clean: a logistic curve, docs/studies.md"
    )
    risk: tuple[float, ...] = parameter(
        (0.01, 0.02, 0.03, 0.05, 0.1), "1", "choice", "shares of broken promises, ascending"
    )
    threshold: tuple[float, ...] = parameter(
        (), "1", "measured", "largest harm of a success, for the share ``risk`` of broken promises"
    )

    def probability(self, harm: float) -> float:
        """The probability that a pick of this predicted harm is not clean."""
        return float(np.interp(harm, self.harm, self.failed))

    def allowed(self, risk: float) -> float:
        """The largest harm of a success, for a share of promises that may be broken."""
        return float(np.interp(risk, self.risk, self.threshold))


KNOWN = Calibration(
    harm=(0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 2.0, 3.0),
    failed=(0.002, 0.011, 0.025, 0.052, 0.084, 0.144, 0.208, 0.438, 0.598),
    threshold=(0.05, 0.2, 0.5, 0.9, 2.0),
)
"""Fruits on stems with exactly known positions."""
DETECTED = Calibration(
    harm=(0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 2.0, 3.0),
    failed=(0.006, 0.022, 0.042, 0.074, 0.106, 0.160, 0.212, 0.386, 0.510),
    threshold=(0.05, 0.3, 0.65, 1.1, 2.0),
)
"""Fruits on stems with detected positions, which have errors."""
PACKS = Calibration(
    harm=(0.0, 1.0, 2.0, 4.0, 8.0, 15.0, 30.0, 60.0),
    failed=(0.016, 0.035, 0.053, 0.090, 0.159, 0.262, 0.425, 0.609),
    threshold=(1.6, 2.5, 8.0, 12.0, 30.0),
)
"""Packs, whose harm is the cost of :mod:`optipromp.core.pushing.packs.standing`."""


@dataclass(frozen=True)
class BeamParameters(Checked):
    """Stems as beams with a fruit at the end (:mod:`optipromp.core.pushing.stems.bending`)."""

    youngs_modulus: float = parameter(
        50e6, "Pa", "guess", "of green stems and peduncles, reported between 10 and 100 MPa"
    )
    stiffness_spread: float = parameter(
        2.0,
        "1",
        "reported",
        "standard deviation of an unknown stiffness, as a factor; 10-100 MPa are two of them; "
        "with 2 as many of 48 runs succeed as with 1",
    )
    diameter: float = parameter(
        0.0025, "m", "reported", "of the elastic beam; strawberry peduncles are 2-3 mm thick"
    )
    truss_diameter: float = parameter(
        0.004, "m", "reported", "of a stem that carries others; strawberry inflorescences: 3-5 mm"
    )
    grown_turn: float = parameter(
        0.5, "rad", "guess", "turn from root to tip by which a stem springs back without its fruit"
    )
    bow_least: float = parameter(
        0.01,
        "1",
        "guess",
        "least bow, middle off its line over length; drawn evenly up to the largest. 1,704 "
        "strawberries are off their stems by 4, 9 and 15 degrees (quartiles, StrawDI): arcs "
        "of a bow of 2, 4 and 7 %",
    )
    bow_most: float = parameter(0.05, "1", "guess", "largest bow; as above")
    parting_sweeps: int = parameter(20, "1", "choice", "over the pairs of overlapping fruits")
    parting_gap: float = parameter(1e-5, "m", "choice", "between fruits after parting")
    fruit_density: float = parameter(
        950.0, "kg/m^3", "reported", "strawberries float barely: 0.9-1.0 g/cm^3"
    )
    gravity: float = parameter(GRAVITY, "m/s^2", "choice", "standard")
    stiff_end: float = parameter(
        100.0, "1", "choice", "stiffness of a fruit over that of its stem: nearly rigid"
    )
    loaded: tuple[float, ...] = parameter(
        (5 / 12, 0.75, 1.0),
        "1",
        "choice",
        "shares of the length whose deflection is known; the last: the fruit",
    )
    elements: int = parameter(24, "1", "choice", "of the grid on which contacts are looked up")
    finer: int = parameter(
        2, "1", "choice", "factor on the elements to solve the beam: fruits turn it sharply"
    )


@dataclass(frozen=True)
class SwingParameters(Checked):
    """Contacts of fruits and their equilibrium (``stems/swinging.py``)."""

    stiffness: float = parameter(3000.0, "N/m", "choice", "of a contact: 10 N press 3 mm")
    friction: float = parameter(
        0.15, "1", "guess", "of the cup on fruits; in the simulation tool 0.35, fruits 0.4"
    )
    leaving: float = parameter(
        0.35, "1", "measured", "of a tool that leaves, as in the simulation: what sticks tears"
    )
    skin_friction: float = parameter(
        0.3,
        "1",
        "measured",
        "of fruits on fruits and stems; with it and the next 227 of 240 runs succeed, without "
        "222; in the simulation 0.4",
    )
    stem_friction: float = parameter(
        0.3, "1", "measured", "of the cup on stems, across its axis; in the simulation 0.35"
    )
    stuck: float = parameter(3e-4, "m", "choice", "largest slip in a step of a sticking contact")
    iterations: int = parameter(
        6, "1", "measured", "per step; 24 runs: median error 4.5 mm; with 12 4.7, with 30 5.0 mm"
    )
    settled: float = parameter(
        1e-4, "m", "choice", "largest change of a deflection that ends the iterations"
    )
    farthest: float = parameter(
        0.004, "m", "measured", "motion of a point in an iteration; 8 mm: error 6.7, not 4.5 mm"
    )
    reversal: float = parameter(
        0.5, "1", "choice", "share of the last step; a longer step back is halved"
    )
    kept_speed: float = parameter(0.9, "1", "guess", "share of a fruit's speed that a step keeps")
    close: float = parameter(
        0.016, "m", "choice", "largest gap of a contact that is computed within a step"
    )
    stirred: float = parameter(
        0.007, "m", "choice", "motion in a step after which all contacts are computed again"
    )
    listed: float = parameter(0.08, "m", "choice", "largest gap of a listed static object")
    wandered: float = parameter(
        0.04, "m", "choice", "motion after which static objects are listed again: half that gap"
    )
    neck: float = parameter(
        0.03, "m", "choice", "length of the neck below the cup that stems collide with"
    )
    barely: float = parameter(0.003, "m", "choice", "least depth below the rim of a fruit inside")


@dataclass(frozen=True)
class HarmParameters(Checked):
    """Forces and times that fruits on stems bear (:mod:`optipromp.core.pushing.stems.harm`)."""

    stem_force: float = parameter(
        2.0, "N", "choice", "lasting, that a stem bears; as in the simulation"
    )
    target_force: float = parameter(5.0, "N", "guess", "lasting, that the target bears")
    fruit_force: float = parameter(
        30.0, "N", "guess", "momentary, that another fruit bears; in the simulation 10 N"
    )
    sudden_force: float = parameter(
        14.0, "N", "measured", "largest momentary force without harm: 10 % of good runs have 8 N"
    )
    inside_time: float = parameter(0.03, "s", "choice", "longest of another fruit inside the cup")
    pinched_time: float = parameter(
        0.2,
        "s",
        "measured",
        "longest of a pinched fruit; in 400 runs crushed or torn fruits were pinched for "
        "0.4-0.8 s, 97 % of the others for less than 0.1 s",
    )
    pull: float = parameter(4.0, "N", "measured", "of the way out along a stem, in the model")
    lasting: float = parameter(0.2, "s", "choice", "time in which a lasting force does not fall")
    swallowed: float = parameter(
        5.0, "1", "choice", "harm of a swallowed neighbour or a missed target"
    )
    hopeless: float = parameter(
        3.0, "1", "measured", "largest harm of a state; 9 % of paths harmed, 13 % without a largest"
    )
    risk: float = parameter(
        0.03, "1", "choice", "default share of promised successes that may be broken"
    )
    good: float = parameter(
        0.2, "1", "measured", "harm of a good path; 231 of 240 runs succeed, 226 with 0.5"
    )


@dataclass(frozen=True)
class HangingParameters(Checked):
    """States and candidate paths among fruits on stems (``stems/hanging.py``)."""

    every: int = parameter(3, "1", "choice", "points of a path in a step of the model")
    screened_every: int = parameter(
        6, "1", "measured", "the same to compare candidates; with 3 as many plans succeed, later"
    )
    model_speed: float = parameter(0.07, "m/s", "choice", "of the tool in the model")
    speed: float = parameter(0.1, "m/s", "choice", "largest of the tool on its path")
    states: int = parameter(
        24,
        "1",
        "measured",
        "of exactly known fruits: an outcome may depend on a millimetre. In 400 runs harm "
        "tells failures from successes with an AUC of 0.84; with 9 of the search and others "
        "0.77",
    )
    screened_known: int = parameter(
        3, "1", "measured", "the same in the search; with 9 as many plans succeed, later"
    )
    detected_states: int = parameter(
        32,
        "1",
        "measured",
        "of detected fruits: in 397 runs an AUC of 0.79; with the 7 of the search and 18 "
        "others of their spread 0.71",
    )
    screened_states: int = parameter(
        7, "1", "measured", "the same in the search: 1,003 of 1,100 runs succeed, 1,006 with all"
    )
    causes: int = parameter(12, "1", "choice", "states in which the cause of a harm is searched")
    shift: float = parameter(
        0.003, "m", "guess", "standard deviation of a position without covariance"
    )
    wider: float = parameter(
        1.5, "1", "choice", "factor on standard deviations in the search: unlikely errors harm"
    )
    turn: float = parameter(1.0, "deg", "guess", "standard deviation of a stem's direction")
    detected_turn: float = parameter(4.0, "deg", "guess", "the same of a detected stem")
    around: float = parameter(
        0.4, "m", "choice", "largest distance of a modelled fruit from the target"
    )
    most: int = parameter(
        24, "1", "choice", "fruits beside the target: contacts grow with their square"
    )
    capture: float = parameter(
        0.005, "m", "choice", "depth below the target from which a path is on the approach line"
    )
    lower: float = parameter(
        1.0,
        "1",
        "measured",
        "standard deviations by which a detected fruit may hang lower: the tool is aside of "
        "it, and on the approach line, as much earlier; with it 74 % of 185 scenes with "
        "errors are promised and picked, 68 % without, 73 % with 2",
    )
    apart: float = parameter(45.0, "deg", "choice", "between the first candidates' directions")
    turned: float = parameter(
        1.0, "rad", "choice", "standard deviation of a candidate's directions"
    )
    clearance: float = parameter(
        0.8, "fruit radii", "choice", "lateral clearance of the first candidates, and of the rule"
    )
    clearance_spread: float = parameter(
        0.3, "fruit radii", "choice", "standard deviation of a clearance"
    )
    clearance_least: float = parameter(0.4, "fruit radii", "choice", "of a candidate")
    clearance_most: float = parameter(1.4, "fruit radii", "choice", "of a candidate")
    stem_side: float = parameter(
        0.1, "1", "choice", "least advantage in harm of a path on a stem's side; half a good harm"
    )
    slack: float = parameter(
        0.003, "m", "choice", "least clearance of the cup from static objects without penalty"
    )


@dataclass(frozen=True)
class PlaneParameters(Checked):
    """Packs pushed on a plane (:mod:`optipromp.core.pushing.packs.quasi_static`)."""

    friction: float = parameter(0.4, "1", "guess", "of packs on the board; as in the simulation")
    density: float = parameter(600.0, "kg/m^3", "guess", "of packs; as in the simulation")
    settled: float = parameter(4e-4, "m", "choice", "largest overlap that counts as none")
    sweeps: int = parameter(25, "1", "choice", "largest number over the contacts in a step")
    jammed: float = parameter(
        4e-3, "m", "choice", "overlap after the sweeps above which an object jams"
    )
    ahead: float = parameter(
        0.02, "m", "choice", "gap of near bodies; listed again after a motion of a third of it"
    )
    flat: float = parameter(
        1e-3, "m", "choice", "height within which corners of a polygon touch together"
    )


@dataclass(frozen=True)
class PackParameters(Checked):
    """Costs of a hand's path through packs (:mod:`optipromp.core.pushing.packs.standing`)."""

    step: float = parameter(
        0.004, "m", "measured", "of the model; steps of 2 mm place packs better by 0.3 mm only"
    )
    far: float = parameter(0.03, "m", "choice", "motion of the target that ends a trial")
    worst: float = parameter(
        25.0, "1", "choice", "cost of a failed trial; more where it ends early"
    )
    moved: float = parameter(0.008, "m", "choice", "motion of the target that costs 1")
    light: float = parameter(3.0, "N", "guess", "largest force that costs nothing")
    heavy: float = parameter(2.5, "N", "guess", "force beyond the light one that costs 1")
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
    beside: float = parameter(
        0.03,
        "m/s",
        "measured",
        "largest of the tool beside packs that it is not to push: 30 mm/s press with 6 to 9 N, "
        "15 mm/s with 5 to 8; the judge's limit",
    )
    sideways: float = parameter(0.12, "m", "choice", "largest distance of a path to the side")
    first_corners: int = parameter(3, "1", "choice", "of a path in the first run of the search")
    corners: int = parameter(4, "1", "choice", "of a path in later runs")
    spread_along: float = parameter(0.05, "m", "choice", "standard deviation of a corner along u")
    spread_aside: float = parameter(0.06, "m", "choice", "standard deviation of a corner along v")
    samples: int = parameter(30, "1", "choice", "states besides the perceived one")
    unsure: float = parameter(
        0.006,
        "m",
        "measured",
        "least standard deviation of a position; a quarter of pushed packs: 13 mm",
    )
    slippery_least: float = parameter(
        0.4, "1", "choice", "least friction of a state over the expected one"
    )
    slippery_most: float = parameter(
        1.4, "1", "choice", "largest friction of a state over the expected one"
    )
    good: float = parameter(
        1.6,
        "1",
        "measured",
        "harm of a path that is good enough; with half the candidates and 3 runs for 5 as "
        "many of 30 shelves stay below 8 as with 1.2, in a third of the time",
    )
    tilt: float = parameter(
        5.0, "deg", "choice", "largest, of the approach from the level and of a can from upright"
    )
    before: float = parameter(0.025, "m", "choice", "distance of a path's entry before all packs")
    sure: float = parameter(
        2.0, "1", "choice", "standard deviations by which a pack may be nearer to the hand"
    )
    low: float = parameter(
        0.006, "m", "choice", "of the hand's spheres over the board: packs pushed low do not topple"
    )
    touching: float = parameter(0.01, "m", "choice", "largest gap between target and board")
    around: float = parameter(
        1.0, "m", "choice", "largest distance of a modelled pack from the target"
    )
    most: int = parameter(100, "1", "choice", "largest number of packs: every pair is tested")


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
    upright: float = parameter(4.0, "deg", "choice", "a stem of less lean leaves both sides free")
    widest_turn: float = parameter(
        60.0, "deg", "choice", "largest, from the direction away from the stem"
    )
    centred: float = parameter(
        0.5, "gripper radii", "choice", "a fruit nearer to the approach line gives no direction"
    )
    release: float = parameter(
        0.5,
        "fruit radii",
        "choice",
        "past a pushable's centre, from where on the rim may come back",
    )
    under: float = parameter(
        0.006, "m", "choice", "of a slightly tilted rim below a fruit that it crosses beneath"
    )
    room_to_turn: float = parameter(0.02, "m", "choice", "height in which the tool changes sides")
    alike: float = parameter(0.7, "1", "choice", "least cosine of equal directions")
    most_choices: int = parameter(8, "1", "choice", "largest number of choices of sides")
    level: float = parameter(0.001, "m", "choice", "between the heights of a path")
    sweeps: int = parameter(40, "1", "choice", "over the half-planes at a height")
    rounding: float = parameter(
        0.01, "m", "choice", "width of each moving average; it cuts a corner of 30 degrees by 1 mm"
    )
    point_step: float = parameter(
        0.001, "m", "choice", "of a path's points; an arm keeps to a path within 2 mm"
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
