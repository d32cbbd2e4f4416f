"""``plan_sequence``: several ripe fruits, picked one after the other."""

import pickle
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from optipromp.core.errors import Code, InvalidRequestError, NoPlanError, OptiPrompError, suggest
from optipromp.core.planning.leg_tasks import aimed
from optipromp.core.planning.legs import Picked, legs_of, plan_whole
from optipromp.core.planning.options import PlanOptions, stated
from optipromp.core.planning.plan import check_request, plan
from optipromp.core.planning.planners import Planner
from optipromp.core.planning.result import REACH, Plan
from optipromp.core.planning.task import Task
from optipromp.core.planning.warming import compile_once
from optipromp.core.processes import cores, run_each
from optipromp.core.promp.model import ProMP
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene

HARMLESS = 0.05  # [1] harm below which plans are equally good: 1 % of them fail (docs/studies.md)


@dataclass(frozen=True)
class Left:
    """A fruit that is not picked: its ``id``, and status and message of its last plan ``made``."""

    id: str
    status: Code
    message: str
    made: Plan | Picked = field(repr=False, compare=False)


@dataclass(frozen=True, eq=False)
class PickSequence:
    """An order of picks, and the plan of each.

    Attributes:
        scene: with all fruits.
        targets: ids of the ripe fruits, in the order of the request.
        picks: plan of each pick, in order; the scene of a plan has the fruits that still hang.
        left: the ripe fruits that cannot be picked.
        placed: the picks with all legs, in order, where the tool takes the targets in; the plans
            of ``picks`` are their reaches. Empty otherwise.
    """

    scene: Scene
    targets: tuple[str, ...]
    picks: tuple[Plan, ...]
    left: tuple[Left, ...]
    placed: tuple[Picked, ...] = ()

    @property
    def order(self) -> tuple[str, ...]:
        """Ids of the fruits in the order of the picks."""
        return tuple(_target(pick) for pick in self.picks)

    @property
    def whole(self) -> Sequence[Plan | Picked]:
        """The picks with all their legs, where they have some; else their plans."""
        return self.placed or self.picks

    @property
    def success(self) -> bool:
        """Whether every ripe fruit is picked."""
        return not self.left

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trajectories, as plain values for JSON."""
        return {
            "scene": self.scene.name,
            "targets": list(self.targets),
            "success": self.success,
            "order": list(self.order),
            "picks": [
                {"target": id_, **made.to_dict()}
                for id_, made in zip(self.order, self.whole, strict=True)
            ],
            "left": [
                {"id": left.id, "status": left.status, "message": left.message}
                for left in self.left
            ],
        }


def plan_sequence(
    scene: Scene | str | Path,
    targets: Sequence[str],
    *,
    progress: Callable[[str], None] | None = None,
    **request: Any,
) -> PickSequence:
    """Choose the order in which several ripe fruits are picked, and plan each pick.

    In each round every ripe fruit that still hangs is planned for, with the others as pushables. Of
    the successful plans, the plan of least predicted harm is chosen; harms below :data:`HARMLESS`
    are equal, and the shortest motion decides. The picked fruit and its stem leave the scene. A
    picked fruit is in no other's way, so that no order picks more fruits than this one, as far as
    the planner knows.

    Where the tool takes the targets in, each pick has the legs of
    :func:`optipromp.core.planning.legs.plan_pick`; a fruit whose way out or carry fails gives way
    to the next best. Every pick starts at the scene's start: the arm lays a fruit down and comes
    back. In a scene with a ``place`` it starts where the pick before it ended, at the place. Pushed
    fruits are assumed to hang at rest again before the next pick.
    Stems that grow from the stem of a picked fruit are held at their roots from then on.

    Args:
        scene: a scene, the name of a built-in scene, or the path of a scene file.
        targets: ids of the ripe fruits: targets or pushables of the scene, in any order. The
            scene's own target is a pushable where it is not among them.
        progress: called with a short text as each plan begins.
        request: further arguments of :func:`optipromp.core.planning.plan.plan`.

    Raises:
        InvalidRequestError: no target, a target twice, or a target that is no fruit of the scene.
        OptiPrompError: an error of :func:`optipromp.core.planning.plan.plan`.
    """
    if not isinstance(scene, Scene):
        scene = load_scene(scene)
    _check(scene, targets)
    begun = scene
    picks, placed = list[Plan](), list[Picked]()
    while True:
        picked = [item.id for pick in picks for item in pick.scene.taken]
        if placed and scene.place is not None:
            scene = replace(scene, start=placed[-1].end)
        tried = {}
        for id_ in targets:
            if id_ not in picked:
                (progress or str)(f"pick {len(picks) + 1}: {id_}")
                tried[id_] = plan_whole(aimed(scene, id_, picked), **request)
        best = min(tried.values(), key=_costs, default=None)
        if best is None or not best.success:
            left = tuple(Left(id_, made.status, made.message, made) for id_, made in tried.items())
            return PickSequence(begun, tuple(targets), tuple(picks), left, tuple(placed))
        if isinstance(best, Picked):
            placed.append(best)
        picks.append(legs_of(best)[REACH])


def _costs(made: Plan | Picked) -> tuple[bool, float, float]:
    """Sort key of picks: success, harm, duration; small harms are equal."""
    legs = [*legs_of(made).values()]
    harm = max(leg.harm for leg in (legs if made.success else legs[:1]))
    return not made.success, max(harm, HARMLESS), sum(leg.duration for leg in legs)


def _check(scene: Scene, targets: Sequence[str]) -> None:
    if not targets or len(set(targets)) < len(targets):
        raise InvalidRequestError(f"targets are {list(targets)}; name each once, and at least one")
    fruits = [item.id for item in scene.objects if item.role in ("target", "pushable")]
    for id_ in targets:
        if id_ not in fruits:
            raise InvalidRequestError(
                f"target {id_!r} is no target or pushable of {scene.name}: {suggest(id_, fruits)}"
            )


def _target(made: Plan) -> str:
    assert made.scene.target is not None
    return made.scene.target.id


Result = Plan | Picked | OptiPrompError


@dataclass(frozen=True)
class _Job:
    """What :func:`plan_many` does with each scene."""

    request: Mapping[str, Any]
    legs: bool

    def result(self, scene: Scene | str | Path) -> Result:
        try:
            scene = scene if isinstance(scene, Scene) else load_scene(scene)
            whole = self.legs and scene.target is not None
            return (plan_whole if whole else plan)(scene, **self.request)
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
        planner: as for :func:`plan`, as are ``demonstrations``, ``seed`` and ``settings``.
        workers: processes that plan; None: one per core; 1: this process plans.
        legs: scenes with a target that the tool takes in, or with a ``place``, are planned with
            all legs, as :func:`optipromp.core.planning.legs.plan_pick` does.
        progress: called in this thread as each plan is done, with the index of its scene and the
            result.

    Returns:
        A result for each scene, in the order of ``scenes``: the plan (also a plan that failed; with
        ``legs`` the pick, of a scene with a place), or the error that :func:`plan` raises;
        ``NoPlanError`` where the process ended.

    Raises:
        InvalidRequestError: fewer than one worker; an unknown planner; options or
            demonstrations that cannot be sent to another process; processes cannot start.
    """
    if workers is not None and workers < 1:
        raise InvalidRequestError(f"workers is {workers}; it must be at least 1")
    options = stated(options, settings, plan_many)
    check_request(planner, options)
    asked = {
        "planner": planner, "demonstrations": demonstrations, "seed": seed, "options": options,
    }  # fmt: skip
    request = _Job(asked, legs)
    count = min(workers or cores(), len(scenes))
    if count > 1:
        compile_once()  # not in each process
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
