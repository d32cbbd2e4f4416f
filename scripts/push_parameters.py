"""Write the table of the push models' numbers: ``python scripts/push_parameters.py``."""

from pathlib import Path

from optipromp.core.parameters import catalogue
from optipromp.core.pushing.parameters import PUSH

PAGE = Path(__file__).resolve().parents[1] / "docs" / "push-parameters.md"
HEAD = """# Numbers of the push models

Every tuned number of the models, of the method's rules and of the candidate paths. The numbers
cannot be set: the kernels are compiled with them. *Measured*: on generated scenes, see
[decisions](decisions.md). *Reported*: a size that the harvesting literature gives often.
*Published*: the method's. *Guess*: ours, of a plausible size. *Choice*: of the model, not of
nature. `optipromp.core.pushing.parameters.PUSH` holds the numbers. The simulation
takes from there the numbers that it shares with the models.

| number | value | unit | kind | |
|---|---|---|---|---|
"""


def table() -> str:
    """The page."""
    rows = []
    for item in catalogue(PUSH):
        values = item.value if isinstance(item.value, tuple) else (item.value,)
        shown = ", ".join(f"{value:g}" for value in values)
        rows.append(f"| `{item.name}` | {shown} | {item.unit} | {item.kind} | {item.source} |\n")
    return HEAD + "".join(rows)


if __name__ == "__main__":
    PAGE.write_text(table(), encoding="utf-8")
