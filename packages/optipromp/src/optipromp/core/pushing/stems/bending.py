r"""Fruits on bending stems, described by few deflections.

A stem is a beam clamped at its root that carries its fruit. Across its axis the deflection w(s)
follows from the energy

.. math:: \tfrac12\int EI\,{w''}^2\,ds + \tfrac12\int T\,{w'}^2\,ds - \sum_k f_k w(s_k)

with the tension T of the fruit's weight. The energy is minimised once, on a fine grid, for loads at
the points ``BEAM.loaded``. For such loads the deflections u of the loaded points describe the whole
stem exactly (static condensation, Guyan 1965): w = W u with energy ½ uᵀ K u, in each of two
directions across the stem. A deflected stem lifts its fruit by ½∫w'² ds = ½ uᵀ S u.

A stem of unknown stiffness has that of green peduncles (a guess, :class:`BeamParameters`). A
leaning stem is at least so stiff that the fruit's weight turns it by the angle that it grew with. A
stem that stands is pressed by the weight in place of the tension; none is softer than
:func:`optipromp.core.scenes.objects.least_stiffness`.

A truss is a tree of straight beams, whose stems grow from other stems. A force on a fruit moves the
fruit by the bending of its stem, and by the motion of the stem's root on the stems that carry it.
Both motions follow from the influence functions of each beam, by the finite differences of a single
stem: static condensation of the whole tree. A twist is (t, ω): motion and turn at a point [m, rad].
A wrench is (f, m) [N, N m].
"""

import itertools
import math
from collections.abc import Sequence
from contextlib import suppress
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpbsv

from optipromp.core.arrays import FloatArray, IntArray, frozen, lengths, read_only
from optipromp.core.compiled import kernel
from optipromp.core.geometry.shapes import Capsule, Cone, PointCloudShape, Shape, Sphere
from optipromp.core.pushing import rules
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.ik import uniform
from optipromp.core.scenes.objects import UNSEEN_SPREAD, least_stiffness
from optipromp.core.scenes.scene import SceneObject

BEAM = PUSH.beam
UP = frozen([0.0, 0.0, 1.0])

_GRID = BEAM.finer * BEAM.elements  # points of the grid on which a beam is solved
_AT = np.round(np.array(BEAM.loaded) * _GRID).astype(int) - 1  # rows of the loaded points
_UNIT = frozen(np.eye(_GRID)[:, _AT])  # 1 N at each loaded point


class Stems(NamedTuple):
    """N fruits on stems with L loaded points each, for the kernels."""

    root: FloatArray  # (N, 3) [m]
    axes: FloatArray  # (N, 3, 3) rows: two directions across the stem, then from root to fruit
    length: FloatArray  # (N,) from the root to the fruit's centre [m]
    mass: FloatArray  # (N,) of the fruits [kg]
    radius: FloatArray  # (N,) of the fruits, of long fruits that of the lower ball [m]
    thickness: FloatArray  # (N,) radius of the stems [m]
    upper: FloatArray  # (N,) share of the stem at a long fruit's upper ball; 1 for a single ball
    above: FloatArray  # (N,) radius of the upper ball [m]
    shape: FloatArray  # (N, elements + 1, L) W: deflections of the grid by those of loaded points
    stiffness: FloatArray  # (N, L, L) K [N/m]
    compliance: FloatArray  # (N, L, L) inverse of K [m/N]
    shortening: FloatArray  # (N, L, L) S [1/m]
    joint: FloatArray  # (N, N, 3, 3) motion of a fruit by a force on another fruit of its truss
    # [m/N]; (N, 0, 3, 3) where no stem grows from another
    rest: FloatArray  # (N, 2L) deflections of the loaded points at rest: the bow of the stem [m]
    lifted: FloatArray  # (N,) arc minus chord of that bow [m]
    drift: FloatArray  # (N, P, 3) of the roots at the points of a path [m]; (N, 0, 3): they stand


