"""Robots for the oracles: convex pieces, placed by Pinocchio."""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from importlib import resources
from typing import Any

import coal
import numpy as np
import pinocchio as pin
import trimesh
from scripts.studies.arms import models

from optipromp.core.geometry import Box, Cylinder, MeshShape
from optipromp.core.robots import (
    Cup,
    FingerGripper,
    FrankaHand,
    MeshTool,
    Scissor,
    load_robot,
    with_tool,
)

RIM = 0.03  # [m] of the base's height that its cover leaves out (robots/data/panda.yaml)
END = 0.012  # [m] along the axis of joint 7: what of link 6 is beyond, link 7 alone covers
RODS = {"cylinder": coal.Cylinder, "capsule": coal.Capsule}


@dataclass
class Piece:
    """A convex piece of a body or of an object: kind, sizes or corners, and its pose."""

    kind: str
    size: tuple[float, ...] = ()
    corners: Any = None
    at: Any = field(default_factory=lambda: np.zeros(3))
    turn: Any = field(default_factory=lambda: np.eye(3))
    link: str = ""
    joint: int = 0
    distal: bool = False

    def coals(self) -> Any:
        """The piece for Coal."""
        match self.kind:
            case "sphere":
                return coal.Sphere(self.size[0])
            case "box":
                return coal.Box(*self.size)
            case "half-space":
                return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            case "mesh":
                return hull(self.corners)
        return RODS[self.kind](*self.size)

    def reach(self) -> float:
        """Radius of a ball about ``at`` that holds it [m]."""
        if self.kind == "half-space":
            return np.inf
        if self.kind == "capsule":
            return self.size[0] + 0.5 * self.size[1]
        if self.kind == "sphere":
            return self.size[0]
        return float(np.linalg.norm(self.points(), axis=1).max())

    def points(self) -> Any:
        """Points of its surface in its own frame."""
        if self.corners is not None:
            return self.corners
        if self.kind == "sphere":
            return self.size[0] * np.array([[1, 0, 0], [-0.6, 0.8, 0], [-0.5, -0.5, 0.7071]])
        half = 0.5 * np.array(self.size if self.kind == "box" else
                              (2 * self.size[0], 2 * self.size[0], self.size[1]))  # fmt: skip
        return half * [[x, y, z] for x in (-1, 0, 1) for y in (-1, 1) for z in (-1, 1)]


def hull(corners: Any) -> Any:
    """The convex hull of points, for Coal."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend([np.array(c, float) for c in corners])
    return coal.Convex.convexHull(vertices, True, "Qt")


def cut(piece: Piece, along: Any, at: float) -> tuple[Piece, Piece]:
    """The parts of a convex body beyond and before a plane."""
    body = trimesh.convex.convex_hull(piece.corners)
    corners = np.array(body.vertices)
    height = corners @ along - at
    i, j = body.edges_unique[height[body.edges_unique].prod(axis=1) < 0.0].T
    share = (height[i] / (height[i] - height[j]))[:, None]
    rim = corners[i] + share * (corners[j] - corners[i])
    beyond, before = (np.concatenate([corners[own], rim]) for own in (height >= 0, height < 0))
    return replace(piece, corners=beyond), replace(piece, corners=before)


def solids(tool: Any, flange: Any) -> list[Piece]:
    """The solids of a tool on a flange; of the Franka hand, the maker's meshes."""
    joint, rotation, translation = flange
    out = []
    if isinstance(tool, FrankaHand):
        folder = models() / "panda_description" / "meshes" / "collision"
        palm, finger = (trimesh.load(folder / f"{n}.stl", force="mesh") for n in ("hand", "finger"))
        at = np.array([0.0, tool.gripper_radius, 0.0584])
        other = np.array(finger.vertices) * [-1, -1, 1] + at * [1, -1, 1]
        for points in (palm.vertices, finger.vertices + at, other):
            corners = np.array(points) @ tool.rotation.T
            out.append(Piece("mesh", (), trimesh.convex.convex_hull(corners).vertices))
    else:
        for solid in tool.solids():
            one = solid.shape
            match one:
                case Box():
                    piece = Piece("box", one.size)
                case Cylinder():
                    piece = Piece("cylinder", (one.radius, one.length))
                case _:
                    piece = Piece("mesh", (), np.array(one.vertices))
            piece.at, piece.turn = np.array(solid.position), solid.rotation
            out.append(piece)
    for piece in out:
        piece.at, piece.turn = translation + rotation @ piece.at, rotation @ piece.turn
        piece.link, piece.joint, piece.distal = "tool", joint, True
    return out


