"""The tuned numbers of planning that are no options of :class:`PlanOptions`."""

from dataclasses import dataclass

from optipromp.core.parameters import Checked, parameter


@dataclass(frozen=True)
class WaypointParameters(Checked):
    """The number of a trajectory's waypoints, and their spacing."""

    fewest: int = parameter(60, "1", "choice", "least number of a trajectory")
    fewest_reach: int = parameter(25, "1", "choice", "least number before the path")
    fewest_approach: float = parameter(40.0, "1", "choice", "least number on the path")
    most: int = parameter(600, "1", "choice", "largest number of a trajectory")
    peak: float = parameter(
        1.9, "1", "choice", "ratio of largest to mean speed of a smooth reach; minimum jerk: 1.875"
    )
    share: float = parameter(
        0.8, "1", "choice", "share of ``max_step`` that sets the number of waypoints"
    )
    tool_step: float = parameter(0.005, "m", "choice", "largest step of the tool on its path")
    tool_time: float = parameter(0.17, "s", "choice", "longest time between waypoints on the path")
    braking: float = parameter(
        0.3, "1", "choice", "share of the approach's time in which the tool comes to rest"
    )
    primitive: int = parameter(150, "1", "choice", "number of the trajectory of a primitive")


@dataclass(frozen=True)
class FollowParameters(Checked):
    """The primitive conditioned on a path, and the arm led along it (``planning/follow.py``)."""

    stations: int = parameter(
        8, "1", "choice", "points of the path that the primitive is conditioned on"
    )
    linearisations: int = parameter(
        4, "1", "measured", "of the kinematics; the last changes a joint by about 1e-3 rad"
    )
    posture_step: float = parameter(
        0.5, "rad", "choice", "largest change of a joint at a station in a linearisation"
    )
    station_deviation: float = parameter(
        2e-3,
        "m",
        "choice",
        "standard deviation of the tool point at a station; equal to the corridor of the solve",
    )
    axis_lever: float = parameter(0.3, "m", "choice", "weighs the tool axis against the tool point")
    tracked: float = parameter(1e-4, "m", "choice", "largest error of a followed tool point")
    task_tracked: float = parameter(1e-5, "m", "choice", "largest error of a followed task point")


@dataclass(frozen=True)
class GoalParameters(Checked):
    """Goal configurations (``planning/goals.py``)."""

    few_starts: int = parameter(12, "1", "choice", "of inverse kinematics, for a primitive")
    starts: int = parameter(24, "1", "measured", "of inverse kinematics, at first; decisions.md")
    more_starts: int = parameter(48, "1", "choice", "where fewer than ``spare`` solutions are free")
    many_starts: int = parameter(320, "1", "choice", "where no solution is free")
    enough: int = parameter(6, "1", "choice", "free configurations to choose among")
    spare: int = parameter(
        3, "1", "choice", "with fewer free configurations, more starts are tried"
    )
    poses: int = parameter(12, "1", "choice", "in a goal's region, beside its middle")
    inside: float = parameter(
        0.9, "1", "choice", "share of a goal's tolerances within which its poses lie"
    )
    distinct: float = parameter(
        0.25, "rad", "choice", "least difference of a joint between two distinct configurations"
    )
    room: float = parameter(0.06, "m", "choice", "clearance beyond which more is not better")
    self_margin: float = parameter(0.01, "m", "choice", "the same between links")
    same_room: float = parameter(
        2e-4, "m", "choice", "largest difference of equal clearances from static objects"
    )
    nearest_error: float = parameter(
        1e-6, "m", "choice", "largest error of a goal found by following the approach line"
    )
    nearest_margin: float = parameter(
        0.05, "rad or m", "choice", "least distance of that goal from the joint limits"
    )


@dataclass(frozen=True)
class KeptParameters(Checked):
    """Constraints of a path (``planning/follow.py``)."""

    share: float = parameter(
        0.9, "1", "choice", "of the limits at waypoints, so that the curve between them is inside"
    )
    reached: float = parameter(1e-4, "m", "choice", "largest error of inverse kinematics")


