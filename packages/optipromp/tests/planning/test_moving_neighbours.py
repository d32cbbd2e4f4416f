"""Avoid objects and pushables that move: plans in time, which the simulation confirms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cli.fixtures import told
from tests.judging.builders import gap

import optipromp
from optipromp.core.errors import Code, InvalidRequestError, InvalidSceneError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning import Plan, PlanOptions, plan_pick
from optipromp.core.scenes import Scene, SceneObject, save_scene
from optipromp.core.scenes.held import Place
from optipromp.core.scenes.objects import ObjectMotion
from optipromp_loop.control.controller import Controller
from optipromp_sim.simulation.export import mjcf
from optipromp_sim.simulation.simulation import Simulation

OUT = np.array([0.5, 0.35, 0.0])  # [m] away from the arm's base
KNOWN = optipromp.load_scene("scenario-3")


def led(scene: Scene, name: str, by: list[float], until: float) -> Scene:
    """The scene in which an object moves by (3,) [m] from time 0 until a time [s]."""
    objects = []
    for item in scene.objects:
        if item.id == name:
            places = np.array([item.position, item.position + by])
            item = replace(item, motion=ObjectMotion(np.array([0.0, until]), places))
        objects.append(item)
    return replace(scene, name="led", objects=tuple(objects))


@pytest.fixture(scope="module")
def usual() -> Plan:
    return optipromp.plan(KNOWN)


def test_the_arm_keeps_off_an_avoid_object_that_crosses_its_way(bare: Scene) -> None:
    direct = optipromp.plan(bare, options=PlanOptions(duration=2.0))
    arm = ~np.asarray(direct.robot.spheres.distal)  # B_d
    spheres = direct.robot.sphere_centers(direct.trajectory.at(1.0).q[None])[0][arm]
    there = spheres[np.argmax(np.linalg.norm(spheres[:, :2], axis=1))]
    motion = ObjectMotion(np.array([0.0, 1.0, 2.0]), np.array([there + OUT, there, there + OUT]))
    ball = SceneObject("ball", "avoid", Sphere(0.06), there + OUT, motion=motion)
    scene = replace(bare, objects=(ball,))
    assert gap(direct.robot, direct.trajectory, ball, arm) < -0.03
    assert [c.other for c in optipromp.judge(scene, direct.trajectory).judgement.contacts] == [
        "ball"
    ]
    hit = optipromp.simulate(direct.trajectory, scene, robot=direct.robot)
    assert {c.other for c in hit.outcome.avoid_contacts} == {"ball"}
    made = optipromp.plan(scene)
    assert made.success, made.message
    room = gap(made.robot, made.trajectory, ball, arm)
    assert room > 0.0
    assert made.metrics.clearance_avoid == pytest.approx(room, abs=5e-3)
    run = optipromp.simulate(made)
    assert run.success, run.outcome.message
    assert not run.outcome.avoid_contacts


@pytest.mark.parametrize(("by", "until"), [(0.03, 3.0), (-0.04, 6.0)])
def test_a_pushable_is_taken_where_it_will_be(usual: Plan, by: float, until: float) -> None:
    scene = led(KNOWN, "n1", [0.0, by, 0.0], until)
    made = optipromp.plan(scene)
    assert made.success, made.message
    assert made.scene.objects == scene.objects
    assert made.prediction.harm <= made.prediction.threshold
    run = optipromp.simulate(made)
    assert run.success, run.outcome.message
    passed, before = made.metrics.passage["n1"], usual.metrics.passage["n1"]
    assert np.abs(np.subtract(passed, before)).max() > 0.005  # another way past it


def test_a_push_that_the_motion_makes_harmful_is_no_success(usual: Plan) -> None:
    """The way past the fruit that stood presses its stem where its root comes to meet it."""
    scene = led(KNOWN, "n1", [0.0, 0.03, 0.0], 3.0)
    assert usual.success
    found = optipromp.judge(scene, usual.trajectory, robot=usual.robot)
    assert found.status is Code.HARM_PREDICTED
    assert found.prediction.harm > 2.0 * usual.prediction.harm


@settings(max_examples=5, deadline=None)
@given(st.floats(0.1, 20.0), st.sampled_from(["n1", "n2", "left"]), st.integers(2, 4))
def test_a_motion_of_no_length_is_none(end: float, name: str, count: int) -> None:
    """To the bit: plan, prediction, figures."""
    item = next(one for one in KNOWN.objects if one.id == name)
    still = ObjectMotion(np.linspace(0.0, end, count), np.tile(item.position, (count, 1)))
    objects = tuple(replace(o, motion=still) if o is item else o for o in KNOWN.objects)
    made, plain = (optipromp.plan(one) for one in (replace(KNOWN, objects=objects), KNOWN))
    assert made.message == plain.message
    np.testing.assert_array_equal(made.trajectory.positions, plain.trajectory.positions)
    np.testing.assert_array_equal(made.trajectory.times, plain.trajectory.times)
    assert made.metrics.to_dict() == plain.metrics.to_dict()
    assert repr(made.prediction) == repr(plain.prediction)


def test_in_the_simulation_the_root_is_led_and_the_fruit_follows() -> None:
    scene = led(KNOWN, "n1", [0.0, 0.04, 0.0], 2.0)
    run = Simulation(scene)
    assert [root.course is not None for root in run.world.roots] == [True]
    row = run.fruits().ids.index("n1")
    begin = run.fruits().positions[row]
    for _ in range(round(3.0 / run.tick)):
        run.step(run.reference)
    ends = run.fruits()
    assert ends.positions[row] - begin == pytest.approx([0.0, 0.04, 0.0], abs=0.005)
    assert ends.attached[row]
    before = next(o for o in scene.objects if o.id == "n1").stem
    assert ends.stem_ends[row][0] - before.root == pytest.approx([0.0, 0.04, 0.0], abs=1e-4)


def test_what_knows_no_motion_refuses_it() -> None:
    scene = led(KNOWN, "n1", [0.0, 0.03, 0.0], 3.0)
    place = Place(np.array([0.4, 0.3, 0.5]), np.array([0.0, 0.0, 1.0]))
    with pytest.raises(InvalidRequestError, match="n1 move: the legs of a pick know no motion"):
        plan_pick(replace(scene, place=place))
    with pytest.raises(InvalidRequestError, match="left move: a closed loop follows fruits alone"):
        Controller(led(KNOWN, "left", [0.0, 0.03, 0.0], 3.0))
    with pytest.raises(InvalidSceneError, match="--closed-loop"):
        led(KNOWN, "ripe", [0.0, 0.03, 0.0], 3.0)


def test_neighbours_that_move_in_files(tmp_path: Path) -> None:
    """Written, checked, planned, judged again, simulated and exported."""
    scene = led(led(KNOWN, "n1", [0.0, 0.03, 0.0], 3.0), "left", [0.0, 0.05, 0.0], 2.0)
    path, out = tmp_path / "led.yaml", tmp_path / "plan"
    save_scene(scene, path)
    assert told("check", path)["moving"] == ["n1", "left"]
    made = optipromp.plan(optipromp.load_scene(path))
    optipromp.write_plan(made, out)
    assert optipromp.load_plan(out).status is made.status
    assert optipromp.simulate(made).success
    text = mjcf(scene, made.robot, made.task.start)
    assert 'name="avoid:left" mocap="true"' in text
    assert "root:n1" not in text  # it hangs on a root that stands
