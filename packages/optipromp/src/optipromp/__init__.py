"""Reach a ripe fruit past its unripe neighbours.

>>> from optipromp import load_scene, plan
>>> result = plan(load_scene("scenario-3"))
>>> result.success, result.metrics.goal_error, result.trajectory.positions.shape

The verbs are :func:`plan`, :func:`plan_many`, :func:`plan_sequence`, :func:`judge` and
:func:`simulate` (of the package optipromp-sim). Shapes, robots, primitives, pushing and costs are
in the sub-packages ``geometry``, ``scenes``, ``robots``, ``promp``, ``pushing`` and
``optimization.costs``. Each name below is loaded when it is first used, so that importing the
package is fast.
"""

import sys
from typing import TYPE_CHECKING, Any

from optipromp.lazy import lazy
from optipromp.moved import Moved

if TYPE_CHECKING:
    from optipromp.core.errors import Code as Code
    from optipromp.core.errors import OptiPrompError as OptiPrompError
    from optipromp.core.judging import Metrics as Metrics
    from optipromp.core.output import load_pick as load_pick
    from optipromp.core.output import load_plan as load_plan
    from optipromp.core.output import write_pick as write_pick
    from optipromp.core.output import write_plan as write_plan
    from optipromp.core.planning import IProMP as IProMP
    from optipromp.core.planning import OptiProMP as OptiProMP
    from optipromp.core.planning import Plan as Plan
    from optipromp.core.planning import PlanOptions as PlanOptions
    from optipromp.core.planning import Verdict as Verdict
    from optipromp.core.planning import judge as judge
    from optipromp.core.planning.legs import Picked as Picked
    from optipromp.core.planning.legs import plan_pick as plan_pick
    from optipromp.core.planning.plan import plan as plan
    from optipromp.core.planning.sequence import PickSequence as PickSequence
    from optipromp.core.planning.sequence import plan_many as plan_many
    from optipromp.core.planning.sequence import plan_sequence as plan_sequence
    from optipromp.core.planning.task import robot_of as robot_of
    from optipromp.core.promp import Basis as Basis
    from optipromp.core.promp import JointPoint as JointPoint
    from optipromp.core.promp import ProMP as ProMP
    from optipromp.core.promp import TaskPoint as TaskPoint
    from optipromp.core.promp import condition as condition
    from optipromp.core.promp import fit as fit
    from optipromp.core.promp import fit_em as fit_em
    from optipromp.core.promp import load_demonstrations as load_demonstrations
    from optipromp.core.robots.library import load_robot as load_robot
    from optipromp.core.robots.model import Robot as Robot
    from optipromp.core.robots.tools import Cup as Cup
    from optipromp.core.robots.tools import FrankaHand as FrankaHand
    from optipromp.core.robots.tools import with_tool as with_tool
    from optipromp.core.scenes.io import load_scene as load_scene
    from optipromp.core.scenes.io import save_scene as save_scene
    from optipromp.core.scenes.scene import Scene as Scene
    from optipromp.core.scenes.scene import SceneObject as SceneObject
    from optipromp.core.trajectory import State as State
    from optipromp.core.trajectory import Trajectory as Trajectory

_HOMES = {
    "core.errors": "Code OptiPrompError",
    "core.judging": "Metrics",
    "core.output": "load_pick load_plan write_pick write_plan",
    "core.planning": (
        "IProMP OptiProMP PickSequence Picked Plan PlanOptions Verdict judge "
        "plan plan_many plan_pick plan_sequence"
    ),
    "core.planning.task": "robot_of",
    "core.promp": "Basis JointPoint ProMP TaskPoint condition fit fit_em load_demonstrations",
    "core.robots.library": "load_robot",
    "core.robots.model": "Robot",
    "core.robots.tools": "Cup FrankaHand with_tool",
    "core.scenes.io": "load_scene save_scene",
    "core.scenes.scene": "Scene SceneObject",
    "core.trajectory": "State Trajectory",
}
_load, _names = lazy(__name__, _HOMES)
sys.meta_path.append(Moved)
_PARTS = "simulate", "Paper", "PushCost"  # of other packages; see ``parts``

__all__ = ["__version__", *_names()]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("optipromp")
    if name == "PaperOptions":
        from optipromp.core.errors import unknown

        raise ImportError(f"optipromp.{name} is no more: {unknown('paper', ())}")
    if name not in _PARTS:
        return _load(name)
    from optipromp import parts

    found = parts.added(name)
    if found is None:
        raise ImportError(f"optipromp.{name} {parts.lacking(parts.GIVEN[name])}")
    return found


def __dir__() -> list[str]:
    return [*__all__, *_PARTS]
