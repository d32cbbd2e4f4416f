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


def misnamed(folder: Path, kind: str, index: int) -> Path:
    """A tetrahedron whose second face names vertex ``index`` in place of its last; binary: PLY."""
    import trimesh

    file = folder / f"part.{'ply' if kind == 'binary' else kind}"
    how = {"ply": {"encoding": "ascii"}, "obj": {"include_normals": True}}.get(kind, {})
    trimesh.Trimesh(TETRAHEDRON, FACES, process=False).export(file, **how)
    texts = {"obj": ("f 1//1 2//2 ", "4"), "off": ("3 0 1 ", "3"), "ply": ("3 0 1 ", "3")}
    if kind in texts:
        before, last = (part.encode() for part in texts[kind])
        new = f"{index}".encode()
    else:
        before = np.array([0, 1], dtype="<i4").tobytes()
        last, new = (np.array([k], dtype="<i4").tobytes() for k in (3, index))
    content = file.read_bytes()
    assert content.count(before + last) == 1
    file.write_bytes(content.replace(before + last, before + new))
    return file


def with_mesh(file: str) -> str:
    body = f'<collision><geometry><mesh filename="{file}"/></geometry></collision>'
    links = f'<link name="a"/><link name="b">{body}</link>'
    return f'<robot name="r">{links}{joint("ab", "a", "b")}</robot>'
