"""The closed loop on the topics of a camera: its pictures become looks here."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.perception.shots import SEED, shot_of
from tests.ros.camera_messages import FRAME, cloud, frames, header, image, info, sent

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.scenes.pose import Pose
from optipromp.laboratory.generate import generate
from optipromp.perception import DepthPicture, Watcher, look_at
from optipromp.ros import Message, PickLoop, message
from optipromp.ros.loop import moving

EPOCH = 1_790_000_000_123_456_789  # [ns]


def states(names: list[str], q: np.ndarray, stamp: int) -> Message:
    return message("sensor_msgs/msg/JointState", header=header(stamp, ""), name=names, position=q)


def test_pictures_of_a_camera_on_the_hand_become_tracked_fruits() -> None:
    scene = generate("cluster", SEED)
    shot = shot_of()
    robot, start = posed(scene)
    names = [f"fr3_{name}" for name in robot.joint_names]
    tool = moving(robot, start.q)[1]
    loop = PickLoop(scene, prefix="fr3_", watcher=Watcher(up=scene.up))
    loop.heard(sent(frames(0, ("tool", FRAME, tool.inverse() @ shot.picture.camera.pose))))
    depth = shot.picture.depth.astype(np.float32)
    for k in range(6):
        stamp = EPOCH + k * 50_000_000
        loop.heard(sent(states(names, start.q, stamp)))
        for item in (
            info(shot.picture.camera, stamp), image(shot.picture.rgb, "rgb8", stamp),
            image(depth, "32FC1", stamp),
        ):  # fmt: skip
            loop.heard(sent(item), "/cam")
        loop.tick(stamp + 1_000_000)
    tracked = loop.controller.tracker.at(0.25)
    picture = DepthPicture(shot.picture.rgb, depth.astype(np.float64), shot.picture.camera)
    want = look_at(picture, up=scene.up).look.in_base()
    assert len(want) >= 3
    assert int(tracked.confirmed.sum()) == len(want)
    for one in want:
        assert np.linalg.norm(tracked.positions - one.position, axis=1).min() < 0.003


def test_pictures_without_a_watcher_or_a_frame_are_refused() -> None:
    scene = generate("cluster", SEED)
    robot, start = posed(scene)
    rng = np.random.default_rng(61303)
    picture = shot_of().picture
    with pytest.raises(InvalidRequestError, match="is of no use here"):
        PickLoop(scene).heard(cloud(picture, EPOCH))
    loop = PickLoop(scene, watcher=Watcher())
    with pytest.raises(InvalidRequestError, match="joint states must come first"):
        loop.heard(cloud(picture, EPOCH))
    loop.heard(states(list(robot.joint_names), start.q, EPOCH))
    with pytest.raises(InvalidRequestError, match=f"frame_id is '{FRAME}': must be"):
        loop.heard(cloud(picture, EPOCH))
    turn = Rotation.from_rotvec(rng.normal(0.0, 1.0, 3)).as_matrix()
    loop.heard(frames(0, (robot.link_names[0], FRAME, Pose([0.1, 0.2, 0.3], turn))))
    loop.heard(cloud(picture, EPOCH))
