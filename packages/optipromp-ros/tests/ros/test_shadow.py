"""A picker's recording in a bag says the same as the file that it was made of."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scripts.shadow_picks import Done, record
from typer.testing import CliRunner

from optipromp import plan, save_scene
from optipromp.cli.main import app
from optipromp.core.scenes.pose import Pose
from optipromp_loop.control import without_fruits
from optipromp_loop.shadow.recording import load_recorded
from optipromp_ros import Recorded, message, write_bag
from optipromp_ros.scenes import pose_message, xyz
from optipromp_ros.shadow import load_picks
from optipromp_ros.trajectories import NANO, time_message
from optipromp_sim.generate import generate

SCENE = generate("cluster", 110_000)
V = "vision_msgs/msg/"


def stamped(time: float, frame: str = "") -> Any:
    stamp = time_message(1_700_000_000 * NANO + round(time * NANO))
    return message("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def seen(time: float, items: Any, frame: str) -> Recorded:
    found = []
    for item in items:
        name, spread = "ripe" if item.role == "target" else "unripe", np.zeros((6, 6))
        spread[:3, :3] = item.covariance
        said = message(f"{V}ObjectHypothesis", class_id=name, score=1.0)
        pose = message("geometry_msgs/msg/PoseWithCovariance", covariance=spread.ravel())
        size = xyz("geometry_msgs/msg/Vector3", np.full(3, 2.0 * item.radius))
        box = message(f"{V}BoundingBox3D", center=pose_message(Pose(item.position)), size=size)
        results = [message(f"{V}ObjectHypothesisWithPose", hypothesis=said, pose=pose)]
        found.append(message(f"{V}Detection3D", id=item.id, results=results, bbox=box))
    told = message(f"{V}Detection3DArray", header=stamped(time, frame), detections=found)
    return Recorded("/seen", told)


def test_a_bag_is_read_as_the_file(tmp_path: Path) -> None:
    file, bag, world = (tmp_path / name for name in ("shift.json", "shift.mcap", "world"))
    reach = plan(SCENE, planner="promp").trajectory
    record([Done(SCENE, reach, "harmed")], file, "perfect")
    read = load_recorded(file, SCENE)
    camera = read.looks[0].camera
    items = []
    for time, *q in np.loadtxt(file.with_suffix(".csv"), delimiter=",", skiprows=1).tolist():
        names = [f"left_{name}" for name in (*read.arm.joints, "finger")]
        said = message("sensor_msgs/msg/JointState", header=stamped(time), name=names, position=q)
        items.append(Recorded("/joint_states", said))
    post = message(
        "geometry_msgs/msg/Transform", rotation=pose_message(camera).orientation,
        translation=xyz("geometry_msgs/msg/Vector3", camera.position),
    )  # fmt: skip
    kind, head = "geometry_msgs/msg/TransformStamped", stamped(0.0, "left_link0")
    still = message(kind, header=head, child_frame_id="eye", transform=post)
    posts = Recorded("/tf_static", message("tf2_msgs/msg/TFMessage", transforms=[still]))
    write_bag(bag, [posts, *items, *(seen(o.time, o.detections, "eye") for o in read.looks)])
    write_bag(world, [*items, *(seen(o.time, o.in_base(), "world") for o in read.looks)])
    for path, blind in ((bag, False), (world, True)):
        found = load_picks(path, SCENE, gripper="left_finger", marks=None)
        assert [m.closed for m in found.marks] == pytest.approx([m.closed for m in read.marks])
        assert [look.time for look in found.looks] == pytest.approx([o.time for o in read.looks])
        for one, other in zip(found.looks[0].in_base(), read.looks[0].in_base(), strict=True):
            assert (one.id, one.role) == (other.id, other.role)
            np.testing.assert_allclose(one.position, other.position, atol=1e-6)
        assert any("where the camera was" in words for words in found.lacks) == blind
        np.testing.assert_allclose(found.arm.at(3.0), read.arm.at(3.0), atol=1e-9)
    save_scene(without_fruits(SCENE), tmp_path / "cell.yaml")
    asked = ["shadow", str(bag), "--known", str(tmp_path / "cell.yaml"), "--json", "--gripper"]
    result = CliRunner().invoke(app, [*asked, "left_finger"])
    assert result.exit_code == 0, result.output
    (pick,) = json.loads(result.stdout)["picks"]
    assert (pick["harmful"], pick["ours"]["status"]) == (True, "success")
    assert "'jaw'" in CliRunner().invoke(app, [*asked, "jaw"]).output
