"""Every tuned number of the push models, the rules and the candidate paths.

The numbers cannot be set: the kernels are compiled with them. The simulation shares some of them;
where it has another value, the comment says so. ``docs/decisions.md`` has the measurements.

A comment beside or above a number has its unit (none: 1), its kind (none: a choice) and its
meaning; ``docs/push-parameters.md`` lists them.

:class:`Calibration` holds the probability of an unclean pick for a predicted harm, and the largest
harm of a promise.
"""

from typing import NamedTuple

import numpy as np

from optipromp.core.parameters import FRUIT_DENSITY, GRAVITY


class Calibration(NamedTuple):
    """Tables of predicted harm against simulated runs; interpolated, constant beyond the ends."""

    harm: tuple[float, ...] = ()  # ascending abscissae of ``failed``
    # measured: share of runs that are not clean: a logistic curve, docs/studies.md
    failed: tuple[float, ...] = ()
    risk: tuple[float, ...] = (0.01, 0.02, 0.03, 0.05, 0.1)  # shares of broken promises, ascending
    # measured: largest harm of a success, for the share ``risk`` of broken promises
    threshold: tuple[float, ...] = ()

    def probability(self, harm: float) -> float:
        """The probability that a pick of this predicted harm is not clean."""
        return float(np.interp(harm, self.harm, self.failed))

    def allowed(self, risk: float) -> float:
        """The largest harm of a success, for a share of promises that may be broken."""
        return float(np.interp(risk, self.risk, self.threshold))


KNOWN = Calibration(
    harm=(0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 2.0, 3.0),
    failed=(0.007, 0.034, 0.063, 0.122, 0.199, 0.356, 0.521, 0.897, 0.977),
    threshold=(0.05, 0.2, 0.5, 0.9, 2.0),
)
"""A way in among fruits on stems with exactly known positions."""
DETECTED = Calibration(
    harm=(0.0, 0.1, 0.2, 0.35, 0.5, 0.75, 1.0, 2.0, 3.0),
    failed=(0.029, 0.054, 0.070, 0.093, 0.116, 0.155, 0.195, 0.367, 0.531),
    threshold=(0.05, 0.3, 0.65, 1.1, 2.0),
)
"""A way in among fruits on stems with detected positions, which have errors."""
KNOWN_OUT = Calibration(
    harm=KNOWN.harm,
    failed=(0.009, 0.014, 0.020, 0.032, 0.049, 0.094, 0.162, 0.589, 0.872),
    threshold=(0.2, 0.4, 0.8, 1.2, 2.0),
)
"""A whole pick, way in and way out, past exactly known fruits: 693 runs, 389 of them in the second
engine, too."""
DETECTED_OUT = Calibration(
    harm=DETECTED.harm,
    failed=(0.043, 0.046, 0.050, 0.063, 0.086, 0.158, 0.283, 0.848, 0.979),
    threshold=(0.1, 0.3, 0.8, 0.9, 1.2),
)
"""A whole pick past detected fruits: 482 runs, 337 of them in the second engine, too. Up to a harm
of 0.8 one promise in twelve is broken whatever the harm: fruits are swallowed or missed."""
PACKS = Calibration(
    harm=(0.0, 1.0, 2.0, 4.0, 8.0, 15.0, 30.0, 60.0),
    failed=(0.016, 0.035, 0.053, 0.090, 0.159, 0.262, 0.425, 0.609),
    threshold=(1.6, 2.5, 8.0, 12.0, 30.0),
)
"""Packs, whose harm is the cost of :mod:`optipromp.core.pushing.packs.standing`."""


