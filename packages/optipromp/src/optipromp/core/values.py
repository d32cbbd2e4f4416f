"""How values are checked: limits stand beside a field, and one translator tells what is wrong.

A class that derives from :class:`Validated` states in the annotation of a field what it may be::

    speed: Annotated[float | None, Gt(0.0), Unit("m/s")] = None
    points: Annotated[FloatArray, Array(None, 3)]

Limits and units are those of ``annotated_types``; pydantic checks them. Numbers are finite unless
their unit says ``or inf``. A bool is no number, nor is a text; a whole number is a float.
"""

import functools
import math
import operator
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from types import EllipsisType, UnionType
from typing import Annotated, Any, ClassVar, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
from annotated_types import Ge, Gt, Le, Lt, Unit
from numpy.typing import ArrayLike
from pydantic import AfterValidator, AllowInfNan, TypeAdapter
from pydantic import ValidationError as ValidationError
from pydantic.errors import PydanticSchemaGenerationError
from pydantic_core import ErrorDetails, PydanticCustomError, SchemaValidator, core_schema

from optipromp.core.arrays import FloatArray, frozen, read_only
from optipromp.core.errors import (
    InvalidRequestError,
    OptiPrompError,
    is_name,
    no_name,
    short,
    suggest,
)

_HOLDING: tuple[Any, ...] = tuple, Mapping, dict
NO_LIMIT = "or inf"  # in the unit of a number that may be infinite


def refuse(what: str, at: str = "") -> PydanticCustomError:
    """The refusal of a value by a validator, in words that follow its name and ``at``."""
    return PydanticCustomError("refused", "{at} {what}", {"at": at, "what": what})


class Array:
    """In an annotation: a read-only array of finite numbers, of a shape (None: any size; ...: any).

    ``most``: largest size of a number. ``order``: of its memory, as NumPy names it.
    """

    def __init__(
        self,
        *shape: int | EllipsisType | None,
        most: float = np.inf,
        order: Literal["C", "K"] = "C",
    ) -> None:
        self.shape, self.most, self.order = shape, most, order
        self._sized = [(axis, n) for axis, n in enumerate(shape) if n not in (None, ...)]
        self._sure = min(most * most, sys.float_info.max)

    def read(self, values: ArrayLike) -> FloatArray:
        """The ``values`` as such an array, or else :func:`refuse`."""
        try:
            array = read_only(np.array(values, dtype=np.float64, order=self.order))
        except (TypeError, ValueError, OverflowError):
            raise refuse(f"is {values!r:.60}: must be finite numbers") from None
        fits = array.ndim == len(self.shape) and all(array.shape[k] == n for k, n in self._sized)
        if not fits and self.shape != (...,):
            letters = iter("ikn"[-self.shape.count(None) :])
            wanted = ", ".join(next(letters) if n is None else str(n) for n in self.shape)
            wanted += "," * (len(self.shape) == 1)
            raise refuse(f"has shape {array.shape}: must be ({wanted})")
        if not np.vdot(array, array) <= self._sure:  # the sum of squares proves it in half the time
            wrong = ~(np.isfinite(array) & (np.abs(array) <= self.most))
            if wrong.any():
                at = tuple(int(i) for i in np.argwhere(wrong)[0])
                wanted = f"at most {self.most:g}" if np.isfinite(array[at]) else "finite"
                raise refuse(f"is {array[at]}: must be {wanted}", f"{list(at) or ''}")
        return array

    def __get_pydantic_core_schema__(self, *_: object) -> core_schema.CoreSchema:
        return core_schema.no_info_plain_validator_function(self.read)


def array(
    name: str, values: ArrayLike, *shape: int | EllipsisType | None, most: float = np.inf,
    order: Literal["C", "K"] = "C", error: type[OptiPrompError] = InvalidRequestError,
) -> FloatArray:  # fmt: skip
    """``values`` as an :class:`Array`; ``name`` begins the ``error``."""
    return read_by(Array(*shape, most=most, order=order).read, name, values, error)


def direction(values: ArrayLike) -> FloatArray:
    """``values`` (3,) normalised; a validator, which refuses a length of 0."""
    vector = Array(3).read(values)
    length = math.hypot(*vector)
    if not length > 0.0:
        raise refuse(f"is {vector.tolist()}: must have a direction")
    return frozen(vector / length)


def read_by(
    read: Callable[[ArrayLike], FloatArray], name: str, values: ArrayLike,
    error: type[OptiPrompError],
) -> FloatArray:  # fmt: skip
    """What a validator makes of ``values``; ``name`` begins the ``error``."""
    try:
        return read(values)
    except PydanticCustomError as cause:
        raise error(f"{name}{cause.message()}") from None


def _named(text: str) -> str:
    if not is_name(text):
        raise refuse(f"is {no_name(text)}")
    return text