def stems(
    objects: Sequence[SceneObject], up: FloatArray = UP, factor: FloatArray | float = 1.0
) -> Stems:
    """Straight stems of hanging fruits; ``up`` and ``factor`` see :func:`bent_stems`."""
    balls = [hanging_balls(fruit) for fruit in objects]
    return bent_stems(
        np.array([t.stem.points[-1] for t in objects if t.stem is not None]).reshape(-1, 3),
        np.array([own.center for own in balls]).reshape(-1, 3),
        np.array([own.radius for own in balls]),
        np.array([t.stem.radius for t in objects if t.stem is not None]),
        up,
        np.array([own.apart for own in balls]),
        np.array([own.above for own in balls]),
        np.array([t.physical.get("mass", np.nan) for t in objects]),
        np.array([t.physical.get("stem_stiffness", np.nan) for t in objects]),
        factor,
        parents(objects),
    )


def parents(objects: Sequence[SceneObject]) -> IntArray:
    """Index (N,) of the object whose stem each stem grows from; -1 for a root that is held."""
    known = {item.id: k for k, item in enumerate(objects)}
    names = [None if item.stem is None else item.stem.parent for item in objects]
    return np.array([-1 if name is None else known.get(name, -1) for name in names], np.int64)


class Balls(NamedTuple):
    """The two balls that the model takes a fruit for, one behind the other along its stem."""

    center: FloatArray  # (3,) of the lower ball [m]
    radius: float  # of the lower ball [m]
    above: float  # radius of the upper ball [m]
    apart: float  # distance of the centres; 0 for a single ball [m]


@lru_cache(maxsize=256)  # by identity: a plan asks several times for each fruit
def hanging_balls(fruit: SceneObject) -> Balls:
    """The balls of a fruit along the line from its centre to its stem's root.

    A capsule and a cone have the balls at their ends; other shapes balls that touch the ends of the
    mesh along the line. A point cloud, and a fruit without a stem, is a single ball that holds it.
    """
    shape, stem = fruit.shape, fruit.stem
    if stem is None or isinstance(shape, Sphere | PointCloudShape):
        return Balls(fruit.position, fruit.radius, fruit.radius, 0.0)
    line = stem.root - fruit.position
    line = fruit.rotation.T @ (line / np.linalg.norm(line))
    if isinstance(shape, Capsule | Cone):
        ends = [getattr(shape, "tip", shape.radius), shape.radius]
        up = 1 if float(line[2]) >= 0.0 else -1
        line, low, apart = np.array([0.0, 0.0, up]), -0.5 * shape.length, shape.length
        radius, above = ends[::up]
    else:
        low, radius, above, apart = _touching(shape, tuple(line.tolist()))
    center = fruit.position + low * (fruit.rotation @ line)
    return Balls(read_only(center), radius, above, apart)


def _touching(shape: Shape, line: tuple[float, ...]) -> tuple[float, float, float, float]:
    with suppress(TypeError):  # a class without a hash is fitted each time
        hash(shape)
        return _fitted(shape, line)
    return _fitted.__wrapped__(shape, line)


@lru_cache(maxsize=256)
def _fitted(shape: Shape, line: tuple[float, ...]) -> tuple[float, float, float, float]:
    """Balls that touch the ends of a mesh along a ``line`` through its origin: place of the lower
    ball's centre on the line, both radii, and the distance of the centres [m]. Of 16 radii for each
    ball: the pair whose hull has the least mean distance from the surface."""
    points, axis = shape.mesh().vertices, np.array(line)
    height = points @ axis
    aside = lengths(points - height[:, None] * axis)
    low, high, wide = float(height.min()), float(height.max()), float(aside.max())
    one = 0.5 * (high - low)
    shares = np.linspace(0.1, 1.0, 16) * min(wide, one)
    best, fit = np.inf, (0.5 * (low + high), one, one, 0.0)
    for radius, above in itertools.product(shares, shares):
        apart = high - low - radius - above
        if apart <= abs(radius - above) + 1e-9:
            continue
        sine = (radius - above) / apart
        share = (height - low - radius + aside * sine / -np.sqrt(1.0 - sine**2)) / apart
        share = np.clip(share, 0.0, 1.0)
        off = np.hypot(aside, height - low - radius - share * apart)
        error = float(np.abs(off - radius - share * (above - radius)).mean())
        if error < best:
            best, fit = error, (low + radius, float(radius), float(above), float(apart))
    return fit


