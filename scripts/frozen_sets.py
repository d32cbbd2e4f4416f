"""Write the digests of the benchmark's development set to standard output.

Run from the repository: ``python scripts/frozen_sets.py >
packages/optipromp-bench/src/optipromp_bench/data/development.json``.
"""

import json
import sys

from optipromp_bench.sets import SceneSet, digest
from optipromp_sim.generate import generate

told: dict[str, dict[str, str]] = {}
for preset, seed in SceneSet().scenes():
    told.setdefault(preset, {})[str(seed)] = digest(generate(preset, seed))  # type: ignore[arg-type]
sys.stdout.write(json.dumps(told, indent=0))