class BeamParameters(NamedTuple):
    """Stems as beams with a fruit at the end (:mod:`optipromp.core.pushing.stems.bending`)."""

    # [Pa] guess: of green stems and peduncles, reported between 10 and 100 MPa
    youngs_modulus: float = 50e6
    # reported: standard deviation of an unknown stiffness, as a factor; 10-100 MPa are two of them;
    # with 2 as many of 48 runs succeed as with 1
    stiffness_spread: float = 2.0
    diameter: float = 0.0025  # [m] reported: of the beam; strawberry stems are 2-3 mm
    # [m] reported: of a stem that carries others; strawberry inflorescences: 3-5 mm
    truss_diameter: float = 0.004
    # [rad] guess: turn from root to tip by which a stem springs back without its fruit
    grown_turn: float = 0.5
    # guess: least bow, middle off its line over length; drawn evenly up to the largest. 1,704
    # strawberries are off their stems by 4, 9 and 15 degrees (quartiles, StrawDI): arcs of a bow of
    # 2, 4 and 7 %
    bow_least: float = 0.01
    bow_most: float = 0.05  # guess: largest bow; as above
    parting_sweeps: int = 20  # over the pairs of overlapping fruits
    parting_gap: float = 1e-5  # [m] between fruits after parting
    # [kg/m^3] reported: strawberries float barely: 0.9-1.0 g/cm^3
    fruit_density: float = FRUIT_DENSITY
    gravity: float = GRAVITY  # [m/s^2] standard
    stiff_end: float = 100.0  # stiffness of a fruit over that of its stem: nearly rigid
    # shares of the length whose deflection is known; the last: the fruit
    loaded: tuple[float, ...] = (5 / 12, 0.75, 1.0)
    elements: int = 24  # of the grid on which contacts are looked up
    finer: int = 2  # factor on the elements to solve the beam: fruits turn it sharply


class SwingParameters(NamedTuple):
    """Contacts of fruits and their equilibrium (``stems/swinging.py``)."""

    stiffness: float = 3000.0  # [N/m] of a contact: 10 N press 3 mm
    friction: float = 0.15  # guess: of the cup on fruits; in the simulation tool 0.35, fruits 0.4
    # measured: of a tool that leaves, as in the simulation: what sticks to it is torn off
    leaving: float = 0.35
    # measured: of fruits on fruits and stems; with it and the next 227 of 240 runs succeed, without
    # 222; in the simulation 0.4
    skin_friction: float = 0.3
    # measured: of the cup on stems, across its axis; in the simulation 0.35
    stem_friction: float = 0.3
    stuck: float = 3e-4  # [m] largest slip in a step of a sticking contact
    # measured: per step; 24 runs: median error 4.5 mm; with 12 4.7, with 30 5.0 mm
    iterations: int = 6
    settled: float = 1e-4  # [m] largest change of a deflection that ends the iterations
    # [m] measured: motion of a point in an iteration; 8 mm: error 6.7, not 4.5 mm
    farthest: float = 0.004
    reversal: float = 0.5  # share of the last step; a longer step back is halved
    kept_speed: float = 0.9  # guess: share of a fruit's speed that a step keeps
    close: float = 0.016  # [m] largest gap of a contact that is computed within a step
    stirred: float = 0.007  # [m] motion after which contacts are recomputed
    listed: float = 0.08  # [m] largest gap of a listed static object
    wandered: float = 0.04  # [m] motion after which static objects are listed again: half that gap
    neck: float = 0.03  # [m] length of the neck below the cup that stems collide with
    barely: float = 0.003  # [m] least depth below the rim of a fruit inside


class HarmParameters(NamedTuple):
    """Forces and times that fruits on stems bear (:mod:`optipromp.core.pushing.stems.swinging`)."""

    stem_force: float = 2.0  # [N] lasting, that a stem bears; as in the simulation
    target_force: float = 5.0  # [N] guess: lasting, that the target bears
    # [N] guess: momentary, that another fruit bears; in the simulation 10 N
    fruit_force: float = 30.0
    # [N] measured: largest momentary force without harm: 10 % of good runs have 8 N
    sudden_force: float = 14.0
    inside_time: float = 0.03  # [s] longest of another fruit inside the cup
    # [s] measured: longest of a pinched fruit; in 400 runs crushed or torn fruits were pinched for
    # 0.4-0.8 s, 97 % of the others for less than 0.1 s
    pinched_time: float = 0.2
    # [m] measured: room of a long target in the mouth, without which it counts as pressed: of 98
    # picks 14 were of a target that is wider, or reaches below the floor, among them all 4 that
    # harmed it. The floor lifts a fruit as far for nothing
    fit: float = 0.001
    pull: float = 5.0  # [N] guess: along a stem, that it bears; as in the simulation
    lasting: float = 0.2  # [s] time in which a lasting force does not fall
    swallowed: float = 5.0  # harm of a swallowed neighbour or a missed target
    # measured: largest harm of a state; 9 % of paths harmed, 13 % without a largest
    hopeless: float = 3.0
    risk: float = 0.03  # default share of promised successes that may be broken
    good: float = 0.2  # measured: harm of a good path; 231 of 240 runs succeed, 226 with 0.5
    # [1/m³] measured: fruits that the eyes miss in the way of an upright cup of 50 mm, over the
    # volume that no picture shows there: 6 such fruits in 82 sights of `cluster`, `field`, `wild`
    unseen: float = 130.0


