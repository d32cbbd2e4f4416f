"""The planners without optimisation: ProMP (scenario I) and I-ProMP (scenario II)."""

import functools
import time

import numpy as np

from optipromp.arrays import FloatArray, frozen
from optipromp.planning import joint
from optipromp.planning.build import Knots
from optipromp.planning.options import Planner, PlanOptions
from optipromp.planning.primitives import led_through, on_branch, via_points
from optipromp.planning.setup import Setup
from optipromp.planning.stages import Outcome
from optipromp.planning.starts import LEVER_ARM
from optipromp.promp.model import ProMP
from optipromp.pushing.interactive import pushes
from optipromp.pushing.neighbours import detection_variance

CAMERA_PHASE = 0.5
KNOTS = 150


def knots_without_vias(count: int) -> Knots:
    """Knots of a motion that nothing divides."""
    return Knots(count, CAMERA_PHASE)


@functools.lru_cache(maxsize=8)
def end(promp: ProMP) -> FloatArray:
    """Where the mean of a ProMP ends (n,)."""
    return frozen(promp.mean_trajectory(np.array([1.0]))[0])


def plan_movement(
    setup: Setup,
    promp: ProMP,
    options: PlanOptions,
    goals: FloatArray,
    planner: Planner,
    seed: int,
) -> Outcome:
    """Condition the ProMP on the planner's points, on the branch nearest to the ProMP's own end.

    ``promp`` passes start, camera point (unless the scene or the options leave it out) and target;
    ``i-promp`` also each neighbour's pose and pushed pose, at evenly spaced phases. The arm pauses
    at the camera point, to look.
    """
    began = time.perf_counter()
    goal = goals[int(np.argmin(np.linalg.norm(goals - end(promp), axis=1)))]
    phase = options.camera_phase or CAMERA_PHASE
    camera = options.camera_point
    if camera is None:
        camera = setup.scene.options.get("camera_point", True)
    branch: FloatArray | None = None
    if setup.goal_joints is None and (planner == "i-promp" or camera):
        positions: list[FloatArray] = []
        variances: list[float] = []
        if planner == "i-promp":
            deviation = options.direction_deviation
            rng = np.random.default_rng(seed) if deviation > 0.0 else None
            things = setup.neighbours
            for push, thing in zip(
                pushes(setup.scene, things, setup.robot.gripper_radius, rng, deviation),
                things,
                strict=True,
            ):
                positions += [push.position, push.pushed]
                variances += [detection_variance(thing)] * 2
        via = via_points(setup, positions, phase, options.via_deviation)
        branch = on_branch(setup, via, goal)
    knots = Knots(options.knots or KNOTS, phase)
    if branch is None:
        last, exact = np.array([1.0]), np.zeros(1)
        q = led_through(promp, setup.start, last, goal[None], exact, knots.count)
    else:
        spread = (via.deviations / LEVER_ARM) ** 2
        spread[1:-1] += np.array(variances) / LEVER_ARM**2
        q = led_through(promp, setup.start, via.phases, branch, spread, knots.count, phase)
        q[-1] = goal
    trajectory = joint.trajectory_of(setup, options, q, knots.first)
    return Outcome(trajectory, trajectory, knots, (), True, {planner: time.perf_counter() - began})
