"""MPlib in an interpreter of its own: its wheels want NumPy 1, this library NumPy 2.

Reads one JSON document a line on standard input, answers with one a line. Imports nothing of ours.
"""

import json
import sys
import time
from typing import Any


def main() -> None:
    """Answer until the input ends."""
    import mplib
    import numpy as np

    print(json.dumps({"mplib": getattr(mplib, "__version__", "")}), flush=True)
    for line in sys.stdin:
        asked: dict[str, Any] = json.loads(line)
        began = time.perf_counter()
        planner = mplib.Planner(
            urdf=asked["urdf"], srdf=asked["srdf"], move_group=asked["tip"],
            joint_vel_limits=np.array(asked["velocity"]),
            joint_acc_limits=np.array(asked["acceleration"]),
        )  # fmt: skip
        mplib.set_global_seed(asked["seed"])
        goals = [np.array(goal) for goal in asked["goals"]]
        found = planner.plan_qpos(
            goals, np.array(asked["start"]), time_step=asked["step"],
            planning_time=asked["longest"],
        )  # fmt: skip
        seconds = time.perf_counter() - began
        points = found.get("position")
        answer = {
            "status": found["status"],
            "seconds": seconds,
            "position": None if points is None else np.asarray(points).tolist(),
        }
        print("\n" + json.dumps(answer), flush=True)  # MPlib prints as it likes


if __name__ == "__main__":
    main()
