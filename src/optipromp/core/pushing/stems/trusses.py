r"""Stems that grow from other stems: what a truss adds to the beams of :mod:`.bending`.

A truss is a tree of straight beams. A force on a fruit moves the fruit by the bending of its stem,
and by the motion of the stem's root on the stems that carry it. Both motions follow from the
influence functions of each beam, by the finite differences of a single stem: static condensation
of the whole tree.

A twist is (t, ω): motion and turn at a point [m, rad]. A wrench is (f, m) [N, N m].
"""

from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray


class StemTree(NamedTuple):
    """N stems of one or more trusses."""

    parent: IntArray  # (N,) index of the stem that each stem grows from; -1 for a held root
    share: FloatArray  # (N,) of the parent's length at which the stem grows
    root: FloatArray  # (N, 3) [m]
    axes: FloatArray  # (N, 3, 3) as of :class:`.bending.Stems`
    length: FloatArray  # (N,) [m]

    def ancestors(self, i: int) -> list[tuple[int, float]]:
        """The stems that carry stem i, and the share of each at which the next one grows."""
        out = []
        while self.parent[i] >= 0:
            out.append((int(self.parent[i]), float(self.share[i])))
            i = int(self.parent[i])
        return out


def tree(parent: IntArray, root: FloatArray, axes: FloatArray, length: FloatArray) -> StemTree:
    """The tree of N stems; each root is projected on the chord of its parent."""
    along = ((root - root[parent]) * axes[parent, 2]).sum(axis=1) / length[parent]
    return StemTree(parent, np.clip(along, 0.0, 1.0), root, axes, length)


