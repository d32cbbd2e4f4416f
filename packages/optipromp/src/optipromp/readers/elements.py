"""XML files as trees of elements, without entities."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.sax.handler import ContentHandler
from xml.sax.xmlreader import AttributesImpl, Locator

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


class _Builder(ContentHandler):
    """Builds the tree without recursion."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path = path
        self.root: Node | None = None
        self.open: list[Node] = []
        self.locator: Locator | None = None

    def setDocumentLocator(self, locator: Locator) -> None:
        self.locator = locator

    def startElement(self, name: str, attrs: AttributesImpl) -> None:
        line = (self.locator.getLineNumber() if self.locator is not None else None) or 0
        if name.startswith("xacro:"):
            raise InvalidRobotError(
                f"{self.path}:{line}: <{name}> is unexpanded xacro; expand the file first "
                "(xacro robot.urdf.xacro > robot.urdf)"
            )
        attributes = {key: str(attrs.getValue(key)) for key in attrs.getNames()}
        for key, value in attributes.items():
            found = _XACRO.search(value)
            if found:
                raise InvalidRobotError(
                    f'{self.path}:{line}: <{name}> {key}="{value}" holds the unexpanded xacro '
                    f"expression {found.group()}; expand the file first"
                )
        node = Node(name, attributes, line)
        if self.open:
            self.open[-1].children.append(node)
        else:
            self.root = node
        self.open.append(node)

    def characters(self, content: str) -> None:
        self.open[-1].text.append(content)

    def endElement(self, name: str) -> None:
        self.open.pop()


def read_xml(path: Path, content: bytes | None = None) -> Node:
    """The root element of the XML file at ``path``, in any encoding of XML.

    ``content`` is read in place of the file's content.
    """
    from xml.sax import SAXParseException

    import defusedxml.sax
    from defusedxml.common import DefusedXmlException

    content = read_bytes(path, InvalidRobotError, LARGEST_TEXT) if content is None else content
    if not content.strip():
        raise InvalidRobotError(f"{path}: the file is empty; a URDF starts with <robot>")
    builder = _Builder(path)
    try:
        defusedxml.sax.parseString(content, builder)
    except DefusedXmlException as error:
        raise InvalidRobotError(
            f"{path}: declares or refers to XML entities ({type(error).__name__}); "
            "a URDF needs none, and they are refused"
        ) from error
    except SAXParseException as error:
        raise InvalidRobotError(
            f"{path}:{error.getLineNumber()}:{error.getColumnNumber()}: not well-formed XML: "
            f"{error.getMessage()}"
        ) from error
    except (ValueError, LookupError) as error:  # an encoding that does not exist or does not fit
        raise InvalidRobotError(f"{path}: not readable as XML: {error}") from error
    if builder.root is None:
        raise InvalidRobotError(f"{path}: holds no XML element")
    return builder.root
