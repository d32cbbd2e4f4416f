"""What a study leaves beside its rows: a summary, a figure and, with pyarrow, a Parquet file."""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from optipromp.experiments.calibration import calibration
from optipromp.experiments.runs import COLUMNS, Row
from optipromp.experiments.statistics import Cell
from optipromp.experiments.study_figure import study_figure
from optipromp.files import json_text, write_atomically
from optipromp.viewer.figures import png


def write_results(rows: Sequence[Row], cells: Sequence[Cell], folder: Path) -> tuple[str, ...]:
    """Write ``summary.json``, ``study.png`` and, where pyarrow is installed, ``rows.parquet``.

    Returns:
        The names of the files.

    Raises:
        InvalidRequestError: a file cannot be written.
    """
    found = calibration(rows)
    document = {
        "cells": [cell.to_dict() for cell in cells],
        "calibration": None if found is None else asdict(found),
    }
    write_atomically(folder / "summary.json", json_text(document).encode("utf-8"))
    write_atomically(folder / "study.png", png(study_figure(cells)))
    parquet = _parquet(rows)
    if parquet is None:
        return "summary.json", "study.png"
    write_atomically(folder / "rows.parquet", parquet)
    return "summary.json", "study.png", "rows.parquet"


def _parquet(rows: Sequence[Row]) -> bytes | None:
    """The rows as a Parquet file; None without pyarrow (extra ``study``)."""
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError:
        return None
    from io import BytesIO

    values = [asdict(row) for row in rows]
    table = pyarrow.table({name: [value[name] for value in values] for name in COLUMNS})
    stream = BytesIO()
    parquet.write_table(table, stream)
    return stream.getvalue()
