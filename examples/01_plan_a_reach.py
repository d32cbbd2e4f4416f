"""Plan a reach, look at how it was judged, and keep it.

A scene is loaded by the name of a built-in one or by the path of a file. `plan` returns a value
whether it succeeds or not: `status` says which, and `metrics` what the judge measured.
`write_plan` leaves the files that `optipromp plan --reach --out` leaves, without the figures;
`load_plan` brings them back. The whole pick is `plan_pick`, `write_pick` and `load_pick`.

    python examples/01_plan_a_reach.py
"""

import tempfile
from pathlib import Path

from optipromp import load_plan, load_scene, plan, write_plan

scene = load_scene("scenario-3")
result = plan(scene, seed=0)

print(f"{scene.name}: {result.status} {result.message}")
print(f"{result.trajectory.n_waypoints} waypoints over {result.trajectory.duration:.2f} s")
print(f"at the target: {1e3 * result.metrics.goal_error:.3f} mm off")
for fruit, offset in result.metrics.M_p.items():
    if offset is not None:
        print(f"passes {fruit} at {1e3 * offset:+.1f} mm")

with tempfile.TemporaryDirectory() as folder:
    names = write_plan(result, Path(folder))
    again = load_plan(folder)
print(
    f"wrote {', '.join(names)}; read back: {again.status}, {again.trajectory.n_waypoints} waypoints"
)

if not result.success:
    raise SystemExit(1)
