"""Plans many scenes and checks their curves by SciPy: limits at 1 kHz and between, and durations.

    python scripts/check_curves.py --plans 1030

The scenes: every preset and the planners ``promp``, ``i-promp`` and ``paper`` on the Panda;
free reaches between random configurations on Panda and SCARA. The table compares each duration
with that of waypoints spaced evenly by the limits of velocity and acceleration alone, taken from
differences (what a plan's duration was before its curve was timed).
"""

import argparse
from collections.abc import Iterator

import numpy as np
from scipy.interpolate import BPoly

from optipromp.core.planning import Plan, Planner, plan
from optipromp.core.planning.planners import label
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes.scene import JointGoal, Scene
from optipromp_paper.paper import Paper
from optipromp_sim.generate import generate

SEED = 70_000


def plans(count: int, seed: int = SEED) -> Iterator[tuple[str, Plan]]:
    """``count`` plans with the name of their kind, spread over the kinds."""
    presets = ("cluster", "side-clusters", "table-top", "mixed")
    stages = Paper(constraints="push-model")
    kinds: list[tuple[str, Planner | str, int]] = [
        *((preset, "opti-promp", 8) for preset in presets),
        ("shelf", "opti-promp", 2), ("cluster", "promp", 1), ("cluster", "i-promp", 1),
        ("mixed", stages, 1), ("panda", "", 4), ("scara", "", 6),
    ]  # fmt: skip
    shares = sum(kind[-1] for kind in kinds)
    for name, planner, share in kinds:
        for k in range(round(count * share / shares)):
            if name in ("panda", "scara"):
                yield f"{name}, free", plan(free(name, seed + k))
            else:
                made = plan(generate(name, seed + k), planner=planner)
                yield f"{name}, {label(planner)}", made


def free(name: str, seed: int) -> Scene:
    """A reach between two random configurations, with nothing in the way."""
    robot, rng = load_robot(name), np.random.default_rng(seed)
    low, high = np.maximum(robot.lower, -2.5), np.minimum(robot.upper, 2.5)
    begin, end = rng.uniform(low, high, (2, robot.n_joints))
    return Scene(
        "free", name, (), start=begin, goal=JointGoal(begin + rng.uniform() * (end - begin))
    )


def excess(made: Plan) -> float:
    """Largest excess over a limit at 1 kHz and at 20 places between rows, as a share of it."""
    curve, robot = made.trajectory, made.robot
    rows = np.stack([curve.positions, curve.velocities, curve.accelerations], axis=1)
    pieces = BPoly.from_derivatives(curve.times, list(rows))
    between = np.linspace(curve.times[:-1], curve.times[1:], 20, axis=1).ravel()
    times = np.union1d(np.arange(0.0, curve.duration, 1e-3), between)
    worst = max(
        float((robot.lower - pieces(times)).max()), float((pieces(times) - robot.upper).max())
    )
    for order, limit in enumerate((robot.velocity, robot.acceleration, robot.jerk), start=1):
        worst = max(worst, float((np.abs(pieces.derivative(order)(times)) / limit).max()) - 1.0)
    ends = np.abs(np.concatenate([curve.velocities[[0, -1]], curve.accelerations[[0, -1]]]))
    return max(worst, float(ends.max()))


def before(made: Plan) -> float:
    """Duration of the waypoints, evenly spaced, by differences of positions [s]."""
    robot, q = made.robot, made.trajectory.positions
    still = np.zeros_like(q[:1])
    steps = np.concatenate([still, np.diff(q, axis=0), still])
    dt = max(
        float((np.abs(steps) / robot.velocity).max()),
        float(np.sqrt((np.abs(np.diff(steps, axis=0)) / robot.acceleration).max())),
    )
    if made.scene.goal is None and made.scene.pushables:  # the tool is slow on its approach
        points, _ = robot.tool_pose(q[made.first :])
        far = float(np.linalg.norm(np.diff(points, axis=0), axis=1).max())
        hangs = made.scene.target.stem is not None
        dt = max(dt, far / (PUSH.hanging.speed if hangs else PUSH.standing.speed))
    return dt * (len(q) - 1)


def main() -> None:
    """Print one line a kind."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--plans", type=int, default=1000)
    parser.add_argument("--first", type=int, default=SEED, help="seed of the first scenes")
    asked = parser.parse_args()
    found: dict[str, list[tuple[float, float, bool]]] = {}
    for name, made in plans(asked.plans, asked.first):
        if not np.ptp(made.trajectory.positions, axis=0).any():
            continue  # no goal configuration was found: the arm stays
        longer = made.trajectory.duration / before(made)
        found.setdefault(name, []).append((excess(made), longer, made.success))
    print("| plans | number | with an excess | of these promised | "
          "duration over that of evenly spaced waypoints: median | 95 % |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- |")
    for name, rows in found.items():
        over, longer, success = np.array(rows).T
        bad = over > 1e-9
        print(f"| {name} | {len(rows)} | {bad.sum()} | {int(success[bad].sum())} "
              f"| {np.median(longer):.3f} | {np.quantile(longer, 0.95):.3f} |")  # fmt: skip


if __name__ == "__main__":
    main()
