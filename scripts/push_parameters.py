"""Write the table of the push models' numbers: ``python scripts/push_parameters.py``."""

import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from optipromp.core.pushing.parameters import PUSH

PAGE = Path(__file__).resolve().parents[1] / "docs" / "push-parameters.md"
HEAD = """# Numbers of the push models

Look up here what a prediction rests on, and how sure each number is. These are the tuned
numbers of the models, of the method's rules and of the candidate paths. The numbers
cannot be set: the kernels are compiled with them. *Measured*: on generated scenes, see
[decisions](decisions.md). *Reported*: a size that the harvesting literature gives often.
*Published*: the method's. *Guess*: ours, of a plausible size. *Choice*: of the model, not of
nature. `optipromp.core.pushing.parameters.PUSH` holds the numbers. The simulation
takes from there the numbers that it shares with the models.

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
                r"(?:\[(.+?)\] )?(?:(guess|reported|measured|published): )?(.+)",
                comments[item],
            )
            unit, kind, source = text.groups() if text else ("", "", "")
            yield Number(f"{group}.{item}", value, unit or "1", kind or "choice", source)


def table() -> str:
    """The page."""
    rows = []
    for item in numbers():
        values = item.value if isinstance(item.value, tuple) else (item.value,)
        shown = ", ".join(f"{value:g}" for value in values)
        rows.append(f"| `{item.name}` | {shown} | {item.unit} | {item.kind} | {item.source} |\n")
    return HEAD + "".join(rows)


if __name__ == "__main__":
    PAGE.write_text(table(), encoding="utf-8")
