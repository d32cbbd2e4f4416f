"""The looks of a scene: fruits with a calyx, stems, objects, and the row that the fruits hang from.

The row (gutter, hangers, posts, floor) is decoration that no plan considers, so it is drawn only
where the scene has no object that the stems could hang from.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frame_along, frozen
from optipromp.core.geometry.faces import box, revolve, sphere, tube
from optipromp.core.geometry.shapes import MeshShape, PointCloudShape, Shape, Sphere
from optipromp.core.scenes.scene import Scene, SceneObject

_LARGEST_FACE = 0.04  # [m] larger flat faces are cut, so that a painter can sort them by depth
_CREASE = 0.77  # cosine of 40 degrees, a choice: a sharper edge is shaded as an edge
_DIGITS = 7  # decimals of a corner [m] by which corners are the same


def shape_faces(
    shape: Shape, position: FloatArray, rotation: FloatArray, cut: float = _LARGEST_FACE
) -> FloatArray:
    """Faces (F, 4, 3) of a shape placed in the world.

    ``rotation``: (3, 3), world from local. ``cut``: largest edge of a flat face [m], unless an edge
    takes too many faces.
    """
    return np.asarray(shape.surface(cut) @ np.asarray(rotation).T + np.asarray(position))


def triangles(faces: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (M, 3) of faces (F, 4, 3), or of triangles (M, 3, 3).

    Corners at one place are one vertex where the surface is smooth, so that a viewer that averages
    normals shades it smoothly; they are several vertices at an edge sharper than :data:`_CREASE`.
    Triangles of no area are left out.
    """
    corners = faces
    if faces.shape[1] == 4:
        corners = np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]])
    place = np.round(corners, _DIGITS) + 0.0
    normal = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
    area = np.linalg.norm(normal, axis=1)
    place, normal = place[area > 0.0], normal[area > 0.0]
    if not len(place):
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64)
    _, at = _alike(place.reshape(-1, 3))
    unit = np.repeat(normal / np.linalg.norm(normal, axis=1)[:, None], 3, axis=0)
    count = np.bincount(at)
    order = np.argsort(at, kind="stable")  # corners by place; each meets all others of its place
    met = count[at[order]]
    one = np.repeat(order, met)
    start = np.repeat((np.cumsum(count) - count)[at[order]], met)
    step = np.arange(len(one)) - np.repeat(np.cumsum(met) - met, met)
    other = order[start + step]
    alike = np.einsum("ci,ci->c", unit[one], unit[other]) > _CREASE
    mean = np.zeros_like(unit)
    np.add.at(mean, one[alike], np.repeat(normal, 3, axis=0)[other[alike]])
    mean /= np.linalg.norm(mean, axis=1)[:, None]
    keys = np.column_stack([at, np.round(mean, 2)]) + 0.0
    first, index = _alike(keys)
    return place.reshape(-1, 3)[first], index.reshape(-1, 3).astype(np.int64)


def coarser(corners: FloatArray, cell: float) -> FloatArray:
    """Fewer triangles (M, 3, 3): all corners in a cell of a grid move to their mean."""
    points = corners.reshape(-1, 3)
    _, cells = _alike(np.floor(points / cell))
    count = np.bincount(cells)
    mean = np.stack([np.bincount(cells, column) for column in points.T], axis=1) / count[:, None]
    a, b, c = (index := cells.reshape(-1, 3)).T
    whole = index[(a != b) & (b != c) & (c != a)]
    first, _ = _alike(np.sort(whole, axis=1))
    return np.asarray(mean[whole[np.sort(first)]])


def _alike(rows: FloatArray | IntArray) -> tuple[IntArray, IntArray]:
    """The first of each kind of ``rows`` (k, d), and the kind of each (k,); a faster np.unique."""
    order = np.lexsort(rows.T)
    new = np.ones(len(rows), dtype=np.bool_)
    new[1:] = (np.diff(rows[order], axis=0) != 0).any(axis=1)
    kind = np.empty(len(rows), dtype=np.int64)
    kind[order] = np.cumsum(new) - 1
    return order[new], kind


Colour = tuple[int, int, int]  # sRGB, 0 to 255


