"""A forest plot: shares with their intervals, a line for each, as SVG."""

from typing import NamedTuple
from xml.sax.saxutils import escape

from optipromp_bench.experiments.statistics import wilson

COLOURS = "#0072b2", "#d55e00"  # of the first series and of the second: told apart by all eyes
LETTER, WIDE, LINE = 6.3, 295, 12  # [pixel] a letter of a label, a panel, a share
SCALES = 20.0, 40.0, 60.0, 80.0, 100.0  # [%] the largest share of a panel's axis


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


Shares = dict[str, dict[str, dict[str, Share]]]  # by panel, label and series


def forest(shares: Shares) -> str:
    """Shares with their intervals as SVG: a panel beside the other, a line for each share."""
    series = list(dict.fromkeys(s for p in shares.values() for each in p.values() for s in each))
    labels: dict[str, list[str]] = {}
    for lines in shares.values():
        for label, each in lines.items():
            labels[label] = [
                name for name in series if name in each or name in labels.get(label, ())
            ]
    tops, y = {}, 44
    for label, names in labels.items():
        tops[label], y = y, y + LINE * len(names) + 6
    edge = round(max(120.0, 24.0 + LETTER * max(map(len, labels))))
    width, height = edge + len(shares) * WIDE, y + 24
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
        f'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="11">',
        '<rect width="100%" height="100%" fill="#fff"/>',
    ]
    for k, name in enumerate(series if len(series) > 1 else ()):
        out += [dot(10 + 110 * k, 14, k), text(18 + 110 * k, 18, name, "start")]
    for label, names in labels.items():
        out.append(text(edge - 12, tops[label] + LINE * len(names) / 2 + 4, label, "end"))
    for k, (panel, lines) in enumerate(shares.items()):
        left = edge + k * WIDE
        most = max(share.high for each in lines.values() for share in each.values())
        scale = min(each for each in SCALES if each >= most) / (WIDE - 25)  # [% by pixel]
        out.append(text(left, 34, f"{panel}, %", "start"))
        for tick in range(5):
            x = left + tick * (WIDE - 25) / 4
            out.append(f'<path d="M{x:g} 40V{y}" stroke="#ddd"/>')
            out.append(text(x, y + 14, f"{scale * (x - left):g}", "middle"))
        for label, each in lines.items():
            for name, share in each.items():
                middle = tops[label] + LINE * (labels[label].index(name) + 0.5)
                at, low, high = (left + each / scale for each in share)
                which = series.index(name)
                path = f'd="M{low:.1f} {middle:g}H{high:.1f}" stroke="{COLOURS[which]}"'
                out += [f"<path {path}/>", dot(at, middle, which)]
    return "\n".join([*out, "</svg>", ""])


def dot(x: float, y: float, k: int) -> str:
    """The mark of a share: full of the first series, empty of the second."""
    colour = COLOURS[k]
    fill = "#fff" if k else colour
    return f'<circle cx="{x:.1f}" cy="{y:g}" r="3" fill="{fill}" stroke="{colour}"/>'


def text(x: float, y: float, words: str, anchor: str) -> str:
    """Words of a picture."""
    return f'<text x="{x:g}" y="{y:g}" text-anchor="{anchor}">{escape(words)}</text>'
