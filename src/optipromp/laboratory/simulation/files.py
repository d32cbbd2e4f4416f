"""Runs as files: ``rollout.npz`` and ``outcome.json``."""

import io
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.errors import OptiPrompError
from optipromp.core.files import json_text, write_atomically
from optipromp.core.scenes.io import scene_to_dict
from optipromp.laboratory.simulation.execute import Run


def run_document(run: Run) -> dict[str, Any]:
    """The JSON document of a run: its outcome, seed, version and times."""
    from optipromp import __version__

    return {
        "scene": run.scene.name,
        "seed": run.seed,
        "version": __version__,
        **run.outcome.to_dict(),
        "seconds": run.seconds,
        "real_time_factor": run.real_time_factor,
    }


def write_run(
    run: Run, folder: Path, further: Mapping[str, bytes] | None = None
) -> tuple[str, ...]:
    """Write ``rollout.npz``, further files and, last, ``outcome.json``; each whole or not at all.

    Returns:
        The names of the files.

    Raises:
        InvalidRequestError: the folder cannot be written.
    """
    scene = None
    with suppress(OptiPrompError):  # a mesh that has no file
        scene = scene_to_dict(run.scene, base_dir=folder)
    stream = io.BytesIO()
    np.savez_compressed(stream, **run.rollout.arrays())  # type: ignore[arg-type]
    files = {
        "rollout.npz": stream.getvalue(),
        **(further or {}),
        "outcome.json": json_text(run_document(run) | {"scene_file": scene}).encode("utf-8"),
    }
    for name, content in files.items():
        write_atomically(folder / name, content)
    return tuple(files)
