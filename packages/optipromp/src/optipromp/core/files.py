"""Files: read up to a size, written whole or not at all; JSON text; archives of arrays."""

import errno
import glob
import io
import json
import math
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from optipromp.core.errors import InvalidRequestError, OptiPrompError

LARGEST_TEXT = 64_000_000
"""Most bytes of a text file, chosen: a scene of 100,000 obstacles has 11 million, as JSON 22."""

LARGEST_ARRAYS = 256_000_000  # most bytes of an archive of arrays or a mesh, unpacked, chosen


def read_bytes(path: Path, error: type[OptiPrompError], most: int = LARGEST_ARRAYS) -> bytes:
    """The content of a file of at most ``most`` bytes."""
    try:
        found = path.stat()
        if stat.S_ISDIR(found.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(found.st_mode):
            raise error(f"{path}: cannot be read: a device or pipe; must be a file")
        with path.open("rb") as file:
            content = file.read(most + 1) if found.st_size <= most else b""
    except OSError as cause:
        raise error(f"{path}: cannot be read: {cause.strerror or cause}") from None
    except ValueError as cause:  # a name that no file can have
        raise error(f"{str(path)!r}: cannot be read: {cause}") from None
    size = max(found.st_size, len(content))
    if size > most:
        raise error(f"{path}: has {size / 1e6:.0f} MB: must have at most {most / 1e6:.0f}")
    return content


is_file, is_folder, is_there = os.path.isfile, os.path.isdir, os.path.exists
"""Whether a path is a file, a folder, or anything, also a device or a pipe. False for a forbidden
folder and for a name that no file can have, where ``Path``'s methods raise until Python 3.13."""


def file_name(text: str) -> str:
    """``text`` as the name of a file: at most 60 letters, without separators and wildcards."""
    return "".join("_" if letter in '/\\:*?"<>|' else letter for letter in text)[:60]


def is_bag(path: Path) -> bool:
    """Whether a path looks like a bag: ``.mcap``, ``.db3``, or a folder with metadata.yaml. A
    ``.bag`` of ROS 1 does too, and its reader says what to do."""
    if is_folder(path):
        return is_there(path / "metadata.yaml")
    return path.suffix.lower() in (".mcap", ".db3", ".bag")


FOLDERS = "OPTIPROMP_FOLDERS"
"""Environment variable: further folders from which scenes may read files."""


ALLOW_XACRO = "OPTIPROMP_ALLOW_XACRO"
"""Environment variable: 1 if files may name xacro files, which run code."""


def homes(folder: Path | None) -> tuple[Path, ...]:
    """The folders that may hold the files which a file in ``folder`` names. They are ``folder``,
    the working directory (unless it is the root), and :data:`FOLDERS`."""
    here = Path.cwd()
    listed = [Path(home) for home in os.environ.get(FOLDERS, "").split(os.pathsep) if home]
    return folder or here, *([here] if here != Path(here.anchor) else []), *listed


def check_inside(
    path: Path, folder: Path | None, error: type[OptiPrompError], more: Iterable[Path] = ()
) -> Path:
    """``path``, which a file in ``folder`` names, if it lies in its :func:`homes` or in ``more``.
    Links are followed."""
    try:
        real = path.resolve()
        if any(real.is_relative_to(home.resolve()) for home in (*homes(folder), *more)):
            return path
    except (OSError, RuntimeError, ValueError) as cause:  # a ring of links; no name of a file
        raise error(f"{str(path)!r}: cannot be found: {cause}") from None
    raise error(
        f"{path} is outside the folder of the file that names it and outside the working "
        f"directory: must be inside, or in a folder that {FOLDERS} lists"
    )


COMMITTED = ".committed"
"""Folder beside files that were written together, while they are moved to their places."""


def write_atomically(path: Path, content: bytes) -> None:
    """Write ``content`` beside ``path`` and rename it into place; the folder is made if missing. If
    the writing is interrupted (a full disk, Ctrl-C, a kill), ``path`` holds its old content or the
    new. Remains of killed processes beside it are removed."""
    if is_there(path) and not is_file(path):
        raise InvalidRequestError(f"cannot write {path}: it is no file")
    with _writing(path), _aside(path.parent, path.name) as temporary:
        _write(temporary, content)
        temporary.replace(path)


def write_together(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write several files of a folder, all of them or none; the folder is made if missing. The
    files are written to a temporary folder, which is then renamed to :data:`COMMITTED`: from then
    on they count as written. Last they are moved to their places. If that is interrupted by a kill,
    :func:`settle` finishes it. Other files of the folder stay."""
    for name in files:
        if is_there(folder / name) and not is_file(folder / name):
            raise InvalidRequestError(f"cannot write {folder / name}: it is no file")
    committed = folder / COMMITTED
    with _writing(folder), _aside(folder, COMMITTED.removeprefix(".")) as temporary:
        temporary.mkdir()
        for name, content in files.items():
            _write(temporary / name, content)
        if committed.is_symlink():
            committed.unlink()
        while True:
            settle(folder)
            try:
                temporary.rename(committed)
                break
            except OSError:
                if not is_folder(committed):  # else another process was faster
                    raise
        settle(folder)


@contextmanager
def moved_when_whole(folder: Path, name: str) -> Iterator[Path]:
    """A new folder, whose entry ``name`` is moved into ``folder`` if nothing is raised."""
    with _writing(folder / name), _aside(folder, "new") as temporary:
        temporary.mkdir()
        yield temporary
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (temporary / name).rename(folder / name)


def settle(folder: Path) -> None:
    """Move the files that :func:`write_together` has committed in a folder to their places."""
    committed = folder / COMMITTED
    while is_folder(committed) and not committed.is_symlink():
        with suppress(FileNotFoundError):  # another process moves it too
            for file in sorted(committed.iterdir()):
                file.replace(folder / file.name)
            committed.rmdir()


@contextmanager
def _writing(path: Path, how: str = "") -> Iterator[None]:
    """Turn errors of writing ``path`` into InvalidRequestError."""
    try:
        yield
    except OSError as error:
        cause = error.strerror or error
        raise InvalidRequestError(f"cannot write {how}{path}: {cause}") from error
    except ValueError as error:  # a name that no file can have
        raise InvalidRequestError(f"cannot write {how}{str(path)!r}: {error}") from None


@contextmanager
def _aside(folder: Path, name: str) -> Iterator[Path]:
    """A temporary path beside ``name``, removed afterwards; remains of ended processes go first."""
    folder.mkdir(parents=True, exist_ok=True)
    if os.name == "posix":
        for left in folder.glob(f".{glob.escape(name)}.*.writing"):
            number = left.name.split(".")[-2].partition("-")[0]
            if number.isdecimal() and not _runs(int(number)):
                _remove(left)
    temporary = folder / f".{name}.{os.getpid()}-{os.urandom(4).hex()}.writing"
    try:
        yield temporary
    finally:
        _remove(temporary)


def _runs(process: int) -> bool:
    """Whether a process of this number exists."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _write(path: Path, content: bytes) -> None:
    with path.open("xb") as stream:
        stream.write(content)
        stream.flush()
        os.fsync(stream.fileno())


def _remove(path: Path) -> None:
    """Remove a file or a folder, if it exists and may be removed."""
    with suppress(OSError, ValueError):
        if is_folder(path):
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def cache_folder() -> Path | None:
    """The user's cache: ``OPTIPROMP_CACHE``, else the platform's; None without a home folder."""
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
    """Test that files can be written in ``folder``, which need not exist; nothing is left there."""
    new = [path for path in (folder, *folder.parents) if not is_there(path)]
    try:
        with _writing(folder, "into "):
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
    finally:
        for path in new:
            with suppress(OSError, ValueError):  # not created, or another process wrote there
                path.rmdir()


def npz(arrays: Mapping[str, Any], *, compressed: bool = False) -> bytes:
    """Arrays by name as the content of an NPZ file."""
    import numpy as np

    stream = io.BytesIO()
    (np.savez_compressed if compressed else np.savez)(stream, allow_pickle=False, **arrays)
    return stream.getvalue()


def read_npz(
    path: Path | str,
    error: type[OptiPrompError] = InvalidRequestError,
    *,
    content: bytes | None = None,
    most: int = LARGEST_ARRAYS,
) -> dict[str, Any]:
    """All arrays of an NPZ file, or of the ``content`` of one. Never unpickles."""
    import numpy as np

    content = read_bytes(Path(path), error) if content is None else content
    if not content.startswith(b"PK"):
        raise error(f"{path} is not a readable NPZ file of plain arrays (no archive)")
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as archive:
            size = sum(entry.file_size for entry in archive.zip.infolist())
            if size <= most:
                return {key: _array(key, archive[key]) for key in archive.files}
    except Exception as cause:  # zipfile, zlib, tokenize, NumPy raise whatever goes wrong in them
        reason = " ".join(str(cause).split())[:120] or type(cause).__name__
        raise error(f"{path} is not a readable NPZ file of plain arrays ({reason})") from None
    raise error(f"{path}: unpacks to {size / 1e6:.0f} MB: must be at most {most / 1e6:.0f}")


def _array(key: str, member: Any) -> Any:
    """A member of an archive. Raises ValueError if it is no array or no Unicode text."""
    import numpy as np

    if not isinstance(member, np.ndarray):  # NumPy returns bytes
        raise ValueError(f"{key!r} is no array")
    if member.dtype.kind == "U":
        codes = np.frombuffer(member.tobytes(), np.dtype("u4").newbyteorder(member.dtype.byteorder))
        if codes.max(initial=0) > sys.maxunicode:
            raise ValueError(f"{key!r} holds text that is not Unicode")
    return member


@contextmanager
def reading(
    path: Path | str,
    wrong: str,
    error: type[OptiPrompError] = InvalidRequestError,
    passes: tuple[type[OptiPrompError], ...] = (),
) -> Iterator[None]:
    """Errors in the content of a file that this library wrote become one line that names the file.
    ``wrong``: what the file is not, in words. ``passes``: types of errors that are raised as they
    are."""
    try:
        yield
    except passes:
        raise
    except OptiPrompError as cause:
        named = str(path) in cause.message
        raise error(cause.message if named else f"{path}: {cause.message}") from None
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as cause:
        raise error(f"{path} is {wrong}: {_words(cause)}") from None


def _words(cause: Exception) -> str:
    """An error of Python or pydantic in one line, with the key that it is about."""
    if isinstance(cause, KeyError):
        return f"it lacks {cause}"
    told = getattr(cause, "errors", None)
    if callable(told):  # pydantic's, which is not imported here
        first = told()[0]
        return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
    return str(cause)


def members(
    data: Mapping[str, Any], table: Mapping[str, tuple[type, str]], sizes: dict[str, int]
) -> dict[str, Any]:
    """The arrays of an archive that ``table`` names, read-only. Raises KeyError and ValueError.
    ``data``: of :func:`read_npz`. ``table``: type and shape of each array, a letter or a digit for
    each dimension. ``sizes``: of the letters; those that it lacks are added as they are met."""
    import numpy as np

    from optipromp.core.arrays import frozen

    out = {}
    for key, (kind, shape) in table.items():
        array = data[key]
        for letter, size in zip(shape, array.shape, strict=False):
            sizes.setdefault(letter, size)
        wanted = tuple(int(letter) if letter.isdigit() else sizes[letter] for letter in shape)
        if array.dtype != np.dtype(kind) or array.shape != wanted:
            raise ValueError(
                f"'{key}' must be {np.dtype(kind)} {wanted}, is {array.dtype} {array.shape}"
            )
        out[key] = frozen(array, array.dtype)
    return out


def texts(member: Any) -> tuple[str, ...]:
    """The texts of an array of texts, in order; an array without dimensions holds one."""
    import numpy as np

    return tuple(str(text) for text in np.atleast_1d(member))


def json_text(document: object) -> str:
    """``document`` as JSON text; NaN and infinities become null, arrays become lists."""
    return json.dumps(plain(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def plain(value: Any) -> Any:
    """``value`` in JSON's types; NaN and infinities become None, arrays and tuples lists."""
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
