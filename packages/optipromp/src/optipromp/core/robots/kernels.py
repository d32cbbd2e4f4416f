r"""Kinematics kernels: one serial chain of moving segments, many configurations.

Fixed joints are merged when the robot is built, so a segment is a moving joint and what it carries.
With the parent's frame :math:`(R_{s-1}, o_{s-1})` segment *s* stands at

.. math:: o_s = o_{s-1} + R_{s-1} t_s \;(+\, a_s\, q),\qquad
          R_s = R_{s-1} F_s \,\exp([a_s]_\times q)

where :math:`q` is the value of the independent joint ``dof[s]`` times ``multiplier[s]`` plus
``offset[s]`` (a mimic joint shares its driver's ``dof``).

Forces pull back without a Jacobian: the forces on the points that segment *s* and everything after
it carry are summed to a wrench :math:`(f, m)` about the world origin; the generalised force of a
revolute joint is :math:`a\cdot(m - o\times f)`, of a prismatic one :math:`a\cdot f`.
"""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.compiled import called, inner, kernel

REVOLUTE = 0
PRISMATIC = 1


class Kinematics(NamedTuple):
    """A serial chain of S moving segments driven by n independent joints."""

    kind: IntArray  # (S,) REVOLUTE or PRISMATIC
    rotation: FloatArray  # (S, 3, 3) joint frame at zero in the parent segment's frame
    translation: FloatArray  # (S, 3) [m]
    axis: FloatArray  # (S, 3) unit, in the joint frame
    dof: IntArray  # (S,) independent joint that drives the segment
    multiplier: FloatArray  # (S,) 1 unless mimic
    offset: FloatArray  # (S,) 0 unless mimic [rad or m]


@inner
def chain_frames(kin, q, origins, rotations, axes):
    """Frames of every segment at one configuration.

    ``q`` (n,) → ``origins`` (S, 3), ``rotations`` (S, 3, 3), world joint ``axes`` (S, 3), in place.
    """
    r00, r01, r02 = 1.0, 0.0, 0.0
    r10, r11, r12 = 0.0, 1.0, 0.0
    r20, r21, r22 = 0.0, 0.0, 1.0
    ox, oy, oz = 0.0, 0.0, 0.0
    for s in range(kin.kind.shape[0]):
        t = kin.translation[s]
        ox += r00 * t[0] + r01 * t[1] + r02 * t[2]
        oy += r10 * t[0] + r11 * t[1] + r12 * t[2]
        oz += r20 * t[0] + r21 * t[1] + r22 * t[2]
        f = kin.rotation[s]
        m00 = r00 * f[0, 0] + r01 * f[1, 0] + r02 * f[2, 0]
        m01 = r00 * f[0, 1] + r01 * f[1, 1] + r02 * f[2, 1]
        m02 = r00 * f[0, 2] + r01 * f[1, 2] + r02 * f[2, 2]
        m10 = r10 * f[0, 0] + r11 * f[1, 0] + r12 * f[2, 0]
        m11 = r10 * f[0, 1] + r11 * f[1, 1] + r12 * f[2, 1]
        m12 = r10 * f[0, 2] + r11 * f[1, 2] + r12 * f[2, 2]
        m20 = r20 * f[0, 0] + r21 * f[1, 0] + r22 * f[2, 0]
        m21 = r20 * f[0, 1] + r21 * f[1, 1] + r22 * f[2, 1]
        m22 = r20 * f[0, 2] + r21 * f[1, 2] + r22 * f[2, 2]
        ax, ay, az = kin.axis[s, 0], kin.axis[s, 1], kin.axis[s, 2]
        wx = m00 * ax + m01 * ay + m02 * az
        wy = m10 * ax + m11 * ay + m12 * az
        wz = m20 * ax + m21 * ay + m22 * az
        value = kin.multiplier[s] * q[kin.dof[s]] + kin.offset[s]
        if kin.kind[s] == PRISMATIC:
            ox += wx * value
            oy += wy * value
            oz += wz * value
            r00, r01, r02 = m00, m01, m02
            r10, r11, r12 = m10, m11, m12
            r20, r21, r22 = m20, m21, m22
        else:
            c, sn = math.cos(value), math.sin(value)
            v = 1.0 - c
            e00, e01, e02 = ax * ax * v + c, ax * ay * v - az * sn, ax * az * v + ay * sn
            e10, e11, e12 = ax * ay * v + az * sn, ay * ay * v + c, ay * az * v - ax * sn
            e20, e21, e22 = ax * az * v - ay * sn, ay * az * v + ax * sn, az * az * v + c
            r00 = m00 * e00 + m01 * e10 + m02 * e20
            r01 = m00 * e01 + m01 * e11 + m02 * e21
            r02 = m00 * e02 + m01 * e12 + m02 * e22
            r10 = m10 * e00 + m11 * e10 + m12 * e20
            r11 = m10 * e01 + m11 * e11 + m12 * e21
            r12 = m10 * e02 + m11 * e12 + m12 * e22
            r20 = m20 * e00 + m21 * e10 + m22 * e20
            r21 = m20 * e01 + m21 * e11 + m22 * e21
            r22 = m20 * e02 + m21 * e12 + m22 * e22
        origins[s, 0], origins[s, 1], origins[s, 2] = ox, oy, oz
        axes[s, 0], axes[s, 1], axes[s, 2] = wx, wy, wz
        rotations[s, 0, 0], rotations[s, 0, 1], rotations[s, 0, 2] = r00, r01, r02
        rotations[s, 1, 0], rotations[s, 1, 1], rotations[s, 1, 2] = r10, r11, r12
        rotations[s, 2, 0], rotations[s, 2, 1], rotations[s, 2, 2] = r20, r21, r22


