"""YAML and JSON files as plain values, and CSV files as tables of numbers.

Numbers, booleans and null follow YAML 1.2: ``1e-3`` is a number, ``no`` and ``1:30`` are text.
Duplicate keys and tags are refused, and so are files that are larger or nested deeper than the
limits below.

YAML is read from PyYAML's events, not by its constructors: these overflow the stack of the process
on deeply nested files, and raise exceptions of any type.
"""

from __future__ import annotations

import codecs
import csv
import io
import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import yaml

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError, suggest
from optipromp.core.files import LARGEST_TEXT, is_there, read_bytes, write_atomically

_MOST_VALUES = 3_000_000  # with aliases unfolded, chosen: 100,000 objects have 1.1 million
_DEEPEST = 100  # levels of nesting, chosen: a scene has 6
_DEEP = f"nested deeper than {_DEEPEST}"
_SAID = {"exceeded maximum nesting depth": _DEEP}  # by libyaml, of 1,000 levels in brackets
_Parser: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)

_NUMBER = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WHOLE = re.compile(r"[-+]?[0-9]+")
_WORDS: dict[str, Any] = {
    word: value
    for words, value in (
        ("true True TRUE", True),
        ("false False FALSE", False),
        ("null Null NULL ~", None),
        (".nan .NaN .NAN", float("nan")),
        (".inf .Inf .INF +.inf +.Inf +.INF", float("inf")),
        ("-.inf -.Inf -.INF", float("-inf")),
    )
    for word in words.split()
} | {"": None}


def read_document(path: Path, error: type[OptiPrompError], holds: str) -> Any:
    """Read a YAML or (by suffix ``.json``) JSON file into plain values.

    ``error``: type of the error that is raised. ``holds``: the required content of the file, in
    words.
    """
    text = ""
    try:
        text = _decode(read_bytes(path, error, LARGEST_TEXT), holds)
        if not text.strip():
            raise ValueError(f"is empty: must hold {holds}")
        return _read_json(text) if path.suffix == ".json" else read_yaml(text)
    except json.JSONDecodeError as cause:
        what = f"line {cause.lineno}: {cause.msg}"
    except yaml.MarkedYAMLError as cause:
        mark = cause.problem_mark or cause.context_mark
        line = f"line {min(mark.line + 1, len(text.splitlines()))}: " if mark is not None else ""
        problem = cause.problem or cause.context or "not YAML"
        what = f"{line}{_SAID.get(problem, problem)}"
    except yaml.YAMLError as cause:
        what = " ".join(str(cause).split())
    except RecursionError:
        what = "nested too deep"
    except ValueError as cause:
        what = str(cause)
    raise error(f"{path}: {what}")


def built_in(folder: str) -> dict[str, Any]:
    """The YAML files of a folder of :mod:`optipromp.core.scenes`, by name."""
    files = (resources.files("optipromp.core.scenes") / folder).iterdir()
    return {f.name[:-5]: f for f in sorted(files, key=str) if f.name.endswith(".yaml")}


def read_named(
    name_or_path: str | Path, folder: str, error: type[OptiPrompError], holds: str
) -> tuple[Any, str, Path | None]:
    """Read a built-in document of a ``folder`` (see :func:`built_in`) by its name, or a file.

    ``error``, ``holds``: see :func:`read_document`.

    Returns: its plain value; the file in messages; the path of a file that is not built in.
    """
    known = built_in(folder)
    if isinstance(name_or_path, str) and name_or_path in known:
        with resources.as_file(known[name_or_path]) as path:
            return read_document(path, error, holds), path.name, None
    path = Path(name_or_path)
    if path.suffix not in (".yaml", ".yml", ".json") and not is_there(path):
        what = " ".join(holds.split()[:2])
        raise error(f"{what} {str(path)!r} is neither a file nor built in: {suggest(path, known)}")
    return read_document(path, error, holds), str(path), path