class Arm:
    """A robot with a tool, as this script sees it; ``own``: made of the judge's spheres."""

    def __init__(self, name: str, tool: Any, own: bool) -> None:
        self.name = f"{name} with {type(tool).__name__}"
        self.robot = with_tool(load_robot(name), tool)
        with resources.as_file(
            resources.files("optipromp.core.robots") / "data" / f"{name}.urdf"
        ) as p:
            self.model = pin.buildModelFromUrdf(str(p))
        self.data = self.model.createData()
        frame = self.model.frames[self.model.getFrameId("flange")]
        flange = frame.parentJoint, frame.placement.rotation, frame.placement.translation
        spheres = self.robot.spheres
        balls = [
            Piece("sphere", (float(r),), None, np.array(c), np.eye(3), self.robot.link_names[k],
                  int(s) + 1, bool(d))
            for s, c, r, k, d in zip(*spheres, strict=True)
        ]  # fmt: skip
        self.pieces = balls
        if not own:
            if name == "panda":
                self.pieces = self._links() + solids(tool, flange)
            else:
                self.pieces = [b for b in balls if b.link != "tool"] + solids(tool, flange)
        self.bodies = [piece.coals() for piece in self.pieces]
        self.joints = np.array([piece.joint for piece in self.pieces])
        self.at = np.array([piece.at for piece in self.pieces])
        self.turn = np.array([piece.turn for piece in self.pieces])
        self.distal = np.array([piece.distal for piece in self.pieces])
        low, high = self.robot.lower, self.robot.upper
        self.reach = np.array([piece.reach() for piece in self.pieces])
        self.low, self.high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
        reach = 0.1 + max(np.linalg.norm(p.at) + np.abs(p.points()).max() for p in self.pieces)
        steps = [np.linalg.norm(j.translation) for j in self.model.jointPlacements][1:]
        steps += [0.51] if name == "scara" else []  # the lift's range
        self.levers = np.array([reach + sum(steps[j + 1 :]) for j in range(self.model.nq)])

    def _links(self) -> list[Piece]:
        folder = models() / "panda_description" / "meshes" / "collision"
        last, out = self.robot.n_joints, []
        for i in range(last + 1):
            mesh = trimesh.load(folder / f"link{i}.stl", force="mesh")
            corners = np.array(trimesh.convex.convex_hull(mesh).vertices)
            piece = Piece("mesh", (), corners, link=f"link{i}", joint=i, distal=i == last)
            if i == 0:  # without its rim
                piece, _ = cut(piece, np.array([0.0, 0.0, 1.0]), RIM)
            if i == 6:  # its end, in which link 7 turns, counts with link 7
                place = self.model.jointPlacements[7]
                along = place.rotation[:, 2]
                end, piece = cut(piece, along, END + along @ place.translation)
                out.append(replace(end, distal=True))
            out.append(piece)
        return out

    def poses(self, q: Any) -> tuple[Any, Any]:
        """World rotations (k, 3, 3) and positions (k, 3) of the pieces."""
        pin.forwardKinematics(self.model, self.data, q)
        turns = np.array([pose.rotation for pose in self.data.oMi])[self.joints]
        places = np.array([pose.translation for pose in self.data.oMi])[self.joints]
        return turns @ self.turn, places + np.einsum("kij,kj->ki", turns, self.at)


@lru_cache(maxsize=1)
def prism() -> MeshTool:
    """A tool of a mesh: a solid prism with six sides."""
    angle = np.arange(6) * np.pi / 3
    ring = 0.03 * np.column_stack([np.cos(angle), np.sin(angle)])
    points = [np.column_stack([ring, np.full(6, z)]) for z in (0.0, 0.12)]
    mesh = trimesh.convex.convex_hull(np.concatenate(points))
    return MeshTool((MeshShape(np.array(mesh.vertices), np.array(mesh.faces)),), (0.0, 0.0, 0.13))


def arms(own: bool) -> list[Arm]:
    """Both built-in arms with their tools."""
    cups = Cup(0.05), Cup(0.03, 0.08, 0.2, opening=0.05), Cup(0.08, 0.05, 0.0)
    both = (*cups, FingerGripper(0.08), Scissor(0.05), prism())
    return [Arm("panda", tool, own) for tool in (*both, FrankaHand())] + [
        Arm("scara", tool, own) for tool in both
    ]
