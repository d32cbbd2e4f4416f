"""Every tuned number of the push models, of their rules and of the paths that they look at.

They are the library's numbers and cannot be passed: the kernels are compiled with them. Those that
the simulation has too stand here, and it takes them from here; where it has another value the
source says so. ``docs/decisions.md`` tells the measurements that the sources name.
"""

from dataclasses import dataclass, field

from optipromp.parameters import Checked, parameter


@dataclass(frozen=True)
class BeamParameters(Checked):
    """Stems as beams with a fruit at the end (:mod:`optipromp.pushing.bending`)."""

    youngs_modulus: float = parameter(
        50e6, "Pa", "guess", "green stems and peduncles are reported between some 10 and 100 MPa"
    )
    diameter: float = parameter(
        0.0025, "m", "reported", "strawberry peduncles are 2-3 mm thick; of the elastic beam"
    )
    grown_turn: float = parameter(
        0.5, "rad", "guess", "how far a stem turns, root to tip, once nothing hangs on it"
    )
    fruit_density: float = parameter(
        950.0, "kg/m^3", "reported", "strawberries float barely: 0.9-1.0 g/cm^3"
    )
    gravity: float = parameter(9.81, "m/s^2", "choice", "standard")
    stiff_end: float = parameter(
        100.0, "1", "choice", "how much stiffer than its stem a fruit is: as good as rigid"
    )
    loaded: tuple[float, ...] = parameter(
        (5 / 12, 0.75, 1.0), "1", "choice",
        "shares of the length at which a stem's deflection is known, the last the fruit's centre",
    )  # fmt: skip
    elements: int = parameter(24, "1", "choice", "of the grid on which contacts are looked up")
    finer: int = parameter(
        2, "1", "choice",
        "as many times more when the beam is solved: the fruit's weight turns it sharply",
    )  # fmt: skip


@dataclass(frozen=True)
class SwingParameters(Checked):
    """Contacts of fruits on stems and their equilibrium (:mod:`optipromp.pushing.equilibrium`)."""

    stiffness: float = parameter(3000.0, "N/m", "choice", "of a contact: 10 N press 3 mm")
    friction: float = parameter(
        0.15, "1", "guess",
        "of the cup on fruits; the simulation has 0.35 for the tool and 0.4 for fruits",
    )  # fmt: skip
    stuck: float = parameter(
        3e-4, "m", "choice", "slip of a step up to which a fruit counts as stuck to the cup"
    )
    iterations: int = parameter(
        6, "1", "measured", "24 runs: median error 4.5 mm; 4.7 and 5.0 mm with 12 and 30"
    )
    settled: float = parameter(
        1e-4, "m", "choice", "change of the deflections that ends the iterations"
    )
    farthest: float = parameter(
        0.004,
        "m",
        "measured",
        "that a point moves in an iteration; with 8 mm the error is 6.7 mm, not 4.5",
    )
    reversal: float = parameter(
        0.5, "1", "choice", "share of the last change whose reverse is taken by half"
    )
    kept_speed: float = parameter(
        0.9, "1", "guess", "share of its speed that a fruit keeps from step to step"
    )
    close: float = parameter(
        0.016, "m", "choice", "gap up to which a contact is looked at within a step"
    )
    stirred: float = parameter(
        0.007, "m", "choice", "that fruits move in a step until what is close is looked up again"
    )
    listed: float = parameter(0.08, "m", "choice", "gap up to which what stands firm is listed")
    wandered: float = parameter(
        0.04, "m", "choice", "that a fruit moves until that is listed again; half the gap"
    )
    neck: float = parameter(0.03, "m", "choice", "under the cup that stems are kept off its neck")
    barely: float = parameter(
        0.003, "m", "choice", "under the rim at which a fruit begins to count as inside"
    )


@dataclass(frozen=True)
class HarmParameters(Checked):
    """What fruits on stems bear (:mod:`optipromp.pushing.harm`)."""

    stem_force: float = parameter(2.0, "N", "choice", "lasting, on a stem; as in the simulation")
    target_force: float = parameter(5.0, "N", "guess", "lasting, on the target")
    fruit_force: float = parameter(
        30.0, "N", "guess",
        "momentary, on another fruit; the simulation's limit is 10 N",
    )  # fmt: skip
    sudden_force: float = parameter(
        14.0, "N", "measured",
        "momentary, up to which it says nothing: of runs that go well one in ten has above 8 N",
    )  # fmt: skip
    inside_time: float = parameter(0.03, "s", "choice", "that another fruit may be inside the cup")
    pinched_time: float = parameter(
        0.2, "s", "measured",
        "400 runs: what was crushed or torn was pinched for 0.4-0.8 s, 97 % of the others for less "
        "than 0.1 s; the simulation holds such a fruit, the model lets it slip out",
    )  # fmt: skip
    lasting: int = parameter(5, "1", "choice", "steps over which a force must last")
    swallowed: float = parameter(5.0, "1", "choice", "added for a swallowed or a missed fruit")
    hopeless: float = parameter(
        3.0, "1", "measured",
        "from which a state counts no more; with 25 states 9 % of paths harmed, 13 % before",
    )  # fmt: skip
    threshold: float = parameter(1.0, "1", "measured", "of a success; see docs/studies.md")
    good: float = parameter(0.5, "1", "choice", "that needs no less")
    detected_good: float = parameter(0.2, "1", "choice", "that needs no less, of detected fruits")


