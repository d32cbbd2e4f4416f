"""Goals at which the hand touches what it is about to grasp: refused, and reached with `may_touch`.

MotionBenchMaker's goals are of this kind, but its files are not at hand: these are our own laid
tables (benchmarks/furniture.py). The hand comes down round a thing on the table and overlaps it; it
keeps 10 mm from all others. tests/test_benchmarks_suite.py plans one as it is, and with the pair.
"""

import numpy as np

from benchmarks.furniture import CLEARANCE, POSE_STARTS, THICK, TILT
from optipromp.core.arrays import FloatArray
from optipromp.core.geometry import distances
from optipromp.core.planning.task import posed
from optipromp.core.robots import ik
from optipromp.core.scenes.scene import Scene, obstacles_of

DEEPEST = 0.05  # [m] of the tool point below the top of a thing, at most: a choice
TRIES = 40  # poses of the hand on a table


def touching(scene: Scene, seed: int) -> tuple[FloatArray, str] | None:
    """A goal (n,) at which the tool overlaps one thing alone, and that thing; None: none found."""
    robot, _ = posed(scene)
    rng = np.random.default_rng(seed)
    things = [item for item in scene.objects if item.id.startswith("thing")]
    board = next(item.position[2] for item in scene.objects if item.id == "table") + 0.5 * THICK
    hand = robot.spheres.link == robot.link_names.index("tool")
    for _ in range(TRIES):
        thing = things[int(rng.integers(len(things)))]
        half = thing.position[2] - board
        point = thing.position + [0.0, 0.0, half - rng.uniform(0.0, DEEPEST)]
        axis = np.array([0.0, 0.0, -1.0]) + np.tan(TILT) * rng.uniform(-1.0, 1.0, 3)
        axis /= np.linalg.norm(axis)
        found = ik.solve(robot, point, axis, starts=POSE_STARTS, seed=seed).joints
        if not len(found):
            continue
        q = np.array(found[int(rng.integers(len(found)))])
        q[-1] = rng.uniform(robot.lower[-1], robot.upper[-1])
        if robot.self_gaps(q[None]).min(initial=0.0) < 0.0:
            continue
        away, _ = distances(obstacles_of(scene, "static"), robot.sphere_centers(q[None])[0])
        room = away - np.asarray(robot.spheres.radius)[:, None]
        mine = np.array([item.id == thing.id for item in scene.static])
        if room[:, ~mine].min() < CLEARANCE or room[np.ix_(~hand, mine)].min() < CLEARANCE:
            continue
        if room[np.ix_(hand, mine)].min() < 0.0:
            return q, thing.id
    return None
