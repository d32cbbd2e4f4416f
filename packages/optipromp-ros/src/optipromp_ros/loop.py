"""What the node ``optipromp ros-node`` does, without ROS: plans on request, and the closed loop.

:class:`PickLoop` takes states and detections in and gives curves that replace others.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.errors import (
    Code,
    ExecutionError,
    InvalidRequestError,
    OptiPrompError,
    StartInvalidError,
)
from optipromp.core.execution.executor import standing
from optipromp.core.execution.streaming import Line, Stretch
from optipromp.core.planning import Plan, PlanOptions, plan
from optipromp.core.planning.planners import factory
from optipromp.core.promp.model import ProMP
from optipromp.core.robots.library import load_arm
from optipromp.core.robots.measured import Measured
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_eyes.watcher import Watcher
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.plant import without_fruits
from optipromp_loop.control.stages import LoopStage
from optipromp_ros import live, trajectories
from optipromp_ros.frames import Frames, known_frames, link_prefix
from optipromp_ros.images import PICTURES, Pictures
from optipromp_ros.scenes import vector
from optipromp_ros.types import ERROR, OK, WARN, Message, constants, diagnostic, message

WRENCH = "geometry_msgs/msg/WrenchStamped"
KEPT = 2.0  # [s] of joint states, to tell where a camera on the hand was: a choice


class PickLoop:
    """A pick in closed loop by messages.

    All times are those of the messages' stamps and of :meth:`tick`, which must share a clock. Where
    that clock is set, the arm comes to rest on the running curve, the states so far are dropped,
    and the next curve begins where the arm is measured then.

    Args:
        scene: robot, tool, approach, and what stands still. Its fruits are left out: the camera
            tells of them.
        parameters: of the detections.
        controller: of the pick; None: one for ``scene``.
        rate: of the points of a trajectory [Hz]; None: the rows of the curves.
        prefix: of joint and link names in ROS.
        watcher: of pictures, where looks are made here of a camera's topics; None: pictures are
            refused, and detections tell of the fruits.

    Attributes:
        controller: with its stage and its decisions.
        frames: that were told.
    """

    def __init__(
        self,
        scene: Scene,
        *,
        parameters: live.DetectionParameters | None = None,
        controller: Controller | None = None,
        rate: float | None = None,
        prefix: str = "",
        watcher: Watcher | None = None,
    ) -> None:
        self.watcher, self._pictures = watcher, Pictures()
        self.controller = controller or Controller(without_fruits(scene), real_time=True)
        self.parameters = parameters or live.DetectionParameters()
        robot = self.controller.robot
        self.frames, self._base = Frames(), scene.base
        self._rate, self._prefix = rate, prefix
        held = self.controller.parameters.state_age
        self._arm = Measured(robot.joint_names, robot.turns, prefix=prefix, kept=KEPT, held=held)
        self._origin: int | None = None  # the stamp of the loop's time 0, as the clock is set now
        self._ticked: tuple[int, int] | None = None  # the last cycle by both clocks [ns]
        self._line: Line | None = None
        self._trouble, self._set = "no joint states", ""  # why nothing goes on; that of the clock

    @property
    def ended(self) -> bool:
        """Whether the pick is done, or given up."""
        return self.controller.ended

    def heard(self, item: Message, topic: str = "") -> None:
        """Take a message in.

        Read are ``sensor_msgs/JointState``, ``vision_msgs/Detection3DArray``, and
        ``tf2_msgs/TFMessage`` of frames that stand still on a link of the robot or on ``tool`` (at
        the tool point, z along its axis), themselves or through others; and
        ``geometry_msgs/WrenchStamped``, the force of the world on the tool in any known frame,
        without the tool's own weight.
        With a watcher also the messages of pictures that :func:`optipromp_ros.bag_pictures` reads.

        Args:
            item: the message.
            topic: of a picture: one with ``rect`` in its name has no distortion.

        Raises:
            InvalidRequestError: joints that are not the robot's; an unknown frame; detections or
                pictures from before the first joint states, or from long after the newest; another
                type of message.
            InvalidSceneError: a wrong value.
        """
        match item.__msgtype__:
            case "sensor_msgs/msg/JointState":
                time = self._time(trajectories.nanoseconds(item.header.stamp))
                trajectories.hear(self._arm, item, time)
            case _ if item.__msgtype__ == WRENCH:
                time = self._time(trajectories.nanoseconds(item.header.stamp))
                sensor = self._camera(item.header.frame_id, time)
                self.controller.feel(time, sensor.rotation @ vector(item.wrench.force))
            case "tf2_msgs/msg/TFMessage":
                self.frames.heard(item, still=True)
            case _ if item.__msgtype__ == live.DETECTIONS:
                time = self._time(trajectories.nanoseconds(item.header.stamp))
                known = {item.header.frame_id: self._camera(item.header.frame_id, time)}
                self.controller.see(live.read_detections(item, known, self.parameters, time=time))
            case kind if kind in PICTURES and self.watcher is not None:
                taken = self._pictures.heard(topic or kind, item)
                if taken is not None:
                    time = self._time(taken.stamp)
                    camera = self._camera(taken.header.frame_id, time)
                    self.watcher.watch(taken.picture(camera), time)
            case _:
                raise InvalidRequestError(
                    f"a {item.__msgtype__} is of no use here: must be a JointState, a "
                    "Detection3DArray, a WrenchStamped or a TFMessage"
                )

    def tick(self, now: int, steady: int | None = None) -> Message | None:
        """One cycle of the controller, to be called every ``controller.parameters.period``.

        Args:
            now: by the clock of the stamps [ns].
            steady: by a clock that nobody sets, such as ``time.monotonic_ns()``, by which the clock
                of the stamps is judged; None: by the period of the cycles and by the joint states.

        Returns:
            The ``trajectory_msgs/JointTrajectory`` that takes over at its time stamp,
            ``controller.parameters.lead`` from now. None: what runs goes on or the arm stands.
            Where joint states are missing, older than ``controller.parameters.state_age`` or ahead,
            or the clock was set, that trajectory comes to rest.
        """
        p, by = self.controller.parameters, self._set_by(now, steady)
        time = self._time(now)
        if by:
            self._arm.forget()
            self._set = f"the clock was set {'back' if by < 0.0 else 'forward'} by {abs(by):.3f} s"
        newest = self._arm.newest
        age = math.inf if newest is None else time - newest[0]
        fresh = newest is not None and abs(age) <= p.state_age
        if self._set and newest and fresh and (self._line is None or self._line.ended(time)):
            self.controller.begin_anew(time, newest[1])
            self._line, self._set = None, ""
        self._trouble = self._set
        if not (fresh or self._trouble):
            self._trouble = "joint states are old" if newest else self._arm.silent
            if age < 0.0:
                self._trouble = "joint states are ahead of the clock"
                self._arm.forget()
        if self._trouble or newest is None:
            return self._sent(self.controller.hold(time, self._trouble), time)
        for look in () if self.watcher is None else self.watcher.looks():
            self.controller.see(look)
        at, measured = newest
        reference = State(measured.q) if self._line is None else self._line.at(at)
        return self._sent(self.controller(time, measured, reference), time)

    def _set_by(self, now: int, steady: int | None) -> float:
        """By how much the clock of the stamps was set since the last cycle [s]; 0: it was not.

        The loop's own time goes on as if it had not been.
        """
        before, self._ticked = self._ticked, (now, now if steady is None else steady)
        if before is None or self._origin is None:
            return 0.0
        gone = (now - before[0]) / trajectories.NANO
        true = gone if steady is None else (steady - before[1]) / trajectories.NANO
        p = self.controller.parameters
        if steady is None and (gone < 0.0 or self._jumped(before[0], gone)):
            true = p.period
        self._origin += round((gone - true) * trajectories.NANO)
        return gone - true if abs(gone - true) > p.clock_step else 0.0

    def _jumped(self, before: int, gone: float) -> bool:
        """Whether the arm is where it was to be a period, and not ``gone`` [s], after a cycle."""
        p, then = self.controller.parameters, self._time(before)
        if gone - p.period <= p.clock_step or (newest := self._arm.newest) is None:
            return False
        at, state = newest
        if abs(then + gone - at) > p.state_age:
            return False  # nothing was heard: it may have waited
        times = self._arm.series()[-1].times
        heard = times[(times > then) & (times < then + gone)]
        if np.diff(heard, prepend=then, append=then + gone).max() <= p.clock_step:
            return False  # states came all the while: the cycle is late
        if self._line is None:
            return True
        apart, line = self.controller.robot.apart, self._line
        one, other = (apart(state.q, line.at(then + after).q) for after in (p.period, gone))
        return bool(np.abs(one).max() <= np.abs(other).max())

    def _sent(self, stretch: Stretch | None, time: float) -> Message | None:
        """The message of a stretch; None where it changes nothing for an arm that stands."""
        if stretch is None:
            return None
        newest, begins = self._arm.newest, stretch.begins
        stood = standing(self.controller.robot, newest[1]) if newest else stretch.curve
        line = self._line or Line.of(stood, min(time, begins))
        stands = not np.ptp(stretch.curve.positions, axis=0).any()
        if stands and line.at(begins).near(stretch.at(begins), 1e-9):
            return None  # a controller of the arm holds it where it stands
        since = time if newest is None else min(time, newest[0])  # it is asked for the state then
        try:
            self._line = line.take(stretch, since, anew=self.controller.lost)
        except ExecutionError as error:  # the arm comes to rest on the curve that runs
            self._trouble = error.message
            stretch = self.controller.driver.brake(begins, line.at(begins))
            self._line = line.take(stretch, since)
        assert self._origin is not None
        before = self._arm.prefix or ""
        return trajectories.stretch_trajectory(stretch, self._origin, self._rate, before)

    def status(self) -> Message:
        """A ``diagnostic_msgs/DiagnosticStatus``: the last decision, the stage and the fruits."""
        loop = self.controller
        trouble = self._trouble or loop.fault
        failed = loop.lost or loop.stage is LoopStage.GAVE_UP
        level = ERROR if failed else WARN if trouble else OK
        tracked = None if self._origin is None else loop.tracker.at(max(loop.tracker.time, 0.0))
        count = 0 if tracked is None else int(tracked.confirmed.sum())
        told = {
            "stage": str(loop.stage),
            "fruits": str(count),
            "gripper": "close" if loop.holding else "open",
            "tries left": str(loop.tries),
            "camera": loop.noticed[-1].why if loop.noticed else "",
            "last cycle [ms]": f"{1e3 * loop.cycles[-1]:.1f}" if loop.cycles else "",
        }
        words = trouble or (loop.events[-1].why if loop.events else "looking")
        return diagnostic(level, "loop", words, loop.robot.name, told)

    def _time(self, stamp: int) -> float:
        """Seconds since the first stamp: few, so that they are exact to the nanosecond."""
        if self._origin is None:
            self._origin = stamp
        return (stamp - self._origin) / trajectories.NANO

    def _camera(self, name: str, time: float) -> Pose:
        """The pose of a camera's frame in the base at a ``time`` [s]."""
        robot, q = self.controller.robot, self._arm.at(time)
        before = link_prefix(self.frames.names, robot, self._arm.prefix, self._prefix)
        return self.frames.find(name, known_frames(robot, before, self._base, q))


