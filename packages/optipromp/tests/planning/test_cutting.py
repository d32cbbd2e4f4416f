"""Where a scissor cuts: on the target's stem, a distance above the fruit."""

from dataclasses import replace

import numpy as np
import pytest
from tests.robots.builders import INNER

from optipromp.core.geometry.shapes import Box
from optipromp.core.planning.task import aimed_at_stem
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots import Cup, Mounted, Scissor, Solid
from optipromp.core.robots.mounted import Load
from optipromp.core.scenes import Scene, Stem
from optipromp_sim.generate import generate

BLADES = Scissor(0.06, blade_length=0.09, depth=0.008)
BOX = Load("box", (Solid("box", Box((0.02, 0.02, 0.02)), np.array([0.0, 0.05, -0.1])),))


def hanging(points: np.ndarray | None = None) -> Scene:
    """One fruit that hangs, with a stem through ``points`` (k, 3) from its centre [m]."""
    scene = generate("limp", 3)
    fruit = scene.target
    stem = Stem.along(fruit.position, scene.up, 0.15)
    if points is not None:
        stem = Stem(fruit.position + points)
    return replace(scene, objects=(replace(fruit, stem=stem),))


@pytest.mark.parametrize(
    "tool", [BLADES, Mounted(BLADES), Mounted(BLADES, loads=(BOX,)), Scissor(0.06, cut=0.03)]
)
def test_the_approach_ends_on_the_stem_a_cut_above_the_fruit(tool: Scissor | Mounted) -> None:
    scene = hanging()
    found = aimed_at_stem(scene, tool)
    cut = 0.03 if tool == Scissor(0.06, cut=0.03) else 0.02
    assert found.approach.shift == pytest.approx((scene.target.radius + cut) * scene.up, abs=1e-3)
    assert (found.approach.cone, found.approach.aside) == (0.0, 0.0)
    assert found.aim == pytest.approx(scene.target.position + found.approach.shift)


def test_a_bent_stem_is_cut_where_it_is() -> None:
    points = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.025], [0.1, 0.0, 0.025], [0.1, 0.0, 0.2]])
    found = aimed_at_stem(hanging(points), BLADES).approach.shift
    assert found[2] == pytest.approx(0.025, abs=1e-6)
    assert 0.02 < found[0] < 0.05


def test_a_short_stem_is_cut_half_way() -> None:
    short = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.04]])
    scene = hanging(short)
    long = aimed_at_stem(hanging(), Scissor(0.06, cut=1e-6)).approach.shift[2]
    found = aimed_at_stem(scene, BLADES).approach.shift[2]
    assert found == pytest.approx(0.5 * (long + 0.04), abs=1e-3)


def test_what_a_scene_states_stays() -> None:
    scene = hanging()
    stated = replace(scene, approach=replace(scene.approach, shift=np.array([0.0, 0.0, 0.05])))
    assert aimed_at_stem(stated, BLADES) is stated
    tilted = replace(scene, approach=replace(scene.approach, cone=10.0, aside=0.01))
    approach = aimed_at_stem(tilted, BLADES).approach
    assert (approach.cone, approach.aside) == (10.0, 0.01)
    assert aimed_at_stem(scene, Cup(0.03)) is scene
    bare = replace(scene, objects=(replace(scene.target, stem=None),))
    assert aimed_at_stem(bare, BLADES) is bare


@pytest.mark.parametrize(
    ("aside", "missed"),
    [((0, 0), False), ((0, 0.015), False), ((0.015, 0), True), ((0, 0.04), True)],
)
def test_the_push_model_tells_whether_the_stem_ends_between_the_blades(aside, missed):
    """The blades are narrow along x_g and open along y_g."""
    scene = aimed_at_stem(hanging(), BLADES)
    x_g, y_g, z_g = scene.frame
    model = Hanging(scene, BLADES, (), scene.aim - 0.15 * z_g, INNER)
    end = scene.aim + aside[0] * x_g + aside[1] * y_g
    points = end + np.linspace(-0.15, 0.0, 60)[:, None] * z_g
    axes = np.tile(z_g, (60, 1))
    assert model.led(0, points, axes).harm.missed is missed
    below = points - 0.02 * z_g
    assert model.led(0, below, axes).harm.missed
