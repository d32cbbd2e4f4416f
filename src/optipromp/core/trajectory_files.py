"""Trajectories to files and back: CSV, NPZ and plan folders."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import is_folder, read_npz, texts
from optipromp.core.tables import read_table
from optipromp.core.trajectory import Trajectory

CURVE = ("times", "positions", "velocities", "accelerations")
KINDS = ("", "_velocity", "_acceleration")  # of the columns of a CSV file


def csv(trajectory: Trajectory) -> bytes:
    """The rows as text: time, then positions, velocities and accelerations of every joint.

    Columns are named ``time``, the joints, then the joints with ``_velocity`` and with
    ``_acceleration``.
    """
    header = ["time", *(name + kind for kind in KINDS for name in trajectory.joint_names)]
    table = np.column_stack([trajectory.times, *trajectory.rows()])
    form = ",".join(["%.10g"] * table.shape[1])
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


def read_trajectory(path: str | Path, joint_names: Sequence[str]) -> Trajectory:
    """Read a trajectory of a robot, from any source.

    - ``.csv``: a column ``time`` [s], a column for each joint, and, for all joints or none,
      ``<joint>_velocity`` and ``<joint>_acceleration``.
    - ``.npz``: ``times`` (or ``time``) (T,), ``positions`` (T, n), optional ``velocities`` and
      ``accelerations``; ``joint_names`` (n,), by default in the robot's order.
    - a folder of ``optipromp plan --out``.

    Columns are matched to joints by name; see :func:`columns`. See :func:`curve` for rows without
    velocities and accelerations. Times may begin anywhere and be unevenly spaced.

    Args:
        path: of the file or folder.
        joint_names: of the robot, in its order.

    Raises:
        InvalidRequestError: there is no such file, the file is no trajectory, joints are missing or
            unknown, values are not finite, or times do not grow; the message names them.
    """
    path = Path(path)
    if is_folder(path):
        path = path / "waypoints.npz"
    try:
        if path.suffix.lower() == ".csv":
            return _from_csv(path, joint_names)
        if path.suffix.lower() == ".npz":
            return _from_npz(path, joint_names)
    except OptiPrompError as error:
        told = "" if str(path) in error.message else f"{path}: "
        raise InvalidRequestError(f"{told}{error.message}") from None
    raise InvalidRequestError(
        f"{path}: a trajectory is a .csv, an .npz or a folder of optipromp plan; a ROS bag is "
        "read by optipromp validate"
    )


def curve(
    times: FloatArray,
    rows: Sequence[FloatArray | None],
    names: Sequence[str],
    joint_names: Sequence[str],
) -> Trajectory:
    """A trajectory of a robot from rows in any order of joints.

    ``times``: (T,), beginning anywhere [s]. ``rows``: positions, velocities and accelerations (T,
    n). Without velocities (None) the curve is the smoothest through the positions, at rest at both
    ends. Without accelerations (None), those of the cubics through positions and velocities are
    taken: the mean of both sides. ``names``: of the n columns. ``joint_names``: of the robot, in
    its order.
    """
    order = columns(names, joint_names, "the trajectory")
    times = np.asarray(times, dtype=np.float64)
    positions, velocities, accelerations = (
        None if values is None else np.asarray(values, dtype=np.float64)[:, order]
        for values in rows
    )
    assert positions is not None
    times = times - times[:1]
    if velocities is None:
        return Trajectory.through(positions, times, tuple(joint_names))
    if accelerations is None:
        accelerations = _of_cubics(times, positions, velocities)
    return Trajectory(times, positions, velocities, accelerations, tuple(joint_names))


def columns(names: Sequence[str], joints: Sequence[str], what: str) -> list[int]:
    """The index in ``names`` of each of the n ``joints``; further names are ignored.

    Drivers put a prefix before all names of an arm (``fr3_joint1``). If the joints are not among
    the names, they are searched behind a prefix that all of them share.

    ``names``: in any order. ``joints``: of the robot, in its order. ``what``: the owner of the
    names, which begins the error.
    """
    names = list(names)
    if not joints:
        raise InvalidRequestError(f"{what} names no joints: must name one at least")
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise InvalidRequestError(f"{what}: joint {twice!r} is named twice: must be once")
    tails = (name.removesuffix(joints[0]) for name in names if name.endswith(joints[0]))
    prefixes = [p for p in tails if all(p + joint in names for joint in joints)]
    if "" in prefixes or len(prefixes) == 1:
        prefix = "" if "" in prefixes else prefixes[0]
        return [names.index(prefix + joint) for joint in joints]
    if prefixes:
        raise InvalidRequestError(
            f"{what}: the joints stand there behind each of the prefixes {', '.join(prefixes)}: "
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


def _from_npz(path: Path, joint_names: Sequence[str]) -> Trajectory:
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
    return curve(np.ravel(times), rows, names, joint_names)


def _from_csv(path: Path, joint_names: Sequence[str]) -> Trajectory:
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
    return curve(times, rows, names, joint_names)
