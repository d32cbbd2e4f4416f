"""A forest plot: shares with their intervals, and ratios beside 1, a line for each, as SVG."""

import math
import textwrap
from collections.abc import Callable, Iterator, Sequence, Sized
from typing import NamedTuple
from xml.sax.saxutils import escape

from optipromp_bench.experiments.statistics import wilson

SERIES = ("#0072b2", "#0072b2"), ("#d55e00", "#fff"), ("#009e73", "#b9e2d5")
"""Line and fill of each series: told apart by all eyes, and without colours."""
WIDTH, RIGHT = 356, 338  # [pixel] of a picture, as a phone of 390 shows it; where its axes end
LETTER, LONG, LINE = 6.2, 21, 13  # [pixel] a letter; letters of a line of a label; [pixel] a line
SCALES = [[tick * top / 4 for tick in range(5)] for top in (20.0, 40.0, 60.0, 80.0, 100.0)]
SPANS = (  # the ticks of an axis of ratios, which reaches as far either way
    [0.5, 0.7, 1.0, 1.4, 2.0], [0.25, 0.5, 1.0, 2.0, 4.0], [0.1, 0.3, 1.0, 3.0, 10.0],
    [0.01, 0.1, 1.0, 10.0, 100.0], [0.001, 0.03, 1.0, 30.0, 1000.0],
)  # fmt: skip


class Share(NamedTuple):
    """A share with its interval [%]."""

    share: float
    low: float
    high: float

    @classmethod
    def of(cls, count: int, runs: int) -> "Share":
        """Of ``runs``, with Wilson's interval, 95 %."""
        return cls(*(100.0 * part for part in (count / runs, *wilson(count, runs))))

    def __str__(self) -> str:
        return f"{self.share:g} ({self.low:g}–{self.high:g})"


Lines = dict[str, dict[str, Share | float]]  # by label and series; a number is a ratio
Panels = dict[str, Lines]


def forest(panels: Panels) -> str:
    """Shares with their intervals as SVG, and ratios as bars from 1: a panel below the other."""
    series = list(dict.fromkeys(s for p in panels.values() for each in p.values() for s in each))
    words = [part for lines in panels.values() for label in lines for part in wrapped(label)]
    edge, y = round(20.0 + LETTER * max(map(len, words))), 10.0
    out, left = list[str](), 12.0
    for k, name in enumerate(series):
        if name:
            out += [dot(left, y + 4, k), text(left + 8, y + 8, name, "start")]
            left += 28.0 + LETTER * len(name)
    y += 18.0 * bool(out)
    for title, lines in panels.items():
        out += panel(title, lines, series, edge, y)
        y += 44.0 + sum(height(*each) for each in lines.items())
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{y:g}" '
        f'viewBox="0 0 {WIDTH} {y:g}" font-family="sans-serif" font-size="11">'
    )
    return "\n".join([head, '<rect width="100%" height="100%" fill="#fff"/>', *out, "</svg>", ""])


def panel(title: str, lines: Lines, series: Sequence[str], edge: int, y: float) -> Iterator[str]:
    """A panel from ``y`` on, whose axis begins at ``edge`` [pixel]."""
    marks = [value for each in lines.values() for value in each.values()]
    most = max(m.high if isinstance(m, Share) else max(m, 1.0 / m) for m in marks)
    ratios = not isinstance(marks[0], Share)
    ticks = next(each for each in (SPANS if ratios else SCALES) if each[-1] >= most)

    def at(value: float) -> float:
        span = math.log(value) / math.log(ticks[-1]) if ratios else 2.0 * value / ticks[-1] - 1.0
        return edge + 0.5 * (1.0 + span) * (RIGHT - edge)

    yield text(8, y + 12, title if ratios else f"{title}, %", "start")
    y += 22.0
    bottom = y + sum(height(*each) for each in lines.items())
    for tick in ticks:
        colour = "#777" if ratios and tick == 1.0 else "#ddd"
        yield f'<path d="M{at(tick):.1f} {y - 4:g}V{bottom:g}" stroke="{colour}"/>'
        yield text(round(at(tick)), bottom + 12, f"{tick:g}", "middle")
    for label, each in lines.items():
        y += height(label, each)
        middle, parts = y - 0.5 * height(label, each), wrapped(label)
        for j, part in enumerate(parts):
            yield text(edge - 10, middle + LINE * (j - 0.5 * len(parts)) + 10, part, "end")
        for j, name in enumerate(name for name in series if name in each):
            at_y = middle + LINE * (j + 0.5 - 0.5 * len(each))
            yield mark(each[name], series.index(name), at, at_y)


def mark(value: Share | float, k: int, at: Callable[[float], float], y: float) -> str:
    """A share with its interval, or a bar from 1 to a ratio, of the series ``k``."""
    colour, fill = SERIES[k]
    if isinstance(value, Share):
        line = f'<path d="M{at(value.low):.1f} {y:g}H{at(value.high):.1f}" stroke="{colour}"'
        return f'{line} stroke-width="1.5"/>{dot(at(value.share), y, k)}'
    low, high = sorted((at(1.0), at(value)))
    box = f'<rect x="{low:.1f}" y="{y - 4:g}" width="{high - low:.1f}" height="8" '
    aside, anchor = (4, "start") if value < 1.0 else (-4, "end")  # at the free side of 1
    number = text(round(at(1.0)) + aside, y + 4, f"{value:g}", anchor)
    return f'{box}fill="{fill}" stroke="{colour}"/>{number}'


def wrapped(label: str) -> list[str]:
    """The lines of a label."""
    return textwrap.wrap(label, LONG) or [""]


def height(label: str, each: Sized) -> float:
    """Of a label with its marks [pixel]."""
    return 5.0 + LINE * max(len(wrapped(label)), len(each))


def dot(x: float, y: float, k: int) -> str:
    """The mark of a share of the series ``k``."""
    colour, fill = SERIES[k]
    return f'<circle cx="{x:.1f}" cy="{y:g}" r="3.5" fill="{fill}" stroke="{colour}"/>'


def text(x: float, y: float, words: str, anchor: str) -> str:
    """Words of a picture."""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(words)}</text>'
