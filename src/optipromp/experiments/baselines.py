"""The planners of a study: ours, and those it is measured against.

``straight``, ``obstacles`` and ``chomp`` are built from the library's own parts and returned, as
every planner's answer here, as an :class:`Answer` that the simulator can execute.
"""

import math
import time
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from optipromp.arrays import FloatArray, lengths
from optipromp.errors import Code, InvalidRequestError
from optipromp.optimization import covariant
from optipromp.optimization.costs.joints import SmoothnessCost
from optipromp.optimization.costs.obstacles import ObstacleCost
from optipromp.optimization.problem import Problem
from optipromp.planning import PaperOptions, Plan, PlanOptions, plan
from optipromp.planning.task import Task, resolve
from optipromp.planning.timing import shortest
from optipromp.planning.verdict import verdict
from optipromp.pushing.model import Prediction
from optipromp.robots import ik
from optipromp.robots.roll import level
from optipromp.scenes.scene import JointGoal, Scene
from optipromp.scenes.values import suggest
from optipromp.trajectory import Trajectory

StudyPlanner = Literal[
    "straight", "promp", "i-promp", "i-promp-guard", "drift", "paper", "obstacles", "chomp",
    "opti-promp",
]  # fmt: skip
STUDY_PLANNERS: tuple[StudyPlanner, ...] = get_args(StudyPlanner)

SETTINGS: dict[str, dict[str, Any]] = {  # of planners that are one of ours, other than it is
    "i-promp-guard": {
        "planner": "i-promp", "options": PlanOptions(paper=PaperOptions(guard=True))
    },
    "drift": {"options": PlanOptions(prediction=False, rule="paper")},
    "paper": {"strategy": "sequential", "options": PlanOptions(constraints="paper")},
}  # fmt: skip
SPEED = 0.1  # [m/s] of the tool after the camera point, as of the other planners
STEP = 0.04  # [rad or m] no joint moves more between the waypoints of ``straight``
LINE_STEP = 0.005  # [m] between followed tool points
FOLLOWED = 1e-5  # [m] largest error of a followed tool point
SMOOTHNESS = 1e-5  # of ½∫‖ξ̈‖² dt beside the obstacle functionals of ``chomp``; a choice


@dataclass(frozen=True, eq=False)
class Answer:
    """A planner's answer to a scene.

    Attributes:
        planner: which one.
        status: ``success`` only where the independent check found nothing wrong.
        message: why, in words.
        trajectory: what is executed; None where the planner has none.
        seconds: wall time of planning.
        harm: predicted of its push; None where no model knows it.
        guard: until when the tool's mouth is closed [s]; 0: never.
        failure: predicted probability that the pick is not clean; None where no model tells one.
        tilt: of the approach that the planner chose, off the scene's [degrees].
    """

    planner: StudyPlanner
    status: Code
    message: str
    trajectory: Trajectory | None
    seconds: float
    harm: float | None = None
    guard: float = 0.0
    failure: float | None = None
    tilt: float = 0.0


