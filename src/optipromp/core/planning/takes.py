"""What is planned of a scene: the whole pick where a tool takes its target, else a reach alone."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from optipromp.core.planning.leg_tasks import REACH
from optipromp.core.planning.legs import Picked, plan_pick
from optipromp.core.planning.plan import plan
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import robot_of
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory, chained


def takes(scene: Scene, robot: Robot) -> bool:
    """Whether the robot's tool takes the target of a scene in which nothing moves."""
    tool = robot.tool
    return tool is not None and tool.mouth[0] > 0.0 and not (scene.target is None or scene.movers)


def plan_whole(scene: Scene | str | Path, **request: Any) -> Picked | Plan:
    """The pick where the tool takes the target or the scene has a place; else the reach alone, and
    where it fails."""
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if scene.place is None and not takes(scene, robot_of(scene)):
        return plan(scene, **request)
    picked = plan_pick(scene, **request)
    return picked if picked.reach.success else picked.reach


def legs_of(made: Plan | Picked) -> Mapping[str, Plan]:
    """The legs of a pick by name; of a plan, it alone as ``reach``."""
    return made.legs if isinstance(made, Picked) else {REACH: made}


def curve_of(made: Plan | Picked) -> Trajectory:
    """The motion of all legs."""
    return chained([leg.trajectory for leg in legs_of(made).values()])
