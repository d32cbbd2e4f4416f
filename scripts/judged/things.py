"""Objects for the oracles, and their distances from a robot, by Coal and by MuJoCo."""

from dataclasses import dataclass, replace
from typing import Any

import coal
import mujoco
import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from scripts.judged.bodies import Arm, Piece

from optipromp.core.geometry import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Sphere,
)
from optipromp.core.scenes import SceneObject, Stem

KINDS = "sphere", "box", "cylinder", "capsule", "half-space", "mesh", "corner", "cloud"


@dataclass
class Thing:
    """An object: what the judge is given, and the pieces that Coal and MuJoCo are."""

    kind: str
    role: str
    item: SceneObject
    pieces: list[Piece]
    out: Any  # away from the robot

    def __post_init__(self) -> None:
        self.bodies = [piece.coals() for piece in self.pieces]
        self.poses = [coal.Transform3s(p.turn, p.at) for p in self.pieces]

    def __str__(self) -> str:
        return f"{self.kind}, {self.role}"

    def moved(self, by: Any) -> "Thing":
        """The same, moved by a vector [m]."""
        pieces = [replace(piece, at=piece.at + by) for piece in self.pieces]
        at, stem = self.item.position + by, self.item.stem
        if stem is not None:
            stem = Stem(stem.points + by)
        return Thing(
            self.kind, self.role, replace(self.item, position=at, stem=stem), pieces, self.out
        )


def polytope(rng: Any, size: float) -> Any:
    """Corners of a random convex body, about its middle."""
    points = rng.normal(size=(12, 3))
    points *= size / np.linalg.norm(points, axis=1)[:, None]
    return points - points.mean(axis=0)


def corner(a: float, b: float) -> tuple[MeshShape, list[Piece]]:
    """A closed mesh of an L, which is not convex, and the two boxes that it is."""
    outline = np.array([[0, 0], [a, 0], [a, b], [b, b], [b, a], [0, a]], float)
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (-0.5 * a, 0.5 * a))
    lid = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [(f[2], f[1], f[0]) for f in lid] + [tuple(6 + i for i in f) for f in lid]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, 6 + j), (i, 6 + j, 6 + i)]
    boxes = [Piece("box", (a, b, a), at=np.array([0.5 * a, 0.5 * b, 0.0])),
             Piece("box", (b, a, a), at=np.array([0.5 * b, 0.5 * a, 0.0]))]  # fmt: skip
    return MeshShape(np.concatenate([low, high]), np.array(faces)), boxes


def thing(rng: Any, arm: Arm, q: Any, gap: float) -> Thing:
    """A random object whose distance from the robot at ``q`` is about ``gap`` [m]."""
    kind, role = str(rng.choice(KINDS)), str(rng.choice(["static", "static", "avoid", "pushable"]))
    role = "static" if kind == "half-space" else role
    at, out, far = near(rng, arm, q)
    size = np.exp(rng.uniform(np.log(0.004), np.log(0.15), 3))
    turn = Rotation.random(random_state=rng).as_matrix()
    match kind:
        case "sphere":
            shape, pieces, reach = Sphere(size[0]), [Piece("sphere", (size[0],))], size[0]
        case "box":
            edges = tuple(2.0 * size)
            shape, pieces, reach = Box(edges), [Piece("box", edges)], size.min()
        case "cylinder" | "capsule":
            rod = (size[0], 2.0 * size[1])
            shape = (Cylinder if kind == "cylinder" else Capsule)(*rod)
            pieces, reach = [Piece(kind, rod)], min(size[:2])
        case "half-space":
            shape, pieces, reach = HalfSpace(), [Piece(kind)], far
            side = np.cross(out, [1.0, 0.0, 0.0] if abs(out[0]) < 0.9 else [0.0, 1.0, 0.0])
            side /= np.linalg.norm(side)
            turn = np.column_stack([side, np.cross(-out, side), -out])
        case "mesh":
            corners = polytope(rng, 0.02 + size[0])
            closed = trimesh.convex.convex_hull(corners)
            shape = MeshShape(np.array(closed.vertices), np.array(closed.faces))
            pieces, reach = [Piece("mesh", (), corners)], 0.8 * (0.02 + size[0])
        case "corner":
            shape, pieces = corner(0.03 + size[0], 0.01 + 0.3 * size[0])
            reach = 0.5 * (0.01 + 0.3 * size[0])
        case _:
            points = rng.uniform(-size[0], size[0], (30, 3))
            shape = PointCloudShape(points, 0.01)
            pieces, reach = [Piece("sphere", (0.01,), at=p) for p in points], size[0]
    place = at + out * reach
    for piece in pieces:
        piece.at, piece.turn = place + turn @ piece.at, turn @ piece.turn
    stem = Stem.along(place, np.array([0.0, 0.0, 1.0]), 0.2) if role == "pushable" else None
    what = Thing(kind, role, SceneObject("it", role, shape, place, turn, stem), pieces, out)
    for _ in range(4):
        what = what.moved((gap - distance(arm, q, what)) * out)
    return what


