"""The judge's distances: from a point to each kind of shape, and a scene's objects as arrays.

Kernels measure simple shapes; meshes and point clouds are measured in NumPy. No gradients.
"""

import functools
from collections.abc import Sequence
from itertools import chain
from math import hypot, sqrt
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, lengths
from optipromp.core.compiled import called, inlined, inner
from optipromp.core.geometry import shapes
from optipromp.core.scenes.objects import Role
from optipromp.core.scenes.scene import Scene, SceneObject

STATIC, AVOID, AVOID_BY_TOOL, PUSHABLE, STEM = range(5)  # roles; rows of smallest distances
ROLES: dict[Role, int] = {"static": STATIC, "avoid": AVOID, "pushable": PUSHABLE}
BLOCK = 4  # objects in a block; of 4, 8, 16 and 32 the fastest among 1,000 obstacles
CELL = 0.05  # [m] edge of a cell whose objects are neighbours; about the size of a fruit
PAIRS = 50_000  # of points and triangles measured at once, which take about 30 MB: chosen


class Objects(NamedTuple):
    """K objects of simple shape, in C blocks of near objects of one role."""

    rows: IntArray  # (K,) in the scene's N objects; of a piece of a stem: N + row of the object
    kind: IntArray  # (K,)
    role: IntArray  # (K,)
    position: FloatArray  # (K, 3) [m]
    rotation: FloatArray  # (K, 3, 3) local to world
    size: FloatArray  # (K, 3) radius / half sizes / radius, half length, tip / radii [m]
    bound: FloatArray  # (K,) radius of a ball about the position that holds the object [m]
    block: IntArray  # (C + 1,) where each block begins
    block_middle: FloatArray  # (C, 3) centre of a ball that holds the objects' balls [m]
    block_bound: FloatArray  # (C,) radius of this ball [m]


@functools.lru_cache(maxsize=8)
def objects_of(
    scene: Scene, counted: frozenset[int] | None = None
) -> tuple[Objects, tuple[SceneObject, ...]]:
    """Objects of simple shape as arrays, and the meshes and point clouds.

    Objects that move are left out, and a target that stands. One that hangs counts as stems do.
    Stems are capsules. ``counted``: indices of the objects whose bodies and stems count; None: all.
    """
    role = np.full(len(scene.objects), -1)
    for name, code in ROLES.items():
        role[scene.rows(name)] = code
    if scene.target is not None and scene.target.stem is not None:
        role[scene.rows("target")] = STEM
    moves = [motion is not None and motion.fastest > 0.0 for motion in scene.columns["motion"]]
    counts = ~np.array(moves, dtype=np.bool_)
    if counted is not None:  # what moves: see judging/moving.py
        counts &= np.isin(np.arange(len(role)), list(counted))
    role[~counts] = -1
    kind, size, bound = measured(scene.columns["shape"])
    owner, middle, turn, capsule = scene.strands
    rows = np.concatenate([np.arange(len(role)), len(role) + owner])
    role = np.concatenate([role, np.where(counts[owner], STEM, -1)])
    kind = np.concatenate([kind, np.full(len(owner), shapes.CAPSULE)])
    size, bound = np.vstack([size, capsule]), np.append(bound, capsule.sum(axis=1))
    position = np.vstack([scene.positions, middle])
    rotation = np.concatenate([scene.rotations, turn])
    simple, rest = (
        np.flatnonzero((role >= 0) & each) for each in (kind != shapes.GRID, kind == shapes.GRID)
    )
    simple = simple[_neighbours(role[simple], position[simple], bound[simple])]
    role, position, bound = role[simple], position[simple], bound[simple]
    place = np.arange(len(role))
    first = np.maximum.accumulate(np.where(np.diff(role, prepend=-1) != 0, place, 0))
    start = np.flatnonzero((place - first) % BLOCK == 0)
    ends = np.append(start, len(role))
    low, high = np.minimum.reduceat(position, start), np.maximum.reduceat(position, start)
    middle = 0.5 * (low + high)
    reach = lengths(position - np.repeat(middle, np.diff(ends), axis=0)) + bound
    objects = Objects(
        rows[simple], kind[simple], role, position, rotation[simple], size[simple], bound, ends,
        middle, np.maximum.reduceat(reach, start),
    )  # fmt: skip
    return objects, scene.objects_at(rest)


