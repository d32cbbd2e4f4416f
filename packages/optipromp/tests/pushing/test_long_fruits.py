"""Long fruits in the push model: capsules along their stems, as two balls."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pushing.fruits import CUP, DT, NOTHING, TARGET, UP, along, hung, led

from optipromp.core.arrays import frame_along
from optipromp.core.geometry import (
    Box,
    Capsule,
    Cone,
    Ellipsoid,
    MeshShape,
    PointCloudShape,
    Shape,
    Sphere,
)
from optipromp.core.geometry.obstacles import pack
from optipromp.core.geometry.shapes import Primitive, outlines
from optipromp.core.planning import plan
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems import swinging
from optipromp.core.pushing.stems.bending import hanging_balls
from optipromp.core.pushing.stems.cup import cup_distance
from optipromp.core.pushing.stems.hanging import Hanging
from optipromp.core.robots.tools import Cup
from optipromp.core.scenes import Scene, SceneObject, Stem
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

LONG = 0.012  # [m] between the balls


def test_a_fruit_that_is_hardly_long_moves_as_a_ball() -> None:
    points = along((0.06, 0, -0.1), (0.03, 0, -0.02), (0.0, 0, 0))
    place = ((0, 0, 0), (0.02, 0.0, 0.2)), ((0.02, 0.01, -0.05), (0.0, 0.05, 0.2))
    ball, long = led(hung(*place), points), led(hung(*place, apart=1e-7), points)
    np.testing.assert_allclose(ball[0], long[0], atol=1e-5)


def test_the_upper_ball_is_pressed_where_the_lower_one_is_below_the_cup() -> None:
    """The cup's neck and base pass above the lower ball, and meet the upper one."""
    points = along((0.08, 0, 0.055), (0.02, 0, 0.055))  # the base is 25 mm above the fruit
    vector = (0.0, 0.0, 0.25)
    apart = 0.04
    positions, forces, _ = led(hung(((0, 0, 0), vector), apart=apart), points)
    assert forces[-1, 0] > 0.0
    assert positions[-1, 0, 0] - TARGET[0] < -0.01
    upper = positions[-1, 0] + apart * UP  # nearly: the stem has turned a little
    off = upper - points[-1]
    gap = cup_distance(float(np.hypot(off[0], off[1])), float(off[2]), CUP)[0] - 0.015
    assert gap > -1.5 * forces.max() / PUSH.swing.stiffness - 2e-3


@pytest.mark.parametrize("height", [0.0, LONG])
def test_two_long_fruits_keep_apart_at_either_end(height: float) -> None:
    stems = hung(((0, 0, 0), (0.0, 0.0, 0.2)), ((-0.035, 0, height), (0.0, 0.0, 0.2)), apart=LONG)
    positions, forces, _ = led(stems, along((0.06, 0, 0), (0.0, 0, 0)))
    cores = [positions[-1, i] + np.linspace(0.0, LONG, 20)[:, None] * UP for i in (0, 1)]
    least = np.linalg.norm(cores[0][:, None] - cores[1][None], axis=2).min()
    assert least > 0.03 - 2.0 * forces.max() / PUSH.swing.stiffness - 2e-3
    assert positions[-1, 1, 0] < TARGET[0] - 0.05  # pushed on by the first


def test_a_wall_behind_pinches_the_upper_end() -> None:
    """The wall ends above the lower ball's centre: a ball there would slip below it."""
    wall = pack([(Box((0.02, 1.0, 0.02)), TARGET + [-0.03, 0.0, 0.03], np.eye(3))])
    points = along((0.06, 0, 0), (0.02, 0, 0))
    axes = np.tile(UP, (len(points), 1))
    stems = hung(((0.2, 0, 0), UP), ((0, 0, 0), (0.0, 0.0, 0.2)), apart=0.03)
    free = swinging.led(stems, points, axes, DT, CUP, NOTHING).harm
    held = swinging.led(stems, points, axes, DT, CUP, wall).harm
    assert free.pinched == 0.0
    assert held.pinched > 0.0
    assert held.fruit > 2.0 * free.fruit


def test_the_balls_of_a_capsule_lie_along_its_stem() -> None:
    line = np.array([0.3, 0.1, 0.9]) / np.linalg.norm([0.3, 0.1, 0.9])
    turn = np.append(1.0 + line[2], np.cross([0.0, 0.0, 1.0], line))
    turn /= np.linalg.norm(turn)
    for flipped in (turn, np.array([-turn[1], turn[0], turn[3], -turn[2]])):  # either end up
        fruit = SceneObject(
            "f", "pushable", Capsule(0.015, 0.01), TARGET, flipped,
            Stem(np.array([TARGET + 0.02 * line, TARGET + 0.2 * line])),
        )  # fmt: skip
        own = hanging_balls(fruit)
        np.testing.assert_allclose(own.center, TARGET - 0.005 * line, atol=1e-12)
        assert (own.radius, own.above, own.apart) == (0.015, 0.015, 0.01)


