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
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpbsv

from optipromp.arrays import FloatArray, frozen, lengths
from optipromp.geometry.shapes import Capsule
from optipromp.pushing.parameters import PUSH
from optipromp.scenes.scene import SceneObject

LOADED, ELEMENTS, FINER = PUSH.beam.loaded, PUSH.beam.elements, PUSH.beam.finer
MODULUS, DIAMETER = PUSH.beam.youngs_modulus, PUSH.beam.diameter
GROWN_TURN, STIFF_END = PUSH.beam.grown_turn, PUSH.beam.stiff_end
FRUIT_DENSITY, GRAVITY = PUSH.beam.fruit_density, PUSH.beam.gravity
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
        radius: (N,) of the fruits; ``thickness`` (N,) radii of the stems [m].
        upper: (N,) share of the stem at which a long fruit's second ball is; 1 for a ball.
        shape: (N, ELEMENTS + 1, L) W, deflection of the grid's points by those of the loaded ones.
        stiffness: (N, L, L) K [N/m].
        compliance: (N, L, L) the inverse of K [m/N].
        shortening: (N, L, L) S [1/m].
    """

    root: FloatArray
    axes: FloatArray
    length: FloatArray
    mass: FloatArray
    radius: FloatArray
    thickness: FloatArray
    upper: FloatArray
    shape: FloatArray
    stiffness: FloatArray
    compliance: FloatArray
    shortening: FloatArray


def stems(
    objects: Sequence[SceneObject], up: FloatArray = UP, factor: FloatArray | float = 1.0
) -> Stems:
    """The stems of fruits that hang, as if straight from root to fruit; ``up`` as :func:`bent`.

    Stiffnesses, told or assumed, are multiplied by ``factor`` (N,).
    """
    balls = [balls_of(fruit) for fruit in objects]
    return bent(
        np.array([t.stem.points[-1] for t in objects if t.stem is not None]).reshape(-1, 3),
        np.array([center for center, _, _ in balls]).reshape(-1, 3),
        np.array([radius for _, radius, _ in balls]),
        np.array([t.stem.radius for t in objects if t.stem is not None]),
        up,
        np.array([apart for _, _, apart in balls]),
        np.array([t.physical.get("mass", np.nan) for t in objects]),
        np.array([t.physical.get("stem_stiffness", np.nan) for t in objects]),
        factor,
    )


def balls_of(fruit: SceneObject) -> tuple[FloatArray, float, float]:
    """The two balls that the model takes a fruit for, one behind the other along its stem.

    A capsule is taken for the balls at its ends; any other shape for one ball that holds it.

    Returns:
        Centre (3,) of the lower one, radius, and the distance of the upper one; 0 for one ball [m].
    """
    if not isinstance(fruit.shape, Capsule) or fruit.stem is None:
        return fruit.position, fruit.radius, 0.0
    end = 0.5 * fruit.shape.length * fruit.rotation[:, 2]
    away = -1.0 if float(end @ fruit.stem.vector) > 0.0 else 1.0
    return fruit.position + away * end, fruit.shape.radius, fruit.shape.length


def bent(
    root: FloatArray, fruit: FloatArray, radius: FloatArray, thickness: FloatArray,
    up: FloatArray = UP, apart: FloatArray | float = 0.0, mass: FloatArray | float = np.nan,
    stiffness: FloatArray | float = np.nan, factor: FloatArray | float = 1.0,
) -> Stems:  # fmt: skip
    """Stems of radius ``thickness`` (N,), from roots (N, 3) to fruits (N, 3) of radius (N,) [m].

    ``up`` (3,) is opposite to gravity. A long fruit has a second ball ``apart`` (N,) from the first
    towards the root [m]. Where ``mass`` (N,) [kg] and ``stiffness`` EI (N,) [N m²] are not numbers,
    they are assumed. Stiffnesses are multiplied by ``factor`` (N,).
    """
    count, n, loaded = len(root), FINER * ELEMENTS, len(LOADED)
    length, axes = _frames(root, fruit)
    along = axes[:, 2]
    ball = FRUIT_DENSITY * 4.0 / 3.0 * np.pi * radius**3
    mass = np.where(np.isnan(mass), ball + FRUIT_DENSITY * np.pi * apart * radius**2, mass)
    down = along @ up
    x, y, z = (along - down[:, None] * up).T
    lean = np.hypot(np.hypot(x, y), z)
    # the moment m g sinθ (L - s) turns the stem by m g sinθ L² / 2EI
    grown = mass * GRAVITY * lean * length**2 / (2.0 * GROWN_TURN)
    assumed = np.maximum(MODULUS * np.pi / 64.0 * DIAMETER**4, grown)
    bending = factor * np.where(np.isnan(stiffness), assumed, stiffness)
    tension = mass * GRAVITY * np.abs(down)
    h = length / n
    stiffer = np.where(
        (np.arange(n) + 0.5) / n > (1.0 - (radius + apart) / length)[:, None], STIFF_END, 1.0
    )
    stiffer[:, 0] *= 0.5  # clamped: the beam is mirrored at its root
    ei = np.zeros((count, n + 2))  # by h³, at the grid's points from the root; none beyond the end
    ei[:, :n] = bending[:, None] * stiffer / h[:, None] ** 3
    pull = (tension / h)[:, None]
    # ½∫EI w''² + ½∫T w'² by central differences, as LAPACK keeps a symmetric band
    band = np.zeros((count, 3, n))
    band[:, 0] = ei[:, :n] + 4.0 * ei[:, 1:-1] + ei[:, 2:] + 2.0 * pull
    band[:, 0, 0] += 3.0 * ei[:, 0]
    band[:, 0, -1] -= pull[:, 0]
    band[:, 1, :-1] = -2.0 * (ei[:, 1:n] + ei[:, 2:-1]) - pull
    band[:, 2, :-2] = ei[:, 2:n]
    compliance = np.array([dpbsv(one, _UNIT, lower=1)[1] for one in band]).reshape(count, n, loaded)
    between = np.ascontiguousarray(compliance[:, _AT])
    condensed = np.linalg.inv(between)
    shape = np.zeros((count, ELEMENTS + 1, loaded))
    shape[:, 1:] = compliance[:, FINER - 1 :: FINER] @ condensed
    steps = np.diff(shape, axis=1)
    shortening = np.einsum("nki,nkj->nij", steps, steps) / (FINER * h)[:, None, None]
    return Stems(
        root, axes, length, mass, radius, thickness, 1.0 - apart / length, shape, condensed,
        between, shortening,
    )  # fmt: skip


def moved(s: Stems, root: FloatArray, fruit: FloatArray) -> Stems:
    """The same N stems with M sampled roots and fruits (M, N, 3) [m].

    Their stiffness is kept: a few per cent of length change it little.
    """
    times = len(root)
    length, axes = _frames(root.reshape(-1, 3), fruit.reshape(-1, 3))
    kept = (np.concatenate([values] * times) for values in s[3:])
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
