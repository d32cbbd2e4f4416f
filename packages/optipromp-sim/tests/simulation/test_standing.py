"""Crops that stand, and long fruits: what is promised is picked."""

import numpy as np
from tests.simulation.bench import clean

from optipromp.core.geometry import Capsule, Sphere
from optipromp.core.planning import plan
from optipromp.core.planning.task import robot_of
from optipromp.core.scenes import Approach, Scene, SceneObject, Stem, ToolSpec
from optipromp_sim.simulation import Cause, simulate


def mushroom(**tool: float) -> Scene:
    """A mushroom with nothing near, taken from above."""
    top = np.array([0.45, 0.0, 0.2])
    cap = SceneObject(
        "cap", "target", Sphere(0.022), top, stem=Stem(np.array([top, top - [0.0, 0.0, 0.04]]))
    )
    spec = ToolSpec("suction", {"radius": 0.015, **tool})
    down = Approach(direction=np.array([0.0, 0.0, -1.0]))
    return Scene("mushroom", "panda", (cap,), tool=spec, approach=down)


def test_a_suction_cup_presses_a_mushroom_softly() -> None:
    for stiffness, stroke in ((1000.0, 0.002), (10000.0, 0.0005)):
        scene = mushroom(stiffness=stiffness)
        assert robot_of(scene).tool.fruit == 0.022 - stroke
        run = clean(plan(scene))
        assert run.outcome.peak_force["cap"] < 5.0
        assert run.outcome.displacement["cap"] < 0.002


def test_a_cup_that_would_press_too_hard_is_refused() -> None:
    made = plan(mushroom(fruit=0.008))  # 14 mm, 14 N
    assert made.status == "HARM_PREDICTED"
    assert "cap is pressed by 14.0 N at the lip (bears 5" in made.message
    assert plan(mushroom(fruit=0.018)).success  # 4 N


def cucumber(*others: tuple[float, float, float]) -> Scene:
    """A cucumber among young ones at places relative to it, taken from the side by fingers."""
    middle, objects = np.array([0.51, 0.0, 0.41]), []
    for k, place in enumerate([(0.0, 0.0, 0.0), *others]):
        at, (radius, length) = middle + place, (0.012, 0.08) if k else (0.019, 0.14)
        stem = Stem(np.array([at, at + [0.0, 0.0, 0.14]]))
        role = "pushable" if k else "target"
        name = f"young{k}" if k else "ripe"
        objects.append(SceneObject(name, role, Capsule(radius, length), at, stem=stem))
    tool = ToolSpec("finger_gripper", {"opening": 0.06, "finger_length": 0.06, "palm_length": 0.05})
    side = Approach(direction=np.array([1.0, 0.0, 0.0]), cone=0.0)
    return Scene("cucumber", "panda", tuple(objects), tool=tool, approach=side)


def test_a_cucumber_is_picked_between_the_fingers() -> None:
    clean(plan(cucumber((-0.03, 0.09, 0.01), (0.0, -0.08, 0.0))))


def test_a_young_one_between_the_fingers_is_swallowed_by_both() -> None:
    """Its centre is above the fingers; it crosses them with the ripe one's."""
    alone = plan(cucumber())
    scene = cucumber((-0.035, 0.004, 0.03))
    run = simulate(alone.trajectory, scene, robot=alone.robot)
    assert run.outcome.cause is Cause.SWALLOWED_OTHER
    assert run.outcome.swallowed_others == ("young1",)
    assert not plan(scene).success
