"""Trajectories: curves of joint values over time, for controllers; their CSV and NPZ files."""

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator

from optipromp.core.arrays import FloatArray, frozen, read_only
from optipromp.core.compiled import kernel
from optipromp.core.documents import read_table
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import is_folder, read_npz, reading, texts
from optipromp.core.shown import Shown
from optipromp.core.values import Array, Positive, Validated, refuse, value

GREATEST = 1e9
"""Largest size of a position, velocity, acceleration [rad or m, s] or time [s], chosen: values
derived from them do not overflow."""

SHORTEST_STEP = 1e-9
"""Least time between two rows [s], chosen."""

CLOSE = 5e-4
"""[s] Rows of a file that are closer are one: controllers send no faster than 1 kHz. A choice."""

SAME = 1e-4  # [rad or m] by which such rows may differ: noise and rounding, chosen
SPARSE, FEW = 5.0, 5  # [s] between more rows than these, beyond which times look like milliseconds

Motion = tuple[FloatArray, FloatArray, FloatArray]
"""Positions, velocities and accelerations, of one shape."""


NONE = frozen([])
Values = Annotated[FloatArray, Array(None, most=GREATEST)]
Rows = Annotated[FloatArray, Array(None, None, most=GREATEST)]


@dataclass(frozen=True, eq=False)
class State(Validated, label="state."):
    """Positions, velocities and accelerations of n joints; at rest by default.

    Args:
        q: (n,) [rad or m].
        velocity: (n,) [rad/s or m/s].
        acceleration: (n,) [rad/s² or m/s²].

    Raises:
        InvalidRequestError: arrays of different sizes, or a value that is not finite.
    """

    q: Values
    velocity: Values = field(default_factory=lambda: NONE)
    acceleration: Values = field(default_factory=lambda: NONE)

    def __post_init__(self) -> None:
        super().__post_init__()
        for what in ("velocity", "acceleration"):
            values = getattr(self, what)
            if not len(values):
                object.__setattr__(self, what, read_only(np.zeros_like(self.q)))
            elif len(values) != len(self.q):
                raise InvalidRequestError(
                    f"state.{what} has shape {values.shape}: must be that of q, {self.q.shape}"
                )

    @property
    def moving(self) -> bool:
        """Whether a velocity or an acceleration is not zero."""
        return bool(self.velocity.any() or self.acceleration.any())

    def near(self, other: "State", most: float) -> bool:
        """Whether each value of ``other`` differs by at most ``most``."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return all(float(np.abs(a - b).max()) <= most for a, b in pairs)


def _growing(times: FloatArray) -> FloatArray:
    if len(times) and times[0] != 0.0:
        raise refuse(f"begin at {times[0]:g}; they must begin at 0 [s]")
    if (short := times[1:] - times[:-1] < SHORTEST_STEP).any():
        row = int(short.argmax())
        raise refuse(
            f"do not grow: {times[row]:g} s at waypoint {row}, then {times[row + 1]:g} s; "
            f"they must by {SHORTEST_STEP:g} s"
        )
    return times


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Shown, Validated):
    r"""A curve of n joints in time, with continuous positions, velocities and accelerations.

    T rows define the curve. Between two rows, a time h apart, each joint follows the quintic
    polynomial with the positions, velocities and accelerations of both, as in ROS 2's joint
    trajectory controller. With s from 0 to 1 between the rows,

    .. math:: q(s) = \sum_{k=0}^5 \binom{5}{k} s^k (1-s)^{5-k} b_k

    where :math:`b_0 = q_0`, :math:`b_1 = q_0 + h\dot q_0/5`,
    :math:`b_2 = q_0 + 2h\dot q_0/5 + h^2\ddot q_0/20`, and likewise from the other end.

    Args:
        times: (T,) of the rows [s]; they begin at 0 and grow.
        positions: (T, n) [rad, or m for a prismatic joint].
        velocities: (T, n) [rad/s or m/s].
        accelerations: (T, n) [rad/s² or m/s²].
        joint_names: n names.

    Raises:
        InvalidRequestError: fewer than 2 rows, arrays of different shapes, a value that is not
            finite, times that do not begin at 0 or do not grow, or a wrong number of names.
    """

    times: Annotated[Values, AfterValidator(_growing)]
    positions: Rows
    velocities: Rows
    accelerations: Rows
    joint_names: tuple[str, ...]

    def __post_init__(self) -> None:
        super().__post_init__()
        names, times, shape = self.joint_names, self.times, self.positions.shape
        if shape[0] < 2:
            raise InvalidRequestError(
                f"a trajectory needs at least 2 waypoints as (T, n); got shape {shape}"
            )
        if shape[1] != len(names):
            raise InvalidRequestError(f"{len(names)} joint names for {shape[1]} columns")
        if len(times) != shape[0]:
            raise InvalidRequestError(f"{len(times)} times for {shape[0]} waypoints")
        for what in ("velocities", "accelerations"):
            values = getattr(self, what)
            if values.shape != shape:
                raise InvalidRequestError(
                    f"{what} have shape {values.shape}; positions have {shape}"
                )

    @classmethod
    def through(
        cls,
        positions: FloatArray,
        times: FloatArray | float,
        joint_names: tuple[str, ...],
        *,
        begin: State | None = None,
    ) -> "Trajectory":
        """The smoothest curve through waypoints: a quintic spline with four derivatives.

        Args:
            positions: (T, n) waypoints.
            times: (T,) of the waypoints [s], or the time between two [s].
            joint_names: n names.
            begin: how the joints move at the first waypoint; None: at rest. The end is at rest.

        Raises:
            InvalidRequestError: as :class:`Trajectory`.
        """
        q = np.asarray(positions, dtype=np.float64)
        if isinstance(times, float | int):
            at = np.asarray(np.arange(len(q)) * value("dt", times, Positive))
        else:
            at = times
        still = np.zeros_like(q)
        rough = cls(at, q, still, still, joint_names)  # checks the arguments
        return cls(rough.times, q, *derivatives(q, rough.times, begin), joint_names)

    @classmethod
    def still(cls, q: FloatArray, times: ArrayLike, joint_names: tuple[str, ...]) -> "Trajectory":
        """A stay at positions ``q`` (n,), with rows at ``times`` (T,) [s]."""
        rest = np.zeros((np.size(times), len(q)))
        return cls(np.asarray(times), q + rest, rest, rest, joint_names)

    def _words(self) -> str:
        return (
            f"of {len(self.joint_names)} joints, {len(self.times)} waypoints, {self.duration:.2f} s"
        )

    @property
    def n_waypoints(self) -> int:
        """T, the number of rows."""
        return int(self.positions.shape[0])

    @property
    def duration(self) -> float:
        """Time from the first row to the last [s]."""
        return float(self.times[-1])

    def at(self, time: float) -> State:
        """The state at ``time`` [s]."""
        return State(*(values[0] for values in self.sample(time)))

    def rows(self, which: Any = slice(None)) -> Motion:
        """Positions, velocities and accelerations of some rows, (m, n) each."""
        return self.positions[which], self.velocities[which], self.accelerations[which]

    def sample(self, times: ArrayLike) -> Motion:
        """Positions, velocities and accelerations at ``times`` (M,), each (M, n).

        Before its first and after its last row the curve has the values of that row.
        """
        t = np.clip(np.atleast_1d(np.asarray(times, dtype=np.float64)), 0.0, self.duration)
        row = np.clip(np.searchsorted(self.times, t, side="right") - 1, 0, self.n_waypoints - 2)
        h = np.diff(self.times)[row]
        s, out = ((t - self.times[row]) / h)[:, None], []
        b = control_points(h[:, None], self.rows(row), self.rows(row + 1))
        for order, factor in enumerate((1.0, 5.0, 20.0)):
            points = np.diff(b, order, axis=0)
            while len(points) > 1:  # de Casteljau's algorithm
                points = points[:-1] + s * (points[1:] - points[:-1])
            out.append(np.asarray(factor * points[0] / h[:, None] ** order))
        return out[0], out[1], out[2]

    def resample(self, rate: float) -> "Trajectory":
        """The same curve with rows at ``rate`` [Hz]; the last row is at the end of the curve.

        Raises:
            InvalidRequestError: the rate is not positive, or needs over 10 million rows.
        """
        if not (np.isfinite(rate) and rate > 0):
            raise InvalidRequestError(f"rate is {rate:g}; it must be positive [Hz]")
        if self.duration * rate > 1e7:
            raise InvalidRequestError(f"{rate:g} Hz over {self.duration:g} s: over 10 million rows")
        times = np.arange(int(np.ceil(self.duration * rate - 1e-6))) / rate
        times = np.append(times, self.duration)
        return Trajectory(times, *self.sample(times), self.joint_names)

    def slowed(self, factor: float) -> "Trajectory":
        """The same path in ``factor`` times the time."""
        return Trajectory(
            self.times * factor,
            self.positions,
            self.velocities / factor,
            self.accelerations / (factor * factor),
            self.joint_names,
        )


def chained(parts: Sequence[Trajectory]) -> Trajectory:
    """Trajectories one after the other; each begins where, and as, the one before it ends."""
    begins = np.append(0.0, np.cumsum([part.duration for part in parts]))
    which = [slice(int(k > 0), None) for k in range(len(parts))]
    times = [b + part.times[r] for b, part, r in zip(begins[:-1], parts, which, strict=True)]
    rows = [part.rows(r) for part, r in zip(parts, which, strict=True)]
    q, v, a = (np.concatenate(one) for one in zip(*rows, strict=True))
    return Trajectory(np.concatenate(times), q, v, a, parts[0].joint_names)


def derivatives(
    positions: FloatArray, times: FloatArray, begin: State | None = None
) -> tuple[FloatArray, FloatArray]:
    """Velocities and accelerations (T, n) of the quintic spline through ``positions`` (T, n).

    ``begin``: velocity and acceleration at the first position; None: at rest. At the last position
    the joints are at rest.
    """
    v, a = np.zeros((2, *positions.shape))
    if begin is not None:
        v[0], a[0] = begin.velocity, begin.acceleration
    _join(np.ascontiguousarray(positions), np.diff(times), v, a)
    return v, a


@kernel
def _join(q, h, v, a):
    """Set the rows of ``v``, ``a`` (T, n) between the first and the last, for waypoints ``q``.

    At each of these waypoints the fourth and the third derivative of the quintics on both sides,
    which last ``h`` (T-1,) [s], are the same. These equations, two a waypoint, are symmetric and
    positive definite (they minimise the integral of the squared jerk), and solved block by block:
    (v, a) of row i is ``m[i]`` times that of row i + 1, plus what stands in ``v[i]``, ``a[i]``.
    """
    count, n = q.shape
    m = np.zeros((count, 4))
    for i in range(1, count - 1):
        g, f = h[i - 1], h[i]
        g2, f2 = g * g, f * f
        # of (v, a) before: fourth derivative, third derivative
        b0, b1, b2, b3 = 168.0 / (g2 * g), 24.0 / g2, -24.0 / g2, -3.0 / g
        m0, m1, m2, m3 = m[i - 1]
        d0 = 192.0 / (g2 * g) + 192.0 / (f2 * f) + b0 * m0 + b1 * m2
        d1 = 36.0 / f2 - 36.0 / g2 + b0 * m1 + b1 * m3
        d2 = 36.0 / f2 - 36.0 / g2 + b2 * m0 + b3 * m2
        d3 = 9.0 / f + 9.0 / g + b2 * m1 + b3 * m3
        over = 1.0 / (d0 * d3 - d1 * d2)
        c0, c1, c2, c3 = 168.0 / (f2 * f), -24.0 / f2, 24.0 / f2, -3.0 / f
        m[i, 0], m[i, 1] = -over * (d3 * c0 - d1 * c2), -over * (d3 * c1 - d1 * c3)
        m[i, 2], m[i, 3] = -over * (d0 * c2 - d2 * c0), -over * (d0 * c3 - d2 * c1)
        for k in range(n):
            back, on = (q[i, k] - q[i - 1, k]) / (g2 * g), (q[i + 1, k] - q[i, k]) / (f2 * f)
            r0 = 360.0 * (on / f + back / g) - b0 * v[i - 1, k] - b1 * a[i - 1, k]
            r1 = 60.0 * (on - back) - b2 * v[i - 1, k] - b3 * a[i - 1, k]
            v[i, k], a[i, k] = over * (d3 * r0 - d1 * r1), over * (d0 * r1 - d2 * r0)
    for i in range(count - 2, 0, -1):
        for k in range(n):
            x, y = v[i + 1, k], a[i + 1, k]
            v[i, k] += m[i, 0] * x + m[i, 1] * y
            a[i, k] += m[i, 2] * x + m[i, 3] * y


def control_points(h: FloatArray, begin: Motion, end: Motion) -> FloatArray:
    """Bernstein coefficients (6, m, n) of m quintics; see :class:`Trajectory`.

    A quintic lasts a time ``h`` (m, 1) [s]. ``begin`` and ``end`` are positions, velocities and
    accelerations, (m, n) each.
    """
    (q, v, a), (r, w, b) = begin, end
    v, w, a, b = h * v / 5.0, h * w / 5.0, h * h * a / 20.0, h * h * b / 20.0
    return np.stack([q, q + v, q + 2.0 * v + a, r - 2.0 * w + b, r - w, r])


CURVE = ("times", "positions", "velocities", "accelerations")
KINDS = ("", "_velocity", "_acceleration")  # of the columns of a CSV file


def csv(trajectory: Trajectory) -> bytes:
    """The rows as text: time, then positions, velocities and accelerations of every joint.

    Columns are named ``time``, the joints, then the joints with ``_velocity`` and with
    ``_acceleration``.
    """
    header = ["time", *(name + kind for kind in KINDS for name in trajectory.joint_names)]
    table = np.column_stack([trajectory.times, *trajectory.rows()])
    form = ",".join(["%.15g"] * table.shape[1])
    lines = (form % tuple(row) for row in table.tolist())
    return "\n".join([",".join(header), *lines, ""]).encode()


def arrays(trajectory: Trajectory, prefix: str = "") -> dict[str, Any]:
    """The rows as arrays by name: ``times``, ``positions``, ``velocities``, ``accelerations``."""
    values = {prefix + name: getattr(trajectory, name) for name in CURVE}
    return values | {"joint_names": np.array(trajectory.joint_names, dtype=np.str_)}


def from_arrays(rows: Mapping[str, Any], prefix: str = "") -> Trajectory:
    """The trajectory of :func:`arrays`."""
    names = texts(rows["joint_names"])
    times, positions, velocities, accelerations = (rows[prefix + name] for name in CURVE)
    return Trajectory(times, positions, velocities, accelerations, names)


Unwind = Callable[[FloatArray], FloatArray]
"""Of positions (T, n) in the robot's order: the same without steps of whole turns."""


