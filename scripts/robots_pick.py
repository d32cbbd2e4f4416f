"""Stock arms pick their own ``cluster`` scenes in the simulation: a table of robots-tried.md.

    python scripts/robots_pick.py [--folder FOLDER] [--count 50] [ARM ...] [NAME=FILE ...]

FOLDER is ``share/example-robot-data/robots`` of the package example-robot-data (extra ``models``),
by default the installed one. Before each plan the built-in Panda plans its scene of the same seed:
processor times are compared within one process, on whatever machine this is. NAME=FILE adds an arm.
"""

import argparse
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from robots_tried import models

from optipromp.core.planning import plan, warm_up
from optipromp.core.robots.library import NOTHING, Choice
from optipromp_bench.experiments.statistics import share, tabled
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

SEED = 77_000  # of the first scene
TIAGO = """format: 1
name: tiago
urdf: {urdf}
base: base_link
flange: wrist_ft_tool_link
allow_self: [[torso_fixed_column_link, arm_1_link]]
"""
ARMS = {
    "Panda's own URDF": "panda_description/urdf/panda.urdf",
    "UR3": "ur_description/urdf/ur3_robot.urdf",
    "UR5": "ur_description/urdf/ur5_robot.urdf",
    "UR10": "ur_description/urdf/ur10_robot.urdf",
    "xArm7": "xarm_description/urdf/xarm7.urdf",
    "Kinova j2s6s200": "kinova_description/robots/kinova.urdf",
    "TIAGo with its torso": "tiago_description/robots/tiago_no_hand.urdf",
}


COLUMNS = (
    "arm", "joints", "spheres", "neck of the cup", "valid plans", "picked", "picked, % (95 %)",
    "median time", "p95",
)  # fmt: skip


def pick(name: str, path: str | Path, choice: Choice, seeds: range) -> tuple[Any, ...]:
    """A row of the table: what became of the scenes of these seeds."""
    valid, picked, own, panda, causes = 0, 0, [], [], []
    generate("cluster", seeds[0], path, choice)
    for seed in seeds:
        for times, args in ((panda, ()), (own, (path, choice))):
            scene = generate("cluster", seed, *args)
            began = time.thread_time()
            made = plan(scene)
            times.append(time.thread_time() - began)
        outcome = simulate(made).outcome
        valid, picked = valid + made.success, picked + outcome.success
        causes += [] if outcome.success else [f"{seed} {made.status} {outcome.cause}"]
    ratio = np.median(own) / np.median(panda)
    late = np.percentile(own, 95) / np.percentile(panda, 95)
    print(f"{name}: {', '.join(causes)}", flush=True)
    joints, spheres = made.robot.n_joints, len(made.robot.spheres.radius)
    neck = made.scene.tool.parameters["length"] if made.scene.tool else 0.0
    return (
        name, joints, spheres, f"{1e3 * neck:.0f} mm", valid, picked, share(picked, len(seeds)),
        f"{ratio:.1f}", f"{late:.1f}",
    )  # fmt: skip


def main() -> None:
    """Run the arms that are named, or all, and print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("arms", nargs="*")
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--first", type=int, default=SEED, help="seed of the first scene")
    given = parser.parse_intermixed_args()
    folder, seeds = given.folder or models(), range(given.first, given.first + given.count)
    warnings.simplefilter("ignore")  # of arms without demonstrations
    warm_up()
    rows = []
    own_arms = dict(arm.split("=", 1) for arm in given.arms if "=" in arm)
    named = [arm for arm in given.arms if "=" not in arm]
    with tempfile.TemporaryDirectory() as written:
        for name, file in {"built-in Panda": "panda", **ARMS, **own_arms}.items():
            if named and name not in (*named, *own_arms):
                continue
            path: str | Path = file if file == "panda" else folder / file
            if name.startswith("TIAGo"):
                own = Path(written, "tiago.yaml")
                own.write_text(TIAGO.format(urdf=path))
                path = own
            rows.append(pick(name, path, NOTHING, seeds))
    print(tabled("Arms", COLUMNS, rows))


if __name__ == "__main__":
    main()
