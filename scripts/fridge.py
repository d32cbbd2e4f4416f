"""An xArm7 reaches a bottle behind two cups in a fridge: how long, and how hard.

    python scripts/fridge.py FOLDER

FOLDER is ``share/example-robot-data/robots`` of the package example-robot-data (extra ``models``).
The plan is slow only where something is near or is pushed. Beside it stands the same path at the
speed of a push throughout. Both are executed in the simulation.
"""

import argparse
from pathlib import Path

import numpy as np

from optipromp.core.geometry import Box, Cylinder
from optipromp.core.planning import plan
from optipromp.core.planning.timing import shortest
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes import Approach, Scene, SceneObject, ToolSpec
from optipromp_sim.simulation import Run, simulate

FRONT, BACK, BOARD, WIDTH, ROOM, WALL = 0.52, 0.85, 0.40, 0.50, 0.36, 0.02  # [m] choices


def fridge(robot: str | Path) -> Scene:
    """A shelf of a fridge with an open door: a bottle behind two cups."""
    middle, deep = 0.5 * (FRONT + BACK), BACK - FRONT

    def wall(name: str, size: tuple[float, float, float], *at: float) -> SceneObject:
        return SceneObject(name, "static", Box(size), np.array(at))

    def stood(name: str, role: str, radius: float, tall: float, x: float, y: float) -> SceneObject:
        at = np.array([x, y, BOARD + 0.5 * tall])
        return SceneObject(name, role, Cylinder(radius, tall), at)  # type: ignore[arg-type]

    objects = (
        stood("bottle", "target", 0.032, 0.22, 0.70, 0.02),
        stood("cup1", "pushable", 0.038, 0.10, 0.60, -0.03),
        stood("cup2", "pushable", 0.038, 0.10, 0.61, 0.06),
        wall("shelf", (deep, WIDTH, WALL), middle, 0.0, BOARD - 0.5 * WALL),
        wall("ceiling", (deep, WIDTH, WALL), middle, 0.0, BOARD + ROOM + 0.5 * WALL),
        wall("back", (WALL, WIDTH, ROOM), BACK + 0.5 * WALL, 0.0, BOARD + 0.5 * ROOM),
        wall("left", (deep, WALL, ROOM), middle, 0.5 * (WIDTH + WALL), BOARD + 0.5 * ROOM),
        wall("right", (deep, WALL, ROOM), middle, -0.5 * (WIDTH + WALL), BOARD + 0.5 * ROOM),
        wall("door", (WALL, 0.45, 0.9), FRONT - 0.25, 0.62, BOARD),
    )
    level = Approach(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    return Scene(
        name="fridge", robot=robot, tool=ToolSpec("franka_hand"), objects=objects, approach=level
    )


def told(name: str, run: Run) -> str:
    """A line of the answer."""
    outcome = run.outcome
    forces = ", ".join(f"{id_} {force:.1f} N" for id_, force in outcome.peak_force.items())
    return (
        f"{name}: {outcome.duration:.1f} s, {'picked' if run.success else outcome.cause}, {forces}"
    )


def main() -> None:
    """Plan, execute both, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    scene = fridge(parser.parse_args().folder / "xarm_description" / "urdf" / "xarm7.urdf")
    made = plan(scene)
    print(f"plan: {made.status}, {made.message}")
    even = shortest(made.robot, made.trajectory.positions, made.first, PUSH.standing.speed)
    print(told("slow only near", simulate(made)))
    print(told("slow throughout", simulate(even, made.scene, robot=made.robot)))


if __name__ == "__main__":
    main()