class HangingParameters(NamedTuple):
    """States and candidate paths among fruits on stems (``stems/hanging.py``)."""

    every: int = 3  # points of a path in a step of the model
    # measured: the same on a way out: in steps of 3 a fruit slides off the floor within one step
    every_out: int = 1
    # measured: the same to compare candidates; with 3 as many plans succeed, later
    screened_every: int = 6
    model_speed: float = 0.07  # [m/s] of the tool in the model
    speed: float = 0.1  # [m/s] largest of the tool on its path
    # measured: of exactly known fruits: an outcome may depend on a millimetre. In 400 runs harm
    # tells failures from successes with an AUC of 0.84; with 9 of the search and others 0.77
    states: int = 24
    screened_known: int = 3  # measured: the same in the search; with 9 as many plans succeed, later
    # measured: of detected fruits: in 397 runs an AUC of 0.79; with the 7 of the search and 18
    # others of their spread 0.71
    detected_states: int = 32
    # measured: the same in the search: 1,003 of 1,100 runs succeed, 1,006 with all
    screened_states: int = 7
    # measured: share of the allowed harm, up to which the harm in a third of the states or more is
    # that in all: of 144 paths 85 have so little; all of these do 36 % of the allowed harm at most
    sure: float = 0.1
    causes: int = 12  # states in which the cause of a harm is searched
    shift: float = 0.003  # [m] guess: standard deviation of a position without covariance
    wider: float = 1.5  # factor on standard deviations in the search: unlikely errors harm
    turn: float = 1.0  # [deg] guess: standard deviation of a stem's direction
    detected_turn: float = 4.0  # [deg] guess: the same of a detected stem
    around: float = 0.4  # [m] largest distance of a modelled fruit from the target
    most: int = 24  # fruits beside the target: contacts grow with their square
    capture: float = 0.005  # [m] depth below the target from which a path is on the approach line
    # measured: standard deviations by which a detected fruit may hang lower: the tool is aside of
    # it, and on the approach line, as much earlier; with it 74 % of 185 scenes with errors are
    # promised and picked, 68 % without, 73 % with 2
    lower: float = 1.0
    apart: float = 45.0  # [deg] between the first candidates' directions
    turned: float = 1.0  # [rad] standard deviation of a candidate's directions
    clearance: float = 0.8  # [fruit radii] of the first candidates, lateral
    clearance_spread: float = 0.3  # [fruit radii] standard deviation of a clearance
    clearance_least: float = 0.4  # [fruit radii] of a candidate
    clearance_most: float = 1.4  # [fruit radii] of a candidate
    slack: float = 0.003  # [m] cup to static objects, free of penalty


class PlaneParameters(NamedTuple):
    """Packs pushed on a plane (:mod:`optipromp.core.pushing.packs.quasi_static`)."""

    friction: float = 0.4  # guess: of packs on the board; as in the simulation
    density: float = 600.0  # [kg/m^3] guess: of packs; as in the simulation
    settled: float = 4e-4  # [m] largest overlap that counts as none
    sweeps: int = 25  # largest number over the contacts in a step
    jammed: float = 4e-3  # [m] overlap after the sweeps above which an object jams
    ahead: float = 0.02  # [m] gap of near bodies; listed again after a motion of a third of it
    flat: float = 1e-3  # [m] height within which corners of a polygon touch together


class PackParameters(NamedTuple):
    """Costs of a hand's path through packs (:mod:`optipromp.core.pushing.packs.standing`)."""

    # [m] measured: of the model; steps of 2 mm place packs better by 0.3 mm only
    step: float = 0.004
    far: float = 0.03  # [m] motion of the target that ends a trial
    worst: float = 25.0  # cost of a failed trial; more where it ends early
    moved: float = 0.008  # [m] motion of the target that costs 1
    light: float = 3.0  # [N] guess: largest force that costs nothing
    heavy: float = 2.5  # [N] guess: force beyond the light one that costs 1
    wide: float = 0.016  # [m] least distance to a wall that costs nothing
    tight: float = 0.004  # [m] lack of that distance that costs 1
    behind: float = 0.01  # [m] least distance behind the board's edge that costs nothing
    back: float = 0.005  # [m] lack of that distance that costs 1
    beyond: float = 0.002  # [m] distance of the target past 0.4 of the fingers' reach that costs 1
    jam: float = 0.002  # [m] overlap that costs 1
    taken: float = 10.0  # cost of another object between the fingers


