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
from typing import Annotated, Any, ClassVar, Literal, Self

from annotated_types import Ge, Unit

from optipromp.core.errors import InvalidRequestError, unknown
from optipromp.core.values import Validated

GRAVITY = 9.81  # [m/s²]
FRUIT_DENSITY = 950.0  # [kg/m³] reported: strawberries float barely: 0.9-1.0 g/cm³
Kind = Literal["measured", "reported", "published", "guess", "choice"]


def parameter(default: Any, unit: str, kind: Kind, source: str) -> Any:
    """A dataclass field with a default, a unit, a kind and a source."""
    metadata = {"unit": unit, "kind": kind, "source": source}
    if isinstance(default, dict):
        return field(default_factory=lambda: dict(default), metadata=metadata)
    return field(default=default, metadata=metadata)


class Settings(Validated):
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

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__(**({"label": f"{cls.__name__}."} | keywords))

    @classmethod
    def _limited(cls, name: str, hint: Any) -> Any:
        """A number as one that is not negative, unless it is signed, with its unit."""
        unit = cls.__dataclass_fields__[name].metadata.get("unit", "")
        above = [Ge(0)] if hint in (int, float) and name not in cls.signed else []
        return Annotated[hint, *above, Unit(unit)]


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
