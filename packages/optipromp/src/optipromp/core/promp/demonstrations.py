"""Demonstrations, and their NPZ files; entry points read files of other programs."""

import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidDemonstrationError, OptiPrompError
from optipromp.core.files import is_folder, is_there, npz, read_npz, texts, write_atomically
from optipromp.core.promp import checks
from optipromp.core.robots.turns import BEYOND_LIMITS, TURN, WRAP, Turns, unwrapped
from optipromp.core.values import Array, Validated

LARGEST = 4.0 * np.pi  # [rad or m] larger positions look like degrees or millimetres
_BLUNDER = 1.0  # [rad or m] farther beyond a limit no arm leans, and degrees are
_STILL, _IDLE = 0.01, 0.25  # of a joint's range: no motion; of the time without motion: too much
_BACK = 0.5  # of the distance to the others' ends: the other way round a demonstration is near them
_LARGEST_JOINT = 1e6  # [rad or m] larger positions overflow in learning
FORMS = "Q, time, lengths; or positions (N, T, n) with an optional time (T,) or (N, T)"


READERS = "optipromp.demonstration_readers"
"""Group of entry points, each named by a suffix without its dot, or ``folder``: a function of a
path and a :data:`Convert` that returns :class:`Demonstrations`."""
Convert = Callable[[Sequence[str], FloatArray], tuple[list[str], FloatArray]] | None


@dataclass(frozen=True, eq=False)
class Demonstration(Validated, error=InvalidDemonstrationError):
    """One recorded movement, complete or partial.

    Args:
        times: (m,), m >= 2, strictly increasing [s or any unit].
        positions: (m, n) joint positions [rad or m].
        span: start and end time of the whole movement, for a partial recording (see
            :func:`fit_em`). By default the recording is complete.

    Raises:
        InvalidDemonstrationError: an invalid value; the message names index and value.
    """

    times: Annotated[FloatArray, Array(None)]
    positions: Annotated[FloatArray, Array(None, None, most=_LARGEST_JOINT, order="K")]
    span: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        error, times, positions = InvalidDemonstrationError, self.times, self.positions
        if positions.shape[0] != times.size or positions.shape[1] == 0:
            raise error(
                f"positions: expected shape ({times.size}, n), one row per time, "
                f"got {positions.shape}"
            )
        if times.size < 2:
            raise error(f"a demonstration needs at least 2 samples, got {times.size}")
        steps = np.diff(times)
        if (steps <= 0.0).any():
            i = int(np.argmax(steps <= 0.0)) + 1
            raise error(f"times must increase: times[{i}] = {times[i]} after {times[i - 1]}")
        if self.span is not None:
            start, end = self.span
            slack = checks.PHASE_TOLERANCE * (end - start)
            if not (start < end and start - slack <= times[0] and times[-1] <= end + slack):
                raise error(
                    f"span ({start}, {end}) must enclose the times {times[0]} to {times[-1]}"
                )

    @property
    def phases(self) -> FloatArray:
        """Phases (m,): 0 at the start of the movement, 1 at its end."""
        start, end = self.span or (float(self.times[0]), float(self.times[-1]))
        return (self.times - start) / (end - start)

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return int(self.positions.shape[1])


