"""Reading YAML and JSON text into plain values, with none of YAML 1.1's surprises.

Numbers, booleans and null read as in YAML 1.2: ``1e-3`` is a number, ``no`` and ``1:30`` are text.
Duplicate keys, which the readers of both formats ignore, are refused.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, ClassVar

import yaml

from optipromp.errors import OptiPrompError

_MOST_VALUES = 20_000_000
_Base: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_Base):  # type: ignore[misc]
    """The safe loader with YAML 1.2's core schema."""

    yaml_implicit_resolvers: ClassVar[dict[str, list[tuple[str, re.Pattern[str]]]]] = {}

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.constructor.ConstructorError(
                    None, None, "a key must be text", key.start_mark
                )
            if key.value in seen and key.tag != "tag:yaml.org,2002:merge":
                raise yaml.constructor.ConstructorError(
                    None, None, f"key {key.value!r} stands twice", key.start_mark
                )
            seen.add(key.value)
        mapping: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        return mapping


for _tag, _pattern, _first in (
    ("bool", r"true|True|TRUE|false|False|FALSE", "tTfF"),
    ("null", r"~|null|Null|NULL|", ["~", "n", "N", ""]),
    ("int", r"[-+]?[0-9]+", "-+0123456789"),
    (
        "float",
        r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)",
        "-+0123456789.",
    ),
    ("merge", r"<<", "<"),
):
    _Loader.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(f"^(?:{_pattern})$"), list(_first)
    )
# YAML 1.1 reads 010 as octal and 1e-3 as text; both are decimal numbers here.
_Loader.add_constructor(
    "tag:yaml.org,2002:int", lambda loader, node: int(loader.construct_scalar(node))
)


def _construct_float(loader: Any, node: yaml.ScalarNode) -> float:
    text = str(loader.construct_scalar(node)).lower()
    return float(text.replace(".inf", "inf").replace(".nan", "nan"))


_Loader.add_constructor("tag:yaml.org,2002:float", _construct_float)


def read_document(path: Path, error: type[OptiPrompError], holds: str) -> Any:
    """Read a YAML or (by suffix ``.json``) JSON file into plain values.

    Args:
        path: of the file.
        error: raised where it cannot be read.
        holds: what the file must hold, in words.

    Raises:
        OptiPrompError: of the type given: the file is missing, empty, binary, truncated or
            malformed; the message names it, the line and what is wrong.
    """
    try:
        text = _decode(path.read_bytes(), holds)
        if not text.strip():
            raise ValueError(f"is empty: must hold {holds}")
        return _read_json(text) if path.suffix == ".json" else _read_yaml(text)
    except OSError as cause:
        what = f"cannot be read: {cause.strerror or cause}"
    except json.JSONDecodeError as cause:
        what = f"line {cause.lineno}: {cause.msg}"
    except yaml.MarkedYAMLError as cause:
        mark = cause.problem_mark or cause.context_mark
        line = f"line {min(mark.line + 1, len(text.splitlines()))}: " if mark is not None else ""
        what = f"{line}{cause.problem or cause.context or 'not YAML'}"
    except yaml.YAMLError as cause:
        what = " ".join(str(cause).split())
    except RecursionError:
        what = "nested too deep"
    except (ValueError, OverflowError) as cause:
        what = str(cause)
    raise error(f"{path}: {what}")


def _decode(data: bytes, holds: str) -> str:
    utf16 = data[:2] in (b"\xff\xfe", b"\xfe\xff")
    at = -1 if utf16 else data.find(b"\0")
    if at < 0:
        try:
            return data.decode("utf-16" if utf16 else "utf-8-sig")
        except UnicodeDecodeError as error:
            at = error.start
    line = data.count(b"\n", 0, at) + 1
    raise ValueError(
        f"line {line}: byte 0x{data[at]:02x} is no text: must be {holds}, as YAML or JSON in UTF-8"
    )


def _read_json(text: str) -> Any:
    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        mapping = dict(items)
        if len(mapping) < len(items):
            names = [name for name, _ in items]
            twice = next(name for name in names if names.count(name) > 1)
            raise ValueError(f"key {twice!r} stands twice")
        return mapping

    return json.loads(text, object_pairs_hook=pairs)


def _read_yaml(text: str) -> Any:
    document = yaml.load(text, Loader=_Loader)  # a safe loader
    if "&" in text and "*" in text:
        _check_aliases(document)
    return document


def _check_aliases(document: Any) -> None:
    """Refuse a document that holds itself, or aliases that unfold without bound."""
    sizes: dict[int, int] = {}
    open_: set[int] = set()

    def size(value: Any) -> int:
        if not isinstance(value, dict | list):
            return 1
        key = id(value)
        if key in open_:
            raise ValueError("an alias holds itself: must not")
        if key not in sizes:
            open_.add(key)
            children = value.values() if isinstance(value, dict) else value
            sizes[key] = 1 + sum(size(child) for child in children)
            open_.discard(key)
        return sizes[key]

    count = size(document)
    if count > _MOST_VALUES:
        raise ValueError(f"aliases unfold to {count} values: must be at most {_MOST_VALUES}")
