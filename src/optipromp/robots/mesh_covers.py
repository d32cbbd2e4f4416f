"""Covers of a robot's meshes: fitted once, then kept on disk under the hash of what they cover."""

import hashlib
from collections.abc import Collection, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.files import cache_folder, npz, read_bytes, read_npz, write_atomically
from optipromp.processes import cores
from optipromp.robots.meshes import mesh_file, triangles
from optipromp.robots.urdf import UrdfGeometry, UrdfModel

LOOSE = 0.030  # [m] chosen: excess down to which a cover grows
FIXED = 0.060  # [m] chosen: the same of a link that does not move, but for the arm's base
PER_MESH = 7.5  # spheres, on average over the meshes of a robot: 60 for eight links
_COVERS_VERSION = 8  # part of the cache key: raise it when the same meshes get other covers


class Cover(NamedTuple):
    """Spheres (k, 4), centres and radii [m], and how far they reach beyond what they cover [m].

    ``parts`` (c, 4): see :mod:`optipromp.robots.surfaces`; empty of spheres that were given.
    """

    spheres: FloatArray
    excess: float
    parts: FloatArray = np.zeros((0, 4))


def cover_meshes(
    model: UrdfModel, meshes: Sequence[tuple[str, UrdfGeometry]], fixed: Collection[str] = ()
) -> dict[UrdfGeometry, Cover]:
    """Covers of meshes, each given with its link, in the frames of the meshes.

    Those of links that are ``fixed`` may reach :data:`FIXED` beyond them.

    The spheres are shared out among all meshes, so that they reach about equally far beyond them.
    The cache folder is ``OPTIPROMP_CACHE``, else the platform's; one that cannot be written is no
    error.

    Raises InvalidRobotError for a mesh that is missing, malformed or degenerate.
    """
    first: dict[tuple[Path, tuple[float, ...]], tuple[str, UrdfGeometry]] = {}
    keys = [(mesh_file(model.path, link, shape), shape.size) for link, shape in meshes]
    for key, mesh in zip(keys, meshes, strict=True):
        first.setdefault(key, mesh)
    if not first:
        return {}
    loose = [FIXED if link in fixed else LOOSE for link, _ in first.values()]
    file = _cache_file(list(first), loose)
    covers = None if file is None else _load(file, len(first))
    if covers is None:
        from optipromp.robots.fit import fit_covers
        from optipromp.robots.surfaces import parts

        solids = [triangles(model.path, link, shape) for link, shape in first.values()]
        fitted = fit_covers(solids, PER_MESH, loose)
        with ThreadPoolExecutor(cores()) as pool:
            own = pool.map(parts, [spheres for spheres, _ in fitted], solids)
            covers = [Cover(*cover, part) for cover, part in zip(fitted, own, strict=True)]
        if file is not None:
            arrays = {f"{i}": np.vstack([c.spheres, [c.excess] * 4]) for i, c in enumerate(covers)}
            arrays |= {f"parts {i}": c.parts for i, c in enumerate(covers)}
            with suppress(InvalidRequestError):  # the next run fits them again
                write_atomically(file, npz(arrays))
    of_key = dict(zip(first, covers, strict=True))
    return {shape: of_key[key] for key, (_, shape) in zip(keys, meshes, strict=True)}


def _cache_file(keys: list[tuple[Path, tuple[float, ...]]], loose: list[float]) -> Path | None:
    """The file that holds the covers of these meshes at these scales, by content."""
    folder = cache_folder()
    if folder is None:
        return None
    digest = hashlib.sha256(f"{_COVERS_VERSION} {PER_MESH} {loose}".encode())
    for path, scale in keys:
        try:
            content = read_bytes(path, InvalidRequestError)
        except InvalidRequestError:  # the reader of the mesh says what is wrong
            return None
        digest.update(f" {path.suffix.lower()} {scale} {len(content)} ".encode())
        digest.update(content)
    return folder / "covers" / f"{digest.hexdigest()}.npz"


def _load(file: Path, count: int) -> list[Cover] | None:
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