@dataclass(frozen=True, eq=False)
class Demonstrations(Sequence[Demonstration]):
    """Demonstrations of one movement on the same joints; a sequence of :class:`Demonstration`.

    Raises:
        InvalidDemonstrationError: no demonstration, or different numbers of joints.
    """

    items: tuple[Demonstration, ...]
    joint_names: tuple[str, ...] = ()
    named: bool = field(init=False)  # whether names were stated

    def __post_init__(self) -> None:
        items = tuple(self.items)
        object.__setattr__(self, "named", len(self.joint_names) > 0)
        if not items:
            raise InvalidDemonstrationError("no demonstrations: at least one is needed")
        n = items[0].n_joints
        for i, item in enumerate(items):
            if item.n_joints != n:
                raise InvalidDemonstrationError(
                    f"demonstration {i} has {item.n_joints} joints, the first has {n}"
                )
        object.__setattr__(self, "items", items)
        object.__setattr__(self, "joint_names", checks.names_for(self.joint_names, n))

    def __len__(self) -> int:
        return len(self.items)

    @overload
    def __getitem__(self, index: int) -> Demonstration: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[Demonstration, ...]: ...

    def __getitem__(self, index: int | slice) -> Demonstration | tuple[Demonstration, ...]:
        return self.items[index]

    @property
    def n_joints(self) -> int:
        """Number of joints n."""
        return self.items[0].n_joints

    def for_joints(self, joints: Sequence[str], what: str) -> "Demonstrations":
        """The same demonstrations with the columns in the order of ``joints``.

        Raises:
            InvalidDemonstrationError: other joint names; the message begins with ``what``.
        """
        order = checks.matching_columns(self.joint_names, joints, what)
        items = (Demonstration(d.times, d.positions[:, order], d.span) for d in self)
        return Demonstrations(tuple(items), tuple(joints))

    def for_robot(
        self, joints: Sequence[str], lower: FloatArray, upper: FloatArray, what: str,
        turns: Turns | None = None,
    ) -> "Demonstrations":  # fmt: skip
        """As :meth:`for_joints`, within the limits (n,) of a robot.

        A joint that may turn begins at most half a turn from where it begins in the first
        demonstration, or in another where only then all are within the joint's limits.

        ``turns``: which joints may; None: those without limits.

        Raises:
            InvalidDemonstrationError: as :meth:`for_joints` and :func:`check_limits`; a turn
                apart, where the limits have no room for one.
        """
        ordered = self.for_joints(joints, what)
        free = Turns(np.isinf(lower) & np.isinf(upper), lower, upper) if turns is None else turns
        away = _one_turn(ordered, free)
        items = []
        for i, item in enumerate(ordered):
            items.append(replace(item, positions=item.positions - TURN * away[i]))
            check_limits(items[i].positions, joints, lower, upper, f"{what}: demonstration {i}")
        found = Demonstrations(tuple(items), tuple(joints))
        if told := turn_apart(found, free.may):
            raise InvalidDemonstrationError(
                f"{what}: {told}, and its limits have no room for all on one turn: leave one out"
            )
        return found


def _one_turn(found: Demonstrations, turns: Turns) -> FloatArray:
    """Whole turns (N, n) that, taken off, leave the demonstrations on one turn of each joint."""
    starts = np.array([item.positions[0] for item in found])
    low, high = (np.array([side(d.positions, axis=0) for d in found]) for side in (np.min, np.max))
    out, done = np.zeros_like(starts), ~turns.may
    for first in starts:
        away = TURN * np.round((starts - first) / TURN)
        fits = (low - away >= turns.lower - BEYOND_LIMITS).all(axis=0)
        fits &= (high - away <= turns.upper + BEYOND_LIMITS).all(axis=0)
        out[:, fits & ~done] = np.round(away / TURN)[:, fits & ~done]
        done |= fits
    return out


def check_limits(
    positions: FloatArray, names: Sequence[str], lower: FloatArray, upper: FloatArray, what: str,
    slack: FloatArray | float = BEYOND_LIMITS,
    error: type[OptiPrompError] = InvalidDemonstrationError,
) -> None:  # fmt: skip
    """Refuse positions (T, n) more than ``slack`` (n,) beyond the limits (n,) of the joints."""
    slack = np.broadcast_to(slack, lower.shape)
    beyond = np.maximum(lower - positions, positions - upper) - slack
    sample, joint = divmod(int(beyond.argmax()), beyond.shape[1])
    if beyond[sample, joint] <= 0.0:
        return
    value = positions[sample, joint]
    units = " (degrees or millimetres? radians and metres are needed)"
    raise error(
        f"{what}: {names[joint]} is {value:.4g} at sample {sample}: must be within its limits "
        f"[{lower[joint]:.4f}, {upper[joint]:.4f}], or at most {slack[joint]:.4g} beyond"
        f"{units if beyond[sample, joint] > _BLUNDER else ''}"
    )


