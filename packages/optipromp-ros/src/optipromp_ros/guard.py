"""A guard between two topics: somebody's velocities in, harmless velocities out."""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError, StartInvalidError
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.guard import Guard, Safe
from optipromp_ros import live, trajectories
from optipromp_ros.arm_state import ArmState
from optipromp_ros.frames import known_frames
from optipromp_ros.types import ERROR, OK, WARN, Message, diagnostic, message

COMMAND = "std_msgs/msg/Float64MultiArray"
SILENT = 0.1  # [s] after which a command counts no more, and a state of the arm is old: five cycles

REST = 1e-6  # [rad/s or m/s] of the end of a braking curve: rounding


class GuardFilter:
    """Filters the commands of a velocity controller of ROS by a guard.

    Commands are ``std_msgs/Float64MultiArray``: a velocity for each joint, in the robot's order, as
    the ``JointGroupVelocityController`` of ros2_control reads them; or three velocities of the
    tool point in the base frame. What goes out has a velocity for each joint.

    Args:
        scene: robot, tool, fruits and what stands still.
        parameters: of the detections.
        prefix: of joint and link names in ROS.
        takes_over: of the guard, see :class:`optipromp_loop.guard.Guard`.
    """

    def __init__(
        self, scene: Scene, parameters: live.DetectionParameters | None = None, prefix: str = "",
        takes_over: bool = False,
    ) -> None:  # fmt: skip
        self.guard = Guard(scene, takes_over=takes_over)
        self.safe: Safe | None = None
        self._parameters = parameters or live.DetectionParameters()
        self._prefix, self._base = prefix, scene.base
        self._arm = ArmState.of(self.guard.robot, prefix, SILENT)
        self._wish: tuple[int, FloatArray] | None = None
        self._looks: list[Look] = []
        self._trouble = ""  # why nothing was decided in the last period

    def heard(self, item: Message, now: int) -> None:
        """Take a command, a ``JointState`` or a ``Detection3DArray`` in, at ``now`` [ns].

        Raises:
            InvalidRequestError: joints that are not the robot's; an unknown frame; a command of a
                wrong length; another type of message.
        """
        robot, q = self.guard.robot, None
        match item.__msgtype__:
            case "sensor_msgs/msg/JointState":
                self._arm = self._arm.heard(item, now)
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
                with suppress(StartInvalidError):
                    q = self._arm.known(now).q
                frames = known_frames(robot, self._prefix, self._base, q)
                self._looks.append(live.read_detections(item, frames, self._parameters, time=time))
            case _:
                raise InvalidRequestError(f"a {item.__msgtype__} is of no use to a guard")

    def tick(self, now: int) -> Message:
        """The command of the next period, at ``now`` [ns].

        A command that is older than :data:`SILENT` counts as 0. Without a state of the arm that is
        younger, and where the guard can decide nothing, the arm is led along the braking curve that
        passed last, and then gets zeros: a velocity controller goes on with what it got last.
        """
        self._trouble = ""
        try:
            self.safe = self._decided(self._arm.known(now), now)
        except StartInvalidError as error:
            self._trouble = error.message
        except (OptiPrompError, ValueError, ArithmeticError) as error:
            self._trouble = f"nothing can be decided: {error}"
        if self._trouble:
            self.safe = self.guard.blind(self._trouble)
        still = np.zeros(self.guard.robot.n_joints)
        return message(COMMAND, data=still if self.safe is None else self.safe.velocity)

    def ending(self) -> Iterator[Message]:
        """The commands, one a period, of a guard that ends: along the braking curve, to zeros."""
        while safe := self.guard.blind("the guard ends"):
            if np.abs(safe.velocity).max() <= REST:
                break
            yield message(COMMAND, data=safe.velocity)
        yield message(COMMAND, data=np.zeros(self.guard.robot.n_joints))

    def status(self) -> Message:
        """A ``diagnostic_msgs/DiagnosticStatus``: why the last command is not what was asked, who
        moves the arm, and whether a gripper may close."""
        words = self._trouble or (self.safe.reason if self.safe else "")
        level, told = ERROR if self._trouble else WARN if words else OK, dict[str, str]()
        if self.safe is not None:
            told = {"mover": self.safe.mover, "gripper": "close" if self.safe.holding else "open"}
        return diagnostic(level, "guard", words or "as asked", self.guard.robot.name, told)

    def _decided(self, state: State, now: int) -> Safe:
        """What the guard gives for a state, and the newest command and looks."""
        wish = np.zeros(self.guard.robot.n_joints)
        if self._wish is not None and abs(now - self._wish[0]) <= 1e9 * SILENT:
            wish = self._wish[1]
        if len(wish) < self.guard.robot.n_joints:
            wish = self.guard.tool(wish, state)
        looks, self._looks = self._looks, []
        return self.guard(wish, state, looks, 1e-9 * now)
