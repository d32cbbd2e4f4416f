"""A camera in the running simulation."""

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.trajectory import State
from optipromp_eyes import DepthPicture, look_at
from optipromp_sim.generate import generate
from optipromp_sim.simulation import DisturbanceParameters, LiveCamera, Simulation
from optipromp_sim.simulation.parameters import SimulationParameters


def front_of(picture: DepthPicture, place: np.ndarray) -> float:
    """Measured depth where a place (3,) in the base is in the picture, less that of the place."""
    local = picture.camera.pose.inverse() @ place
    column, row = np.rint(picture.camera.pixels(local)).astype(int)
    near = picture.depth[row - 2 : row + 3, column - 2 : column + 3]
    return float(np.median(near[near > 0.0]) - local[2])


def test_it_shows_the_fruits_where_they_are_now() -> None:
    scene = generate("cluster", 3)
    sway = SimulationParameters(disturbance=DisturbanceParameters(sway=0.02))
    simulation = Simulation(scene, parameters=sway)
    reference = simulation.state()
    with LiveCamera(simulation, "beside", seed=61302) as camera:
        places = []
        for _ in range(2):
            fruits, picture = simulation.fruits(), camera.take()
            target = fruits.positions[fruits.roles.index("target")]
            assert -0.03 < front_of(picture, target) < -0.005  # the front of a fruit
            ripe = [d for d in look_at(picture).look.in_base() if d.role == "target"]
            assert min(np.linalg.norm(d.position - target) for d in ripe) < 0.01
            places.append(target)
            for _ in range(round(3.3 / simulation.tick)):
                simulation.step(State(reference.q))
        assert np.linalg.norm(places[1] - places[0]) > 0.008  # it moved, and was found there


def test_a_camera_in_the_palm_goes_with_the_arm() -> None:
    simulation = Simulation(generate("cluster", 3))
    with LiveCamera(simulation, "palm") as camera:
        begin = camera.take().camera.pose
        point, axis = simulation.robot.tool_pose(simulation.state().q)
        assert np.allclose(begin.rotation[:, 2], axis, atol=1e-6)
        moved = simulation.state().q + 0.001
        for _ in range(round(0.2 / simulation.tick)):
            simulation.step(State(moved))
        away = simulation.robot.tool_pose(simulation.state().q)[0] - point
        assert np.linalg.norm(away) > 2e-4
        assert np.linalg.norm(camera.camera.pose.position - begin.position - away) < 1e-3
    with LiveCamera(simulation, "hand") as other:  # a second one, of the same simulation
        assert other.take().depth.max() > 0.1
    with pytest.raises(InvalidRequestError, match="mount is 'roof': valid are palm, hand, beside"):
        LiveCamera(simulation, "roof")
