"""Changes of what is right: of values in documents, of bytes, of XML, of arrays.

Each takes its choices from a source: ``random.Random(seed)``, or Hypothesis' own, which shrinks.
"""

import copy
import io
import json
import math
from collections.abc import Sequence
from random import Random
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml

NUMBERS = [
    0, -0.0, 1, -1, 2, 3, 0.5, 1e-3, 1e-9, 1e-160, 5e-324, 1e-17, 10, 180, 800, 1e3, 1e6, 1e9,
    1e150, 1e160, 1e300, 1.7e308, -1e300, math.nan, math.inf, -math.inf, 2**31, 2**63, 10**30,
    10**400, True, False,
]  # fmt: skip
WORDS = [
    "", " ", "x", "no", "1e-3", "1,5", "NaN", "target", "static", "pushable", "panda", "scara",
    "cup", "mesh", "franka_hand", "world", "camera", "../../etc/passwd", "/dev/zero", "/dev/null",
    "a[/bold]", "$\\frac{$", "\x1b[31m", "\x00", "\ud800", "ü", "\u202e", "a" * 5000, "${x}", "%s",
]  # fmt: skip
OTHERS: list[Any] = [None, [], {}, [[]], [{}], {"": None}, [0, 0, 0], [1, 0, 0, 0], ["x"], {"x": 1}]
TAGS = [
    b"!!timestamp x", b"!!bool x", b"!!int x", b"!!binary '#'", b"!!set {a}", b"!!omap [a: 1]",
    b"&a [*a]", b"*a", b"<<: 3", b"!!python/name:os.system", b"? [1]: 2", b"|", b">-", b"- " * 50,
    b"[" * 3000, b"{a: " * 3000, b"\t", b"\xff\xfe", b"\x00", b"%YAML 9.9\n---", b"...\n---\n",
    b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&#0;", b"<![CDATA[", b"<xacro:if value='1'>", b"${x}",
    b"1" * 5000, b",", b'"', b"'", b"\r", b"\x1a", b"nan", b"1e999", b"-", b"\xed\xa0\x80",
]  # fmt: skip


def value(random: Random) -> Any:
    pool: Sequence[Any] = random.choice([NUMBERS, NUMBERS, WORDS, OTHERS])
    return copy.deepcopy(random.choice(pool))


def spots(document: Any) -> list[tuple[Any, Any]]:
    """Every place in a document as (holder, key or index)."""
    found: list[tuple[Any, Any]] = []
    open_ = [document]
    while open_:
        holder = open_.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        for key in keys:
            found.append((holder, key))
            if isinstance(holder[key], dict | list):
                open_.append(holder[key])
    return found


def changed(random: Random, document: Any) -> Any:
    """A copy of a document of plain values with one to four places changed."""
    document = copy.deepcopy(document)
    for _ in range(random.choice([1, 1, 1, 2, 2, 3, 4])):
        places = spots(document)
        if not places:
            return document
        holder, key = random.choice(places)
        old = holder[key]
        match random.randrange(8):
            case 0:
                del holder[key]
            case 1 | 2:
                holder[key] = value(random)
            case 3 | 4 if _is_number(old):
                holder[key] = old * random.choice([-1, 0, 0.5, 0.99, 1.01, 2, 10, 1e-3, 1e3, 1e12])
            case 3 | 4 | 5 if _is_number(old):
                holder[key] = old + random.gauss(0.0, random.choice([1e-9, 1e-2, 0.1, 1.0]))
            case 5 if isinstance(holder, list):
                holder.insert(random.randrange(len(holder) + 1), copy.deepcopy(old))
            case 6:
                other, place = random.choice(places)
                holder[key] = copy.deepcopy(other[place]) if place in keys_of(other) else None
            case _ if isinstance(holder, dict):
                holder[random.choice(["x", "scale", "frame", str(key) + "s", "goal"])] = old
    return document


def _is_number(old: Any) -> bool:
    """Whether a value is a number that floats hold."""
    return isinstance(old, int | float) and not isinstance(old, bool) and not abs(old) > 10**308


def keys_of(holder: Any) -> Any:
    return holder.keys() if isinstance(holder, dict) else range(len(holder))


