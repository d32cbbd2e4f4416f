"""The message types: fields and order of the real packages, bytes and back."""

import builtins
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest
from rosbags.rosbag2 import Writer

from optipromp.core.errors import InvalidRequestError
from optipromp_ros import from_bytes, message, read_bag, to_bytes, types, typestore
from optipromp_ros.types import copied

# MD5 sums that ROS 1 publishes for types that kept their fields in ROS 2. A field of another name,
# type or place gives another sum. Types with a Header, whose fields changed, have none here.
PUBLISHED = {
    "object_recognition_msgs/msg/ObjectType": "ac757ec5be1998b0167e7efcda79e3cf",
    "moveit_msgs/msg/AllowedCollisionEntry": "90d1ae1850840724bb043562fe3285fc",
    "moveit_msgs/msg/AllowedCollisionMatrix": "aedce13587eef0d79165a075659c1879",
    "moveit_msgs/msg/JointConstraint": "c02a15146bec0ce13564807805b008f0",
    "moveit_msgs/msg/LinkPadding": "b3ea75670df55c696fedee97774d5947",
    "moveit_msgs/msg/LinkScale": "19faf226446bfb2f645a4da6f2a56166",
    "moveit_msgs/msg/ObjectColor": "ec3bd6f103430e64b2ae706a67d8488e",
}
OURS = [
    name for name in typestore().fielddefs if name.startswith(("moveit", "octomap", "object_rec"))
]


@pytest.mark.parametrize("name", PUBLISHED)
def test_fields_are_those_of_the_real_packages(name: str) -> None:
    assert typestore().generate_msgdef(name)[1] == PUBLISHED[name]


@pytest.mark.parametrize("name", OURS)
def test_an_empty_message_of_every_type_goes_through_bytes(name: str) -> None:
    item = message(name)
    back = from_bytes(to_bytes(item), name)
    assert to_bytes(back) == to_bytes(item)
    assert typestore().hash_rihs01(name).startswith("RIHS01_")


@pytest.mark.parametrize(
    ("name", "fields", "words"),
    [
        ("moveit_msgs/msg/Plan", {}, "message type 'moveit_msgs/msg/Plan' is unknown"),
        ("std_msgs/msg/String", {"text": ""}, "has no field 'text': it has data"),
    ],
)
def test_unknown_types_and_fields_are_refused(name: str, fields, words: str) -> None:
    with pytest.raises(InvalidRequestError, match=words):
        message(name, **fields)


@pytest.mark.parametrize(
    "data", [b"", b"\0\1\0\0", b"\0\1\0\0\xff\xff\xff\xff", b"\7\7\0\0\0\0\0\0"]
)
def test_bytes_that_are_no_message_are_refused(data: bytes) -> None:
    with pytest.raises(InvalidRequestError, match=r"bytes are no std_msgs/msg/String"):
        from_bytes(data, "std_msgs/msg/String")


# A JointState of three joints of the ROS 2 node in tests/ros/real, with Fast DDS: what a raw
# subscription has of it, and what ``rclpy.serialization.serialize_message`` makes of it.
SENT = bytes.fromhex(
    "00010000803bb16a000000000100000000000000030000000b0000006672335f6a6f696e743100000b000000"
    "6672335f6a6f696e743200000b0000006672335f6a6f696e7433000003000000000000000000e03f00000000"
    "0000d0bf000000000000f03f0000000000000000"
)
SERIALISED = SENT + bytes.fromhex("643b643520010000")


@pytest.mark.parametrize("data", [SENT, SERIALISED])
def test_bytes_of_a_real_node_are_read(data: bytes) -> None:
    back = from_bytes(data, "sensor_msgs/msg/JointState")
    assert back.header.stamp.sec == 1_790_000_000
    assert back.name == ["fr3_joint1", "fr3_joint2", "fr3_joint3"]
    assert back.position.tolist() == [0.5, -0.25, 1.0]
    assert not len(back.velocity) + len(back.effort)


def test_a_bag_that_a_python_node_wrote_is_read(tmp_path: Path) -> None:
    """rosbag2_py writes what serialize_message gives."""
    with Writer(tmp_path / "bag", version=8) as writer:
        to = writer.add_connection("/a", "sensor_msgs/msg/JointState", typestore=typestore())
        writer.write(to, 7, SERIALISED)
    ((topic, item, stamp),) = read_bag(tmp_path / "bag")
    assert (topic, stamp, item.position.tolist()) == ("/a", 7, [0.5, -0.25, 1.0])


def test_a_message_of_another_library_is_copied() -> None:
    """Its fields are those of its type; a byte is bytes of one, as in rclpy."""
    part = SimpleNamespace(**vars(message("moveit_msgs/msg/CollisionObject", id="box")))
    del part.__msgtype__
    part.operation = b"\x01"
    part.header = SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=4), frame_id="world")
    link = SimpleNamespace(x=0.25, y=0.0, z=0.0)
    part.pose = SimpleNamespace(position=link, orientation=message("geometry_msgs/msg/Quaternion"))
    world = SimpleNamespace(
        collision_objects=[part], octomap=message("octomap_msgs/msg/OctomapWithPose")
    )
    back = copied(world, "moveit_msgs/msg/PlanningSceneWorld")
    back = from_bytes(to_bytes(back), "moveit_msgs/msg/PlanningSceneWorld")
    (found,) = back.collision_objects
    assert (found.id, found.operation, found.header.stamp.nanosec) == ("box", 1, 4)
    assert (found.header.frame_id, found.pose.position.x) == ("world", 0.25)


def test_without_rosbags_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    for name in [name for name in sys.modules if name.startswith("rosbags")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InvalidRequestError, match=r"pip install -e 'packages/optipromp-ros'"):
        types.typestore.__wrapped__()
