"""The compilation of kernels: by Numba, with its cache on the disk.

A division by zero gives infinity, as in NumPy, and no kernel holds Python's lock.

The content of the cache is executed, and its index is unpickled. So the cache is used only in a
folder where nobody but this user, root or the owner of the source can write. Every file ends in a
checksum, because a damaged file would end the process. Without such a folder, kernels are compiled
in memory.

A compiled kernel is known by what it is made of, not by its file's time: see :func:`_stamp`. The
cache lies in ``OPTIPROMP_CACHE`` where that is set, else where Numba has it.
"""

import functools
import hashlib
import io
import os
import re
import stat
import time
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import CodeType, ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np
from numba import config, njit
from numba.core import event
from numba.core.registry import CPUDispatcher

from optipromp.core.budget import check_memory, pause

if TYPE_CHECKING:
    IndexDataCacheFile: Any = object
else:
    from numba.core.caching import IndexDataCacheFile

check_memory()


class _Pausing(event.Listener):
    """Stops the clock of a thread while it compiles a kernel."""

    def __init__(self) -> None:
        self._began: list[float] = []  # nested kernels; Numba's lock admits one thread

    def on_start(self, event: Any) -> None:
        self._began.append(time.perf_counter())

    def on_end(self, event: Any) -> None:
        began = self._began.pop()
        if not self._began:
            pause(time.perf_counter() - began)


event.register("numba:compile", _Pausing())  # type: ignore[no-untyped-call]

_CHECKED = 4  # bytes of the checksum (CRC-32)


def _whole(path: str) -> bool:
    """Whether a file of the cache ends in its checksum, or does not exist."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        return True
    return content[-_CHECKED:] == zlib.crc32(content[:-_CHECKED]).to_bytes(_CHECKED, "big")


class _Checked(IndexDataCacheFile):  # type: ignore[misc]
    """Numba's cache of one function, which ignores damaged files and failures to write."""

    def __init__(self, kernel: Any) -> None:
        line = re.compile(r"-\d+(?=\.)")  # of the file, in which it may move
        name = line.sub("", kernel._cache._impl.filename_base, count=1)
        super().__init__(kernel._cache.cache_path, name, "")
        self._kernel = kernel

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        with super()._open_for_write(filepath) as file:
            yield (content := io.BytesIO())
            file.write(content.getvalue())
            file.write(zlib.crc32(content.getvalue()).to_bytes(_CHECKED, "big"))

    def _load_index(self) -> Any:
        self._source_stamp = _stamp(self._kernel)
        with suppress(ImportError, AttributeError):  # of a version whose types stood elsewhere
            return super()._load_index() if _whole(self._index_path) else {}
        return {}

    def _load_data(self, name: str) -> Any:
        if not _whole(self._data_path(name)):
            raise FileNotFoundError(name)  # it is compiled again
        return super()._load_data(name)

    def save(self, key: Any, data: Any) -> None:
        with suppress(OSError):
            super().save(key, data)


@functools.cache
def _stamp(kernel: Any) -> str:
    """A hash of what the code of a kernel is made of: of its own content and of that of all kernels
    which it calls, also through others."""
    found = [kernel]
    for one in found:
        found += [call for call in _content(one)[1] if call not in found]
    return hashlib.sha256("".join(sorted(_content(one)[0] for one in found)).encode()).hexdigest()


@functools.cache
def _content(kernel: Any) -> tuple[str, list[Any]]:
    """Code, options, and values of a kernel with the types of its module, in words; and calls."""
    code, known = kernel.py_func.__code__, kernel.py_func.__globals__
    read = [known[name] for name in code.co_names if name in known]
    for module in [value for value in read if isinstance(value, ModuleType)]:
        read += [getattr(module, name) for name in code.co_names if hasattr(module, name)]
    kinds = sorted(_told(value) for value in known.values() if isinstance(value, type))
    words = f"{kernel.py_func.__qualname__} {kernel.targetoptions} {_told((code, *read))} {kinds}"
    return words, [value for value in read if isinstance(value, CPUDispatcher)]