@dataclass(frozen=True)
class LineParameters(Checked):
    """Straight lines between way points (``planning/lines.py``)."""

    step: float = parameter(5e-3, "m", "choice", "largest step of the tool between two waypoints")
    turn: float = parameter(0.03, "rad", "choice", "largest turn of the tool between two waypoints")
    fewest: int = parameter(20, "1", "choice", "least number of waypoints of a line")
    tracked: float = parameter(1e-5, "m", "choice", "largest error of inverse kinematics")
    jump: float = parameter(
        0.3, "rad or m", "choice", "motion of a joint between two waypoints that is another branch"
    )
    branches: int = parameter(60, "1", "choice", "of the first way point that are followed")
    tries: int = parameter(6, "1", "choice", "branches to which a free motion is planned")
    near: float = parameter(
        1e-5, "rad or m", "choice", "distance of a branch from the start that counts as none"
    )
    share: float = parameter(
        0.5, "1", "choice", "of the allowed distance from a line that the planner uses"
    )
    refinements: int = parameter(3, "1", "choice", "of a line's waypoints, each to twice as many")
    parts: int = parameter(4, "1", "choice", "of an interval, for which line and speed are checked")


@dataclass(frozen=True)
class PickParameters(Checked):
    """How many paths are followed, and how they are compared (``planning/pick.py``)."""

    invalid: float = parameter(
        2.5,
        "1",
        "choice",
        "harm added where the trajectory is not valid; less than the harm of a swallowed fruit",
    )
    goals: int = parameter(3, "1", "choice", "goal configurations that a path is followed to")
    tries: int = parameter(
        6, "1", "choice", "paths that are followed while no valid trajectory keeps the margin"
    )
    few_tries: int = parameter(
        2, "1", "choice", "paths that are followed where other approaches remain to be tried"
    )


@dataclass(frozen=True)
class SolveParameters(Checked):
    """Stiffnesses of constraints, in the priority of method §5 (``planning/pick.py``)."""

    must: float = parameter(1e6, "1/m^2", "choice", "joint limits, contacts, the goal")
    firm: float = parameter(
        1e5, "1/m^2", "choice", "clearance from objects to avoid and between links, joint steps"
    )
    kept: float = parameter(
        1e4, "1/m^2", "choice", "the tool path; static clearance has twice this"
    )
    wish: float = parameter(
        1e3, "1/m^2", "choice", "the tool's clearance from objects to avoid, the level of a hand"
    )
    lean: float = parameter(1e2, "1/rad^2", "choice", "the tilt of the tool on the path")
    touch_margin: float = parameter(
        1e-3, "m", "choice", "clearance from static objects below which ``must`` applies"
    )
    upright: float = parameter(2.0, "deg", "choice", "tilt of the tool allowed on the path")
    within: float = parameter(
        3e-3, "1", "choice", "curvature inside the corridor, as a share of the walls' curvature"
    )
    safety: float = parameter(0.01, "m", "published", "epsilon of F_s and F_d; the method")
    far_damping: float = parameter(
        1e-2, "1", "choice", "first damping where a start breaks constraints"
    )
    far_tolerance: float = parameter(1e-2, "1", "choice", "gain that ends a stage of such a start")


@dataclass(frozen=True)
class PrimitiveParameters(Checked):
    """The built-in prior, and conditioning on task points (``planning/primitive.py``)."""

    acceleration: float = parameter(
        40.0, "rad", "choice", "per unit of phase²: standard deviation of the prior's acceleration"
    )
    position: float = parameter(3.0, "rad", "choice", "standard deviation of the prior's position")
    paused: float = parameter(
        0.1, "rad", "choice", "per unit of phase: standard deviation of the velocity at a pause"
    )
    lever_arm: float = parameter(
        0.4, "m", "guess", "ratio of the standard deviations of the tool point and of the joints"
    )
    camera_phase: float = parameter(0.5, "1", "choice", "phase of the camera point")
    checked: int = parameter(
        101, "1", "choice", "samples of a user's ProMP's mean, checked for the joint limits"
    )


