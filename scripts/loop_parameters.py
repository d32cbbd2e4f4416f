"""Write the table of the closed loop's numbers: ``python scripts/loop_parameters.py``."""

import re
from dataclasses import dataclass, field
from pathlib import Path

from optipromp.control import LoopParameters, TrackerParameters
from optipromp.core.parameters import catalogue
from optipromp.laboratory.simulation import DetectorParameters

PAGE = Path(__file__).resolve().parents[1] / "docs" / "closed-loop.md"
MARKS = "<!-- parameters: scripts/loop_parameters.py -->\n", "<!-- end of parameters -->\n"


@dataclass(frozen=True)
class _All:
    loop: LoopParameters = field(default_factory=LoopParameters)
    tracker: TrackerParameters = field(default_factory=TrackerParameters)
    detector: DetectorParameters = field(default_factory=DetectorParameters)


def table() -> str:
    """The table."""
    rows = ["\n| parameter | default | unit | kind | |\n", "|---|---|---|---|---|\n"]
    for item in catalogue(_All()):
        values = item.value if isinstance(item.value, tuple) else (item.value,)
        shown = ", ".join(
            f"{value:g}" if isinstance(value, float) else str(value) for value in values
        )
        rows.append(f"| `{item.name}` | {shown} | {item.unit} | {item.kind} | {item.source} |\n")
    return "".join(rows) + "\n"


def page(text: str) -> str:
    """The page ``text`` with the present table."""
    begin, end = MARKS
    found = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    return found.sub(lambda _: begin + table() + end, text)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