@dataclass(frozen=True, eq=False)
class Part:
    """A surface that moves as one.

    Attributes:
        name: unique among the parts of a robot, or of a scene; in files ``/`` separates a group.
        segment: of the robot, which carries the part; -1: the base, or the world.
        vertices: (v, 3) in the frame of that segment [m]; of a scene, in the robot's base frame.
        faces: (f, 3) rows of vertices, anticlockwise seen from outside.
        colour: sRGB, each 0 to 255.
        opacity: 0 to 1.
        owner: id of the scene's object; empty where the part is of none.
    """

    name: str
    segment: int
    vertices: FloatArray
    faces: IntArray
    colour: Colour
    opacity: float = 1.0
    owner: str = ""

    @classmethod
    def of(
        cls, name: str, faces: FloatArray, colour: str, *, segment: int = -1, opacity: float = 1.0,
        owner: str = "",
    ) -> Self:  # fmt: skip
        """A part of faces (F, 4, 3), or triangles (F, 3, 3), in a colour ``#rrggbb``."""
        vertices, rows = triangles(faces)
        return cls(
            name, segment, frozen(vertices), frozen(rows, np.int64), rgb(colour), opacity, owner
        )

    def placed(self, position: FloatArray, rotation: FloatArray) -> Self:
        """The same part, its frame at a position (3,) [m] with a rotation (3, 3)."""
        return replace(self, vertices=frozen(self.vertices @ rotation.T + position))


def rgb(colour: str) -> Colour:
    """The numbers of ``#rrggbb``."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue


def hex_colour(colour: Iterable[int]) -> str:
    """``#rrggbb`` of the first three numbers."""
    return "#" + bytes(int(value) for value in colour)[:3].hex()


ROLES = {"target": "#d11a2a", "avoid": "#7f9a5c", "static": "#b39b7c"}
UNRIPE = ("#a9c46a", "#c6cf86", "#8fb554", "#d3d7a0")  # pushables on stems, in turn
PUSHABLES = ("#6aa832", "#00897b", "#b8960c", "#2f5d1e", "#9a6b3c", "#5f7f8c")  # others, in turn
LEAF, STEM, TRUSS = "#3f8a2e", "#4c8030", "#6f8a4a"
GUTTER, POST, FLOOR = "#f2f3ef", "#a7adb3", "#e9ece5"
SEE_THROUGH = 0.3  # opacity of objects to avoid
SEPALS = 7
LARGE = 0.04  # [m] radius of a ball above which it needs more faces
TROUGH = 0.16, 0.07, 0.55  # [m] of the gutter: width, height, length beyond the last stem
OVER = 0.006  # [m] from the highest root up to the gutter
HANGS = 0.08  # [m] from a root to the object that its stem hangs from, at most
REACHES = 0.15  # [m] length of a hanger to such an object, at most
GROUND = 1.6  # [m] half the floor's side
FLOOR_DEPTH = 0.01  # [m] thickness of the floor


def scene_parts(scene: Scene) -> tuple[Part, ...]:
    """The looks of a scene in the base frame of its robot: objects, stems, then the scenery."""
    parts: list[Part] = []
    for item in scene.objects:
        parts += [part.placed(item.position, item.rotation) for part in object_parts(scene, item)]
        if item.stem is not None:
            faces = tube(np.asarray(item.stem.points), item.stem.radius, 12)
            parts.append(Part.of(f"stem:{item.id}", faces, STEM, owner=item.id))
    return (*parts, *scenery(scene))


def object_parts(scene: Scene, item: SceneObject) -> tuple[Part, ...]:
    """An object of a scene in its own frame, without its stem: ``role:id``, and its calyx."""
    opacity = SEE_THROUGH if item.role == "avoid" else 1.0
    faces = item.shape.surface()
    if isinstance(item.shape, Sphere) and item.radius > LARGE:
        faces = sphere(np.zeros(3), item.radius, 48)
    name, colour = f"{item.role}:{item.id}", colour_of(scene, item)
    body = Part.of(name, faces, colour, opacity=opacity, owner=item.id)
    if item.stem is None or isinstance(item.shape, MeshShape | PointCloudShape):
        return (body,)
    first = np.diff(np.asarray(item.stem.points)[:2], axis=0)[0]
    up = item.rotation.T @ (first / np.linalg.norm(first))
    top = item.radius if isinstance(item.shape, Sphere) else float(np.max(body.vertices @ up))
    faces = calyx(item.radius if isinstance(item.shape, Sphere) else 0.5 * top, top)
    return body, Part.of(f"calyx:{item.id}", faces @ frame_along(up).T, LEAF, owner=item.id)


