"""The schema of a scene file, as pydantic models."""

from __future__ import annotations

import functools
import operator
import reprlib
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails, PydanticCustomError

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry.shapes import PRIMITIVES
from optipromp.core.robots.tools import TOOLS
from optipromp.core.scenes.objects import Role
from optipromp.core.scenes.values import suggest
from optipromp.core.shown import LONGEST_NAME, printable


def _refuse(what: str) -> PydanticCustomError:
    return PydanticCustomError("scene", "{what}", {"what": what})


def _printable(text: str) -> str:
    if printable(text) != text:
        raise _refuse(f"is '{printable(text)[:60]}': must hold no control characters")
    return text


_SHORT = reprlib.Repr()
_SHORT.maxstring = _SHORT.maxother = 60

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Positive = Annotated[float, Field(strict=True, allow_inf_nan=False, gt=0.0)]
NotNegative = Annotated[float, Field(strict=True, allow_inf_nan=False, ge=0.0)]
Text = Annotated[
    str, Field(strict=True, min_length=1, max_length=LONGEST_NAME), AfterValidator(_printable)
]
Sizes = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[Number], Field(min_length=4, max_length=4)]
Frame = Literal["world", "base", "camera"]


class _Model(BaseModel):
    """Base of mappings, which refuse unknown keys by name."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        if not isinstance(data, dict):
            raise _refuse(
                f"is {_short(data)}: must be a mapping with keys {', '.join(cls.model_fields)}"
            )
        for key in data:
            if key not in cls.model_fields:
                raise _refuse(f"unknown key {key!r}: {suggest(key, cls.model_fields)}")
        return data


class _OneOf(_Model):
    """A mapping with exactly one of its keys."""

    @model_validator(mode="after")
    def _exactly_one(self) -> _OneOf:
        given = [name for name in type(self).model_fields if name in self.model_fields_set]
        if len(given) != 1:
            raise _refuse(
                f"has {' and '.join(given) or 'no key'}: must have exactly one of "
                f"{', '.join(type(self).model_fields)}"
            )
        if getattr(self, given[0]) is None:
            raise _refuse(f"{given[0]} is empty: must be a mapping")
        return self


class MeshModel(_Model):
    """A mesh file; ``scale`` turns its unit into metres."""

    file: Text
    scale: Positive = 1.0


class PointCloudModel(_Model):
    """A point cloud file; ``scale`` turns its unit into metres."""

    file: Text
    radius: Positive
    scale: Positive = 1.0


def _sizes_model(shape: type) -> type[_Model]:
    """The model of a shape without a file: each of its sizes, above 0."""
    kinds: dict[Any, Any] = {"float": Positive, float: Positive}
    keys: dict[str, Any] = {x.name: (kinds.get(x.type, Sizes), ...) for x in fields(shape)}
    return create_model(f"{shape.__name__}Model", __base__=_Model, **keys)


if TYPE_CHECKING:
    ShapeModel = _OneOf
else:
    _shapes = {name: _sizes_model(shape) for name, shape in PRIMITIVES.items()}
    _shapes |= {"mesh": MeshModel, "point_cloud": PointCloudModel}
    ShapeModel = create_model(
        "ShapeModel", __base__=_OneOf, **{k: (model | None, None) for k, model in _shapes.items()}
    )


class PoseModel(_Model):
    """The pose of a frame in the world; see :class:`optipromp.core.scenes.pose.Pose`."""

    position: Vector
    orientation: Quaternion | None = None


class StemModel(_Model):
    """A stem: straight to a root, or along a direction, or a polyline, fruit first."""

    root: Vector | None = None
    direction: Vector | None = None
    length: Positive | None = None
    points: Annotated[list[Vector], Field(min_length=2)] | None = None
    radius: Positive | None = None
    parent: Text | None = None

    @model_validator(mode="after")
    def _one_form(self) -> StemModel:
        forms = [self.root, self.direction, self.points]
        if sum(form is not None for form in forms) != 1:
            raise _refuse("must have exactly one of root, direction (with length), points")
        if self.direction is not None and self.length is None:
            raise _refuse("has direction and no length: must have both")
        if self.length is not None and self.direction is None:
            raise _refuse("has length and no direction: length goes with direction")
        return self


class ObjectModel(_Model):
    """One object."""

    id: Text
    role: Role
    shape: ShapeModel
    frame: Frame | None = None
    position: Vector
    orientation: Quaternion | None = None
    stem: StemModel | None = None
    covariance: Annotated[list[Vector], Field(min_length=3, max_length=3)] | None = None
    sigma: NotNegative | None = None
    padding: NotNegative | None = None
    physical: dict[Text, Number] = {}

    @model_validator(mode="after")
    def _one_uncertainty(self) -> ObjectModel:
        if self.covariance is not None and self.sigma is not None:
            raise _refuse("has covariance and sigma: must have one of them at most")
        return self


class AttachedModel(_Model):
    """A shape that moves with the tool; see :class:`optipromp.core.scenes.held.Attached`."""

    id: Text
    shape: ShapeModel
    position: Vector = [0.0, 0.0, 0.0]
    orientation: Quaternion | None = None
    mass: Positive | None = None


class PlaceModel(_Model):
    """Where the target is brought; see :class:`optipromp.core.scenes.held.Place`."""

    position: Vector
    axis: Vector
    retreat: Positive | None = None


class ApproachModel(_Model):
    """The target frame; see :class:`optipromp.core.scenes.scene.Approach`."""

    direction: Vector | None = None
    lateral: Vector | None = None
    camera_distance: Positive | None = None
    cone: NotNegative | None = None
    aside: NotNegative | None = None
    shift: Vector | None = None
    lead: Vector | None = None


class GoalModel(_Model):
    """A goal of the joints, or of the tool point and the tool axis."""

    joints: Annotated[list[Number], Field(min_length=1)] | None = None
    position: Vector | None = None
    axis: Vector | None = None

    @model_validator(mode="after")
    def _one_form(self) -> GoalModel:
        if (self.joints is None) == (self.position is None):
            raise _refuse("must have either joints, or position (and axis)")
        if self.joints is not None and self.axis is not None:
            raise _refuse("has joints and axis: axis goes with position")
        return self


class _ToolModel(_Model):
    """The tool on the flange; its keys are the parameters of the class of its kind."""

    kind: Text

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        own = [name for name in cls.model_fields if name != "kind"]
        for key in data:
            if key not in cls.model_fields:
                which = suggest(key, own) if own else "it takes none"
                raise _refuse(f"{key} is no parameter of {data['kind']}: {which}")
        return data

    @property
    def given(self) -> dict[str, Any]:
        """The parameters in the file."""
        return self.model_dump(exclude={"kind"}, exclude_none=True)


class MeshToolModel(_ToolModel):
    """See :class:`optipromp.core.robots.mesh_tool.MeshTool`; ``scale`` is for the mesh files."""

    kind: Literal["mesh"]
    file: Text | None = None
    parts: Annotated[list[Text], Field(min_length=1)] | None = None
    scale: Positive = 1.0
    tool_point: Vector
    tool_axis: Vector | None = None
    opening: Positive | None = None
    height: Positive | None = None

    @model_validator(mode="after")
    def _one_form(self) -> MeshToolModel:
        if (self.file is None) == (self.parts is None):
            raise _refuse("must have exactly one of file, parts")
        return self


def _tool_model(kind: str) -> type[_ToolModel]:
    """The model of a tool whose parameters are numbers; their ranges are checked by its class."""
    keys: dict[str, Any] = {"kind": (Literal[kind], ...)}
    for item in fields(TOOLS[kind]):  # type: ignore[arg-type]
        needed = item.default is MISSING
        keys[item.name] = (Number, ...) if needed else (Number | None, None)
    return create_model(f"Model of {kind}", __base__=_ToolModel, **keys)


if TYPE_CHECKING:
    ToolModel = _ToolModel
else:
    _models = [MeshToolModel if kind == "mesh" else _tool_model(kind) for kind in TOOLS]
    ToolModel = Annotated[functools.reduce(operator.or_, _models), Field(discriminator="kind")]


class RobotModel(_Model):
    """A robot by its file; see :class:`optipromp.core.robots.library.Choice`."""

    file: Text
    tip: Text | None = None
    base: Text | None = None
    srdf: Text | None = None
    hold: dict[Text, Number] = {}
    package_dirs: list[Text] = []


class OptionsModel(_Model):
    """Settings of the planners that belong to a scene."""

    camera_point: bool | None = None
    drift_offset: NotNegative | dict[Text, NotNegative] | None = None


class SceneModel(_Model):
    """A whole scene file."""

    format: Literal[1] = 1
    name: Text
    robot: Annotated[
        Annotated[Text, Tag("name")] | Annotated[RobotModel, Tag("file")],
        Discriminator(lambda given: "file" if isinstance(given, dict) else "name"),
    ]
    tool: ToolModel | None = None
    scale: Positive | None = None
    start: Annotated[list[Number], Field(min_length=1)] | None = None
    target: Text | None = None
    goal: GoalModel | None = None
    base: PoseModel | None = None
    camera: PoseModel | None = None
    frame: Frame = "world"
    approach: ApproachModel = ApproachModel()
    options: OptionsModel = OptionsModel()
    objects: list[ObjectModel] = []
    attached: list[AttachedModel] = []
    may_touch: list[Annotated[list[Text], Field(min_length=2, max_length=2)]] = []
    padding: NotNegative = 0.0
    place: PlaceModel | None = None

    @model_validator(mode="after")
    def _camera_is_known(self) -> SceneModel:
        stated: dict[str, Frame | None] = {"frame": self.frame}
        stated |= {f"objects[{k}].frame": item.frame for k, item in enumerate(self.objects)}
        for name, frame in stated.items():
            if frame == "camera" and self.camera is None:
                raise _refuse(
                    f"{name} is 'camera' and the scene has no camera: give its pose in the world, "
                    "camera: {position: [x, y, z], orientation: [w, x, y, z]}"
                )
        return self


def parse(document: Any, source: str) -> SceneModel:
    """Check a document against the schema.

    Args:
        document: the content of the file, as plain Python values.
        source: the name of the document in messages, usually the file.

    Raises:
        InvalidSceneError: the document does not fit the schema; one line with source, field, value
            and what would be right.
    """
    try:
        return SceneModel.model_validate(document)
    except ValidationError as error:
        details = error.errors(include_url=False)
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise InvalidSceneError(f"{source}: {_describe(details[0])}{more}") from None
    except RecursionError:
        raise InvalidSceneError(f"{source}: nested too deep") from None


def _describe(error: ErrorDetails) -> str:
    path = ""
    for n, step in enumerate(error["loc"]):
        if n == 1 and error["loc"][0] in ("robot", "tool"):
            continue  # the kind of robot or tool, which is no key
        path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else str(step)
    value = error["input"]
    context = error.get("ctx", {})
    kind = error["type"]
    if kind == "scene":
        return f"{path}: {context['what']}" if path else str(context["what"])
    if kind == "missing":
        return f"{path} is missing"
    if kind in ("too_short", "too_long"):
        field = "min_length" if kind == "too_short" else "max_length"
        length = len(value) if isinstance(value, list) else "other"
        least = "at least " if kind == "too_short" else "at most "
        return f"{path} has {length} entries: must have {least}{context[field]}"
    wanted = {
        "finite_number": "must be finite",
        "float_type": "must be a number" + (", without quotes" if isinstance(value, str) else ""),
        "greater_than": f"must be above {context.get('gt', 0):g}",
        "greater_than_equal": f"must be at least {context.get('ge', 0):g}",
        "string_type": "must be text" + ("" if value is None else ": put it in quotes"),
        "string_too_short": "must not be empty",
        "string_too_long": f"must have at most {context.get('max_length')} letters",
        "list_type": "must be a list",
        "dict_type": "must be a mapping",
        "model_attributes_type": "must be a mapping with kind and parameters",
    }.get(kind)
    if kind == "union_tag_not_found":
        return f"{path}.kind is missing: valid are {', '.join(TOOLS)}"
    if kind == "union_tag_invalid":
        return f"{path}.kind is {_short(value['kind'])}: {suggest(value['kind'], TOOLS)}"
    if kind == "literal_error":
        words = str(context["expected"]).replace(" or ", ", ").split(",")
        wanted = suggest(value, [word.strip().strip("'") for word in words])
    return f"{path} is {_short(value)}: {wanted or error['msg']}"


def _short(value: object) -> str:
    return _SHORT.repr(value)