def test_a_cone_is_its_two_balls_and_other_round_shapes_are_fitted() -> None:
    stem = Stem(np.array([TARGET + 0.02 * UP, TARGET + 0.2 * UP]))
    cone = SceneObject("f", "pushable", Cone(0.015, 0.006, 0.02), TARGET, stem=stem)
    own = hanging_balls(cone)
    np.testing.assert_allclose(own.center, TARGET - 0.01 * UP, atol=1e-12)
    assert (own.radius, own.above, own.apart) == (0.006, 0.015, 0.02)
    mesh = hanging_balls(replace(cone, shape=cone.shape.mesh()))
    np.testing.assert_allclose(mesh.center, own.center, atol=1e-3)
    np.testing.assert_allclose(mesh[1:], own[1:], atol=1e-3)
    egg = hanging_balls(replace(cone, shape=Ellipsoid((0.015, 0.015, 0.02))))
    assert egg.radius == pytest.approx(egg.above)
    assert egg.apart + 2.0 * egg.radius == pytest.approx(0.04)  # as long as it
    assert 0.012 < egg.radius < 0.016
    flat = hanging_balls(replace(cone, shape=Ellipsoid((0.02, 0.02, 0.015))))
    assert flat.apart < 0.002  # wider than long: one ball, or nearly


class Own(Shape):
    """A shape of a user, known by its mesh alone."""

    def __init__(self, like: Shape) -> None:
        self.like = like

    def mesh(self, around: int = 24) -> MeshShape:
        return self.like.mesh(around)


