"""The compilation of kernels: by Numba, with its cache on the disk.

A division by zero gives infinity, as in NumPy, and no kernel holds Python's lock.

The content of the cache is executed, and its index is unpickled. So the cache is used only in a
folder where nobody but this user, root or the owner of the source can write. Every file ends in a
checksum, because a damaged file would end the process. Without such a folder, kernels are compiled
in memory.
"""

import io
import os
import stat
import time
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numba import njit
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

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        with super()._open_for_write(filepath) as file:
            yield (content := io.BytesIO())
            file.write(content.getvalue())
            file.write(zlib.crc32(content.getvalue()).to_bytes(_CHECKED, "big"))

    def _load_index(self) -> Any:
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
        f"{why}: they are compiled in memory, each time (a minute or two); NUMBA_CACHE_DIR names "
        "another folder",
        stacklevel=2,
    )
    return False


_CACHED = _may_cache()


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
        make = njit(
            cache=_CACHED, error_model="numpy", nogil=True, no_cfunc_wrapper=True, **options
        )

        def compiled(function: Any) -> Any:
            dispatcher = make(function)
            if _CACHED:
                dispatcher._cache._cache_file.__class__ = _Checked
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
    if not _CACHED:
        return False
    index = dispatcher._cache._cache_file._load_index()  # empty if the source has changed
    processor = dispatcher.targetctx.codegen().magic_tuple()
    return any(key[1] == processor for key in index)
