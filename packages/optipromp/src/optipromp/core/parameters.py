"""Parameters: numbers with their unit and origin.

A group of parameters is a frozen dataclass. Each field has ``unit``, ``source`` and ``kind`` as
metadata (:func:`catalogue` lists them):

- ``measured``: by the people that the source names, or by us on what the source names;
- ``reported``: a usual value of the harvesting literature, not traced to a measurement;
- ``published``: by a manufacturer or by the author of a model or method;
- ``guess``: our value of a plausible size; vary it before you rely on it;
- ``choice``: a setting of a model, a solver or a judge, not a property of nature.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from typing import Any, ClassVar, Literal, Self

import numpy as np

from optipromp.core.errors import InvalidRequestError, unknown

GRAVITY = 9.81  # [m/s²]
Kind = Literal["measured", "reported", "published", "guess", "choice"]


def parameter(default: Any, unit: str, kind: Kind, source: str) -> Any:
    """A dataclass field with a default, a unit, a kind and a source."""
    metadata = {"unit": unit, "kind": kind, "source": source}
    if isinstance(default, dict):
        return field(default_factory=lambda: dict(default), metadata=metadata)
    return field(default=default, metadata=metadata)


class Settings:
    """Base of dataclasses that users make by keyword: an unknown name is refused as wrong input."""

    def __new__(cls, *_: object, **given: object) -> Self:
        """Check the keywords, before the dataclass reads them."""
        names = [item.name for item in fields(cls) if item.init]  # type: ignore[arg-type]
        for name in given:
            if name not in names:
                raise InvalidRequestError(
                    f"{cls.__name__} has no setting {name!r}: {unknown(name, names)}"
                )
        return super().__new__(cls)


@dataclass(frozen=True)
class Checked(Settings):
    """Base of groups whose numbers must be finite (or infinite if the unit says so) and, unless
    they are ``signed``, not negative."""

    signed: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if isinstance(value, bool) or not isinstance(value, int | float):
                continue
            unlimited = "or inf" in item.metadata.get("unit", "")
            if not (np.isfinite(value) or (unlimited and value == np.inf)) or (
                value < 0 and item.name not in self.signed
            ):
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
    """The parameters of a dataclass of groups, by their dotted names."""
    for group in fields(parameters):
        branch = getattr(parameters, group.name)
        assert is_dataclass(branch)
        for item in fields(branch):
            yield Parameter(
                f"{group.name}.{item.name}", getattr(branch, item.name), **item.metadata
            )
