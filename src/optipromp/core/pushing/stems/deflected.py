"""Kernels of one deflected stem of :class:`optipromp.core.pushing.stems.bending.Stems`.

``u[i]`` (2L,) are the deflections of the loaded points of stem i: L along the first direction
across the stem, then L along the second [m]. Kernels take the arrays of all stems and the index of
a stem: counting the references of a slice would cost more than the kernel itself.
"""

from typing import NamedTuple

from optipromp.core.arrays import FloatArray
from optipromp.core.compiled import inlined, inner
from optipromp.core.pushing.stems.bending import LOADED, Stems

LOADS = len(LOADED)


class Descent(NamedTuple):
    """Gauss-Newton on the energy of one stem after the other."""

    inertia: FloatArray  # (N,) mass of the fruits over the squared time of a step [N/m]
    free: FloatArray  # (N, L, L) inverse of stiffness plus inertia of each stem [m/N]
    gradient: FloatArray  # (2L,) of the energy of the present stem [N]
    inverse: FloatArray  # (2L, 2L) of the Hessian of that energy [m/N]
    j: FloatArray  # (2L,) see :func:`press`
    v: FloatArray  # (2L,) see :func:`press`
    eased: FloatArray  # (N,) share of a Gauss-Newton step that is taken
    last: FloatArray  # (N, 2L) last step [m]


@inlined
def shortened(s: Stems, u: FloatArray, i: int) -> float:
    """Height by which the deflections of a stem lift its fruit: ½ uᵀ S u [m]."""
    up = 0.0
    for a in range(LOADS):
        for b in range(LOADS):
            both = u[i, a] * u[i, b] + u[i, LOADS + a] * u[i, LOADS + b]
            up += 0.5 * s.shortening[i, a, b] * both
    return up


@inlined
def place(
    s: Stems, u: FloatArray, i: int, chord: float, share: float
) -> tuple[float, float, float]:
    """Position of the point at a share of a stem; ``chord`` is the distance root to fruit [m]."""
    root, axes, shape = s.root, s.axes, s.shape
    n = shape.shape[1] - 1
    k = min(int(share * n), n - 1)
    t = share * n - k
    w1 = w2 = 0.0
    for a in range(LOADS):
        w = (1.0 - t) * shape[i, k, a] + t * shape[i, k + 1, a]
        w1 += w * u[i, a]
        w2 += w * u[i, LOADS + a]
    along = chord * share
    return (
        root[i, 0] + w1 * axes[i, 0, 0] + w2 * axes[i, 1, 0] + along * axes[i, 2, 0],
        root[i, 1] + w1 * axes[i, 0, 1] + w2 * axes[i, 1, 1] + along * axes[i, 2, 1],
        root[i, 2] + w1 * axes[i, 0, 2] + w2 * axes[i, 1, 2] + along * axes[i, 2, 2],
    )


@inlined
def level(s: Stems, i: int, x: float, y: float, z: float) -> float:
    """Share of a straight stem that is level with a point; 0 beyond the ends of the stem."""
    root, axes = s.root, s.axes
    d = (
        (x - root[i, 0]) * axes[i, 2, 0]
        + (y - root[i, 1]) * axes[i, 2, 1]
        + (z - root[i, 2]) * axes[i, 2, 2]
    )
    share = d / s.length[i]
    return share if 0.0 < share < 1.0 else 0.0


@inner
def freely(s: Stems, i: int, d: Descent) -> None:
    """``d.free[i]`` (L, L): inverse of the stiffness plus the fruit's inertia [m/N]."""
    last = LOADS - 1
    shared = 1.0 / d.inertia[i] + s.compliance[i, last, last]
    for a in range(LOADS):
        for b in range(LOADS):
            both = s.compliance[i, a, last] * s.compliance[i, b, last]
            d.free[i, a, b] = s.compliance[i, a, b] - both / shared


@inlined
def begin(s: Stems, u: FloatArray, ahead: FloatArray, i: int, d: Descent) -> None:
    """``d.gradient`` and ``d.inverse`` of the energy of stem and inertia, without contacts."""
    gradient, inverse = d.gradient, d.inverse
    for a in range(LOADS):
        g1 = g2 = 0.0
        for b in range(LOADS):
            k = s.stiffness[i, a, b]
            g1 += k * (u[i, b] - s.rest[i, b])
            g2 += k * (u[i, LOADS + b] - s.rest[i, LOADS + b])
            inverse[a, b] = inverse[LOADS + a, LOADS + b] = d.free[i, a, b]
            inverse[a, LOADS + b] = inverse[LOADS + a, b] = 0.0
        gradient[a], gradient[LOADS + a] = g1, g2
    for a in (LOADS - 1, 2 * LOADS - 1):
        gradient[a] += d.inertia[i] * (u[i, a] - ahead[i, a])


@inlined
def press(
    s: Stems, u: FloatArray, i: int, share: float, way: tuple[float, float, float], depth: float,
    spring: float, d: Descent,
) -> None:  # fmt: skip
    """Add a spring [N/m], compressed by ``depth`` [m], that pushes a share of a stem along ``way``.

    With ``d.j`` the derivative of the spring's length by the deflections, the Hessian grows by
    ``spring`` j jᵀ. Its inverse follows by Sherman and Morrison's formula; ``d.v`` is scratch.
    """
    axes, shape, inverse, j, v = s.axes, s.shape, d.inverse, d.j, d.v
    nx, ny, nz = way
    n = shape.shape[1] - 1
    k = min(int(share * n), n - 1)
    t = share * n - k
    n1 = nx * axes[i, 0, 0] + ny * axes[i, 0, 1] + nz * axes[i, 0, 2]
    n2 = nx * axes[i, 1, 0] + ny * axes[i, 1, 1] + nz * axes[i, 1, 2]
    n3 = share * (nx * axes[i, 2, 0] + ny * axes[i, 2, 1] + nz * axes[i, 2, 2])
    for a in range(LOADS):
        w = (1.0 - t) * shape[i, k, a] + t * shape[i, k + 1, a]
        d1 = d2 = 0.0
        for b in range(LOADS):
            d1 += s.shortening[i, a, b] * u[i, b]
            d2 += s.shortening[i, a, b] * u[i, LOADS + b]
        j[a] = w * n1 - n3 * d1
        j[LOADS + a] = w * n2 - n3 * d2
    yielding = 1.0 / spring
    for a in range(2 * LOADS):
        total = 0.0
        for b in range(2 * LOADS):
            total += inverse[a, b] * j[b]
        v[a] = total
        yielding += total * j[a]
    for a in range(2 * LOADS):
        d.gradient[a] -= spring * depth * j[a]
        total = v[a] / yielding
        for b in range(2 * LOADS):
            inverse[a, b] -= total * v[b]
