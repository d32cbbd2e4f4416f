"""A scene and the legs of a plan as a bag of ROS 2."""

from collections.abc import Sequence
from pathlib import Path

from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp_ros.scenes import planning_scene
from optipromp_ros.trajectories import display_trajectory, joint_trajectory
from optipromp_ros.types import Recorded, write_bag


def write_plan(
    path: Path,
    scene: Scene,
    robot: str,
    curves: Sequence[tuple[str, Trajectory]],
    rate: float,
    prefix: str,
) -> None:
    """Write the planning scene, and of a plan the trajectory of each leg.

    Args:
        path: of the bag.
        scene: any.
        robot: its name.
        curves: the name and the trajectory of each leg.
        rate: of the points of a JointTrajectory [Hz].
        prefix: before the joints' names.
    """
    items = [Recorded("/planning_scene", planning_scene(scene, prefix))]
    for name, curve in curves:
        topic = "/joint_trajectory" + ("" if name == "reach" else f"/{name}")
        items.append(Recorded(topic, joint_trajectory(curve, rate, prefix)))
    if curves:
        shown = display_trajectory([curve for _, curve in curves], robot, prefix=prefix)
        items.append(Recorded("/display_planned_path", shown))
    write_bag(path, items)
