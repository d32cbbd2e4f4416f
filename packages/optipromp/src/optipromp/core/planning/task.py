"""A task: the scene's robot with its tool, start, goal, obstacles, neighbours and push model."""

import functools
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import InvalidRequestError, InvalidSceneError, StartInvalidError
from optipromp.core.geometry import distances, pack
from optipromp.core.optimization.evaluation import BodyPoints, body_points
from optipromp.core.optimization.problem import Surroundings, surroundings_of
from optipromp.core.parameters import FRUIT_DENSITY
from optipromp.core.planning.parameters import CUTTING
from optipromp.core.promp.model import ProMP
from optipromp.core.pushing.model import Combined, Continued, PushModel
from optipromp.core.pushing.packs import standing
from optipromp.core.pushing.packs.standing import Standing, rings_of, wrist
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, ToolPath, along, evenly, length, turning
from optipromp.core.pushing.rules import neighbours
from optipromp.core.pushing.stems import hanging
from optipromp.core.pushing.stems.cup import flange_of
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots.grippers import PRESS, Scissor, Suction
from optipromp.core.robots.model import Robot, letting_touch
from optipromp.core.robots.mounted import Mounted, loads_of, unmounted
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.robots.tools import make_tool, with_tool
from optipromp.core.scenes.goals import Goal, JointGoal, PoseGoal, at_goal
from optipromp.core.scenes.held import Pair, check_names
from optipromp.core.scenes.objects import ObjectMotion, check_upright
from optipromp.core.scenes.scene import Attached, Scene, SceneObject, bare_robot
from optipromp.core.trajectory import State, Trajectory

MOST_POINTS = 50_000  # of a tool's motion, which are 50 m at STEP: more than any arm's
MOMENTS = 200  # of a trajectory at which the passage of what moves is looked for: a choice


@dataclass(frozen=True, eq=False)
class Underway:
    """What the arm has done by the start of a task.

    Attributes:
        begun: whether its state replaces the scene's start: the tool may be among fruits already.
        entry: (3,) tool point at the start, if the tool has begun its approach [m]; else None.
        passed: neighbours below the rim of a tool that has begun its approach.
        running: the rest of the trajectory that runs already; None: none runs.
        kept: tool path of ``running``.
        same: whether the pushables are where the running plan has them.
        pushed: tool points and axes (P, 3) of the push so far, if ``same``.
    """

    begun: bool = False
    entry: FloatArray | None = None
    passed: tuple[SceneObject, ...] = ()
    running: Trajectory | None = None
    kept: ToolPath | None = None
    same: bool = False
    pushed: tuple[FloatArray, FloatArray] | None = None


FROM_START = Underway()


