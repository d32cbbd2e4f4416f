"""The tuned numbers of planning that are no options of :class:`PlanOptions`.

Each is followed by its unit and its meaning. A number is our choice where no other source stands.
"""


class Waypoint:
    """The number of a trajectory's waypoints, and their spacing."""

    fewest = 60  # [1] least number of a trajectory
    fewest_reach = 25  # [1] least number before the path
    fewest_approach = 40.0  # [1] least number on the path
    most = 600  # [1] largest number of a trajectory
    peak = 1.9  # [1] ratio of largest to mean speed of a smooth reach; minimum jerk: 1.875
    share = 0.8  # [1] share of ``max_step`` that sets the number of waypoints
    tool_step = 0.005  # [m] largest step of the tool on its path
    tool_time = 0.17  # [s] longest time between waypoints on the path
    braking = 0.3  # [1] share of the approach's time in which the tool comes to rest
    primitive = 150  # [1] number of the trajectory of a primitive


class Follow:
    """The primitive conditioned on a path, and the arm led along it (``planning/follow.py``)."""

    stations = 8  # [1] points of the path that the primitive is conditioned on
    # measured: of the kinematics; the last changes a joint by about 1e-3 rad
    linearisations = 4  # [1]
    posture_step = 0.5  # [rad] largest change of a joint at a station in a linearisation
    # standard deviation of the tool point at a station; equal to the corridor of the solve
    station_deviation = 2e-3  # [m]
    axis_lever = 0.3  # [m] weighs the tool axis against the tool point
    tracked = 1e-4  # [m] largest error of a followed tool point
    braked = 401  # [1] entries of the table of the time over the braked way
    task_tracked = 1e-5  # [m] largest error of a followed task point


class Goal:
    """Goal configurations (``planning/goals.py``)."""

    few_starts = 12  # [1] of inverse kinematics, for a primitive
    starts = 24  # [1] measured: of inverse kinematics, at first; decisions.md
    more_starts = 48  # [1] where fewer than ``spare`` solutions are free
    many_starts = 320  # [1] where no solution is free
    enough = 6  # [1] free configurations to choose among
    spare = 3  # [1] with fewer free configurations, more starts are tried
    poses = 12  # [1] in a goal's region, beside its middle
    inside = 0.9  # [1] share of a goal's tolerances within which its poses lie
    distinct = 0.25  # [rad] least difference of a joint between two distinct configurations
    distinct_many = 0.1  # [rad] the same with ``many_starts`` starts
    room = 0.06  # [m] clearance beyond which more is not better
    self_margin = 0.01  # [m] the same between links
    nearest_error = 1e-6  # [m] largest error of a goal found by following the approach line
    nearest_margin = 0.05  # [rad or m] least distance of that goal from the joint limits


class Constraint:
    """Constraints of a path (``planning/follow.py``)."""

    share = 0.9  # [1] of the limits at waypoints, so that the curve between them is inside
    reached = 1e-4  # [m] largest error of inverse kinematics


class Line:
    """Straight lines between way points (``planning/lines.py``)."""

    step = 5e-3  # [m] largest step of the tool between two waypoints
    turn = 0.03  # [rad] largest turn of the tool between two waypoints
    fewest = 20  # [1] least number of waypoints of a line
    tracked = 1e-5  # [m] largest error of inverse kinematics
    jump = 0.3  # [rad or m] motion of a joint between two waypoints that is another branch
    branches = 60  # [1] of the first way point that are followed
    tries = 6  # [1] branches to which a free motion is planned
    near = 1e-5  # [rad or m] distance of a branch from the start that counts as none
    share = 0.5  # [1] of the allowed distance from a line that the planner uses
    refinements = 3  # [1] of a line's waypoints, each to twice as many
    parts = 4  # [1] of an interval, for which line and speed are checked


class Pick:
    """How many paths are followed, and how they are compared (``planning/pick.py``)."""

    # harm added where the trajectory is not valid; less than the harm of a swallowed fruit
    invalid = 2.5  # [1]
    goals = 3  # [1] goal configurations that a path is followed to
    tries = 6  # [1] paths that are followed while no valid trajectory keeps the margin
    level = 10.0  # [1] weight of a pair's distance across the fingers, against that along them
    few_tries = 2  # [1] paths that are followed where other approaches remain to be tried


