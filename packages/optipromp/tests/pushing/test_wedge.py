"""A cup's floor that comes down on a fruit: the law of the wedge against the simulation."""

import math
from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.planning.task import resolve
from optipromp.core.planning.timing import shortest
from optipromp.core.pushing.stems.cup import wedged
from optipromp.core.robots import ik
from optipromp.core.scenes import scene_from_dict

RADIUS, MASS, STEM = 0.016, 0.016, 0.15  # [m], [kg], [m] of the fruit and its plumb stem
CUP = 0.025  # [m] radius
ABOVE, DOWN = 0.03, 0.08  # [m] of the floor over the fruit's centre at first; by which it comes


def law(aside: float, speed: float, friction: float) -> float:
    """The pull on a fruit whose centre is ``aside`` of the cup's axis [m], at the rim's outside."""
    across = (aside - CUP) / RADIUS
    along = math.sqrt(1.0 - across**2)
    return float(wedged(MASS, along, speed * along, friction))


def simulated(aside: float, speed: float, friction: float) -> float:
    """The largest pull on the fruit's stem as the cup comes down at a speed [m/s] [N]."""
    from optipromp_sim.simulation import SimulationParameters
    from optipromp_sim.simulation.simulation import Simulation

    place = np.array([0.45, 0.0, 0.75])
    hangs = {
        "id": "n", "role": "pushable", "shape": {"sphere": {"radius": RADIUS}},
        "position": place.tolist(), "physical": {"mass": MASS},
        "stem": {"root": [*place[:2], place[2] + RADIUS + STEM]},
    }  # fmt: skip
    ripe = {"id": "ripe", "role": "target", "shape": {"sphere": {"radius": 0.015}},
            "position": [0.3, 0.35, 0.9], "stem": {"root": [0.3, 0.35, 1.05]}}  # fmt: skip
    scene = scene_from_dict({
        "format": 1, "name": "wedge", "robot": "panda", "objects": [ripe, hangs],
        "tool": {"kind": "cup", "radius": CUP, "height": 0.05, "length": 0.1},
    })  # fmt: skip
    robot = resolve(scene).robot
    floor = robot.tool.front - robot.tool.reach  # over the tool point
    begin = place + np.array([aside, 0.0, ABOVE - floor])
    points = begin - np.linspace(0.0, DOWN, 41)[:, None] * np.array([0.0, 0.0, 1.0])
    rng = np.random.default_rng(0)
    for _ in range(50):
        near = rng.uniform(robot.lower, robot.upper)
        q, errors = ik.track(robot, points, np.tile([0.0, 0.0, 1.0], (41, 1)), near)
        if errors.max() < 1e-4:
            break
    usual = SimulationParameters()
    parameters = replace(
        usual,
        robot=replace(usual.robot, tool_friction=friction),
        fruit=replace(usual.fruit, friction=friction),
    )
    run = Simulation(scene, 0, parameters, robot=robot, q=q[0])
    _, outcome = run.follow(shortest(robot, q, 0, speed))
    return outcome.stem_tension["n"]


@pytest.mark.parametrize("friction", [0.0, 0.2, 0.35])
@pytest.mark.parametrize("speed", [0.03, 0.1, 0.15])
def test_the_law_of_the_wedge_tells_the_pull_that_is_simulated(speed, friction):
    """Nothing is fitted: the stiffness is that of the push model's contacts."""
    assert law(0.037, speed, friction) == pytest.approx(simulated(0.037, speed, friction), rel=0.3)


def test_a_fruit_jams_within_the_cone_of_friction_and_comes_free_beside_it() -> None:
    edge = CUP + RADIUS * math.sin(math.atan(0.35))
    assert law(edge - 1e-6, 0.03, 0.35) == math.inf
    assert law(edge + 1e-3, 0.03, 0.35) < math.inf
    assert simulated(0.028, 0.1, 0.35) > 5.0  # [N] it is torn off
    assert law(0.028, 0.1, 0.35) == math.inf
    free = simulated(0.037, 0.1, 0.35)  # after a step aside of 9 mm
    assert free < 1.5
    assert law(0.037, 0.1, 0.35) < 1.5


def test_the_blow_goes_with_the_speed_and_rises_towards_the_jam() -> None:
    blows = [law(0.034, speed, 0.2) - MASS * 9.81 for speed in (0.02, 0.04, 0.08)]
    assert blows[1] == pytest.approx(2.0 * blows[0])
    assert blows[2] == pytest.approx(4.0 * blows[0])
    pulls = [law(aside, 0.1, 0.35) for aside in (0.040, 0.037, 0.034, 0.031)]
    assert pulls == sorted(pulls)
