"""The message types: fields and order of the real packages, bytes and back."""

import builtins
import sys

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.ros import from_bytes, message, to_bytes, types, typestore

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


def test_fields_take_plain_numbers_and_lists() -> None:
    item = message(
        "sensor_msgs/msg/JointState", name=("a", "b"), position=[1, 2], velocity=(0.5, 0.25)
    )
    back = from_bytes(to_bytes(item), "sensor_msgs/msg/JointState")
    assert back.name == ["a", "b"]
    assert back.position.tolist() == [1.0, 2.0]
    assert back.velocity.dtype == np.float64
    assert not len(back.effort)


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


def test_without_rosbags_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without(name: str, *args, **kwargs):
        if name.startswith("rosbags"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    for name in [name for name in sys.modules if name.startswith("rosbags")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(InvalidRequestError, match=r"pip install -e '\.\[ros\]'"):
        types.typestore.__wrapped__()
