"""The plant as tracked, and as a push moves it."""

import numpy as np
import pytest

from optipromp.control.plant import MOVED, pushed_by
from optipromp.control.servo import Route
from optipromp.core.planning import plan
from optipromp.laboratory.generate import generate


def test_a_push_is_told_of_the_fruits_that_it_moves() -> None:
    """The target, which the tool does not touch, counts as free: its rest may be learnt."""
    made = plan(generate("cluster", 101))
    route = Route.of(made)
    assert pushed_by(route, route.approach) == {}
    whole = pushed_by(route, route.duration)
    assert whole
    target = made.scene.target
    assert target.id not in whole
    assert all(np.linalg.norm(by) > MOVED for by in whole.values())
    model = made.push_model
    found = model.moved(route.points[made.first :], route.axes[made.first :])
    places = dict(zip(found.ids, found.positions, strict=True))
    for item in made.scene.objects:
        if item.id in whole:
            assert whole[item.id] == pytest.approx(places[item.id] - item.position, abs=2e-3)
    half = pushed_by(route, 0.5 * (route.approach + route.duration))
    assert set(half) <= {item.id for item in made.scene.pushables}
    back = Route.back(made.robot, made.trajectory, made.scene)
    assert pushed_by(back, route.duration) == {}
