"""XML files as trees of elements, without entities."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers.expat import ExpatError, ParserCreate

from optipromp.core.errors import InvalidRobotError
from optipromp.core.files import LARGEST_TEXT, read_bytes

_XACRO = re.compile(r"\$\{[^}]*\}?|\$\([^)]*\)?")


@dataclass(frozen=True)
class Node:
    """An element: tag, attributes, line in the file (from 1), child elements and text in order."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list["Node"] = field(default_factory=list)
    text: list[str] = field(default_factory=list)


def read_xml(path: Path, content: bytes | None = None) -> Node:
    """The root element of the XML file at ``path``, in any encoding of XML.

    ``content`` is read in place of the file's content.
    """
    content = read_bytes(path, InvalidRobotError, LARGEST_TEXT) if content is None else content
    if not content.strip():
        raise InvalidRobotError(f"{path}: the file is empty; a URDF starts with <robot>")
    parser, opened = ParserCreate(), [Node("", {}, 0)]  # the root's parent

    def refuse(what: str) -> NoReturn:
        raise InvalidRobotError(f"{path}:{parser.CurrentLineNumber}: {what}")

    def start(tag: str, attributes: dict[str, str]) -> None:
        if tag.startswith("xacro:"):
            refuse(f"<{tag}> is unexpanded xacro; expand the file first (xacro FILE > robot.urdf)")
        for key, value in attributes.items():
            if found := _XACRO.search(value):
                refuse(
                    f'<{tag}> {key}="{value}" holds the unexpanded xacro expression '
                    f"{found.group()}; expand the file first"
                )
        opened.append(Node(tag, attributes, parser.CurrentLineNumber))
        opened[-2].children.append(opened[-1])

    def entities(*_: object) -> NoReturn:
        refuse("declares or refers to XML entities; a URDF needs none, and they are refused")

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: opened.pop()
    parser.CharacterDataHandler = lambda text: opened[-1].text.append(text)
    parser.EntityDeclHandler = parser.UnparsedEntityDeclHandler = entities
    parser.ExternalEntityRefHandler = parser.SkippedEntityHandler = entities
    try:
        parser.Parse(content, True)
    except ExpatError as error:
        where = f"{path}:{error.lineno}:{error.offset}"
        raise InvalidRobotError(f"{where}: not well-formed XML: {error}") from error
    except (ValueError, LookupError) as error:  # an encoding that does not exist or does not fit
        raise InvalidRobotError(f"{path}: not readable as XML: {error}") from error
    return opened[0].children[0]
