"""The tuned numbers of planning that are no options of :class:`PlanOptions`.

Nothing sets them. Each is a choice of ours, unless its comment says measured, published or guess.
A unit stands in brackets; a number without one is a count or a ratio.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class WaypointParameters:
    """The number of a trajectory's waypoints, and their spacing."""

    fewest: int = 60  # least number of a trajectory
    fewest_reach: int = 25  # least number before the path
    fewest_approach: float = 40.0  # least number on the path
    most: int = 600  # largest number of a trajectory
    peak: float = 1.9  # ratio of largest to mean speed of a smooth reach; minimum jerk: 1.875
    share: float = 0.8  # share of ``max_step`` that sets the number of waypoints
    tool_step: float = 0.005  # [m] largest step of the tool on its path
    tool_time: float = 0.17  # [s] longest time between waypoints on the path
    braking: float = 0.3  # share of the approach's time in which the tool comes to rest
    primitive: int = 150  # number of the trajectory of a primitive


@dataclass(frozen=True)
class FollowParameters:
    """The primitive conditioned on a path, and the arm led along it (``planning/follow.py``)."""

    stations: int = 8  # points of the path that the primitive is conditioned on
    # measured: of the kinematics; the last changes a joint by about 1e-3 rad
    linearisations: int = 4
    posture_step: float = 0.5  # [rad] largest change of a joint at a station in a linearisation
    # [m] standard deviation of the tool point at a station; equal to the corridor of the solve
    station_deviation: float = 2e-3
    axis_lever: float = 0.3  # [m] weighs the tool axis against the tool point
    tracked: float = 1e-4  # [m] largest error of a followed tool point
    task_tracked: float = 1e-5  # [m] largest error of a followed task point


@dataclass(frozen=True)
class GoalParameters:
    """Goal configurations (``planning/goals.py``)."""

    few_starts: int = 12  # of inverse kinematics, for a primitive
    starts: int = 24  # measured: of inverse kinematics, at first; decisions.md
    more_starts: int = 48  # where fewer than ``spare`` solutions are free
    many_starts: int = 320  # where no solution is free
    enough: int = 6  # free configurations to choose among
    spare: int = 3  # with fewer free configurations, more starts are tried
    poses: int = 12  # in a goal's region, beside its middle
    inside: float = 0.9  # share of a goal's tolerances within which its poses lie
    distinct: float = 0.25  # [rad] least difference of a joint between two distinct configurations
    room: float = 0.06  # [m] clearance beyond which more is not better
    self_margin: float = 0.01  # [m] the same between links
    same_room: float = 2e-4  # [m] largest difference of equal clearances from static objects
    nearest_error: float = 1e-6  # [m] largest error of a goal found by following the approach line
    nearest_margin: float = 0.05  # [rad or m] least distance of that goal from the joint limits


@dataclass(frozen=True)
class KeptParameters:
    """Constraints of a path (``planning/kept.py``)."""

    share: float = 0.9  # of the limits at waypoints, so that the curve between them is inside
    reached: float = 1e-4  # [m] largest error of inverse kinematics


@dataclass(frozen=True)
class LineParameters:
    """Straight lines between way points (``planning/lines.py``)."""

    step: float = 5e-3  # [m] largest step of the tool between two waypoints
    turn: float = 0.03  # [rad] largest turn of the tool between two waypoints
    fewest: int = 20  # least number of waypoints of a line
    tracked: float = 1e-5  # [m] largest error of inverse kinematics
    jump: float = 0.3  # [rad or m] motion of a joint between two waypoints that is another branch
    branches: int = 60  # of the first way point that are followed
    tries: int = 6  # branches to which a free motion is planned
    near: float = 1e-5  # [rad or m] distance of a branch from the start that counts as none
    share: float = 0.5  # of the allowed distance from a line that the planner uses
    refinements: int = 3  # of a line's waypoints, each to twice as many
    parts: int = 4  # of an interval, for which line and speed are checked


@dataclass(frozen=True)
class PickParameters:
    """How many paths are followed, and how they are compared (``planning/pick.py``)."""

    # harm added where the trajectory is not valid; less than the harm of a swallowed fruit
    invalid: float = 2.5
    goals: int = 3  # goal configurations that a path is followed to
    tries: int = 6  # paths that are followed while no valid trajectory keeps the margin
    few_tries: int = 2  # paths that are followed where other approaches remain to be tried


@dataclass(frozen=True)
class SolveParameters:
    """Stiffnesses of constraints, in the priority of method §5 (``planning/pick.py``)."""

    must: float = 1e6  # [1/m^2] joint limits, contacts, the goal
    firm: float = 1e5  # [1/m^2] clearance from objects to avoid and between links, joint steps
    kept: float = 1e4  # [1/m^2] the tool path; static clearance has twice this
    wish: float = 1e3  # [1/m^2] the tool's clearance from objects to avoid, the level of a hand
    lean: float = 1e2  # [1/rad^2] the tilt of the tool on the path
    touch_margin: float = 1e-3  # [m] clearance from static objects below which ``must`` applies
    upright: float = 2.0  # [deg] tilt of the tool allowed on the path
    within: float = 3e-3  # curvature inside the corridor, as a share of the walls' curvature
    safety: float = 0.01  # [m] published: epsilon of F_s and F_d; the method
    far_damping: float = 1e-2  # first damping where a start breaks constraints
    far_tolerance: float = 1e-2  # gain that ends a stage of such a start


