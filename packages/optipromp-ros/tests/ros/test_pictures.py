"""Pictures of bags: decoded, joined, placed; and seen as those of files are."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.cli.fixtures import invoke, told
from tests.perception.shots import SEED, shot_of
from tests.ros.camera_messages import FRAME, cloud, compressed, frames, image, info, sent, states

from optipromp import load_scene
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.scenes import save_scene
from optipromp.core.scenes.hand import flange_of, tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp_eyes import CameraModel, DepthPicture, Watcher, look_at
from optipromp_eyes.pictures import taken
from optipromp_ros import Message, PickLoop, Recorded, bag_pictures, message, write_bag
from optipromp_ros.camera_infos import is_rectified, is_registered
from optipromp_ros.frames import known_frames
from optipromp_ros.images import Pictures
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph

SECOND = 10**9
EPOCH = 1_790_000_000 * SECOND
SCENE = load_scene("scenario-3")
RNG = np.random.default_rng(61300)
CAMERA = CameraModel(20, 12, 22.0, 23.0, 9.0, 6.0)
RGB = RNG.integers(0, 256, (12, 20, 3), dtype=np.uint8)
DEPTH = np.where(RNG.random((12, 20)) < 0.9, RNG.uniform(0.3, 0.9, (12, 20)), 0.0)
PICTURE = DepthPicture(RGB, DEPTH.astype(np.float32).astype(np.float64), CAMERA)
DEPTH = DEPTH.astype(np.float32)
COLOUR, FAR, CLOUD = "/cam/color/image_raw", "/cam/depth/image_raw", "/cam/points"


SCENE_BASE = posed(SCENE)[0].link_names[0]
see = partial(invoke, "see")


def joined(colour: Message, far: Message, about: Message | None = None) -> DepthPicture:
    made = Pictures()
    made.heard("/cam/color/camera_info", about or info(CAMERA))
    assert made.heard(COLOUR, colour) is None
    return made.heard(FAR, far).picture()


COLOURS = {
    "rgb8": image(RGB, "rgb8", EPOCH, spare=4),
    "bgr8": image(RGB[:, :, ::-1], "bgr8", EPOCH),
    "rgba8": image(np.dstack([RGB, RGB[:, :, :1]]), "rgba8", EPOCH),
    "png": compressed(RGB, EPOCH, "png"),
}
MILLI = np.rint(1e3 * DEPTH).astype(np.uint16)
DEPTHS = {
    "32FC1": (image(np.where(DEPTH > 0, DEPTH, np.nan), "32FC1", EPOCH + 10**6), 1e-9),
    "16UC1": (image(MILLI, "16UC1", EPOCH, spare=6), 0.51e-3),
    "big endian": (image(MILLI, "16UC1", EPOCH, big=True), 0.51e-3),
    "compressed 16UC1": (compressed(MILLI, EPOCH, "16UC1"), 0.51e-3),
    "compressed 32FC1": (compressed(DEPTH, EPOCH, "32FC1"), 5e-3),
    "RVL": (compressed(MILLI, EPOCH, "16UC1 rvl"), 0.51e-3),
    "RVL 32FC1": (compressed(DEPTH, EPOCH, "32FC1 rvl"), 5e-3),
    "PNG": (compressed(MILLI, EPOCH, "16UC1 plain"), 0.51e-3),
}
MILLIS = DEPTHS["16UC1"][0]


@pytest.mark.parametrize("colour", COLOURS)
def test_colours_of_every_encoding_are_the_same(colour: str) -> None:
    assert (joined(COLOURS[colour], DEPTHS["32FC1"][0]).rgb == RGB).all()


@pytest.mark.parametrize("far", DEPTHS)
def test_depths_of_every_encoding_are_metres(far: str) -> None:
    item, most = DEPTHS[far]
    found = joined(COLOURS["rgb8"], item)
    assert np.abs(found.depth - DEPTH).max() <= most
    assert ((found.depth == 0) == (DEPTH == 0)).all()
    assert (found.camera.fx, found.camera.fy) == (22.0, 23.0)
    assert (found.camera.cx, found.camera.cy) == (9.0, 6.0)


def about(focal: float, stamp: int = EPOCH, **further: Any) -> Message:
    """A ``CameraInfo`` of a sensor of 60 x 36 pixels."""
    return info(CameraModel(60, 36, focal, 46.0, 30.0, 20.0), stamp, **further)


@pytest.mark.parametrize(
    ("part", "bins", "want"),
    [
        ((12, 8, 20, 12), 0, (44.0, 46.0, 18.0, 12.0)),
        ((0, 0, 0, 0), 3, (44.0 / 3, 46.0 / 3, 10.0, 20.0 / 3)),
        ((10, 6, 40, 24), 2, (22.0, 23.0, 10.0, 7.0)),
    ],
    ids=["part", "binning", "both"],
)
def test_a_part_of_the_sensor_and_binning_move_the_axis(part, bins, want):
    x, y, width, height = part
    roi = message("sensor_msgs/msg/RegionOfInterest", x_offset=x, y_offset=y, width=width,
                  height=height)  # fmt: skip
    told = about(44.0, roi=roi, binning_x=bins, binning_y=bins)
    lens = joined(COLOURS["rgb8"], MILLIS, told).camera
    assert (lens.fx, lens.fy, lens.cx, lens.cy) == pytest.approx(want)
    old = {name.upper() if name in "dkrp" else name: value for name, value in vars(told).items()}
    old = SimpleNamespace(**old)  # as ROS 1 has it
    assert joined(COLOURS["rgb8"], MILLIS, old).camera.cx == lens.cx
    with pytest.raises(InvalidRequestError, match="20 x 12 pixels; its CameraInfo tells of 60 x"):
        joined(COLOURS["rgb8"], MILLIS, about(44.0))


def sequence(*items: tuple[str, Message], topics: list[str] | None = None) -> list[float]:
    """Focal lengths of the pictures of messages, as they are heard."""
    made = Pictures(topics)
    whole = (made.heard(topic, item) for topic, item in items)
    return [one.picture().camera.fx for one in whole if one is not None]


def small(focal: float, stamp: int = EPOCH) -> Message:
    return info(CameraModel(20, 12, focal, 46.0, 9.0, 6.0), stamp)


def shown(stamp: int) -> list[tuple[str, Message]]:
    return [(COLOUR, image(RGB, "rgb8", stamp)), (FAR, image(MILLI, "16UC1", stamp))]


def test_of_several_infos_that_of_the_topic_and_the_moment_is_taken(tmp_path: Path) -> None:
    beside, other = "/cam/color/camera_info", "/cam/preview/camera_info"
    two = [(beside, small(44.0)), (other, small(99.0))]
    assert sequence(*two, *shown(EPOCH)) == [44.0]
    assert sequence(*two, *shown(EPOCH), topics=[COLOUR, FAR, other]) == [99.0]
    assert sequence((other, small(99.0)), *shown(EPOCH)) == [99.0]  # the only one
    with pytest.raises(InvalidRequestError, match="tell of different cameras"):
        sequence(("/else/camera_info", small(44.0)), two[1], *shown(EPOCH))
    late = EPOCH + SECOND // 2
    once = [(beside, small(44.0)), *shown(late), *shown(late + SECOND)]
    assert sequence(*once) == [44.0, 44.0]
    focals = [40.0, 50.0, 60.0]
    each = [[*shown(EPOCH + k * SECOND), (beside, small(focal, EPOCH + k * SECOND))]
            for k, focal in enumerate(focals)]  # fmt: skip
    assert sequence(*(part for some in each for part in some)) == focals
    assert sequence(*(part for some in each for part in some[::-1])) == focals
    lost = [*each[0], *shown(EPOCH + SECOND), *each[2]]
    assert sequence(*lost) == [40.0, 60.0]  # the second waited
    lost += [part for k in (3, 4, 5) for part in shown(EPOCH + k * SECOND)]
    assert sequence(*lost) == [40.0, 60.0, 60.0]  # infos have stopped
    still = [("/tf_static", frames(0, (SCENE_BASE, FRAME, Pose())))]
    items = [Recorded(*part) for some in (still, *each) for part in some]
    write_bag(tmp_path / "zoom.mcap", items)
    found = bag_pictures(tmp_path / "zoom.mcap", SCENE, every=0.0)
    assert [one.picture.camera.fx for one in found] == focals
    items += [Recorded(*part) for part in shown(EPOCH + SECOND // 2)]
    write_bag(tmp_path / "between.mcap", items)
    with pytest.raises(InvalidRequestError, match=r"nearest message is 0\.5 s from it"):
        list(bag_pictures(tmp_path / "between.mcap", SCENE, every=0.0))


@pytest.mark.parametrize(
    ("topic", "straight", "registered"),
    [
        ("/cam/color/image_raw", False, False),
        ("/direct/color/image_raw", False, False),
        ("/gain_corrected/image", False, False),
        ("/rect_cam/image_raw/compressed", False, False),
        ("/cam/image_rect_color", True, False),
        ("/zed/rgb/color/rect/image/compressed", True, False),
        ("/unaligned_depth/image_rect_raw", True, False),
        ("/cam/aligned_depth_to_color/image_raw/compressedDepth", False, True),
        ("/cam/depth_registered/image_rect", True, True),
    ],
)
def test_names_of_topics_tell_by_whole_words(topic: str, straight: bool, registered: bool) -> None:
    assert (is_rectified(topic), is_registered(topic)) == (straight, registered)


def test_a_cloud_is_a_picture_whose_camera_fits_its_points() -> None:
    whole = Pictures().heard(CLOUD, cloud(PICTURE, EPOCH))
    found = whole.picture()
    assert (found.rgb == RGB).all()
    assert np.abs(found.depth - DEPTH).max() < 1e-6
    assert found.camera.fx == pytest.approx(22.0, abs=1e-4)
    assert found.camera.cy == pytest.approx(6.0, abs=1e-4)
    turned = cloud(PICTURE, EPOCH)
    for field, name in zip(turned.fields, "zxy", strict=False):  # z forward is x forward now
        field.name = name
    whole = Pictures().heard(CLOUD, turned)
    with pytest.raises(InvalidRequestError, match="optical frame"):
        whole.picture()
    flat = message("sensor_msgs/msg/PointCloud2", height=1, width=9)
    whole = Pictures().heard(CLOUD, flat)
    with pytest.raises(InvalidRequestError, match="take the organised one"):
        whole.picture()


def test_the_distortion_of_a_lens_is_taken_out() -> None:
    bent, told = (-0.2, 0.03, 0.0, 0.0, 0.0), info(CAMERA, bent=(-0.2, 0.03, 0.0, 0.0, 0.0))
    found = joined(COLOURS["rgb8"], MILLIS, told)
    assert (found.rgb == taken(RGB, DEPTH, replace(CAMERA, distortion=bent)).rgb).all()
    assert (found.rgb != RGB).any()
    told.distortion_model = "equidistant"
    with pytest.raises(InvalidRequestError, match="'equidistant' is not read"):
        joined(COLOURS["rgb8"], MILLIS, told)
    told.k = told.k[:2]
    with pytest.raises(InvalidRequestError, match="k has 2 and p 12 numbers"):
        joined(COLOURS["rgb8"], MILLIS, told)


def test_what_is_no_picture_is_said() -> None:
    made = Pictures()
    made.heard("/cam/color/camera_info", info(CAMERA))
    assert made.heard("/cam/infra", image(RGB[:, :, 0], "mono8", EPOCH)) is None
    assert made.seen["/cam/infra"] == "mono8"
    assert made.heard(COLOUR, COLOURS["rgb8"]) is None
    late = image(MILLI, "16UC1", EPOCH + SECOND // 10)
    assert made.heard(FAR, late) is None  # another moment
    with pytest.raises(InvalidRequestError, match="both have depth: name the topics"):
        made.heard("/cam/aligned", late)
    with pytest.raises(InvalidRequestError, match="registered to the colour"):
        joined(COLOURS["rgb8"], image(MILLI[:6], "16UC1", EPOCH))
    short = image(MILLI, "16UC1", EPOCH)
    short.data = short.data[:-9]
    with pytest.raises(InvalidRequestError, match="too few"):
        joined(COLOURS["rgb8"], short)


@pytest.fixture(scope="module")
def shot() -> Photograph:
    return shot_of()


def recorded(shot: Photograph, stamp: int) -> list[Recorded]:
    """Colour, depth and camera as a bag has them."""
    picture = shot.picture
    return [
        Recorded("/cam/color/camera_info", info(picture.camera, stamp), stamp),
        Recorded(COLOUR, image(picture.rgb, "rgb8", stamp), stamp),
        Recorded(FAR, image(picture.depth.astype(np.float32), "32FC1", stamp), stamp),
    ]


@pytest.mark.parametrize("kind", ["row.mcap", "row"])
def test_a_bag_gives_the_scene_of_its_pictures(kind: str, shot: Photograph, tmp_path: Path) -> None:
    known = tmp_path / "known.yaml"
    save_scene(shot.scene, known)
    pose = shot.picture.camera.pose
    still = frames(EPOCH, ("world", "fr3_panda_link0", Pose([0.3, 0.0, 0.0])),
                   ("world", FRAME, Pose([0.3, 0.0, 0.0]) @ pose))  # fmt: skip
    items = [Recorded("/tf_static", still, EPOCH)]
    for k in range(5):
        items += recorded(shot, EPOCH + k * SECOND // 2)
    write_bag(tmp_path / kind, items)
    words = "--bag", tmp_path / kind, "--known", known, "--out", tmp_path / "seen"
    records = told("see", *words)["pictures"]
    assert [record["name"] for record in records] == [
        "row-000, 0.00 s", "row-001, 1.00 s", "row-002, 2.00 s"
    ]  # fmt: skip
    seen, true = load_scene(records[1]["scene"]), shot.scene
    assert np.linalg.norm(seen.target.position - true.target.position) < 0.01
    assert len(seen.pushables) == len(true.pushables)
    assert Path(records[1]["overlay"]).is_file()


def test_a_cloud_in_a_bag_and_a_camera_by_its_file(shot: Photograph, tmp_path: Path) -> None:
    picture = shot.picture
    write_bag(tmp_path / "c.mcap", [Recorded(CLOUD, cloud(picture, EPOCH), EPOCH)])
    said = see("--bag", tmp_path / "c.mcap", "--out", tmp_path / "seen")
    assert said.exit_code == 2
    assert f"no frames tell where the camera was: header.frame_id is '{FRAME}'" in said.stderr
    assert "give --camera" in said.stderr
    (tmp_path / "camera.json").write_text(json.dumps(picture.camera.document()))
    words = "--bag", tmp_path / "c.mcap", "--camera", tmp_path / "camera.json"
    seen = load_scene(told("see", *words, "--out", tmp_path / "seen")["pictures"][0]["scene"])
    assert np.linalg.norm(seen.target.position - shot.scene.target.position) < 0.01


def test_joint_states_tell_where_a_camera_on_the_hand_was(tmp_path: Path) -> None:
    robot, state = posed(SCENE)
    names = [f"fr3_{name}" for name in robot.joint_names]
    mounted = Pose([0.05, 0.0, 0.02], Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix())
    items = [Recorded(CLOUD, cloud(PICTURE, EPOCH), EPOCH)]
    for step in (-1, 1):
        stamp = EPOCH + step * SECOND // 100
        asleep = states(["finger"], np.zeros(1), stamp)
        item = states(names, state.q + 0.01 * step, stamp)
        items += [Recorded("/joint_states", one, stamp) for one in (item, asleep)]
    still = frames(EPOCH, (robot.link_names[-2], FRAME, mounted))
    write_bag(tmp_path / "tf.mcap", [*items, Recorded("/tf_static", still, EPOCH)])
    write_bag(tmp_path / "file.mcap", items)
    want = flange_of(robot, state.q) @ mounted
    camera = CameraModel(20, 12, 22.0, 23.0, 9.0, 6.0, mounted, "hand")
    for found in (
        *bag_pictures(tmp_path / "tf.mcap", SCENE),
        *bag_pictures(tmp_path / "file.mcap", SCENE, camera=camera),
    ):
        pose = found.picture.camera.pose
        assert pose.position == pytest.approx(want.position, abs=1e-9)
        assert pose.rotation == pytest.approx(want.rotation, abs=1e-9)
    write_bag(tmp_path / "bare.mcap", items[:1])
    with pytest.raises(InvalidRequestError, match="no frames tell where the hand was"):
        list(bag_pictures(tmp_path / "bare.mcap", SCENE, camera=camera))


def camera_on(path: Path, told: list[tuple[str, float, float]]) -> Pose:
    """Where a camera on the right hand was at ``EPOCH``.

    ``told``: joint states, as prefix of an arm, time [s], and by how much its first joint is aside.
    """
    robot, state = posed(SCENE)
    items = [Recorded(CLOUD, cloud(PICTURE, EPOCH), EPOCH)]
    for k, (prefix, time, aside) in enumerate(told):
        q = state.q + aside * np.eye(7)[0]
        names = [prefix + name for name in robot.joint_names]
        item = states(names, q, EPOCH + round(time * SECOND))
        items.append(Recorded("/joint_states", item, EPOCH + k))
    still = frames(EPOCH, ("right_" + robot.link_names[-2], FRAME, Pose([0.05, 0.0, 0.02])))
    write_bag(path, [*items, Recorded("/tf_static", still, EPOCH)])
    (found,) = bag_pictures(path, SCENE, prefix="right_")
    return found.picture.camera.pose


def test_of_joint_states_on_two_topics_the_usual_or_named_ones_are_read(tmp_path: Path) -> None:
    """Of one arm, such as what was commanded beside what was measured."""
    robot, state = posed(SCENE)
    items = [Recorded(CLOUD, cloud(PICTURE, EPOCH), EPOCH)]
    still = frames(EPOCH, ("link7", FRAME, Pose()))
    items.append(Recorded("/tf_static", still, EPOCH))
    for topic, aside in (("/joint_states", 0.0), ("/commanded", 0.3), ("/gripper", None)):
        names = ["finger"] if aside is None else list(robot.joint_names)
        q = [0.0] if aside is None else state.q + aside
        items.append(Recorded(topic, states(names, np.array(q), EPOCH), EPOCH))
    write_bag(tmp_path / "a.mcap", items)
    for topics, aside in ((None, 0.0), ((CLOUD, "/commanded"), 0.3)):
        (found,) = bag_pictures(tmp_path / "a.mcap", SCENE, topics=topics)
        want = known_frames(robot, q=state.q + aside)["link7"].position
        np.testing.assert_allclose(found.picture.camera.pose.position, want, atol=1e-9)
    write_bag(tmp_path / "b.mcap", [items[0], items[1], items[3], items[2]._replace(topic="/x")])
    with pytest.raises(InvalidRequestError, match="on /commanded, /x: one topic must be named"):
        list(bag_pictures(tmp_path / "b.mcap", SCENE))


def test_of_two_arms_in_a_bag_the_named_one_carries_the_camera(tmp_path: Path) -> None:
    sides = ("left_", 0.3), ("right_", 0.0)
    told = [(side, time, aside) for time in (-0.05, 0.05) for side, aside in sides]
    robot, state = posed(SCENE)
    want = flange_of(robot, state.q) @ np.array([0.05, 0.0, 0.02])
    np.testing.assert_allclose(camera_on(tmp_path / "a.mcap", told).position, want, atol=1e-9)


def test_where_the_arm_is_unknown_the_refusal_says_why(tmp_path: Path) -> None:
    told = [("right_", -0.2, 0.0), ("right_", 0.2, 0.1)]
    with pytest.raises(InvalidRequestError, match=r"no joint states came for 0\.400 s around then"):
        camera_on(tmp_path / "a.mcap", told)


def test_depth_of_another_imager_or_moment_is_refused_by_name(shot, tmp_path):
    (tmp_path / "camera.json").write_text(json.dumps(shot.picture.camera.document()))
    about, colour, far = recorded(shot, EPOCH)
    far.message.header.frame_id = "camera_depth_optical_frame"
    aligned = far._replace(topic="/cam/aligned_depth_to_color/image_raw")
    late = recorded(shot, EPOCH + SECOND // 10)[2]
    said = {}
    for name, depth in (("raw", far), ("aligned", aligned), ("late", late)):
        write_bag(tmp_path / f"{name}.mcap", [about, colour, depth])
        said[name] = see("--bag", tmp_path / f"{name}.mcap", "--camera", tmp_path / "camera.json",
                         "--out", tmp_path / name)  # fmt: skip
    assert "depth is of the imager 'camera_depth_optical_frame'" in said["raw"].stderr
    assert "aligned_depth_to_color" in said["raw"].stderr
    assert said["aligned"].exit_code == 0
    assert "0.1 s apart at least, must be 0.02 at most" in said["late"].stderr


def test_a_bag_without_pictures_says_what_it_has(shot: Photograph, tmp_path: Path) -> None:
    items = recorded(shot, EPOCH)
    write_bag(tmp_path / "no-depth.mcap", items[:2])
    said = see("--bag", tmp_path / "no-depth.mcap", "--out", tmp_path / "seen").stderr
    assert "no picture with depth" in said
    assert f"{COLOUR} (colour)" in said
    assert "--topics goes with --bag" in see(tmp_path, "--topics", COLOUR).stderr
    assert "without a folder" in see(tmp_path, "--bag", tmp_path / "no-depth.mcap").stderr


def test_pictures_of_a_camera_on_the_hand_become_tracked_fruits() -> None:
    scene = generate("cluster", SEED)
    shot = shot_of()
    robot, start = posed(scene)
    names = [f"fr3_{name}" for name in robot.joint_names]
    tool = tool_frame(robot, start.q)
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


def test_pictures_without_a_watcher_are_refused() -> None:
    with pytest.raises(InvalidRequestError, match="is of no use here"):
        PickLoop(SCENE).heard(COLOURS["rgb8"])