RESPONSE = "moveit_msgs/msg/MotionPlanResponse"
ERROR_CODES = "moveit_msgs/msg/MoveItErrorCodes"
MOVEIT: dict[Code, str] = {  # MoveIt's name of each code; any other code is a FAILURE
    Code.SUCCESS: "SUCCESS",
    Code.INVALID_ROBOT: "INVALID_ROBOT_STATE",
    Code.INVALID_SCENE: "INVALID_OBJECT_NAME",
    Code.INVALID_REQUEST: "INVALID_GOAL_CONSTRAINTS",
    Code.START_INVALID: "START_STATE_INVALID",
    Code.START_IN_COLLISION: "START_STATE_IN_COLLISION",
    Code.GOAL_IN_COLLISION: "GOAL_IN_COLLISION",
    Code.GOAL_UNREACHABLE: "NO_IK_SOLUTION",
    Code.NO_PLAN: "PLANNING_FAILED",
    Code.INVALID_PLAN: "INVALID_MOTION_PLAN",
    Code.HARM_PREDICTED: "INVALID_MOTION_PLAN",
    Code.TIMEOUT: "TIMED_OUT",
    Code.EXECUTION_FAILED: "CONTROL_FAILED",
}


@dataclass(frozen=True, eq=False)
class PlanAnswer:
    """The answer to a request.

    Attributes:
        response: ``moveit_msgs/MotionPlanResponse``, with a trajectory only of a success.
        trajectory: ``trajectory_msgs/JointTrajectory`` for a controller; None: no success.
        display: ``moveit_msgs/DisplayTrajectory``, also of a plan that failed; None: the request
            was refused.
        plan: None: the request was refused.
    """

    response: Message
    trajectory: Message | None = None
    display: Message | None = None
    plan: Plan | None = None