def names_of(scene: Scene, rows: IntArray) -> list[tuple[str, str]]:
    """Names and roles of the objects in ``rows`` (K,) of :class:`Objects`."""
    count = len(scene.objects)
    items = zip(rows.tolist(), scene.objects_at(rows % max(count, 1)), strict=True)
    return [(item.id if k < count else f"the stem of {item.id}", item.role) for k, item in items]


def measured(of: Sequence[shapes.Shape]) -> tuple[IntArray, FloatArray, FloatArray]:
    """Kinds (K,), sizes (K, 3) and bounds (K,) of shapes, as :class:`Objects` holds them.

    The judge reads shapes itself: a wrong size in ``Shape.measure`` must not deceive both the
    planner and the judge. What is none of these shapes is measured as a mesh or a point cloud.
    """
    kind, size = np.full(len(of), shapes.GRID, dtype=np.int64), np.zeros((len(of), 3))
    bound = np.full(len(of), np.inf)
    for k, shape in shapes.alike(of):
        match shape:
            case shapes.Sphere(radius=r):
                kind[k], size[k, 0], bound[k] = shapes.SPHERE, r, r
            case shapes.Box():
                kind[k], size[k] = shapes.BOX, 0.5 * np.transpose(shape.size)
                bound[k] = np.linalg.norm(size[k], axis=-1)
            case shapes.Cylinder(radius=r, length=h):
                kind[k], size[k, 0], size[k, 1] = shapes.CYLINDER, r, 0.5 * h
                bound[k] = np.hypot(r, 0.5 * h)
            case shapes.Capsule(radius=r, length=h):
                kind[k], size[k, 0], size[k, 1] = shapes.CAPSULE, r, 0.5 * h
                bound[k] = r + 0.5 * h
            case shapes.Ellipsoid(radii=radii):
                kind[k], size[k] = shapes.ELLIPSOID, np.transpose(radii)
                bound[k] = np.max(radii, axis=0)
            case shapes.Cone(radius=r, tip=tip, length=h):
                kind[k], size[k, 0], size[k, 1], size[k, 2] = shapes.CONE, r, 0.5 * h, tip
                bound[k] = 0.5 * h + np.maximum(r, tip)
            case shapes.HalfSpace():
                kind[k] = shapes.HALF_SPACE
            case _:
                bound[k] = shape.measure.bound
    return kind, size, bound