@dataclass(frozen=True, eq=False)
class Task:
    """A scene bound to its robot.

    Attributes:
        scene: of the request.
        robot: with the scene's tool.
        state: of the arm at the start.
        goal: a configuration, a pose of the tool, or a region of poses.
        neighbours: pushables in the way, in the order in which the tool meets them.
        underway: what the arm has done by the start.
        risk: share of promised successes that may be broken.
        seed: of everything random.
        demonstrations: of the request: a ProMP, or a file to learn one from; None: the robot's own.
        back: the push model of a retreat, which predicts its whole motion; None for other motions.
        courses: how pushables move about their places in ``scene``, by id; see :func:`as_of`.
    """

    scene: Scene
    robot: Robot
    state: State
    goal: Goal
    neighbours: tuple[SceneObject, ...]
    underway: Underway = FROM_START
    risk: float = PUSH.harm.risk
    seed: int = 0
    demonstrations: ProMP | str | Path | None = None
    back: PushModel | None = None
    courses: Mapping[str, ObjectMotion] = field(default_factory=dict)

    @property
    def start(self) -> FloatArray:
        """Configuration (n,) at the start."""
        return self.state.q

    def __getstate__(self) -> dict[str, Any]:
        """The fields; cached properties are computed anew."""
        return {item.name: getattr(self, item.name) for item in fields(self)}

    @property
    def body(self) -> BodyPoints:
        """The points of the robot that the planning loop follows."""
        return body_points(self.robot)

    @functools.cached_property
    def surroundings(self) -> Surroundings:
        """Obstacles by role, packed when they are first read."""
        return surroundings_of(self.scene.world, self.robot)

    @functools.cached_property
    def _models(self) -> dict[bytes, PushModel | None]:
        return {}

    def push_model(self, goal: FloatArray) -> PushModel | None:
        """The push model; None where no model applies or nothing is to be pushed.

        It depends on the configuration ``goal`` (n,) of the arm at the target where objects stand,
        because they may meet the arm. It is made once, or then once for each ``goal``.
        """
        if self.back is not None:
            return self.back
        key = goal.tobytes() if stands(self) else b""
        if key not in self._models:
            self._models[key] = _push_model(self, goal)
        return self._models[key]

    @functools.cached_property
    def camera(self) -> FloatArray:
        """Camera point (3,) [m] before goal and lowest fruit; on the approach, ``entry``."""
        assert isinstance(self.goal, PoseGoal)
        if self.underway.entry is not None:
            return self.underway.entry
        up = self.scene.frame[2]
        heights = [
            float((fruit.position - self.goal.position) @ up) - fruit.radius
            for fruit in self.neighbours
        ]
        before = min([0.0, *heights]) - self.scene.approach.camera_distance
        return np.asarray(self.goal.position + before * up)

    def axes(self, share: FloatArray) -> FloatArray:
        """Tool axes (m, 3) at shares (m,) of the length of the tool path."""
        assert isinstance(self.goal, PoseGoal)
        lead = None if self.underway.entry is not None else self.scene.approach.lead
        return turning(self.goal.axis, lead, share)

    def at_goal(self, q: FloatArray) -> bool:
        """Whether configuration ``q`` (n,) is at the goal, within its tolerances."""
        return at_goal(self.robot, self.goal, q)


# Compares robots by identity: an unchanged file gives the same robot object.
@functools.lru_cache(maxsize=32)
def _equip(
    robot: Robot, spec: tuple[str, tuple[tuple[str, Any], ...]] | None,
    attached: tuple[Attached, ...], pairs: tuple[Pair, ...],
) -> Robot:  # fmt: skip
    """The robot with a tool, with what the tool holds, without the pairs that may touch."""
    if spec is not None:
        robot = with_tool(robot, make_tool(spec[0], dict(spec[1])))
    if attached:
        robot = laden(robot, attached)
    return letting_touch(robot, pairs) if pairs else robot


def laden(robot: Robot, attached: Sequence[Attached]) -> Robot:
    """The robot whose tool holds ``attached``."""
    if robot.tool is None:
        raise InvalidRequestError(
            f"attached {attached[0].id!r}: {robot.name} has no tool; give the scene a tool, "
            "in whose axes the shape stands"
        )
    tool = Mounted.of(robot.tool)
    loads = (*tool.loads, *(item.load for item in attached))
    return with_tool(robot, replace(tool, loads=loads))


def robot_of(scene: Scene, robot: Robot | None = None) -> Robot:
    """The scene's robot with the scene's tool, and with what the tool holds.

    All of a scene stands in this robot's base frame. ``bare_robot`` is without the tool.
    ``robot`` has its own tool, and stands in the place of the scene's robot and tool.

    Raises:
        InvalidRobotError: a robot that cannot be loaded.
        InvalidSceneError: a tool of an unknown kind.
        InvalidRequestError: a tool that cannot be made or mounted.
    """
    spec = None
    if robot is None:
        robot, tool = bare_robot(scene), scene.tool
        if tool is not None:
            parameters = dict(tool.parameters)
            if tool.kind == "suction" and scene.target is not None:
                cup, target = unmounted(make_tool(tool.kind, parameters)), scene.target
                assert isinstance(cup, Suction)
                far = float(target.shape.support(-scene.frame[2:] @ target.rotation)[0])
                stroke = min(PRESS, PUSH.harm.target_force / cup.stiffness)
                parameters.setdefault("fruit", max(far - stroke, 0.0))
            spec = tool.kind, tuple(sorted(parameters.items()))
    held = {load.id for load in loads_of(robot.tool)}
    attached = tuple(item for item in scene.attached if item.id not in held)
    if spec or attached or scene.may_touch:
        robot = _equip(robot, spec, attached, scene.may_touch)
    return robot


