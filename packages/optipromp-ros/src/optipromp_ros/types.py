"""The types of the messages, messages without ROS, and bags: files of recorded messages.

Types are those of ROS 2 Jazzy. The package ``rosbags`` (package ``optipromp-ros``) brings the
common ones; ``definitions.txt`` holds the fields of ``moveit_msgs``, of ``vision_msgs`` 4 and of
what they need. A bag is a rosbag2 folder (SQLite) or an MCAP file.
"""

from __future__ import annotations

import functools
import os
import struct
import tempfile
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from optipromp.core.errors import InvalidRequestError, OptiPrompError, installed_by
from optipromp.core.files import is_there

if TYPE_CHECKING:
    from rosbags.interfaces import Connection
    from rosbags.typesys.store import Typestore

Message = Any  # A message: the fields of its type as attributes, the type's name as ``__msgtype__``

STATUS = "diagnostic_msgs/msg/DiagnosticStatus"
OK, WARN, ERROR = 0, 1, 2  # its levels

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
        raise InvalidRequestError(
            f"messages of ROS need rosbags: {installed_by('optipromp-ros')}"
        ) from None
    store = get_typestore(Stores.ROS2_JAZZY)
    text = (resources.files(__package__) / "definitions.txt").read_text(encoding="utf-8")
    for part in text.split(_HEADING)[1:]:
        name, _, fields = part.partition("\n")
        store.register(get_types_from_msg(fields, name))
    return store


