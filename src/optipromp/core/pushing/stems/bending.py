r"""Fruits on bending stems, described by few deflections.

A stem is a beam clamped at its root that carries its fruit. Across its axis the deflection w(s)
follows from the energy

.. math:: \tfrac12\int EI\,{w''}^2\,ds + \tfrac12\int T\,{w'}^2\,ds - \sum_k f_k w(s_k)

with the tension T of the fruit's weight. The energy is minimised once, on a fine grid, for loads at
the points :data:`LOADED`. For such loads the deflections u of these points describe the whole stem
exactly (static condensation, Guyan 1965): w = W u with energy ½ uᵀ K u, in each of two directions
across the stem. A deflected stem lifts its fruit by ½∫w'² ds = ½ uᵀ S u.

The stiffness of a stem cannot be seen. It is taken to be that of green peduncles (a guess,
:class:`BeamParameters`). Where a stem leans, it is at least so stiff that the fruit's weight turns
it by no more than the turn that it grew with.

A stem that grows from another has a root that yields: its compliance includes that of the stems
that it hangs on, so its first point moves too (:mod:`optipromp.core.pushing.stems.trusses`).
"""

import itertools
from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpbsv

from optipromp.core.arrays import FloatArray, IntArray, frozen, lengths
from optipromp.core.geometry.shapes import Capsule, Cone, Ellipsoid, MeshShape
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import trusses
from optipromp.core.scenes.scene import SceneObject

LOADED, ELEMENTS, FINER = PUSH.beam.loaded, PUSH.beam.elements, PUSH.beam.finer
MODULUS, DIAMETER = PUSH.beam.youngs_modulus, PUSH.beam.diameter
TRUSS_DIAMETER = PUSH.beam.truss_diameter
GROWN_TURN, STIFF_END = PUSH.beam.grown_turn, PUSH.beam.stiff_end
FRUIT_DENSITY, GRAVITY = PUSH.beam.fruit_density, PUSH.beam.gravity
FITTED = 16  # radii of each ball that are tried when two are fitted to a shape
UP = frozen([0.0, 0.0, 1.0])

_AT = np.round(np.array(LOADED) * FINER * ELEMENTS).astype(int) - 1  # of the grid's points
_UNIT = frozen(np.eye(FINER * ELEMENTS)[:, _AT])  # [N] at each of them


class Stems(NamedTuple):
    """N fruits on stems, for the kernels.

    Attributes:
        root: (N, 3) [m].
        axes: (N, 3, 3) rows: two directions across the stem, then along it to the fruit.
        length: (N,) from the root to the fruit's centre [m].
        mass: (N,) of the fruits [kg].
        radius: (N,) of the fruits, of a long one's lower ball; ``thickness`` (N,) of the stems [m].
        upper: (N,) share of the stem at which a long fruit's upper ball is; 1 for a ball.
        above: (N,) radius of the upper ball [m].
        shape: (N, ELEMENTS + 1, L) W, deflection of the grid's points by those of the loaded ones.
        stiffness: (N, L, L) K [N/m].
        compliance: (N, L, L) the inverse of K [m/N].
        shortening: (N, L, L) S [1/m].
        joint: (N, N, 3, 3) motion of each fruit by a force on another one of its truss [m/N];
            (N, 0, 3, 3) where no stem grows from another.
        rest: (N, 2L) deflections of the loaded points at rest: the bow of the stem [m].
        lifted: (N,) by how much that bow is shorter than its arc [m].
    """

    root: FloatArray
    axes: FloatArray
    length: FloatArray
    mass: FloatArray
    radius: FloatArray
    thickness: FloatArray
    upper: FloatArray
    above: FloatArray
    shape: FloatArray
    stiffness: FloatArray
    compliance: FloatArray
    shortening: FloatArray
    joint: FloatArray
    rest: FloatArray
    lifted: FloatArray