def read_trajectory(
    path: str | Path, joint_names: Sequence[str], unwind: Unwind | None = None
) -> Trajectory:
    """Read a trajectory of a robot, from any source.

    - ``.csv``: a column ``time`` [s], a column for each joint, and, for all joints or none,
      ``<joint>_velocity`` and ``<joint>_acceleration``.
    - ``.npz``: ``times`` (or ``time``) (T,), ``positions`` (T, n), optional ``velocities`` and
      ``accelerations``; ``joint_names`` (n,), by default in the robot's order.
    - a folder of ``optipromp plan --out``.

    Columns are matched by name; see :func:`joint_columns`. See :func:`curve` for rows without
    velocities and accelerations. Times may begin anywhere and be unevenly spaced.

    Args:
        path: of the file or folder.
        joint_names: of the robot, in its order.
        unwind: as for :func:`curve`.

    Raises:
        InvalidRequestError: there is no such file, the file is no trajectory, joints are missing or
            unknown, values are not finite, or times do not grow; the message names them.
    """
    path = Path(path)
    if is_folder(path):
        path = path / "waypoints.npz"
    with reading(path, "no trajectory"):
        if path.suffix.lower() == ".csv":
            return _from_csv(path, joint_names, unwind)
        if path.suffix.lower() == ".npz":
            return _from_npz(path, joint_names, unwind)
    raise InvalidRequestError(
        f"{path}: a trajectory is a .csv, an .npz or a folder of optipromp plan; a ROS bag is "
        "read by optipromp validate"
    )