def carried(
    t: StemTree, weight: FloatArray, up: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """The load of each stem: its fruit, and the stems that grow from it.

    ``t``: the tree. ``weight``: (N,) of the fruits [N]. ``up``: (3,) opposite to gravity.
    ``count``: number of elements of a stem.

    Returns: Weight (N, count) that hangs beyond each element [N], and the integral (N,) of the
    bending moment along each stem [N m²].
    """
    middle = (np.arange(count) + 0.5) / count
    fruit = t.root + t.length[:, None] * t.axes[:, 2]
    here = t.root[:, None] + (t.length[:, None] * middle)[..., None] * t.axes[:, None, 2]
    beyond = np.tile(weight[:, None], count)
    moment = weight[:, None, None] * (fruit[:, None] - here)
    for i in range(len(weight)):
        for a, share in t.ancestors(i):
            held = middle < share
            beyond[a, held] += weight[i]
            moment[a, held] += weight[i] * (fruit[i] - here[a, held])
    level = moment - (moment @ up)[..., None] * up
    return beyond, np.linalg.norm(level, axis=2).sum(axis=1) * t.length / count


class Bent(NamedTuple):
    """Bending of the stems of a truss under the weight that each carries."""

    influence: FloatArray  # (N, n, n) deflections of the grid by forces on it, roots held [m/N]
    turned: FloatArray  # (N, n + 1) deflections of root and grid [m] where the root turns by one
    # radian and the weight pulls the stem back to the plumb


def bending(t: StemTree, stiffness: FloatArray, tension: FloatArray) -> Bent:
    """Solve the beams, those that hang on others first.

    The weight of a fruit pulls its stem back where the root turns. So a stem is a spring on the
    slope of its parent, of stiffness sᵀBs - (Bs)ᵀA⁻¹Bs with the places s of the grid's points, the
    whole stiffness A and the stiffness B of the tension.

    ``t``: the tree. ``stiffness``: (N, n, n) of the grid's points of each single stem [N/m].
    ``tension``: (N, n, n) part of the stiffness that is due to the tension [N/m].
    """
    count, n = len(t.parent), stiffness.shape[1]
    influence, turned = np.zeros((count, n, n)), np.zeros((count, n + 1))
    springs = np.zeros((count, n, n))
    for i in sorted(range(count), key=lambda k: -len(t.ancestors(k))):
        influence[i] = np.linalg.inv(stiffness[i] + springs[i])
        s = t.length[i] * np.arange(1, n + 1) / n
        pulled = (tension[i] + springs[i]) @ s
        turned[i, 1:] = s - influence[i] @ pulled
        if t.parent[i] >= 0:
            _, slope = _weights(n, float(t.share[i]), t.length[t.parent[i]])
            spring = float(turned[i, 1:] @ pulled)
            springs[t.parent[i]] += spring * np.outer(slope, slope)[1:, 1:]
    return Bent(influence, turned)


def condensed(t: StemTree, bent: Bent) -> tuple[FloatArray, FloatArray]:
    """The compliance of roots and of fruits through the stems that they share.

    Returns: Twist (N, 6, 6) of each root by a wrench on it, zero for a held root; and the motion
    (N, N, 3, 3) of each fruit by a force on another fruit, zero on the diagonal [m/N].
    """
    count = len(t.parent)
    base, joint = np.zeros((count, 6, 6)), np.zeros((count, count, 3, 3))
    tops = [t.ancestors(i)[-1][0] if t.parent[i] >= 0 else i for i in range(count)]
    for i in range(count):
        base[i] = _root(t, bent, i)
        for j in range(i):
            if tops[i] == tops[j]:
                joint[i, j] = _between(t, bent, (i, 1.0), (j, 1.0))[:3, :3]
                joint[j, i] = joint[i, j].T
    return base, joint


Place = tuple[int, float]  # a stem, and a share of it


def _root(t: StemTree, bent: Bent, i: int) -> FloatArray:
    """Twist (6, 6) of the root of stem i by a wrench on it."""
    if t.parent[i] < 0:
        return np.zeros((6, 6))
    at = int(t.parent[i]), float(t.share[i])
    return _between(t, bent, at, at)


def _between(t: StemTree, bent: Bent, of: Place, by: Place) -> FloatArray:
    """Twist (6, 6) of a place ``of`` by a wrench at a place ``by``, in the world's axes."""
    (i, share), (j, other) = of, by
    if i == j:
        lever, force = _carried_along(t, bent, i, share), _carried_along(t, bent, i, other)
        return _beam(t, bent, i, share, other) + lever @ _root(t, bent, i) @ force.T
    if len(t.ancestors(i)) < len(t.ancestors(j)):
        return _between(t, bent, by, of).T
    at = int(t.parent[i]), float(t.share[i])
    return np.asarray(_carried_along(t, bent, i, share) @ _between(t, bent, at, by))


def _weights(n: int, share: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Weights (n + 1,) of root and grid in the deflection and in the slope at a share of a stem."""
    value, slope = np.zeros(n + 1), np.zeros(n + 1)
    k = min(int(share * n), n - 1)
    value[k : k + 2] = 1.0 - (share * n - k), share * n - k
    slope[k : k + 2] = np.array([-1.0, 1.0]) * n / length
    return value, slope


def _carried_along(t: StemTree, bent: Bent, i: int, share: float) -> FloatArray:
    """Twist (6, 6) of a share of stem i by the twist of its root."""
    value, slope = _weights(bent.turned.shape[1] - 1, share, t.length[i])
    x, y, z = (value @ bent.turned[i]) * t.axes[i, 2]
    out = np.eye(6)
    out[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    out[3:, 3:] *= slope @ bent.turned[i]
    return out


def _beam(t: StemTree, bent: Bent, i: int, share: float, other: float) -> FloatArray:
    """Twist (6, 6) of a share of stem i by a wrench at the share ``other``, root held."""
    n = bent.influence.shape[1]
    left, right = (np.stack(_weights(n, at, t.length[i]))[:, 1:] for at in (share, other))
    plane = left @ bent.influence[i] @ right.T
    out = np.zeros((6, 6))
    for e in t.axes[i, :2]:
        ways = np.zeros((6, 2))
        ways[:3, 0], ways[3:, 1] = e, np.cross(t.axes[i, 2], e)
        out += ways @ plane @ ways.T
    return out


def sideways(base: FloatArray, axes: FloatArray, turned: FloatArray) -> FloatArray:
    """Compliance (n + 1, n + 1) of root and grid across a stem by the compliance of its root.

    ``base`` (6, 6) is the compliance of the root; ``turned`` (n + 1,) see :class:`Bent`. The result
    is the mean of the two directions across, which the model takes to be equal.
    """
    out = np.zeros((len(turned), len(turned)))
    for e in axes[:2]:
        ways = np.column_stack(
            [np.tile(e, (len(turned), 1)), turned[:, None] * np.cross(axes[2], e)]
        )
        out += 0.5 * ways @ base @ ways.T
    return out