def answer(
    world: live.LiveScene,
    request: Message,
    options: PlanOptions | None = None,
    *,
    demonstrations: ProMP | str | Path | None = None,
    rate: float | None = None,
    prefix: str = "",
    now: int | None = None,
) -> PlanAnswer:
    """Plan the motion of a ``moveit_msgs/MotionPlanRequest``.

    Read are ``start_state`` (where it names joints; with velocities the plan begins in motion; else
    the plan begins where the joint states say that the arm stands),
    ``goal_constraints`` (none: the target of the world), ``planner_id`` (empty: opti-promp),
    ``allowed_planning_time``, and the scaling factors (0: those of ``options``). A
    ``group_name`` must be one of this arm, where an SRDF states its groups. Workspace, number of
    attempts and pipeline are ignored. Path and trajectory constraints, reference trajectories and a
    Cartesian speed are refused.

    Args:
        world: the scene so far.
        request: the message.
        options: of the plan; the request's planning time replaces its timeout.
        demonstrations: as for :func:`optipromp.plan`.
        rate: of the points of the answer [Hz]; None: the rows of the plan.
        prefix: of joint and link names in ROS; empty: the answer names joints as their states do.
        now: by the clock of the joint states [ns]; after :data:`optipromp_ros.arm_state.OLD` they
            are refused. None: they are recorded, and their age is not judged.

    Returns:
        The answer; to a request that cannot be used, the code and the message of the error.
    """
    prefix = prefix or world.prefix
    world, spoken = replace(world, prefix=prefix), prefix or world.arm.measured.prefix or ""
    try:
        _refuse_unread(request)
        _refuse_another_arm(request.group_name, world)
        options = replace(options or PlanOptions(), **_limits(request))
        planner = request.planner_id or "opti-promp"
        factory(planner, "planner_id")  # refuses an unknown name
        stated, state = request.start_state.joint_state, None
        if stated.name or len(stated.position):
            what = "start_state.joint_state"
            state = trajectories.joint_motion(stated, world.robot.joint_names, what, prefix)
            world = world.at(state.q)
        goals = live.read_goal(request.goal_constraints, world)
        if state is None:
            state = _measured(world, now)
            world = world.at(state.q)
        made = plan(
            world.scene(goals),
            planner=planner,
            demonstrations=demonstrations,
            options=options,
            start_state=state if state.moving else None,
        )
    except OptiPrompError as error:
        return PlanAnswer(_response(request, error.code, error.message))
    motion = made.trajectory
    start = trajectories.robot_state(motion.at(0.0), motion.joint_names, spoken)
    done = {"trajectory_start": start, "planning_time": made.time["total"]}
    if made.success:
        done["trajectory"] = trajectories.robot_trajectory(motion, rate, spoken)
    return PlanAnswer(
        response=_response(request, made.status, made.message, **done),
        trajectory=trajectories.joint_trajectory(motion, rate, spoken) if made.success else None,
        display=trajectories.display_trajectory([motion], made.robot.name, rate, spoken),
        plan=made,
    )


