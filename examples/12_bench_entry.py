"""An entry for the benchmark: the tool passes every neighbour on the side away from its stem.

    optipromp bench run --entry 12_bench_entry:Aside --count 20 --out aside

The class is the whole entry. `plan` gives one motion for one scene, or None to refuse it.
"""

import tempfile
from pathlib import Path

import numpy as np

from optipromp import Plan, Scene, plan
from optipromp.bench.primitive import COUNT, OfWeights
from optipromp.bench.results import BenchRun, run_bench, verify
from optipromp.bench.sets import SceneSet


class Aside:
    """Bow the tool's path away from the mean place of the unripe fruit."""

    def plan(self, scene: Scene, seed: int) -> Plan | None:
        """The motion for one scene."""
        target = scene.target
        if target is None:
            return None
        away = [target.position - item.position for item in scene.pushables]
        side = scene.frame[:2] @ np.mean(away, axis=0) if away else np.zeros(2)
        bow = 0.4 * side / max(float(np.linalg.norm(side)), 0.01)
        return plan(scene, planner=OfWeights(weights=np.outer(bow, np.ones(COUNT))), seed=seed)


if __name__ == "__main__":
    scenes = SceneSet("development", ("cluster",), 2)
    run = BenchRun.of(f"{Path(__file__).stem}:Aside", "plan", scenes)
    with tempfile.TemporaryDirectory() as folder:
        rows = run_bench(run, Path(folder), workers=1)
        again = verify(Path(folder) / "submission.zip", entry=run.entry, workers=1)
    for row in rows:
        print(row.preset, row.seed, row.engine, row.result, row.cause)
    print("verified" if again.confirmed else again.changed)
