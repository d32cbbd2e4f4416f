"""Where an arm was: its joint states in, by one driver or several, its configuration at a time out.

Recordings, pictures, the closed loop and the guard read an arm's state here, by one rule.
"""

import math
import warnings
from collections import deque
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.turns import Turns, unwrapped
from optipromp.core.trajectory import State, prefixes

GAP = 0.2  # [s] longest time without a state of the arm, across which nobody knows it: a choice
AT_REST = 0.01
"""[rad/s or m/s] A slower joint is at rest: encoders are noisy. A choice; the arm's controller
smooths a step of this size."""
_JITTER = 5.0  # usual steps by which the time may run back: messages that overtake each other
_SAME = 0.05  # [rad or m] parts of a recording that differ by less at all times are one


class Series(NamedTuple):
    """Times (m,) [s], increasing, and the positions (m, n) then [rad or m]."""

    times: FloatArray
    q: FloatArray

    def at(self, times: FloatArray) -> FloatArray:
        """Positions (k, n) at ``times`` (k,), linear between rows, the same before and after."""
        return np.stack([np.interp(times, self.times, column) for column in self.q.T], axis=1)

    def steps(self, times: FloatArray) -> FloatArray:
        """Time between the rows around each of ``times`` (k,) [s]; 0 at a row and outside."""
        before = np.searchsorted(self.times, times, side="right") - 1
        after = np.searchsorted(self.times, times)
        low, high = (np.clip(k, 0, len(self.times) - 1) for k in (before, after))
        return np.asarray(self.times[high] - self.times[low])


class _Heard(NamedTuple):
    time: float
    names: tuple[str, ...]
    q: FloatArray
    velocity: FloatArray


