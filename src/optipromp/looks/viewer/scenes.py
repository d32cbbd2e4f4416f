"""The pictures of a scene, with its arm at the start."""

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from optipromp.core.budget import Budget
from optipromp.core.planning.plan import plan
from optipromp.core.planning.result import Planned
from optipromp.core.planning.task import Task
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp.looks.viewer.figures import png
from optipromp.looks.viewer.reach import reach_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class _Standing:
    """The planner of an arm that stays at its start."""

    def solve(self, task: Task, budget: Budget) -> Planned:
        rest = np.zeros((2, task.robot.n_joints))
        still = Trajectory(
            np.array([0.0, 0.1]), task.start + rest, rest, rest, task.robot.joint_names
        )
        return Planned(still)


def scene_figure(scene: Scene) -> "Figure":
    """Three views of a scene: the whole arm at its start, and the cluster along x_g and y_g."""
    made = plan(scene, planner=_Standing())
    figure = reach_figure(made)
    words = f"{scene.name}: {made.robot.name} at its start"
    figure.suptitle(words.replace("$", r"\$"), fontsize=11)
    return figure


def scene_pictures(scene: Scene) -> dict[str, bytes]:
    """``scene.png``, and ``scene.html`` (3-D, without a network) where viser is installed."""
    out = {"scene.png": png(scene_figure(scene))}
    if find_spec("viser") is not None:
        from optipromp.looks.viewer.embed import scene_page

        out["scene.html"] = scene_page(scene).encode("utf-8")
    return out
