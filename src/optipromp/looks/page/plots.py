"""The charts of a window, with a needle at the present moment."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.looks.page.content import Chart

CHART_HEIGHT = 170  # [pixel]
_NEEDLE = "#222222"


class Plots:
    """Charts in a container of their own.

    Args:
        gui: of a client; the charts stay in the container that is current now.
    """

    def __init__(self, gui: Any) -> None:
        self.gui, self.place = gui, gui.add_folder("over the plan")
        self.charts: list[tuple[Chart, Any]] = []
        self.marked = -np.inf

    def show(self, wanted: Sequence[Chart], now: float) -> None:
        """Show charts; where their curves are the same as before, only the values are sent."""
        if [_shape(chart) for chart in wanted] == [_shape(chart) for chart, _ in self.charts]:
            self.charts = [(c, node) for c, (_, node) in zip(wanted, self.charts, strict=True)]
            for chart, node in self.charts:
                node.data = columns(chart, now)
        else:
            for _, node in self.charts:
                node.remove()
            with self.place:
                self.charts = [(chart, self._add(chart, now)) for chart in wanted]
        self.marked = now

    def mark(self, now: float, least: float) -> None:
        """Move the needles to the time ``now`` [s], if they are more than ``least`` [s] away."""
        if abs(now - self.marked) > least:
            self.marked = now
            for chart, node in self.charts:
                if chart.timed:
                    node.data = columns(chart, now)

    def _add(self, chart: Chart, now: float) -> Any:
        needle = [("now", None, _NEEDLE)] if chart.timed else []
        series = [
            {"label": name, "stroke": colour, "width": 1.5, "points": {"show": False}}
            for name, _, colour in (*chart.curves, *needle)
        ]
        return self.gui.add_uplot(
            columns(chart, now), ({}, *series), title=chart.title, height=CHART_HEIGHT,
            scales={"x": {"time": False}}, legend={"show": len(chart.curves) > 1},
        )  # fmt: skip


def _shape(chart: Chart) -> tuple[str, ...]:
    return (chart.title, *(name for name, _, _ in chart.curves))


def columns(chart: Chart, now: float) -> tuple[FloatArray, ...]:
    """Columns of a chart; where it is timed, the last is a needle at ``now``."""
    if not chart.timed:
        return chart.x, *(values for _, values, _ in chart.curves)
    at = int(np.searchsorted(chart.x, now))
    found = [
        np.insert(values, at, [np.interp(now, chart.x, values)] * 3)
        for _, values, _ in chart.curves
    ]
    needle = np.full(len(chart.x) + 3, min(c.min() for c in found))
    needle[at + 1] = max(c.max() for c in found)
    return np.insert(chart.x, at, [now] * 3), *found, needle
