"""The distances of :mod:`optipromp.readers.fit`, in compiled loops that hold no matrix of them."""

import math

import numpy as np

from optipromp.core.compiled import inner, kernel


@inner
def costs(points, centers, depth, out):
    """The excess ``out`` (n, m) [m] of covering points (n, 3) from ``centers`` (3, m) at ``depth``
    (m,), in place; see :mod:`optipromp.readers.fit`."""
    for i in range(points.shape[0]):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        for j in range(depth.shape[0]):
            x, y, z = a - centers[0, j], b - centers[1, j], c - centers[2, j]
            out[i, j] = math.sqrt(x * x + y * y + z * z) - depth[j]


@inner
def farthest(points, centers, out):
    """Distance ``out`` (m,) [m] of each centre (3, m) from its farthest point of ``points`` (n, 3),
    in place."""
    out[:] = 0.0
    for i in range(points.shape[0]):
        a, b, c = points[i, 0], points[i, 1], points[i, 2]
        for j in range(out.shape[0]):
            x, y, z = a - centers[0, j], b - centers[1, j], c - centers[2, j]
            square = x * x + y * y + z * z
            out[j] = square if square > out[j] else out[j]
    for j in range(out.shape[0]):
        out[j] = math.sqrt(out[j])


@inner
def largest(cost, rows, out):
    """The maximum ``out`` (m,) over ``rows`` (k,) of ``cost`` (n, m), in place."""
    out[:] = -np.inf
    for i in rows:
        for j in range(out.shape[0]):
            out[j] = cost[i, j] if cost[i, j] > out[j] else out[j]


@kernel
def owners(pieces, centers, radius, owner, beyond):
    """The ball beyond which the corners of each piece (n, c, 3) reach the least: index ``owner``
    (n,) and distance ``beyond`` (n,) [m], in place. Balls: ``centers`` (k, 3), ``radius`` (k,)."""
    for i in range(pieces.shape[0]):
        beyond[i] = np.inf
        for k in range(centers.shape[0]):
            out = -np.inf
            for c in range(pieces.shape[1]):
                x = pieces[i, c, 0] - centers[k, 0]
                y = pieces[i, c, 1] - centers[k, 1]
                z = pieces[i, c, 2] - centers[k, 2]
                out = max(out, math.sqrt(x * x + y * y + z * z) - radius[k])
            if out < beyond[i]:
                beyond[i], owner[i] = out, k


@kernel
def first_of_cells(points, edge, shape, out):
    """Indices ``out`` of the first point of points (n, 3) in each cell of a grid of ``shape`` (3,),
    in place. Returns the number of cells that hold points."""
    seen, count = np.zeros(shape[0] * shape[1] * shape[2], np.bool_), 0
    for i in range(points.shape[0]):
        code = 0
        for j in range(3):
            code = code * shape[j] + max(math.floor(points[i, j] / edge), 0)
        if not seen[code]:
            seen[code] = True
            out[count] = i
            count += 1
    return count