def posed(
    scene: Scene, robot: Robot | None = None, state: State | None = None
) -> tuple[Robot, State]:
    """The robot of :func:`robot_of`, and the state of the arm at the start.

    ``state`` is of the arm, in place of the scene's start. InvalidSceneError: also of a stem that
    is stated to be softer than it must be to stand.
    """
    robot = robot_of(scene, robot)
    dense = FRUIT_DENSITY if scene.crop is None else scene.crop["density"]
    check_upright(scene.objects_at(np.flatnonzero(scene.hangs)), scene.up, dense)
    if state is None and scene.may_touch:
        links = robot.link_names
        if scene.place is not None and scene.target is not None:
            links = (*links, scene.target.id)  # which the tool holds after the pick
        check_names(scene.may_touch, [item.id for item in scene.objects], links)
    start = robot.home if scene.start is None else scene.start
    start = start if state is None else state.q
    if start.shape != (robot.n_joints,):
        raise StartInvalidError(
            f"start has {start.size} values; {robot.name} has {robot.n_joints} joints: "
            f"{', '.join(robot.joint_names)}"
        )
    start = within_limits(robot, start, "start", StartInvalidError)
    if state is not None and (fast := np.abs(state.velocity) > robot.velocity).any():
        joint = int(np.argmax(fast))
        raise StartInvalidError(
            f"start: {robot.joint_names[joint]} moves at {state.velocity[joint]:.4g}, above its "
            f"limit {robot.velocity[joint]:g}"
        )
    return robot, State(start) if state is None else replace(state, q=start)


def resolve(scene: Scene, robot: Robot | None = None, state: State | None = None) -> Task:
    """The task of a scene; its arguments are those of :func:`posed`.

    The approach of a scissor ends on the stem of the target.
    """
    robot, begin = posed(scene, robot, state)
    scene = aimed_at_stem(scene, robot.tool)
    goal, *_ = goals_of(scene, robot, begin.q)
    near = neighbours(scene, robot.gripper_radius)
    return Task(scene, robot, begin, goal, near, Underway(begun=state is not None))


def goals_of(scene: Scene, robot: Robot, start: FloatArray) -> tuple[Goal, ...]:
    """The goals of an arm that begins at ``start`` (n,), any of which may be reached."""
    goals = tuple(
        _turned(goal, robot, start) if isinstance(goal, JointGoal) else goal for goal in scene.goals
    )
    if not goals:
        assert scene.aim is not None  # a scene has a target or a goal
        goals = (PoseGoal(scene.aim, scene.frame[2]),)
    return goals


def approached(task: Task, scene: Scene) -> Task:
    """The task for ``scene``: its scene with another approach."""
    assert scene.aim is not None
    goal, near = PoseGoal(scene.aim, scene.frame[2]), neighbours(scene, task.robot.gripper_radius)
    return replace(task, scene=scene, goal=goal, neighbours=near)


def passages(task: Task, trajectory: Trajectory) -> dict[str, float]:
    """When the tool is nearest to each pushable that moves [s], by id."""
    if not (courses := task.scene.drifting):
        return {}
    times = np.linspace(0.0, trajectory.duration, MOMENTS)
    points, _ = task.robot.tool_pose(trajectory.sample(times)[0])
    return {
        name: float(times[np.argmin(lengths(points - course.at(times)))])
        for name, course in courses.items()
    }


