"""Demonstrations gathered to learn from, and what is assumed before seeing them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.promp.checks import finite_array, names_for, positive
from optipromp.promp.demonstrations import Demonstration, Demonstrations
from optipromp.promp.gaussian import check_covariance

DemonstrationsLike = Demonstrations | Sequence[Demonstration] | Sequence[ArrayLike] | FloatArray
"""What the learners take: demonstrations, a sequence of arrays (m_i, n), or one array (N, T, n)."""

NOISE_FLOOR = 1e-10
"""Smallest observation variance learnt: (1e-5 rad or m) squared."""


@dataclass(frozen=True, eq=False)
class Samples:
    """Demonstrations ready to learn from.

    ``phases`` and ``positions`` hold one array per demonstration, (m_i,) and (m_i, n). If all have
    the same phases, ``stacked`` is all positions at once, (N, T, n); ``even`` says that they are
    evenly spaced from 0 to 1.
    """

    phases: tuple[FloatArray, ...]
    positions: tuple[FloatArray, ...]
    stacked: FloatArray | None
    joint_names: tuple[str, ...]
    even: bool = False

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.positions[0].shape[1])

    @property
    def extent(self) -> FloatArray:
        """Largest minus smallest position of each joint over all demonstrations, (n,)."""
        flat = np.concatenate(self.positions)
        high: FloatArray = flat.max(axis=0)
        low: FloatArray = flat.min(axis=0)
        return high - low


def gather(demonstrations: DemonstrationsLike, joint_names: Sequence[str] | None) -> Samples:
    """Check demonstrations and align them on phase.

    Raises:
        InvalidDemonstrationError: none; a value that is not finite; unequal numbers of joints.
    """
    error = InvalidDemonstrationError
    if isinstance(demonstrations, Demonstration):
        demonstrations = (demonstrations,)
    stacked = _stacked(demonstrations)
    if stacked is not None:
        if stacked.shape[0] == 0:
            raise error("no demonstrations: at least one is needed")
        if stacked.shape[1] < 2 or stacked.shape[2] == 0:
            raise error(f"demonstrations: expected (N, T >= 2, n >= 1), got shape {stacked.shape}")
        phases = np.linspace(0.0, 1.0, stacked.shape[1])
        names = names_for(joint_names or (), stacked.shape[2])
        return Samples((phases,) * len(stacked), tuple(stacked), stacked, names, even=True)
    if not isinstance(demonstrations, Demonstrations):
        items = []
        for i, item in enumerate(demonstrations):
            if not isinstance(item, Demonstration):
                array = finite_array(item, f"demonstration {i}", 2, error)
                if array.shape[0] < 2:
                    raise error(f"demonstration {i} needs at least 2 samples, got {len(array)}")
                item = Demonstration(np.linspace(0.0, 1.0, len(array)), array)
            items.append(item)
        demonstrations = Demonstrations(tuple(items))
    names = names_for(joint_names or demonstrations.joint_names, demonstrations.n_joints)
    all_phases = tuple(item.phases for item in demonstrations)
    positions = tuple(item.positions for item in demonstrations)
    first = all_phases[0]
    same = all(p.size == first.size for p in all_phases) and all(
        bool(np.abs(p - first).max() < 1e-12) for p in all_phases
    )
    return Samples(all_phases, positions, np.stack(positions) if same else None, names)


def _stacked(demonstrations: DemonstrationsLike) -> FloatArray | None:
    """A copy (N, T, n) of bare arrays of finite numbers, all of one shape; None of anything else.

    Raises:
        InvalidDemonstrationError: one array of three dimensions with a value that is not finite.
    """
    if isinstance(demonstrations, np.ndarray):
        if demonstrations.ndim != 3:
            return None
        return finite_array(demonstrations, "demonstrations", 3, InvalidDemonstrationError)
    if not isinstance(demonstrations, list | tuple) or not demonstrations:
        return None
    if not all(
        isinstance(item, np.ndarray) and item.dtype == np.float64 for item in demonstrations
    ):
        return None
    shapes = {item.shape for item in demonstrations}
    if len(shapes) != 1 or len(shapes.pop()) != 2:
        return None
    stacked = np.stack(demonstrations)
    return stacked if np.isfinite(stacked).all() else None


def deviation_floor(extent: FloatArray, demonstrations: int) -> FloatArray:
    """Smallest standard deviation (n,) the default prior gives a weight of each joint.

    1 % of the joint's range of motion ``extent`` (n,), 10 % if there is but one demonstration. A
    joint that hardly moves counts with a tenth of the largest range, at least 0.01 rad or m.
    """
    share = 0.1 if demonstrations == 1 else 0.01
    floor: FloatArray = np.maximum(np.maximum(extent, 0.1 * extent.max()), 0.01)
    return share * floor


def given_prior(given: ArrayLike, size: int) -> FloatArray:
    """A user's Σ_0, checked to be positive definite; a number stands for a multiple of I."""
    if np.ndim(given) == 0:
        return positive(float(np.asarray(given)), "prior_covariance") * np.eye(size)
    prior = check_covariance(given, size, "prior_covariance")
    smallest = float(np.linalg.eigvalsh(prior)[0])
    if smallest <= 0.0:
        raise InvalidRequestError(
            f"prior_covariance must be positive definite; its smallest eigenvalue is {smallest:.3g}"
        )
    return prior
