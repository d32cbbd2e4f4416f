"""A tool of each kind, and a class of the user's own that has the members of ``Tool``."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from optipromp.core.geometry.shapes import Box, MeshShape
from optipromp.core.robots import (
    Cup,
    FingerGripper,
    FrankaHand,
    MeshTool,
    Scissor,
    Solid,
    Suction,
    Tool,
    cover_solids,
    solids_inertia,
)

SIDES = 8  # of the mesh cup
INNER, OUTER, FLOOR, RIM = 0.022, 0.025, 0.10, 0.14  # [m] of the mesh cup
FACES = [
    (0, 2, 1), (0, 3, 2), (4, 5, 6), (4, 6, 7), (0, 1, 5), (0, 5, 4), (1, 2, 6), (1, 6, 5),
    (2, 3, 7), (2, 7, 6), (3, 0, 4), (3, 4, 7),
]  # fmt: skip


def prism(base: np.ndarray, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of an upright prism over a quadrilateral (4, 2), counter-clockwise."""
    floor, top = (np.column_stack([base, np.full(4, z)]) for z in (low, high))
    return np.concatenate([floor, top]), np.array(FACES)


def joined(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    faces = [faces + start for (_, faces), start in zip(parts, starts, strict=False)]
    return np.concatenate([vertices for vertices, _ in parts]), np.concatenate(faces)


def square(half: float) -> np.ndarray:
    return half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


BAR = prism(square(0.01), 0.0, 0.10)


def cup_parts() -> list[tuple[np.ndarray, np.ndarray]]:
    """Neck, floor and a ring of walls, none of which touches another."""
    parts = [prism(square(0.01), 0.0, 0.096), prism(square(0.017), 0.0965, 0.0995)]
    for k in range(SIDES):
        turn = 2.0 * np.pi * (k + np.array([0.001, 0.999])) / SIDES
        flat = np.cos(np.pi / SIDES)  # so that the middle of a wall is INNER from the axis
        near = INNER / flat * np.column_stack([np.cos(turn), np.sin(turn)])
        far = OUTER * np.column_stack([np.cos(turn), np.sin(turn)])
        parts.append(prism(np.array([far[0], far[1], near[1], near[0]]), FLOOR, RIM))
    return parts


def mesh_cup() -> MeshTool:
    """A cup of 10 convex pieces in one mesh."""
    mesh = MeshShape(*joined(cup_parts()))
    return MeshTool((mesh,), (0.0, 0.0, 0.12), opening=2.0 * INNER, height=RIM - FLOOR)


def probe() -> MeshTool:
    """A solid bar that takes hold of nothing; its tool point is before it."""
    return MeshTool((MeshShape(*prism(square(0.012), 0.0, 0.10)),), (0.0, 0.0, 0.118))


@dataclass(frozen=True)
class Spoon:
    """Of the user's own: a flat box that holds what is over it, turned and off the flange's axis.

    It shares no code with the tools of the library but what these export.
    """

    size: float = 0.04

    fingers = False
    reach, front, tip, depth = 0.10, 0.06, 0.12, 0.02

    @property
    def gripper_radius(self) -> float:
        return self.size / 2.0

    @property
    def mouth(self) -> tuple[float, float]:
        return self.size / 2.0 - 0.002, self.size / 2.0

    @property
    def point(self) -> np.ndarray:
        return np.array([0.01, 0.0, 0.10])

    @property
    def rotation(self) -> np.ndarray:
        return np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

    def solids(self) -> tuple[Solid, ...]:
        half = self.size / 2.0
        turned = float(np.cos(0.3)), 0.0, 0.0, float(np.sin(0.3))
        return (
            Solid("bowl", Box((half, half, 0.01)), np.array([0.01, 0.0, 0.065]), turned, "mouth"),
            Solid("stick", Box((0.01, 0.01, 0.06)), np.array([0.01, 0.0, 0.03]), part="neck"),
        )

    def spheres(self) -> np.ndarray:
        return cover_solids(self.solids())

    def outline(self) -> tuple[np.ndarray, ...]:
        wide = self.size / 2.0
        return (np.array([[-0.10, -wide], [-0.03, -wide], [-0.03, wide], [-0.10, wide]]),)

    def holds(self, begin: np.ndarray, end: np.ndarray) -> np.ndarray:
        x, y, z = 0.5 * (begin + end).T
        return (np.hypot(x, y) < self.mouth[0]) & (np.abs(z) < 0.02)

    def inertia(self, mass: float) -> tuple[np.ndarray, np.ndarray]:
        return solids_inertia(self.solids(), mass)


TOOLS: dict[str, Tool] = {
    "cup": Cup(0.03, opening=0.052),
    "franka_hand": FrankaHand(),
    "finger_gripper": FingerGripper(0.06, turn=0.4),
    "scissor": Scissor(0.05),
    "suction": Suction(0.012),
    "mesh": mesh_cup(),
    "probe": probe(),
    "spoon": Spoon(),
}


def write_obj(path: Path, vertices: np.ndarray, faces: np.ndarray) -> None:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in faces.tolist()]
    path.write_text("\n".join(lines) + "\n")
