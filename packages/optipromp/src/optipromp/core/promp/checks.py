"""Checks of arguments, and the warnings of the package."""

import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.values import Name, array, value

PHASE_TOLERANCE = 1e-9
"""[-] Phases no farther apart are one phase, and may lie so far outside [0, 1] (rounding)."""


class RegularisedWarning(UserWarning):
    """The data did not determine the answer alone; a prior or a projection completed it."""


def regularised(message: str) -> None:
    """Warn the caller of a learner that the prior decided."""
    warnings.warn(message, RegularisedWarning, stacklevel=3)


class ConvergenceWarning(UserWarning):
    """An iteration reached its limit before it converged."""


class ConditioningWarning(UserWarning):
    """A conditioned distribution misses an exact point."""


class UnitsWarning(UserWarning):
    """Values so large that they look like degrees or millimetres."""


def phase_array(phases: int | ArrayLike) -> FloatArray:
    """Phases (T,) in [0, 1]: an integer T stands for T evenly spaced ones, a float for one."""
    if isinstance(phases, (bool, np.bool_)):
        raise InvalidRequestError(f"phases: expected a count or phases in [0, 1], got {phases}")
    if isinstance(phases, (int, np.integer)):
        if phases < 1:
            raise InvalidRequestError(f"phases: a count must be at least 1, got {phases}")
        return np.linspace(0.0, 1.0, int(phases))
    found = np.atleast_1d(array("phases", phases, ...))
    if found.ndim != 1:
        raise InvalidRequestError(f"phases has shape {found.shape}: must be (T,)")
    inside = (found >= -PHASE_TOLERANCE) & (found <= 1.0 + PHASE_TOLERANCE)
    if not inside.all():
        index = int(np.argmin(inside))
        raise InvalidRequestError(f"phases[{index}] is {found[index]}; a phase lies in [0, 1]")
    return found


def names_for(names: Sequence[str], count: int) -> tuple[str, ...]:
    """``names`` checked against ``count``; empty means ``joint_1`` ... ``joint_n``."""
    if isinstance(names, str):
        raise InvalidRequestError("joint_names: expected a sequence of names, got one string")
    result = tuple(str(name) for name in names) or tuple(f"joint_{j + 1}" for j in range(count))
    if len(result) != count:
        raise InvalidRequestError(f"joint_names: expected {count} names, got {len(result)}")
    value("joint_names", result, tuple[Name, ...])
    if len(set(result)) != count:
        twice = next(name for name in result if result.count(name) > 1)
        raise InvalidRequestError(f"joint_names: {twice!r} appears twice")
    return result


def unnamed(names: Sequence[str]) -> bool:
    """Whether the names are the default ones: ``joint_1`` ... ``joint_n``."""
    return tuple(names) == names_for((), len(names))


def matching_columns(names: Sequence[str], joints: Sequence[str], what: str) -> list[int]:
    """Indices of the columns with the names of the ``joints``.

    ``what``: owner of the columns; begins the error message.
    """
    unknown = [name for name in names if name not in joints]
    missing = [joint for joint in joints if joint not in names]
    if not unknown and not missing:
        return [list(names).index(joint) for joint in joints]
    if unnamed(names):
        fault = f"its joints are called joint_1 to joint_{len(names)}, as columns without names are"
    else:
        faults = [f"the robot has no joint {', '.join(unknown)}"] if unknown else []
        faults += [f"joint {', '.join(missing)} is missing"] if missing else []
        fault = "; ".join(faults)
    raise InvalidDemonstrationError(
        f"{what}: {fault}. Name each joint of the robot once: {', '.join(joints)} (in the header "
        "of a CSV, in joint_names of an NPZ; columns without names that are in the robot's order "
        "get them by 'optipromp learn --robot', others by its --rename OLD=NEW)"
    )