@called
def frames(kin, q, origins, rotations, axes):
    """Frames of every segment at T configurations: ``q`` (T, n), outputs (T, S, …), in place."""
    for t in range(q.shape[0]):
        chain_frames(kin, q[t], origins[t], rotations[t], axes[t])


@called
def carried_points(segment, local, origins, rotations, out):
    """World positions of points carried by segments.

    ``segment`` (B,), -1 for the fixed base; ``local`` (B, 3); frames at T configurations;
    ``out`` (T, B, 3), in place.
    """
    for t in range(origins.shape[0]):
        for b in range(segment.shape[0]):
            s = segment[b]
            x, y, z = local[b, 0], local[b, 1], local[b, 2]
            if s < 0:
                out[t, b, 0], out[t, b, 1], out[t, b, 2] = x, y, z
                continue
            r = rotations[t, s]
            o = origins[t, s]
            out[t, b, 0] = o[0] + r[0, 0] * x + r[0, 1] * y + r[0, 2] * z
            out[t, b, 1] = o[1] + r[1, 0] * x + r[1, 1] * y + r[1, 2] * z
            out[t, b, 2] = o[2] + r[2, 0] * x + r[2, 1] * y + r[2, 2] * z


@called
def distances_between(one, other, i, j, out):
    """Distances ``out`` (m, P) of points ``one[:, i]`` and ``other[:, j]`` (m, P, 3), in place."""
    for t in range(one.shape[0]):
        for p in range(i.shape[0]):
            x = one[t, i[p], 0] - other[t, j[p], 0]
            y = one[t, i[p], 1] - other[t, j[p], 1]
            z = one[t, i[p], 2] - other[t, j[p], 2]
            out[t, p] = math.sqrt(x * x + y * y + z * z)


@inner
def tool_at(origins, rotations, tool_point, tool_axis, point, direction):
    """Tool point and axis (3,) at one configuration, from the frames of its segments, in place."""
    o, r = origins[-1], rotations[-1]
    for i in range(3):
        point[i] = o[i] + (
            r[i, 0] * tool_point[0] + r[i, 1] * tool_point[1] + r[i, 2] * tool_point[2]
        )
        direction[i] = r[i, 0] * tool_axis[0] + r[i, 1] * tool_axis[1] + r[i, 2] * tool_axis[2]


