"""Time of whole warm plans: joint beside sequential and I-ProMP, in one run.

    python benchmarks/planning.py [--repeats N] [--json]

Prints, for scenario-3 and scenario-4, the median and the 90th percentile of whole library calls
(``optipromp.plan`` on a loaded scene, inverse kinematics, all starts and the independent check
included), the ratio to the joint strategy, and whether the plan holds. A call that fails is a row.
"""

import argparse
import json
import statistics
import time

from optipromp import load_scene, plan

CASES = (
    ("opti-promp, joint", {"planner": "opti-promp", "strategy": "joint"}),
    ("opti-promp, sequential", {"planner": "opti-promp", "strategy": "sequential"}),
    ("i-promp", {"planner": "i-promp"}),
    ("promp", {"planner": "promp"}),
)


def measure(name: str, options: dict[str, str], repeats: int) -> dict[str, object]:
    """Times [ms] of ``repeats`` warm plans of one case."""
    scene = load_scene(name)
    result = plan(scene, **options)
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        result = plan(scene, **options)
        times.append(1e3 * (time.perf_counter() - began))
    return {
        "scene": name,
        "median": statistics.median(times),
        "p90": sorted(times)[int(0.9 * (len(times) - 1))],
        "status": str(result.status),
    }


def main() -> None:
    """Run every case and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=30)
    parser.add_argument("--json", action="store_true")
    arguments = parser.parse_args()
    rows = []
    for scene in ("scenario-3", "scenario-4"):
        base = None
        for label, options in CASES:
            repeats = (
                max(3, arguments.repeats // 10) if "sequential" in label else arguments.repeats
            )
            row = {"case": label, **measure(scene, options, repeats)}
            base = base or row["median"]
            row["ratio"] = row["median"] / base
            rows.append(row)
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return
    print(f"{'scene':<12}{'case':<26}{'median':>10}{'p90':>10}{'ratio':>9}  status")
    for row in rows:
        print(
            f"{row['scene']:<12}{row['case']:<26}{row['median']:>7.1f} ms{row['p90']:>7.1f} ms"
            f"{row['ratio']:>9.2f}  {row['status']}"
        )


if __name__ == "__main__":
    main()
