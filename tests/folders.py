"""What a folder of a plan holds."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

FILES = ("trajectory.csv", "trajectory.npz", "waypoints.npz")
Arrays = dict[str, Any]


def read(path: Path) -> Arrays:
    with np.load(path) as found:
        return {name: found[name] for name in found.files}


def stated(folder: Path, **changes: Any) -> None:
    """The folder's plan.json with other words, and digests as if the files were its own."""
    path = folder / "plan.json"
    document = json.loads(path.read_text()) | changes
    document["sha256"] = {
        name: hashlib.sha256((folder / name).read_bytes()).hexdigest() for name in FILES
    }
    path.write_text(json.dumps(document))


def rows(folder: Path, change: Callable[[Arrays], Arrays]) -> None:
    arrays = change(read(folder / "waypoints.npz"))
    np.savez(folder / "waypoints.npz", **arrays)
    stated(folder)
