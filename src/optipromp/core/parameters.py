"""Numbers with their unit and origin: the form of every tuned number of the library.

A group of them is a frozen dataclass. Each field carries ``unit``, ``source`` and ``kind`` as
metadata (:func:`catalogue` lists them):

- ``measured``: by the people the source names, or by us where it says on what;
- ``reported``: a size that the harvesting literature gives again and again; we did not trace it to
  one measurement;
- ``published``: a manufacturer's or a model author's figure, or the method's;
- ``guess``: ours, of a plausible size; vary it before you rely on it;
- ``choice``: of a model, a solver or a judge, not of nature.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, Literal

import numpy as np

from optipromp.core.errors import InvalidRequestError

GRAVITY = 9.81  # [m/s²]
Kind = Literal["measured", "reported", "published", "guess", "choice"]


def parameter(default: Any, unit: str, kind: Kind, source: str) -> Any:
    """A field of a group: its default, unit, kind and where it comes from."""
    metadata = {"unit": unit, "kind": kind, "source": source}
    if isinstance(default, dict):
        return field(default_factory=lambda: dict(default), metadata=metadata)
    return field(default=default, metadata=metadata)


@dataclass(frozen=True)
class Checked:
    """Refuses numbers that are not finite or below zero (infinite where the unit allows)."""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                continue
            unlimited = "or inf" in item.metadata.get("unit", "")
            if not (np.isfinite(value) or (unlimited and value == np.inf)) or value < 0:
                raise InvalidRequestError(
                    f"{type(self).__name__}.{item.name} is {value}; it must be finite and not "
                    f"negative [{item.metadata.get('unit', '')}]"
                )


@dataclass(frozen=True)
class Parameter:
    """One parameter as :func:`catalogue` lists it."""

    name: str
    value: Any
    unit: str
    kind: Kind
    source: str


def catalogue(parameters: Any) -> Iterator[Parameter]:
    """Every number of a dataclass of groups by its dotted name, with unit, kind and source."""
    for group in fields(parameters):
        branch = getattr(parameters, group.name)
        assert is_dataclass(branch)
        for item in fields(branch):
            meta = item.metadata
            yield Parameter(
                f"{group.name}.{item.name}", getattr(branch, item.name),
                meta["unit"], meta["kind"], meta["source"],
            )  # fmt: skip