class Solve:
    """Stiffnesses of constraints, in the priority of method §5 (``planning/pick.py``)."""

    must = 1e6  # [1/m^2] joint limits, contacts, the goal
    firm = 1e5  # [1/m^2] clearance from objects to avoid and between links, joint steps
    kept = 1e4  # [1/m^2] the tool path; static clearance has twice this
    wish = 1e3  # [1/m^2] the tool's clearance from objects to avoid, the level of a hand
    lean = 1e2  # [1/rad^2] the tilt of the tool on the path
    touch_margin = 1e-3  # [m] clearance from static objects below which ``must`` applies
    upright = 2.0  # [deg] tilt of the tool allowed on the path
    within = 3e-3  # [1] curvature inside the corridor, as a share of the walls' curvature
    safety = 0.01  # [m] published: epsilon of F_s and F_d; the method
    far_damping = 1e-2  # [1] first damping where a start breaks constraints
    far_tolerance = 1e-2  # [1] gain that ends a stage of such a start


class Primitive:
    """The built-in prior, and conditioning on task points (``planning/primitive.py``)."""

    acceleration = 40.0  # [rad] per unit of phase²: standard deviation of the prior's acceleration
    position = 3.0  # [rad] standard deviation of the prior's position
    paused = 0.1  # [rad] per unit of phase: standard deviation of the velocity at a pause
    # guess: ratio of the standard deviations of the tool point and of the joints
    lever_arm = 0.4  # [m]
    camera_phase = 0.5  # [1] phase of the camera point
    checked = 101  # [1] samples of a user's ProMP's mean, checked for the joint limits


class Underway:
    """A plan for an arm that moves already (``planning/underway.py``)."""

    upright = 15.0  # [deg] largest lean of a tool on its approach
    before = 0.002  # [m] from the approach's begin to the camera point
    aside = 0.15  # [m] largest distance of a tool on its approach from the approach's line
    moved = 0.03  # [m] largest motion of the target with which a running path is kept
    # measured: share of broken promises with which a push goes on, among fruits that did not move:
    # a harm that is predicted again on the way varies by 0.1 to 0.5
    risk = 0.1  # [1]
    same = 1e-3  # [m] largest motion of a fruit that did not move
    rows = 100  # [1] samples of the rest of a running path
    fewest = 4  # [1] least number of waypoints of the rest of a motion
    exact = 1e-9  # [rad, rad/s, rad/s^2] largest deviation of an arm on the running curve
    left = 1e-5  # [s] shortest rest of a motion or of an interval
    join = 0.5  # [s] latest time at which a new motion is joined
    quickest = 0.01  # [s] shortest time of a join
    slowest = 2.0  # [s] longest time of a join
    durations = 40  # [1] number tried of a join to each waypoint
    ticks = 100  # [1] in which a joint's acceleration comes to its peak
    samples = 12  # [1] intervals of a join for the tool's speed


class Tree:
    """A way round obstacles (``planning/collision.py``)."""

    samples = 100_000  # [1] largest number that the trees grow towards
    reach = 1.0  # [rad] longest edge of a tree
    step = 0.03  # [m] of the body between two checks along an edge
    seeded = 0.5  # [1] share of samples near the primitive's waypoints
    shown = 4  # [1] samples of the primitive that give these waypoints
    spread = 0.2  # [rad] standard deviation about these waypoints
    shortcuts = 100  # [1] number tried on a way
    ways = 3  # [1] number of which the shortest is taken
    rounds = 4  # [1] of ``ways`` ways, while no optimised one is valid
    # measured: depth in an obstacle: of 163 deeper primitives 18 could be bent, of 86 others 72
    deep = 0.05  # [m]
    ramp = 0.2  # [1] share of a way's time for either ramp of its speed


class Approach:
    """Approaches other than the straight one (``planning/plan.py``)."""

    around = 6  # [1] directions about the approach
    cone = 25.0  # [deg] largest tilt to a hanging target, where the scene states none
    aside = 0.01  # [m] beside the target, where the scene states none
    inner = 0.5  # [1] share of the cone, for a second ring of tilts
    turns, rings = 24, 4  # [1] directions of the cone across which a long target is measured
    room = 0.002  # [m] between target and mouth at the end
    tried = 3  # [1] measured: approaches that are planned; with 6, 2 % more succeed, but later
    ways = 3  # [1] measured: the same where the way out harms; with 12 1 % more, three times later
    candidates = 5  # [1] first paths of a push model that are tried
    # measured: share of the harm's threshold, below which an approach is planned at once
    promising = 0.4  # [1]