def load_demonstrations(path: str | os.PathLike[str], units: Convert = None) -> Demonstrations:
    """Read demonstrations from a file or folder.

    - ``.npz``: ``Q`` (M, n), ``time`` (M,), ``lengths`` (N,), all demonstrations one after
      another; or ``positions`` (N, T, n) with an optional ``time`` (T,) or (N, T), evenly spaced
      if absent. ``joint_names`` (n,) is optional in both.
    - ``.csv``: a header ``time,<joint>,<joint>,...`` and one row per sample; columns
      ``<joint>_velocity`` and ``<joint>_acceleration`` are ignored; an optional column ``demo``
      labels the demonstrations.
    - a folder: every ``.csv`` in it, by name, all with the same joints in the same order.
    - a LeRobot dataset: ``observation.state`` of each episode, without columns of a gripper.

    ``units``: in others than radians and metres, see :class:`optipromp.core.promp.units.Units`.

    Warns:
        UnitsWarning: a position is beyond 4π, as degrees or millimetres are; or LeRobot's are not
            stated.

    Raises:
        InvalidDemonstrationError: the message names the file, and the row or index if any.
    """
    path = Path(path)
    kind = "folder" if is_folder(path) else path.suffix.lower()[1:]
    if not is_there(path):
        raise InvalidDemonstrationError(f"{path} does not exist")
    readers = {each.name: each for each in entry_points(group=READERS)}
    if kind not in ("npz", *readers):
        lacking = "" if readers else " (only .npz can be read: install optipromp anew)"
        told = "expected .npz, .csv or a folder of .csv files"
        raise InvalidDemonstrationError(f"{path}: {told}{lacking}")
    result = (_read_npz if kind == "npz" else readers[kind].load())(path, units)
    largest = [float(np.abs(item.positions).max()) for item in result]
    if max(largest) > LARGEST:
        warnings.warn(
            f"{path}: demonstration {int(np.argmax(largest))} reaches {max(largest):.4g}; "
            "positions are read as radians or metres (learn --unit states another)",
            checks.UnitsWarning,
            stacklevel=2,
        )
    for words in _odd(result):
        warnings.warn(f"{path}: {words}", stacklevel=2)
    return result


def _odd(found: Demonstrations) -> list[str]:
    """Demonstrations that run the other way, or stand still for long, in words."""
    told = []
    if words := turn_apart(found):
        told.append(f"{words}: a robot whose joint may turn (learn --robot) has it on their turn")
    ends = np.array([d.positions[[0, -1]] for d in found])  # (N, 2, n)
    usual = np.median(ends, axis=0)
    away, back = (np.linalg.norm(ends - e, axis=2).sum(axis=1) for e in (usual, usual[::-1]))
    for i, item in enumerate(found):
        if len(found) > 2 and back[i] < _BACK * away[i]:
            told.append(f"demonstration {i} runs from where the others end to where they begin")
        room = np.ptp(item.positions, axis=0).max()
        for which, order in (("first", 1), ("last", -1)):
            q, share = item.positions[::order], item.phases[::order]
            moves = np.abs(q - q[0]).max(axis=1) > _STILL * room
            idle = abs(float(share[max(int(np.argmax(moves)) - 1, 0)] - share[0]))
            if idle > _IDLE:
                words = f"for the {which} {100 * idle:.0f} % of its time, which is learnt too"
                told.append(f"demonstration {i} stands still {words}: cut that off")
    return told