def damaged(random: Random, content: bytes) -> bytes:
    """Bytes with one to four places damaged."""
    for _ in range(random.choice([1, 1, 2, 4])):
        at = random.randrange(len(content) + 1)
        to = min(len(content), at + random.choice([1, 1, 2, 8, 64]))
        match random.randrange(7):
            case 0:
                content = content[:at]
            case 1:
                content = content[:at] + content[to:]
            case 2:
                content = content[:at] + bytes([random.randrange(256)]) + content[at + 1 :]
            case 3:
                content = content[:at] + random.choice(TAGS) + content[to:]
            case 4:
                content = content[:at] + random.choice(TAGS) + content[at:]
            case 5:
                content = content[:to] + content[at:]
            case 6:
                text = str(random.choice(NUMBERS[:-3])).encode()
                content = content[:at] + text + content[to:]
    return content


def xml_changed(random: Random, text: str) -> bytes:
    """An XML document with one to three elements or attributes changed."""
    root = ElementTree.fromstring(text)
    for _ in range(random.choice([1, 1, 2, 3])):
        holders = [node for node in root.iter() if len(node)]
        node = random.choice(list(root.iter()))
        holder = random.choice(holders) if holders else root
        match random.randrange(7):
            case 0 if len(holder):
                holder.remove(random.choice(list(holder)))
            case 1 if len(holder):
                holder.append(copy.deepcopy(random.choice(list(holder))))
            case 2 | 3 | 4 | 5 if node.attrib:
                key = random.choice(list(node.attrib))
                words = node.attrib[key].split() or [""]
                at = random.randrange(len(words))
                words[at] = str(random.choice([*NUMBERS[:-3], *WORDS[:12], "fixed", "floating",
                                               "prismatic", "l1", "j1", "link2"]))  # fmt: skip
                node.attrib[key] = " ".join(words)
            case _:
                node.tag = random.choice(["link", "joint", "origin", "axis", "x", "mimic", "limit"])
    return ElementTree.tostring(root)


def packed(arrays: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=True, **arrays)
    return stream.getvalue()


def arrays_changed(random: Random, arrays: dict[str, Any]) -> bytes:
    """Arrays as an NPZ file: with values, shapes, types or names changed, or bytes damaged."""
    arrays = {key: np.array(array) for key, array in arrays.items()}
    for _ in range(random.choice([1, 1, 2, 3])):
        key = random.choice(list(arrays) or ["x"])
        array = arrays.get(key, np.zeros(3))
        match random.randrange(9):
            case 0:
                arrays.pop(key, None)
            case 1 | 2 if array.size and array.dtype.kind == "f":
                array.flat[random.randrange(array.size)] = float(random.choice(NUMBERS[:-3]))
            case 3 if array.dtype.kind == "f":
                arrays[key] = array * random.choice([-1, 0, 10, 1e-3, 1e150, 1e300, 57.3])
            case 4 if array.ndim:
                arrays[key] = array[: random.randrange(array.shape[0] + 1)]
            case 5:
                kind = random.choice(["f4", "i4", "c16", "U8", "bool", "O", "S4", "M8[s]"])
                arrays[key] = np.resize(np.array([1, 0], dtype=object), array.shape) \
                    if kind == "O" else np.zeros(array.shape, dtype=kind)  # fmt: skip
            case 6:
                arrays[key] = array[..., None] if random.random() < 0.5 else array.ravel()
            case 7:
                arrays[random.choice(["x", "time", "times", "positions", key + "s"])] = array
            case 8 if array.ndim > 1:
                arrays[key] = array[..., : random.randrange(array.shape[-1] + 1)]
    content = packed(arrays)
    if random.random() < 0.25:
        content = damaged(random, content)
    return content


def text_of(random: Random, document: Any) -> tuple[str, bytes]:
    """A document as YAML or JSON; sometimes its bytes are damaged."""
    if random.random() < 0.3:
        name, content = "json", json.dumps(document).encode("utf-8", "surrogatepass")
    else:
        text = yaml.safe_dump(
            document, sort_keys=False, default_flow_style=random.choice([None, False])
        )
        name, content = "yaml", text.encode("utf-8", "surrogatepass")
    return name, content
