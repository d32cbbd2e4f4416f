"""ONNX files without the package onnx: the few messages of protobuf that they need."""

from typing import Any

import numpy as np

FLOAT, INT64, STRING, BOOL = 1, 7, 8, 9


def number(field: int, value: int) -> bytes:
    return whole(field << 3) + whole(value % 2**64)


def whole(value: int) -> bytes:
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    return bytes([*out, value])


def part(field: int, content: bytes | str) -> bytes:
    content = content.encode() if isinstance(content, str) else content
    return whole(field << 3 | 2) + whole(len(content)) + content


def tensor(name: str, values: Any) -> bytes:
    array = np.asarray(values)
    kind = {"f": FLOAT, "i": INT64, "b": BOOL}[array.dtype.kind]
    array = array.astype({FLOAT: "<f4", INT64: "<i8", BOOL: "?"}[kind])
    dims = b"".join(number(1, size) for size in array.shape)
    return dims + number(2, kind) + part(8, name) + part(9, array.tobytes())


def attribute(name: str, value: Any) -> bytes:
    if isinstance(value, bytes):  # a tensor
        return part(5, part(1, name) + part(5, value) + number(20, 4))
    if isinstance(value, list):  # whole numbers
        return part(5, part(1, name) + b"".join(number(8, each) for each in value) + number(20, 7))
    if isinstance(value, tuple):  # a graph
        return part(5, part(1, name) + part(6, value[0]) + number(20, 5))
    return part(5, part(1, name) + number(3, value) + number(20, 2))


def node(kind: str, inputs: tuple[str, ...], outputs: tuple[str, ...], **more: Any) -> bytes:
    names = [part(1, each) for each in inputs] + [part(2, each) for each in outputs]
    told = b"".join(attribute(name, value) for name, value in more.items())
    return part(1, b"".join(names) + part(4, kind) + told)


def port(field: int, name: str, shape: tuple[int, ...] | None, kind: int = FLOAT) -> bytes:
    told = number(1, kind)
    if shape is not None:
        sizes = (number(1, size) if size >= 0 else part(2, f"any{-size}") for size in shape)
        told += part(2, b"".join(part(1, size) for size in sizes))
    return part(field, part(1, name) + part(2, part(1, told)))


def graph(nodes: bytes, ports: bytes, tensors: tuple[bytes, ...] = ()) -> bytes:
    return nodes + part(2, "g") + b"".join(part(5, each) for each in tensors) + ports


def model(content: bytes) -> bytes:
    return number(1, 9) + part(7, content) + part(8, part(1, "") + number(2, 17))


SEEN, TOLD = (1, 5, -1, -2), (1, 9, -3, -4)
HALVED = {"strides": [2, 2]}
"""Of a convolution whose answer has half the rows and columns."""


def right(
    seen: tuple[int, ...] = SEEN, told: tuple[int, ...] = TOLD, name: str = "picture",
    most: float = 1.0,
) -> bytes:  # fmt: skip
    """A convolution of single pixels; with other shapes a wrong network."""
    weights = np.linspace(-most, most, told[1] * seen[1]).reshape(told[1], seen[1], 1, 1)
    ports = port(11, name, seen) + port(12, "y", told)
    made = node("Conv", (name, "w"), ("y",), **HALVED)
    return model(graph(made, ports, (tensor("w", weights),)))


def cast(kind: int) -> bytes:
    """The picture as another type."""
    ports = port(11, "picture", SEEN) + port(12, "y", SEEN, kind)
    return model(graph(node("Cast", ("picture",), ("y",), to=kind), ports))


def filled(value: float, *shape: int) -> bytes:
    """A constant of some shape, however large."""
    made = node("ConstantOfShape", ("s",), ("y",), value=tensor("v", np.array([value])))
    ports = port(11, "picture", SEEN) + port(12, "y", shape)
    return model(graph(made, ports, (tensor("s", np.array(shape, dtype=int)),)))


def loop(*, always: bool) -> bytes:
    """A network whose loop has no end: always, or where a picture is brighter than black."""
    inner = node("Identity", ("c",), ("c2",)) + node("Identity", ("v",), ("v2",))
    ports = port(11, "i", (), INT64) + port(11, "c", (), BOOL) + port(11, "v", None)
    ports += port(12, "c2", (), BOOL) + port(12, "v2", None)
    most = node("ReduceMax", ("picture",), ("m",), keepdims=0)
    go = most + node("Greater", ("m", "zero"), ("go",))
    first = b"" if always else go
    body = first + node("Loop", ("n", "yes" if always else "go", "picture"), ("last",),
                        body=(graph(inner, ports),))  # fmt: skip
    body += node("Conv", ("last", "w"), ("y",), **HALVED)
    weights = np.zeros((9, 5, 1, 1))
    tensors = (tensor("n", np.array(2**62)), tensor("yes", np.array(True)),
               tensor("zero", np.array(0.0)), tensor("w", weights))  # fmt: skip
    return model(graph(body, port(11, "picture", SEEN) + port(12, "y", TOLD), tensors))