class Unhashable(Own):
    """The same, of a class that compares by value and has no hash."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Unhashable) and self.like == other.like


@dataclass(frozen=True)
class Egg(Primitive):
    """The same, of sizes."""

    radii: tuple[float, float, float]

    def mesh(self, around: int = 24) -> MeshShape:
        return Ellipsoid(self.radii).mesh(around)


@pytest.mark.parametrize("kind", [Own, Unhashable, lambda egg: Egg(egg.radii)])
def test_a_shape_of_a_user_hangs_as_its_mesh_does(kind: Callable[[Ellipsoid], Shape]) -> None:
    """It was one ball of 30 mm, where the ellipsoid itself is two of 13.2 mm."""
    egg = Ellipsoid((0.015, 0.015, 0.030))
    line = np.array([0.3, 0.1, 0.9]) / np.linalg.norm([0.3, 0.1, 0.9])
    stem = Stem(np.array([TARGET + 0.03 * line, TARGET + 0.2 * line]))
    built_in = hanging_balls(SceneObject("f", "pushable", egg, TARGET, stem=stem))
    assert built_in.apart > 0.02
    for shape in (kind(egg), egg.mesh()):
        own = hanging_balls(SceneObject("f", "pushable", shape, TARGET, stem=stem))
        np.testing.assert_array_equal(own.center, built_in.center)
        assert own[1:] == built_in[1:]


def test_a_shape_without_a_mesh_and_a_fruit_without_a_stem_are_one_ball() -> None:
    stem = Stem(np.array([TARGET + 0.02 * UP, TARGET + 0.2 * UP]))
    cloud = PointCloudShape(np.array([[0.0, 0.0, 0.02], [0.0, 0.01, 0.0]]), 0.005)
    for fruit in (
        SceneObject("f", "pushable", cloud, TARGET, stem=stem),
        SceneObject("f", "pushable", Ellipsoid((0.015, 0.015, 0.03)), TARGET),
    ):
        np.testing.assert_array_equal(hanging_balls(fruit).center, TARGET)
        assert hanging_balls(fruit)[1:] == (fruit.radius, fruit.radius, 0.0)


def test_the_upper_ball_may_be_larger() -> None:
    """A tool that passes beside the tip of a cone meets its shoulder."""
    points = along((0.08, 0, 0.0), (0.022, 0, 0.0))
    slim = hung(((0, 0, 0), (0.0, 0.0, 0.25)), apart=0.02)
    wide = slim._replace(above=1.6 * slim.radius)
    farther = led(wide, points)[0][-1, 0, 0] - led(slim, points)[0][-1, 0, 0]
    assert farther == pytest.approx(-0.6 * slim.radius[0], abs=1e-3)


def test_a_long_fruit_weighs_what_a_capsule_weighs() -> None:
    (ball,), (long,) = hung(((0, 0, 0), UP)).mass, hung(((0, 0, 0), UP), apart=0.01).mass
    assert long / ball == pytest.approx(1.0 + 0.01 * 0.75 / 0.015)


def test_long_fruits_are_picked_in_the_simulation() -> None:
    picked = 0
    for seed in range(8800, 8804):
        scene = generate("elongated", seed)
        made = plan(scene)
        assert made.prediction is not None
        picked += simulate(made).outcome.success
    assert picked >= 3


def test_fruits_beside_the_target_are_predicted_and_picked_among() -> None:
    picked = 0
    for seed in range(8800, 8804):
        made = plan(generate("tight", seed))
        assert made.prediction is not None, seed
        axis = made.scene.frame[2]
        last = made.trajectory.positions[made.first :]
        points = made.robot.tool_pose(last)[0] - made.robot.tool_pose(last[-1])[0]
        aside = points - np.outer(points @ axis, axis)
        near = points @ axis > -0.03  # the last 30 mm, in which the rim passes the fruits
        assert np.linalg.norm(aside[near], axis=1).max() < 0.01
        picked += simulate(made).outcome.success
    assert picked >= 3


def test_a_lone_target_is_reached_along_the_axis() -> None:
    scene = generate("tight", 8800)
    assert scene.target is not None
    up = np.array([0.0, 0.0, 0.4])
    far = (replace(o, position=o.position + up, stem=None) for o in scene.pushables)
    lone = replace(scene, objects=(scene.target, *far))
    for width, picked in ((1.0, True), (2.0, False)):
        (ripe,) = (o for o in lone.objects if o.role == "target")
        wide = replace(ripe, shape=Sphere(width * ripe.radius))
        made = plan(replace(lone, objects=(wide, *lone.objects[1:])))
        assert made.prediction is not None
        assert made.success == picked, made.message


def leaning(degrees: float, shape: Shape) -> SceneObject:
    """A ripe fruit whose stem and long axis lean by an angle."""
    turn = frame_along(np.array([np.sin(np.deg2rad(degrees)), 0.0, np.cos(np.deg2rad(degrees))]))
    stem = Stem(TARGET + np.outer([0.0, 0.15], turn[:, 2]))
    return SceneObject("ripe", "target", shape, TARGET, turn, stem=stem)


def fitting(target: SceneObject, opening: float, height: float = 0.1) -> Hanging:
    """A model of a cup whose mouth has the inner radius ``opening``."""
    cup = Cup(opening + 0.002, height=height, opening=2.0 * opening)
    camera = TARGET - np.array([0.0, 0.0, 0.25])
    return Hanging(Scene("lean", "panda", (target,)), cup, (), camera, cup.gripper_radius)


@given(
    degrees=st.floats(0.0, 70.0),
    shape=st.sampled_from([Ellipsoid((0.017, 0.017, 0.03)), Cone(0.018, 0.008, 0.02)]),
)
@settings(max_examples=15, deadline=None)
def test_the_harm_rises_as_the_opening_narrows(degrees: float, shape: Shape) -> None:
    target = leaning(degrees, shape)
    wide = float(outlines(shape, UP[None] @ target.rotation)[0][0])
    points = along((0, 0, -0.2), (0, 0, 0))
    axes = np.tile(UP, (len(points), 1))
    mean, harm = [], []
    for room in (0.006, 0.001, 0.0005, 0.0, -0.001, -0.003):
        model = fitting(target, wide + room)
        mean.append(model.least)
        harm.append(model.harm(points, axes, model.states))
    assert mean == sorted(mean)
    assert mean[0] == 0.0
    assert mean[-1] > 0.95
    assert min(harm[-2:]) > 0.8 > 0.6 > harm[0]
    assert all(own >= part - 1e-9 for own, part in zip(harm, mean, strict=True))


def test_a_target_that_reaches_below_the_floor_is_pressed() -> None:
    """A floor lifts a fruit by a millimetre, not by 4; a deeper cup leaves it alone."""
    target = leaning(0.0, Ellipsoid((0.017, 0.017, 0.032)))
    lifted, deeper = fitting(target, 0.025, height=0.05), fitting(target, 0.025, height=0.06)
    assert lifted.least == 1.0
    assert deeper.least == 0.0


def test_the_contacts_of_a_ball_say_what_does_not_fit() -> None:
    assert not fitting(leaning(30.0, Sphere(0.02)), 0.018).least


def test_the_cause_names_a_target_that_does_not_fit() -> None:
    model = fitting(leaning(50.0, Ellipsoid((0.017, 0.017, 0.03))), 0.0235)
    points = along((0, 0, -0.2), (0, 0, 0))
    made = model.predict(points, np.tile(UP, (len(points), 1)))
    assert made.harmful
    assert (made.object, made.cause) == ("ripe", "does not fit into the tool's mouth")