@dataclass(frozen=True)
class UnderwayParameters(Checked):
    """A plan for an arm that moves already (``planning/underway.py``)."""

    upright: float = parameter(15.0, "deg", "choice", "largest lean of a tool on its approach")
    before: float = parameter(0.002, "m", "choice", "from the approach's begin to the camera point")
    aside: float = parameter(
        0.15, "m", "choice", "largest distance of a tool on its approach from the approach's line"
    )
    moved: float = parameter(
        0.03, "m", "choice", "largest motion of the target with which a running path is kept"
    )
    risk: float = parameter(
        0.1,
        "1",
        "measured",
        "share of broken promises with which a push goes on, among fruits that did not move: a "
        "harm that is predicted again on the way varies by 0.1 to 0.5",
    )
    same: float = parameter(1e-3, "m", "choice", "largest motion of a fruit that did not move")
    rows: int = parameter(100, "1", "choice", "samples of the rest of a running path")
    fewest: int = parameter(4, "1", "choice", "least number of waypoints of the rest of a motion")
    exact: float = parameter(
        1e-9, "rad, rad/s, rad/s^2", "choice", "largest deviation of an arm on the running curve"
    )
    left: float = parameter(1e-5, "s", "choice", "shortest rest of a motion or of an interval")
    join: float = parameter(0.5, "s", "choice", "latest time at which a new motion is joined")
    quickest: float = parameter(0.01, "s", "choice", "shortest time of a join")
    slowest: float = parameter(2.0, "s", "choice", "longest time of a join")
    durations: int = parameter(40, "1", "choice", "number tried of a join to each waypoint")
    ticks: int = parameter(100, "1", "choice", "in which a joint's acceleration comes to its peak")
    samples: int = parameter(12, "1", "choice", "intervals of a join for the tool's speed")


@dataclass(frozen=True)
class TreeParameters(Checked):
    """A way round obstacles (``planning/tree.py``)."""

    samples: int = parameter(100_000, "1", "choice", "largest number that the trees grow towards")
    reach: float = parameter(1.0, "rad", "choice", "longest edge of a tree")
    step: float = parameter(0.03, "m", "choice", "of the body between two checks along an edge")
    seeded: float = parameter(0.5, "1", "choice", "share of samples near the primitive's waypoints")
    shown: int = parameter(4, "1", "choice", "samples of the primitive that give these waypoints")
    spread: float = parameter(0.2, "rad", "choice", "standard deviation about these waypoints")
    shortcuts: int = parameter(100, "1", "choice", "number tried on a way")
    ways: int = parameter(3, "1", "choice", "number of which the shortest is taken")
    rounds: int = parameter(4, "1", "choice", "of ``ways`` ways, while no optimised one is valid")
    deep: float = parameter(
        0.05,
        "m",
        "measured",
        "depth in an obstacle: of 163 deeper primitives 18 could be bent, of 86 others 72",
    )
    ramp: float = parameter(
        0.2, "1", "choice", "share of a way's time for either ramp of its speed"
    )


@dataclass(frozen=True)
class ApproachParameters(Checked):
    """Approaches other than the straight one (``planning/plan.py``)."""

    around: int = parameter(6, "1", "choice", "directions about the approach")
    cone: float = parameter(
        25.0, "deg", "choice", "largest tilt to a hanging target, where the scene states none"
    )
    aside: float = parameter(0.01, "m", "choice", "beside the target, where the scene states none")
    inner: float = parameter(0.5, "1", "choice", "share of the cone, for a second ring of tilts")
    room: float = parameter(0.002, "m", "choice", "between target and mouth at the end")
    tried: int = parameter(
        3, "1", "measured", "approaches that are planned; with 6, 2 % more succeed, but later"
    )
    candidates: int = parameter(5, "1", "choice", "first paths of a push model that are tried")
    promising: float = parameter(
        0.4,
        "1",
        "measured",
        "share of the harm's threshold, below which an approach is planned at once",
    )


