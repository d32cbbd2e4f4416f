"""Streams plans to a simulated FR3 with reflexes (``tests/franka/server.py``), by franky.

    python -m scripts.franka_plans ROWS.jsonl

Plans the paper's scenarios (each row of ``optipromp scenarios``) and 20 generated clusters, and
says what an FR3 would abort; such a scene is planned again for the robot ``fr3``. Streams each plan
at its own speed from the arm at rest at its begin, and prints the reflexes and the tracking error.
Rows that the file has are not run again. It needs franky-control and franky-sim. The arm of
scenarios 1 and 2 is no Franka.
"""

import json
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from tests.franka.paced import Paced
from tests.franka.server import serving

from optipromp import Plan, load_scene, plan
from optipromp.core.errors import OptiPrompError
from optipromp.core.scenes import Scene
from optipromp_loop.control.fr3 import foreseen, torques
from optipromp_loop.control.franka import FRANKY_STIFFNESS
from optipromp_paper.scenarios import CASES
from optipromp_sim.generate import generate

HOST = "127.0.48.20"
SEEDS = range(30000, 30020)
OLD = 0.003  # [s] two of a reference's period at 500 Hz, one of the arm's cycle


def streamed(made: Plan, host: str) -> dict[str, Any]:
    """Stream a plan to an arm that stands at its begin; the reflexes and the errors.

    The errors are of the records (100 Hz): of the joints [rad], of the tool point [m] on the way
    and at the end.
    """
    curve, robot = made.trajectory, made.robot
    row: dict[str, Any] = {"status": str(made.status), "duration": curve.duration}
    aborts = foreseen(robot, curve, made.scene.up)
    row |= {"foreseen": [each.kind for each in aborts.violations], "power": aborts.power}
    row["shares"], row["lag"] = aborts.shares, lag(made)
    with (
        serving(host, curve.positions[0]) as reflexes,
        Paced(host, robot) as arm,
    ):
        try:
            done = arm.execute(curve)
        except OptiPrompError as error:
            return row | {"reflexes": list(reflexes), "message": error.message}
        points = [robot.tool_pose(q)[0] for q in (done.positions, done.reference)]
        last = [robot.tool_pose(q)[0] for q in (arm.state().q, curve.positions[-1])]
        return row | {
            "reflexes": list(reflexes),
            "finished": done.finished,
            "message": done.reason,
            "joint_error": done.largest_error,
            "tool_error": float(np.linalg.norm(points[0] - points[1], axis=1).max()),
            "end_error": float(np.linalg.norm(last[0] - last[1])),
        }


def lag(made: Plan) -> float:
    """The joints' largest error [rad] without friction, by the stiffness of the tracker.

    It feels what inertia asks of the torques, and a reference that is up to OLD old.
    """
    curve, up = made.trajectory, made.scene.up
    times = np.linspace(0.0, curve.duration, int(1e3 * curve.duration) + 1)
    q, velocity, _ = curve.sample(times)
    needed = torques(made.robot, times, q, velocity, up)
    needed -= torques(made.robot, 1e3 * times, q, 0.0 * velocity, up)  # of gravity alone
    return float((np.abs(needed / FRANKY_STIFFNESS) + OLD * np.abs(velocity)).max())


def cases() -> Iterator[tuple[str, Scene, dict[str, Any]]]:
    """Names of the rows, scenes, and how each is planned."""
    for case in CASES:
        scene = load_scene(case.scene)
        if case.start is not None:
            scene = replace(scene, start=np.array(case.start))
        if scene.robot == "panda":
            yield case.key, scene, {"planner": case.planner}
        else:
            print(f"{case.key}: not streamed, its arm is {scene.robot}")
    for seed in SEEDS:
        yield f"cluster {seed}", generate("cluster", seed), {}


def streamed_row(name: str, scene: Scene, settings: dict[str, Any]) -> dict[str, Any]:
    """The row of a case; where an FR3 would abort the Panda's plan, of one for the FR3."""
    made = plan(scene, **settings)
    aborts = foreseen(made.robot, made.trajectory, scene.up).violations
    row: dict[str, Any] = {"name": name, "panda": [str(each) for each in aborts]}
    if not aborts:
        return row | streamed(made, HOST)
    try:
        made = plan(replace(scene, robot="fr3"), **settings)
    except OptiPrompError as error:
        return row | {"status": str(error.code), "duration": 0.0, "foreseen": [],
                      "reflexes": [], "message": error.message}  # fmt: skip
    return row | streamed(made, HOST)


def main(path: Path) -> None:
    """Run the rows that the file lacks, and print all."""
    known = {}
    if path.exists():
        known = {row["name"]: row for row in map(json.loads, path.read_text().splitlines())}
    print("plan | status | s | foreseen | reflexes | joint mrad | tool mm, at the end | v a j | W")
    for name, scene, settings in cases():
        if name not in known:
            began = time.perf_counter()
            row = streamed_row(name, scene, settings)
            row["took"] = time.perf_counter() - began
            with path.open("a") as file:
                file.write(json.dumps(row) + "\n")
            known[name] = row
        print(line(known[name]), flush=True)
    aborted = sum(bool(row["reflexes"]) for row in known.values())
    print(f"{len(known)} plans, {aborted} aborted by a reflex")


def line(row: dict[str, Any]) -> str:
    """A row of the table."""
    told = [", ".join(sorted(set(row[which]))) or "none" for which in ("foreseen", "reflexes")]
    head = f"{row['name']} | {row['status']} | {row['duration']:.2f} | {told[0]} | {told[1]} | "
    if "tool_error" not in row:
        return head + row["message"]
    shares = " ".join(f"{row['shares'][what]:.2f}" for what in ("velocity", "acceleration", "jerk"))
    return head + (
        f"{1e3 * row['joint_error']:.1f} | {1e3 * row['tool_error']:.1f}, "
        f"{1e3 * row['end_error']:.1f} | {shares} | {row['power']:.0f}"
        f"{'' if row['finished'] else ' | ' + row['message']}"
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