def colour_of(scene: Scene, item: SceneObject) -> str:
    """The colour ``#rrggbb`` of an object of a scene."""
    if item.role != "pushable":
        return ROLES[item.role]
    colours = PUSHABLES if item.stem is None else UNRIPE
    return colours[[other.id for other in scene.pushables].index(item.id) % len(colours)]


def calyx(radius: float, top: float) -> FloatArray:
    """Faces of sepals on a ball of a ``radius`` [m] whose pole is at the height ``top`` on z.

    Each sepal is a thin leaf that follows the ball from the pole and lifts off at its tip.
    """
    share = np.linspace(0.0, 1.0, 6)
    polar = 1.05 * share  # [rad] from the pole
    lift = radius * (1.03 + 0.10 * share**3)
    width = radius * 0.34 * np.sin(np.pi * np.minimum(0.22 + 0.78 * share, 1.0))
    ridge = np.stack([lift * np.sin(polar), np.zeros(6), lift * np.cos(polar)], axis=1)
    side = np.array([0.0, 1.0, 0.0]) * width[:, None]
    drop = np.array([-1.0, 0.0, -1.0]) / np.sqrt(2.0) * 0.25 * width[:, None]
    left, right = ridge + side + drop, ridge - side + drop
    top_side = np.concatenate([_strip(right, ridge), _strip(ridge, left)])
    leaf = np.concatenate([top_side, top_side[:, ::-1] - [0.0, 0.0, 0.02 * radius]])
    out = [
        revolve(np.array([[0.0, 0.0], [0.16, 0.0], [0.12, 0.14], [0.0, 0.16]]) * radius, 10)
        + [0.0, 0.0, 0.98 * radius]
    ]
    for k in range(SEPALS):
        c, s = np.cos(2.0 * np.pi * k / SEPALS), np.sin(2.0 * np.pi * k / SEPALS)
        out.append(leaf @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T)
    return np.asarray(np.concatenate(out) + [0.0, 0.0, top - radius])


def _strip(lower: FloatArray, upper: FloatArray) -> FloatArray:
    return np.stack([lower[:-1], lower[1:], upper[1:], upper[:-1]], axis=1)


def _row(scene: Scene, roots: FloatArray) -> FloatArray:
    """Axes away from the robot, along the row and up, as columns (3, 3)."""
    up = np.asarray(scene.up)
    middle = roots.mean(axis=0) if len(roots) else scene.positions.mean(axis=0)
    away = middle - (middle @ up) * up
    if np.linalg.norm(away) < 1e-3:
        away = np.eye(3)[int(np.argmin(np.abs(up)))]
        away = away - (away @ up) * up
    away = away / np.linalg.norm(away)
    return np.column_stack([away, np.cross(up, away), up])