def _measured(world: live.LiveScene, now: int | None) -> State:
    """The state of an arm that stands."""
    try:
        return world.arm.at_rest(now)
    except StartInvalidError as error:
        if world.unknown:
            world.scene()  # tells what must be mended besides
        raise StartInvalidError(f"{error.message}; or state the start_state") from None


def not_executed(request: Message, found: PlanAnswer, error: OptiPrompError) -> PlanAnswer:
    """The answer where a plan was not executed, or not to its end."""
    told = "" if isinstance(error, ExecutionError) else "not executed: "
    response = _response(request, error.code, told + error.message)
    return replace(found, response=response, trajectory=None)


def _refuse_another_arm(group: str, world: live.LiveScene) -> None:
    """Refuse a group whose joints are not the arm's, or that the arm's SRDF does not have."""
    keys = "base_dir", "choice"
    given = {key: world.stated[key] for key in keys if key in world.stated}
    _, arm = load_arm(world.stated["robot"], **given)
    if not group or not arm.groups or set(arm.groups.get(group, ())) == set(arm.joints):
        return
    mine = [name for name, joints in arm.groups.items() if set(joints) == set(arm.joints)]
    raise InvalidRequestError(
        f"group_name is {group!r}: this node plans for {', '.join(mine) or arm.why} "
        f"({arm.joints[0]} to {arm.joints[-1]}); leave it empty, or ask the node of that arm"
    )


