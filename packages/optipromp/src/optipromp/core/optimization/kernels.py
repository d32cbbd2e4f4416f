r"""Kernels of the costs: distances to obstacles, a force with stiffness, the Gauss-Newton matrix.

Costs in the workspace depend on *points*: the B body spheres, the tool point, and a second point on
the tool axis (the tip). A cost reads the positions of points. It adds its gradient with respect to
the points to ``force`` (T, B+2, 3), and a positive semi-definite curvature to ``stiffness``
(T, B+2, 6), stored as xx, yy, zz, xy, xz, yz. The curvature of the tip is with respect to the
vector from the tool point to the tip, because costs of the tool's axis depend on this vector.
:func:`optipromp.core.robots.kernels.pull_back` pulls forces back to the joints,
:func:`add_stiffness` the stiffnesses.
"""

import numpy as np

from optipromp.core.compiled import inner, kernel
from optipromp.core.geometry.distances import distance_and_gradient
from optipromp.core.geometry.obstacles import cell_at
from optipromp.core.geometry.shapes import GRID, SPHERE
from optipromp.core.robots.kernels import PRISMATIC


@inner
def add_along(force, stiffness, push, k, x, y, z):
    """Add ``push``·n to a point's ``force`` (3,) and ``k``·n nᵀ to its ``stiffness`` (6,)."""
    force[0] += push * x
    force[1] += push * y
    force[2] += push * z
    stiffness[0] += k * x * x
    stiffness[1] += k * y * y
    stiffness[2] += k * z * z
    stiffness[3] += k * x * y
    stiffness[4] += k * x * z
    stiffness[5] += k * y * z


@kernel
def clearance_field(
    points, radius, link_start, link_bound, link_distal, obstacles, shared, cutoff, distance, normal
):
    """Distance from every body sphere's surface to the nearest obstacle, at most ``cutoff``.

    ``points`` (T, B+2+L, 3) holds the bounding-sphere centres of the L links after the spheres and
    the two tool points. Obstacles from index ``shared`` on concern only links that are not distal.
    Writes ``distance`` (T, B) and the outward ``normal`` (T, B, 3), 0 where the distance is the
    cutoff.
    """
    distance[:] = cutoff
    normal[:] = 0.0
    for t in range(points.shape[0]):
        for link in range(link_start.shape[0] - 1):
            c = points[t, radius.shape[0] + 2 + link]
            for k in range(shared if link_distal[link] else obstacles.kind.shape[0]):
                o = obstacles.position[k]
                ox, oy, oz, reach = o[0], o[1], o[2], obstacles.bound[k] + cutoff
                far = reach + link_bound[link]
                if (c[0] - ox) ** 2 + (c[1] - oy) ** 2 + (c[2] - oz) ** 2 >= far * far:
                    continue
                if SPHERE < obstacles.kind[k] < GRID:  # not round, and exact
                    d, _, _, _ = distance_and_gradient(obstacles, k, c[0], c[1], c[2])
                    if d >= cutoff + link_bound[link]:
                        continue
                for b in range(link_start[link], link_start[link + 1]):
                    x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
                    far = reach + radius[b]
                    if (x - ox) ** 2 + (y - oy) ** 2 + (z - oz) ** 2 >= far * far:
                        continue
                    d, nx, ny, nz = distance_and_gradient(obstacles, k, x, y, z)
                    if d - radius[b] < distance[t, b]:
                        distance[t, b] = d - radius[b]
                        normal[t, b, 0], normal[t, b, 1], normal[t, b, 2] = nx, ny, nz


@kernel
def clearance_in_cells(
    points, radius, link_start, link_distal, obstacles, shared, cutoff, distance, normal
):
    """:func:`clearance_field` for ``obstacles`` with cells: a sphere meets only those of its cell.

    The time hardly grows with the number of obstacles. The reach of the cells must be at least
    ``cutoff`` plus the largest radius.
    """
    cells = obstacles.cells
    distance[:] = cutoff
    normal[:] = 0.0
    for t in range(points.shape[0]):
        for link in range(link_start.shape[0] - 1):
            stop = shared if link_distal[link] else obstacles.kind.shape[0]
            for b in range(link_start[link], link_start[link + 1]):
                x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
                cell = cell_at(cells, x, y, z)
                for i in range(cells.start[cell], cells.start[cell + 1]):
                    k = cells.member[i]
                    if k >= stop:
                        break
                    o, far = obstacles.position[k], obstacles.bound[k] + cutoff + radius[b]
                    if (x - o[0]) ** 2 + (y - o[1]) ** 2 + (z - o[2]) ** 2 >= far * far:
                        continue
                    d, nx, ny, nz = distance_and_gradient(obstacles, k, x, y, z)
                    if d - radius[b] < distance[t, b]:
                        distance[t, b] = d - radius[b]
                        normal[t, b, 0], normal[t, b, 1], normal[t, b, 2] = nx, ny, nz


