"""Cost and gradient of all terms: ours beside C++."""

from benchmarks.evaluation import Case, Program, near_obstacles, panda_with_cup, reach
from benchmarks.registry import RATIO, SUITE, Context, Measured, Metric, Value, Values
from benchmarks.timing import BATCH, in_turn, median, paired_ratio

WAYPOINTS, OBSTACLES = 100, 13
AGREEMENT = 1e-9


def metrics() -> list[Metric]:
    """Times of evaluations, and ours by those of C++."""
    about = "Panda, 86 body spheres, 13 primitive obstacles, 100 waypoints, double precision"
    ratio = "median of the quotients of batches run in turn"
    return [
        Metric("evaluation/optipromp/time", "µs", about=about),
        Metric("evaluation/C++/time", "µs", about="-O3 -march=native, one thread, same arithmetic"),
        Metric("evaluation/C++ without curvature/time", "µs", about="cost and gradient only"),
        Metric("evaluation/optipromp/by C++", RATIO, tolerance=0.15, target=1.5, about=ratio),
        Metric("evaluation/optipromp/by C++ without curvature", RATIO, tolerance=0.15),
    ]


@SUITE.benchmark("evaluation", metrics(), timeout=300)
def evaluation(context: Context) -> Values:
    """One evaluation as the solver makes it, and the C++ program on the same data."""
    robot = panda_with_cup()
    case = Case(robot, WAYPOINTS, near_obstacles(robot, reach(WAYPOINTS), OBSTACLES))
    out: dict[str, Value] = {}
    with Program(case) as program:
        off = program.difference(case)
        if not off < AGREEMENT:
            raise RuntimeError(f"C++ and ours differ by {off:.1e} of the value: nothing to compare")
        ours, same, lean = [], [], []
        for _ in range(context.repeats(60)):
            ours += in_turn({"ours": case}, 1)["ours"]
            calls = max(1, int(BATCH / ours[-1]) + 1)
            same += program.ask(f"time {calls}")
            lean += program.ask(f"time-lean {calls}")
    name = "evaluation/optipromp"
    detail = {"minimum": 1e6 * min(ours), "difference to C++": off}
    out[f"{name}/time"] = Measured(1e6 * median(ours), detail)
    out["evaluation/C++/time"] = Measured(1e6 * median(same), {"minimum": 1e6 * min(same)})
    out["evaluation/C++ without curvature/time"] = Measured(
        1e6 * median(lean), {"minimum": 1e6 * min(lean)}
    )
    out[f"{name}/by C++"] = Measured(
        paired_ratio(ours, same), {"of the minima": min(ours) / min(same)}
    )
    out[f"{name}/by C++ without curvature"] = paired_ratio(ours, lean)
    return out
