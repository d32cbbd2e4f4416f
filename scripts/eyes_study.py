"""How well do the eyes see? Random scenes rendered, seen, and compared with the truth.

Run from the repository: ``PYTHONPATH=src python scripts/eyes_study.py --seeds 70000:70030``. The
script prints the figures of ``docs/eyes.md``, a preset a line, as JSON.
"""

import argparse
import json

from optipromp.laboratory.experiments.seeing import figures, pictures_of


def main() -> None:
    """Print the figures of each preset."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", default="cluster,mixed,field")
    parser.add_argument("--seeds", default="70000:70030", metavar="A:B")
    parser.add_argument("--mount", default="beside", choices=("beside", "palm", "hand"))
    given = parser.parse_args()
    first, end = map(int, given.seeds.split(":"))
    for preset in given.presets.split(","):
        seen = list(pictures_of(preset, range(first, end), given.mount))
        rounded = {name: round(value, 3) for name, value in figures(seen).items()}
        print(json.dumps({"preset": preset, "mount": given.mount, **rounded}), flush=True)


if __name__ == "__main__":
    main()
