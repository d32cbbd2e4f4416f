"""The looks of robots and scenes as coloured surfaces: for pages, files, films and pictures. A
scene is fruits with a calyx, stems, objects, and the row that the fruits hang from. The row
(gutter, hangers, floor) is decoration that no plan considers, so it is drawn only where the
scene has no object that the stems could hang from. An arm is the meshes of its links where they can
be read, else smooth bodies."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.sparse import csr_array

from optipromp.core.arrays import FloatArray, IntArray, frame_along, frozen
from optipromp.core.geometry.faces import box, revolve, sphere, tube
from optipromp.core.geometry.shapes import (
    PRIMITIVES,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
    hull_faces,
)
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.description import LinkGeometry, LinkShape, mesh_file, rotation_of
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import loads_of, without_loads
from optipromp.core.robots.tools import FINGERS, Cup, FrankaHand
from optipromp.core.scenes.scene import Scene, SceneObject

_LARGEST_FACE = 0.04  # [m] larger flat faces are cut, so that a painter can sort them by depth
_CREASE = 0.77  # cosine of 40 degrees, a choice: a sharper edge is shaded as an edge
_DIGITS = 7  # decimals of a corner [m] by which corners are the same


def shape_faces(
    shape: Shape, position: FloatArray, rotation: FloatArray, cut: float = _LARGEST_FACE
) -> FloatArray:
    """Faces (F, 4, 3) of a shape placed in the world. ``rotation``: (3, 3), world from local.
    ``cut``: largest edge of a flat face [m], unless an edge takes too many faces."""
    return np.asarray(shape.surface(cut) @ np.asarray(rotation).T + np.asarray(position))


def triangles(faces: FloatArray) -> tuple[FloatArray, IntArray]:
    """Vertices (V, 3) and triangles (M, 3) of faces (F, 4, 3), or of triangles (M, 3, 3). Corners
    at one place are one vertex where the surface is smooth, so that a viewer that averages normals
    shades it smoothly; they are several vertices at an edge sharper than :data:`_CREASE`. Triangles
    of no area are left out."""
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
    normal = np.repeat(normal, 3, axis=0)  # of each corner
    unit = normal / np.linalg.norm(normal, axis=1)[:, None]
    places = csr_array((np.ones(len(at)), (np.arange(len(at)), at)))
    meets = (places @ places.T).tocoo()  # corners at one place
    one, other = meets.coords
    meets.data *= np.einsum("ci,ci->c", unit[one], unit[other]) > _CREASE
    mean = meets @ normal
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
    ripe = item in scene.taken
    if ripe or item.role != "pushable":
        return ROLES["target" if ripe else item.role]
    colours = PUSHABLES if item.stem is None else UNRIPE
    return colours[[other.id for other in scene.pushables].index(item.id) % len(colours)]


def calyx(radius: float, top: float) -> FloatArray:
    """Faces of sepals on a ball of a ``radius`` [m] whose pole is at the height ``top`` on z. Each
    sepal is a thin leaf that follows the ball from the pole and lifts off at its tip."""
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


def scenery(scene: Scene, *, props: bool = False) -> tuple[Part, ...]:
    """Floor and, where stems hang from nothing in the scene, a gutter that they hang from. With
    ``props`` also the posts and legs under it, which nobody placed: photographs have them."""
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
    return tuple(part for part in parts if props or part.name not in ("posts", "legs"))


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
    items = [item for item in scene.objects if item.role != "avoid"]
    faces = (shape_faces(item.shape, item.position, item.rotation, np.inf) for item in items)
    return min([0.0, *(float((each @ up).min()) for each in faces)])


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


LINK, BASE, DRUM = "#e3e6e9", "#8c9199", "#474d55"
TOOL_COLOURS = {"mouth": "#a9d8ec", "neck": "#3b434c", "palm": "#dfe2e5", "finger": "#3b434c"}
HELD = "#cc5940"  # colour of what a tool holds
GLASS = 0.28  # opacity of a cup, so that the fruit in it is visible
FINE = 0.003  # [m] edge of the cells in which corners of a fine mesh are merged: a pixel of a film
FEW = 4000  # triangles of a link up to which its mesh stays as it is
MANY = 16000  # triangles of a link, at most: an arm's page stays below 3 MB
ELBOW = 0.6  # overlap along a joint's axis over the longer body, above which it is an elbow
_UNIT_BALL = np.unique(sphere(np.zeros(3), 1.0, 24).reshape(-1, 3).round(9), axis=0)
_MODELS = "cmeel.prefix/share/example-robot-data/robots/panda_description/meshes/visual"
Solids = dict[str, list[FloatArray]]  # triangles (m, 3, 3) by colour, in the frame of a segment


@lru_cache(maxsize=16)
def arm_parts(robot: Robot) -> tuple[Part, ...]:
    """The looks of a robot and its tool, in the frames of its segments. A link shows the visual
    geometry of its URDF, or the collision geometry where it has no visual. The built-in Panda shows
    the meshes of the package example-robot-data where that is installed. A link without geometry,
    or with a mesh that cannot be read, shows the convex hull of its body spheres; a revolute joint
    between two such links shows a dark drum."""
    parts: list[Part] = []
    shown: set[str] = set()
    for link, segment, solids in (*_given(robot), *_panda(robot)):
        parts += _parts(link, segment, solids)
        shown.add(link)
    hulls: set[int] = set()
    for index in np.unique(robot.spheres.link).tolist():
        name = robot.link_names[index]
        if name not in shown and index < robot.n_own_links:
            rows = robot.spheres.link == index
            segment = int(robot.spheres.segment[rows][0])
            balls = robot.spheres.radius[rows, None, None] * _UNIT_BALL
            points = (robot.spheres.center[rows, None] + balls).reshape(-1, 3)
            body = np.asarray(points[hull_faces(points)])
            parts += _parts(name, segment, {LINK if segment >= 0 else BASE: [body]})
            hulls.add(segment)
    for s in range(robot.n_segments):
        if robot.kinematics.kind[s] == 0 and {s - 1, s} <= hulls:
            parts += _drum(robot, s)
    return (*parts, *_tool(robot))


def _given(robot: Robot) -> list[tuple[str, int, Solids]]:
    """Link, segment and surfaces of each link whose whole geometry can be read."""
    out = []
    for link in robot.geometry:
        for shapes in filter(None, (link.looks, link.shapes)):
            try:
                found = [(shape, *each) for shape in shapes for each in _surfaces(link, shape)]
            except Exception:
                continue
            solids: Solids = {}
            for shape, colour, corners in found:
                local = corners @ rotation_of(shape.rpy).T + shape.xyz
                placed = local @ link.rotation.T + link.translation
                solids.setdefault(colour, []).append(placed)
            out.append((link.link, link.segment, solids))
            break
    return out


def _surfaces(link: LinkGeometry, shape: LinkShape) -> list[tuple[str, FloatArray]]:
    colour = LINK if link.segment >= 0 else BASE
    if shape.kind == "mesh":
        found = _mesh(mesh_file(link.urdf, link.link, shape))
        return [(own or colour, corners * np.array(shape.size)) for own, corners in found]
    sizes = [shape.size] if shape.kind == "box" else shape.size
    faces = PRIMITIVES[shape.kind](*sizes).surface()
    return [(colour, np.concatenate([faces[:, [0, 1, 2]], faces[:, [0, 2, 3]]]))]


def _mesh(path: Path) -> list[tuple[str | None, FloatArray]]:
    """The triangles (m, 3, 3) of a mesh file, by colour; None where it has none."""
    return _loaded(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=64)
def _loaded(path: Path, changed: int) -> list[tuple[str | None, FloatArray]]:
    import trimesh

    scene: Any = trimesh.load(str(path), force="scene")
    out = []
    for geometry in scene.dump(concatenate=False):
        visual = geometry.visual
        painted = visual.material if visual.kind == "texture" else visual
        name = None if visual.kind is None else hex_colour(painted.main_color)
        out.append((name, np.asarray(geometry.triangles, dtype=np.float64)))
    return out


def _panda(robot: Robot) -> list[tuple[str, int, Solids]]:
    """As :func:`_given`, of the maker's meshes of the built-in Panda where they are installed."""
    folder = _models()
    if robot.name != "panda" or folder is None or any(link.shapes for link in robot.geometry):
        return []
    out = []
    for segment in range(-1, robot.n_segments):
        name = f"link{segment + 1}"
        solids: Solids = {}
        for colour, corners in _mesh(folder / f"{name}.dae"):
            solids.setdefault(colour or LINK, []).append(corners)
        out.append((name, segment, solids))
    return out


