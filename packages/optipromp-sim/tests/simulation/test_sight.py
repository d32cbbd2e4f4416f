"""What a camera sees: in its cone of view, past fruits, walls, leaves and the tool."""

from dataclasses import replace

import numpy as np
import pytest
from tests.simulation.eyes import (
    CAMERA,
    HOME,
    ROBOT,
    WHITE,
    between,
    fruit,
    ids,
    looks,
    seen_by,
    truth,
)

from optipromp.core.arrays import frame_along, rotation
from optipromp.core.geometry.shapes import Box, Sphere
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import SceneObject
from optipromp_sim.simulation.detector import Detector, DetectorParameters
from optipromp_sim.simulation.sight import RAYS, hand_pose

BLIND = DetectorParameters(mount="beside", hidden=1.0)


def test_a_fruit_hides_another():
    behind = fruit("ripe", [0.0, 0.0, 0.5], "target")
    assert ids(looks(seen_by(behind), BLIND)[0]) == {"ripe"}
    assert ids(looks(seen_by(behind, fruit("n1", [0.0, 0.0, 0.4], radius=0.03)), BLIND)[0]) == {
        "n1"
    }
    # where they are now counts, not where the scene has them
    scene = seen_by(behind, fruit("n1", [0.2, 0.0, 0.4], radius=0.03))
    fruits = truth(scene)
    fruits.positions[1] = CAMERA @ np.array([0.0, 0.0, 0.4])
    assert ids(Detector(scene, ROBOT, BLIND).expose(0.0, HOME, fruits)) == {"n1"}


def test_the_half_of_a_fruit_is_hidden_by_a_wall():
    behind = fruit("ripe", [0.0, 0.0, 0.5], "target")
    wall = SceneObject(
        "wall", "static", Box((0.2, 0.2, 0.01)), CAMERA @ np.array([0.1, 0.0, 0.4]),
        CAMERA.rotation,
    )  # fmt: skip
    scene = seen_by(behind, wall)
    detector = Detector(scene, ROBOT, BLIND)
    frame = tool_frame(ROBOT, HOME)
    share = detector._sight.hidden(CAMERA.position, frame, *truth(scene)[1:3])
    assert share == pytest.approx([0.5], abs=2 / RAYS)
    count = sum("ripe" in ids(look) for look in looks(scene, BLIND, 0, 400, 1.0))
    low, high = between(400, 1.0 - share[0])
    assert low <= count <= high


def test_a_fruit_does_not_hide_itself():
    scene = seen_by(*(fruit(f"n{k}", [0.1 * k, 0.0, 0.3], radius=0.004 * (1 + k)) for k in (0, 1)),
                    fruit("ripe", [0.0, 0.1, 0.3], "target", 0.05))  # fmt: skip
    detector = Detector(scene, ROBOT, BLIND)
    share = detector._sight.hidden(CAMERA.position, tool_frame(ROBOT, HOME), *truth(scene)[1:3])
    assert not share.any()


def test_the_tool_hides_what_is_behind_it():
    frame = tool_frame(ROBOT, HOME)
    side = frame.rotation[:, 0]
    behind = frame.position + 0.1 * side
    camera = Pose(frame.position - 0.4 * side, frame_along(side))
    target = SceneObject("ripe", "target", Sphere(0.012), behind)
    scene = seen_by(target, camera=camera)
    assert not looks(scene, BLIND)[0].detections
    moved = HOME.copy()
    moved[0] += 0.5  # [rad]: the tool goes out of the way
    assert ids(Detector(scene, ROBOT, BLIND).expose(0.0, moved, truth(scene))) == {"ripe"}


def test_the_hand_camera_looks_past_its_tool():
    p = DetectorParameters(mount="hand", hidden=1.0)
    frame = tool_frame(ROBOT, HOME)
    ahead = frame @ np.array([0.0, 0.0, ROBOT.tool.depth + p.aim])
    scene = seen_by(SceneObject("ripe", "target", Sphere(0.015), ahead))
    look = looks(scene, p)[0]
    x, y, z = look.detections[0].position
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-9)
    assert z == pytest.approx(np.hypot(p.aim + p.hand_below, 0.03 + p.hand_aside))
    within = frame @ np.array([0.0, 0.0, ROBOT.tool.depth - 0.025])  # in the cup, below its rim
    fruits = truth(scene)._replace(positions=within[None])
    assert not Detector(scene, ROBOT, p).expose(0.0, HOME, fruits).detections
    assert hand_pose(ROBOT, p).position == pytest.approx([0.06, 0.0, ROBOT.tool.depth - 0.06])


def test_leaves_hide_some_fruits_from_one_side():
    scene = seen_by(*(fruit(f"n{k}", [0.1 * k - 0.2, 0.0, 0.5]) for k in range(5)),
                    fruit("ripe", [0.0, 0.15, 0.5], "target"))  # fmt: skip
    counts = [len(looks(scene, replace(BLIND, leaf=0.5), seed)[0].detections) for seed in range(60)]
    assert 0.5 * 6 < np.mean(counts) < 5.5  # half have one, not each hides its fruit wholly
    detector = Detector(scene, ROBOT, replace(BLIND, leaf=1.0), 1)
    first = ids(detector.expose(0.0, HOME, truth(scene)))
    around = rotation([0.0, 0.0, 1.0], np.pi)
    centre = CAMERA @ np.array([0.0, 0.0, 0.5])
    detector._stand = Pose(centre + around @ (CAMERA.position - centre), around @ CAMERA.rotation)
    assert len(first) < 6
    assert len(ids(detector.expose(0.1, HOME, truth(scene)))) == 6  # from behind


def test_the_cone_of_view():
    edge = np.tan(0.5 * WHITE.view)
    inside, outside = (
        fruit("ripe", [0.0, 0.98 * edge, 1.0], "target"),
        fruit("n1", [1.02 * edge, 0, 1]),
    )
    behind = fruit("n2", [0.0, 0.0, -0.5])
    assert ids(looks(seen_by(inside, outside, behind), WHITE)[0]) == {"ripe"}
