"""Docstrings as mkdocstrings reads them: cross-references and formulas, written for Sphinx there.

An extension of Griffe, named in ``mkdocs.yml``. ``:class:`Name``` becomes a link where the
reference shows ``Name`` and code elsewhere; ``:math:`` becomes MathML, which browsers draw.
"""

import re
from typing import Any

import griffe
from latex2mathml.converter import convert

ROLE = re.compile(r":(?:class|func|mod|data|attr|meth):`~?([^`]+)`")
INLINE = re.compile(r":math:`([^`]+)`")
BLOCK = re.compile(r"^( *)\.\. math:: (.+(?:\n\1 +\S.*)*)", re.MULTILINE)
ESCAPED = {"*": "&#42;", "_": "&#95;", "`": "&#96;", "\\": "&#92;"}  # Markdown reads these
SPACED = re.compile(r"\s+")


def mathml(formula: str, display: str) -> str:
    """MathML of a formula in LaTeX, ``inline`` or ``block``, which Markdown leaves as it is."""
    drawn = convert(SPACED.sub(" ", formula).strip(), display=display)
    return "".join(ESCAPED.get(letter, letter) for letter in drawn)


def link(obj: griffe.Object, name: str) -> str:
    """A link to what ``name`` is in the scope of ``obj``, if the reference shows it."""
    try:
        target = obj.resolve(name.lstrip("."))
    except griffe.NameResolutionError:
        target = name
    code = f"<code>{name.lstrip('.').rpartition('.')[2]}</code>"
    return f'<autoref identifier="{target}" optional>{code}</autoref>'


def rewritten(text: str, obj: griffe.Object) -> str:
    """A docstring in Markdown."""
    text = BLOCK.sub(lambda m: f'{m[1]}<span class="formula">{mathml(m[2], "block")}</span>', text)
    text = INLINE.sub(lambda m: f"<span>{mathml(m[1], 'inline')}</span>", text)
    return ROLE.sub(lambda m: link(obj, SPACED.sub("", m[1])), text)


class SphinxMarkup(griffe.Extension):
    """Rewrites every docstring as it is loaded."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Rewrite one."""
        if obj.docstring:
            obj.docstring.value = rewritten(obj.docstring.value, obj)
