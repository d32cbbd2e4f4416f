"""The closed loop behind doors where numbers pass: looks come as arrays, commands leave as arrays.

The doors of LeRobot (:mod:`optipromp_loop.lerobot`) and of inspect-robots lead here. A look is two
arrays:

- ``camera`` (16,): of the newest look: place of the camera (3) [m] and its rotation (9, row by row)
  in the robot's base frame, its full opening angle [rad], age of the look [s], nearest and farthest
  distance that the camera measures [m] (0: not known). An angle of 0: no look has come.
- ``fruits`` (FRUITS, 6): what the look shows: place in the base frame (3) [m], its deviation [m],
  radius [m], and its role: 1 target, 2 pushable, 3 avoid, 0 an empty row.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.linalg import polar

from optipromp.core.arrays import FloatArray
from optipromp.core.execution.executor import standing
from optipromp.core.execution.streaming import Line
from optipromp.core.geometry import Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.parameters import CONTROL

ROLES = "target", "pushable", "avoid"
FRUITS = 32  # rows of detections: as many as the tracker follows, a choice
KNOWN = 0.1  # [m] from a detection to the fruit of the scene whose shape it takes: a choice
GAIN = 2.0  # [1/s] of the joints' error of position in commands of velocity: a choice
TURNED = 1.0  # [rad or m] of a joint whose arm follows the tool point alone: a choice
COMMANDS = "positions", "velocities", "tool"


@dataclass
class Commands:
    """What actions are.

    Attributes:
        scene: a built-in scene or a file, with robot and tool, what stands, and fruits if known.
        rate: of actions [Hz].
        commands: ``positions`` [rad or m] or ``velocities`` of the joints, or ``tool``: velocity
            (3,) of the tool point [m/s], whose axis is kept.
    """

    scene: str = "scenario-3"
    rate: float = 50.0
    commands: str = "positions"

    def names(self, robot: Robot) -> list[str]:
        """Of the numbers of an action."""
        if self.commands == "tool":
            return [f"tool.{axis}.vel" for axis in "xyz"]
        ending = "pos" if self.commands == "positions" else "vel"
        return [f"{joint}.{ending}" for joint in robot.joint_names]


class Pilot:
    """The controller of one pick, and the line along which it leads the arm.

    Args:
        scene: see :class:`~optipromp_loop.control.controller.Controller`.
        given: what actions are; its scene is not read.
        seed: of the plans.
        steps: actions of a chunk; a search gets the cycles that a chunk lasts.

    Attributes:
        scene: as given.
        controller: with its stage, its events and its plans.
    """

    def __init__(
        self, scene: Scene, given: Commands | None = None, *, seed: int = 0, steps: int = 1
    ) -> None:
        self.scene, self.given, self.steps = scene, given or Commands(), steps
        cycles = max(steps / (self.given.rate * CONTROL.period), 1.0)
        slices = replace(CONTROL, slice_steps=round(CONTROL.slice_steps * cycles))
        if self.given.commands == "tool":
            slices = replace(slices, off_curve=TURNED)
        self.controller = Controller(scene, seed=seed, parameters=slices)
        self._line: Line | None = None
        self._seen = -np.inf

    def lead(
        self, now: float, q: FloatArray, look: Look | None, velocity: FloatArray | None = None
    ) -> Line:
        """The line from ``now`` [s] on, of an arm that is measured at ``q`` (n,).

        ``look``: the newest one. ``velocity``: (n,) as measured; None: that of the line.
        """
        robot = self.controller.robot
        line = self._line or Line.of(standing(robot, State(q)), now)
        if look is not None and look.time > self._seen:
            self._seen = look.time
            self.controller.see(look)
        reference = line.at(now)
        state = State(q, reference.velocity if velocity is None else velocity)
        stretch = self.controller(now, state, reference)
        if stretch is not None:
            line = line.take(stretch, now, anew=self.controller.lost)
        self._line = line
        return line

    def chunk(self, now: float, q: FloatArray, look: Look | None) -> FloatArray:
        """Actions (steps, k) that follow ``now`` [s], ``1 / rate`` apart; see :meth:`lead`."""
        line = self.lead(now, q, look)
        reference = line.at(now).q
        ahead = (line.at(now + k / self.given.rate) for k in range(1, self.steps + 1))
        return np.array([self._command(state, q, reference) for state in ahead])

    def _command(self, state: State, q: FloatArray, reference: FloatArray) -> FloatArray:
        """An action that leads to a state, of an arm at ``q`` (n,) in place of ``reference``."""
        robot = self.controller.robot
        if self.given.commands == "positions":
            return state.q
        if self.given.commands == "velocities":
            return np.asarray(state.velocity - GAIN * (q - reference))
        off = robot.tool_pose(q)[0] - robot.tool_pose(reference)[0]
        return np.asarray(robot.tool_jacobian(state.q)[0] @ state.velocity - GAIN * off)


def numbers_of(look: Look | None, now: float) -> tuple[FloatArray, FloatArray]:
    """``camera`` (16,) and ``fruits`` (FRUITS, 6) of a look at a time ``now`` [s].

    A look of more than FRUITS detections keeps the first.
    """
    camera, rows = np.zeros(16), np.zeros((FRUITS, 6))
    if look is not None:
        pose = look.camera
        far = look.far if look.far < np.inf else 0.0
        told = look.view, now - look.time, look.near, far
        camera = np.concatenate([pose.position, pose.rotation.ravel(), told])
        for row, item in zip(rows, look.in_base(), strict=False):
            deviation = np.sqrt(np.trace(np.asarray(item.covariance)) / 3.0)
            row[:] = *item.position, deviation, item.radius, 1 + ROLES.index(item.role)
    return camera, rows


def look_in(camera: FloatArray, fruits: FloatArray, scene: Scene, now: float) -> Look | None:
    """The look of two arrays at a time ``now`` [s]; None: none has come.

    A detection has the shape of the nearest fruit of the scene of its role, within KNOWN, else that
    of a ball.
    """
    if camera[12] <= 0.0:
        return None
    turn, _ = polar(camera[3:12].reshape(3, 3))  # the nearest rotation, of single precision
    pose, items = Pose(camera[:3], turn), list[SceneObject]()
    for k, row in enumerate(fruits.reshape(-1, 6)):
        if not 1 <= row[5] <= len(ROLES):
            continue
        role: Any = ROLES[int(row[5]) - 1]
        known = [o for o in scene.objects if o.role == role]
        known.sort(key=lambda o: float(np.linalg.norm(o.position - row[:3])))
        like = bool(known) and np.linalg.norm(known[0].position - row[:3]) < KNOWN
        made = known[0] if like else SceneObject(f"seen{k}", role, Sphere(row[4]), row[:3])
        spread = row[3] ** 2 * np.eye(3)
        item = replace(made, id=f"seen{k}", position=row[:3], covariance=spread, stem=None)
        items.append(item.transformed(pose.inverse()))
    view, age, near, far = camera[12:].tolist()
    return Look(now - age, pose, tuple(items), view, near, far or np.inf)