Name = Annotated[str, AfterValidator(_named)]
Positive = Annotated[float, Gt(0.0)]
NotNegative = Annotated[float, Ge(0.0)]
Part = Annotated[float, Ge(0.0), Le(1.0)]
Count = Annotated[int, Gt(0)]
Unlimited = Annotated[float, Unit(f"1 {NO_LIMIT}")]


class Validated:
    """Base of dataclasses whose fields are checked, and replaced by what they are taken for.

    Keywords of a class, which its subclasses inherit: ``error``, the type of the error of a
    refusal; ``label``, what stands before the name of a field in it; ``largest``, the largest size
    of a number whose annotation states no narrower limit.
    """

    _error: ClassVar[type[OptiPrompError]] = InvalidRequestError
    _label: ClassVar[str] = ""
    _largest: ClassVar[float] = np.inf

    def __init_subclass__(cls, **keywords: Any) -> None:
        super().__init_subclass__()
        for name, value in keywords.items():
            setattr(cls, f"_{name}", value)

    def __post_init__(self, label: str | None = None) -> None:
        """Check the fields. Raises an ``error`` that names field, value, and what is right."""
        kind: type = type(self)
        form, given = _form_of(kind), vars(self)
        try:
            given.update(form.validator.validate_python(given))
        except ValidationError:
            given.update(form.read(given, self._error, self._label if label is None else label))

    @classmethod
    def _limited(cls, name: str, hint: Any) -> Any:
        """The annotation of a field with the limits that its class sets; by default none."""
        return hint


def fitted(kind: type, given: dict[str, Any]) -> dict[str, Any]:
    """Values of fields of any dataclass, by name, as the annotations of the fields say."""
    return given | _form_of(kind).read(given, InvalidRequestError, "")


def value(
    name: str, given: Any, hint: Any, error: type[OptiPrompError] = InvalidRequestError
) -> Any:
    """A value as an annotation ``hint`` says; ``name`` begins the ``error``."""
    return _form_of_value(hint).read({"": given}, error, name)[""]


class _Form:
    """Names and annotations of values, and what checks them."""

    def __init__(self, hints: Mapping[str, Any], largest: float = np.inf) -> None:
        form = {
            name: core_schema.typed_dict_field(_schema(_checked(hint, largest)), required=False)
            for name, hint in hints.items()
        }
        config = core_schema.CoreConfig(strict=True, allow_inf_nan=False)
        self.hints = hints
        self.validator = SchemaValidator(core_schema.typed_dict_schema(form, config=config))

    def read(
        self, given: dict[str, Any], error: type[OptiPrompError], label: str
    ) -> dict[str, Any]:
        """The values of some names as their annotations say; else the ``error``."""
        try:
            read: dict[str, Any] = self.validator.validate_python(given)
            return read
        except ValidationError:
            given = {name: _plain(one) for name, one in given.items()}
        try:
            read = self.validator.validate_python(given)
        except ValidationError as cause:
            found = cause.errors(include_url=False)
            name = str(found[0]["loc"][0])
            alike = [one for one in found if one["loc"][0] == name]
            raise error(label + _told(alike, given, self.hints[name])) from None
        return read


@functools.cache
def _form_of(kind: type) -> _Form:
    hints = hints_of(kind)
    if not issubclass(kind, Validated):
        return _Form(hints)
    hints = {name: kind._limited(name, hint) for name, hint in hints.items()}
    return _Form(hints, kind._largest)


@functools.cache
def _form_of_value(hint: Any) -> _Form:
    return _Form({"": hint})


def _plain(value: Any) -> Any:
    """A NumPy number as one of Python, and a list, an array or an iterator as a tuple."""
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return tuple(map(_plain, value)) if isinstance(value, list | tuple | Iterator) else value


@functools.cache
def hints_of(kind: Any) -> dict[str, Any]:
    """The annotations of the fields of a class; none where they name types that are not known."""
    try:
        hints = get_type_hints(kind, include_extras=True)
    except NameError:
        return {}
    return {item.name: hints[item.name] for item in fields(kind)}


def _schema(hint: Any) -> core_schema.CoreSchema:
    """What pydantic checks of a type: nothing of one that it does not know."""
    try:
        return TypeAdapter(hint).core_schema
    except PydanticSchemaGenerationError:
        return core_schema.any_schema()


def _checked(hint: Any, most: float) -> Any:
    """A type as pydantic is to check it, numbers to ``most``: of an object, its class alone."""
    kind, args = get_origin(hint), get_args(hint)
    if kind is Annotated:
        free = any(isinstance(one, Unit) and NO_LIMIT in one.unit for one in args[1:])
        inner = _checked(args[0], np.inf if free else most)
        return Annotated[(inner, *args[1:], *[AllowInfNan(True)] * free)]
    if kind in (UnionType, Union):
        return functools.reduce(operator.or_, (_checked(one, most) for one in args))
    if kind in _HOLDING:
        return kind[tuple(one if one is ... else _checked(one, most) for one in args)]
    if hint in (int, float):
        return Annotated[hint, Ge(-most), Le(most)] if most < np.inf else hint
    if getattr(hint, "_is_protocol", False):  # slow to check, and what has its members will do
        return Any
    plain = hint in (bool, str, object, Any, type(None)) or kind is not None
    return hint if plain or not isinstance(hint, type) else Annotated[hint, _Instance(hint)]