def curve(
    times: FloatArray,
    rows: Sequence[FloatArray | None],
    names: Sequence[str],
    joint_names: Sequence[str],
    unwind: Unwind | None = None,
) -> Trajectory:
    """A trajectory of a robot from rows in any order of joints.

    ``times``: (T,), beginning anywhere [s]. ``rows``: positions, velocities and accelerations (T,
    n). Without velocities (None) the curve is the smoothest through the positions, at rest at both
    ends. Without accelerations (None), those of the cubics through positions and velocities are
    taken: the mean of both sides. ``names``: of the n columns. ``joint_names``: of the robot, in
    its order. Rows closer than :data:`CLOSE` are one. ``unwind``: takes out the steps of a whole
    turn of joints that may turn, with a warning; None: such a step is a motion.
    """
    order = joint_columns(names, joint_names, "the trajectory")
    times = np.asarray(times, dtype=np.float64)
    positions, velocities, accelerations = (
        None if values is None else np.asarray(values, dtype=np.float64)[:, order]
        for values in rows
    )
    assert positions is not None
    if unwind is not None and np.isfinite(positions).all():
        told, positions = positions, unwind(positions)
        if (moved := positions != told).any():
            row, joint = (int(k) for k in np.argwhere(moved)[0])
            warnings.warn(
                f"{joint_names[joint]} steps by a whole turn before row {row}: read as reported "
                "within one turn; a controller that takes the rows as they are would turn back",
                stacklevel=4,
            )
    stated = velocities is not None and accelerations is not None
    chosen = _knots(times, positions, joint_names, stated)
    times, positions = times[chosen] - times[:1], positions[chosen]
    velocities = None if velocities is None else velocities[chosen]
    accelerations = None if accelerations is None else accelerations[chosen]
    if velocities is None:
        return Trajectory.through(positions, times, tuple(joint_names))
    if accelerations is None:
        accelerations = _of_cubics(times, positions, velocities)
    return Trajectory(times, positions, velocities, accelerations, tuple(joint_names))


