"""How well do the eyes see? Random scenes rendered, seen, and compared with the truth.

Run from the repository: ``PYTHONPATH=src python scripts/eyes_study.py --seeds 70000:70030``. The
script prints the figures of ``docs/eyes.md``, a preset, a mount and a finder a line, as JSON. Every
finder sees the same pictures. ``--finder network,shapes.onnx`` compares
weights.
"""

import argparse
import itertools
import json
from pathlib import Path

from optipromp.laboratory.experiments.eyes import compared, figures
from optipromp.laboratory.generate import generate
from optipromp.laboratory.simulation.photograph import photograph
from optipromp.perception.detector import finder_named


def main() -> None:
    """Print the figures of each preset, mount and finder."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--presets", default="cluster,mixed,field,wild")
    parser.add_argument("--seeds", default="70000:70030", metavar="A:B")
    parser.add_argument("--mount", default="beside", help="one or more of beside,palm,hand")
    parser.add_argument("--looks", default="plain", help="one or more of plain,rich")
    parser.add_argument(
        "--finder", default="geometry", metavar="A,B",
        help="one or more of geometry, network, a network's FILE.onnx, MODULE:NAME",
    )  # fmt: skip
    given = parser.parse_args()
    first, end = map(int, given.seeds.split(":"))
    finders = {
        name: finder_named("network", Path(name)) if name.endswith(".onnx") else finder_named(name)
        for name in given.finder.split(",")
    }
    for preset, mount, looks in itertools.product(
        given.presets.split(","), given.mount.split(","), given.looks.split(",")
    ):
        seen = {name: [] for name in finders}
        for seed in range(first, end):
            shot = photograph(generate(preset, seed), mount, seed, looks=looks)
            for name, finder in finders.items():
                seen[name].append(compared(shot, finder))
        for name, pictures in seen.items():
            told = {key: round(value, 3) for key, value in figures(pictures).items()}
            row = {"preset": preset, "mount": mount, "looks": looks, "finder": name, **told}
            print(json.dumps(row), flush=True)


if __name__ == "__main__":
    main()
