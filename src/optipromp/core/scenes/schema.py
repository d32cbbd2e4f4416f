"""The schema of a scene file, as pydantic models."""

from __future__ import annotations

import functools
import operator
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry.shapes import PRIMITIVES
from optipromp.core.robots.tools import TOOLS
from optipromp.core.scenes.goal_models import GoalModel, LinesModel, PathModel
from optipromp.core.scenes.models import (
    Argument,
    Model,
    NotNegative,
    Number,
    Positive,
    Quaternion,
    Sizes,
    Text,
    Vector,
    refuse,
)
from optipromp.core.scenes.objects import Role
from optipromp.core.scenes.values import suggest
from optipromp.core.shown import short

Frame = Literal["world", "base", "camera"]


class _OneOf(Model):
    """A mapping with exactly one of its keys."""

    @model_validator(mode="after")
    def _exactly_one(self) -> _OneOf:
        given = [name for name in type(self).model_fields if name in self.model_fields_set]
        if len(given) != 1:
            raise refuse(
                f"has {' and '.join(given) or 'no key'}: must have exactly one of "
                f"{', '.join(type(self).model_fields)}"
            )
        if getattr(self, given[0]) is None:
            raise refuse(f"{given[0]} is empty: must be a mapping")
        return self


class MeshModel(Model):
    """A mesh file; ``scale`` turns its unit into metres."""

    file: Text
    scale: Positive = 1.0


class PointCloudModel(Model):
    """A point cloud file; ``scale`` turns its unit into metres."""

    file: Text
    radius: Positive
    scale: Positive = 1.0


def _sizes_model(shape: type) -> type[Model]:
    """The model of a shape without a file: each of its sizes, above 0."""
    kinds: dict[Any, Any] = {"float": Positive, float: Positive}
    keys: dict[str, Any] = {x.name: (kinds.get(x.type, Sizes), ...) for x in fields(shape)}
    return create_model(f"{shape.__name__}Model", __base__=Model, **keys)


if TYPE_CHECKING:
    ShapeModel = _OneOf
else:
    _shapes = {name: _sizes_model(shape) for name, shape in PRIMITIVES.items()}
    _shapes |= {"mesh": MeshModel, "point_cloud": PointCloudModel}
    ShapeModel = create_model(
        "ShapeModel", __base__=_OneOf, **{k: (model | None, None) for k, model in _shapes.items()}
    )


class PoseModel(Model):
    """The pose of a frame in the world; see :class:`optipromp.core.scenes.pose.Pose`."""

    position: Vector
    orientation: Quaternion | None = None


class StemModel(Model):
    """A stem: straight to a root, or along a direction, or a polyline, fruit first; or unseen."""

    root: Vector | None = None
    direction: Vector | None = None
    length: Positive | None = None
    points: Annotated[list[Vector], Field(min_length=2)] | None = None
    radius: Positive | None = None
    parent: Text | None = None
    tilt: NotNegative | None = None
    unseen: bool = False

    @model_validator(mode="after")
    def _one_form(self) -> StemModel:
        forms = [self.root, self.direction, self.points]
        if self.unseen:
            if self.root is not None or self.points is not None or self.parent is not None:
                raise refuse("is unseen: may have direction, length, tilt and radius alone")
            return self
        if sum(form is not None for form in forms) != 1:
            raise refuse("must have exactly one of root, direction (with length), points")
        if self.direction is not None and self.length is None:
            raise refuse("has direction and no length: must have both")
        if self.length is not None and self.direction is None:
            raise refuse("has length and no direction: length goes with direction")
        return self


class MotionModel(Model):
    """See :class:`optipromp.core.scenes.objects.ObjectMotion`."""

    times: Annotated[list[Number], Field(min_length=2)]
    positions: Annotated[list[Vector], Field(min_length=2)]


class ObjectModel(Model):
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
    physical: dict[Text, Number] = Field(default_factory=dict)
    velocity: Vector | None = None
    motion: MotionModel | None = None

    @model_validator(mode="after")
    def _one_uncertainty(self) -> ObjectModel:
        if self.covariance is not None and self.sigma is not None:
            raise refuse("has covariance and sigma: must have one of them at most")
        if self.velocity is not None and self.motion is not None:
            raise refuse("has velocity and motion: must have one of them at most")
        return self


class AttachedModel(Model):
    """A shape that moves with the tool; see :class:`optipromp.core.scenes.held.Attached`."""

    id: Text
    shape: ShapeModel
    position: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    orientation: Quaternion | None = None
    mass: Positive | None = None


class PlaceModel(Model):
    """Where the target is brought; see :class:`optipromp.core.scenes.held.Place`."""

    position: Vector
    axis: Vector
    retreat: Positive | None = None


