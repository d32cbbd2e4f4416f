"""A scene or a plan as one web page to turn and play, without a server and without a network."""

import io
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.looks.appearance.scene import box_distance
from optipromp.looks.viewer.drawn import Moment, motions, placed
from optipromp.looks.viewer.nodes import Nodes
from optipromp.looks.viewer.serving import listening

if TYPE_CHECKING:
    from optipromp.core.planning import Plan

FRAME_RATE = 12.0  # [Hz] of the recorded motion
FRAMES = 240  # of a motion, at most
REST = 1.0  # [s] of rest before the motion repeats
VIEWS = (-0.6, 0.15), (0.6, 0.15), (-1.4, 0.2), (1.4, 0.2), (np.pi - 0.9, 0.4), (np.pi + 0.9, 0.4)
"""Places of the camera: turn from the direction away from the robot [rad], height over distance."""
SHARES = np.linspace(0.05, 0.95, 40)  # of the line to an object: points checked for others
UNMOVED = 1e-4  # [m] an object that moves by less is not sent again


def scene_page(scene: Scene, robot: Robot | None = None, q: FloatArray | None = None) -> str:
    """The HTML of a scene with its robot at ``q`` (n,), by default at its start."""
    robot, state = posed(scene, robot)
    with recording(scene, robot) as (nodes, record):
        nodes.pose(state.q if q is None else q)
        return str(record.as_html())


def plan_page(plan: "Plan") -> str:
    """The HTML of a plan: the moving arm, fruits as predicted, lines of the tool point."""
    curve = plan.trajectory
    places = {item.id: item.position for item in plan.scene.objects}
    with recording(plan.scene, plan.robot) as (nodes, record):
        for k, motion in enumerate(reversed(motions(plan))):
            points = plan.robot.tool_pose(motion.trajectory.resample(FRAME_RATE).positions)[0]
            nodes.line(motion.name, points, motion.colour, 3.0 if k else 6.0)
        count = min(max(round(FRAME_RATE * curve.duration), 1), FRAMES)
        for time in np.linspace(0.0, curve.duration, count + 1):
            nodes.pose(curve.sample(time)[0][0])
            now = int(np.searchsorted(curve.times, time + 1e-9)) - 1
            for item in placed(plan, Moment(max(now, 0), float(time), "")):
                if np.linalg.norm(item.position - places[item.item.id]) >= UNMOVED:
                    places[item.item.id] = item.position
                    nodes.put(item.item, item.position, item.rotation, item.stem)
            record.insert_sleep(curve.duration / count)
        record.insert_sleep(REST)
        return str(record.as_html())


@contextmanager
def recording(scene: Scene, robot: Robot) -> Iterator[tuple[Nodes, Any]]:
    """Nodes without a client, and a record of the messages that a client would get."""
    server = listening("127.0.0.1", 0)
    try:
        server.scene.set_up_direction("+z")
        nodes = Nodes(server.scene, "base", shadows=True)
        nodes.show(scene, robot)
        _look(server.initial_camera, scene, robot)
        yield nodes, server.get_scene_serializer()
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def _look(camera: Any, scene: Scene, robot: Robot) -> None:
    """Place the camera where the fewest fruits are hidden; of equals, beyond the row."""
    focus = robot.tool_pose(robot.home)[0]
    if len(scene.objects):
        focus = scene.positions.mean(axis=0)
    middle, up = 0.8 * focus, scene.up
    away = focus - (focus @ up) * up
    away /= max(float(np.linalg.norm(away)), 1e-9)
    reach = 1.05 * max(float(np.linalg.norm(focus)), 0.6)
    eyes = [
        middle + reach * (Rotation.from_rotvec(turn * up).apply(away) + lift * up)
        for turn, lift in VIEWS
    ]
    eye = min(eyes, key=lambda eye: _hidden(scene, eye))
    camera.look_at, camera.position = scene.base @ middle, scene.base @ eye


def _hidden(scene: Scene, eye: FloatArray) -> int:
    """Number of pairs of a static object and a target or pushable that it hides from an eye."""
    seen = [item.position for item in scene.objects if item.role in ("target", "pushable")]
    return sum(
        any(box_distance(item, eye + share * (point - eye)) == 0.0 for share in SHARES)
        for point in seen
        for item in scene.static
    )
