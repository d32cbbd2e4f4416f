"""How cost grows: with waypoints, joints, obstacles and the points of a cloud."""

import functools
import os
import tempfile
from dataclasses import replace
from pathlib import Path
from statistics import median as middle

import numpy as np

from benchmarks.evaluation import Case, far_obstacles, near_obstacles, panda_with_cup, reach
from benchmarks.registry import (
    RATIO,
    SUITE,
    Absent,
    Context,
    Measured,
    Metric,
    Value,
    Values,
    stopwatch,
)
from benchmarks.timing import in_turn, median, paired_ratio, reference
from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.obstacles import pack
from optipromp.core.geometry.shapes import PointCloudShape
from optipromp.core.planning import plan, warm_up
from optipromp.core.planning.task import resolve
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene, SceneObject

WAYPOINTS, JOINTS, OBSTACLES = (50, 100, 200, 400), (4, 7, 10, 14), (10, 100, 1000)
LINEAR = {"waypoints": "400 waypoints by 100, per waypoint", "joints": "14 joints by 7, per joint"}
CROWD, MEASURED = "1000 obstacles by 10", ("evaluation", "whole plan")
LINK = 0.12  # [m]
CLOUD = 100_000


def metrics() -> list[Metric]:
    """One evaluation at every size, and the quotients of sizes."""
    out = [Metric(f"growth/{n} waypoints/evaluation", "µs") for n in WAYPOINTS]
    out += [Metric(f"growth/{n} joints/evaluation", "µs") for n in JOINTS]
    out += [Metric(f"growth/{n} obstacles/evaluation", "µs") for n in OBSTACLES]
    out += [Metric(f"growth/{n} obstacles/whole plan", "ms") for n in OBSTACLES]
    per = "1 where cost grows in proportion, below where some of it does not grow"
    out += [
        Metric(f"growth/{name}/evaluation", RATIO, target=1.1, about=per)
        for name in LINEAR.values()
    ]
    out += [Metric(f"growth/{CROWD}/{what}", RATIO, target=2.0) for what in MEASURED]
    return out


def chain(joints: int, folder: Path) -> Robot:
    """An arm of ``joints`` revolute joints, each link as long and as thick as the others."""
    links, rows = ['<link name="base"/>'], []
    for i in range(joints):
        axis = ("0 0 1", "0 1 0")[i % 2]
        links.append(
            f'<link name="l{i}"><collision><origin xyz="0 0 {LINK / 2}"/><geometry>'
            f'<cylinder radius="0.04" length="{LINK}"/></geometry></collision></link>'
        )
        rows.append(
            f'<joint name="j{i}" type="revolute"><parent link="{f"l{i - 1}" if i else "base"}"/>'
            f'<child link="l{i}"/><origin xyz="0 0 {LINK if i else 0.2}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="2"/></joint>'
        )
    path = folder / f"chain-{joints}.urdf"
    path.write_text(f'<robot name="chain">{"".join(links + rows)}</robot>', encoding="utf-8")
    return load_robot(str(path))


@SUITE.benchmark("growth", metrics())
def growth(context: Context) -> Values:
    """One evaluation, and whole plans, as the problem grows."""
    robot, rounds = panda_with_cup(), context.repeats(40)
    waypoints = {n: Case(robot, n, near_obstacles(robot, reach(n), 13)) for n in WAYPOINTS}
    near = near_obstacles(robot, reach(100), 10)
    around = {n: Case(robot, 100, near + far_obstacles(robot, reach(100), n - 10), cells=True)
              for n in OBSTACLES}  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        arms = {n: chain(n, Path(folder)) for n in JOINTS}
    joints = {n: Case(arm, 100, near_obstacles(arm, reach(100, n), 13)) for n, arm in arms.items()}
    out: dict[str, Value] = {}
    for what, cases in (("waypoints", waypoints), ("joints", joints), ("obstacles", around)):
        times = in_turn({str(n): case for n, case in cases.items()}, rounds)
        for n, case in cases.items():
            spheres = {"spheres": len(case.robot.spheres.radius)}
            out[f"growth/{n} {what}/evaluation"] = Measured(1e6 * median(times[str(n)]), spheres)
        if what == "obstacles":
            out[f"growth/{CROWD}/evaluation"] = paired_ratio(times["1000"], times["10"])
        else:
            small, large = list(cases)[1], list(cases)[-1]
            quotient = paired_ratio(times[str(large)], times[str(small)])
            out[f"growth/{LINEAR[what]}/evaluation"] = quotient * small / large
    return out | _plans(context)