@kernel
def add_stiffness(kin, segment, points, stiffness, origins, axes, band, first, out):
    r"""The banded Gauss-Newton matrix :math:`\sum_b J_b^\top C_b J_b` plus the joint-space bands.

    The point stiffnesses of each segment are gathered as 6×6 spatial stiffnesses about the world
    origin and summed down the chain, as forces are; then
    :math:`H_{ij} = s_i^\top K_{\max(i,j)} s_j` with the joints' twists s. ``out``
    ((bandwidth+1), N) is LAPACK's lower banded form for waypoints ``first`` … ``first + N/n − 1``.
    ``band`` (T, 3, n) couples a waypoint with itself, the next and the one after.
    """
    n, n_segments, n_points = band.shape[2], kin.kind.shape[0], stiffness.shape[1]
    spatial, twist = np.empty((n_segments, 6, 6)), np.empty((n_segments, 6))
    jacobian, kt, block = np.zeros((3, 6)), np.empty(6), np.empty((n, n))
    count = out.shape[1] // n
    out[:] = 0.0
    for u in range(count):
        t, last = first + u, -1
        spatial[:] = 0.0
        block[:] = 0.0
        for b in range(n_points):
            s, c = segment[b], stiffness[t, b]
            if s < 0 or (c[0] == 0.0 and c[1] == 0.0 and c[2] == 0.0):
                continue
            last = max(last, s)
            # a point moves by v + ω × x; the tip about the tool point by ω × x alone
            x, y, z, moves = points[t, b, 0], points[t, b, 1], points[t, b, 2], 1.0
            if b == n_points - 1:
                x, y, z, moves = (
                    x - points[t, b - 1, 0],
                    y - points[t, b - 1, 1],
                    z - points[t, b - 1, 2],
                    0.0,
                )
            jacobian[0, 0] = jacobian[1, 1] = jacobian[2, 2] = moves
            jacobian[0, 4], jacobian[1, 5], jacobian[2, 3] = z, x, y
            jacobian[0, 5], jacobian[1, 3], jacobian[2, 4] = -y, -z, -x
            for j in range(6):
                vx, vy, vz = jacobian[0, j], jacobian[1, j], jacobian[2, j]
                fx = c[0] * vx + c[3] * vy + c[4] * vz
                fy = c[3] * vx + c[1] * vy + c[5] * vz
                fz = c[4] * vx + c[5] * vy + c[2] * vz
                for i in range(6):
                    spatial[s, i, j] += (
                        jacobian[0, i] * fx + jacobian[1, i] * fy + jacobian[2, i] * fz
                    )
        for s in range(last + 1):
            a, o, g = axes[t, s], origins[t, s], kin.multiplier[s]
            if kin.kind[s] == PRISMATIC:
                for i in range(3):
                    twist[s, i], twist[s, 3 + i] = g * a[i], 0.0
            else:
                twist[s, 0] = g * (o[1] * a[2] - o[2] * a[1])
                twist[s, 1] = g * (o[2] * a[0] - o[0] * a[2])
                twist[s, 2] = g * (o[0] * a[1] - o[1] * a[0])
                twist[s, 3], twist[s, 4], twist[s, 5] = g * a[0], g * a[1], g * a[2]
        for s in range(last, -1, -1):
            for i in range(6):
                kt[i] = 0.0
                for j in range(6):
                    if s < last:
                        spatial[s, i, j] += spatial[s + 1, i, j]
                    kt[i] += spatial[s, i, j] * twist[s, j]
            for p in range(s + 1):
                v = 0.0
                for i in range(6):
                    v += twist[p, i] * kt[i]
                i, j = kin.dof[p], kin.dof[s]
                block[i, j] += v
                if p != s:
                    block[j, i] += v
        for j in range(n):
            column = u * n + j
            for i in range(j, n):
                out[i - j, column] += block[i, j]
            out[0, column] += band[t, 0, j]
            if u + 1 < count:
                out[n, column] += band[t, 1, j]
            if u + 2 < count:
                out[2 * n, column] += band[t, 2, j]