def message(name: str, /, **fields: Any) -> Message:
    """A message of a type, for instance ``geometry_msgs/msg/Pose``.

    Fields that are not given are zero, empty or false, but the ``w`` of a quaternion is 1, as in
    ROS 2. Sequences of numbers become arrays of their type.

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
    if name == "geometry_msgs/msg/Quaternion":
        fields = {"w": 1.0, **fields}
    values = {key: _value(kind, fields.get(key)) for key, kind in known.items()}
    made: Message = store.types[name](**values)
    return made


def copied(item: Any, name: str) -> Message:
    """A message of the type ``name`` with the fields of another library's message, as rclpy's."""
    fields = typestore().fielddefs[name][1]
    return message(name, **{key: getattr(item, key) for key, _ in fields})


def diagnostic(
    level: int, name: str, words: str, hardware: str, values: Mapping[str, str] | None = None
) -> Message:
    """A ``diagnostic_msgs/DiagnosticStatus``; ``level``: :data:`OK`, :data:`WARN` or :data:`ERROR`.

    ``hardware``: the robot's name. ``values``: further words by key.
    """
    kind = "diagnostic_msgs/msg/KeyValue"
    rows = [message(kind, key=key, value=value) for key, value in (values or {}).items()]
    fields = {"level": level, "name": f"optipromp/{name}", "message": words, "values": rows}
    return message(STATUS, hardware_id=hardware, **fields)


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
        return _decoded(typestore(), data, name)
    except (SerdeError, ValueError, KeyError, IndexError, struct.error) as error:
        raise InvalidRequestError(f"{len(data)} bytes are no {name} ({error})") from None


def _decoded(store: Typestore, data: bytes | memoryview, name: str) -> Message:
    """The message in ``data``; what lies behind it is left.

    rclpy's ``serialize_message``, with which Python programs write bags, gives as many bytes as the
    message was estimated to need, and rosbags refuses more than three that are too many.
    """
    if bytes(data[:2]) not in (b"\0\0", b"\0\1"):
        raise ValueError(f"they begin with {bytes(data[:2])!r}, not as CDR")
    kind = store.get_msgdef(name)
    decode = kind.deserialize_cdr_le if data[1] else kind.deserialize_cdr_be
    return decode(data[4:], 0, kind.cls, store)[0]


def _value(kind: Any, given: Any) -> Any:
    """``given`` as the value of a field of this kind; None: zero or empty."""
    from rosbags.interfaces import Nodetype

    form, what = kind
    if form == Nodetype.NAME:
        if given is None or hasattr(given, "__msgtype__"):
            return message(what) if given is None else given
        return copied(given, what)
    if form == Nodetype.BASE:
        plain: Any = {"string": str, "bool": bool}.get(
            what[0], float if "float" in what[0] else int
        )
        if isinstance(given, bytes):  # a byte, as rclpy has it
            return given[0]
        return plain() if given is None else plain(given)
    (inner, of), size = what
    if inner == Nodetype.BASE and of[0] != "string":
        zeros = np.zeros(size if form == Nodetype.ARRAY else 0)
        return np.array(zeros if given is None else given, dtype=_NUMPY.get(of[0], of[0]))
    return [] if given is None else [_value((inner, of), one) for one in given]


_METADATA_VERSION: Literal[8] = 8  # that of ROS 2 Iron and later


class Recorded(NamedTuple):
    """A message of a bag: its topic, the message, and when it was recorded [ns since 1970]."""

    topic: str
    message: Message
    stamp: int = 0


def write_bag(path: str | os.PathLike[str], items: Iterable[Recorded]) -> None:
    """Write messages to a new bag, whole or not at all.

    Args:
        path: ends in ``.mcap``: one MCAP file; else a rosbag2 folder with a SQLite file.
        items: the messages.

    Raises:
        InvalidRequestError: no messages, values that ROS has no bytes for, the path exists or
            cannot be written, rosbags is missing.
    """
    store = typestore()
    from rosbags.rosbag2 import StoragePlugin, Writer

    path, items = Path(path), list(items)
    if not items:
        raise InvalidRequestError(f"no messages for the bag {path}: must be one at least")
    if is_there(path):
        raise InvalidRequestError(f"{path} exists: a bag must have a path of its own")
    single = path.suffix == ".mcap"
    plugin = StoragePlugin.MCAP if single else StoragePlugin.SQLITE3
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        beside = {"prefix": f".{path.name}.", "dir": str(path.parent)}
        with tempfile.TemporaryDirectory(**beside, ignore_cleanup_errors=True) as folder:
            made = Path(folder) / (path.stem if single else path.name)
            with Writer(made, version=_METADATA_VERSION, storage_plugin=plugin) as writer:
                topics: dict[tuple[str, str], Connection] = {}
                for topic, item, stamp in items:
                    key = topic, item.__msgtype__
                    if key not in topics:
                        topics[key] = writer.add_connection(*key, typestore=store)
                    writer.write(topics[key], stamp, store.serialize_cdr(item, key[1]))
            (next(made.glob("*.mcap")) if single else made).replace(path)
    except Exception as error:  # values that ROS has no bytes for raise errors of any kind
        raise InvalidRequestError(f"cannot write the bag {path}: {error}") from error


def read_bag(
    path: str | os.PathLike[str],
    *,
    topics: Collection[str] | None = None,
    types: Collection[str] | None = None,
) -> Iterator[Recorded]:
    """The messages of a bag, in the order in which they were recorded.

    A message is read by the definition of its type in the bag, else by the built-in one. A topic
    whose type is not built in is skipped with a warning.

    Args:
        path: an MCAP file, a rosbag2 folder, or the SQLite file in it.
        topics: to read; None: all.
        types: of messages to read (``sensor_msgs/msg/JointState``); None: all.

    Raises:
        InvalidRequestError: no bag, a damaged bag, or a topic that it lacks (the message lists its
            topics).
    """
    typestore()
    from rosbags.rosbag2 import Reader

    path = Path(path)
    if path.suffix.lower() == ".bag":
        raise InvalidRequestError(
            f"{path} is a bag of ROS 1: convert it by 'rosbags-convert --src {path.name} --dst "
            f"{path.stem}', which comes with the package rosbags"
        )
    try:
        with Reader(path) as reader:
            chosen = _chosen(path, reader.connections, topics, types)
            if not chosen:
                return
            stores = {connection.msgtype: _types_of(connection) for connection in chosen}
            for connection, stamp, data in _as_recorded(reader, chosen):
                item = _decoded(stores[connection.msgtype], data, connection.msgtype)
                yield Recorded(connection.topic, item, stamp)
    except OptiPrompError:
        raise
    except Exception as error:  # damaged files raise errors of any kind
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InvalidRequestError(f"{path} is not a readable bag ({reason})") from None


def _as_recorded(reader: Any, chosen: list[Connection]) -> Iterable[tuple[Connection, int, bytes]]:
    """The messages in the order of the file: rosbags sorts them, also where a clock was set back.

    Bags whose messages are compressed one by one come as rosbags sorts them.
    """
    storages = getattr(reader.storage, "storages", [reader.storage])
    if reader.compression_mode == "message":
        yield from reader.messages(chosen)
        return
    wanted = {(each.topic, each.msgtype): each for each in chosen}
    for storage in storages:
        ours = ((part.id, wanted.get((part.topic, part.msgtype))) for part in storage.connections)
        known = {key: each for key, each in ours if each is not None}
        if hasattr(storage, "messages_scan"):
            parts = [part for part in storage.connections if part.id in known]
            found = ((part.id, stamp, data) for part, stamp, data in storage.messages_scan(parts))
        else:
            rows = "SELECT topic_id, timestamp, data FROM messages ORDER BY id"
            found = storage.dbconn.execute(rows)
        for topic, stamp, data in found:
            if topic in known:
                yield known[topic], stamp, data


def _chosen(
    path: Path,
    connections: Iterable[Connection],
    topics: Collection[str] | None,
    types: Collection[str] | None,
) -> list[Connection]:
    """The connections to read."""
    connections = list(connections)
    there = {connection.topic for connection in connections}
    for topic in topics or ():
        if topic not in there:
            raise InvalidRequestError(
                f"{path} has no topic {topic!r}: it has {', '.join(sorted(there)) or 'none'}"
            )
    found = []
    for connection in connections:
        name = connection.msgtype
        if (topics is not None and connection.topic not in topics) or (
            types is not None and name not in types
        ):
            continue
        if name not in typestore().fielddefs:
            warnings.warn(
                f"{path}: topic {connection.topic} is skipped; its type {name} is none of ours",
                stacklevel=3,
            )
            continue
        found.append(connection)
    return found


def _types_of(connection: Connection) -> Typestore:
    """The types by the definition in the bag; the built-in ones where it has none or the same."""
    from rosbags.interfaces import MessageDefinitionFormat
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    ours, name = typestore(), connection.msgtype
    if connection.msgdef.format != MessageDefinitionFormat.MSG:
        return ours
    if connection.digest == ours.hash_rihs01(name):
        return ours
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(connection.msgdef.data, name))
    return store