def _plans(context: Context) -> dict[str, Value]:
    """Whole plans of scenario-4 among objects that stand well away from the arm's way."""
    warm_up()
    base = load_scene("scenario-4")
    robot = resolve(base).robot
    swept = plan(base).trajectory.positions
    scenes = {n: _crowded(base, robot, swept, n) for n in OBSTACLES}
    times: dict[int, list[float]] = {n: [] for n in OBSTACLES}
    status = {n: str(plan(scene).status) for n, scene in scenes.items()}
    for _ in range(context.repeats(15)):
        for n, scene in scenes.items():
            times[n].append(1e3 * stopwatch(functools.partial(plan, scene)))
    out: dict[str, Value] = {
        f"growth/{n} obstacles/whole plan": Measured(median(t), {"status": status[n]})
        for n, t in times.items()
    }
    name = f"growth/{CROWD}/whole plan"
    out[name] = paired_ratio(times[OBSTACLES[-1]], times[OBSTACLES[0]])
    failed = [f"{n} obstacles: {word}" for n, word in status.items() if word != "success"]
    if failed:  # a plan that ends early is no plan to compare
        out[name] = Absent("; ".join(failed), "failed")
    return out


def _crowded(base: Scene, robot: Robot, swept: FloatArray, count: int) -> Scene:
    own = sum(obj.role != "target" for obj in base.objects)
    more = [
        SceneObject(f"far-{i}", "static", shape, at, turn)
        for i, (shape, at, turn) in enumerate(far_obstacles(robot, swept, count - own))
    ]
    return replace(base, objects=(*base.objects, *more))


CLOUDS = [
    Metric("point cloud/100,000 points/time", "s", target=1.0, about="from points to planning, "
           "nothing cached"),
    Metric("point cloud/100,000 points/by fixed work", RATIO, tolerance=0.6),
]  # fmt: skip


@SUITE.benchmark("point-cloud", CLOUDS)
def point_cloud(context: Context) -> Values:
    """A cloud of a table with objects on it, made ready for the distance kernels."""
    times, work = [], []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["OPTIPROMP_CACHE"] = folder
        for seed in range(context.repeats(5, 2) + 1):
            cloud = table(np.random.default_rng(seed))
            posed = [(PointCloudShape(cloud, 0.004), np.zeros(3), np.eye(3))]
            seconds = stopwatch(functools.partial(pack, posed))
            if seed:  # the first compiles or loads
                times.append(seconds)
                work.append(min(stopwatch(reference) for _ in range(5)))
    return {
        "point cloud/100,000 points/time": Measured(middle(times), {"minimum": min(times)}),
        "point cloud/100,000 points/by fixed work": paired_ratio(times, work),
    }


def table(rng: np.random.Generator) -> FloatArray:
    """Points (100,000, 3) of a table-top of 1 m² with bumps, seen with a millimetre of noise."""
    flat = rng.uniform(-0.5, 0.5, (CLOUD, 2))
    bumps = rng.uniform(-0.4, 0.4, (12, 2))
    away = np.linalg.norm(flat[:, None] - bumps, axis=2).min(axis=1)
    height = np.sqrt(np.maximum(0.06**2 - away**2, 0.0)) + rng.normal(0.0, 0.001, CLOUD)
    return np.column_stack([flat, height])
