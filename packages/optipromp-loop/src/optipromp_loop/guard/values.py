"""What a guard takes from its caller, keeps in mind, and gives."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.trajectory import State, Trajectory

T = TypeVar("T")
Kind = Literal["limits", "contact", "speed", "harm"]
Mover = Literal["policy", "guard", "loop"]
ROUNDING = 1e-9  # [rad or m; 1] of positions, and of shares of the other limits
DEEPER = 1e-5  # [m] by which a contact that was there may deepen: of the judge's checks


class Limits(NamedTuple):
    """Of the joints, and what a state exceeds of these: it may stay, not go farther."""

    lower: FloatArray  # (n,) [rad or m]
    upper: FloatArray  # (n,)
    rates: FloatArray  # (3, n) of velocity, acceleration and jerk


class Room(NamedTuple):
    """How near the arm may come to what it must not touch."""

    touched: Mapping[str, float]  # depth of contacts that there are, by object [m]
    clear: Mapping[str, float]  # least clearances, by their names [m]


class Refusal(NamedTuple):
    """Why an action does not pass."""

    kind: Kind
    words: str
    joints: BoolArray | None = None  # (n,) whose limits are at stake


@dataclass(frozen=True, eq=False)
class Safe:
    """The action that the guard gives.

    Attributes:
        velocity: (n,) of the joints at the end of the period [rad/s or m/s].
        reference: state at the end of the period.
        curve: the motion: its second row is ``reference``, from where on all joints brake to a
            stop. An arm that hears nothing more follows it to its end.
        acted: whether the wish was not executed as it was.
        braked: whether no action near the wish passed.
        reason: why the wish did not pass; empty: it did.
        probability: of harm, where the prediction of this action met fruits; else 0.
        mover: who moves the arm: the ``policy`` as it wished; the ``guard`` otherwise than it
            wished; the ``loop`` by its own pick, whose curve does not brake after the period, but
            ends at rest.
        holding: whether the loop leaves with the target, or has left: a gripper may close.
    """

    velocity: FloatArray
    reference: State
    curve: Trajectory
    acted: bool
    braked: bool
    reason: str
    probability: float
    mover: Mover
    holding: bool = False


def least(value: float, before: float | None) -> float:
    """The distance that an arm must keep which is at ``value`` [m], and had to keep ``before``.

    Less than the value, so that it may stay. What the arm had to keep does not shrink because the
    arm came near: only where objects did.
    """
    if before is None or abs(value - before) > DEEPER:
        return value - DEEPER
    return min(before, value - ROUNDING)


def velocities(name: str, values: ArrayLike, size: int) -> FloatArray:
    """The ``values`` (size,) of a caller, finite or not; ``name`` begins the error."""
    try:
        out = np.array(values, dtype=np.float64)
        told = f"has shape {out.shape}"
    except (TypeError, ValueError):
        out, told = np.zeros(0), f"is {values!r:.60}"
    if out.shape != (size,):
        raise InvalidRequestError(f"{name} {told}: must be ({size},), velocities")
    return out


def typed(name: str, value: T, kind: type) -> T:
    """A ``value`` of a caller that is of a ``kind``; ``name`` begins the error."""
    if not isinstance(value, kind):
        raise InvalidRequestError(f"{name} is {value!r:.60}: must be of {kind.__name__}")
    return value
