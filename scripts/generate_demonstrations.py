"""Make the built-in demonstrations: seeded reaches to fruit-like targets, tool first.

    python scripts/generate_demonstrations.py

Each is a smooth motion from near the robot's ready pose to a point under a random target, then
straight in along the approach, as a person guiding the arm would do it. Writes
``packages/optipromp/src/optipromp/core/promp/data/<robot>.npz``. The shipped files are of commit
1a6a0b99: the inverse kinematics of today makes others of the same kind, and other plans with these.
"""

from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline

from optipromp.core.promp import save_demonstrations
from optipromp.core.promp.demonstrations import Demonstration, Demonstrations
from optipromp.core.robots import ik
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool

OUT = Path(__file__).resolve().parents[1] / "packages/optipromp/src/optipromp/core/promp/data"
SEED = 20261121
COUNT = 40
SAMPLES = 60
UP = np.array([0.0, 0.0, 1.0])


def demonstrations(
    robot: Robot,
    ready: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    deviation: np.ndarray,
    below: float,
    rng: np.random.Generator,
) -> Demonstrations:
    """Reaches to targets in the box from ``low`` to ``high`` [m], from near ``ready``."""
    found: list[Demonstration] = []
    while len(found) < COUNT:
        target = rng.uniform(low, high)
        start = np.clip(ready + rng.normal(0.0, deviation), robot.lower, robot.upper)
        goal, miss = ik.track(robot, target[None], UP[None], start)
        heights = np.array([0.33, 0.67, 1.0]) * (below + rng.uniform(0.0, 0.04))
        points = target - heights[:, None] * UP
        points[:, :2] += rng.normal(0.0, 0.006, (3, 2))
        via, misses = ik.track(robot, points, np.tile(UP, (3, 1)), goal[0])
        turn = np.max(np.abs(np.diff(np.vstack([start, via[::-1], goal]), axis=0)))
        margin = np.min(np.minimum(via - robot.lower, robot.upper - via))
        if max(miss.max(), misses.max()) > 1e-4 or turn > 1.5 or margin < 0.0:
            continue
        camera = rng.uniform(0.42, 0.55)
        phases = np.concatenate([[0.0], np.linspace(camera, 1.0, 4)])
        motion = CubicSpline(phases, np.vstack([start, via[::-1], goal]), bc_type="clamped")
        z = np.linspace(0.0, 1.0, SAMPLES)
        q = motion(z)
        if np.any(q < robot.lower) or np.any(q > robot.upper):
            continue
        found.append(Demonstration(z * rng.uniform(2.5, 4.0), np.round(q, 6)))
    return Demonstrations(tuple(found), robot.joint_names)


def main() -> None:
    """Write both files."""
    panda = with_tool(load_robot("panda"), Cup(radius=0.05))
    scara = with_tool(load_robot("scara"), Cup(radius=0.03, length=0.0616, opening=0.04))
    OUT.mkdir(parents=True, exist_ok=True)
    save_demonstrations(
        demonstrations(
            panda,
            np.array([1.42, 1.10, -1.26, -2.42, -1.69, 1.02, 0.8]),
            np.array([0.38, -0.12, 0.78]),
            np.array([0.52, 0.12, 0.94]),
            np.full(7, 0.06),
            0.2,
            np.random.default_rng(SEED),
        ),
        OUT / "panda.npz",
    )
    save_demonstrations(
        demonstrations(
            scara,
            np.array([0.03, 0.8, 0.9]),
            np.array([-0.10, 0.42, 0.32]),
            np.array([0.10, 0.52, 0.40]),
            np.array([0.008, 0.08, 0.08]),
            0.2,
            np.random.default_rng(SEED),
        ),
        OUT / "scara.npz",
    )


if __name__ == "__main__":
    main()
