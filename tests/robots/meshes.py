"""Robots with meshes."""

from pathlib import Path

import numpy as np
from tests.robots.links import joint

TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]])


FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def mesh(folder: Path, name: str = "part.obj", size: float = 1.0) -> Path:
    import trimesh

    folder.mkdir(parents=True, exist_ok=True)
    trimesh.Trimesh(size * TETRAHEDRON, FACES).export(str(folder / name))
    return folder / name


def with_mesh(file: str) -> str:
    body = f'<collision><geometry><mesh filename="{file}"/></geometry></collision>'
    links = f'<link name="a"/><link name="b">{body}</link>'
    return f'<robot name="r">{links}{joint("ab", "a", "b")}</robot>'
