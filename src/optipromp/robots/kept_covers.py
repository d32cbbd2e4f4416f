"""Covers of a robot's shapes, kept on disk under the hash of what they cover."""

import hashlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.files import cache_folder, npz, read_bytes, read_npz, write_atomically

_COVERS_VERSION = 11  # part of the cache key: raise it when the same shapes get other covers


class Cover(NamedTuple):
    """Spheres (k, 4), centres and radii [m], and how far they reach beyond what they cover [m].

    ``parts`` (c, 4): see :mod:`optipromp.robots.surfaces`; empty of spheres that were given.
    """

    spheres: FloatArray
    excess: float
    parts: FloatArray = np.zeros((0, 4))


class Covered(NamedTuple):
    """What a cover depends on: the kind and sizes of a shape, its file, and whether it is fixed."""

    kind: str
    size: tuple[float, ...]
    mesh: Path | None
    fixed: bool


def cache_file(shapes: Sequence[Covered]) -> Path | None:
    """The file that holds the covers of these shapes; meshes are told apart by their content.

    The cache folder is ``OPTIPROMP_CACHE``, else the platform's. None without one, and where a mesh
    cannot be read: its reader says what is wrong.
    """
    folder = cache_folder()
    if folder is None:
        return None
    digest = hashlib.sha256(f"{_COVERS_VERSION}".encode())
    for shape in shapes:
        digest.update(f" {shape.kind} {shape.size} {shape.fixed}".encode())
        if shape.mesh is not None:
            try:
                content = read_bytes(shape.mesh, InvalidRequestError)
            except InvalidRequestError:
                return None
            digest.update(f" {shape.mesh.suffix.lower()} {len(content)} ".encode())
            digest.update(content)
    return folder / "covers" / f"{digest.hexdigest()}.npz"


def load_covers(file: Path, count: int) -> list[Cover] | None:
    """The covers in a cache file; None where there is none, or none that can be used."""
    try:
        data = read_npz(file)
        rows = [np.asarray(data[f"{i}"], dtype=np.float64) for i in range(count)]
        parts = [np.asarray(data[f"parts {i}"], dtype=np.float64) for i in range(count)]
    except (InvalidRequestError, KeyError, TypeError, ValueError):
        return None
    for row, part in zip(rows, parts, strict=True):
        usable = row.ndim == 2 and row.shape[1] == 4 and len(row) > 1
        usable = usable and part.shape[1:] == (4,) and bool(np.isfinite(part).all())
        if not (usable and np.isfinite(row).all() and (row[:-1, 3] > 0.0).all()):
            return None
    both = zip(rows, parts, strict=True)
    return [Cover(row[:-1], float(row[-1, 0]), part) for row, part in both]


def keep_covers(file: Path, covers: Sequence[Cover]) -> None:
    """Write a cache file; one that cannot be written is no error: covers are made again."""
    arrays = {f"{i}": np.vstack([c.spheres, [c.excess] * 4]) for i, c in enumerate(covers)}
    arrays |= {f"parts {i}": c.parts for i, c in enumerate(covers)}
    with suppress(InvalidRequestError):
        write_atomically(file, npz(arrays))
