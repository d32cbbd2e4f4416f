"""The plant of a guard: what may be pushed, with its models, and what must not be touched."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.geometry import Sphere
from optipromp.core.judging.clearance import pieces
from optipromp.core.optimization.problem import Surroundings
from optipromp.core.planning.task import Task, stands
from optipromp.core.pushing.model import Combined, PushModel
from optipromp.core.pushing.stems.hanging import Hanging, after
from optipromp.core.scenes.objects import SceneObject, rooted
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control.plant import target_row, told_of, tracked_scene
from optipromp_loop.control.tracker import Tracked
from optipromp_loop.guard.motion import ROUNDING

ROOT = 0.005  # [m] about the root of a stem: 2 N bend 5 mm of 150 MPa by 0.3 mm; a choice


DEEPER = 1e-5  # [m] by which a contact that was there may deepen: of the judge's checks


class Room(NamedTuple):
    """How near the arm may come to what it must not touch."""

    touched: Mapping[str, float]  # depth of contacts that there are, by object [m]
    clear: Mapping[str, float]  # least clearances, by their names [m]


def least(value: float, before: float | None) -> float:
    """The distance that an arm must keep which is at ``value`` [m], and had to keep ``before``.

    Less than the value, so that it may stay. What the arm had to keep does not shrink because the
    arm came near: only where objects did.
    """
    if before is None or abs(value - before) > DEEPER:
        return value - DEEPER
    return min(before, value - ROUNDING)


class Course(NamedTuple):
    """Fruits on stems where the motion so far has led them: the model of a push that goes on.

    ``going``: in the states of a prediction. ``seen``: in the perceived state.
    """

    going: Hanging
    seen: Hanging

    def on(self, poses: FloatArray, states: int) -> "Course":
        """After the tool went on through poses (P, 6)."""
        points, axes = np.split(poses, 2, axis=1)
        return Course(after(self.going, points, axes, states), after(self.seen, points, axes, 1))


@dataclass(frozen=True, eq=False)
class Plant:
    """A scene with models of the fruits that may be pushed.

    Attributes:
        task: of the robot in the scene.
        hanging: models of fruits on stems.
        standing: models of fruits that stand.
        known: ids of the fruits of both.
        added: whether the scene changed since the models were made.
    """

    task: Task
    hanging: tuple[Hanging, ...]
    standing: tuple[PushModel, ...]
    known: frozenset[str]
    added: bool = False

    @classmethod
    def of(cls, task: Task, risk: float) -> "Plant":
        """With models whose harm is at most ``risk``."""
        model = replace(task, risk=risk).push_model(task.start)
        models = () if model is None else model.models if isinstance(model, Combined) else (model,)
        hanging = tuple(one for one in models if isinstance(one, Hanging))
        known = {fruit.id for one in hanging for fruit in one.fruits}
        if stands(task) and len(hanging) < len(models):
            known |= {item.id for item in task.scene.objects if item.stem is None}
        standing = tuple(one for one in models if not isinstance(one, Hanging))
        return cls(task, hanging, standing, frozenset(known))

    @property
    def models(self) -> tuple[PushModel, ...]:
        """All of them."""
        return (*self.standing, *self.hanging)

    @cached_property
    def fresh(self) -> tuple[Course, ...]:
        """The courses of pushes that begin."""
        return tuple(Course(one.leaving(0), one) for one in self.hanging)

    @cached_property
    def judged(self) -> Scene:
        """The scene in which what no model knows stands: it must not be touched."""
        objects = []
        for item in self.task.scene.objects:
            known = item.id in self.known
            stem, parts, of = item.stem, list[SceneObject](), "/root" if known else ""
            if item.role in ("static", "avoid") or known:
                objects.append(item)
                if known and stem is not None and stem.parent is None and not stem.unseen:
                    parts = [replace(item, shape=Sphere(ROOT), position=stem.points[-1], stem=None)]
            else:
                stems = () if stem is None else stem.likely()
                parts = [replace(item, stem=None), *(one for s in stems for one in pieces(item, s))]
            objects += [
                replace(part, id=item.id + of + (f"/{k}" if k else ""), role="static", motion=None)
                for k, part in enumerate(parts)
            ]
        return replace(self.task.scene, objects=tuple(objects))

    @cached_property
    def around(self) -> Surroundings:
        """The obstacles of :attr:`judged`."""
        return replace(self.task, scene=self.judged).surroundings

    @cached_property
    def pushed(self) -> frozenset[str]:
        """The fruits whose place the models tell while the tool pushes; the target is one."""
        target = (o.id for o in self.task.scene.objects if o.role == "target")
        return self.known.union(target)

    def during_push(self, scene: Scene) -> "Plant":
        """With all of a ``scene`` but the fruits that are pushed: these are where the models lead.

        A target beside these is one more fruit that no model knows.
        """
        own = {o.id: o for o in self.task.scene.objects if o.id in self.pushed}
        new = [item for item in scene.objects if item.id not in own]
        if self.task.scene.target is not None:
            new = [replace(o, role="pushable") if o.role == "target" else o for o in new]
        scene = replace(scene, objects=rooted([*own.values(), *new]))
        return replace(self, task=replace(self.task, scene=scene), added=True)


def stays(item: SceneObject, before: SceneObject | None, changed: float) -> bool:
    """Whether an object is what it was, and moved by less than ``changed`` [m]."""
    if before is None or item.role != before.role:
        return False
    return math.dist(item.position, before.position) < changed


def unchanged(
    base: Scene, before: Scene, seen: Tracked, changed: float, own: frozenset[str]
) -> bool:
    """Whether :func:`seen_scene` surely has the objects of ``before``, each moved by less than
    ``changed`` [m]; ``own`` are left out. Told without the objects being made."""
    if target_row(seen) is None:
        return False
    rows = np.flatnonzero(seen.confirmed).tolist()
    places = {
        seen.ids[row]: (seen.roles[row], seen.rest[row] if by is None or one is None else
                        one.position + by)
        for row, (one, by) in zip(rows, told_of(base, seen), strict=True)
    }  # fmt: skip
    still = (item for item in base.objects if item.role in ("static", "avoid"))
    places |= {item.id: (item.role, item.position) for item in still}
    was = {item.id: item for item in before.objects if item.id not in own}
    return was.keys() == places.keys() - own and all(
        places[name][0] == item.role and math.dist(places[name][1], item.position) < changed
        for name, item in was.items()
    )


def seen_scene(base: Scene, before: Scene, seen: Tracked, changed: float) -> Scene:
    """What stands in ``base``, and the tracked fruits.

    A target that the looks show no more, because it is hidden or picked, stays as it was
    ``before``; so do then fruits that moved by less than ``changed`` [m].
    """
    if target_row(seen) is not None:
        return tracked_scene(base, seen)
    still = [item for item in base.objects if item.role in ("static", "avoid")]
    was = {item.id: item for item in before.objects}
    fruits = {o.id: was[o.id] if stays(o, was.get(o.id), changed) else o for o in seen.objects()}
    if (target := before.target) is not None:
        fruits[target.id] = replace(fruits.get(target.id, target), role="target")
    return replace(before, objects=rooted([*still, *fruits.values()]))
