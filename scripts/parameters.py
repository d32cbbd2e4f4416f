"""Write the tables of numbers: of the push models, and of the closed loop.

    python scripts/parameters.py    # docs/push-parameters.md, and a part of docs/closed-loop.md

The page on the closed loop says more of a number than the code: its words stay, a new number has
those of the code.
"""

import inspect
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from optipromp.core.parameters import catalogue
from optipromp.core.pushing.parameters import PUSH
from optipromp_loop.control import LoopParameters, TrackerParameters
from optipromp_sim.simulation import DetectorParameters

DOCS = Path(__file__).resolve().parents[1] / "docs"
BETWEEN = re.compile(
    r"(?<=<!-- parameters: scripts/parameters.py -->\n).*?(?=<!-- end of parameters -->\n)",
    re.DOTALL,
)
HEAD = """# Numbers of the push models

For whoever asks what a prediction rests on, and how sure each number is. The numbers cannot be
set: the kernels are compiled with them. *Measured*: on generated scenes, see
[decisions](decisions.md). *Reported*: a size that the harvesting literature gives often.
*Published*: the method's. *Guess*: ours, of a plausible size. *Choice*: of the model, not of
nature. `optipromp.core.pushing.parameters.PUSH` holds the numbers, which the simulation shares.

| number | value | unit | kind | |
|---|---|---|---|---|
"""


class Number(NamedTuple):
    """A number of the push models, as the comment beside or above it describes it."""

    name: str
    value: float | tuple[float, ...]
    unit: str
    kind: str
    source: str


def numbers() -> Iterator[Number]:
    """The numbers of all groups, by their dotted names."""
    for group, branch in PUSH._asdict().items():
        above: list[str] = []
        comments = {}
        for line in inspect.getsource(type(branch)).splitlines():
            code, _, comment = line.strip().partition("# ")
            name = re.match(r"(\w+): .* = ", code)
            if name is not None:
                comments[name[1]] = comment or " ".join(above)
            above = [*above, comment] if comment and not code else []
        for item, value in branch._asdict().items():
            text = re.fullmatch(
                r"(?:\[(.+?)\] )?(?:(guess|reported|measured|published): )?(.+)", comments[item]
            )
            unit, kind, source = text.groups() if text else ("", "", "")
            yield Number(f"{group}.{item}", value, unit or "1", kind or "choice", source)


def rows(items: Iterable[Any], said: Mapping[str, str]) -> str:
    """Rows of a table; in place of a number's source, what is ``said`` of it."""
    out = []
    for item in items:
        values = item.value if isinstance(item.value, tuple) else (item.value,)
        shown = ", ".join(f"{each:g}" if isinstance(each, float) else str(each) for each in values)
        words = said.get(item.name, item.source)
        out.append(f"| `{item.name}` | {shown} | {item.unit} | {item.kind} | {words} |\n")
    return "".join(out)


def push_page() -> str:
    """The page of the push models."""
    return HEAD + rows(numbers(), {})


@dataclass(frozen=True)
class _Loop:
    loop: LoopParameters = field(default_factory=LoopParameters)
    tracker: TrackerParameters = field(default_factory=TrackerParameters)
    detector: DetectorParameters = field(default_factory=DetectorParameters)


def loop_page(text: str) -> str:
    """The page on the closed loop, ``text``, with the present table."""
    said = dict(re.findall(r"^\| `([\w.]+)` \|(?:[^|]*\|){3} (.*) \|$", text, re.MULTILINE))
    table = "\n| parameter | default | unit | kind | |\n|---|---|---|---|---|\n"
    table += rows(catalogue(_Loop()), said)
    return BETWEEN.sub(lambda _: f"{table}\n", text)


if __name__ == "__main__":
    (DOCS / "push-parameters.md").write_text(push_page(), encoding="utf-8")
    loop = DOCS / "closed-loop.md"
    loop.write_text(loop_page(loop.read_text(encoding="utf-8")), encoding="utf-8")
