"""The push model of a task, and the motion of the tool as a model takes it."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from optipromp.arrays import FloatArray, lengths
from optipromp.planning.task import Task
from optipromp.pushing import hanging, standing
from optipromp.pushing.cup import flange_of
from optipromp.pushing.hanging import Hanging
from optipromp.pushing.model import Combined, PushModel
from optipromp.pushing.path import STEP, along, evenly, length
from optipromp.pushing.standing import Standing
from optipromp.robots.model import Robot
from optipromp.scenes.scene import PoseGoal, Scene

AMONG = 0.3  # [m] behind the target within which the arm may meet objects that stand


def push_model(task: Task, goal: FloatArray) -> PushModel | None:
    """The push model of a task; None where no model applies or nothing is to be pushed.

    ``goal`` (n,) is a configuration of the arm at the target.
    """
    scene, tool = task.scene, task.robot.tool
    if tool is None or not isinstance(task.goal, PoseGoal):
        return None
    models: list[PushModel] = []
    if standing.applies(scene, tool):
        models.append(Standing(scene, tool, wrist(task, goal)))
    if hanging.applies(scene, tool, task.neighbours):
        radius, flange = task.robot.gripper_radius, flange_of(task.robot)
        models.append(Hanging(scene, tool, task.neighbours, task.camera, radius, flange))
    return models[0] if len(models) == 1 else Combined(*models) if models else None


def tool_motion(robot: Robot, q: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Tool points (P, 3), about :data:`STEP` apart, and axes (P, 3) along configurations (T, n)."""
    points, axes = robot.tool_pose(q)
    count = max(2, int(np.ceil(length(points) / STEP)) + 1)
    axes = along(points, axes, count)
    return evenly(points, count), axes / lengths(axes)[:, None]


def pushed_aside(task: Task) -> Task:
    """The task without the objects that stand: the tool pushes them aside before the arm comes."""
    if not isinstance(task.goal, PoseGoal) or not standing.applies(task.scene, task.robot.tool):
        return task
    scene = emptied(task.scene)
    return replace(task, scene=scene, standing=scene)


@lru_cache(maxsize=4)
def emptied(scene: Scene) -> Scene:
    """The scene without the pushables that stand."""
    kept = (item for item in scene.objects if item.role != "pushable" or item.stem is not None)
    return replace(scene, objects=tuple(kept))


def wrist(task: Task, goal: FloatArray) -> list[FloatArray]:
    """The links among the objects while the tool is at the target: one box (4, 2) per link.

    The boxes are in the coordinates of the tool's outline, for a goal configuration (n,).
    """
    robot, scene = task.robot, task.scene
    assert isinstance(task.goal, PoseGoal)
    local = (robot.sphere_centers(goal) - task.goal.position) @ scene.frame.T
    radius, link = np.asarray(robot.spheres.radius), np.asarray(robot.spheres.link)
    packs = [(obj.position - task.goal.position) @ scene.frame[0] for obj in scene.pushables]
    tall = max(obj.radius for obj in scene.pushables)
    level_with = (local[:, 0] + radius > min(packs) - tall) & (
        local[:, 0] - radius < max(packs) + tall
    )
    near = level_with & (local[:, 2] + radius > -AMONG) & (link != len(robot.link_names) - 1)
    out = []
    for one in np.unique(link[near]):
        mine = near & (link == one)
        flat = local[mine][:, [2, 1]]
        (u0, v0), (u1, v1) = (
            (flat - radius[mine, None]).min(axis=0), (flat + radius[mine, None]).max(axis=0)
        )  # fmt: skip
        out.append(np.array([[u0, v0], [u1, v0], [u1, v1], [u0, v1]]))
    return out
