"""ProMP files: NPZ, written whole or not at all."""

import io
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from optipromp.errors import InvalidRequestError, OptiPrompError
from optipromp.files import write_atomically
from optipromp.promp.basis import Basis
from optipromp.promp.model import ProMP

PROMP_FORMAT = 1
_KEYS = ("format", "basis", "mean", "covariance", "noise", "joint_names")


def write_npz(path: Path, arrays: Mapping[str, NDArray[np.generic]]) -> None:
    """Write arrays to ``path``, whole or not at all.

    Raises:
        InvalidRequestError: the file cannot be written.
    """
    buffer = io.BytesIO()
    np.savez(buffer, allow_pickle=False, **dict(arrays))
    write_atomically(path, buffer.getvalue())


def read_npz(path: Path, error: type[OptiPrompError]) -> dict[str, NDArray[np.generic]]:
    """All arrays of an NPZ file. Never unpickles.

    Raises:
        OptiPrompError: of the type given, if the file is missing, damaged or no NPZ.
    """
    try:
        with path.open("rb") as file:  # opened here: NumPy leaves a damaged one open
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise error(f"{path} is a single array, not an NPZ archive")
            with archive:
                return {key: archive[key] for key in archive.files}
    except OSError as cause:
        raise error(f"cannot read {path}: {cause.strerror or cause}") from None
    except (ValueError, EOFError, zipfile.BadZipFile, KeyError, NotImplementedError) as cause:
        raise error(f"{path} is not a readable NPZ file of plain arrays ({cause})") from None


def save_promp(promp: ProMP, path: Path) -> None:
    """See :meth:`ProMP.save`."""
    basis = promp.basis
    write_npz(
        path,
        {
            "format": np.array(PROMP_FORMAT),
            "basis": np.array([basis.count, basis.width, basis.outside], dtype=np.float64),
            "mean": promp.mean,
            "covariance": promp.covariance,
            "noise": promp.noise,
            "joint_names": np.array(promp.joint_names, dtype=np.str_),
        },
    )


def load_promp(path: Path) -> ProMP:
    """See :meth:`ProMP.load`."""
    data = read_npz(path, InvalidRequestError)
    missing = [key for key in _KEYS if key not in data]
    if missing:
        raise InvalidRequestError(f"{path} is no ProMP file: it lacks {', '.join(missing)}")
    version = data["format"]
    if (
        version.shape != ()
        or not np.issubdtype(version.dtype, np.integer)
        or version != PROMP_FORMAT
    ):
        raise InvalidRequestError(f"{path}: format {version} is unknown; this reads {PROMP_FORMAT}")
    try:
        numbers = np.asarray(data["basis"], dtype=np.float64)
        if numbers.shape != (3,) or not np.isfinite(numbers).all():
            raise InvalidRequestError(f"basis: expected count, width, outside, got {numbers}")
        if (numbers[[0, 2]] % 1.0).any():
            raise InvalidRequestError(f"basis: count and outside must be whole, got {numbers}")
        return ProMP(
            Basis(int(numbers[0]), float(numbers[1]), int(numbers[2])),
            np.asarray(data["mean"], dtype=np.float64),
            np.asarray(data["covariance"], dtype=np.float64),
            np.asarray(data["noise"], dtype=np.float64),
            tuple(str(name) for name in np.atleast_1d(data["joint_names"])),
        )
    except (OptiPrompError, ValueError, TypeError) as cause:
        raise InvalidRequestError(f"{path}: {cause}") from None