class StandingParameters(NamedTuple):
    """States and candidate paths among packs (:mod:`optipromp.core.pushing.packs.standing`)."""

    # [m/s] measured: slow, so as not to knock packs; 18 mm/s press a tenth harder
    speed: float = 0.015
    # [m/s] measured: largest of the tool beside packs that it is not to push: 30 mm/s press with 6
    # to 9 N, 15 mm/s with 5 to 8; the judge's limit
    beside: float = 0.03
    sideways: float = 0.12  # [m] largest distance of a path to the side
    first_corners: int = 3  # of a path in the first run of the search
    corners: int = 4  # of a path in later runs
    spread_along: float = 0.05  # [m] standard deviation of a corner along u
    spread_aside: float = 0.06  # [m] standard deviation of a corner along v
    samples: int = 30  # states besides the perceived one
    # [m] measured: least standard deviation of a position; a quarter of pushed packs: 13 mm
    unsure: float = 0.006
    slippery_least: float = 0.4  # least friction of a state over the expected one
    slippery_most: float = 1.4  # largest friction of a state over the expected one
    # measured: harm of a path that is good enough; with half the candidates and 3 runs for 5 as
    # many of 30 shelves stay below 8 as with 1.2, in a third of the time
    good: float = 1.6
    tilt: float = 5.0  # [deg] largest, of the approach from the level and of a can from upright
    before: float = 0.025  # [m] distance of a path's entry before all packs
    sure: float = 2.0  # standard deviations by which a pack may be nearer to the hand
    low: float = 0.006  # [m] of the hand's spheres over the board: packs pushed low do not topple
    touching: float = 0.01  # [m] largest gap between target and board
    around: float = 1.0  # [m] largest distance of a modelled pack from the target
    most: int = 100  # largest number of packs: every pair is tested


class RuleParameters(NamedTuple):
    """Neighbours, and the side and height at which the tool passes them."""

    search_radius: float = 0.2  # [m] published: around the target; method, section 4
    plane_factor: float = 1.5  # [gripper radii] published: D_plane; method, section 4
    # measured: standard deviations by which a detected neighbour may be farther out
    unsure: float = 2.0
    least_inclination: float = 1.0  # [deg] of a stem that decides the side
    upright: float = 4.0  # [deg] a stem of less lean leaves both sides free
    widest_turn: float = 60.0  # [deg] largest, from the direction away from the stem
    centred: float = 0.5  # [gripper radii] nearer fruits give no direction
    # [fruit radii] past a pushable's centre, from where on the rim may come back
    release: float = 0.5
    under: float = 0.006  # [m] of a tilted rim that crosses below a fruit
    room_to_turn: float = 0.02  # [m] height in which the tool changes sides
    alike: float = 0.7  # least cosine of equal directions
    most_choices: int = 8  # largest number of choices of sides
    level: float = 0.001  # [m] between the heights of a path
    sweeps: int = 40  # over the half-planes at a height
    # [m] width of each moving average; it cuts a corner of 30 degrees by 1 mm
    rounding: float = 0.01
    point_step: float = 0.001  # [m] of a path's points; an arm keeps to a path within 2 mm


class PushParameters(NamedTuple):
    """All numbers of the push models and rules."""

    beam: BeamParameters = BeamParameters()
    swing: SwingParameters = SwingParameters()
    harm: HarmParameters = HarmParameters()
    known: Calibration = KNOWN
    detected: Calibration = DETECTED
    known_out: Calibration = KNOWN_OUT
    detected_out: Calibration = DETECTED_OUT
    packs: Calibration = PACKS
    hanging: HangingParameters = HangingParameters()
    plane: PlaneParameters = PlaneParameters()
    pack: PackParameters = PackParameters()
    standing: StandingParameters = StandingParameters()
    rule: RuleParameters = RuleParameters()


PUSH = PushParameters()
