"""The Gauss-Newton matrix from the stiffness of points and joints."""

import numpy as np
from numba import njit

from optipromp.robots.kernels import PRISMATIC


@njit(cache=True, error_model="numpy", nogil=True)
def add_stiffness(kin, segment, points, stiffness, origins, axes, band, first, out):  # type: ignore[no-untyped-def]
    r"""The banded Gauss-Newton matrix :math:`\sum_b J_b^\top C_b J_b` plus the joint-space bands.

    The point stiffnesses of each segment are gathered as 6×6 spatial stiffnesses about the world
    origin and summed down the chain, as forces are; then
    :math:`H_{ij} = s_i^\top K_{\max(i,j)} s_j` with the joints' twists s. ``out``
    ((bandwidth+1), N) is LAPACK's lower banded form for the knots ``first`` … ``first + N/n − 1``;
    ``band`` (T, 3, n) couples a knot with itself, the next and the one after.
    """
    n = band.shape[2]
    n_segments = kin.kind.shape[0]
    n_points = stiffness.shape[1]
    spatial = np.empty((n_segments, 6, 6))
    twist = np.empty((n_segments, 6))
    used = np.empty(n_segments, dtype=np.bool_)
    block = np.empty((n, n))
    kt = np.empty(6)
    count = out.shape[1] // n
    out[:] = 0.0
    for u in range(count):
        t = first + u
        used[:] = False
        for b in range(n_points):
            s = segment[b]
            c = stiffness[t, b]
            if s < 0 or (c[0] == 0.0 and c[1] == 0.0 and c[2] == 0.0):
                continue
            if not used[s]:
                spatial[s, :, :] = 0.0
                used[s] = True
            x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
            if b == n_points - 1:  # the tip moves about the tool point: rotation only
                x -= points[t, b - 1, 0]
                y -= points[t, b - 1, 1]
                z -= points[t, b - 1, 2]
            k = spatial[s]
            c00, c11, c22, c01, c02, c12 = c[0], c[1], c[2], c[3], c[4], c[5]
            # M = C·(−[x]×): velocity of the point is v − x × ω
            m00, m01, m02 = -c01 * z + c02 * y, c00 * z - c02 * x, -c00 * y + c01 * x
            m10, m11, m12 = -c11 * z + c12 * y, c01 * z - c12 * x, -c01 * y + c11 * x
            m20, m21, m22 = -c12 * z + c22 * y, c02 * z - c22 * x, -c02 * y + c12 * x
            if b < n_points - 1:
                k[0, 0] += c00
                k[0, 1] += c01
                k[0, 2] += c02
                k[1, 1] += c11
                k[1, 2] += c12
                k[2, 2] += c22
                k[0, 3] += m00
                k[0, 4] += m01
                k[0, 5] += m02
                k[1, 3] += m10
                k[1, 4] += m11
                k[1, 5] += m12
                k[2, 3] += m20
                k[2, 4] += m21
                k[2, 5] += m22
            # (−[x]×)ᵀ M = [x]× M
            k[3, 3] += -z * m10 + y * m20
            k[3, 4] += -z * m11 + y * m21
            k[3, 5] += -z * m12 + y * m22
            k[4, 4] += z * m01 - x * m21
            k[4, 5] += z * m02 - x * m22
            k[5, 5] += -y * m02 + x * m12
        last = -1
        for s in range(n_segments - 1, -1, -1):
            if used[s]:
                last = s
                break
        block[:] = 0.0
        if last >= 0:
            for s in range(last + 1):
                a, o = axes[t, s], origins[t, s]
                g = kin.multiplier[s]
                if kin.kind[s] == PRISMATIC:
                    twist[s, 0], twist[s, 1], twist[s, 2] = g * a[0], g * a[1], g * a[2]
                    twist[s, 3], twist[s, 4], twist[s, 5] = 0.0, 0.0, 0.0
                else:
                    twist[s, 0] = g * (o[1] * a[2] - o[2] * a[1])
                    twist[s, 1] = g * (o[2] * a[0] - o[0] * a[2])
                    twist[s, 2] = g * (o[0] * a[1] - o[1] * a[0])
                    twist[s, 3], twist[s, 4], twist[s, 5] = g * a[0], g * a[1], g * a[2]
            for s in range(last, -1, -1):
                k = spatial[s]
                if not used[s]:
                    k[:, :] = 0.0
                if s < last:
                    up = spatial[s + 1]
                    for i in range(6):
                        for j in range(i, 6):
                            k[i, j] += up[i, j]
                for i in range(6):
                    v = 0.0
                    for j in range(6):
                        v += (k[i, j] if i <= j else k[j, i]) * twist[s, j]
                    kt[i] = v
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
