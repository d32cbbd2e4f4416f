"""An entry for the benchmark, of your own inverse kinematics: from below the fruits straight up.

    optipromp bench run --entry 12_bench_entry:Up --preset field --count 20 --out up

The class is the whole entry. `plan` gives one motion for one scene, or None to refuse it.
`robot_of` is the scene's robot with its tool, and `gentle` times waypoints as the benchmark's own
entries are timed: within the limits of the joints, and slow near fruits.
"""

import tempfile
from pathlib import Path

import numpy as np

from optipromp import Robot, Scene, Trajectory, robot_of
from optipromp.timing import gentle
from optipromp_bench.results import BenchRun, run_bench, verify
from optipromp_bench.sets import SceneSet


class Up:
    """To a point 12 cm below the lowest fruit, then straight up to the target."""

    def plan(self, scene: Scene, seed: int) -> Trajectory | None:
        """The motion for one scene."""
        if scene.target is None or scene.start is None:
            return None
        robot, goal, axis = robot_of(scene), scene.target.position, scene.frame[2]
        below = min([0.0, *(axis @ (item.position - goal) for item in scene.pushables)]) - 0.12
        rows = [scene.start]
        for height in np.linspace(below, 0.0, 30):
            q, error = self.reached(robot, rows[-1], goal + height * axis, axis)
            if error > 1e-3:
                return None
            rows.append(q)
        return gentle(scene, rows)

    def reached(
        self, robot: Robot, q: np.ndarray, point: np.ndarray, axis: np.ndarray
    ) -> tuple[np.ndarray, float]:
        """Joints near q at which the tool point and axis are the ones asked, and the error left."""
        for _ in range(300):
            (now, along), (place, turn) = robot.tool_pose(q), robot.tool_jacobian(q)
            off = np.concatenate([point - now, 0.2 * (axis - along)])
            if np.linalg.norm(off) < 1e-5:
                break
            rows = np.vstack([place, 0.2 * turn])
            step = rows.T @ np.linalg.solve(rows @ rows.T + 1e-5 * np.eye(6), off)
            q = np.clip(q + step, robot.lower, robot.upper)
        return q, float(np.linalg.norm(off))


if __name__ == "__main__":
    scenes = SceneSet("development", ("field",), 3)
    run = BenchRun.of(f"{Path(__file__).stem}:Up", "plan", scenes)
    with tempfile.TemporaryDirectory() as folder:
        rows = run_bench(run, Path(folder), workers=1)
        again = verify(Path(folder) / "submission.zip", entry=run.entry, workers=1)
    for row in rows:
        print(row.preset, row.seed, row.engine, row.result, row.cause)
    print("verified" if again.confirmed else again.changed)