def _knots(
    times: FloatArray, positions: FloatArray, names: Sequence[str], stated: bool
) -> list[int]:
    """Rows that define a curve: of rows closer than :data:`CLOSE` the first, at the end the last.

    Such rows between which a joint moves are refused, unless velocities and accelerations are
    ``stated``, too: without these they would be guessed from the step.
    """
    if times.ndim != 1 or len(times) != len(positions) or not np.isfinite(times).all():
        return list(range(len(times)))  # which is refused by Trajectory
    if not stated and len(times) > FEW and (step := np.median(np.diff(times))) > SPARSE:
        warnings.warn(
            f"rows are {step:.3g} s apart: are times in milliseconds? they must be in seconds",
            stacklevel=4,
        )
    chosen = [0] if len(times) else []
    for row in range(1, len(times)):
        before = chosen[-1]
        moved = np.abs(positions[row] - positions[before])
        one = bool(moved.max() <= SAME)  # not where a position is not a number
        if not 0.0 <= times[row] - times[before] < CLOSE or (stated and not one):
            chosen.append(row)
        elif not one:
            joint = int(np.argmax(moved))
            raise InvalidRequestError(
                f"waypoints {before} and {row} are {times[row] - times[before]:.3g} s apart, and "
                f"{names[joint]} differs by {moved[joint]:.3g}: rows closer than {CLOSE:g} s must "
                "be the same"
            )
        elif row == len(times) - 1 and before > 0:
            chosen[-1] = row
    return chosen


