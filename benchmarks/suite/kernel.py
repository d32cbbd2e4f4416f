"""Cost and gradient of all terms: ours beside C++, part by part."""

from collections.abc import Callable

from benchmarks.evaluation import Case, Program, near_obstacles, panda_with_cup, reach
from benchmarks.registry import RATIO, SUITE, Context, Measured, Metric, Value, Values
from benchmarks.timing import BATCH, in_turn, median, paired_ratio

WAYPOINTS, OBSTACLES = 100, 13
AGREEMENT = 1e-9
PARTS = ("kinematics", "distances", "terms", "self-collision", "pull back")


def metrics() -> list[Metric]:
    """Whole evaluations, then their parts."""
    about = "Panda, 86 body spheres, 13 primitive obstacles, 100 waypoints, double precision"
    ratio = "median of the quotients of batches run in turn"
    out = [
        Metric("evaluation/optipromp/time", "µs", about=about),
        Metric("evaluation/C++/time", "µs", about="-O3 -march=native, one thread, same arithmetic"),
        Metric("evaluation/C++ without curvature/time", "µs", about="cost and gradient only"),
        Metric("evaluation/optipromp/by C++", RATIO, tolerance=0.15, target=1.5, about=ratio),
        Metric("evaluation/optipromp/by C++ without curvature", RATIO, tolerance=0.15),
    ]
    for part in PARTS:
        out += [
            Metric(f"evaluation parts/{part}/optipromp", "µs"),
            Metric(f"evaluation parts/{part}/C++", "µs"),
        ]
    out.append(Metric("evaluation parts/calls from Python/optipromp", "µs"))
    return out


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
        parts = [median(values) for values in zip(*_profiles(program, context), strict=True)]
    name = "evaluation/optipromp"
    detail = {"minimum": 1e6 * min(ours), "difference to C++": off, "spheres": 60}
    out[f"{name}/time"] = Measured(1e6 * median(ours), detail)
    out["evaluation/C++/time"] = Measured(1e6 * median(same), {"minimum": 1e6 * min(same)})
    out["evaluation/C++ without curvature/time"] = Measured(
        1e6 * median(lean), {"minimum": 1e6 * min(lean)}
    )
    out[f"{name}/by C++"] = Measured(
        paired_ratio(ours, same), {"of the minima": min(ours) / min(same)}
    )
    out[f"{name}/by C++ without curvature"] = paired_ratio(ours, lean)
    for part, seconds in zip(PARTS, parts, strict=True):
        out[f"evaluation parts/{part}/C++"] = 1e6 * seconds
    small = Case(robot, 3, near_obstacles(robot, reach(3), OBSTACLES))
    timed = in_turn({**_parts(case), "few waypoints": small}, context.repeats(40))
    seconds_of = {name: median(values) for name, values in timed.items()}
    for part in PARTS:
        out[f"evaluation parts/{part}/optipromp"] = 1e6 * seconds_of[part]
    # what a hundred waypoints cost but for three of them: the rest is paid once a call
    work = (seconds_of["all"] - seconds_of["few waypoints"]) * WAYPOINTS / (WAYPOINTS - 3)
    out["evaluation parts/calls from Python/optipromp"] = Measured(
        1e6 * (seconds_of["all"] - work), {"within the parts above": True}
    )
    return out


def _profiles(program: Program, context: Context) -> list[list[float]]:
    return [program.ask("profile 10") for _ in range(context.repeats(30))]


def _parts(case: Case) -> dict[str, Callable[[], object]]:
    p, e, around = case.problem, case.problem.evaluation, case.problem.surroundings
    case()

    def distances() -> None:
        e.static.measure(e, around.static, len(around.static.kind), p.cutoff)
        e.dynamic.measure(e, around.dynamic, around.shared, p.cutoff)

    def terms() -> None:
        for cost in p.costs:
            cost.add(e, cost.weight)

    def apart() -> None:
        for constraint in p.constraints:
            constraint.add(e, constraint.weight)

    return {
        "all": case,
        "kinematics": lambda: e.move_to(case.q),
        "distances": distances,
        "terms": terms,
        "self-collision": apart,
        "pull back": p.gradient,
    }
