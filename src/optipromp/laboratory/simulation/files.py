"""Runs as files: ``rollout.npz`` and ``outcome.json``."""

import io
import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import json_text, write_atomically
from optipromp.core.scenes.io import scene_to_dict
from optipromp.laboratory.simulation.execute import Run
from optipromp.laboratory.simulation.parameters import SimulationParameters


def run_document(run: Run) -> dict[str, Any]:
    """The JSON document of a run: its outcome, seed, version and times."""
    from importlib.metadata import version

    return {
        "scene": run.scene.name,
        "seed": run.seed,
        "version": version("optipromp"),
        **run.outcome.to_dict(),
        "seconds": run.seconds,
        "real_time_factor": run.real_time_factor,
    }


def write_run(
    run: Run, folder: Path, further: Mapping[str, bytes] | None = None
) -> tuple[str, ...]:
    """Write ``rollout.npz``, further files and, last, ``outcome.json``; each whole or not at all.

    Returns: The names of the files.
    """
    scene = None
    with suppress(OptiPrompError):  # a mesh that has no file
        scene = scene_to_dict(run.scene, base_dir=folder)
    stream = io.BytesIO()
    np.savez_compressed(stream, **run.rollout.arrays())  # type: ignore[arg-type]
    files = {
        "rollout.npz": stream.getvalue(),
        **(further or {}),
        "outcome.json": json_text(
            run_document(run) | {"scene_file": scene, "parameters": asdict(run.parameters)}
        ).encode("utf-8"),
    }
    for name, content in files.items():
        write_atomically(folder / name, content)
    return tuple(files)


def read_parameters(document: Mapping[str, Any]) -> SimulationParameters:
    """The parameters in the document of ``outcome.json``; without any, the defaults."""
    groups, default = document.get("parameters") or {}, SimulationParameters()
    made = {}
    try:
        for name, group in groups.items():
            usual = getattr(default, name)
            known = asdict(usual)
            values = {key: math.inf if value is None else value for key, value in group.items()}
            for key, value in values.items():
                if _kind(value) is not _kind(known[key]):
                    raise TypeError(f"{name}.{key} is {value!r}")
            made[name] = type(usual)(**values)
        return SimulationParameters(**made)
    except (AttributeError, KeyError, TypeError) as error:
        raise InvalidRequestError(
            f"the parameters are not those of this version ({error})"
        ) from None


def _kind(value: object) -> type:
    """The type of a value; whole numbers count as the others."""
    return float if type(value) is int else type(value)