class Measured:
    """The joint states of one arm.

    Joints are found by their names. Drivers may put one prefix before all names of an arm, and may
    send some of its joints each. Joints that may turn are put onto the turn nearest to the one
    before. Where the time runs back, a clock was set: the states of before are of another clock.

    Args:
        joints: of the arm, n names, in its order.
        turns: of these; None: joints that are reported within one turn are taken to turn.
        prefix: before the names, which alone is read; empty: the only one that is heard.
        kept: how long states are remembered [s]. States that run back by more than :data:`GAP` end
            those before them, and later ones are late. Infinite: all are read, as a recording.
        gap: longest time between two states across which the arm is known [s].
        held: how long before its first and after its last state the arm is as then [s].
        what: these states, in errors and warnings.
    """

    def __init__(
        self, joints: Sequence[str], turns: Turns | None = None, *, prefix: str = "",
        kept: float = math.inf, gap: float = GAP, held: float = GAP, what: str = "joint_states",
    ) -> None:  # fmt: skip
        self.joints, self.what = tuple(joints), what
        self.prefix = prefix or None  # before the joints' names; None: it is not known yet
        self._turns, self._stated, self._kept = turns, prefix, kept
        self._gap, self._held = gap, held
        # of the joints' full names, once the prefix is known
        self._columns = {prefix + name: k for k, name in enumerate(self.joints)} if prefix else {}
        self._names = dict[str, None]()  # of joints that may be the arm's
        self._waiting: list[_Heard] = []  # until all joints were heard
        self._drivers: dict[tuple[int, ...], deque[_Heard]] = {}  # by the joints that they send
        self._joined: list[Series] | None = None

    # -- what is heard

    def heard(
        self, time: float, names: Sequence[str], positions: ArrayLike, velocities: ArrayLike = ()
    ) -> None:
        """Take the joint states of a ``time`` in [s].

        Args:
            time: by the clock that :meth:`at` is asked by.
            names: of m joints, some or all of the arm's, and others, which are left out.
            positions: (m,) [rad or m].
            velocities: (m,) [rad/s or m/s], or none.

        Raises:
            InvalidRequestError: none of the arm's joints; two arms and no prefix; a joint that is
                named twice; another number of values; a value that is not finite.
        """
        q = values(names, positions, "positions", self.what)
        known = np.size(velocities) > 0
        velocity = values(names, velocities, "velocities", self.what) if known else np.zeros_like(q)
        mine = self.mine(names)
        one = _Heard(float(time), tuple(names[k] for k in mine), q[mine], velocity[mine])
        for k, name in enumerate(one.names):
            told = f"{self.what}: {name} is"
            if name in one.names[:k]:
                raise InvalidRequestError(f"{told} named twice: must be once")
            for kind, value in (("", one.q[k]), ("of velocity ", one.velocity[k])):
                if not math.isfinite(value):
                    raise InvalidRequestError(f"{told} {kind}{value}: must be finite")
        self._find(one.names)
        if self._columns.keys() & set(one.names):
            self._take(one)
        elif mine and not self._columns:
            self._waiting = [each for each in self._waiting if each.time >= time - self._kept]
            self._waiting.append(one)
        else:
            raise self._lacks(self.joints, names)

    def mine(self, names: Sequence[str]) -> list[int]:
        """The indices of the names that may be of the arm's joints."""
        if self._stated:
            return [k for k, name in enumerate(names) if name in self._columns]
        return [k for k, name in enumerate(names) if name.endswith(self.joints)]

    def _lacks(self, joints: Sequence[str], names: Collection[str]) -> InvalidRequestError:
        told = ", ".join(self._stated + name for name in joints)
        return InvalidRequestError(
            f"{self.what}: joint {told} is missing; it names {', '.join(names) or 'none'}"
            + ". One prefix may stand before all of an arm" * (not self._stated)
        )

    def _find(self, names: Sequence[str]) -> None:
        """Find the prefix of the arm's joints among all names so far."""
        new = [name for name in names if name not in self._names]
        self._names.update(dict.fromkeys(new))
        if self._stated or (self._columns and not new):
            return
        found = prefixes(self._names, self.joints)
        if len(found) > 1:
            self.forget()
            self._columns, self.prefix = {}, None
            raise InvalidRequestError(
                f"{self.what}: the joints stand there behind each of the prefixes "
                f"{', '.join(found)}: must be one arm, or have its prefix named"
            )
        columns = {found[0] + name: k for k, name in enumerate(self.joints)} if found else {}
        if columns != self._columns:
            waiting = self._waiting
            self.forget()
            self._columns, self.prefix = columns, found[0] if found else None
            for one in waiting:
                if columns.keys() & set(one.names):
                    self._take(one)

    def _take(self, one: _Heard) -> None:
        """Keep what is the arm's with what the same driver told before."""
        found = {self._columns.get(name, -1): k for k, name in enumerate(one.names)}
        columns = tuple(sorted(found.keys() - {-1}))
        rows = [found[column] for column in columns]
        kept = self._drivers.setdefault(columns, deque())
        if self._kept < math.inf and kept and one.time <= kept[-1].time:
            if kept[-1].time > one.time >= kept[-1].time - self._gap:
                return  # a message that was overtaken
            kept.pop() if one.time == kept[-1].time else kept.clear()
        q = one.q[rows]
        if self._kept < math.inf and kept and self._turns is not None:
            q = self._turns.of_joints(columns).onto(q, kept[-1].q)
        kept.append(_Heard(one.time, (), q, one.velocity[rows]))
        while kept[0].time < one.time - self._kept:
            kept.popleft()
        for other in [each for each in self._drivers if each != columns]:
            if self._drivers[other][-1].time < one.time - self._kept:
                del self._drivers[other]  # that driver is gone
        self._joined = None

    def __copy__(self) -> "Measured":
        made = object.__new__(Measured)
        vars(made).update(vars(self), _names=dict(self._names), _waiting=list(self._waiting))
        made._drivers = {key: kept.copy() for key, kept in self._drivers.items()}
        return made

    def forget(self) -> None:
        """Drop all states so far, as where a clock was set."""
        self._waiting, self._joined = [], None
        self._drivers.clear()

    # -- where the arm was

    @property
    def lacking(self) -> tuple[str, ...]:
        """The joints of which no state is known."""
        known = {column for columns in self._drivers for column in columns}
        return tuple(name for k, name in enumerate(self.joints) if k not in known)

    @property
    def silent(self) -> str:
        """That there are no joint states, and of which joints where there are of others."""
        some = f" of {', '.join(self.lacking)}" if len(self.lacking) < len(self.joints) else ""
        return f"no joint states{some}"

    @property
    def newest(self) -> tuple[float, State] | None:
        """Time of the newest state of all joints [s], and that state.

        None: of some joint there is none.
        """
        if self.lacking:
            return None
        drivers = self._chosen()
        time = min(self._drivers[columns][-1].time for columns in drivers)
        q, velocity = np.zeros((2, len(self.joints)))
        for columns in drivers:
            rows, mine = self._drivers[columns], list(columns)
            k = next((k for k in range(len(rows) - 1, 0, -1) if rows[k].time <= time), 0)
            near = [rows[i] for i in range(k, min(k + 2, len(rows)))]
            around = self._unwound(np.array([one.q for one in near]), columns)
            at = Series(np.array([one.time for one in near]), around).at(np.array([time]))
            q[mine], velocity[mine] = at[0], rows[-1].velocity
        return time, State(q) if np.abs(velocity).max() < AT_REST else State(q, velocity)

    def at(self, time: float) -> FloatArray:
        """(n,) where the arm was at a ``time`` [s], linear between joint states.

        Raises:
            InvalidRequestError: nobody knows: before the first states or after the newest, in a
                gap, or at a time that was twice, as a clock was set.
        """
        if len(self.lacking) == len(self.joints):
            self._find(())
            raise InvalidRequestError(
                "where the arm was is unknown: joint states must come first, of the arm's joints"
            )
        parts, held = self.series(), self._held
        near = [one for one in parts if one.times[0] - held <= time <= one.times[-1] + held]
        if not near:
            last = max((float(one.times[-1]) for one in parts), default=math.inf)
            if time > last:
                raise InvalidRequestError(
                    f"the stamp is {time - last:.3f} s after the newest joint states: must be "
                    f"{held:g} s at most, by the same clock"
                )
            raise InvalidRequestError(
                f"where the arm was is unknown: the stamp is in no part of {self.what}: joint "
                "states must come first, by the same clock"
            )
        near = [one for one in near if one.times[0] <= time <= one.times[-1]] or near
        asked = np.array([time])
        found = [(float(one.steps(asked)[0]), np.asarray(one.at(asked)[0])) for one in near]
        step, q = min(found, key=lambda each: each[0])  # of the smaller gap
        if step > self._gap:
            raise InvalidRequestError(
                f"where the arm was is unknown: no joint states came for {step:.3f} s around then, "
                f"must be {self._gap:g} s at most"
            )
        apart = np.subtract if self._turns is None else self._turns.apart
        if max(float(np.abs(apart(other, q)).max()) for _, other in found) > _SAME:
            raise InvalidRequestError(
                f"where the arm was is unknown: the clock of {self.what} was set back, and the arm "
                "was elsewhere at each of both times: record anew, with one clock"
            )
        return q

    def series(self) -> list[Series]:
        """The positions (m, n) over time, between the times at which the clock was set.

        Times are those of the driver of the first joint, where all others were heard.

        Raises:
            InvalidRequestError: a joint was never heard; drivers with two clocks.
        """
        if lacking := self.lacking:
            raise self._lacks(lacking, self._names)
        if self._joined is None:
            self._joined = self._join()
        return self._joined

    def _chosen(self) -> list[tuple[int, ...]]:
        """The drivers that tell of all joints: those of most joints first."""
        known, out = set[int](), list[tuple[int, ...]]()
        for columns in sorted(self._drivers, key=lambda each: (-len(each), each)):
            if set(columns) - known:
                out.append(columns)
                known |= set(columns)
        return sorted(out)

    def _join(self) -> list[Series]:
        drivers, each = self._chosen(), []
        for columns in drivers:
            rows = self._drivers[columns]
            times, q = np.array([one.time for one in rows]), np.array([one.q for one in rows])
            parts = parts_in_time(self.what, times, q, stacklevel=6)
            each.append([Series(at, self._unwound(part, columns)) for at, part in parts])
        if len({len(parts) for parts in each}) > 1:
            raise InvalidRequestError(
                f"{self.what}: the joints of the arm are in messages of two clocks"
            )
        out = []
        for parts in map(list, zip(*each, strict=True)):
            times, gap = parts[0].times, self._gap
            q, near = np.empty((len(times), len(self.joints))), np.ones(len(times), dtype=np.bool_)
            for columns, one in zip(drivers, parts, strict=True):
                q[:, list(columns)] = one.q if one is parts[0] else one.at(times)
                near &= (times >= one.times[0]) & (times <= one.times[-1])
                near &= (one.steps(times) <= gap) | (one is parts[0])
            if near.any():
                out.append(Series(times[near], q[near]))
        return out

    def _unwound(self, q: FloatArray, columns: tuple[int, ...]) -> FloatArray:
        """Rows (T, k) of a driver on turns that follow one another, also beyond limits.

        Which turn a driver means is not known: it may count from 0, and the limits from -2π.
        """
        if self._turns is None:
            return unwrapped(q)
        may = self._turns.of_joints(columns).may
        most = np.full(may.shape, np.inf)
        return Turns(may, -most, most).unwound(q)