def near(rng: Any, arm: Arm, q: Any) -> tuple[Any, Any, float]:
    """A point of the robot's surface, a direction, and how far the robot goes along it."""
    turns, places = arm.poses(q)
    one = rng.integers(len(arm.pieces))
    points = arm.pieces[one].points() @ turns[one].T + places[one]
    at, out = points[rng.integers(len(points))], rng.normal(size=3)
    out /= np.linalg.norm(out)
    ends = [(p.points() @ r.T + t) @ out for p, r, t in zip(arm.pieces, turns, places, strict=True)]
    return at, out, float(max(e.max() for e in ends) - at @ out)


def distance(arm: Arm, q: Any, what: Thing) -> float:
    """Coal's signed distance [m] of the bodies that must not touch the object."""
    turns, places = arm.poses(q)
    least, request, result = np.inf, coal.DistanceRequest(), coal.DistanceResult()
    away = places[:, None] - [piece.at for piece in what.pieces]
    bound = np.linalg.norm(away, axis=2) - arm.reach[:, None] - [p.reach() for p in what.pieces]
    if what.role != "static":
        bound[arm.distal] = np.inf
    for place in np.argsort(bound, axis=None):
        i, k = divmod(int(place), len(what.pieces))
        if bound[i, k] >= least:
            break
        result.clear()
        pose = coal.Transform3s(turns[i], places[i])
        d = coal.distance(arm.bodies[i], pose, what.bodies[k], what.poses[k], request, result)
        least = min(least, d)
    return float(least)


class MuJoCo:
    """The same distance by MuJoCo; a model for each case, of the bodies and the object."""

    def distance(self, arm: Arm, q: Any, what: Thing) -> float:
        """MuJoCo's signed distance [m]."""
        turns, places = arm.poses(q)
        spec, bodies = mujoco.MjSpec(), 0
        for k, piece in enumerate(arm.pieces):
            if what.role == "static" or not arm.distal[k]:
                self._add(spec, piece, turns[k], places[k], f"p{k}")
                bodies += 1
        for k, piece in enumerate(what.pieces):
            self._add(spec, piece, piece.turn, piece.at, f"o{k}")
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return min(
            mujoco.mj_geomDistance(model, data, i, bodies + k, 10.0, None)
            for i in range(bodies) for k in range(len(what.pieces))
        )  # fmt: skip

    def _add(self, spec: Any, piece: Piece, turn: Any, at: Any, name: str) -> None:
        x, y, z, w = Rotation.from_matrix(turn).as_quat()
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{piece.kind.upper()}")
        size = list(piece.size)
        if piece.kind == "box":
            size = [0.5 * edge for edge in size]
        elif len(size) == 2:
            size[1] *= 0.5
        more: dict[str, Any] = {"size": (size + [0.0] * 3)[:3]}
        if piece.kind == "mesh":
            spec.add_mesh(name=name, uservert=np.ravel(piece.corners).tolist())
            more = {"meshname": name}
        spec.worldbody.add_geom(type=kind, pos=at, quat=[w, x, y, z], **more)