def _response(request: Message, code: Code, words: str, **fields: Message) -> Message:
    values = constants(ERROR_CODES)
    error = message(
        ERROR_CODES,
        val=values[MOVEIT.get(code, "FAILURE")],
        message=f"{code}: {words}" if words else str(code),
        source="optipromp",
    )
    return message(RESPONSE, group_name=request.group_name, error_code=error, **fields)


def _limits(request: Message) -> dict[str, Any]:
    """The scaling factors and the planning time that a request states, as options of the plan."""
    found = {}
    for name in ("velocity_scaling", "acceleration_scaling"):
        value = float(getattr(request, f"max_{name}_factor"))
        if not 0.0 <= value <= 1.0:
            told = f"max_{name}_factor is {value:g}"
            raise InvalidRequestError(f"{told}: must be above 0 and at most 1, or 0")
        if value:
            found[name] = value
    seconds = float(request.allowed_planning_time)
    if not 0.0 <= seconds < math.inf:
        raise InvalidRequestError(
            f"allowed_planning_time is {seconds:g}: must be above 0 s, or 0 (as the options say)"
        )
    return found | ({"timeout": seconds} if seconds else {})


def _refuse_unread(request: Message) -> None:
    """Refuse constraints that the planner does not keep."""
    path = request.path_constraints
    kinds = (f"{k}_constraints" for k in ("joint", "position", "orientation", "visibility"))
    stated = {f"path_constraints.{kind}": getattr(path, kind) for kind in kinds} | {
        "trajectory_constraints": request.trajectory_constraints.constraints,
        "reference_trajectories": request.reference_trajectories,
        "max_cartesian_speed": request.max_cartesian_speed != 0.0,
        "start_state.multi_dof_joint_state": request.start_state.multi_dof_joint_state.joint_names,
        "start_state.attached_collision_objects": request.start_state.attached_collision_objects,
    }
    if asked := [name for name, value in stated.items() if value]:
        raise InvalidRequestError(f"{', '.join(asked)}: must be empty; the planner keeps none")
