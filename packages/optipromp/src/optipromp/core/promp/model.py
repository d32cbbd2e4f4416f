"""The probabilistic movement primitive: a Gaussian over trajectories."""

import os
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray, read_only
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import is_file, npz, read_npz, reading, texts, write_atomically
from optipromp.core.promp.basis import Basis
from optipromp.core.promp.checks import matching_columns, names_for
from optipromp.core.promp.gaussian import check_covariance, square_root
from optipromp.core.shown import Shown
from optipromp.core.values import Positive, array, value

PROMP_FORMAT = 1
LARGEST_WEIGHT = 1e9  # [rad or m] products of larger weights overflow


@dataclass(frozen=True, eq=False, repr=False)
class ProMP(Shown):
    r"""A distribution over trajectories of n joints (Paraschos et al., 2013).

    .. math:: y_t = \Phi_t w + \epsilon, \quad w \sim N(\mu_w, \Sigma_w), \quad
              \epsilon \sim N(0, \mathrm{diag}(r))

    The nK weights are joint-major: weight k of joint j is ``w[j * K + k]``. A ProMP is immutable
    (its arrays are read-only); every operation returns a new ProMP.

    Args:
        basis: the K basis functions.
        mean: :math:`\mu_w`, (n, K) or flat (nK,), in rad or m. Kept as (n, K).
        covariance: :math:`\Sigma_w` (nK, nK), positive semi-definite.
        noise: variance r of an observation [rad² or m²], one per joint (n,) or one for all.
        joint_names: n names; by default ``joint_1`` ... ``joint_n``.

    Raises:
        InvalidRequestError: a wrong shape, a value that is not finite, or a covariance that is
            not symmetric positive semi-definite.
    """

    basis: Basis
    mean: FloatArray
    covariance: FloatArray
    noise: FloatArray = field(default_factory=lambda: np.zeros(()))
    joint_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not isinstance(self.basis, Basis):
            raise InvalidRequestError(f"basis: expected a Basis, got {type(self.basis).__name__}")
        count = self.basis.count
        mean = array("mean", self.mean, ..., order="K")
        if mean.ndim == 1 and mean.size and mean.size % count == 0:
            mean = mean.reshape(-1, count)
        if mean.ndim != 2 or mean.shape[0] == 0 or mean.shape[1] != count:
            raise InvalidRequestError(
                f"mean: expected shape (n, {count}) or (n * {count},), got {mean.shape}"
            )
        n = mean.shape[0]
        covariance = check_covariance(self.covariance, n * count, "covariance")
        noise = array("noise", self.noise, ...)
        if noise.shape not in ((), (n,)) or (noise < 0.0).any():
            raise InvalidRequestError(f"noise: expected {n} variances >= 0, got {noise.tolist()}")
        for name, values, power in (
            ("mean", mean, 1),
            ("covariance", covariance, 2),
            ("noise", noise, 2),
        ):
            largest, most = np.abs(values).max(), LARGEST_WEIGHT**power
            if largest > most:
                raise InvalidRequestError(f"{name} reaches {largest:g}: at most {most:g}")
        object.__setattr__(self, "mean", read_only(mean))
        object.__setattr__(self, "covariance", read_only(covariance))
        object.__setattr__(self, "noise", read_only(np.broadcast_to(noise, (n,)).copy()))
        object.__setattr__(self, "joint_names", names_for(self.joint_names, n))

    def _words(self) -> str:
        names = ", ".join(self.joint_names)
        return f"of {self.n_joints} joints ({names}), {self.basis.count} bases a joint"

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.mean.shape[0])

    @property
    def n_weights(self) -> int:
        """Number of weights nK."""
        return int(self.mean.size)

    @property
    def weights(self) -> FloatArray:
        """Mean weights, flat (nK,), joint-major."""
        return self.mean.reshape(-1)

    @cached_property
    def _root(self) -> FloatArray:
        return read_only(square_root(self.covariance))

    def mean_trajectory(self, phases: int | ArrayLike) -> FloatArray:
        """Mean positions (T, n) at phases (T,), or at a count of evenly spaced phases."""
        return self.basis.evaluate(phases) @ self.mean.T

    def trajectory(self, weights: ArrayLike, phases: int | ArrayLike) -> FloatArray:
        """Positions (..., T, n) of weights (..., n, K) or (nK,)."""
        given = array("weights", weights, ...)
        if given.shape == (self.n_weights,):
            given = given.reshape(self.mean.shape)
        if given.ndim < 2 or given.shape[-2:] != self.mean.shape:
            raise InvalidRequestError(
                f"weights: expected (..., {self.n_joints}, {self.basis.count}), got {given.shape}"
            )
        return np.asarray(self.basis.evaluate(phases) @ np.swapaxes(given, -1, -2))

    def marginals(
        self,
        phases: int | ArrayLike,
        derivative: int = 0,
        duration: float = 1.0,
        observation_noise: bool = False,
    ) -> tuple[FloatArray, FloatArray]:
        r"""Mean (T, n) and covariance (T, n, n) of the joints, or of a derivative, at each phase.

        The distribution is :math:`N(\Phi_t \mu_w, \Phi_t \Sigma_w \Phi_t^T)`.

        Args:
            phases: (T,) in [0, 1], or a count.
            derivative: 0 positions, 1 velocities, 2 accelerations, 3 jerks.
            duration: [s] of the movement at constant phase rate; scales derivatives only.
            observation_noise: add diag(r) (positions only).

        Raises:
            InvalidRequestError: a phase outside [0, 1], another derivative, duration <= 0.
        """
        rate = 1.0 / value("duration", duration, Positive) ** derivative
        values = rate * self.basis.evaluate(phases, derivative)
        n, count = self.mean.shape
        pairs = (values[:, :, None] * values[:, None, :]).reshape(-1, count * count)
        blocks = self.covariance.reshape(n, count, n, count).transpose(1, 3, 0, 2)
        covariance = (pairs @ blocks.reshape(count * count, n * n)).reshape(-1, n, n)
        covariance = 0.5 * (covariance + covariance.transpose(0, 2, 1))
        diagonal = np.einsum("tjj->tj", covariance)
        np.maximum(diagonal, 0.0, out=diagonal)
        if observation_noise:
            if derivative != 0:
                raise InvalidRequestError("observation_noise: known for positions only")
            diagonal += self.noise
        return values @ self.mean.T, covariance

    def standard_deviation(
        self, phases: int | ArrayLike, derivative: int = 0, duration: float = 1.0
    ) -> FloatArray:
        """Standard deviation (T, n) of each joint, or of a derivative, at each phase."""
        _, covariance = self.marginals(phases, derivative, duration)
        return np.asarray(np.sqrt(np.einsum("tjj->tj", covariance)))

    def sample_weights(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Samples (count, n, K) of the weights."""
        if count < 0:
            raise InvalidRequestError(f"count of samples must be at least 0, got {count}")
        offsets = rng.standard_normal((count, self.n_weights)) @ self._root.T
        return (self.weights + offsets).reshape(count, *self.mean.shape)

    def sample(
        self,
        rng: np.random.Generator,
        count: int,
        phases: int | ArrayLike,
        observation_noise: bool = False,
    ) -> FloatArray:
        """Sampled trajectories (count, T, n), smooth unless ``observation_noise`` is added."""
        weights = self.sample_weights(rng, count)
        result: FloatArray = self.basis.evaluate(phases) @ np.swapaxes(weights, -1, -2)
        if observation_noise:
            result += rng.standard_normal(result.shape) * np.sqrt(self.noise)
        return result

    def with_weights(self, mean: ArrayLike, covariance: ArrayLike) -> "ProMP":
        """The same primitive (basis, noise, names) with another weight distribution, checked."""
        return ProMP(
            self.basis, np.asarray(mean), np.asarray(covariance), self.noise, self.joint_names
        )

    def for_joints(self, joints: Sequence[str], what: str = "the ProMP") -> "ProMP":
        """The same primitive with its joints in the order of ``joints``.

        Raises:
            InvalidDemonstrationError: other joint names; the message begins with ``what``.
        """
        if tuple(joints) == self.joint_names:
            return self
        order = matching_columns(self.joint_names, joints, what)
        rows = np.arange(self.n_weights).reshape(self.mean.shape)[order].reshape(-1)
        return made(
            self.basis,
            self.mean[order],
            self.covariance[np.ix_(rows, rows)],
            self.noise[order],
            tuple(joints),
        )

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write to an NPZ file, atomically.

        Raises:
            InvalidRequestError: the file cannot be written; an existing file stays as it is.
        """
        basis = self.basis
        arrays = {
            "format": np.array(PROMP_FORMAT),
            "basis": np.array([basis.count, basis.width, basis.outside], dtype=np.float64),
            "mean": self.mean,
            "covariance": self.covariance,
            "noise": self.noise,
            "joint_names": np.array(self.joint_names, dtype=np.str_),
        }
        write_atomically(Path(path), npz(arrays))

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> "ProMP":
        """Read a file of :meth:`save`.

        Raises:
            InvalidRequestError: the file is missing, no ProMP file, of another format, or damaged.
        """
        path = Path(path)
        data = read_npz(path)
        with reading(path, "no ProMP file"):
            version = data["format"]
            if version.shape or version.dtype.kind not in "iu" or version != PROMP_FORMAT:
                raise InvalidRequestError(f"format {version} is unknown; this reads {PROMP_FORMAT}")
            numbers, mean, covariance, noise = (  # "same_kind" refuses complex numbers
                data[key].astype(np.float64, casting="same_kind")
                for key in ("basis", "mean", "covariance", "noise")
            )
            if numbers.shape != (3,) or not np.isfinite(numbers).all():
                raise InvalidRequestError(f"basis: expected count, width, outside, got {numbers}")
            if (numbers[[0, 2]] % 1.0).any():
                raise InvalidRequestError(f"basis: count and outside must be whole, got {numbers}")
            basis = Basis(int(numbers[0]), float(numbers[1]), int(numbers[2]))
            return cls(basis, mean, covariance, noise, texts(data["joint_names"]))


def is_primitive(path: Path) -> bool:
    """Whether ``path`` is a file that :meth:`ProMP.save` wrote."""
    try:
        if not is_file(path):  # opening a pipe would wait
            return False
        with zipfile.ZipFile(path) as archive:
            return {"basis.npy", "mean.npy", "covariance.npy"} <= set(archive.namelist())
    except (OSError, ValueError, NotImplementedError, zipfile.BadZipFile):
        return False


def trusted(promp: ProMP, mean: FloatArray, covariance: FloatArray) -> ProMP:
    """``promp`` with another weight distribution that needs no checks and no copy."""
    mean = mean.reshape(promp.mean.shape)
    return made(promp.basis, mean, covariance, promp.noise, promp.joint_names)


def made(
    basis: Basis,
    mean: FloatArray,
    covariance: FloatArray,
    noise: FloatArray,
    joint_names: tuple[str, ...],
) -> ProMP:
    """A ProMP of values that need no checks and no copy."""
    result = object.__new__(ProMP)
    result.__dict__.update(
        basis=basis,
        mean=read_only(mean),
        covariance=read_only(covariance),
        noise=read_only(noise),
        joint_names=joint_names,
    )
    return result