def _neighbours(role: IntArray, position: FloatArray, bound: FloatArray) -> IntArray:
    """An order (K,) of objects: by role, then by size, then along a Z-order curve.

    Sizes ``bound`` [m] are grouped by powers of two, positions by cells of :data:`CELL`.
    """
    _, exponent = np.frexp(bound)
    exponent = np.where(np.isfinite(bound), np.clip(exponent, -15, 15), 16) + 16
    cell = np.clip(position / CELL + 512.0, 0.0, 1023.0).astype(np.int64)
    key = (role * 64 + exponent) << 30
    for bit in range(10):
        for axis in range(3):
            key |= ((cell[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(key, kind="stable")


@called
def to_surface(kind, a, b, c, x, y, z):
    """Signed distance [m] of a point in the shape's frame to a shape of sizes a, b, c."""
    if kind == shapes.SPHERE:
        return sqrt(x * x + y * y + z * z) - a
    if kind == shapes.BOX:
        ax, ay, az = abs(x) - a, abs(y) - b, abs(z) - c
        px, py, pz = max(ax, 0.0), max(ay, 0.0), max(az, 0.0)
        return sqrt(px * px + py * py + pz * pz) + min(max(ax, ay, az), 0.0)
    if kind == shapes.CYLINDER:
        ar, az = sqrt(x * x + y * y) - a, abs(z) - b
        return hypot(max(ar, 0.0), max(az, 0.0)) + min(max(ar, az), 0.0)
    if kind == shapes.CAPSULE:
        dz = z - min(max(z, -b), b)
        return sqrt(x * x + y * y + dz * dz) - a
    if kind == shapes.CONE:
        return _to_cone(a, b, c, sqrt(x * x + y * y), z)
    if kind == shapes.ELLIPSOID:
        return _to_ellipsoid(a, b, c, abs(x), abs(y), abs(z))
    return z


@inner
def _to_cone(a, b, c, rho, z):
    """Distance to the union of balls whose radius changes linearly from c at -b to a at b.

    At the nearest ball, radius and distance from the centre grow along the axis at one rate.
    """
    growth = (a - c) / (2.0 * b)
    share = (z + b + rho * growth / sqrt(1.0 - growth * growth)) / (2.0 * b)
    share = min(max(share, 0.0), 1.0)
    return hypot(rho, z + b - share * 2.0 * b) - (c + share * (a - c))


@inner
def _to_ellipsoid(a, b, c, x, y, z):
    """Distance by bisection of the nearest point's multiplier (Eberly, Distance to an ellipsoid).

    ``over`` is the multiplier less its pole: its digits are not lost near the shape's middle.
    """
    least = min(a, b, c)
    x, y, z = max(x, 1e-13 * least), max(y, 1e-13 * least), max(z, 1e-13 * least)
    a2, b2, c2 = a * a - least * least, b * b - least * least, c * c - least * least
    low, high = 0.0, least * least + sqrt(a * a * x * x + b * b * y * y + c * c * z * z)
    for _ in range(90):
        over = 0.5 * (low + high)
        u, v, w = a * x / (over + a2), b * y / (over + b2), c * z / (over + c2)
        if u * u + v * v + w * w > 1.0:
            low = over
        else:
            high = over
    over = 0.5 * (low + high)
    t = over - least * least
    u, v, w = x / (over + a2), y / (over + b2), z / (over + c2)
    return t * sqrt(u * u + v * v + w * w)


@inner
def to_core(kind, a, b, c, x, y, z):
    """Distance [m] of a point to the paper's core: a sphere's centre, the long axis of a bar."""
    if kind == shapes.HALF_SPACE:
        return z
    if kind == shapes.BOX:
        if a >= b and a >= c:
            x -= min(max(x, -a), a)
        elif b >= c:
            y -= min(max(y, -b), b)
        else:
            z -= min(max(z, -c), c)
    elif kind not in (shapes.SPHERE, shapes.ELLIPSOID):
        z -= min(max(z, -b), b)
    return sqrt(x * x + y * y + z * z)


@inner
def inside(r, p, k, points, i):
    """World point ``i`` of ``points`` in frame ``k``: rotations ``r`` (K, 3, 3), origins ``p``."""
    x, y, z = points[i, 0] - p[k, 0], points[i, 1] - p[k, 1], points[i, 2] - p[k, 2]
    return (
        r[k, 0, 0] * x + r[k, 1, 0] * y + r[k, 2, 0] * z,
        r[k, 0, 1] * x + r[k, 1, 1] * y + r[k, 2, 1] * z,
        r[k, 0, 2] * x + r[k, 1, 2] * y + r[k, 2, 2] * z,
    )


@inlined
def apart_by(a, i, b, j):
    """Distance [m] between point ``i`` of ``a`` (A, 3) and point ``j`` of ``b`` (B, 3)."""
    x, y, z = a[i, 0] - b[j, 0], a[i, 1] - b[j, 1], a[i, 2] - b[j, 2]
    return sqrt(x * x + y * y + z * z)


def nearest(
    item: SceneObject, spheres: FloatArray, radius: FloatArray, limit: float
) -> tuple[float, int, int]:
    """Smallest distance of moving spheres to a mesh or a point cloud.

    ``spheres``, ``radius``: (M, B, 3) centres and (B,) radii [m]. ``limit``: distances above it,
    and above 0, need not be exact [m].

    Returns: The distance [m] (an upper bound where it need not be exact), the index of the sphere,
    and that of the configuration.
    """
    bound = item.shape.measure.bound
    local = (spheres - item.position).reshape(-1, 3) @ item.rotation
    radii = np.tile(radius, len(spheres))
    least = lengths(local) - radii - bound
    first = int(np.argmin(least))
    d = _to_shape(item.shape, local[first : first + 1]) - radii[first]
    rows = np.flatnonzero(least < max(min(limit, float(d[0])), 0.0))
    if len(rows):
        d = _to_shape(item.shape, local[rows]) - radii[rows]
        first = int(rows[np.argmin(d)])
    return float(d.min()), first % len(radius), first // len(radius)


def _to_shape(shape: shapes.Shape, points: FloatArray) -> FloatArray:
    """Signed distances (N,) [m] of ``points`` (N, 3), in the shape's frame, to its surface."""
    if isinstance(shape, shapes.PointCloudShape):
        return np.asarray(_tree(shape).query(points)[0]) - shape.radius
    triangles, middles, wide = _surface(shape.mesh(shapes.FINE))
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    # no triangle whose middle is farther than the nearest middle by ``wide`` is the nearest one
    most = middles.query(points)[0] + wide
    near = middles.query_ball_point(points, most * (1.0 + 1e-9))
    row = np.repeat(np.arange(len(points)), [len(rows) for rows in near])
    pairs = np.stack([row, np.fromiter(chain.from_iterable(near), np.int64, len(row))])
    out = np.full(len(points), np.inf)
    for one, own in np.split(pairs, range(PAIRS, len(row), PAIRS), axis=1):
        np.minimum.at(out, one, _to_triangles(triangles[own] - points[one, None]))
    for k in np.flatnonzero(((points >= low) & (points <= high)).all(axis=1)).tolist():
        out[k] *= 1.0 - 2.0 * (abs(_winding(triangles - points[k])) > 0.5)
    return out


@functools.lru_cache(maxsize=4)
def _tree(cloud: shapes.PointCloudShape) -> Any:
    from scipy.spatial import cKDTree  # slow to import, seldom needed

    return cKDTree(cloud.points)


@functools.lru_cache(maxsize=64)
def _surface(mesh: shapes.MeshShape) -> tuple[FloatArray, Any, float]:
    """The triangles (F, 3, 3) of a mesh, a tree of their middles, and the largest distance of a
    corner from its middle [m]."""
    from scipy.spatial import cKDTree

    triangles = mesh.vertices[mesh.faces]
    middles = triangles.mean(axis=1)
    far = lengths((triangles - middles[:, None]).reshape(-1, 3))
    return triangles, cKDTree(middles), float(far.max())


def _winding(corners: FloatArray) -> float:
    """Turns of a closed surface of triangles (F, 3, 3) about the origin: its solid angle (Van
    Oosterom and Strackee, 1983)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(v, axis=-1) for v in (a, b, c))
    below = la * lb * lc + _dot(a, b) * lc + _dot(b, c) * la + _dot(c, a) * lb
    return float(2.0 * np.arctan2(_dot(a, np.cross(b, c)), below).sum() / (4.0 * np.pi))


def _to_triangles(corners: FloatArray) -> FloatArray:
    """Distances (N,) [m] of the origin to triangles (N, 3, 3)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    foot = (_dot(a, normal) / _dot(normal, normal))[..., None] * normal
    above = np.ones(len(corners), dtype=bool)
    edges = np.full(len(corners), np.inf)
    for first, second in ((a, b), (b, c), (c, a)):
        edge = second - first
        above &= _dot(np.cross(edge, foot - first), normal) >= 0
        share = np.clip(-_dot(first, edge) / _dot(edge, edge), 0, 1)
        edges = np.minimum(edges, np.linalg.norm(first + share[..., None] * edge, axis=-1))
    return np.asarray(np.where(above, np.linalg.norm(foot, axis=-1), edges))


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("...i,...i", a, b))
