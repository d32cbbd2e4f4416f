"""A guard between two topics: somebody's velocities in, harmless velocities out."""

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.guard import Guard, Safe
from optipromp_ros import live, trajectories
from optipromp_ros.types import Message, message

COMMAND = "std_msgs/msg/Float64MultiArray"
SILENT = 0.1  # [s] after which a command counts no more, and a state of the arm is old: five cycles


class GuardFilter:
    """Filters the commands of a velocity controller of ROS by a guard.

    Commands are ``std_msgs/Float64MultiArray``: a velocity for each joint, in the robot's order, as
    the ``JointGroupVelocityController`` of ros2_control reads them; or three velocities of the
    tool point in the base frame. What goes out has a velocity for each joint.

    Args:
        scene: robot, tool, fruits and what stands still.
        parameters: of the detections.
        prefix: of joint and link names in ROS.
    """

    def __init__(
        self, scene: Scene, parameters: live.DetectionParameters | None = None, prefix: str = ""
    ) -> None:
        self.guard = Guard(scene)
        self.safe: Safe | None = None
        self._parameters = parameters or live.DetectionParameters()
        self._frames = live.frames_of(self.guard.robot, prefix, scene.base)
        self._state: tuple[int, State] | None = None
        self._wish: tuple[int, FloatArray] | None = None
        self._looks: list[Look] = []

    def heard(self, item: Message, now: int) -> None:
        """Take a command, a ``JointState`` or a ``Detection3DArray`` in, at ``now`` [ns].

        Raises:
            InvalidRequestError: joints that are not the robot's; an unknown frame; a command of a
                wrong length; another type of message.
        """
        robot = self.guard.robot
        match item.__msgtype__:
            case "sensor_msgs/msg/JointState":
                state = trajectories.joint_motion(item, robot.joint_names, "joint_states")
                self._state = now, state
            case _ if item.__msgtype__ == COMMAND:
                wish = np.array(item.data, dtype=np.float64)
                if len(wish) not in (3, robot.n_joints):
                    raise InvalidRequestError(
                        f"a command has {len(wish)} values: must be {robot.n_joints} velocities of "
                        "joints, or 3 of the tool point"
                    )
                self._wish = now, wish
            case _ if item.__msgtype__ == live.DETECTIONS:
                time = 1e-9 * trajectories.nanoseconds(item.header.stamp)
                look = live.read_detections(item, self._frames, self._parameters, time=time)
                self._looks.append(look)
            case _:
                raise InvalidRequestError(f"a {item.__msgtype__} is of no use to a guard")

    def tick(self, now: int) -> Message | None:
        """The command of the next period, at ``now`` [ns]; None: no state of the arm is known.

        A command that is older than :data:`SILENT` counts as 0.
        """
        if self._state is None or now - self._state[0] > 1e9 * SILENT:
            return None
        state, wish = self._state[1], np.zeros(self.guard.robot.n_joints)
        if self._wish is not None and now - self._wish[0] <= 1e9 * SILENT:
            wish = self._wish[1]
        if len(wish) < self.guard.robot.n_joints:
            wish = self.guard.tool(wish, state)
        looks, self._looks = self._looks, []
        self.safe = self.guard(wish, state, looks)
        return message(COMMAND, data=self.safe.velocity)
