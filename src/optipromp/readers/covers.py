"""Covers: spheres that enclose the geometry of links, and reach little beyond it."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRobotError
from optipromp.core.processes import in_threads
from optipromp.core.robots.description import LinkShape, mesh_file, mesh_name, rotation_of
from optipromp.core.robots.tool_geometry import cover_box, cover_capsule, cover_cylinder
from optipromp.readers.chain import Placement
from optipromp.readers.fit import MOST_SAMPLES, count_samples, finer, fit_covers
from optipromp.readers.meshes import MOST_TRIANGLES, triangles
from optipromp.readers.surfaces import of_box, of_rod, parts
from optipromp.readers.urdf import UrdfModel

LOOSE = 0.030  # [m] chosen: excess above which the cover of a mesh gets further spheres
FIXED = 0.060  # [m] chosen: that excess for links that do not move, except the arm's base
PER_MESH = 7.5  # spheres, chosen: mean over the meshes of a robot, 60 for eight links
MOUNTED = 0.005  # [m] chosen: distance of the lowest fixed point from z = 0, at most, if mounted


class Cover(NamedTuple):
    """Spheres (k, 4), centres and radii [m], and their excess: the largest distance [m] by which
    they reach beyond the geometry.

    ``parts`` (c, 4): see :mod:`optipromp.readers.surfaces`; empty for spheres of a robot file.
    """

    spheres: FloatArray
    excess: float
    parts: FloatArray = np.zeros((0, 4))


class Covered(NamedTuple):
    """The key of a cover: kind and size of a shape, its mesh, and whether its link is fixed."""

    kind: str
    size: tuple[float, ...]
    mesh: Path | None
    fixed: bool


def cover_links(
    model: UrdfModel, links: Collection[str], fixed: Collection[str]
) -> dict[str, Cover]:
    """Covers of the links, in their frames, over their collision geometry or else their visual.

    Covers of ``fixed`` links are coarser.
    """
    shapes = {link: model.links[link].collisions or model.links[link].visuals for link in links}
    over = _cover_shapes(model, [(link, one) for link in links for one in shapes[link]], fixed)
    covers = {}
    for link, own in shapes.items():
        shown = [(over[link, one], one) for one in own]
        placed = [_placed(cover.spheres, shape) for cover, shape in shown]
        before = np.cumsum([0, *[len(spheres) for spheres in placed]])
        surfaces = [
            _placed(cover.parts, shape) + [0.0, 0.0, 0.0, first]
            for (cover, shape), first in zip(shown, before[:-1], strict=True)
        ]
        covers[link] = Cover(
            np.concatenate([np.zeros((0, 4)), *placed]),
            max((cover.excess for cover, _ in shown), default=0.0),
            np.concatenate([np.zeros((0, 4)), *surfaces]),
        )
    return covers


def _cover_shapes(
    model: UrdfModel, shapes: Sequence[tuple[str, LinkShape]], fixed: Collection[str]
) -> dict[tuple[str, LinkShape], Cover]:
    """The cover of each shape of a link, in the shape's frame; alike shapes are covered once.

    The number of spheres is shared among all meshes, so that their covers have about equal excess.
    """
    first, key_of = dict[Covered, tuple[str, LinkShape]](), {}
    for link, shape in shapes:
        mesh = mesh_file(model.path, link, shape) if shape.kind == "mesh" else None
        key_of[link, shape] = key = Covered(shape.kind, shape.size, mesh, link in fixed)
        first.setdefault(key, (link, shape))
    of_key = dict(zip(first, _made(model, first), strict=True))
    return {told: of_key[key] for told, key in key_of.items()}


def _made(model: UrdfModel, shapes: Mapping[Covered, tuple[str, LinkShape]]) -> list[Cover]:
    """The cover of each shape, in the order of ``shapes``."""
    solids, count = list[FloatArray](), 0
    for link, shape in shapes.values():
        solids.append(_surface(model, link, shape))
        count += len(solids[-1])
        _check_fineness(mesh_name(model.path, link, shape), solids[-1], count)
    meshes = [i for i, key in enumerate(shapes) if key.mesh is not None]
    loose = [FIXED if key.fixed else LOOSE for key in shapes if key.mesh is not None]
    fitted = fit_covers([solids[i] for i in meshes], PER_MESH, loose) if meshes else []
    of_mesh = dict(zip(meshes, fitted, strict=True))
    spheres = [
        of_mesh[i] if i in of_mesh else _cover(shape, LOOSE if key.fixed else 0.0)
        for i, (key, (_, shape)) in enumerate(shapes.items())
    ]
    own = in_threads(parts, [centers for centers, _ in spheres], solids)
    return [Cover(*cover, part) for cover, part in zip(spheres, own, strict=True)]


def _check_fineness(where: str, surface: FloatArray, count: int) -> None:
    """Refuse a robot of more than MOST_TRIANGLES, and a surface that folds without end."""
    if count > MOST_TRIANGLES:
        raise InvalidRobotError(
            f"{where}: with it the robot's meshes have {count} triangles: must have at most "
            f"{MOST_TRIANGLES}; simplify them, or give the link spheres in a robot file"
        )
    if (points := count_samples(surface)) > MOST_SAMPLES:
        raise InvalidRobotError(
            f"{where}: its triangles are as large as {points / MOST_SAMPLES:.0f} times what can be "
            "covered: it folds over and over; simplify it"
        )


def finer_cover(model: UrdfModel, link: str, cover: Cover, split: Collection[int]) -> Cover:
    """The cover of a link with its spheres of indices ``split`` halved."""
    surface = np.concatenate(
        [
            _surface(model, link, shape) @ rotation_of(shape.rpy).T + np.array(shape.xyz)
            for shape in model.links[link].collisions or model.links[link].visuals
        ]
    )
    spheres, excess = finer(surface, cover.spheres, split)
    return Cover(spheres, excess, parts(spheres, surface))


def _surface(model: UrdfModel, link: str, shape: LinkShape) -> FloatArray:
    """The triangles (f, 3, 3) [m] of a shape, in its frame."""
    if shape.kind == "mesh":
        return triangles(model.path, link, shape)
    if shape.kind == "box":
        return of_box(np.array(shape.size))
    if shape.kind == "sphere":
        return of_rod(shape.size[0], 0.0, shape.size[0])
    radius, length = shape.size
    return of_rod(radius, length, radius if shape.kind == "capsule" else 0.0)


def stands_on_its_plane(covers: Mapping[str, Cover], places: Mapping[str, Placement]) -> bool:
    """Whether the lowest point of the fixed links is at z = 0 of the root, within MOUNTED.

    Their covers are then raised: a table that the robot stands on does not count as touched.
    """
    fixed = [
        (covers[name].parts[:, :3], place) for name, place in places.items() if place.segment < 0
    ]
    lowest = [
        float((surface @ place.rotation[2]).min() + place.translation[2])
        for surface, place in fixed
        if len(surface)
    ]
    return abs(min(lowest, default=np.inf)) <= MOUNTED


def _cover(shape: LinkShape, bulge: float) -> tuple[FloatArray, float]:
    """The spheres (k, 4) of a primitive, and their excess [m]: radius minus depth of the centre.

    The spheres may reach beyond the primitive by ``bulge`` [m] or its :func:`allowance`, whichever
    is larger.
    """
    if shape.kind == "sphere":
        radius = shape.size[0]
        return np.array([[0.0, 0.0, 0.0, radius]]), 0.0
    if shape.kind == "box":
        spheres = cover_box(np.array(shape.size), max(bulge, allowance(min(shape.size) / 2.0)))
        depth = (np.array(shape.size) / 2.0 - np.abs(spheres[:, :3])).min(axis=1)
        return spheres, float((spheres[:, 3] - depth).max())
    radius, length = shape.size
    if shape.kind == "cylinder":
        spheres = cover_cylinder(radius, length, max(bulge, allowance(min(radius, length / 2.0))))
        side = radius - np.hypot(spheres[:, 0], spheres[:, 1])
        depth = np.minimum(side, length / 2.0 - np.abs(spheres[:, 2]))
        return spheres, float((spheres[:, 3] - depth).max())
    tip = np.array([0.0, 0.0, length / 2.0])
    spheres = cover_capsule(-tip, tip, radius, max(bulge, allowance(radius)))
    return spheres, float((spheres[:, 3] - radius).max())


def allowance(half_width: float) -> float:
    """The distance [m] by which a cover may exceed a primitive: 0.01 m or 0.2 half widths."""
    return max(0.01, 0.2 * half_width)


def _placed(cover: FloatArray, shape: LinkShape) -> FloatArray:
    """Rows (k, 4) of a cover, moved from the shape's frame to the link's."""
    centers = cover[:, :3] @ rotation_of(shape.rpy).T + np.array(shape.xyz)
    return np.column_stack([centers, cover[:, 3:]])
