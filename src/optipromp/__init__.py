"""Reach a ripe fruit past its unripe neighbours.

>>> from optipromp import load_scene, plan
>>> result = plan(load_scene("scenario-3"))
>>> result.success, result.metrics.goal_error, result.trajectory.positions.shape

The verbs are :func:`plan`, :func:`plan_many`, :func:`plan_sequence`, :func:`judge` and
:func:`simulate` (which needs the extra ``sim``). Shapes, robots, primitives, pushing and costs are
in the sub-packages ``geometry``, ``scenes``, ``robots``, ``promp``, ``pushing`` and
``optimization.costs``. Each name below is loaded when it is first used, so that importing the
package is fast. Gymnasium knows ``optipromp/Pick-v0`` and ``optipromp/PickProMP-v0`` then.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import TYPE_CHECKING, Any

from optipromp.lazy import lazy

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
    from optipromp.laboratory.planners.paper import PaperOptions as PaperOptions
    from optipromp.laboratory.planners.paper import PushCost as PushCost
    from optipromp.laboratory.simulation import simulate as simulate

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
    "laboratory.planners.paper": "PaperOptions PushCost",
    "laboratory.simulation": "simulate",
    "core.trajectory": "State Trajectory",
}
_load, __dir__ = lazy(__name__, _HOMES)

__all__ = ["__version__", *__dir__()]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("optipromp")
    return _load(name)


_REGISTRY = "gymnasium.envs.registration"


class _Environments(MetaPathFinder):
    """Registers the environments as soon as Gymnasium's registry is loaded.

    Gymnasium reads no entry points, and its import takes several times as long as this package's.
    """

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        spec = PathFinder.find_spec(name, path) if name == _REGISTRY else None
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module
            spec.loader.exec_module = lambda module: (execute(module), _register(module))  # type: ignore
        return spec


def _register(registry: Any) -> None:
    for name, kind in (("Pick-v0", "PickEnv"), ("PickProMP-v0", "PickProMPEnv")):
        registry.register(f"optipromp/{name}", entry_point=f"optipromp.bench.env:{kind}")


if _REGISTRY in sys.modules:
    _register(sys.modules[_REGISTRY])
elif not any(type(finder).__name__ == _Environments.__name__ for finder in sys.meta_path):
    sys.meta_path.insert(0, _Environments())
