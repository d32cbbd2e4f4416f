"""Bags: written, read back by us and by a reader that is not ours, refusals."""

import sqlite3
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes import load_scene
from optipromp_ros import Recorded, is_bag, message, planning_scene, read_bag, to_bytes, write_bag

SCENE = load_scene("scenario-4")
TEXT = message("std_msgs/msg/String", data="grün")
STATE = message("sensor_msgs/msg/JointState", name=["a"], position=[np.pi])
ITEMS = [
    Recorded("/scene", planning_scene(SCENE), 10),
    Recorded("/text", TEXT, 20),
    Recorded("/joint_states", STATE, 1_700_000_000_123_456_789),
    Recorded("/text", TEXT, 1_700_000_000_123_456_790),
]


@pytest.mark.parametrize("name", ["bag", "bag.mcap"])
def test_a_bag_reads_back(tmp_path: Path, name: str) -> None:
    path = tmp_path / "new" / name
    write_bag(path, ITEMS)
    assert is_bag(path)
    assert sorted(p.name for p in path.parent.iterdir()) == [name]  # nothing half-written beside it
    back = list(read_bag(path))
    assert [(i.topic, i.stamp) for i in back] == [(i.topic, i.stamp) for i in ITEMS]
    assert [to_bytes(i.message) for i in back] == [to_bytes(i.message) for i in ITEMS]
    (only,) = read_bag(path, topics=["/joint_states"])
    assert only.message.position.tolist() == [np.pi]
    texts = list(read_bag(path, types=["std_msgs/msg/String"]))
    assert [item.message.data for item in texts] == ["grün", "grün"]
    assert not list(read_bag(path, topics=["/text"], types=["sensor_msgs/msg/JointState"]))


def test_another_reader_reads_the_same_from_mcap(tmp_path: Path) -> None:
    path = tmp_path / "bag.mcap"
    write_bag(path, ITEMS)
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        seen = {channel.topic: (item.log_time, decoded) for _, channel, item, decoded in
                reader.iter_decoded_messages()}  # fmt: skip
    assert seen["/text"][1].data == "grün"
    stamp, state = seen["/joint_states"]
    assert stamp == ITEMS[2].stamp
    assert list(state.position) == [np.pi]
    scene = seen["/scene"][1]
    assert scene.robot_model_name == "panda"
    np.testing.assert_allclose(scene.robot_state.joint_state.position, SCENE.start, atol=1e-9)
    for item, one in zip(SCENE.objects, scene.world.collision_objects, strict=True):
        where = one.pose.position
        np.testing.assert_allclose((where.x, where.y, where.z), item.position, atol=1e-9)
        points = item.stem.points if item.stem else ()
        for point, frame in zip(points, one.subframe_poses[: len(points)], strict=True):
            local = (frame.position.x, frame.position.y, frame.position.z)
            at = item.rotation @ local + item.position
            np.testing.assert_allclose(at, point, atol=1e-9)
    ripe = scene.world.collision_objects[0]
    assert ripe.id == "target/ripe"
    assert ripe.subframe_names == ["stem_0", "stem_1", "approach"]
    assert list(ripe.primitives[0].dimensions) == [SCENE.target.shape.radius]


def test_sqlite_holds_the_bytes_of_ros(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", ITEMS)
    with sqlite3.connect(tmp_path / "bag" / "bag.db3") as base:
        rows = base.execute("select timestamp, data from messages order by timestamp").fetchall()
    base.close()
    assert rows == [(item.stamp, to_bytes(item.message)) for item in ITEMS]


def foreign(path: Path, name: str, text: str, *topics: str, **values: object) -> None:
    """A bag of another program: one message of its own type on each topic."""
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(text, name))
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, name, typestore=store)
            writer.write(connection, 1, store.serialize_cdr(store.types[name](**values), name))


def test_a_type_that_is_none_of_ours_is_skipped_with_a_word(tmp_path: Path) -> None:
    foreign(tmp_path / "bag", "my_msgs/msg/Berry", "float64 ripeness", "/berry", ripeness=0.5)
    with pytest.warns(UserWarning, match="topic /berry is skipped; its type my_msgs/msg/Berry"):
        assert list(read_bag(tmp_path / "bag")) == []


def test_a_type_of_another_release_is_read_by_the_bags_definition(tmp_path: Path) -> None:
    """MoveItErrorCodes of Humble has neither ``message`` nor ``source``."""
    name = "moveit_msgs/msg/MoveItErrorCodes"
    foreign(tmp_path / "bag", name, "int32 val", "/code", val=-31)
    (item,) = read_bag(tmp_path / "bag")
    assert item.message.val == -31
    assert not hasattr(item.message, "source")


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidRequestError, match="no messages for the bag"):
        write_bag(tmp_path / "bag", [])
    write_bag(tmp_path / "bag", ITEMS)
    with pytest.raises(InvalidRequestError, match="bag exists: a bag must have a path of its own"):
        write_bag(tmp_path / "bag", ITEMS)
    large = message("std_msgs/msg/Header", frame_id="a")
    large.stamp.sec = 2**40
    with pytest.raises(InvalidRequestError, match="cannot write the bag"):
        write_bag(tmp_path / "large", [Recorded("/a", large)])
    (tmp_path / "file").touch()
    with pytest.raises(InvalidRequestError, match="cannot write the bag"):
        write_bag(tmp_path / "file" / "bag", ITEMS)


@pytest.mark.parametrize("name", ["none.mcap", "none", "bad.mcap", "bad", "text.txt", "bad.db3"])
def test_what_is_no_bag_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "metadata.yaml").write_text("rosbag2_bagfile_information: 3\n")
    for file in ("bad.mcap", "text.txt", "bad.db3"):
        (tmp_path / file).write_bytes(b"no bag at all" * 10)
    with pytest.raises(InvalidRequestError, match=f"{name} is not a readable bag"):
        list(read_bag(tmp_path / name))


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.99])
def test_a_bag_that_was_cut_off_is_refused(tmp_path: Path, share: float) -> None:
    write_bag(tmp_path / "bag.mcap", ITEMS)
    data = (tmp_path / "bag.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: int(share * len(data))])
    with pytest.raises(InvalidRequestError, match="is not a readable bag"):
        list(read_bag(tmp_path / "cut.mcap"))


def test_a_bag_of_ros_1_says_how_to_convert_it(tmp_path: Path) -> None:
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(
        InvalidRequestError, match=r"ROS 1: convert it by 'rosbags-convert --src old"
    ):
        list(read_bag(tmp_path / "old.bag"))
