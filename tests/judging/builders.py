"""Scenes and trajectories the judge is asked about in tests."""

from typing import Any

import numpy as np
from trimesh.remesh import subdivide

from optipromp.core.geometry import Box, MeshShape, Sphere
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import Scene, SceneObject
from optipromp.core.trajectory import Trajectory

UP = np.array([0.0, 0.0, 1.0])
TURN = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])


def obj(role: Any, shape: Any, at: Any, turn: Any = None, name: str = "object") -> SceneObject:
    return SceneObject(
        name, role, shape, np.asarray(at, float), np.eye(3) if turn is None else turn
    )


def to(goal: Any, *objects: SceneObject) -> Scene:
    return Scene("s", "robot", objects, goal=goal)


def moving(robot: Robot, q: Any, dt: float = 1.0) -> Trajectory:
    """Straight from each waypoint to the next, with a stop at each."""
    q = np.asarray(q, float)
    still = np.zeros_like(q)
    return Trajectory(dt * np.arange(len(q)), q, still, still, robot.joint_names)


def box_mesh(size: tuple[float, float, float], cuts: int = 0) -> MeshShape:
    """A box of 12 triangles, each of which is cut into four ``cuts`` times."""
    half = 0.5 * np.array(size)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half
    faces = [
        (0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1),
        (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3),
    ]  # fmt: skip
    for _ in range(cuts):
        corners, faces = subdivide(corners, np.array(faces))
    return MeshShape(corners, np.array(faces))


def gap(robot: Robot, made: Trajectory, item: SceneObject, who: Any = slice(None)) -> float:
    """Smallest distance of the body spheres ``who`` to a moving ball or upright box.

    Densely sampled, by an interpolation of its own.
    """
    times = np.linspace(0.0, made.duration, 4000)
    at = [np.interp(times, item.motion.times, one) for one in item.motion.positions.T]
    off = robot.sphere_centers(made.sample(times)[0])[:, who] - np.stack(at, axis=1)[:, None]
    if isinstance(item.shape, Sphere):
        away = np.linalg.norm(off, axis=-1) - item.shape.radius
    else:
        assert isinstance(item.shape, Box)
        over = np.abs(off) - 0.5 * np.array(item.shape.size)
        outside = np.linalg.norm(np.maximum(over, 0.0), axis=-1)
        away = outside + np.minimum(over.max(axis=-1), 0.0)
    return float((away - np.asarray(robot.spheres.radius)[who]).min())