def as_of(task: Task, when: Mapping[str, float]) -> Task:
    """The task whose pushables stand where they are at times ``when`` [s], by id.

    Its ``courses`` are their displacements from there.
    """
    if not when:
        return task
    scene = task.scene.standing(when)
    here, before = {item.id: item for item in scene.objects}, task.scene.drifting
    courses = {name: before[name].shifted(-here[name].position) for name in when}
    near = tuple(here[item.id] for item in task.neighbours)
    if task.underway.entry is None:
        near = neighbours(scene, task.robot.gripper_radius)
    passed = tuple(here[item.id] for item in task.underway.passed)
    task = replace(task, scene=scene, neighbours=near, courses=courses)
    return changed(task, passed=passed)


def changed(task: Task, **done: Any) -> Task:
    """The task of an arm that has done something else by its start; see :class:`Underway`."""
    return replace(task, underway=replace(task.underway, **done))


def _push_model(task: Task, goal: FloatArray) -> PushModel | None:
    scene, tool = task.scene, task.robot.tool
    if tool is None or not isinstance(task.goal, PoseGoal):
        return None
    models: list[PushModel] = []
    if stands(task):
        links, rings = wrist(task.robot, scene, task.goal.position, goal), rings_of(task.robot)
        models.append(Standing(scene, tool, links, rings=rings, risk=task.risk))
    if hanging.applies(scene, tool, task.neighbours or task.underway.passed):
        radius, flange = task.robot.gripper_radius, flange_of(task.robot)
        models.append(Hanging(scene, tool, task.neighbours, task.camera, radius, flange, task.risk))
    if not models:
        return None
    model = models[0] if len(models) == 1 else Combined(*models)
    return model if task.underway.pushed is None else Continued(model, *task.underway.pushed)