@dataclass(frozen=True)
class TimingParameters(Checked):
    """Times of the waypoints where the joints' limits decide (``planning/timing.py``)."""

    least_dt: float = parameter(1e-3, "s", "choice", "of a trajectory that hardly moves")
    ramps: tuple[float, ...] = parameter(
        (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0),
        "1",
        "choice",
        "tried ratios of the time of a motion's ramp to the time of its cruise",
    )
    refinements: int = parameter(
        5, "1", "measured", "of the intervals; they make free reaches 15 % shorter, 20 no more"
    )
    gain: float = parameter(0.5, "1", "measured", "exponent of an interval's need; 1 oscillates")
    shrink: float = parameter(0.9, "1", "choice", "least change of an interval in a refinement")
    widen: float = parameter(3.0, "1", "choice", "largest change of an interval in a refinement")
    spare: float = parameter(
        0.05, "1", "choice", "share by which the tool may exceed its speed within an interval"
    )
    among: float = parameter(
        0.025, "m", "choice", "distance from a fruit in which the tool is slow; the judge's is 0.02"
    )
    parts: int = parameter(
        4, "1", "choice", "of an interval, for which the tool's speed is checked"
    )
    beside: float = parameter(
        0.015,
        "m",
        "choice",
        "distance from the first place of an object that stands, in which the tool is slower: 2.5 "
        "standard deviations of its position; the judge's is 0.01",
    )
    ahead: float = parameter(
        0.015,
        "m",
        "measured",
        "way before a push in which the tool is slow: a quarter of pushed packs is 13 mm off",
    )
    quickest: float = parameter(
        30.0, "1", "choice", "largest rate at which a slow trajectory is led where nothing is near"
    )
    grade: float = parameter(
        1.2, "1", "choice", "largest ratio of the rates at two neighbouring waypoints"
    )
    last: float = parameter(
        0.04,
        "m",
        "choice",
        "way before the end on which the tool brakes slowly: it meets the target",
    )
    meeting: float = parameter(0.5, "1", "choice", "share of its largest speed at the target")
    still: float = parameter(1e-6, "m/s", "choice", "speed of a tool that hardly moves")
    paces: int = parameter(100, "1", "choice", "trials of the rates until all limits are kept")


@dataclass(frozen=True)
class InTimeParameters(Checked):
    """Plans among objects that move (``planning/in_time.py``)."""

    horizon: float = parameter(
        20.0, "s", "choice", "for which the places of an object that moves are avoided at first"
    )
    spacing: float = parameter(0.25, "radii of the object", "choice", "between two of these places")
    most: int = parameter(200, "1", "choice", "number of these places")
    room: float = parameter(0.01, "m", "choice", "from objects that move, where there is a way")
    wait: float = parameter(0.25, "s", "choice", "between two times of departure that are tried")
    longest: float = parameter(20.0, "s", "choice", "wait at the start")
    met: float = parameter(
        3.0, "s", "choice", "at which a pushable that moves is passed, in the first plan"
    )
    rounds: int = parameter(4, "1", "choice", "plans until a pushable is where the plan takes it")
    same: float = parameter(1e-3, "m", "choice", "between two places of a pushable that are one")


WAYPOINT = WaypointParameters()
FOLLOW = FollowParameters()
GOAL = GoalParameters()
KEPT = KeptParameters()
LINE = LineParameters()
PICK = PickParameters()
SOLVE = SolveParameters()
PRIMITIVE = PrimitiveParameters()
TREE = TreeParameters()
TIMING = TimingParameters()
APPROACH = ApproachParameters()
IN_TIME = InTimeParameters()
UNDERWAY = UnderwayParameters()