def axis_of(fruit: SceneObject) -> FloatArray:
    """The axis of a fruit: centres (2, 3) of its lower and upper ball, in its local frame [m]."""
    own, stem = hanging_balls(fruit), fruit.stem
    line = np.zeros(3) if stem is None else (stem.root - fruit.position)
    up = own.apart * line / max(float(np.linalg.norm(line)), 1e-12)
    return np.asarray((own.center - fruit.position + [[0.0, 0.0, 0.0], up]) @ fruit.rotation)


def bent_stems(
    root: FloatArray, fruit: FloatArray, radius: FloatArray, thickness: FloatArray,
    up: FloatArray = UP, apart: FloatArray | float = 0.0, above: FloatArray | None = None,
    mass: FloatArray | float = np.nan, stiffness: FloatArray | float = np.nan,
    factor: FloatArray | float = 1.0, parent: IntArray | None = None,
) -> Stems:  # fmt: skip
    """Straight stems of radius ``thickness`` (N,) from roots (N, 3) to fruits (N, 3) [m].

    ``up`` (3,) is opposite to gravity. A long fruit has a second ball of radius ``above`` (N,),
    ``apart`` (N,) from the first towards the root [m]. NaN in ``mass`` (N,) [kg] or ``stiffness``
    EI (N,) [N m²] stands for the assumed value. ``factor`` (N,) multiplies all stiffnesses.
    ``parent``: see :func:`parents`.
    """
    count, n, loaded = len(root), BEAM.finer * BEAM.elements, len(BEAM.loaded)
    length, axes = _frames(root, fruit)
    along = axes[:, 2]
    above = radius if above is None else above
    dense = BEAM.fruit_density
    ball = dense * 4.0 / 3.0 * np.pi * (0.5 * (radius**3 + above**3))
    between_balls = dense * np.pi * apart * (radius**2 + radius * above + above**2) / 3.0
    mass = np.where(np.isnan(mass), ball + between_balls, mass)
    down = along @ up
    x, y, z = (along - down[:, None] * up).T
    lean = np.hypot(np.hypot(x, y), z)
    weight: FloatArray = mass * BEAM.gravity  # (N,), or (N, n) beyond each element
    # the moment m g sinθ (L - s) turns the stem by m g sinθ L² / 2EI
    grown, thick = weight * lean * length**2 / 2.0, np.full(count, BEAM.diameter)
    whole = None
    if parent is not None and (parent >= 0).any():
        share = ((root - root[parent]) * axes[parent, 2]).sum(axis=1) / length[parent]
        whole = StemTree(parent, np.clip(share, 0.0, 1.0), root, axes, length)
        weight, grown = _carried(whole, weight, up, n)
        thick[np.unique(parent[parent >= 0])] = BEAM.truss_diameter
    assumed = np.maximum(BEAM.youngs_modulus * np.pi / 64.0 * thick**4, grown / BEAM.grown_turn)
    load = weight if whole is None else weight[:, 0]
    bending = np.maximum(
        factor * np.where(np.isnan(stiffness), assumed, stiffness),
        least_stiffness(load / BEAM.gravity, length * down, length - above - apart, above + apart),
    )
    tension = weight * (-down if whole is None else -down[:, None])  # below 0: the stem stands
    h = length / n
    stiffer = np.where(
        (np.arange(n) + 0.5) / n > (1.0 - (above + apart) / length)[:, None], BEAM.stiff_end, 1.0
    )
    stiffer[:, 0] *= 0.5  # clamped: the beam is mirrored at its root
    ei = np.zeros((count, n + 2))  # by h³, at the grid's points from the root; none beyond the end
    ei[:, :n] = bending[:, None] * stiffer / h[:, None] ** 3
    pull = (tension if tension.ndim == 2 else tension[:, None]) / h[:, None]
    band = _band(ei, pull)
    compliance = np.array([dpbsv(one, _UNIT, lower=1)[1] for one in band]).reshape(count, n, loaded)
    joint, first = np.zeros((count, 0, 3, 3)), np.zeros((count, 1, loaded))
    if whole is not None:
        solved = bent_by_weight(whole, _full(band), _full(_band(np.zeros_like(ei), pull)))
        base, joint = roots_condensed(whole, solved)
        for k in range(count):
            added = sideways(base[k], axes[k], solved.turned[k])[:, [0, *(_AT + 1)]]
            first[k], compliance[k] = added[0, 1:], solved.influence[k][:, _AT] + added[1:, 1:]
    between = np.ascontiguousarray(compliance[:, _AT])
    condensed = np.linalg.inv(between)
    grid = np.concatenate([first, compliance[:, BEAM.finer - 1 :: BEAM.finer]], axis=1)
    shape = grid @ condensed
    steps = np.diff(shape, axis=1)
    shortening = np.einsum("nki,nkj->nij", steps, steps) / (BEAM.finer * h)[:, None, None]
    return Stems(
        root, axes, length, mass, radius, thickness, 1.0 - apart / length, above, shape, condensed,
        between, shortening, joint, np.zeros((count, 2 * loaded)), np.zeros(count),
        np.zeros((count, 0, 3)),
    )  # fmt: skip


