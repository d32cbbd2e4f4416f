"""Hooks of imports: former paths of modules, and the environments for Gymnasium.

The paths that modules had before the rings are kept for one release, with a warning. Gymnasium asks
no entry points, and to import it takes several times as long as to import this package. So the
environments are registered as soon as somebody else loads its registry.
"""

import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

_CORE = (
    "arrays", "budget", "compiled", "documents", "errors", "execution", "files", "geometry",
    "judging", "optimization", "output", "parameters", "planning", "processes", "promp", "pushing",
    "robots", "scenes", "shown", "tables", "trajectory", "trajectory_files",
)  # fmt: skip
_STEMS = (
    "bending", "contacts", "cup", "deflected", "equilibrium", "hanging", "harm", "parting",
    "swinging", "trusses",
)  # fmt: skip
_PACKS = "flat", "quasi_static", "standing", "trials"
_READERS = "fit", "mjcf", "packages", "surfaces", "urdf"
MOVED = {
    **{f"optipromp.pushing.{name}": f"optipromp.core.pushing.stems.{name}" for name in _STEMS},
    **{f"optipromp.pushing.{name}": f"optipromp.core.pushing.packs.{name}" for name in _PACKS},
    **{f"optipromp.robots.{name}": f"optipromp.readers.{name}" for name in _READERS},
    "optipromp.planning.paper": "optipromp.laboratory.planners.paper",
    "optipromp.scenes.generate": "optipromp.laboratory.generate",
    "optipromp.simulation": "optipromp.laboratory.simulation",
    "optipromp.experiments": "optipromp.laboratory.experiments",
    "optipromp.page": "optipromp.looks.page",
    "optipromp.viewer": "optipromp.looks.viewer",
    "optipromp.reports": "optipromp.looks.reports",
    **{f"optipromp.{room}": f"optipromp.core.{room}" for room in _CORE},
}
"""The present path of each room by its former path."""
REGISTRY = "gymnasium.envs.registration"


class _Alias(Loader):
    """Gives the module that stands at its present path."""

    def __init__(self, present: str) -> None:
        self.present = present

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        module = import_module(self.present)
        words = f"{spec.name} is {self.present} now; the former path goes with the next release"
        warnings.warn(words, DeprecationWarning, stacklevel=2)
        self.own = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self.own  # the import has just put the former path's in its place


class _Finder(MetaPathFinder):
    """Finds modules by their former paths, and the registry of Gymnasium."""

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name == REGISTRY:
            return _registering(PathFinder.find_spec(name, path))
        if not name.startswith("optipromp."):
            return None
        former = next((room for room in MOVED if name == room or name.startswith(f"{room}.")), None)
        if former is None:
            return None
        present = MOVED[former] + name.removeprefix(former)
        return ModuleSpec(name, _Alias(present), is_package=name in MOVED)


def _registering(spec: ModuleSpec | None) -> ModuleSpec | None:
    if spec is not None and spec.loader is not None:
        execute = spec.loader.exec_module
        spec.loader.exec_module = lambda module: (execute(module), _register(module))  # type: ignore
    return spec


def _register(registry: Any) -> None:
    for name, kind in (("Pick-v0", "PickEnv"), ("PickProMP-v0", "PickProMPEnv")):
        registry.register(f"optipromp/{name}", entry_point=f"optipromp.bench.env:{kind}")


def hook_imports() -> None:
    """Let Python find modules by their former paths, and Gymnasium the environments."""
    if not any(type(finder).__name__ == _Finder.__name__ for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())  # before a room's own folder is searched
        if REGISTRY in sys.modules:
            _register(sys.modules[REGISTRY])