def _models() -> Path | None:
    """The folder of the Panda's meshes; None where they, or their readers, are not installed."""
    try:
        folder = Path(str(distribution("example-robot-data").locate_file(_MODELS)))
    except PackageNotFoundError:
        return None
    readers = all(find_spec(name) is not None for name in ("trimesh", "collada"))
    return folder if readers and folder.is_dir() else None


def _parts(name: str, segment: int, solids: Solids) -> list[Part]:
    """One part for each colour; meshes are made coarser until they have few enough triangles."""
    meshes = {colour: np.concatenate(each) for colour, each in solids.items()}
    cell = FINE
    while sum(map(len, meshes.values())) > (FEW if cell == FINE else MANY):
        meshes = {colour: coarser(corners, cell) for colour, corners in meshes.items()}
        cell *= 1.4
    return [
        Part.of(f"{name}/{k}" if k else name, corners, colour, segment=segment)
        for k, (colour, corners) in enumerate(meshes.items())
        if len(corners)
    ]


def _drum(robot: Robot, s: int) -> list[Part]:
    """A dark cylinder about joint ``s`` where the bodies on its two sides overlap. It is a ring
    about bodies that lie end to end along the axis, and a pin through bodies that lie side by side
    along most of it, as at an elbow."""
    kin, cover = robot.kinematics, robot.spheres
    axis = kin.axis[s]
    spans, reaches = [], []
    for segment in (s - 1, s):
        rows = cover.segment == segment
        centers, radii = cover.center[rows], cover.radius[rows]
        if segment == s - 1:
            centers = (centers - kin.translation[s]) @ kin.rotation[s]
        along = centers @ axis
        aside = np.linalg.norm(centers - along[:, None] * axis, axis=1)
        near = aside < radii
        if not near.any():
            return []
        half = np.sqrt(radii[near] ** 2 - aside[near] ** 2)
        spans.append((float((along[near] - half).min()), float((along[near] + half).max())))
        reaches.append((along[near], radii[near]))
    low, high = max(spans[0][0], spans[1][0]), min(spans[0][1], spans[1][1])
    if high <= low:
        return []
    middle = 0.5 * (low + high)
    widths = [
        float(np.sqrt(np.maximum(radii**2 - (along - middle) ** 2, 0.0)).max())
        for along, radii in reaches
    ]
    radius, half = 1.03 * max(widths), 0.12 * max(widths)
    longer = max(spans, key=lambda span: span[1] - span[0])
    if high - low > ELBOW * (longer[1] - longer[0]):
        middle, half = 0.5 * sum(longer), 0.52 * (longer[1] - longer[0])
        radius = 0.7 * max(widths)
    profile = np.array([[0.0, -half], [0.96 * radius, -half], [radius, -0.7 * half],
                        [radius, 0.7 * half], [0.96 * radius, half], [0.0, half]])  # fmt: skip
    faces = revolve(profile, 32) @ frame_along(axis).T + middle * axis
    return [Part.of(f"joint:{s}", faces, DRUM, segment=s)]