def turn_apart(found: Demonstrations, may: BoolArray | bool = True) -> str:
    """Which demonstration begins a whole turn from the others, in words; empty: none does.

    ``may``: (n,) which joints are looked at.
    """
    starts = np.array([d.positions[0] for d in found])
    away = starts - np.sort(starts, axis=0)[len(starts) // 2]
    turns = np.round(away / TURN)
    apart = may & (turns != 0.0) & (np.abs(away - TURN * turns) < WRAP)
    if not apart.any() or np.abs(starts).max() > LARGEST:
        return ""
    i, joint = (int(k) for k in np.argwhere(apart)[0])
    return f"demonstration {i} begins a turn apart from others in {found.joint_names[joint]}"


def save_demonstrations(demonstrations: Demonstrations, path: str | os.PathLike[str]) -> None:
    """Write demonstrations to an NPZ file that :func:`load_demonstrations` reads; atomic.

    Raises:
        InvalidDemonstrationError: a demonstration is partial; the format has no span.
        InvalidRequestError: the file cannot be written.
    """
    for i, item in enumerate(demonstrations):
        if item.span is not None and item.span != (item.times[0], item.times[-1]):
            raise InvalidDemonstrationError(f"demonstration {i} is partial; NPZ keeps whole ones")
    arrays = {
        "Q": np.concatenate([item.positions for item in demonstrations]),
        "time": np.concatenate([item.times for item in demonstrations]),
        "lengths": np.array([item.times.size for item in demonstrations]),
        "joint_names": np.array(demonstrations.joint_names, dtype=np.str_),
    }
    write_atomically(Path(path), npz(arrays))


def built(
    path: Path, parts: Sequence[tuple[str, ArrayLike, ArrayLike]], names: Sequence[str],
    units: Convert,
) -> Demonstrations:  # fmt: skip
    """Demonstrations from (label, times, positions); errors name the file and the label."""
    items, columns = [], names
    for label, times, positions in parts:
        try:
            if units is not None:
                names, positions = units(columns, np.asarray(positions))
            item = Demonstration(np.asarray(times), np.asarray(positions))
        except InvalidDemonstrationError as cause:
            raise InvalidDemonstrationError(f"{path}: {label}: {cause.message}") from None
        items.append(replace(item, positions=unwrapped(item.positions)))
    try:
        return Demonstrations(tuple(items), tuple(names))
    except Exception as cause:
        raise InvalidDemonstrationError(f"{path}: {cause}") from None


def _numbers(data: dict[str, NDArray[np.generic]], key: str, path: Path) -> FloatArray:
    array = data[key]
    if array.dtype.kind not in "fiu":
        raise InvalidDemonstrationError(f"{path}: {key} holds {array.dtype}, expected numbers")
    return array.astype(np.float64)


def _read_npz(path: Path, units: Convert) -> Demonstrations:
    data = read_npz(path, InvalidDemonstrationError)
    names = texts(data["joint_names"]) if "joint_names" in data else ()
    if {"Q", "time", "lengths"} <= data.keys():
        q, time = _numbers(data, "Q", path), _numbers(data, "time", path)
        lengths = _numbers(data, "lengths", path)
        if q.ndim != 2 or time.shape != q.shape[:1] or lengths.ndim != 1:
            raise InvalidDemonstrationError(
                f"{path}: expected Q (M, n), time (M,), lengths (N,); got {q.shape}, "
                f"{time.shape}, {lengths.shape}"
            )
        if (lengths % 1.0).any() or (lengths < 0).any() or lengths.sum() != time.size:
            raise InvalidDemonstrationError(
                f"{path}: lengths must be whole and sum to {time.size}, the sum is {lengths.sum()}"
            )
        cuts = np.cumsum(lengths).astype(int)[:-1]
        parts = zip(np.split(time, cuts), np.split(q, cuts), strict=True)
    elif "positions" in data:
        positions = _numbers(data, "positions", path)
        if positions.ndim != 3:
            raise InvalidDemonstrationError(
                f"{path}: positions: expected shape (N, T, n), got {positions.shape}"
            )
        shape = positions.shape[:2]
        time = _numbers(data, "time", path) if "time" in data else np.linspace(0, 1, shape[1])
        if time.shape not in (shape, shape[1:]):
            raise InvalidDemonstrationError(
                f"{path}: time: expected shape {shape[1:]} or {shape}, got {time.shape}"
            )
        parts = zip(np.broadcast_to(time, shape), positions, strict=True)
    else:
        raise InvalidDemonstrationError(
            f"{path} holds {', '.join(sorted(data)) or 'nothing'}; expected {FORMS}"
        )
    labelled = [(f"demonstration {i}", t, p) for i, (t, p) in enumerate(parts)]
    return built(path, labelled, names, units)