@kernel
def tool_poses(kin, q, tool_point, tool_axis, points, directions):
    """Tool point and axis at M configurations: ``q`` (M, n) → (M, 3), (M, 3), in place."""
    n_segments = kin.kind.shape[0]
    origins = np.empty((n_segments, 3))
    rotations = np.empty((n_segments, 3, 3))
    axes = np.empty((n_segments, 3))
    for m in range(q.shape[0]):
        chain_frames(kin, q[m], origins, rotations, axes)
        tool_at(origins, rotations, tool_point, tool_axis, points[m], directions[m])


@kernel
def tool_rows(kin, origins, axes, point, direction, jp, ja):
    """Jacobians of tool point ``jp`` (3, n) and tool axis ``ja`` (3, n) at one configuration."""
    jp[:] = 0.0
    ja[:] = 0.0
    for s in range(kin.kind.shape[0]):
        j = kin.dof[s]
        k = kin.multiplier[s]
        wx, wy, wz = axes[s, 0], axes[s, 1], axes[s, 2]
        if kin.kind[s] == PRISMATIC:
            jp[0, j] += k * wx
            jp[1, j] += k * wy
            jp[2, j] += k * wz
            continue
        dx, dy, dz = point[0] - origins[s, 0], point[1] - origins[s, 1], point[2] - origins[s, 2]
        jp[0, j] += k * (wy * dz - wz * dy)
        jp[1, j] += k * (wz * dx - wx * dz)
        jp[2, j] += k * (wx * dy - wy * dx)
        ja[0, j] += k * (wy * direction[2] - wz * direction[1])
        ja[1, j] += k * (wz * direction[0] - wx * direction[2])
        ja[2, j] += k * (wx * direction[1] - wy * direction[0])


@kernel
def tool_jacobians(kin, q, tool_point, tool_axis, points, directions, jp, ja):
    """Tool point, axis and their Jacobians at M configurations, ``jp`` and ``ja`` (M, 3, n)."""
    n_segments = kin.kind.shape[0]
    origins = np.empty((n_segments, 3))
    rotations = np.empty((n_segments, 3, 3))
    axes = np.empty((n_segments, 3))
    for m in range(q.shape[0]):
        chain_frames(kin, q[m], origins, rotations, axes)
        tool_at(origins, rotations, tool_point, tool_axis, points[m], directions[m])
        tool_rows(kin, origins, axes, points[m], directions[m], jp[m], ja[m])


@kernel
def pull_back(kin, segment, points, forces, origins, axes, out):
    r"""Generalised forces :math:`\sum_b J_b^\top f_b` at T configurations, added to ``out`` (T, n).

    ``segment`` (B,), ``points`` and ``forces`` (T, B, 3) in the world frame.
    """
    n_segments = kin.kind.shape[0]
    wrench = np.empty((n_segments, 6))
    for t in range(points.shape[0]):
        wrench[:] = 0.0
        for b in range(segment.shape[0]):
            s = segment[b]
            fx, fy, fz = forces[t, b, 0], forces[t, b, 1], forces[t, b, 2]
            if s < 0 or (fx == 0.0 and fy == 0.0 and fz == 0.0):
                continue
            x, y, z = points[t, b, 0], points[t, b, 1], points[t, b, 2]
            w = wrench[s]
            w[0] += fx
            w[1] += fy
            w[2] += fz
            w[3] += y * fz - z * fy
            w[4] += z * fx - x * fz
            w[5] += x * fy - y * fx
        fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for s in range(n_segments - 1, -1, -1):
            w = wrench[s]
            fx += w[0]
            fy += w[1]
            fz += w[2]
            mx += w[3]
            my += w[4]
            mz += w[5]
            a = axes[t, s]
            if kin.kind[s] == PRISMATIC:
                g = a[0] * fx + a[1] * fy + a[2] * fz
            else:
                o = origins[t, s]
                g = (
                    a[0] * (mx - (o[1] * fz - o[2] * fy))
                    + a[1] * (my - (o[2] * fx - o[0] * fz))
                    + a[2] * (mz - (o[0] * fy - o[1] * fx))
                )
            out[t, kin.dof[s]] += kin.multiplier[s] * g
