"""Whether a robot touches itself as its meshes do, by Coal.

Links touch where their surfaces meet, or one is inside the other (winding number). Pairs that the
maker's SRDF disables are left out.
"""

import coal
import numpy as np
import trimesh

from optipromp.core.robots import Robot
from optipromp.core.robots.description import LinkGeometry, LinkShape, rotation_of
from optipromp.readers.packages import triangles


def link_meshes(robot: Robot) -> dict[str, np.ndarray]:
    """The triangles (f, 3, 3) of each link that has geometry, in its frame [m]."""
    return {
        each.link: np.concatenate(
            [_triangles(each, one) @ rotation_of(one.rpy).T + one.xyz for one in each.shapes]
        )
        for each in robot.geometry
        if each.shapes
    }


def _triangles(geometry: LinkGeometry, shape: LinkShape) -> np.ndarray:
    if shape.kind == "mesh":
        return triangles(geometry.urdf, geometry.link, shape)
    made = {
        "box": lambda: trimesh.creation.box(shape.size),
        "sphere": lambda: trimesh.creation.icosphere(radius=shape.size[0]),
        "cylinder": lambda: trimesh.creation.cylinder(*shape.size),
        "capsule": lambda: trimesh.creation.capsule(shape.size[1], shape.size[0]),
    }
    return np.asarray(made[shape.kind]().triangles)


def random_configurations(robot: Robot, count: int) -> np.ndarray:
    """(count, n) within the limits; continuous joints turn once."""
    low = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    high = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    return np.random.default_rng(1).uniform(low, high, (count, robot.n_joints))


def meshes_touch(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Whether links two or more segments apart touch at ``q`` (m, n): (m,)."""
    places, meshes = {each.link: each for each in robot.geometry}, link_meshes(robot)
    wrong = {frozenset(each[:2]) for each in robot.left_out if each.why.endswith(".srdf")}
    models = {name: _bvh(mesh) for name, mesh in meshes.items()}
    solids = {name: (mesh, mesh.min((0, 1)), mesh.max((0, 1))) for name, mesh in meshes.items()}
    origins, rotations = robot.segment_frames(q)
    at = {}
    for name in meshes:
        own, s = places[name], places[name].segment
        turns = rotations[:, s] if s >= 0 else np.tile(np.eye(3), (len(q), 1, 1))
        moves = origins[:, s] if s >= 0 else np.zeros((len(q), 3))
        at[name] = [
            coal.Transform3s(turn @ own.rotation, turn @ own.translation + move)
            for turn, move in zip(turns, moves, strict=True)
        ]
    out, request, result = np.zeros(len(q), bool), coal.CollisionRequest(), coal.CollisionResult()
    for a in meshes:
        for b in meshes:
            if places[a].segment > places[b].segment - 2 or frozenset((a, b)) in wrong:
                continue
            for t in np.flatnonzero(~out):
                result.clear()
                touch = coal.collide(models[a], at[a][t], models[b], at[b][t], request, result)
                between = at[a][t].inverse() * at[b][t]
                touch = touch or _inside(solids[a], between, meshes[b][0, 0])
                out[t] = touch or _inside(solids[b], between.inverse(), meshes[a][0, 0])
    return out


def _bvh(mesh: np.ndarray) -> coal.BVHModelOBBRSS:
    corners, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
    for corner in mesh.reshape(-1, 3):
        corners.append(corner)
    for k in range(0, 3 * len(mesh), 3):
        faces.append(coal.Triangle(k, k + 1, k + 2))
    out = coal.BVHModelOBBRSS()
    out.beginModel(len(mesh), 3 * len(mesh))
    out.addSubModel(corners, faces)
    out.endModel()
    return out


def _inside(solid: tuple[np.ndarray, ...], place: coal.Transform3s, point: np.ndarray) -> bool:
    """Whether ``point`` (3,) of what stands at ``place`` is in a mesh, given with its bounds."""
    (mesh, low, high), p = solid, place.transform(point)
    if (p < low).any() or (p > high).any():
        return False
    a, b, c = np.moveaxis(mesh - p, 1, 0)
    x, y, z = (np.linalg.norm(v, axis=1) for v in (a, b, c))
    volume = np.einsum("ij,ij->i", a, np.cross(b, c))
    rest = x * y * z + (a * b).sum(1) * z + (b * c).sum(1) * x + (c * a).sum(1) * y
    return bool(abs(np.arctan2(volume, rest).sum()) > np.pi)
