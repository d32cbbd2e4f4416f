"""``plan_many``: plans of many scenes, on all cores."""

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from optipromp.core.errors import InvalidRequestError, NoPlanError, OptiPrompError
from optipromp.core.planning.legs import Picked, after
from optipromp.core.planning.options import PlanOptions, Strategy, stated
from optipromp.core.planning.plan import check_request, plan
from optipromp.core.planning.planner import Planner
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import Task
from optipromp.core.processes import cores, run_each
from optipromp.core.promp.model import ProMP
from optipromp.core.scenes.scene import Scene

Result = Plan | Picked | OptiPrompError


@dataclass(frozen=True, eq=False)
class _Request:
    """The arguments of :func:`plan` that all plans have in common."""

    planner: Planner | str
    strategy: Strategy
    demonstrations: ProMP | str | Path | None
    seed: int
    options: PlanOptions | None
    legs: bool = False

    def result(self, scene: Scene | str | Path) -> Result:
        asked = {name: value for name, value in vars(self).items() if name != "legs"}
        try:
            made = plan(scene, **asked)
            placed = self.legs and made.scene.place is not None and made.scene.target is not None
            return after(made, **asked) if placed else made
        except OptiPrompError as error:
            return error.with_traceback(None)

    def bare(self, scene: Scene | str | Path) -> Result:
        """The result without its scene, which the caller has: less to send between processes."""
        result = self.result(scene)
        if isinstance(result, Plan) and result.scene is scene:
            task: Task = replace(result.task, scene=None, demonstrations=None)  # type: ignore[arg-type]
            return replace(result, task=task)
        return result


def plan_many(
    scenes: Sequence[Scene | str | Path],
    options: PlanOptions | None = None,
    *,
    planner: Planner | str = "opti-promp",
    strategy: Strategy = "joint",
    demonstrations: ProMP | str | Path | None = None,
    seed: int = 0,
    workers: int | None = None,
    legs: bool = False,
    progress: Callable[[int, Result], None] | None = None,
    **settings: Any,
) -> list[Result]:
    """Plan a reach in each of many scenes, on all cores.

    Every plan equals the plan that :func:`plan` makes of its scene alone. Several processes make
    the plans, so a script must call this function under ``if __name__ == "__main__":``, and the
    classes of its own costs (``options.costs``) must be importable.

    Args:
        scenes: scenes, names of built-in scenes, or scene files.
        options: of every plan; see :class:`PlanOptions`.
        planner: as for :func:`plan`.
        strategy: as for :func:`plan`.
        demonstrations: as for :func:`plan`.
        seed: as for :func:`plan`.
        workers: processes that plan; None: one per core; 1: this process plans.
        legs: scenes with a target and a ``place`` are planned with all legs, as
            :func:`optipromp.core.planning.legs.plan_pick` does.
        progress: called in this thread as each plan is done, with the index of its scene and the
            result.
        settings: as for :func:`plan`.

    Returns:
        A result for each scene, in the order of ``scenes``: the plan (also a plan that failed; with
        ``legs`` the pick, of a scene with a place), or the error that :func:`plan` raises;
        ``NoPlanError`` where the process ended.

    Raises:
        InvalidRequestError: fewer than one worker; an unknown planner or strategy; options or
            demonstrations that cannot be sent to another process; processes cannot start.
    """
    if workers is not None and workers < 1:
        raise InvalidRequestError(f"workers is {workers}; it must be at least 1")
    options = stated(options, settings, plan_many)
    check_request(planner, strategy, options)
    request = _Request(planner, strategy, demonstrations, seed, options, legs)
    count = min(workers or cores(), len(scenes))
    if count > 1:
        try:
            pickle.dumps(request)
        except (pickle.PicklingError, AttributeError, TypeError) as error:
            raise InvalidRequestError(
                f"options or demonstrations cannot be sent to other processes ({error}); "
                "workers=1 needs none"
            ) from error
    results: dict[int, Result] = {}

    def done(index: int, result: Result | BrokenProcessPool) -> None:
        scene = scenes[index]
        if isinstance(scene, Scene) and getattr(result, "scene", scene) is None:
            assert isinstance(result, Plan)
            result = replace(
                result, task=replace(result.task, scene=scene, demonstrations=demonstrations)
            )
        elif isinstance(result, BrokenProcessPool):
            result = NoPlanError(str(result))
        results[index] = result
        if progress is not None:
            progress(index, result)

    function = request.bare if count > 1 else request.result
    run_each(function, [(scene,) for scene in scenes], done, workers=count)
    return [results[index] for index in range(len(scenes))]
