"""A rank-one addition to a symmetric 3×3 matrix kept as six numbers."""

from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def add_outer(stiffness, weight, x, y, z):  # type: ignore[no-untyped-def]
    """Add ``weight`` times the outer product of (x, y, z) to a symmetric matrix of six numbers."""
    stiffness[0] += weight * x * x
    stiffness[1] += weight * y * y
    stiffness[2] += weight * z * z
    stiffness[3] += weight * x * y
    stiffness[4] += weight * x * z
    stiffness[5] += weight * y * z
