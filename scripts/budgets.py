"""Whether `timeout` holds within a tenth, whatever the scene.

    python scripts/budgets.py --seconds 0.2 0.5 2

The planner's clock is the process's own time here, so the machine's other work counts for nothing;
``--wall`` leaves it the wall clock. The first plan of each scene, with the least budget, is not
counted: it makes the robot, and compiles.
"""

import argparse
import math
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.geometry import Box, Cylinder, Sphere
from optipromp.core.planning import PlanOptions, plan, warm_up
from optipromp.core.scenes import JointGoal, Scene, SceneObject, Stem, load_scene
from optipromp_sim.generate import generate

TENTH = 1.1
JOINTS = 30


def shell(count: int, nearest: float) -> tuple[SceneObject, ...]:
    """Small balls about the arm, from ``nearest`` to 2 m from its shoulder."""
    rng = np.random.default_rng(0)
    out = rng.normal(size=(count, 3))
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    places = rng.uniform(nearest, 2.0, (count, 1)) * out + [0.0, 0.0, 0.4]
    return tuple(SceneObject(f"c{i}", "static", Sphere(0.01), at) for i, at in enumerate(places))


def hanging(count: int) -> tuple[SceneObject, ...]:
    """Fruits on stems all about, a hundred of them before the target."""
    rng = np.random.default_rng(1)
    places = rng.uniform([0.2, -0.6, 0.4], [0.9, 0.6, 1.1], (count, 3))
    places[:100] = rng.uniform([0.40, -0.05, 0.70], [0.50, 0.05, 0.86], (100, 3))
    return tuple(
        SceneObject(f"p{i}", "pushable", Sphere(0.012), at, stem=Stem.along(at, UP, 0.15))
        for i, at in enumerate(places)
    )


def standing(count: int) -> tuple[SceneObject, ...]:
    """Packs on a board, a hundred of them before the target."""
    side = math.ceil(math.sqrt(count))
    at = np.stack(np.meshgrid(*(np.linspace(-0.9, 0.9, side),) * 2), axis=-1).reshape(-1, 2)
    places = np.column_stack([at + [0.5, 0.0], np.full(len(at), 0.8)])[:count]
    packs = tuple(
        SceneObject(f"p{i}", "pushable", Cylinder(0.01, 0.06), p) for i, p in enumerate(places)
    )
    board = SceneObject("board", "static", Box((2.4, 2.4, 0.02)), np.array([0.5, 0.0, 0.76]))
    return (*packs, board)


UP = np.array([0.0, 0.0, 1.0])


def around(scene: Scene, things: tuple[SceneObject, ...]) -> Scene:
    """The scene with those of the things that leave free where the arm stands at both ends."""
    made = plan(scene)
    centers = made.robot.sphere_centers(made.trajectory.positions[[0, -1]]).reshape(-1, 3)
    kept = [o for o in things if np.linalg.norm(centers - o.position, axis=1).min() > 0.1]
    return replace(scene, objects=(*scene.objects, *kept))


def long_arm(folder: Path) -> Scene:
    """An arm of :data:`JOINTS` joints about y and z by turns, among balls."""
    links = ['<robot name="long"><link name="l0"/>']
    for i in range(1, JOINTS + 1):
        links.append(
            f'<link name="l{i}"><collision><origin xyz="0 0 0.03"/><geometry><sphere radius="0.03"'
            f'/></geometry></collision></link><joint name="j{i}" type="revolute"><parent link='
            f'"l{i - 1}"/><child link="l{i}"/><origin xyz="0 0 0.05"/><axis xyz="0 {i % 2} '
            f'{(i + 1) % 2}"/><limit lower="-1" upper="1" velocity="1" effort="9"/></joint>'
        )
    path = folder / "long.urdf"
    path.write_text("".join(links) + "</robot>", encoding="utf-8")
    goal = JointGoal(np.where(np.arange(JOINTS) % 2 == 0, 0.08, 0.0))
    return Scene("long", str(path), shell(300, 1.0)[:150], goal=goal, start=np.full(JOINTS, 0.01))


def cases(folder: Path) -> dict[str, tuple[Scene, dict[str, Any]]]:
    """Scenes that ask for more than there is time for, and their options."""
    three, four = load_scene("scenario-3"), load_scene("scenario-4")
    bare = replace(three, objects=tuple(o for o in three.objects if o.role == "target"))
    lid = SceneObject("lid", "static", Box((0.3, 0.3, 0.05)), np.array([0.45, 0.0, 0.93]))

    def with_(scene: Scene, *more: SceneObject) -> Scene:
        return replace(scene, objects=(*scene.objects, *more))

    return {
        "100,000 obstacles, apart": (with_(three, *shell(100_000, 1.1)), {}),
        "100,000 obstacles, in the way": (around(three, shell(100_000, 0.3)), {}),
        "1,000 pushables on stems": (around(bare, hanging(1000)), {}),
        "1,000 standing pushables": (around(bare, standing(1000)), {}),
        "2,000 waypoints": (four, {"waypoints": 2000}),
        "2,000 waypoints, no way": (with_(three, lid), {"waypoints": 2000}),
        "an arm of 30 joints": (long_arm(folder), {}),
        "no way": (with_(three, lid), {}),
        "fruits in the way": (generate("cluster", 11), {}),
        "packs in the way": (generate("shelf", 7), {}),
    }


def main() -> None:
    """Print a line for each scene and budget."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, nargs="+", default=[0.2, 0.5, 2.0])
    parser.add_argument("--only", default="")
    parser.add_argument("--wall", action="store_true")
    parser.add_argument("--planner", default="opti-promp")
    asked = parser.parse_args()
    if not asked.wall:
        time.perf_counter = time.process_time
    warm_up()
    over, rows = 0, []
    with tempfile.TemporaryDirectory() as folder:
        for name, (scene, more) in cases(Path(folder)).items():
            if asked.only not in name:
                continue
            plan(scene, planner=asked.planner, options=PlanOptions(timeout=1e-6, **more))
            times, ends = [], []
            for budget in asked.seconds:
                began = time.perf_counter()
                options = PlanOptions(timeout=budget, **more)
                made = plan(scene, planner=asked.planner, options=options)
                took = time.perf_counter() - began
                late = took > TENTH * budget
                over += late
                row = f"{name:32s} budget {budget:5.2f} s  took {took:6.3f} s  {made.status}"
                print(row + late * "  LATE", flush=True)
                times.append(f"{took:.2f}")
                ends.append(str(made.status))
            rows.append(" | ".join(["", name, *times, ", then ".join(dict.fromkeys(ends)), ""]))
    print(f"late: {over}\n")
    heads = " | ".join(f"took, of {budget:g} s" for budget in asked.seconds)
    print(f"| scene | {heads} | ends as |\n|---|{'---|' * len(asked.seconds)}---|")
    print("\n".join(row.strip() for row in rows))


if __name__ == "__main__":
    main()
