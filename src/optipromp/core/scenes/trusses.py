"""Trusses: stems that grow from other stems."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes.objects import STEM_SLACK, SceneObject
from optipromp.core.scenes.values import suggest


def nearest(points: FloatArray, point: FloatArray) -> tuple[int, FloatArray]:
    """Index of the piece of a stem (N, 3) that is nearest to ``point`` (3,), and the nearest point
    (3,) of it [m]."""
    start, pieces = points[:-1], np.diff(points, axis=0)
    share = ((point - start) * pieces).sum(axis=1) / (pieces**2).sum(axis=1)
    places = start + np.clip(share, 0.0, 1.0)[:, None] * pieces
    piece = int(np.argmin(((places - point) ** 2).sum(axis=1)))
    return piece, np.asarray(places[piece])


def parents_first(objects: Sequence[SceneObject]) -> list[SceneObject]:
    """The objects in their order, but each after its stem's parent."""
    by_id = {item.id: item for item in objects}
    out: dict[str, SceneObject] = {}
    for item in objects:
        line = [item]
        while (stem := line[-1].stem) is not None and stem.parent is not None:
            where = f"object {line[-1].id!r}: stem.parent {stem.parent!r}"
            if stem.parent not in by_id:
                raise InvalidSceneError(f"{where} is no object: {suggest(stem.parent, by_id)}")
            parent = by_id[stem.parent]
            if parent.stem is None:
                raise InvalidSceneError(f"{where} has no stem: must be an object that hangs")
            if parent in line:
                raise InvalidSceneError(f"{where} grows from it in turn: one root must be held")
            if parent.id in out:
                break
            line.append(parent)
        out |= {one.id: one for one in reversed(line)}
    return list(out.values())


def check_trusses(objects: Sequence[SceneObject]) -> None:
    """Refuse stems whose root is not on their parent's stem."""
    if all(item.stem is None or item.stem.parent is None for item in objects):
        return
    by_id = {item.id: item for item in parents_first(objects)}
    for item in objects:
        if item.stem is None or item.stem.parent is None:
            continue
        other = by_id[item.stem.parent].stem
        assert other is not None
        if by_id[item.stem.parent].motion is not None:
            raise InvalidSceneError(
                f"object {item.stem.parent!r} has a motion and carries the stem of {item.id!r}: "
                "fruits of a truss must stand"
            )
        off = float(np.linalg.norm(nearest(other.points, item.stem.root)[1] - item.stem.root))
        if off > STEM_SLACK:
            raise InvalidSceneError(
                f"object {item.id!r}: the root of its stem is {off:.3g} m from the stem of "
                f"{item.stem.parent!r}, its parent: must be on it, to {STEM_SLACK:g} m"
            )


def rooted(objects: Iterable[SceneObject]) -> tuple[SceneObject, ...]:
    """The objects with the root of each stem moved to the nearest point of its parent's stem.

    For objects that have moved one by one. A stem whose parent is missing gets a fixed root.
    """
    items = list(objects)
    here = {item.id: item for item in items}
    for item in items:
        stem = item.stem
        if stem is not None and stem.parent is not None and stem.parent not in here:
            here[item.id] = replace(item, stem=replace(stem, parent=None))
    for item in parents_first(list(here.values())):
        if item.stem is None or item.stem.parent is None:
            continue
        other = here[item.stem.parent].stem
        assert other is not None
        points = np.array(item.stem.points)
        _, points[-1] = nearest(other.points, points[-1])
        here[item.id] = replace(item, stem=replace(item.stem, points=points))
    return tuple(here[item.id] for item in items)