class Timing:
    """Times of the waypoints where the joints' limits decide (``planning/timing.py``)."""

    least_dt = 1e-3  # [s] of a trajectory that hardly moves
    # tried ratios of the time of a motion's ramp to the time of its cruise
    ramps = (0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.0)  # [1]
    # measured: of the intervals; they make free reaches 15 % shorter, 20 no more
    refinements = 5  # [1]
    gain = 0.5  # [1] measured: exponent of an interval's need; 1 oscillates
    shrink = 0.9  # [1] least change of an interval in a refinement
    widen = 3.0  # [1] largest change of an interval in a refinement
    spare = 0.05  # [1] share by which the tool may exceed its speed within an interval
    among = 0.025  # [m] distance from a fruit in which the tool is slow; the judge's is 0.02
    parts = 4  # [1] of an interval, for which the tool's speed is checked
    # distance from the first place of an object that stands, in which the tool is slower: 2.5
    # standard deviations of its position; the judge's is 0.01
    beside = 0.015  # [m]
    # measured: way before a push in which the tool is slow: a quarter of pushed packs is 13 mm off
    ahead = 0.015  # [m]
    quickest = 30.0  # [1] largest rate at which a slow trajectory is led where nothing is near
    grade = 1.2  # [1] largest ratio of the rates at two neighbouring waypoints
    last = 0.04  # [m] way before the end on which the tool brakes slowly: it meets the target
    meeting = 0.5  # [1] share of its largest speed at the target
    still = 1e-6  # [m/s] speed of a tool that hardly moves
    paces = 100  # [1] trials of the rates until all limits are kept
    told = 1.1  # [1] ratio of two speeds of a way out that a prediction tells apart


class InTime:
    """Plans among objects that move (``planning/underway.py``)."""

    horizon = 20.0  # [s] for which the places of an object that moves are avoided at first
    spacing = 0.25  # [radii of the object] between two of these places
    most = 200  # [1] number of these places
    room = 0.01  # [m] from objects that move, where there is a way
    wait = 0.25  # [s] between two times of departure that are tried
    longest = 20.0  # [s] wait at the start
    met = 3.0  # [s] at which a pushable that moves is passed, in the first plan
    rounds = 4  # [1] plans until a pushable is where the plan takes it
    same = 1e-3  # [m] between two places of a pushable that are one


class Retreat:
    """Numbers of the retreat."""

    step = 0.005  # [m] between the waypoints of a straight retreat
    cone = 25.0  # [deg] off the tool axis: as that of an approach
    around = 8  # [1] directions about the tool axis that are tried
    # [1] steps aside before a retreat, over the tool's outer radius: hung fruits slide off
    aside = (1.8, 1.2, 0.6)
    slower = 0.5645  # [1] speed of the next proposal of a way that harms: six steps of TIMING.told
    slowest = 0.03  # [m/s] least speed: back along the way in, 10 of 13 hard picks are clean
    screened = 4  # [1] states by which all retreats are ranked
    judged = 6  # [1] retreats that are judged, at most
    farther = 2.0  # [1] retreats so much longer are tried where the shorter ends among fruits
    good = 0.45  # [1] measured: harm of a pick, up to which no other approach is tried
    alike = 0.2  # [1] measured: harms below it are equal, and the first and fastest way is taken


class Cutting:
    """Stems that a scissor cuts from the side (``planning/cutting.py``)."""

    along = 5e-4  # [m] between points of a stem, half of the judge's tolerance of a goal
    sway = 0.07  # [rad] largest of a fruit that hangs from the blades, beside the lean of its stem
    tilt = 0.02  # [rad] largest of the tool from the level on the way out
    parts = 8  # [1] samples of an interval, by which the changes of the tool's velocity are summed


class Lift:
    """Numbers of a lift."""

    heights = (0.02, 0.04, 0.01)  # [m] of the lift, in the order in which they are tried
    step = 0.005  # [m] between the waypoints of a lift
    # measured: of the tool until it is out: at 0.1 m/s 4 of 14 runs pressed a pack beyond 10 N on
    # the way back, at 0.025 m/s none of these
    speed = 0.025  # [m/s]
    level = 30.0  # [deg] largest slope of an approach from the side
    pushed = 0.001  # [m] a pack that the reach moves farther touches the tool, and may do so


WAYPOINT = Waypoint
FOLLOW = Follow
GOAL = Goal
CONSTRAINT = Constraint
LINE = Line
PICK = Pick
SOLVE = Solve
PRIMITIVE = Primitive
UNDERWAY = Underway
TREE = Tree
APPROACH = Approach
TIMING = Timing
IN_TIME = InTime
BACK = Retreat
LIFTING = Lift
CUTTING = Cutting
