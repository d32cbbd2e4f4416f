"""The types of the messages, and messages without ROS.

Types are those of ROS 2 Jazzy. The package ``rosbags`` (extra ``ros``) brings the common ones;
``definitions.txt`` holds the fields of ``moveit_msgs``, of ``vision_msgs`` 4 and of what they need.
"""

from __future__ import annotations

import functools
from importlib import resources
from typing import TYPE_CHECKING, Any

import numpy as np

from optipromp.core.errors import InvalidRequestError, installed_by

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

Message = Any
"""A message: the fields of its type as attributes, the type's name as ``__msgtype__``."""

_HEADING = "MSG: "
_NUMPY = {"byte": "uint8", "octet": "uint8", "char": "uint8"}  # other names are NumPy's


@functools.cache
def typestore() -> Typestore:
    """The types by name, with functions that turn their messages into bytes (CDR) and back.

    Raises:
        InvalidRequestError: rosbags is not installed.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore
    except ImportError:
        raise InvalidRequestError(f"messages of ROS need rosbags: {installed_by('ros')}") from None
    store = get_typestore(Stores.ROS2_JAZZY)
    text = (resources.files("optipromp.ros") / "definitions.txt").read_text(encoding="utf-8")
    for part in text.split(_HEADING)[1:]:
        name, _, fields = part.partition("\n")
        store.register(get_types_from_msg(fields, name))
    return store


def message(name: str, /, **fields: Any) -> Message:
    """A message of a type, for instance ``geometry_msgs/msg/Pose``.

    Fields that are not given are zero, empty or false. Sequences of numbers become arrays of their
    type.

    Raises:
        InvalidRequestError: an unknown type, or a field that the type lacks.
    """
    store = typestore()
    if name not in store.fielddefs:
        raise InvalidRequestError(f"message type {name!r} is unknown")
    known = dict(store.fielddefs[name][1])
    for key in fields:
        if key not in known:
            raise InvalidRequestError(f"{name} has no field {key!r}: it has {', '.join(known)}")
    values = {key: _value(kind, fields.get(key)) for key, kind in known.items()}
    made: Message = store.types[name](**values)
    return made


def constants(name: str) -> dict[str, int]:
    """The constants of a message type by name."""
    return {key: int(value) for key, _, value in typestore().fielddefs[name][0]}


def to_bytes(item: Message) -> bytes:
    """A message as ROS sends it (CDR, little endian)."""
    return bytes(typestore().serialize_cdr(item, item.__msgtype__, little_endian=True))


def from_bytes(data: bytes | memoryview, name: str) -> Message:
    """The message of the type ``name`` in ``data`` (CDR).

    Raises:
        InvalidRequestError: the bytes are not such a message.
    """
    from rosbags.serde import SerdeError

    try:
        return typestore().deserialize_cdr(data, name)
    except (SerdeError, KeyError, IndexError) as error:
        raise InvalidRequestError(f"{len(data)} bytes are no {name} ({error})") from None


def _value(kind: Any, given: Any) -> Any:
    """``given`` as the value of a field of this kind; None: zero or empty."""
    from rosbags.interfaces import Nodetype

    form, what = kind
    if form == Nodetype.NAME:
        return message(what) if given is None else given
    if form == Nodetype.BASE:
        plain: Any = {"string": str, "bool": bool}.get(
            what[0], float if "float" in what[0] else int
        )
        return plain() if given is None else plain(given)
    (inner, of), size = what
    if inner == Nodetype.BASE and of[0] != "string":
        zeros = np.zeros(size if form == Nodetype.ARRAY else 0)
        return np.array(zeros if given is None else given, dtype=_NUMPY.get(of[0], of[0]))
    return [] if given is None else list(given)