@dataclass(frozen=True)
class HangingParameters(Checked):
    """States and candidate paths among fruits on stems (:mod:`optipromp.pushing.hanging`)."""

    every: int = parameter(3, "1", "choice", "points of a path between two steps of the model")
    model_speed: float = parameter(0.07, "m/s", "choice", "of the tool in the model")
    speed: float = parameter(0.1, "m/s", "choice", "of the tool on the path, at most")
    states: int = parameter(
        3, "1", "measured", "of known fruits: 582 of 600 runs succeed, 580 with five"
    )
    detected_states: int = parameter(
        25, "1", "measured", "of detected fruits; with 13, 994 of 1,100 runs succeed, not 1,003"
    )
    screened_states: int = parameter(
        7, "1", "measured", "while searching; 1,003 of 1,100 runs succeed, 1,006 with all"
    )
    shift: float = parameter(
        0.003, "m", "guess", "standard deviation of a fruit that the scene gives no covariance of"
    )
    wider: float = parameter(
        1.5, "1", "choice",
        "times the standard deviation of a detection: it is the unlikely that does harm",
    )  # fmt: skip
    turn: float = parameter(1.0, "deg", "guess", "standard deviation of a stem's direction")
    detected_turn: float = parameter(4.0, "deg", "guess", "of a detected stem's direction")
    around: float = parameter(0.4, "m", "choice", "of the target within which objects are known")
    most: int = parameter(
        24, "1", "choice", "fruits beside the target: what they do to one another takes its square"
    )
    capture: float = parameter(
        0.005, "m", "choice", "below the target at which the rim is to be under it, corners rounded"
    )
    apart: float = parameter(
        45.0, "deg", "choice", "between directions in which all neighbours are passed alike"
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
    slack: float = parameter(0.003, "m", "choice", "that the cup should keep from static objects")


@dataclass(frozen=True)
class PlaneParameters(Checked):
    """Packs pushed on a plane (:mod:`optipromp.pushing.quasi_static`)."""

    friction: float = parameter(0.4, "1", "guess", "of packs on the board; as in the simulation")
    density: float = parameter(600.0, "kg/m^3", "guess", "of packs; as in the simulation")
    settled: float = parameter(4e-4, "m", "choice", "of overlap that is none")
    sweeps: int = parameter(25, "1", "choice", "over the contacts, in a step")
    jammed: float = parameter(
        4e-3, "m", "choice", "of overlap after these at which something gives way that must not"
    )
    ahead: float = parameter(
        0.02, "m", "choice", "less apart are near: looked at until something moves a third of it"
    )
    flat: float = parameter(
        1e-3, "m", "choice", "within which corners of a polygon are pressed together"
    )


@dataclass(frozen=True)
class PackParameters(Checked):
    """What a path of a hand through packs costs (:mod:`optipromp.pushing.trials`)."""

    step: float = parameter(
        0.004, "m", "measured", "of the model; 2 mm place packs better by 0.3 mm only"
    )
    far: float = parameter(0.03, "m", "choice", "that the target may move until it is given up")
    worst: float = parameter(25.0, "1", "choice", "cost of a failed trial; more if it ends early")
    moved: float = parameter(0.008, "m", "choice", "that the target moves for a cost of 1")
    light: float = parameter(3.0, "N", "guess", "of force that cost nothing")
    heavy: float = parameter(2.5, "N", "guess", "beyond it for a cost of 1")
    wide: float = parameter(0.016, "m", "choice", "to a wall that cost nothing")
    tight: float = parameter(0.004, "m", "choice", "less than these for a cost of 1")
    behind: float = parameter(0.01, "m", "choice", "behind the board's edge that cost nothing")
    back: float = parameter(0.005, "m", "choice", "less than these for a cost of 1")
    beyond: float = parameter(
        0.002, "m", "choice", "of the target past 0.4 of the fingers' reach for a cost of 1"
    )
    jam: float = parameter(0.002, "m", "choice", "of overlap for a cost of 1")
    taken: float = parameter(10.0, "1", "choice", "cost of another object between the fingers")


@dataclass(frozen=True)
class StandingParameters(Checked):
    """States and candidate paths among packs (:mod:`optipromp.pushing.standing`)."""

    every: int = parameter(4, "1", "choice", "points of a path between two steps of the model")
    speed: float = parameter(
        0.015, "m/s", "measured", "packs are pushed, not knocked; 18 mm/s press by a tenth more"
    )
    sideways: float = parameter(0.12, "m", "choice", "that a path leads aside at most")
    first_corners: int = parameter(3, "1", "choice", "of a path in the first run of the search")
    corners: int = parameter(4, "1", "choice", "of a path in later runs")
    spread_along: float = parameter(0.05, "m", "choice", "standard deviation of a corner along u")
    spread_aside: float = parameter(0.06, "m", "choice", "standard deviation of a corner along v")
    samples: int = parameter(30, "1", "choice", "states besides the perceived one")
    unsure: float = parameter(
        0.006, "m", "measured",
        "least standard deviation of a position: after a whole path a quarter is off by 13 mm",
    )  # fmt: skip
    slippery_least: float = parameter(
        0.4, "1", "choice", "friction of a state, in the expected one"
    )
    slippery_most: float = parameter(1.4, "1", "choice", "friction of a state, in the expected one")
    good: float = parameter(1.2, "1", "choice", "harm that needs no less")
    threshold: float = parameter(4.0, "1", "choice", "harm of a success; not calibrated yet")
    tilt: float = parameter(
        5.0, "deg", "choice", "of the approach from the level, and of a can from upright, at most"
    )
    before: float = parameter(0.025, "m", "choice", "of all that the tool point enters")
    low: float = parameter(
        0.006, "m", "choice", "that the hand's spheres go over the board: packs do not topple"
    )
    touching: float = parameter(0.01, "m", "choice", "between the target and its board, at most")
    around: float = parameter(1.0, "m", "choice", "of the target within which packs are known")
    most: int = parameter(100, "1", "choice", "packs: a trial asks each of them for every other")


@dataclass(frozen=True)
class RuleParameters(Checked):
    """Neighbours, and the side and height at which the tool passes them."""

    search_radius: float = parameter(0.2, "m", "published", "of the target; method, section 4")
    plane_factor: float = parameter(
        1.5, "gripper radii", "published", "D_plane, from the approach line; method, section 4"
    )
    unsure: float = parameter(
        2.0, "1", "measured", "standard deviations that a detected neighbour may be farther out"
    )
    least_inclination: float = parameter(1.0, "deg", "choice", "of a stem that gives a side")
    upright: float = parameter(4.0, "deg", "choice", "a stem that leans less is in no side's way")
    widest_turn: float = parameter(60.0, "deg", "choice", "from straight away from the stem")
    centred: float = parameter(
        0.5, "gripper radii", "choice", "from the approach line; nearer, a fruit gives no direction"
    )
    release: float = parameter(
        0.5, "fruit radii", "choice", "past a pushable's centre at which the rim may come back"
    )
    under: float = parameter(
        0.006, "m", "choice", "that a rim, tilted a little, stays under a fruit it crosses beneath"
    )
    room_to_turn: float = parameter(0.02, "m", "choice", "of height from one side to another")
    alike: float = parameter(0.7, "1", "choice", "cosine from which two directions are one")
    most_choices: int = parameter(8, "1", "choice", "of sides that are tried")
    level: float = parameter(0.001, "m", "choice", "between the heights that are looked at")
    sweeps: int = parameter(40, "1", "choice", "over the half-planes at one height")
    rounding: float = parameter(
        0.01, "m", "choice", "of a path, each moving average: a corner of 30 degrees is cut by 1 mm"
    )
    point_step: float = parameter(
        0.001,
        "m",
        "choice",
        "between a path's points; fine beside the 2 mm that an arm keeps to it",
    )


@dataclass(frozen=True)
class PushParameters:
    """All of them."""

    beam: BeamParameters = field(default_factory=BeamParameters)
    swing: SwingParameters = field(default_factory=SwingParameters)
    harm: HarmParameters = field(default_factory=HarmParameters)
    hanging: HangingParameters = field(default_factory=HangingParameters)
    plane: PlaneParameters = field(default_factory=PlaneParameters)
    pack: PackParameters = field(default_factory=PackParameters)
    standing: StandingParameters = field(default_factory=StandingParameters)
    rule: RuleParameters = field(default_factory=RuleParameters)


PUSH = PushParameters()
"""The numbers that the library works with."""
