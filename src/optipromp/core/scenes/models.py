"""What the models of scene files share: values, and mappings that refuse unknown keys."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from optipromp.core.scenes.values import suggest
from optipromp.core.shown import LONGEST_NAME, printable, short


def refuse(what: str) -> PydanticCustomError:
    """The refusal of a value, in words that follow its name."""
    return PydanticCustomError("scene", "{what}", {"what": what})


def _printable(text: str) -> str:
    if printable(text) != text:
        raise refuse(f"is '{printable(text)[:60]}': must hold no control characters")
    return text


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Text = Annotated[
    str, Field(strict=True, min_length=1, max_length=LONGEST_NAME), AfterValidator(_printable)
]
Sizes = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[Number], Field(min_length=4, max_length=4)]
Argument = (
    Annotated[bool, Field(strict=True)]
    | Annotated[int, Field(strict=True)]
    | Number
    | Annotated[str, Field(strict=True, max_length=LONGEST_NAME), AfterValidator(_printable)]
)


class Model(BaseModel):
    """Base of mappings, which refuse unknown keys by name."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            raise refuse(
                f"is {short(data)}: must be a mapping with keys {', '.join(cls.model_fields)}"
            )
        for key in data:
            if key not in cls.model_fields:
                raise refuse(f"unknown key {key!r}: {suggest(key, cls.model_fields)}")
        return data
