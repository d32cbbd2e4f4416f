"""How kernels are compiled: by Numba, into its cache on the disk.

A division by zero gives infinity, as in NumPy, and no kernel holds Python's lock.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from numba import njit

kernel = njit(cache=True, error_model="numpy", nogil=True)
"""Decorator of a kernel that may allocate arrays."""

if TYPE_CHECKING:  # Numba has the option ``_nrt`` for its own use, and declares it nowhere
    inner = inlined = kernel
else:
    inner = njit(cache=True, error_model="numpy", nogil=True, _nrt=False)
    inlined = njit(cache=True, error_model="numpy", nogil=True, _nrt=False, forceinline=True)
"""Decorators of a kernel that neither allocates nor returns an array.

It takes no part in counting references to arrays. With counting, a kernel that takes 30 arrays in
named tuples spends more time on that than on its work: a push, split into such kernels, took 2.1
times as long. What is ``inlined`` is inserted wherever it is called.
"""


def in_cache(dispatcher: Any) -> bool:
    """Whether Numba's cache has this kernel compiled."""
    name = f"*.{dispatcher.py_func.__qualname__}-*.nbi"
    return any(Path(dispatcher.stats.cache_path or "").glob(name))
