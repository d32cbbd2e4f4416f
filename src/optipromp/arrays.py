"""Array types used everywhere."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen(values: Any, dtype: Any = np.float64) -> NDArray[Any]:
    """Return a contiguous read-only copy of ``values``."""
    array = np.array(values, dtype=dtype, order="C")
    array.setflags(write=False)
    return array