def _tool(robot: Robot) -> list[Part]:
    tool, last, folder = robot.tool, robot.n_segments - 1, _models()
    if tool is None:
        return []
    held = []
    for load in loads_of(tool):
        faces = [shape_faces(one.shape, one.position, one.rotation, np.inf) for one in load.solids]
        held.append(Part.of(f"tool/{load.id}", np.concatenate(faces), HELD, segment=last))
    tool = without_loads(tool)
    solids: dict[str, list[FloatArray]] = {}
    if isinstance(tool, FrankaHand) and folder is not None:
        placed = [("hand", np.zeros(3), 1.0)]
        placed += [
            ("finger", np.array([0.0, y, FINGERS]), np.sign(y))
            for y in (tool.gripper_radius, -tool.gripper_radius)
        ]
        for name, at, sign in placed:
            for colour, corners in _mesh(folder / f"{name}.dae"):
                turned = corners * [sign, sign, 1.0] + at
                solids.setdefault(colour or LINK, []).append(turned @ tool.rotation.T)
        parts = _parts("tool", last, solids)
    else:
        if isinstance(tool, Cup):
            solids = _cup(tool)
        else:
            for solid in tool.solids():
                own = shape_faces(solid.shape, solid.position, solid.rotation, np.inf)
                solids.setdefault(solid.part, []).append(own)
        parts = []
        for name, each in solids.items():
            seen: Any = {"segment": last, "opacity": GLASS if name == "mouth" else 1.0}
            parts.append(Part.of(f"tool/{name}", np.concatenate(each), TOOL_COLOURS[name], **seen))
    parts += held
    return [part.placed(robot.flange_translation, robot.flange_rotation) for part in parts]


def _cup(cup: Cup) -> dict[str, list[FloatArray]]:
    """A turned cup with a rounded rim, on its cone and its neck."""
    inner, outer = cup.mouth
    base, rim, neck = cup.length, cup.length + cup.height, min(NECK_RADIUS, cup.radius)
    wall, low = outer - inner, [[r, base - cup.cone] for r in (0.0, neck)[: 1 + (cup.cone > 0.0)]]
    floor, bevel = min(wall, cup.height / 4.0), 0.3 * min(wall, 0.01)
    mouth = np.array([
        *low, [outer - bevel, base], [outer, base + bevel], [outer, rim - bevel],
        [outer - bevel, rim], [inner + bevel, rim], [inner, rim - bevel], [inner, base + floor],
        [0.0, base + floor],
    ])  # fmt: skip
    out = {"mouth": [revolve(mouth, 48)]}
    if cup.length > 0.0:
        foot = min(2.5 * neck, outer), min(0.006, 0.2 * base)
        rod = np.array([[0.0, 0.0], [foot[0], 0.0], [foot[0], foot[1]], [neck, foot[1]],
                        [neck, base], [0.0, base]])  # fmt: skip
        out["neck"] = [revolve(rod, 32)]
    return out