def prefixes(names: Collection[str], joints: Sequence[str]) -> list[str]:
    """The prefixes behind which all ``joints`` stand among the names; the empty one alone, if so.

    Drivers put a prefix before all names of an arm (``fr3_joint1``).
    """
    tails = (name.removesuffix(joints[0]) for name in names if name.endswith(joints[0]))
    found = [p for p in tails if all(p + joint in names for joint in joints)]
    return [""] if "" in found else found


def joint_columns(names: Sequence[str], joints: Sequence[str], what: str) -> list[int]:
    """The index in ``names`` of each of the n ``joints``; further names are ignored.

    If the joints are not among the names, they are searched behind a prefix that all of them share.

    ``what``: the owner of the names, which begins the error.
    """
    names = list(names)
    if not joints:
        raise InvalidRequestError(f"{what} names no joints: must name one at least")
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InvalidRequestError(f"{what}: joint {twice!r} is named twice: must be once")
    found = prefixes(names, joints)
    if len(found) == 1:
        return [names.index(found[0] + joint) for joint in joints]
    if found:
        raise InvalidRequestError(
            f"{what}: the joints stand there behind each of the prefixes {', '.join(found)}: "
            "must be one arm"
        )
    missing = [joint for joint in joints if joint not in names]
    raise InvalidRequestError(
        f"{what}: joint {', '.join(missing)} is missing; it names {', '.join(names) or 'none'}. "
        f"It must name {', '.join(joints)}, with one prefix for all or none"
    )