def attempt(
    scene: Scene, planner: StudyPlanner, *, seed: int = 0, risk: float = PlanOptions.risk
) -> Answer:
    """Plan a scene with any planner of a study.

    - ``straight``: to the camera point, then straight along the approach, no fruit considered.
    - ``promp``, ``i-promp``, ``opti-promp``: see :func:`optipromp.planning.plan`.
    - ``i-promp-guard``: i-promp whose mouth is closed until the last push is done, and whose closed
      rim is led under each neighbour. An open mouth swallows what it is led onto.
    - ``drift``: the arm follows the tool path that the paper's drift rule gives: past each
      neighbour by R_gripper and a clearance along ±y_g, on the side away from its stem.
    - ``paper``: the paper's own two stages, held to its constraint 1.
    - ``obstacles``: opti-promp, that is Gauss-Newton, to which every pushable is an obstacle like a
      neighbour: the whole robot keeps away by cost, and nothing drifts past anything.
    - ``chomp``: covariant gradient descent, as the paper and CHOMP have it, on F_s and F_d over all
      body spheres and smoothness, from the ProMP that ``promp`` gives. Every pushable is an
      obstacle too.

    Args:
        scene: as the planner sees it.
        planner: one of :data:`STUDY_PLANNERS`.
        seed: of everything random.
        risk: share of promised successes that may be broken, see :class:`PlanOptions`.

    Raises:
        InvalidRequestError: an unknown planner, or a risk that is not between 0 and 1.
        InvalidSceneError, InvalidRobotError, StartInvalidError: wrong input.
    """
    if planner not in STUDY_PLANNERS:
        raise InvalidRequestError(f"planner is {planner!r}: {suggest(planner, STUDY_PLANNERS)}")
    began = time.perf_counter()
    if planner == "straight":
        return straight(scene, risk)
    if planner == "chomp":
        return chomp(scene, seed, risk)
    if planner != "obstacles":
        request = SETTINGS.get(planner, {"planner": planner})
        options = replace(request.get("options", PlanOptions()), risk=risk)
        made = plan(scene, seed=seed, **{**request, "options": options})
        moves = bool(np.ptp(made.trajectory.positions, axis=0).max() > 0.0)
        return Answer(
            planner, made.status, made.message, made.trajectory if moves else None,
            time.perf_counter() - began, made.prediction.harm if made.prediction else None,
            pushed(made) if planner == "i-promp-guard" else 0.0, _failure(made.prediction),
            float(np.rad2deg(np.arccos(min(made.scene.frame[2] @ scene.frame[2], 1.0)))),
        )  # fmt: skip
    made = plan(as_obstacles(scene), seed=seed, options=PlanOptions(risk=risk))
    seconds = time.perf_counter() - began
    if made.status not in (Code.SUCCESS, Code.INVALID_PLAN, Code.HARM_PREDICTED):
        return Answer(planner, made.status, made.message, made.trajectory, seconds)
    task = replace(resolve(scene), risk=risk)
    return _judged(planner, task, gently(task, made.trajectory.positions), seconds)


def pushed(made: Plan) -> float:
    """When the last push of an i-promp plan is done [s]; 0 where it pushes nothing."""
    if len(made.via) < 3:  # camera, pushes, goal
        return 0.0
    points, _ = made.robot.tool_pose(made.trajectory.positions)
    return float(made.trajectory.times[np.argmin(lengths(points - made.via[-2].position))])


def gently(setup: Task, q: FloatArray) -> Trajectory:
    """Waypoints (T, n), no faster from the camera point on than the other planners are there."""
    first = None
    if setup.neighbours and not isinstance(setup.goal, JointGoal):
        points, _ = setup.robot.tool_pose(q)
        first = int(np.argmin(np.linalg.norm(points - setup.camera, axis=1)))
    return shortest(setup.robot, q, first, SPEED)


def as_obstacles(scene: Scene) -> Scene:
    """The scene with every pushable in the role of a neighbour to be avoided, and one approach.

    Other approaches are chosen by pushes, of which nothing is known here.
    """
    objects = tuple(
        replace(item, role="avoid") if item.role == "pushable" else item for item in scene.objects
    )
    return replace(scene, objects=objects, approach=replace(scene.approach, cone=0.0, aside=0.0))


def chomp(scene: Scene, seed: int = 0, risk: float = PlanOptions.risk) -> Answer:
    """CHOMP from the conditioned ProMP; start and goal configuration stay."""
    began = time.perf_counter()
    made = plan(scene, planner="promp", seed=seed)
    if made.status not in (Code.SUCCESS, Code.INVALID_PLAN, Code.HARM_PREDICTED):
        return Answer("chomp", made.status, made.message, None, time.perf_counter() - began)
    problem = chomp_problem(scene, made.trajectory.n_waypoints)
    found = covariant.descend(problem, made.trajectory.positions, covariant.DescentOptions())
    task = replace(resolve(scene), risk=risk)
    return _judged("chomp", task, gently(task, found.q), time.perf_counter() - began)


def chomp_problem(scene: Scene, waypoints: int) -> Problem:
    """F_s, F_d over all body spheres, and smoothness; pushables are obstacles; ends are fixed."""
    task = resolve(as_obstacles(scene))
    safety = PaperOptions().epsilon
    costs = [
        ObstacleCost("static", 1.0, safety, "sum"),
        ObstacleCost("avoid", 1.0, safety, "sum"),
        ObstacleCost("tool avoid", 1.0, safety, "sum"),
        SmoothnessCost(SMOOTHNESS),
    ]
    return Problem(
        task.robot, task.surroundings, costs, (), waypoints, cutoff=safety + 1e-3, end_fixed=True,
        body=task.body,
    )  # fmt: skip


