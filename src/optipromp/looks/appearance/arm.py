"""The looks of an arm: the meshes of its links where they can be read, else smooth bodies."""

import functools
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.geometry.faces import revolve, sphere
from optipromp.core.geometry.shapes import PRIMITIVES, hull_faces
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.description import LinkGeometry, LinkShape, mesh_file, rotation_of
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import loads_of, without_loads
from optipromp.core.robots.tools import FINGERS, Cup, FrankaHand
from optipromp.looks.appearance.scene import Part, coarser, hex_colour, shape_faces

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
    """The looks of a robot and its tool, in the frames of its segments.

    A link shows the visual geometry of its URDF, or the collision geometry where it has no visual.
    The built-in Panda shows the meshes of the package example-robot-data where that is installed. A
    link without geometry, or with a mesh that cannot be read, shows the convex hull of its body
    spheres; a revolute joint between two such links shows a dark drum.
    """
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


@functools.lru_cache(maxsize=64)
def _loaded(path: Path, changed: int) -> list[tuple[str | None, FloatArray]]:
    import trimesh

    scene: Any = trimesh.load(str(path), force="scene")
    out = []
    for geometry in scene.dump(concatenate=False):
        visual = geometry.visual
        colour = None
        if visual.kind == "texture":
            colour = visual.material.main_color
        elif visual.kind is not None:
            colour = visual.main_color
        name = None if colour is None else hex_colour(colour)
        out.append((name, np.asarray(geometry.triangles, dtype=np.float64)))
    return out


def _panda(robot: Robot) -> list[tuple[str, int, Solids]]:
    """As :func:`_given`, of the maker's meshes of the built-in Panda where they are installed."""
    folder = _models()
    if robot.name != "panda" or robot.geometry or folder is None:
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
    """A dark cylinder about joint ``s`` where the bodies on its two sides overlap.

    It is a ring about bodies that lie end to end along the axis, and a pin through bodies that lie
    side by side along most of it, as at an elbow.
    """
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
    """A turned cup with a rounded rim on its neck."""
    inner, outer = cup.mouth
    base, rim, neck = cup.length, cup.length + cup.height, min(NECK_RADIUS, cup.radius)
    wall = outer - inner
    floor, bevel = min(wall, cup.height / 4.0), 0.3 * min(wall, 0.01)
    mouth = np.array([
        [0.0, base], [outer - bevel, base], [outer, base + bevel], [outer, rim - bevel],
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