def values(names: Sequence[str], given: ArrayLike, kind: str, what: str) -> FloatArray:
    """The values (m,) of m joints, if they are as many as the ``names``."""
    out = np.asarray(given, dtype=np.float64)
    if len(out) and not len(names):
        raise InvalidRequestError(f"{what}: name is empty: must name the joint of each position")
    if len(out) != len(names):
        none = ", or none" if kind == "velocities" else ""
        raise InvalidRequestError(
            f"{what}: {len(out)} {kind} for {len(names)} names: must be as many{none}"
        )
    return out


def parts_in_time(
    what: str, times: FloatArray, positions: FloatArray, stacklevel: int = 4
) -> list[Series]:
    """Each part of a recording: times increase in it.

    Where the time runs back a clock was set, and a part ends: unless messages overtook each other,
    or the parts say the same of the times that they share. Of rows at one time the first stays.

    Args:
        what: the recording; begins the warnings of what was cut or left out.
        times: (m,) as recorded, in any unit.
        positions: (m, n) [rad or m].
        stacklevel: of the warnings.
    """

    def in_order(rows: IntArray) -> IntArray:
        return rows[np.unique(times[rows], return_index=True)[1]]

    steps = np.diff(times)
    jitter = _JITTER * np.quantile(np.abs(steps), 0.75) if len(steps) else 0.0
    back = np.flatnonzero(steps < -jitter) + 1
    parts: list[IntArray] = []
    for rows in np.split(np.arange(len(times)), back):
        for k, part in enumerate(parts):
            if _agree(times, positions, part, in_order(rows)):
                parts[k] = in_order(np.concatenate([part, rows]))
                break
        else:
            if parts:
                warnings.warn(
                    f"{what}: the time runs back by {-steps[rows[0] - 1]:.6g} at row {rows[0]}: "
                    "cut there, and both parts are read",
                    stacklevel=stacklevel,
                )
            parts.append(in_order(rows))
    if dropped := len(times) - sum(map(len, parts)):
        words = f"{dropped} of {len(times)} rows have the time of another: left out"
        warnings.warn(f"{what}: {words}", stacklevel=stacklevel)
    return [Series(times[part], positions[part]) for part in parts]


def _agree(times: FloatArray, positions: FloatArray, a: IntArray, b: IntArray) -> bool:
    """Whether two parts share a stretch of time, and have the same positions then."""
    shared = b[(times[b] >= times[a[0]]) & (times[b] <= times[a[-1]])]
    if not len(shared):
        return False
    there = Series(times[a], positions[a]).at(times[shared])
    return bool(np.abs(there - positions[shared]).max() < _SAME)