def _solid(row: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Faces of a box between two corners in the axes of a row."""
    return np.asarray((box(high - low) + 0.5 * (low + high)) @ row.T)


def scenery(scene: Scene) -> tuple[Part, ...]:
    """Floor and, where stems hang from nothing in the scene, a gutter that they hang from."""
    if not len(scene.objects):
        return ()
    hanging = [
        item.stem.root
        for item in scene.objects
        if item.stem is not None
        and item.stem.parent is None
        and (item.stem.root - item.position) @ scene.up > 0.0
    ]
    roots = np.reshape(hanging, (-1, 3))
    holding = next(
        (i for i in scene.static if any(box_distance(i, r) < HANGS for r in roots)), None
    )
    row = _row(scene, roots)
    ground = ground_of(scene)
    parts = []
    if ground is not None:
        center = 0.5 * scene.positions.mean(axis=0) @ row
        low, high = center - GROUND, center + GROUND
        low[2], high[2] = ground - FLOOR_DEPTH, ground
        parts.append(Part.of("floor", _solid(row, low, high), FLOOR))
        if ground < -FLOOR_DEPTH:
            pedestal = np.array([[-0.1, -0.1, ground], [0.1, 0.1, -0.001]])
            parts.append(Part.of("pedestal", _solid(row, *pedestal), POST))
    local = roots @ row
    level = 0.0 if ground is None else ground
    if holding is not None:
        parts += _table(row, holding, roots, level)
    elif len(roots) and local[:, 2].max() > 0.1:  # not under the arm's base
        parts += _gutter(row, local, level)
    return tuple(parts)


def _gutter(row: FloatArray, roots: FloatArray, ground: float) -> list[Part]:
    """An open trough over the roots (k, 3) in the row's axes, its posts, and hangers to it."""
    width, height, beyond = TROUGH
    low, high = roots.min(axis=0), roots.max(axis=0)
    under = high[2] + OVER
    half = 0.5 * max(width, high[0] - low[0] + 0.04)
    middle, ends = 0.5 * (low[0] + high[0]), (low[1] - beyond, high[1] + beyond)
    wall = 0.006
    plates = [
        ((-half, 0.0), (half, wall)),
        ((-half, wall), (wall - half, height)),
        ((half - wall, wall), (half, height)),
        ((-half - 0.012, height - wall), (-half, height)),
        ((half, height - wall), (half + 0.012, height)),
        ((wall - half, 0.5 * height), (half - wall, 0.75 * height)),
    ]
    solids = []
    for a, b in plates:
        first = np.array([middle + a[0], ends[0], under + a[1]])
        last = np.array([middle + b[0], ends[1], under + b[1]])
        solids.append(_solid(row, first, last))
    parts = [
        Part.of("gutter", np.concatenate(solids[:-1]), GUTTER),
        Part.of("soil", solids[-1], "#5b4636"),
    ]
    posts = []
    for end in (ends[0] + 0.12, ends[1] - 0.12):
        top = np.array([[middle, end, ground], [middle, end, under]]) @ row.T
        posts.append(tube(top, 0.014, 16))
        bar = np.array([middle, end, under - 0.012])
        posts.append(_solid(row, bar - [half, 0.015, 0.012], bar + [half, 0.015, 0.012]))
    parts.append(Part.of("posts", np.concatenate(posts), POST))
    hangers = [tube(np.array([root, [*root[:2], under]]) @ row.T, 0.0015, 8) for root in roots]
    return [*parts, Part.of("hangers", np.concatenate(hangers), TRUSS)]


def _table(row: FloatArray, item: SceneObject, roots: FloatArray, ground: float) -> list[Part]:
    """Two legs under an object that stems hang from, and hangers from the roots to it."""
    local = _corners(item) @ item.rotation.T + item.position
    low, high = (local @ row).min(axis=0), (local @ row).max(axis=0)
    middle = 0.5 * (low[0] + high[0])
    legs = []
    for end in (low[1] + 0.04, high[1] - 0.04):
        line = np.array([[middle, end, ground], [middle, end, low[2]]])
        legs.append(tube(line @ row.T, 0.01, 16))
    hangers = [
        tube(np.stack([root, _nearest(item, root)]), 0.0015, 8)
        for root in roots
        if 0.001 < box_distance(item, root) < REACHES
    ]
    parts = [Part.of("legs", np.concatenate(legs), POST)]
    if hangers:
        parts.append(Part.of("hangers", np.concatenate(hangers), TRUSS))
    return parts


def ground_of(scene: Scene) -> float | None:
    """Height of the floor at the base or the lowest object [m]; None where the scene has one."""
    if any(np.isinf(item.radius) for item in scene.objects):
        return None
    up = np.asarray(scene.up)
    lowest = [0.0]
    for item in scene.objects:
        if item.role != "avoid":
            faces = shape_faces(item.shape, item.position, item.rotation, np.inf)
            lowest.append(float((faces @ up).min()))
    return min(lowest)


def _corners(item: SceneObject) -> FloatArray:
    return item.shape.surface().reshape(-1, 3)


def _nearest(item: SceneObject, point: FloatArray) -> FloatArray:
    """The point (3,) of an object's bounding box that is nearest to a point."""
    corners, local = _corners(item), (point - item.position) @ item.rotation
    inside = np.clip(local, corners.min(axis=0), corners.max(axis=0))
    return np.asarray(item.rotation @ inside + item.position)


def box_distance(item: SceneObject, point: FloatArray) -> float:
    """Distance of a point (3,) from an object's bounding box, infinite for a half-space [m]."""
    if np.isinf(item.radius):
        return np.inf
    return float(np.linalg.norm(point - _nearest(item, point)))
