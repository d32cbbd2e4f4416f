"""A public benchmark of reaching in hanging clutter, and the door of learners to the simulation.

Once this package is imported, Gymnasium knows ``optipromp/Pick-v0`` and ``optipromp/PickProMP-v0``.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

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
    for name, kind, steps in (("Pick-v0", "PickEnv", 1000), ("PickProMP-v0", "PickProMPEnv", 1)):
        registry.register(
            f"optipromp/{name}", entry_point=f"optipromp_bench.env:{kind}", max_episode_steps=steps
        )


if _REGISTRY in sys.modules:
    _register(sys.modules[_REGISTRY])
elif not any(type(finder).__name__ == _Environments.__name__ for finder in sys.meta_path):
    sys.meta_path.insert(0, _Environments())