class _Instance:
    """In an annotation: an object of a class, whose fields are not looked at."""

    def __init__(self, kind: type) -> None:
        self.kind = kind

    def __get_pydantic_core_schema__(self, *_: object) -> core_schema.CoreSchema:
        return core_schema.is_instance_schema(self.kind)


def notes(hint: Any) -> Iterator[Any]:
    """The metadata of an annotation and of its parts."""
    if get_origin(hint) is Annotated:
        yield from hint.__metadata__
    for one in get_args(hint):
        yield from notes(one)


def _told(found: Sequence[ErrorDetails], given: Any, hint: Any) -> str:
    """What is wrong with a value of a field, in words; of a union, what is wrong deepest in it."""
    places = [_place(one, given) for one in found]
    deepest = max(depth for _, _, depth in places)
    path, value, _ = next(place for place in places if place[2] == deepest)
    found = [one for one, (*_, depth) in zip(found, places, strict=True) if depth == deepest]
    if found[0]["type"] == "missing":  # in a tuple
        return f"{path} has {len(value)} entries: must have {int(found[-1]['loc'][-1]) + 1}"
    return fault(path, value, found, list(notes(hint)))


def _place(error: ErrorDetails, value: Any) -> tuple[str, Any, int]:
    """Name, value and depth of what an error is about; its ``loc`` names types of a union too."""
    path, depth = "", 0
    for step in error["loc"]:
        if isinstance(value, Mapping) and step in value:
            path += f".{step}" if path else str(step)
        elif isinstance(value, tuple) and isinstance(step, int) and step < len(value):
            path += f"[{step}]"
        elif step == "[key]":
            key = error["loc"][-2]
            path = f"{path.removesuffix(f'.{key}')} {key!r}"
            continue
        else:
            continue
        value, depth = value[step], depth + 1
    return path, value, depth


_NUMERIC = re.compile(r"\s*[-+]?[\d.]+([eE][-+]?\d+)?\s*")
_WORDS = {
    "finite_number": "finite",
    "float_type": "a number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "text: put it in quotes",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "a mapping",
    "mapping_type": "a mapping",
}
_LIMITS: dict[str, tuple[type, str, str]] = {
    "greater_than": (Gt, "gt", "above"),
    "greater_than_equal": (Ge, "ge", "at least"),
    "less_than": (Lt, "lt", "below"),
    "less_than_equal": (Le, "le", "at most"),
}


def fault(name: str, value: Any, found: Sequence[ErrorDetails], notes: Sequence[Any] = ()) -> str:
    """What is wrong with a value, in words: its name, the value, what must be, and the unit.

    ``found``: errors of the value, of which one must be mended. ``notes``: the metadata of its
    type.
    """
    kind, context = found[0]["type"], found[0].get("ctx", {})
    if kind == "refused":
        return f"{name}{found[0]['msg']}".lstrip(": ")
    if kind == "missing":
        return f"{name} is missing"
    if kind in ("too_short", "too_long"):
        most, key = ("least", "min_length") if kind == "too_short" else ("most", "max_length")
        count = len(value) if isinstance(value, list | tuple) else "other"
        return f"{name} has {count} entries: must have at {most} {context[key]}"
    if kind == "literal_error":
        words = str(context["expected"]).replace(" or ", ", ").replace("'", "").split(", ")
        return f"{name} is {short(value)}: {suggest(value, words)}"
    wanted = " or ".join(dict.fromkeys(_wanted(one, value, notes) for one in found))
    units = [one.unit for one in notes if isinstance(one, Unit) and one.unit not in ("", "1")]
    return f"{name} is {short(value)}: must be {wanted}{f' [{units[0]}]' if units else ''}"


def _wanted(error: ErrorDetails, value: Any, notes: Sequence[Any]) -> str:
    kind, context = error["type"], error.get("ctx", {})
    if kind in _LIMITS:
        limits = {}
        for name, (limit, key, words) in _LIMITS.items():
            stated = [getattr(one, key) for one in notes if isinstance(one, limit)]
            for number in stated or ([context[key]] if name == kind else []):
                limits[words] = number
        if limits.keys() == {"at least", "at most"}:
            return f"{limits['at least']:g} to {limits['at most']:g}"
        return " and ".join(f"{words} {limit:g}" for words, limit in limits.items())
    if kind == "is_instance_of":
        return f"a {context['class']}"
    if kind == "float_type" and isinstance(value, str) and _NUMERIC.fullmatch(value):
        return "a number, without quotes"
    return _WORDS.get(kind, error["msg"])
