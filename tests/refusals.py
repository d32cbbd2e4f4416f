"""What every refusal is: one line that names what is wrong."""

from collections.abc import Callable, Collection
from typing import Any

import pytest

from optipromp.core.errors import OptiPrompError


def assert_refused(
    kind: type[OptiPrompError], words: str | Collection[str], call: Callable[..., Any], /,
    *given: Any, **named: Any,
) -> None:  # fmt: skip
    """A call raises an error of a ``kind``, whose message is one line that holds all ``words``."""
    with pytest.raises(kind) as caught:
        call(*given, **named)
    told = caught.value.message
    assert "\n" not in told
    for word in [words] if isinstance(words, str) else words:
        assert word in told