def write_document(document: Any, path: Path) -> None:
    """Write a plain value (JSON if the suffix is ``.json``, else YAML), whole or not at all."""
    if path.suffix == ".json":
        text = json.dumps(document, indent=2, allow_nan=False) + "\n"
    else:
        text = yaml.safe_dump(
            document, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True
        )
    write_atomically(path, text.encode("utf-8"))


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
        mapping: dict[str, Any] = {}
        for name, value in items:
            if name in mapping:
                raise ValueError(f"key {name!r} stands twice")
            mapping[name] = value
        return mapping

    if sum(map(text.count, "{[,")) > _MOST_VALUES:
        raise ValueError(f"holds more than {_MOST_VALUES} values")
    return json.loads(text, object_pairs_hook=pairs)


def read_yaml(text: str) -> Any:
    """The plain value of one YAML document."""
    reader, value, documents = _Reader(yaml.parse(text, Loader=_Parser)), None, 0
    for event in reader.events:
        if isinstance(event, yaml.DocumentStartEvent):
            documents += 1
            if documents > 1:
                refuse_event(event, "a second document: must be one")
        elif isinstance(event, yaml.NodeEvent):
            value, _ = reader.node(event, 0)
    return value


class _Reader:
    """Builds values from a parser's events, each with its number of values, aliases unfolded."""

    def __init__(self, events: Iterator[Any]) -> None:
        self.events = events
        self.anchors: dict[str, tuple[Any, int] | None] = {}  # None: not closed yet

    def node(self, event: Any, depth: int) -> tuple[Any, int]:
        """The value that begins with ``event``, at nesting ``depth``, and its number of values."""
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self.anchors:
                refuse_event(event, f"found undefined alias {event.anchor!r}")
            known = self.anchors[event.anchor]
            if known is None:
                refuse_event(event, "an alias holds itself: must not")
            return known
        if event.tag not in (None, "!"):
            refuse_event(event, f"tag {event.tag}: values must have none")
        if isinstance(event, yaml.ScalarEvent):
            plain = event.implicit[0] and not event.tag
            found = _resolved(event.value) if plain else event.value, 1
        else:
            if depth == _DEEPEST:
                refuse_event(event, _DEEP)
            if event.anchor is not None:
                self.anchors[event.anchor] = None
            mapping = isinstance(event, yaml.MappingStartEvent)
            found = (self.mapping if mapping else self.sequence)(depth + 1)
        if event.anchor is not None:
            self.anchors[event.anchor] = found
        return found

    def sequence(self, depth: int) -> tuple[Any, int]:
        out, size = [], 1
        for event in self.events:
            if isinstance(event, yaml.SequenceEndEvent):
                break
            value, more = self.node(event, depth)
            size = _sum(size, more, event)
            out.append(value)
        return out, size

    def mapping(self, depth: int) -> tuple[Any, int]:
        out: dict[str, Any] = {}
        merged: list[Any] = []
        size = 1
        for event in self.events:
            if isinstance(event, yaml.MappingEndEvent):
                break
            name, begin = self.key(event, out), next(self.events)
            value, more = self.node(begin, depth)
            size = _sum(size, more, begin)
            if name != "<<":
                out[name] = value
                continue
            merged = value if isinstance(value, list) else [value]
            if not all(isinstance(other, dict) for other in merged):
                refuse_event(begin, "<< must be a mapping, or a list of mappings")
        for other in merged:  # keys of the mapping itself, and of earlier ones, take precedence
            for name in other:
                out.setdefault(name, other[name])
        return out, size

    def key(self, event: Any, known: dict[str, Any]) -> str:
        """The text of a mapping's key."""
        if not isinstance(event, yaml.ScalarEvent):
            refuse_event(event, "a key must be text")
        if event.tag not in (None, "!"):
            refuse_event(event, f"tag {event.tag}: values must have none")
        if event.value in known:
            refuse_event(event, f"key {event.value!r} stands twice")
        if event.anchor is not None:
            self.anchors[event.anchor] = event.value, 1
        return str(event.value)


