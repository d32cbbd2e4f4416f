"""Write the table of the closed loop's numbers: ``python scripts/loop_parameters.py``.

The page says more of a number than the code: its words stay, a new number has those of the code.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

from optipromp.core.parameters import catalogue
from optipromp_loop.control import LoopParameters, TrackerParameters
from optipromp_sim.simulation import DetectorParameters

PAGE = Path(__file__).resolve().parents[1] / "docs" / "closed-loop.md"
MARKS = "<!-- parameters: scripts/loop_parameters.py -->\n", "<!-- end of parameters -->\n"


@dataclass(frozen=True)
class _All:
    loop: LoopParameters = field(default_factory=LoopParameters)
    tracker: TrackerParameters = field(default_factory=TrackerParameters)
    detector: DetectorParameters = field(default_factory=DetectorParameters)


def table(said: dict[str, str]) -> str:
    """The table, in the words that are ``said`` of each number."""
    rows = ["\n| parameter | default | unit | kind | |\n", "|---|---|---|---|---|\n"]
    for item in catalogue(_All()):
        values = item.value if isinstance(item.value, tuple) else (item.value,)
        shown = ", ".join(
            f"{value:g}" if isinstance(value, float) else str(value) for value in values
        )
        words = said.get(item.name, item.source)
        rows.append(f"| `{item.name}` | {shown} | {item.unit} | {item.kind} | {words} |\n")
    return "".join(rows) + "\n"


def page(text: str) -> str:
    """The page ``text`` with the present table."""
    begin, end = MARKS
    found = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    said = dict(re.findall(r"^\| `([\w.]+)` \|(?:[^|]*\|){3} (.*) \|$", text, re.MULTILINE))
    return found.sub(lambda _: begin + table(said) + end, text)


if __name__ == "__main__":
    PAGE.write_text(page(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