class ApproachModel(Model):
    """The target frame; see :class:`optipromp.core.scenes.scene.Approach`."""

    direction: Vector | None = None
    lateral: Vector | None = None
    camera_distance: Positive | None = None
    cone: NotNegative | None = None
    aside: NotNegative | None = None
    shift: Vector | None = None
    lead: Vector | None = None


class MountModel(Model):
    """The pose of a tool in the flange frame."""

    position: Vector = Field(default_factory=lambda: [0.0, 0.0, 0.0])
    orientation: Quaternion = Field(default_factory=lambda: [1.0, 0.0, 0.0, 0.0])


class _ToolModel(Model):
    """The tool on the flange; its keys are the parameters of the class of its kind."""

    kind: Text
    mount: MountModel | None = None

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        own = [name for name in cls.model_fields if name != "kind"]
        for key in data:
            if key not in cls.model_fields:
                which = suggest(key, own) if own else "it takes none"
                raise refuse(f"{key} is no parameter of {data['kind']}: {which}")
        return data

    @property
    def given(self) -> dict[str, Any]:
        """The parameters in the file."""
        return self.model_dump(exclude={"kind", "mount"}, exclude_none=True)


class MeshToolModel(_ToolModel):
    """See :class:`optipromp.core.robots.mesh_tool.MeshTool`; ``scale`` is for the mesh files."""

    kind: Literal["mesh"]
    file: Text | None = None
    parts: Annotated[list[Text], Field(min_length=1)] | None = None
    fingers: Annotated[list[Text], Field(min_length=2)] | None = None
    scale: Positive = 1.0
    tool_point: Vector
    tool_axis: Vector | None = None
    opening: Positive | None = None
    height: Positive | None = None

    @model_validator(mode="after")
    def _one_form(self) -> MeshToolModel:
        given = [self.file is not None, self.parts is not None]
        if sum(given) != 1 and not (self.fingers is not None and not any(given)):
            raise refuse("must have exactly one of file, parts; with fingers, at most one")
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


class RobotModel(Model):
    """A robot by its file; see :class:`optipromp.core.robots.library.Choice`."""

    file: Text
    arm: Text | None = None
    tip: Text | None = None
    base: Text | None = None
    srdf: Text | None = None
    hold: dict[Text, Number] = Field(default_factory=dict)
    package_dirs: list[Text] = Field(default_factory=list)
    args: dict[Text, Argument] = Field(default_factory=dict)


class OptionsModel(Model):
    """Settings of the planners that belong to a scene."""

    camera_point: bool | None = None
    drift_offset: NotNegative | dict[Text, NotNegative] | None = None


def _points(given: Any) -> Any:
    """A list of way points as the mapping that holds them."""
    return {"points": given} if isinstance(given, list) else given


class SceneModel(Model):
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
    goal: (
        Annotated[
            Annotated[GoalModel, Tag("one")]
            | Annotated[list[GoalModel], Field(min_length=1), Tag("several")],
            Discriminator(lambda given: "several" if isinstance(given, list) else "one"),
        ]
        | None
    ) = None
    path: PathModel | None = None
    waypoints: Annotated[LinesModel, BeforeValidator(_points)] | None = None
    base: PoseModel | None = None
    camera: PoseModel | None = None
    frame: Frame = "world"
    approach: ApproachModel = ApproachModel()
    options: OptionsModel = OptionsModel()
    objects: list[ObjectModel] = Field(default_factory=list)
    attached: list[AttachedModel] = Field(default_factory=list)
    may_touch: list[Annotated[list[Text], Field(min_length=2, max_length=2)]] = Field(
        default_factory=list
    )
    padding: NotNegative = 0.0
    place: PlaceModel | None = None

    @model_validator(mode="after")
    def _camera_is_known(self) -> SceneModel:
        stated: dict[str, Frame | None] = {"frame": self.frame}
        stated |= {f"objects[{k}].frame": item.frame for k, item in enumerate(self.objects)}
        for name, frame in stated.items():
            if frame == "camera" and self.camera is None:
                raise refuse(
                    f"{name} is 'camera' and the scene has no camera: give its pose in the world, "
                    "camera: {position: [x, y, z], orientation: [w, x, y, z]}"
                )
        return self


def parse(document: Any, source: str) -> SceneModel:
    """Check a document against the schema.

    ``document``: the content of the file, as plain Python values. ``source``: the name of the
    document in messages, usually the file.
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
        if n == 1 and error["loc"][0] in ("robot", "tool", "goal"):
            continue  # the kind of robot, tool or goal, which is no key
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
        return f"{path}.kind is {short(value['kind'])}: {suggest(value['kind'], TOOLS)}"
    if kind == "literal_error":
        words = str(context["expected"]).replace(" or ", ", ").split(",")
        wanted = suggest(value, [word.strip().strip("'") for word in words])
    return f"{path} is {short(value)}: {wanted or error['msg']}"