def bowed(straight: Stems, size: FloatArray, turn: FloatArray) -> Stems:
    """The N stems, each with half a sine wave at rest from its root to the surface of its fruit.

    ``size`` (N,) is the height of the wave over the length, ``turn`` (N,) its direction about the
    stem [rad].
    """
    free = straight.upper - straight.above / straight.length  # share without the fruit
    share = np.minimum(np.array(BEAM.loaded) / free[:, None], 1.0)
    off = (size * straight.length)[:, None] * np.sin(np.pi * share)
    rest = np.concatenate([np.cos(turn)[:, None] * off, np.sin(turn)[:, None] * off], axis=1)
    lifted = 0.5 * np.einsum("na,nab,nb->n", off, straight.shortening, off)
    return straight._replace(rest=rest, lifted=lifted)


def _band(ei: FloatArray, pull: FloatArray) -> FloatArray:
    """½∫EI w''² + ½∫T w'² by central differences, as a symmetric band of LAPACK's (N, 3, n).

    ``ei`` (N, n + 2) is EI/h³ at the grid's points. ``pull`` (N, n) is the tension T/h in each
    element [N/m]; (N, 1) for a tension that is equal in all elements.
    """
    n = ei.shape[1] - 2
    pull = np.broadcast_to(pull, (len(ei), n))
    band = np.zeros((len(ei), 3, n))
    beside = pull + np.concatenate([pull[:, 1:], pull[:, -1:]], axis=1)
    band[:, 0] = ei[:, :n] + 4.0 * ei[:, 1:-1] + ei[:, 2:] + beside
    band[:, 0, 0] += 3.0 * ei[:, 0]
    band[:, 0, -1] -= pull[:, -1]
    band[:, 1, :-1] = -2.0 * (ei[:, 1:n] + ei[:, 2:-1]) - pull[:, 1:]
    band[:, 2, :-2] = ei[:, 2:n]
    return band


def _full(band: FloatArray) -> FloatArray:
    """Bands (N, 3, n) as symmetric matrices (N, n, n)."""
    n = band.shape[2]
    out = np.zeros((len(band), n, n))
    for off in range(3):
        k = np.arange(n - off)
        out[:, k, k + off] = out[:, k + off, k] = band[:, off, : n - off]
    return out


