"""The numbers of the push models: each says its unit and origin, and the docs list them."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.pushing.parameters import PUSH

ROOT = Path(__file__).resolve().parents[4]
SCRIPT = runpy.run_path(str(ROOT / "scripts" / "parameters.py"))


def test_the_docs_list_every_number_with_its_value_unit_and_source() -> None:
    page = (ROOT / "docs" / "push-parameters.md").read_text(encoding="utf-8")
    assert page == SCRIPT["push_page"](), "run scripts/parameters.py"
    assert page.count("| `") == sum(len(group) for group in PUSH)


def test_a_number_cannot_be_changed_and_is_not_below_zero() -> None:
    with pytest.raises(AttributeError):
        PUSH.beam.diameter = 1.0  # type: ignore[misc]
    for number in SCRIPT["numbers"]():
        assert number.source, number.name
        assert np.isfinite(number.value).all(), number.name
        assert (np.array(number.value) >= 0.0).all(), number.name
