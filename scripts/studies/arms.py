"""Stock arms pick their own ``cluster`` scenes in the simulation: a table of robots-tried.md.

    optipromp bench study scripts/studies/arms.toml --out arms

Files are those of the package example-robot-data (extra ``models``). Before each plan the built-in
Panda plans its scene of the same seed: times are compared within one process, on whatever machine
this is.
"""

import itertools
import tempfile
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.metadata import distribution
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.planning import plan, warm_up
from optipromp.core.robots.library import NOTHING
from optipromp_bench.experiments.statistics import Table, share
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

MODELS = "cmeel.prefix/share/example-robot-data/robots"  # in the folder of installed packages
TIAGO = """format: 1
name: tiago
urdf: {urdf}
base: base_link
flange: wrist_ft_tool_link
allow_self: [[torso_fixed_column_link, arm_1_link]]
"""
ARMS = {
    "built-in Panda": "panda",
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


@cache
def folder() -> tempfile.TemporaryDirectory[str]:
    """Of files that are written here, once a process, in which code is compiled, too."""
    warnings.simplefilter("ignore")  # of arms without demonstrations
    warm_up()
    return tempfile.TemporaryDirectory()


def models() -> Path:
    """The robots of the installed package example-robot-data."""
    return Path(str(distribution("example-robot-data").locate_file(MODELS)))


def file_of(name: str) -> str | Path:
    """The robot's name or file."""
    own, path = Path(folder().name, "tiago.yaml"), ARMS[name]
    if path == "panda":
        return path
    if not name.startswith("TIAGo"):
        return models() / path
    own.write_text(TIAGO.format(urdf=models() / path))
    return own


@dataclass(frozen=True)
class Arms:
    """A study of arms."""

    arms: tuple[str, ...] = tuple(ARMS)
    seeds: tuple[int, int] = (77_000, 77_050)

    def asks(self) -> list[dict[str, Any]]:
        """See :class:`optipromp_bench.experiments.kinds.Kind`."""
        all_ = itertools.product(self.arms, range(*self.seeds))
        return [{"preset": "cluster", "arm": name, "seed": seed} for name, seed in all_]

    def trial(self, ask: Mapping[str, Any]) -> dict[str, Any]:
        """What an arm planned and picked, and what it took beside the Panda [s]."""
        file, times = file_of(ask["arm"]), []
        generate("cluster", ask["seed"], file, NOTHING)  # reads the robot
        for args in ((), (file, NOTHING)):
            scene = generate("cluster", ask["seed"], *args)
            began = time.thread_time()
            made = plan(scene)
            times.append(time.thread_time() - began)
        outcome, tool = simulate(made).outcome, made.scene.tool
        return {
            "result": outcome.result, "cause": f"{made.status} {outcome.cause}", "times": times,
            "valid": made.success, "picked": outcome.success, "joints": made.robot.n_joints,
            "spheres": len(made.robot.spheres.radius),
            "neck": tool.parameters["length"] if tool else 0.0,
        }  # fmt: skip

    @staticmethod
    def told(parts: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Table]:
        """A line for each arm."""
        lines = []
        for name, own in itertools.groupby(itertools.chain(*parts.values()), lambda r: r["arm"]):
            rows = list(own)
            panda, times = np.array([row["times"] for row in rows]).T
            picked, last = sum(row["picked"] for row in rows), rows[-1]
            ratios = (np.quantile(times, q) / np.quantile(panda, q) for q in (0.5, 0.95))
            lines.append([
                name, last["joints"], last["spheres"], f"{1e3 * last['neck']:.0f} mm",
                sum(row["valid"] for row in rows), picked, share(picked, len(rows)),
                *(f"{ratio:.1f}" for ratio in ratios),
            ])  # fmt: skip
        return [Table("Arms", COLUMNS, lines)]