def stems_moved(cases: Sequence[Stems], root: FloatArray, fruit: FloatArray) -> Stems:
    """The same N stems with M sampled roots and fruits (M, N, 3) [m].

    Sample m has the stiffness of case m modulo the number of cases.
    """
    times = len(root)
    length, axes = _frames(root.reshape(-1, 3), fruit.reshape(-1, 3))
    turns = [cases[m % len(cases)] for m in range(times)]
    kept = (np.concatenate(values) for values in zip(*(own[3:] for own in turns), strict=True))
    return Stems(np.ascontiguousarray(root.reshape(-1, 3)), axes, length, *kept)


def _frames(root: FloatArray, fruit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lengths (N,) and axes (N, 3, 3), see :class:`Stems`."""
    hang = fruit - root
    length = lengths(hang)
    along = hang / length[:, None]
    x, y, z = along.T
    nought = np.zeros(len(along))
    # across from the world's x axis, or from its y axis where that is nearly along the stem
    e1 = np.where(np.abs(x) < 0.9, [nought, z, -y], [-z, nought, x])
    u, v, w = e1 = e1 / lengths(e1.T)
    e2 = [y * w - z * v, z * u - x * w, x * v - y * u]
    return length, np.ascontiguousarray(np.stack([e1, e2, [x, y, z]]).transpose(2, 0, 1))


class StemTree(NamedTuple):
    """N stems of one or more trusses."""

    parent: IntArray  # (N,) index of the stem that each stem grows from; -1 for a held root
    # (N,) of the parent's length at which the stem grows: its root, projected on that chord
    share: FloatArray
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


def _carried(
    t: StemTree, weight: FloatArray, up: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """The load of each stem: its fruit, and the stems that grow from it.

    ``weight``: (N,) of the fruits [N]. ``up``: (3,) opposite to gravity. ``count``: number of
    elements of a stem.

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


def bent_by_weight(t: StemTree, stiffness: FloatArray, tension: FloatArray) -> Bent:
    """Solve the beams, those that hang on others first.

    The weight of a fruit pulls its stem back where the root turns. So a stem is a spring on the
    slope of its parent, of stiffness sᵀBs - (Bs)ᵀA⁻¹Bs with the places s of the grid's points, the
    whole stiffness A and the stiffness B of the tension.

    ``stiffness``: (N, n, n) of the grid's points of each single stem [N/m]. ``tension``: (N, n, n)
    part of the stiffness that is due to the tension [N/m].
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


def roots_condensed(t: StemTree, bent: Bent) -> tuple[FloatArray, FloatArray]:
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


@kernel
def part(fruit, root, radius, above, apart):
    """Move each fruit of an overlapping pair by half of the overlap, in place.

    ``fruit``: (M, N, 3) centres of the lower balls of N fruits in M states, in and out [m].
    ``root``: (M, N, 3) roots of the stems [m]. ``radius``: (N,) see
    :class:`optipromp.core.pushing.stems.bending.Balls`, as for the others.
    """
    count, up, way = len(radius), np.zeros(3), np.zeros(3)
    off = np.zeros((count, 3))  # from the lower to the upper ball
    for m in range(len(fruit)):
        for i in range(count):
            far = 0.0
            for k in range(3):
                up[k] = root[m, i, k] - fruit[m, i, k]
                far += up[k] * up[k]
            for k in range(3):
                off[i, k] = apart[i] * up[k] / math.sqrt(far)
        for _ in range(BEAM.parting_sweeps):
            moved = False
            for i in range(count):
                for o in range(i):
                    deep = 0.0
                    for a in range(2 if apart[i] > 0.0 else 1):
                        for b in range(2 if apart[o] > 0.0 else 1):
                            far = 0.0
                            for k in range(3):
                                d = fruit[m, i, k] + a * off[i, k] - fruit[m, o, k] - b * off[o, k]
                                up[k] = d
                                far += d * d
                            far = math.sqrt(far)
                            own = above[i] if a else radius[i]
                            other = above[o] if b else radius[o]
                            over = own + other - far
                            if over > deep and far > 1e-9:
                                deep = over
                                for k in range(3):
                                    way[k] = up[k] / far
                    if deep > 0.0:
                        moved = True
                        for k in range(3):
                            fruit[m, i, k] += 0.5 * (deep + BEAM.parting_gap) * way[k]
                            fruit[m, o, k] -= 0.5 * (deep + BEAM.parting_gap) * way[k]
            if not moved:
                break


@lru_cache(maxsize=4)  # by identity: all approaches to a target meet the same fruits
def sampled(
    fruits: tuple[SceneObject, ...], searched: int, states: int, vertical: tuple[float, ...]
) -> Stems:
    """``searched`` states for the search, the perceived one first, then ``states`` for the harm.

    A path does better in the states that it was chosen in: its harm is predicted in other states.
    The samples for the harm have the spread of the errors, those for the search a wider spread.
    """
    up, samples = np.array(vertical), searched - 1 + states
    wider = np.where(np.arange(samples) < searched - 1, PUSH.hanging.wider, 1.0)[:, None]
    cases = _cases(fruits, up)
    seen, count = cases[0], len(fruits)
    sure = [fruit.covariance is None for fruit in fruits]
    deviation = np.sqrt([rules.detection_variance(fruit) for fruit in fruits])
    spread = np.where(sure, PUSH.hanging.shift, deviation * wider)
    turn = np.where(sure, PUSH.hanging.turn, PUSH.hanging.detected_turn)
    told = [None if fruit.stem is None else fruit.stem.tilt for fruit in fruits]
    turn = np.array([own if own is not None else by for own, by in zip(told, turn, strict=True)])
    turn = np.deg2rad(turn) * seen.length
    shifted, swung = np.random.default_rng(0).standard_normal((2, samples, count, 3))
    shift = spread[..., None] * shifted
    swing = turn[:, None] * (swung - (swung @ up)[..., None] * up)  # level
    place = np.array([hanging_balls(fruit).center for fruit in fruits])
    hidden = [fruit.stem is not None and fruit.stem.unseen for fruit in fruits]
    longer = np.exp(np.where(hidden, UNSEEN_SPREAD, 0.0) * (swung @ up)) - 1.0
    swing = swing + longer[..., None] * (seen.root - place)
    places = np.concatenate([place[None], place + shift])
    roots = np.concatenate([seen.root[None], seen.root + shift + swing])
    part(places, roots, seen.radius, seen.above, (1.0 - seen.upper) * seen.length)
    size, turn = uniform(1, (2, (samples + 1) * count))
    beam = PUSH.beam
    size = beam.bow_least + size * (beam.bow_most - beam.bow_least)
    return bowed(stems_moved(cases, roots, places), size, 2.0 * np.pi * turn)


def _cases(fruits: Sequence[SceneObject], up: FloatArray) -> list[Stems]:
    """The expected stems; where stiffnesses are uncertain, also all stems softer, and all stiffer.

    The stems of a plant are alike.
    """
    told = [fruit.physical for fruit in fruits]
    assumed = [1.0 if "stem_stiffness" in each else BEAM.stiffness_spread for each in told]
    spreads = zip(told, assumed, strict=True)
    wide = np.array([each.get("stem_stiffness_spread", usual) for each, usual in spreads])
    if (wide == 1.0).all():
        return [stems(fruits, up)]
    factors = np.stack([np.ones(len(fruits)), 1.0 / wide, wide])
    if (parents(fruits) >= 0).any():
        return [stems(fruits, up, factor) for factor in factors]
    every, count = stems([*fruits] * len(factors), up, factors.ravel()), len(fruits)
    return [
        Stems(*(values[k : k + count] for values in every))
        for k in range(0, len(factors) * count, count)
    ]
