"""Kernels of one deflected stem of :class:`optipromp.pushing.stems.bending.Stems`.

The deflections ``u[i]`` (2L,) are those of the stem's loaded points, off the straight line, along
the first direction across it, then along the second. Kernels take the arrays of all stems and the
index of one, because a slice would count references, which costs more than these kernels do.
"""

from optipromp.arrays import FloatArray
from optipromp.compiled import inner
from optipromp.pushing.stems.bending import LOADED

LOADS = len(LOADED)


@inner
def shortened(shortening: FloatArray, u: FloatArray, i: int) -> float:
    """How far a stem's deflections lift its fruit [m]."""
    up = 0.0
    for a in range(LOADS):
        for b in range(LOADS):
            both = u[i, a] * u[i, b] + u[i, LOADS + a] * u[i, LOADS + b]
            up += 0.5 * shortening[i, a, b] * both
    return up


@inner
def place(
    root: FloatArray, axes: FloatArray, shape: FloatArray, u: FloatArray, i: int, length: float,
    share: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Position of the point at a share of a stem whose chord from root to fruit is ``length``."""
    n = shape.shape[1] - 1
    k = min(int(share * n), n - 1)
    t = share * n - k
    w1 = w2 = 0.0
    for a in range(LOADS):
        w = (1.0 - t) * shape[i, k, a] + t * shape[i, k + 1, a]
        w1 += w * u[i, a]
        w2 += w * u[i, LOADS + a]
    along = length * share
    return (
        root[i, 0] + w1 * axes[i, 0, 0] + w2 * axes[i, 1, 0] + along * axes[i, 2, 0],
        root[i, 1] + w1 * axes[i, 0, 1] + w2 * axes[i, 1, 1] + along * axes[i, 2, 1],
        root[i, 2] + w1 * axes[i, 0, 2] + w2 * axes[i, 1, 2] + along * axes[i, 2, 2],
    )


@inner
def level(
    root: FloatArray, axes: FloatArray, i: int, length: float, x: float, y: float, z: float
) -> float:
    """Share of a stem at rest that is level with a point; 0 beyond its ends."""
    d = (
        (x - root[i, 0]) * axes[i, 2, 0]
        + (y - root[i, 1]) * axes[i, 2, 1]
        + (z - root[i, 2]) * axes[i, 2, 2]
    )
    share = d / length
    return share if 0.0 < share < 1.0 else 0.0


@inner
def freely(compliance: FloatArray, inertia: float, i: int, free: FloatArray) -> None:
    """The inverse (L, L) of stiffness and inertia [N/m] of the fruit, into ``free[i]``."""
    last = LOADS - 1
    shared = 1.0 / inertia + compliance[i, last, last]
    for a in range(LOADS):
        for b in range(LOADS):
            both = compliance[i, a, last] * compliance[i, b, last]
            free[i, a, b] = compliance[i, a, b] - both / shared


@inner
def begin(
    stiffness: FloatArray, rest: FloatArray, free: FloatArray, u: FloatArray, ahead: FloatArray,
    i: int, inertia: float, gradient: FloatArray, inverse: FloatArray,
) -> None:  # fmt: skip
    """Energy of stem and inertia: gradient (2L,) and inverse Hessian (2L, 2L)."""
    for a in range(LOADS):
        g1 = g2 = 0.0
        for b in range(LOADS):
            k = stiffness[i, a, b]
            g1 += k * (u[i, b] - rest[i, b])
            g2 += k * (u[i, LOADS + b] - rest[i, LOADS + b])
            inverse[a, b] = inverse[LOADS + a, LOADS + b] = free[i, a, b]
            inverse[a, LOADS + b] = inverse[LOADS + a, b] = 0.0
        gradient[a], gradient[LOADS + a] = g1, g2
    for a in (LOADS - 1, 2 * LOADS - 1):
        gradient[a] += inertia * (u[i, a] - ahead[i, a])


@inner
def press(
    axes: FloatArray, shape: FloatArray, shortening: FloatArray, u: FloatArray, i: int,
    share: float, nx: float, ny: float, nz: float, depth: float, spring: float, j: FloatArray,
    v: FloatArray, gradient: FloatArray, inverse: FloatArray,
) -> None:  # fmt: skip
    """Add a spring [N/m], pressed by ``depth``, that pushes a share of a stem along (nx, ny, nz).

    With j the derivative of its length by the deflections, the Hessian grows by ``spring`` j jᵀ:
    its inverse follows by Sherman and Morrison's formula. ``j`` and ``v`` (2L,) are written to.
    """
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
            d1 += shortening[i, a, b] * u[i, b]
            d2 += shortening[i, a, b] * u[i, LOADS + b]
        j[a] = w * n1 - n3 * d1
        j[LOADS + a] = w * n2 - n3 * d2
    yielding = 1.0 / spring
    for a in range(2 * LOADS):
        s = 0.0
        for b in range(2 * LOADS):
            s += inverse[a, b] * j[b]
        v[a] = s
        yielding += s * j[a]
    for a in range(2 * LOADS):
        gradient[a] -= spring * depth * j[a]
        s = v[a] / yielding
        for b in range(2 * LOADS):
            inverse[a, b] -= s * v[b]
