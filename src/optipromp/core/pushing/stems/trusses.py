r"""Stems that grow from other stems: what a truss adds to the beams of :mod:`.bending`.

A truss is a tree of straight beams. A force on one of its fruits moves the fruit by its own stem's
bending, and by the motion of the stem's root on the stems that it hangs on. Both follow from the
influence functions of each beam, by the same finite differences as of a single stem: static
condensation of the whole tree.

A twist is (t, ω): the motion of a point and the turn there [m, rad]. A wrench is (f, m) [N, N m].
"""

from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray


class StemTree(NamedTuple):
    """N stems of one or more trusses.

    Attributes:
        parent: (N,) the stem that each grows from, -1 where its root is held.
        share: (N,) of the parent's length at which it grows.
        root: (N, 3) [m]; ``axes`` (N, 3, 3) and ``length`` (N,) as of the stems.
    """

    parent: IntArray
    share: FloatArray
    root: FloatArray
    axes: FloatArray
    length: FloatArray

    def ancestors(self, i: int) -> list[tuple[int, float]]:
        """The stems that stem i hangs on, and the share of each at which what carries i begins."""
        out = []
        while self.parent[i] >= 0:
            out.append((int(self.parent[i]), float(self.share[i])))
            i = int(self.parent[i])
        return out


def tree(parent: IntArray, root: FloatArray, axes: FloatArray, length: FloatArray) -> StemTree:
    """The tree of N stems; a root counts as on its parent's chord, where it is level with it."""
    along = ((root - root[parent]) * axes[parent, 2]).sum(axis=1) / length[parent]
    return StemTree(parent, np.clip(along, 0.0, 1.0), root, axes, length)


def carried(
    t: StemTree, weight: FloatArray, up: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """What stems carry for others.

    Args:
        t: the tree.
        weight: (N,) of the fruits [N].
        up: (3,) opposite to gravity.
        count: of elements on each stem.

    Returns:
        Weight (N, count) that hangs beyond each element, its own fruit's included [N]; and the
        integral (N,) of the bending moment along each stem [N m²].
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
    """How the stems of a truss bend, with all that hangs on each.

    Attributes:
        influence: (N, n, n) deflection of the grid's points by a force at each, roots held [m/N].
        turned: (N, n + 1) motion of the grid's points across the stem, the root first, where the
            root turns by one radian and what hangs on the stem pulls it back to the plumb [m].
    """

    influence: FloatArray
    turned: FloatArray


def bending(t: StemTree, stiffness: FloatArray, tension: FloatArray) -> Bent:
    """Solve the beams, those that hang on others first.

    A stem whose root turns is pulled back by its fruit's weight: it is a spring on the slope of the
    stem that it hangs on, of stiffness sᵀBs - (Bs)ᵀA⁻¹Bs for places s, all stiffness A and that of
    the tension B.

    Args:
        t: the tree.
        stiffness: (N, n, n) of the grid's points of each stem alone [N/m].
        tension: (N, n, n) the part of it that is due to the tension [N/m].
    """
    count, n = len(t.parent), stiffness.shape[1]
    influence, turned = np.zeros((count, n, n)), np.zeros((count, n + 1))
    springs: dict[int, FloatArray] = {}
    for i in sorted(range(count), key=lambda k: -len(t.ancestors(k))):
        added = springs.get(i, np.zeros((n, n)))
        influence[i] = np.linalg.inv(stiffness[i] + added)
        s = t.length[i] * np.arange(1, n + 1) / n
        pulled = (tension[i] + added) @ s
        turned[i, 1:] = s - influence[i] @ pulled
        if t.parent[i] >= 0:
            own = int(t.parent[i])
            _, slope = _weights(n, float(t.share[i]), t.length[own])
            spring = float(turned[i, 1:] @ pulled)
            springs[own] = (
                springs.get(own, np.zeros((n, n))) + spring * np.outer(slope, slope)[1:, 1:]
            )
    return Bent(influence, turned)


def condensed(t: StemTree, bent: Bent) -> tuple[FloatArray, FloatArray]:
    """The compliance of roots and of fruits through the stems that they share.

    Returns:
        Twist (N, 6, 6) of each root by a wrench there, zero where it is held; and the motion
        (N, N, 3, 3) of each fruit by a force on another one, zero on the diagonal [m/N].
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
    """The twist (6, 6) of the root of stem i by a wrench there."""
    if t.parent[i] < 0:
        return np.zeros((6, 6))
    at = int(t.parent[i]), float(t.share[i])
    return _between(t, bent, at, at)


def _between(t: StemTree, bent: Bent, of: Place, by: Place) -> FloatArray:
    """The twist (6, 6) of one place by a wrench at another, in the world's axes."""
    (i, share), (j, other) = of, by
    if i == j:
        lever, force = _carried_along(t, bent, i, share), _carried_along(t, bent, i, other)
        return _beam(t, bent, i, share, other) + lever @ _root(t, bent, i) @ force.T
    if len(t.ancestors(i)) < len(t.ancestors(j)):
        return _between(t, bent, by, of).T
    at = int(t.parent[i]), float(t.share[i])
    return np.asarray(_carried_along(t, bent, i, share) @ _between(t, bent, at, by))


def _weights(n: int, share: float, length: float) -> tuple[FloatArray, FloatArray]:
    """Of the grid's points (n + 1,), root first: for the value at a share of a stem, the slope."""
    value, slope = np.zeros(n + 1), np.zeros(n + 1)
    k = min(int(share * n), n - 1)
    value[k : k + 2] = 1.0 - (share * n - k), share * n - k
    slope[k : k + 2] = np.array([-1.0, 1.0]) * n / length
    return value, slope


def _carried_along(t: StemTree, bent: Bent, i: int, share: float) -> FloatArray:
    """The twist (6, 6) of a place of stem i by the twist of its root."""
    value, slope = _weights(bent.turned.shape[1] - 1, share, t.length[i])
    x, y, z = (value @ bent.turned[i]) * t.axes[i, 2]
    out = np.eye(6)
    out[:3, 3:] = [[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]]
    out[3:, 3:] *= slope @ bent.turned[i]
    return out


def _beam(t: StemTree, bent: Bent, i: int, share: float, other: float) -> FloatArray:
    """The twist (6, 6) of a share of stem i by a wrench at another one, its root held."""
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
    """Motion (n + 1, n + 1) across a stem through the compliance of its root, at its grid's points.

    ``base`` (6, 6) is that compliance, ``axes`` (3, 3) and ``turned`` (n + 1,) are the stem's. It
    is the mean of the two directions across, which the model takes to be alike.
    """
    out = np.zeros((len(turned), len(turned)))
    for e in axes[:2]:
        ways = np.column_stack(
            [np.tile(e, (len(turned), 1)), turned[:, None] * np.cross(axes[2], e)]
        )
        out += 0.5 * ways @ base @ ways.T
    return out
