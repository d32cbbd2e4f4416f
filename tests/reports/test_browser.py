"""A report in a headless Chromium without a network: its 3-D view draws, its tables fit a phone."""

import io
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from optipromp.core.output import write_plan
from optipromp.core.planning import plan
from optipromp.looks.reports import plan_report

PATIENCE = 90.0  # [s] without a graphics card


def test_a_report_opens_offline_and_its_view_moves(chromium: Any, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    write_plan(plan("scenario-1", planner="i-promp"), tmp_path)
    (tmp_path / "report.html").write_bytes(plan_report(tmp_path))
    context = chromium.new_context(viewport={"width": 400, "height": 800}, offline=True)
    page = context.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((tmp_path / "report.html").as_uri())
    canvas = page.frame_locator("iframe").locator("canvas").first

    def shot() -> np.ndarray:
        content = image.open(io.BytesIO(canvas.screenshot(timeout=1e3 * PATIENCE)))
        return np.asarray(content.convert("RGB"), dtype=int)

    first, end = shot(), time.monotonic() + PATIENCE
    while np.abs(shot() - first).max(axis=2).mean() < 1.0:
        assert time.monotonic() < end, "nothing moves in the 3-D view"
        time.sleep(0.5)
    colours = shot().reshape(-1, 3)
    assert ((colours[:, 0] > 2 * colours[:, 1]) & (colours[:, 0] > 90)).sum() > 5  # ripe
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    assert all(url.startswith(("file:", "data:", "blob:", "about:")) for url in asked)
    assert not wrong
    context.close()