def _sum(size: int, more: int, event: Any) -> int:
    """The sum of two numbers of values; refused above :data:`_MOST_VALUES`."""
    if size + more > _MOST_VALUES:
        refuse_event(event, f"values unfold to more than {_MOST_VALUES}")
    return size + more


def _resolved(text: str) -> Any:
    if text in _WORDS:
        return _WORDS[text]
    if not _NUMBER.fullmatch(text):
        return text
    return int(text) if _WHOLE.fullmatch(text) else float(text)


def refuse_event(event: Any, what: str) -> NoReturn:
    """Refuse the document, at the line of ``event``."""
    raise yaml.MarkedYAMLError(problem=what, problem_mark=event.start_mark)


_WIDE = codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE
_SEPARATOR = re.compile(r"sep=([^\w\r\n\"])\r?\n")


@dataclass(frozen=True)
class Table:
    """A CSV file: the names of its columns, and its rows as text."""

    path: Path  # of the file
    error: type[OptiPrompError]  # type of the errors that are raised
    header: list[str]  # names of the columns
    first: int  # line number of the header
    lines: list[int]  # line number of each row
    rows: list[list[str]]  # texts, one a column

    def numbers(self, columns: Sequence[int]) -> FloatArray:
        """The numbers (R, C) in the columns of the C indices, for all R rows."""
        out = np.empty((len(self.rows), len(columns)))
        for k, row in enumerate(self.rows):
            for i, column in enumerate(columns):
                try:
                    out[k, i] = float(row[column])
                except ValueError:
                    out[k, i] = np.nan
        if not np.isfinite(out).all():
            k, i = (int(index) for index in np.argwhere(~np.isfinite(out))[0])
            raise self.error(
                f"{self.path}, line {self.lines[k]}: {self.header[columns[i]]} is "
                f"{self.rows[k][columns[i]]!r}, expected a finite number"
            )
        return out


def read_table(path: Path, error: type[OptiPrompError], wanted: str) -> Table:
    """Read a CSV file, in UTF-8, or in UTF-16 with its mark.

    A first line ``sep=;`` states the separator. Lines that begin with ``#`` are left out; the last
    is the header where numbers follow it. ``wanted`` describes the expected header in messages.
    """
    content = read_bytes(path, error, LARGEST_TEXT)
    try:
        text = content.decode("utf-16" if content[:2] in _WIDE else "utf-8-sig")
        stated = _SEPARATOR.match(text)
        lines = csv.reader(io.StringIO(text, newline=""), delimiter=stated[1] if stated else ",")
        every = [(n, row) for n, row in enumerate(lines, start=1) if row][bool(stated) :]
    except (UnicodeDecodeError, csv.Error) as cause:
        raise error(f"{path} is not a CSV file in UTF-8 or UTF-16 ({cause})") from None
    found = [each for each in every if not each[1][0].startswith("#")]
    if len(found) < len(every) and all(map(_NUMBER.fullmatch, found[0][1] if found else "x")):
        line, names = [each for each in every if each[1][0].startswith("#")][-1]
        found.insert(0, (line, [names[0].lstrip(" #"), *names[1:]]))  # as numpy.savetxt writes it
    if not found:
        raise error(f"{path} is empty; expected a header {wanted}")
    header = [name.strip() for name in found[0][1]]
    for sign, name in ((";", "semicolons"), ("\t", "tabs")):
        if len(header) == 1 and sign in header[0]:
            raise error(
                f"{path}, line {found[0][0]}: its columns are separated by {name}: must be by "
                "commas, and numbers have a decimal point; save it as CSV with commas"
            )
    for line, row in found[1:]:
        if len(row) != len(header):
            raise error(f"{path}, line {line}: {len(row)} values, the header has {len(header)}")
    numbers, rows = [line for line, _ in found[1:]], [row for _, row in found[1:]]
    return Table(path, error, header, found[0][0], numbers, rows)
