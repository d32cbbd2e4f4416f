"""The numbers of the push models: each says its unit and origin, and the docs list them."""

import dataclasses
from pathlib import Path

import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.parameters import catalogue
from optipromp.core.pushing.parameters import PUSH, BeamParameters

PAGE = Path(__file__).resolve().parents[2] / "docs" / "push-parameters.md"


def test_the_docs_list_every_number_with_its_value_unit_and_source() -> None:
    text = PAGE.read_text(encoding="utf-8")
    for item in catalogue(PUSH):
        values = item.value if isinstance(item.value, tuple) else (item.value,)
        shown = ", ".join(f"{value:g}" for value in values)
        row = f"| `{item.name}` | {shown} | {item.unit} | {item.kind} | {item.source} |"
        assert row in text, f"{row}: run scripts/push_parameters.py"
    assert text.count("| `") == len(list(catalogue(PUSH)))


def test_a_number_cannot_be_changed_and_is_not_below_zero() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        PUSH.beam.diameter = 1.0  # type: ignore[misc]
    with pytest.raises(InvalidRequestError, match=r"BeamParameters.diameter is -1.0"):
        BeamParameters(diameter=-1.0)