def straight(scene: Scene, risk: float = PlanOptions.risk) -> Answer:
    """The tool to the camera point, a stop, and straight along the approach to the target.

    Both parts follow a line of the tool point by inverse kinematics from the start, each with the
    timing of least jerk. Where the arm cannot follow the first line, it moves in joint space to
    the branch that reaches the target. No obstacle is considered.
    """
    began = time.perf_counter()
    setup = replace(resolve(scene), risk=risk)
    parts = _parts(setup)
    if parts is None:
        away = "no configuration follows the approach line to the target"
        return Answer("straight", Code.GOAL_UNREACHABLE, away, None, time.perf_counter() - began)
    robot = setup.robot
    q = np.vstack([parts[0], parts[1][1:]])
    q[1:] = level(robot, q, setup.scene.frame[0], path=True)[1:]
    return _judged("straight", setup, gently(setup, q), time.perf_counter() - began)


def _judged(planner: StudyPlanner, task: Task, trajectory: Trajectory, seconds: float) -> Answer:
    found = verdict(task, trajectory)
    harm = found.prediction.harm if found.prediction else None
    failure = _failure(found.prediction)
    return Answer(planner, found.status, found.message, trajectory, seconds, harm, failure=failure)


def _failure(told: Prediction | None) -> float | None:
    return None if told is None or math.isnan(told.probability) else told.probability


def _parts(setup: Task) -> tuple[FloatArray, FloatArray] | None:
    """Waypoints (m, n) from start to camera point, and from there to the target."""
    if isinstance(setup.goal, JointGoal):
        raise InvalidRequestError("straight needs a target to approach; the scene's goal is joints")
    robot, goal, axis = setup.robot, setup.goal.position, setup.goal.axis
    camera = setup.camera
    point, pointing = robot.tool_pose(setup.start)
    there, missed = ik.track(robot, *_line(point, camera, pointing, axis), setup.start)
    ahead, off = ik.track(robot, *_line(camera, goal, axis, axis), there[-1])
    if max(missed.max(), off.max()) < FOLLOWED:
        first = np.vstack([setup.start, there])
        return _least_jerk(first), _least_jerk(np.vstack([there[-1], ahead]))
    best: tuple[float, FloatArray] | None = None
    for end in ik.solve(robot, goal, axis, near=setup.start[None], rest=setup.start).joints:
        back, off = ik.track(robot, *_line(goal, camera, axis, axis), end)
        turn = float(np.max(np.abs(back[-1] - setup.start)))
        if off.max() < FOLLOWED and (best is None or turn < best[0]):
            best = turn, np.vstack([end, back])[::-1]
    if best is None:
        return None
    return _least_jerk(np.vstack([setup.start, best[1][0]])), _least_jerk(best[1])


def _line(
    begin: FloatArray, end: FloatArray, first: FloatArray, last: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Tool points (m, 3) and axes (m, 3) on a line, without its beginning."""
    count = max(2, int(np.ceil(np.linalg.norm(end - begin) / LINE_STEP)))
    share = np.linspace(0.0, 1.0, count + 1)[1:, None]
    axes = first + share * (last - first)
    return begin + share * (end - begin), axes / np.linalg.norm(axes, axis=1, keepdims=True)


def _least_jerk(path: FloatArray) -> FloatArray:
    """Waypoints (T, n) along a path (m, n) with the timing 10 τ³ − 15 τ⁴ + 6 τ⁵."""
    lengths = np.max(np.abs(np.diff(path, axis=0)), axis=1)
    along = np.concatenate([[0.0], np.cumsum(np.maximum(lengths, 1e-12))])
    count = max(10, int(np.ceil(1.9 * along[-1] / STEP)))  # the middle is 1.9 times as fast
    tau = np.linspace(0.0, 1.0, count + 1)
    share = along[-1] * (10.0 * tau**3 - 15.0 * tau**4 + 6.0 * tau**5)
    return np.stack([np.interp(share, along, column) for column in path.T], axis=1)
