"""Is the shadow right? Recordings of other pickers, whose harm is known from the simulation.

    optipromp bench run --entry straight --count 5 --out straight
    python scripts/shadow_picks.py straight push-aside clone --out recordings

Each folder is one of ``optipromp bench run``. Its motions in the engine ``arm`` become recordings
as docs/shadow.md has them: joint states at 100 Hz, looks of a detector before each pick, the
gripper. Picks among the same static objects are one recording. The table has how many of the picks
that harmed something in simulation, were clean, or missed the target are called harmful, with 95 %
intervals. In ``--out`` are the recordings, for ``optipromp shadow``.
"""

import argparse
import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.files import json_text, read_npz, write_atomically
from optipromp.core.planning.task import posed
from optipromp.core.scenes.io import save_scene, scene_to_dict
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import CURVE, Trajectory, chained
from optipromp_bench import episode
from optipromp_bench.experiments.statistics import Table, share
from optipromp_bench.sets import scene_of
from optipromp_bench.tracks import BACK
from optipromp_loop.control import without_fruits
from optipromp_loop.shadow.compared import Shadowed, shadowed
from optipromp_loop.shadow.recording import load_recorded
from optipromp_sim.simulation import DETECTORS, Detector
from optipromp_sim.simulation.detector import Truth

RATE = 100.0  # [Hz] of the joint states
ENDS = "harmed", "clean", "missed"
HARMFUL = ": called harmful % (95 %)"
COLUMNS = "entry", "picks judged", *(f"{end}{of}" for end in ENDS for of in ("", HARMFUL))
STAND, HOME = 0.6, 2.0  # [s] before a pick and at the grasp; of the way back to the start


@dataclass(frozen=True, eq=False)
class Done:
    """A pick that the simulation has judged."""

    scene: Scene
    reach: Trajectory
    result: str
    back: Trajectory | None = None  # None: as the tool came


def still(one: Done) -> str:
    """What stands still in the scene of a pick, as a text."""
    return json_text(scene_to_dict(without_fruits(one.scene))["objects"])


def picks_of(folder: Path) -> list[Done]:
    """The picks of a folder of ``optipromp bench run``, in the engine ``arm``."""
    out = []
    for row in csv.DictReader((folder / "rows.csv").read_text("utf-8").splitlines()):
        if row["engine"] != "arm" or row["result"] in ("refused", "error"):
            continue
        scene, _ = scene_of(row["preset"], int(row["seed"]))
        robot, state = posed(scene)
        found = read_npz(folder / "motions" / f"{row['preset']}-{row['seed']}.npz")
        if "arm" in found:  # the velocities of a policy
            q = [state.q]
            for action in found["arm"]:
                (state,) = episode.driven(robot, state, action, 1.0 / episode.RATE, 1)
                q.append(state.q)
            reach = Trajectory.through(np.array(q), 1.0 / episode.RATE, robot.joint_names)
        else:
            reach = Trajectory(*(found[key] for key in CURVE), robot.joint_names)
        rows = [found[key] for key in BACK if key in found]
        back = Trajectory(*rows, robot.joint_names) if rows else None
        out.append(Done(scene, reach, row["result"], back))
    return out


def record(picks: Sequence[Done], file: Path, detector: str) -> None:
    """Leave the recording of picks, one after the other, and its table."""
    robot, names = posed(picks[0].scene)[0], picks[0].reach.joint_names
    parts, looks, shut = list[Trajectory](), list[dict[str, Any]](), list[tuple[float, float]]()
    for k, one in enumerate(picks):
        eye, none = Detector(one.scene, robot, DETECTORS[detector], k), np.zeros((0, 3))
        (begin, end), now = one.reach.positions[[0, -1]], sum(part.duration for part in parts)
        for time in now + 0.05 * np.arange(10):
            look = eye.expose(time, begin, Truth((), none, np.zeros((0, 3, 3)), ()))
            items = scene_to_dict(replace(one.scene, objects=look.in_base()))["objects"]
            where = {key: getattr(look.camera, key) for key in ("position", "orientation")}
            looks.append({"time": time, "objects": items, "camera": where})
        back = one.back or episode.as_it_came(robot, one.reach.positions)
        stand, grasp = (Trajectory.still(q, (0.0, STAND), names) for q in (begin, end))
        home = Trajectory.through(np.array([back.positions[-1], begin]), HOME, names)
        parts += [stand, one.reach, grasp, back, home]
        closed = now + 1.5 * STAND + one.reach.duration
        shut.append((closed, closed + 0.5 * STAND + back.duration))
    line = chained(parts).resample(RATE)
    finger = [0.04 - 0.03 * any(a <= time < b for a, b in shut) for time in line.times]
    table, head = file.with_suffix(".csv"), ",".join(["time", *names, "finger"])
    rows = np.column_stack([line.times, line.positions, finger])
    np.savetxt(table, rows, delimiter=",", header=head, comments="", fmt="%.8g")
    document = {"joint_states": table.name, "gripper": "finger", "looks": looks}
    write_atomically(file, json_text(document).encode())


def line_of(rows: Sequence[tuple[Done, Shadowed]]) -> list[Any]:
    """How many picks were judged; of each end how many there are, and are called harmful."""
    known = [(one.result, beside.harmful) for one, beside in rows if not beside.why]
    cells: list[Any] = [f"{len(known)} of {len(rows)}"]
    for end in ENDS:
        alarms = [alarm for result, alarm in known if result == end]
        cells += [len(alarms), share(sum(alarms), len(alarms))]
    return cells


def main() -> None:
    """Make the recordings, shadow them, and print how right the shadow was."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("results", nargs="+", type=Path, metavar="DIR")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--detector", choices=tuple(DETECTORS), default="zero-mean")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    every = dict[str, list[tuple[Done, Shadowed]]]()
    for folder in given.results:
        rows = every.setdefault(f"`{folder.name}`", [])
        for k, (_, group) in enumerate(groupby(sorted(picks_of(folder), key=still), still)):
            picks, file = list(group), given.out / f"{folder.name}-{k}.json"
            known = without_fruits(picks[0].scene)
            save_scene(known, file.with_suffix(".yaml"))
            record(picks, file, given.detector)
            rows += zip(picks, shadowed(load_recorded(file, known), known), strict=True)
    every["all"] = [row for rows in every.values() for row in rows]
    print(Table("Shadow", COLUMNS, [[name, *line_of(rows)] for name, rows in every.items()]))


if __name__ == "__main__":
    main()