def tool_motion(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (P, 3), about :data:`STEP` apart, and tool axes (P, 3) along ``q`` (T, n)."""
    return spaced(*robot.tool_pose(q))


def spaced(points: FloatArray, axes: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points and axes (T, 3), resampled at P points about :data:`STEP` apart (P, 3).

    P is at most ``MOST_POINTS``.
    """
    count = max(2, min(int(np.ceil(length(points) / STEP)) + 1, MOST_POINTS))
    axes = along(points, axes, count)
    return evenly(points, count), axes / lengths(axes)[:, None]


def pushed_aside(task: Task) -> Task:
    """The task without the objects that stand: the tool pushes them aside before the arm comes."""
    return replace(task, scene=emptied(task.scene)) if stands(task) else task


def stands(task: Task) -> bool:
    """Whether the push model of standing objects applies."""
    return isinstance(task.goal, PoseGoal) and standing.applies(task.scene, task.robot.tool)


@functools.lru_cache(maxsize=4)
def emptied(scene: Scene) -> Scene:
    """The scene without the pushables that stand."""
    kept = (item for item in scene.objects if item.role != "pushable" or item.stem is not None)
    return replace(scene, objects=tuple(kept))


def cuts(scene: Scene, tool: Tool | None) -> bool:
    """Whether the ``tool`` is a scissor, and the target hangs on a stem."""
    hangs = scene.target is not None and scene.target.stem is not None
    return hangs and isinstance(unmounted(tool), Scissor)


def from_side(scene: Scene) -> bool:
    """Whether the approach of a scene is nearer to the level than to the vertical."""
    return abs(float(scene.frame[2] @ scene.up)) < math.sqrt(0.5)


def aimed_at_stem(scene: Scene, tool: Tool | None) -> Scene:
    """The scene whose approach ends on the target's stem, if the ``tool`` is a scissor.

    The place is the lowest one that is ``cut`` from the fruit; of a stem that is nowhere twice as
    far from the fruit, half of the way to its farthest place. Of a truss it is as far from all of
    its fruits and stems, above the highest node. The place does not vary where the
    scene states no lateral distance; from below, the axis does not where it states no cone: turned
    about the stem, the blades would meet the fruit. An approach whose ``shift`` is stated stays as
    it is.

    Raises:
        InvalidSceneError: a truss that the tool cannot cut, or cannot cut from here.
    """
    target, blades, approach = scene.target, unmounted(tool), scene.approach
    if target is not None and approach.truss:
        cut = isinstance(blades, Scissor) and from_side(scene)
        if not cut or (target.stem is not None and target.stem.parent is not None):
            raise InvalidSceneError(
                f"approach.truss: a truss is cut across the stem of {target.id}: state tool: "
                "{kind: scissor, opening: 0.05} and a level approach.direction; the target must be "
                "the fruit at the end of the stem from which the others grow"
            )
    if target is None or target.stem is None or not isinstance(blades, Scissor):
        return scene
    if approach.shift.any():
        return scene
    points = evenly(target.stem.points, int(np.ceil(target.stem.length / CUTTING.along)) + 1)
    solids = [(item.shape, item.position, item.rotation) for item in scene.taken]
    for stem in (item.stem for item in scene.taken[1:]):
        assert stem is not None
        points = points[int(np.argmin(lengths(points - stem.root))) :]
        solids += stem.pieces()
    far = distances(pack(solids), points)[0].min(axis=1)
    above = points[int(np.argmax(far >= min(blades.cut, 0.5 * far.max())))]
    cone = approach.cone if from_side(scene) or approach.cone is not None else 0.0
    aside = 0.0 if approach.aside is None else approach.aside
    approach = replace(approach, shift=above - target.position, cone=cone, aside=aside)
    return scene.approached(approach)


DEGREES = 4.0 * np.pi  # [rad] chosen: larger values look like degrees
LIMIT_TOLERANCE = 2e-3
"""[rad or m] A start or a goal that is this little beyond a limit is at the limit. An encoder of
4096 steps errs by 1.5e-3 rad: a choice."""
LIMIT_ROUNDING = 1e-6  # [rad or m] that is not worth a word: files round


def _turned(goal: JointGoal, robot: Robot, start: FloatArray) -> JointGoal:
    """A goal whose joints that may turn without end have their values nearest to ``start`` (n,)."""
    joints = robot.check_configuration(goal.joints)
    joints = within_limits(robot, joints, "goal", InvalidRequestError)
    return JointGoal(np.where(robot.turns.endless, robot.turns.onto(joints, start), joints))


def within_limits(robot: Robot, q: FloatArray, what: str, error: type) -> FloatArray:
    """A configuration (n,) within the joint limits.

    A joint at most :data:`LIMIT_TOLERANCE` beyond its limit is moved to it, with a warning; farther
    ones are refused. ``what`` begins the warning and the ``error``.
    """
    over = np.maximum(robot.lower - q, q - robot.upper)
    worst = int(np.argmax(over))
    if over[worst] <= 0.0:
        far = int(np.argmax(np.abs(q) / (1.0 + robot.turns.endless)))  # these may have turned
        if abs(q[far]) > DEGREES * (1.0 + robot.turns.endless[far]):
            warnings.warn(f"{what}: {robot.joint_names[far]} is {q[far]:g}: degrees?", stacklevel=4)
        return q
    noise = LIMIT_ROUNDING < over[worst] <= LIMIT_TOLERANCE
    told = (
        f"{what}: {robot.joint_names[worst]} is {q[worst]:.{6 if noise else 4}f}, outside its "
        f"limits [{robot.lower[worst]:.4f}, {robot.upper[worst]:.4f}]"
    )
    if over[worst] > LIMIT_TOLERANCE:
        degrees = " (degrees? radians are needed)" if abs(q[worst]) > DEGREES else ""
        raise error(f"{told} by more than {LIMIT_TOLERANCE:g}{degrees}")
    if noise:
        warnings.warn(f"{told} by {over[worst]:.2g}: moved to the limit", stacklevel=4)
    return np.clip(q, robot.lower, robot.upper)
