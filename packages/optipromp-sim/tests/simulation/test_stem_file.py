"""The fruit on its stem as MJCF, in plain MuJoCo, against beams and the push model."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from tests.simulation.one_stem import loaded, tracked

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import Sphere
from optipromp.core.pushing.stems import bending
from optipromp.core.scenes import SceneObject, Stem
from optipromp_sim.simulation import stem_mjcf

LENGTH, MASS, STIFFNESS = 0.15, 0.02, 2e-3  # [m] [kg] [N m²]


def berry(direction=(0.0, 0.0, 1.0), stiffness=STIFFNESS, length=LENGTH, radius=0.01):
    at = np.array([0.1, 0.2, 0.5])
    stem = Stem.along(at, np.array(direction), length)
    physical = {"mass": MASS, "stem_stiffness": stiffness}
    return SceneObject("b", "pushable", Sphere(radius), at, stem=stem, physical=physical)


@pytest.mark.parametrize("direction", [(0, 0, 1.0), (0.3, 0, 1.0), (0, -1.0, 0.4)])
def test_it_hangs_where_the_fruit_hangs(direction):
    fruit = berry(direction)
    model, data = loaded(fruit)
    np.testing.assert_allclose(data.body("fruit:b").xpos, fruit.position, atol=1e-6)
    np.testing.assert_allclose(tracked(model, data, 2.0)[-1], fruit.position, atol=1e-3)
    assert model.nkey == (direction != (0, 0, 1.0))
    assert model.body("fruit:b").mass[0] == pytest.approx(MASS)


@pytest.mark.parametrize("stiffness", [1e-3, 2e-3, 5e-3])
def test_it_bends_as_in_the_push_model(stiffness):
    fruit, force = berry(stiffness=stiffness), 0.05
    model, data = loaded(fruit)
    aside = tracked(model, data, 4.0, (force, 0.0, 0.0))[-1] - fruit.position
    beam = bending.stems([fruit])
    assert aside[0] == pytest.approx(force * beam.compliance[0, -1, -1], rel=0.08)
    assert abs(aside[1]) < 1e-4


def test_it_joins_a_model_of_the_user():
    own = mujoco.MjSpec.from_string(
        "<mujoco><option timestep='0.001' integrator='discrete'/>"
        "<worldbody><body name='arm'/></worldbody></mujoco>"
    )
    for k in range(2):
        frame = own.worldbody.add_frame(pos=[0.0, 0.3 * k, 0.0])
        own.attach(mujoco.MjSpec.from_string(stem_mjcf(berry())), prefix=f"{k}/", frame=frame)
    model = own.compile()
    assert model.body("1/fruit:b").id > model.body("0/fruit:b").id > 0
    assert model.neq == 2


def test_what_hangs_on_no_stem_of_its_own_is_refused():
    with pytest.raises(InvalidSceneError, match="'b' has no stem"):
        stem_mjcf(replace(berry(), stem=None))
    grown = replace(berry(), stem=replace(berry().stem, parent="other"))
    with pytest.raises(InvalidSceneError, match="grows from another"):
        stem_mjcf(grown)
    with pytest.raises(InvalidSceneError, match="up"):
        stem_mjcf(berry(), up=np.zeros(3))