def _of_cubics(times: FloatArray, q: FloatArray, velocity: FloatArray) -> FloatArray:
    """Accelerations (T, n) of the cubics between rows: the mean of both sides of a row."""
    h = np.diff(times)[:, None]
    chord = 6.0 * np.diff(q, axis=0) / h
    after = (chord - 4.0 * velocity[:-1] - 2.0 * velocity[1:]) / h
    before = (4.0 * velocity[1:] + 2.0 * velocity[:-1] - chord) / h
    middle = 0.5 * (before[:-1] + after[1:])
    return np.concatenate([after[:1], middle, before[-1:]])


def _from_npz(path: Path, joint_names: Sequence[str], unwind: Unwind | None) -> Trajectory:
    found = read_npz(path)
    for name in set(found) & {"time", *CURVE}:
        if found[name].dtype.kind not in "fiu":
            raise InvalidRequestError(f"{name} holds {found[name].dtype}, not numbers")
    times = found.get("times", found.get("time"))
    if times is None or "positions" not in found:
        raise InvalidRequestError(
            f"it holds {', '.join(sorted(found))}; a trajectory has times (T,) and positions (T, n)"
        )
    positions = np.asarray(found["positions"])
    if positions.ndim != 2:
        raise InvalidRequestError(f"positions have shape {positions.shape}, not (T, n)")
    names = texts(found.get("joint_names", joint_names))
    rows = [positions, found.get("velocities"), found.get("accelerations")]
    for what, values in zip(CURVE[1:], rows, strict=True):
        if values is not None and np.shape(values) != (len(np.ravel(times)), len(names)):
            raise InvalidRequestError(
                f"{what} have shape {np.shape(values)}; {len(np.ravel(times))} times and "
                f"{len(names)} joints ask for ({len(np.ravel(times))}, {len(names)})"
            )
    return curve(np.ravel(times), rows, names, joint_names, unwind)


def _from_csv(path: Path, joint_names: Sequence[str], unwind: Unwind | None) -> Trajectory:
    table = read_table(path, InvalidRequestError, "time,<joint>,...")
    header = table.header
    if header.count("time") != 1 or len(set(header)) != len(header):
        raise InvalidRequestError("expected a header time,<joint>,..., each name once")
    rates = {name + kind for name in header for kind in KINDS[1:]}
    names = [name for name in header if name != "time" and name not in rates]
    rows: list[FloatArray | None] = []
    for kind in KINDS:
        known = [name + kind for name in names if name + kind in header]
        if known and len(known) < len(names):
            lacking = next(name + kind for name in names if name + kind not in header)
            raise InvalidRequestError(f"it has {known[0]}, but not {lacking}: all joints, or none")
        rows.append(table.numbers([header.index(name) for name in known]) if known else None)
    if rows[0] is None:
        raise InvalidRequestError("it has no column of a joint")
    times = table.numbers([header.index("time")])[:, 0]
    return curve(times, rows, names, joint_names, unwind)