def _told(value: Any) -> str:
    """A value that a kernel reads, in words that are the same in every process."""
    if isinstance(value, CodeType):
        return f"{value.co_code!r} {value.co_names} {_told(value.co_consts)}"
    if isinstance(value, tuple):
        return f"{type(value).__name__}({', '.join(map(_told, value))})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes()!r}"
    if value is None or isinstance(value, bool | int | float | str):
        return repr(value)
    return f"{getattr(value, '__qualname__', type(value))} {getattr(value, '_fields', '')}"


def is_private(folder: Path) -> bool:
    """Whether only this user, root or the owner of this package can write in ``folder``."""
    if not hasattr(os, "getuid"):
        return True
    owners = {os.getuid(), 0, Path(__file__).stat().st_uid}
    for path in (folder, folder.parent):
        with suppress(FileNotFoundError):
            found = path.stat()
            public = found.st_mode & stat.S_IWOTH and not found.st_mode & stat.S_ISVTX
            if found.st_uid not in owners or public:
                return False
    return True


if asked := os.environ.get("OPTIPROMP_CACHE"):
    config.CACHE_DIR = config.CACHE_DIR or str(Path(asked, "kernels"))  # type: ignore[attr-defined]


def _may_cache() -> bool:
    """Whether there is a private folder for the cache; warns if not."""
    try:
        folder = Path(str(njit(cache=True)(_may_cache).stats.cache_path))
    except RuntimeError:  # the package's folder and the user's cannot be written
        why = "no folder for compiled kernels can be written"
    else:
        if is_private(folder):
            return True
        why = f"others can write in {folder}, where compiled kernels would be kept"
    warnings.warn(
        f"{why}: they are compiled in memory, each time (a minute or two); OPTIPROMP_CACHE names "
        "another folder",
        stacklevel=2,
    )
    return False


CACHED = _may_cache()


if TYPE_CHECKING:  # Numba's types do not know the option ``_nrt``
    compiler = njit
    kernel = called = inner = inlined = njit(error_model="numpy")
else:

    class _Inner(CPUDispatcher):
        """A kernel without what Python calls: compiling that would take a quarter of the time."""

        def __call__(self, *given: Any) -> Any:
            raise TypeError(f"{self.py_func.__name__}: only kernels call it; must be @called")

    def compiler(**options: Any) -> Any:
        """A decorator of kernels with further options of Numba."""
        make = njit(cache=CACHED, error_model="numpy", nogil=True, no_cfunc_wrapper=True, **options)

        def compiled(function: Any) -> Any:
            dispatcher = make(function)
            if CACHED:
                dispatcher._cache._cache_file = _Checked(dispatcher)
            if "no_cpython_wrapper" in options:
                dispatcher.__class__ = _Inner
            return dispatcher

        return compiled

    kernel = compiler()
    called = compiler(_nrt=False)
    inner = compiler(_nrt=False, no_cpython_wrapper=True)
    inlined = compiler(_nrt=False, no_cpython_wrapper=True, forceinline=True)
"""Decorators of kernels. A ``kernel`` may allocate arrays. The others neither allocate nor return
arrays, and do not count references to them: for a kernel with 30 arrays in named tuples, counting
would take longer than the work. Kernels alone call an ``inner`` kernel, and an ``inlined`` one is
inserted wherever it is called. Python calls the others.
"""


def in_cache(dispatcher: Any) -> bool:
    """Whether Numba's cache has this kernel, compiled from this source for this processor."""
    if not CACHED:
        return False
    index = dispatcher._cache._cache_file._load_index()  # empty if the source has changed
    processor = dispatcher.targetctx.codegen().magic_tuple()
    return any(key[1] == processor for key in index)
