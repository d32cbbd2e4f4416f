"""Write core/robots/data/*.robot: the built-in robots, resolved from their robot files.

Run from the repository after a change of the readers or of a robot file there:
``python scripts/built_in_robots.py``.
"""

from pathlib import Path

from optipromp.core.robots import save_robot
from optipromp.core.robots.library import NOTHING
from optipromp.readers.reading import read_description

DATA = Path(__file__).resolve().parents[1] / "packages/optipromp/src/optipromp/core/robots/data"


def main() -> None:
    """Write them all."""
    for path in sorted(DATA.glob("*.yaml")):
        save_robot(read_description(path, NOTHING, Path), path.with_suffix(".robot"))


if __name__ == "__main__":
    main()
