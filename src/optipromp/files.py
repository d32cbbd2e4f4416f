"""Writing files whole or not at all; JSON text; archives of arrays."""

import io
import json
import math
import os
import sys
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from optipromp.errors import InvalidRequestError, OptiPrompError


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` beside ``path`` and rename it into place; the folder is made if need be.

    Whatever interrupts the writing (a full disk, Ctrl-C), ``path`` holds its old content or the
    new.

    Raises:
        InvalidRequestError: the folder or the file cannot be written; the message names it and why.
    """
    temporary: str | None = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        umask = os.umask(0)
        os.umask(umask)
        Path(temporary).chmod(0o666 & ~umask)  # mkstemp is private; a result need not be
        Path(temporary).replace(path)
    except OSError as error:
        raise InvalidRequestError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            with suppress(OSError):
                Path(temporary).unlink(missing_ok=True)


def cache_folder() -> Path | None:
    """The user's cache: ``OPTIPROMP_CACHE``, else the platform's; None where there is no home."""
    asked = os.environ.get("OPTIPROMP_CACHE")
    if asked:
        return Path(asked)
    try:
        if sys.platform == "win32":
            local = os.environ.get("LOCALAPPDATA") or Path.home() / "AppData/Local"
            return Path(local) / "optipromp"
        if sys.platform == "darwin":
            return Path.home() / "Library/Caches/optipromp"
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "optipromp"
    except RuntimeError:
        return None


def check_folder(folder: Path) -> None:
    """Make ``folder`` if need be and try that files can be written there.

    Raises:
        InvalidRequestError: they cannot; the message names the folder and why.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise InvalidRequestError(
            f"cannot write into {folder}: {error.strerror or error}"
        ) from error


def npz(arrays: Mapping[str, Any], *, compressed: bool = False) -> bytes:
    """Arrays by name as the content of an NPZ file."""
    import numpy as np

    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def read_npz(path: Path, error: type[OptiPrompError] = InvalidRequestError) -> dict[str, Any]:
    """All arrays of an NPZ file. Never unpickles.

    Raises:
        OptiPrompError: of the type given, if the file is missing, damaged or no NPZ.
    """
    import zipfile

    import numpy as np

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


def json_text(document: object) -> str:
    """``document`` as JSON text; NaN and infinities become null, arrays become lists."""
    return json.dumps(plain(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def plain(value: Any) -> Any:
    """``value`` as JSON has it; NaN and infinities become None, arrays and tuples lists."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, str):
        return str(value)  # an enumeration's word
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if value is None or isinstance(value, bool | int):
        return value
    return str(value)
