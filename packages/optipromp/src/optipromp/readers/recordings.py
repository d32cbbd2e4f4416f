"""Demonstrations from tables (CSV), folders of tables, and datasets of LeRobot."""

import warnings
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.documents import read_document, read_table
from optipromp.core.errors import InvalidDemonstrationError, installed_by
from optipromp.core.files import is_there
from optipromp.core.promp import checks
from optipromp.core.promp.demonstrations import (
    FORMS,
    LARGEST,
    Convert,
    Demonstration,
    Demonstrations,
    built,
)
from optipromp.core.robots.measured import parts_in_time


def read_csv(path: Path, units: Convert) -> Demonstrations:
    """The demonstrations of a table, see :func:`load_demonstrations`."""
    table = read_table(path, InvalidDemonstrationError, "time,<joint>,...")
    header = table.header
    rates = {name + kind for name in header for kind in ("_velocity", "_acceleration")}
    joints = [i for i, name in enumerate(header) if name not in {"time", "demo", *rates}]
    if header.count("time") != 1 or header.count("demo") > 1 or not joints or "" in header:
        raise InvalidDemonstrationError(
            f"{path}, line {table.first}: expected a header time,<joint>,... with an optional "
            f"column demo, comma-separated; got {','.join(header)!r}"
        )
    values = table.numbers([header.index("time"), *joints])
    demo = header.index("demo") if "demo" in header else None
    labels = ["" if demo is None else row[demo].strip() for row in table.rows]
    parts: list[tuple[str, ArrayLike, ArrayLike]] = []
    for label in dict.fromkeys(labels):
        block = values[[other == label for other in labels]]
        name = f"demo {label}" if label else "rows"
        pieces = parts_in_time(f"{path}: {name}", block[:, 0], block[:, 1:])
        parts += [(name, *piece) for piece in pieces]
    return built(path, parts, [header[i] for i in joints], units)


def read_folder(path: Path, units: Convert) -> Demonstrations:
    """The demonstrations of a folder of tables, or of a LeRobot dataset."""
    if is_there(path / "meta" / "info.json"):
        return _read_lerobot(path, units)
    try:
        files = sorted(file for file in path.iterdir() if file.suffix.lower() == ".csv")
    except OSError as error:
        raise InvalidDemonstrationError(f"{path}: cannot be read: {error.strerror}") from None
    if is_there(path / "data" / "metadata.json"):
        raise InvalidDemonstrationError(
            f"{path} is a Minari dataset, whose observations do not tell which of them are joints: "
            f"write these as NPZ: {FORMS}, with joint_names"
        )
    if not files:
        raise InvalidDemonstrationError(f"{path} holds no .csv file")
    items: list[Demonstration] = []
    names: tuple[str, ...] = ()
    for file in files:
        part = read_csv(file, units)
        names = names or part.joint_names
        if part.joint_names != names:
            raise InvalidDemonstrationError(
                f"{file}: joints {', '.join(part.joint_names)}; {files[0].name} has "
                f"{', '.join(names)}"
            )
        items.extend(part)
    return Demonstrations(tuple(items), names)


STATE = "observation.state"


def _read_lerobot(path: Path, units: Convert) -> Demonstrations:
    """The episodes of a LeRobot dataset, of versions 2 (a file each) and 3 (files of several)."""
    try:
        from pyarrow import ArrowException
        from pyarrow.parquet import read_table as read_parquet
    except ImportError:
        raise InvalidDemonstrationError(
            f"{path} is a LeRobot dataset: reading it needs pyarrow: "
            f"{installed_by('optipromp[episodes]')}"
        ) from None
    about = read_document(path / "meta" / "info.json", InvalidDemonstrationError, "a mapping")
    columns = [STATE, "timestamp", "episode_index"]
    try:
        stated = about["features"][STATE]["names"]
        table = read_parquet(path / "data", columns=columns)
        rows = np.array(table[STATE].to_pylist(), dtype=np.float64)
        times, episode = (table[name].to_numpy().astype(np.float64) for name in columns[1:])
    except (ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        words = " ".join(str(error).split())[:120]
        raise InvalidDemonstrationError(
            f"{path}: no LeRobot dataset with {', '.join(columns)} ({words})"
        ) from None
    if isinstance(stated, dict):
        stated = next(iter(stated.values()), None)
    if rows.ndim != 2 or (stated is not None and len(stated) != rows.shape[1]):
        raise InvalidDemonstrationError(f"{path}: {STATE} has other columns than its names")
    names = [str(name).removesuffix(".pos") for name in stated or ()]
    gone = [k for k, name in enumerate(names) if "gripper" in name.lower()]
    if gone:
        listed = ", ".join(names[k] for k in gone)
        warnings.warn(f"{path}: {listed}: left out, as no joint of an arm", stacklevel=4)
    rows, order = np.delete(rows, gone, axis=1), np.unique(episode)
    parts = [(f"episode {e:.0f}", times[episode == e], rows[episode == e]) for e in order]
    if units is None:
        told = f"{path}: states no unit, and LeRobot's arms record degrees or -100 to 100: 'learn "
        told += "--unit radians', 'degrees', or 'range' with --calibration FILE states it"
        if np.abs(rows).max(initial=0.0) > LARGEST:
            raise InvalidDemonstrationError(told)
        warnings.warn(f"{told}; read as radians", checks.UnitsWarning, stacklevel=4)
    return built(path, parts, [name for k, name in enumerate(names) if k not in gone], units)