@dataclass(frozen=True)
class PrimitiveParameters:
    """The built-in prior, and conditioning on task points (``planning/primitive.py``)."""

    # [rad] per unit of phase²: standard deviation of the prior's acceleration
    acceleration: float = 40.0
    position: float = 3.0  # [rad] standard deviation of the prior's position
    paused: float = 0.1  # [rad] per unit of phase: standard deviation of the velocity at a pause
    # [m] guess: ratio of the standard deviations of the tool point and of the joints
    lever_arm: float = 0.4
    camera_phase: float = 0.5  # phase of the camera point
    checked: int = 101  # samples of a user's ProMP's mean, checked for the joint limits


@dataclass(frozen=True)
class UnderwayParameters:
    """A plan for an arm that moves already (``planning/underway.py``)."""

    upright: float = 15.0  # [deg] largest lean of a tool on its approach
    before: float = 0.002  # [m] from the approach's begin to the camera point
    aside: float = 0.15  # [m] largest distance of a tool on its approach from the approach's line
    moved: float = 0.03  # [m] largest motion of the target with which a running path is kept
    # measured: share of broken promises with which a push goes on, among fruits that did not move:
    # a harm that is predicted again on the way varies by 0.1 to 0.5
    risk: float = 0.1
    same: float = 1e-3  # [m] largest motion of a fruit that did not move
    rows: int = 100  # samples of the rest of a running path
    fewest: int = 4  # least number of waypoints of the rest of a motion
    exact: float = 1e-9  # [rad, rad/s, rad/s^2] largest deviation of an arm on the running curve
    left: float = 1e-5  # [s] shortest rest of a motion or of an interval
    join: float = 0.5  # [s] latest time at which a new motion is joined
    quickest: float = 0.01  # [s] shortest time of a join
    slowest: float = 2.0  # [s] longest time of a join
    durations: int = 40  # number tried of a join to each waypoint
    ticks: int = 100  # in which a joint's acceleration comes to its peak
    samples: int = 12  # intervals of a join for the tool's speed


@dataclass(frozen=True)
class TreeParameters:
    """A way round obstacles (``planning/tree.py``)."""

    samples: int = 100_000  # largest number that the trees grow towards
    reach: float = 1.0  # [rad] longest edge of a tree
    step: float = 0.03  # [m] of the body between two checks along an edge
    seeded: float = 0.5  # share of samples near the primitive's waypoints
    shown: int = 4  # samples of the primitive that give these waypoints
    spread: float = 0.2  # [rad] standard deviation about these waypoints
    shortcuts: int = 100  # number tried on a way
    ways: int = 3  # number of which the shortest is taken
    rounds: int = 4  # of ``ways`` ways, while no optimised one is valid
    # [m] measured: depth in an obstacle: of 163 deeper primitives 18 could be bent, of 86 others 72
    deep: float = 0.05
    ramp: float = 0.2  # share of a way's time for either ramp of its speed


@dataclass(frozen=True)
class ApproachParameters:
    """Approaches other than the straight one (``planning/approaches.py``)."""

    around: int = 6  # directions about the approach
    cone: float = 25.0  # [deg] largest tilt to a hanging target, where the scene states none
    aside: float = 0.01  # [m] beside the target, where the scene states none
    inner: float = 0.5  # share of the cone, for a second ring of tilts
    room: float = 0.002  # [m] between target and mouth at the end
    tried: int = 3  # measured: approaches that are planned; with 6, 2 % more succeed, but later
    candidates: int = 5  # first paths of a push model that are tried
    # measured: share of the harm's threshold, below which an approach is planned at once
    promising: float = 0.4


@dataclass(frozen=True)
class TimingParameters:
    """Times of the waypoints where the joints' limits decide (``planning/timing.py``)."""

    least_dt: float = 1e-3  # [s] of a trajectory that hardly moves
    # tried ratios of the time of a motion's ramp to the time of its cruise
    ramps: tuple[float, ...] = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0)
    # measured: of the intervals; they make free reaches 15 % shorter, 20 no more
    refinements: int = 5
    gain: float = 0.5  # measured: exponent of an interval's need; 1 oscillates
    shrink: float = 0.9  # least change of an interval in a refinement
    widen: float = 3.0  # largest change of an interval in a refinement
    spare: float = 0.05  # share by which the tool may exceed its speed within an interval
    among: float = 0.025  # [m] distance from a fruit in which the tool is slow; the judge's is 0.02
    parts: int = 4  # of an interval, for which the tool's speed is checked
    # [m] distance from the first place of an object that stands, in which the tool is slower: 2.5
    # standard deviations of its position; the judge's is 0.01
    beside: float = 0.015
    # [m] measured: way before a push in which the tool is slow: a quarter of pushed packs is 13 mm
    # off
    ahead: float = 0.015
    quickest: float = 30.0  # largest rate at which a slow trajectory is led where nothing is near
    grade: float = 1.2  # largest ratio of the rates at two neighbouring waypoints
    # [m] way before the end on which the tool brakes slowly: it meets the target
    last: float = 0.04
    meeting: float = 0.5  # share of its largest speed at the target
    still: float = 1e-6  # [m/s] speed of a tool that hardly moves
    paces: int = 100  # trials of the rates until all limits are kept


@dataclass(frozen=True)
class InTimeParameters:
    """Plans among objects that move (``planning/in_time.py``)."""

    horizon: float = 20.0  # [s] for which the places of an object that moves are avoided at first
    spacing: float = 0.25  # [radii of the object] between two of these places
    most: int = 200  # number of these places
    room: float = 0.01  # [m] from objects that move, where there is a way
    wait: float = 0.25  # [s] between two times of departure that are tried
    longest: float = 20.0  # [s] wait at the start
    met: float = 3.0  # [s] at which a pushable that moves is passed, in the first plan
    rounds: int = 4  # plans until a pushable is where the plan takes it
    same: float = 1e-3  # [m] between two places of a pushable that are one


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