def stems(
    objects: Sequence[SceneObject], up: FloatArray = UP, factor: FloatArray | float = 1.0
) -> Stems:
    """The stems of fruits that hang, as if straight from root to fruit; ``up`` as :func:`bent`.

    Stiffnesses, told or assumed, are multiplied by ``factor`` (N,).
    """
    balls = [balls_of(fruit) for fruit in objects]
    return bent(
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
    """(N,) which of the objects each one's stem grows from; -1 for one whose root is held."""
    known = {item.id: k for k, item in enumerate(objects)}
    names = [None if item.stem is None else item.stem.parent for item in objects]
    return np.array([-1 if name is None else known.get(name, -1) for name in names], np.int64)


class Balls(NamedTuple):
    """The two balls that the model takes a fruit for, one behind the other along its stem.

    Attributes:
        center: (3,) of the lower one [m].
        radius: of the lower one, ``above`` of the upper one [m].
        apart: distance of their centres; 0 for one ball [m].
    """

    center: FloatArray
    radius: float
    above: float
    apart: float


def balls_of(fruit: SceneObject) -> Balls:
    """The balls that a fruit is taken for: those of a capsule or cone, those fitted to an ellipsoid
    or a mesh. Any other shape is taken for one ball that holds it.
    """
    shape, stem = fruit.shape, fruit.stem
    if stem is None or not isinstance(shape, Capsule | Cone | Ellipsoid | MeshShape):
        return Balls(fruit.position, fruit.radius, fruit.radius, 0.0)
    if isinstance(shape, Capsule | Cone):
        tip = shape.tip if isinstance(shape, Cone) else shape.radius
        end = 0.5 * shape.length * fruit.rotation[:, 2]
        if float(end @ stem.vector) < 0.0:
            return Balls(fruit.position + end, shape.radius, tip, shape.length)
        return Balls(fruit.position - end, tip, shape.radius, shape.length)
    line = stem.root - fruit.position
    line = fruit.rotation.T @ (line / np.linalg.norm(line))
    low, radius, above, apart = _fitted(shape, tuple(line.tolist()))
    return Balls(fruit.position + low * (fruit.rotation @ line), radius, above, apart)


@lru_cache(maxsize=256)
def _fitted(
    shape: Ellipsoid | MeshShape, line: tuple[float, ...]
) -> tuple[float, float, float, float]:
    """Two balls on ``line`` (3,) from the local origin that fit a shape's surface best.

    They touch the shape's ends along the line, and of all radii those are taken for which the
    surface is nearest to their hull in the mean.

    Returns:
        Where on the line the lower one is, the two radii, and their distance [m].
    """
    points, axis = shape.mesh().vertices, np.array(line)
    height = points @ axis
    aside = lengths(points - height[:, None] * axis)
    low, high, wide = float(height.min()), float(height.max()), float(aside.max())
    one = 0.5 * (high - low)
    shares = np.linspace(0.1, 1.0, FITTED) * min(wide, one)
    best, found = np.inf, (0.5 * (low + high), one, one, 0.0)
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
            best, found = error, (low + radius, float(radius), float(above), float(apart))
    return found


def bent(
    root: FloatArray, fruit: FloatArray, radius: FloatArray, thickness: FloatArray,
    up: FloatArray = UP, apart: FloatArray | float = 0.0, above: FloatArray | None = None,
    mass: FloatArray | float = np.nan, stiffness: FloatArray | float = np.nan,
    factor: FloatArray | float = 1.0, parent: IntArray | None = None,
) -> Stems:  # fmt: skip
    """Stems of radius ``thickness`` (N,), from roots (N, 3) to fruits (N, 3) of radius (N,) [m].

    ``up`` (3,) is opposite to gravity. A long fruit has a second ball of radius ``above`` (N,),
    ``apart`` (N,) from the first towards the root [m]. Where ``mass`` (N,) [kg] and ``stiffness``
    EI (N,) [N m²] are not numbers, they are assumed. Stiffnesses are multiplied by ``factor`` (N,).
    ``parent`` (N,) is the stem that each grows from, -1 where its root is held.
    """
    count, n, loaded = len(root), FINER * ELEMENTS, len(LOADED)
    length, axes = _frames(root, fruit)
    along = axes[:, 2]
    above = radius if above is None else above
    ball = FRUIT_DENSITY * 4.0 / 3.0 * np.pi * (0.5 * (radius**3 + above**3))
    between_balls = FRUIT_DENSITY * np.pi * apart * (radius**2 + radius * above + above**2) / 3.0
    mass = np.where(np.isnan(mass), ball + between_balls, mass)
    down = along @ up
    x, y, z = (along - down[:, None] * up).T
    lean = np.hypot(np.hypot(x, y), z)
    weight: FloatArray = mass * GRAVITY  # (N,), or (N, n) beyond each element
    # the moment m g sinθ (L - s) turns the stem by m g sinθ L² / 2EI
    grown, thick = weight * lean * length**2 / 2.0, np.full(count, DIAMETER)
    whole = None
    if parent is not None and (parent >= 0).any():
        whole = trusses.tree(parent, root, axes, length)
        weight, grown = trusses.carried(whole, weight, up, n)
        thick[np.unique(parent[parent >= 0])] = TRUSS_DIAMETER
    assumed = np.maximum(MODULUS * np.pi / 64.0 * thick**4, grown / GROWN_TURN)
    bending = factor * np.where(np.isnan(stiffness), assumed, stiffness)
    tension = weight * (np.abs(down) if whole is None else np.abs(down)[:, None])
    h = length / n
    stiffer = np.where(
        (np.arange(n) + 0.5) / n > (1.0 - (above + apart) / length)[:, None], STIFF_END, 1.0
    )
    stiffer[:, 0] *= 0.5  # clamped: the beam is mirrored at its root
    ei = np.zeros((count, n + 2))  # by h³, at the grid's points from the root; none beyond the end
    ei[:, :n] = bending[:, None] * stiffer / h[:, None] ** 3
    pull = (tension if tension.ndim == 2 else tension[:, None]) / h[:, None]
    band = _band(ei, pull)
    compliance = np.array([dpbsv(one, _UNIT, lower=1)[1] for one in band]).reshape(count, n, loaded)
    joint, first = np.zeros((count, 0, 3, 3)), np.zeros((count, 1, loaded))
    if whole is not None:
        solved = trusses.bending(whole, _full(band), _full(_band(np.zeros_like(ei), pull)))
        base, joint = trusses.condensed(whole, solved)
        for k in range(count):
            added = trusses.sideways(base[k], axes[k], solved.turned[k])[:, [0, *(_AT + 1)]]
            first[k], compliance[k] = added[0, 1:], solved.influence[k][:, _AT] + added[1:, 1:]
    between = np.ascontiguousarray(compliance[:, _AT])
    condensed = np.linalg.inv(between)
    grid = np.concatenate([first, compliance[:, FINER - 1 :: FINER]], axis=1)
    shape = grid @ condensed
    steps = np.diff(shape, axis=1)
    shortening = np.einsum("nki,nkj->nij", steps, steps) / (FINER * h)[:, None, None]
    return Stems(
        root, axes, length, mass, radius, thickness, 1.0 - apart / length, above, shape, condensed,
        between, shortening, joint, np.zeros((count, 2 * loaded)), np.zeros(count),
    )  # fmt: skip


def bowed(straight: Stems, size: FloatArray, turn: FloatArray) -> Stems:
    """The N stems, each half a sine wave at rest, from its root to where its fruit begins.

    ``size`` (N,) is the bow, middle off the line over length, ``turn`` (N,) its direction about the
    stem [rad].
    """
    free = straight.upper - straight.above / straight.length  # without the fruit
    share = np.minimum(np.array(LOADED) / free[:, None], 1.0)
    off = (size * straight.length)[:, None] * np.sin(np.pi * share)
    rest = np.concatenate([np.cos(turn)[:, None] * off, np.sin(turn)[:, None] * off], axis=1)
    lifted = 0.5 * np.einsum("na,nab,nb->n", off, straight.shortening, off)
    return straight._replace(rest=rest, lifted=lifted)


def _band(ei: FloatArray, pull: FloatArray) -> FloatArray:
    """½∫EI w''² + ½∫T w'² by central differences, as LAPACK keeps a symmetric band (N, 3, n).

    ``ei`` (N, n + 2) is EI over h³ at the grid's points, ``pull`` (N, n), or (N, 1) where it is the
    same all along, the tension in each element over h [N/m].
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


def moved(cases: Sequence[Stems], root: FloatArray, fruit: FloatArray) -> Stems:
    """The same N stems with M sampled roots and fruits (M, N, 3) [m].

    Sample m has the stiffness of the case m modulo their number: a few per cent of length change it
    little.
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
