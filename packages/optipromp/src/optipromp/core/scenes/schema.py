"""The description of a scene file: each value with its type, its unit and its frame.

A :class:`Value` says what a value is. A :func:`form` is a mapping of such values: a pydantic model
that checks a file, and from which :func:`values` reads numbers in metres and in the base's frame.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationError,
    create_model,
    model_validator,
)
from pydantic_core import ErrorDetails

from optipromp.core import values as checks
from optipromp.core.errors import LONGEST_NAME, InvalidSceneError, short, suggest
from optipromp.core.geometry.shapes import PRIMITIVES
from optipromp.core.robots.tools import TOOLS
from optipromp.core.scenes.objects import Role
from optipromp.core.scenes.pose import Pose
from optipromp.core.values import Name, NotNegative, Positive, fault

refuse = functools.partial(checks.refuse, at=":")  # the name of a value stands before it
Number = float
Text = Name
Sizes = Annotated[list[Positive], Field(min_length=3, max_length=3)]
Vector = Annotated[list[Number], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[Number], Field(min_length=4, max_length=4)]
Argument = bool | int | float | Annotated[str, Field(max_length=LONGEST_NAME)]
Frame = Literal["world", "base", "camera"]


def _free(given: Any) -> Any:
    """An empty list for ``free``, which is no list in a file."""
    if isinstance(given, str) or given == []:
        if given != "free":
            raise refuse(f"is {short(given)}: must be [x, y, z] or free")
        return []
    if isinstance(given, list) and len(given) != 3:
        raise refuse(f"has {len(given)} entries: must have 3")
    return given


@dataclass(frozen=True)
class Value:
    """What a value of a scene file is."""

    type: Any  # its type, with limits, as pydantic checks it; a form, for a mapping
    metres: int = 0  # power of the file's ``scale`` that turns it into metres
    # how it changes from one frame to another; "": not at all
    frame: Literal["", "point", "direction"] = ""
    default: Any = None  # where the file lacks it; ``...``: the file must state it

    def read(self, value: Any, scale: float, frame: Pose | None) -> Any:
        """The value in metres and in the frame in which its own has the pose ``frame``."""
        if isinstance(value, dict):
            return {name: self.read(one, scale, frame) for name, one in value.items()}
        if isinstance(value, list) and not value:
            return None  # an axis that is free
        if self.frame or (self.metres and isinstance(value, list)):
            value = np.array(value)
        value = scale**self.metres * value if self.metres else value
        if frame is None or not self.frame:
            return value
        return frame @ value if self.frame == "point" else frame.rotation @ value


POINT = Value(Vector, 1, "point")
DIRECTION = Value(Vector, 0, "direction")
SPAN = Value(Vector, 1, "direction")
AXIS = Value(Annotated[list[Number], BeforeValidator(_free)], 0, "direction")
TURN = Value(Quaternion)
LENGTH = Value(Positive, 1)
DISTANCE = Value(NotNegative, 1)
NAME = Value(Text)


def _text_or(mapping: Any) -> Any:
    """The type of a text, or of a mapping in its place."""
    return Annotated[
        Annotated[Text, Tag("name")] | Annotated[mapping, Tag("file")],
        Discriminator(lambda given: "file" if isinstance(given, dict) else "name"),
    ]


class Model(BaseModel):
    """Base of mappings, which refuse unknown keys by name."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

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


_KINDS: dict[type[Model], Mapping[str, Value]] = {}


def form(check: Callable[[Any], Any] | None = None, /, **kinds: Value) -> Any:
    """A mapping with values of these kinds; ``check`` refuses values that do not go together."""
    keys: dict[str, Any] = {
        name: (kind.type | None, None) if kind.default is None else (kind.type, kind.default)
        for name, kind in kinds.items()
    }
    more = {} if check is None else {"check": model_validator(mode="after")(check)}
    made = create_model("Form", __base__=Model, __validators__=more, **keys)  # type: ignore[arg-type]
    _KINDS[made] = kinds
    return made


def needed(kind: Value) -> Value:
    """A value that the file must state."""
    return replace(kind, default=...)


def values(given: Any, scale: float, frame: Pose | None = None) -> dict[str, Any]:
    """The values that a mapping states, by their names; see :meth:`Value.read`."""
    read = {
        name: kind.read(value, scale, frame)
        for name, kind in _KINDS[type(given)].items()
        if (value := getattr(given, name)) is not None
    }
    return {name: value for name, value in read.items() if value is not None}


# -- shapes ----------------------------------------------------------------------------------


def _exactly_one(model: Any) -> Any:
    """Refuse a mapping without exactly one of its keys."""
    stated = [name for name in type(model).model_fields if name in model.model_fields_set]
    if len(stated) != 1:
        raise refuse(
            f"has {' and '.join(stated) or 'no key'}: must have exactly one of "
            f"{', '.join(type(model).model_fields)}"
        )
    if getattr(model, stated[0]) is None:
        raise refuse(f"{stated[0]} is empty: must be a mapping")
    return model


def _sizes(shape: type) -> Value:
    """A shape without a file: each of its sizes, above 0."""
    kinds = {"float": LENGTH, float: LENGTH}
    return Value(
        form(**{x.name: needed(kinds.get(x.type, Value(Sizes, 1))) for x in fields(shape)})
    )


FILE_SCALE = Value(Positive, default=1.0)  # turns the unit of a mesh or of a cloud into metres
SHAPE = form(
    _exactly_one,
    **{name: _sizes(shape) for name, shape in PRIMITIVES.items()},
    mesh=Value(form(file=needed(NAME), scale=FILE_SCALE)),
    point_cloud=Value(form(file=needed(NAME), radius=needed(LENGTH), scale=FILE_SCALE)),
)

# -- objects ---------------------------------------------------------------------------------


def _stem(stem: Any) -> Any:
    """A stem is straight to a root, or along a direction, or a polyline, fruit first; or unseen."""
    forms = [stem.root, stem.direction, stem.points]
    if stem.unseen:
        if stem.root is not None or stem.points is not None or stem.parent is not None:
            raise refuse("is unseen: may have direction, length, tilt and radius alone")
        return stem
    if sum(one is not None for one in forms) != 1:
        raise refuse("must have exactly one of root, direction (with length), points")
    if stem.direction is not None and stem.length is None:
        raise refuse("has direction and no length: must have both")
    if stem.length is not None and stem.direction is None:
        raise refuse("has length and no direction: length goes with direction")
    return stem


def _object(item: Any) -> Any:
    for one, other in (("covariance", "sigma"), ("velocity", "motion")):
        if getattr(item, one) is not None and getattr(item, other) is not None:
            raise refuse(f"has {one} and {other}: must have one of them at most")
    return item


POLYLINE = Value(Annotated[list[Vector], Field(min_length=2)], 1)
POSE = form(position=needed(POINT), orientation=TURN)
STEM = form(
    _stem, root=POINT, direction=DIRECTION, length=LENGTH, points=POLYLINE, radius=LENGTH,
    parent=NAME, tilt=Value(NotNegative), unseen=Value(bool, default=False),
)  # fmt: skip
MOTION = form(
    times=needed(Value(Annotated[list[Number], Field(min_length=2)])), positions=needed(POLYLINE)
)
OBJECT = form(
    _object,
    id=needed(NAME),
    role=needed(Value(Role)),
    shape=needed(Value(SHAPE)),
    frame=Value(Frame),
    position=needed(POINT),
    orientation=TURN,
    stem=Value(STEM),
    covariance=Value(Annotated[list[Vector], Field(min_length=3, max_length=3)], 2),
    sigma=DISTANCE,
    padding=DISTANCE,
    physical=Value(dict[Text, Number], default={}),
    velocity=SPAN,
    motion=Value(MOTION),
)
ATTACHED = form(
    id=needed(NAME),
    shape=needed(Value(SHAPE)),
    position=replace(POINT, default=[0.0, 0.0, 0.0]),
    orientation=TURN,
    mass=Value(Positive),
)

# -- goals -----------------------------------------------------------------------------------


def _turn(pose: Any) -> Any:
    """Refuse a pose unless it has exactly one of axis and orientation."""
    if (pose.axis is None) == (pose.orientation is None):
        both = "axis and orientation" if pose.axis is not None else "position alone"
        raise refuse(
            f"has {both}: must have one of axis: [x, y, z], the tool axis; orientation: "
            "[w, x, y, z], of the tool's frame; axis: free, where the tool may point anywhere"
        )
    return pose


def _goal(goal: Any) -> Any:
    """A goal is of the joints, or of the tool: its point, and its axis, orientation or neither."""
    if (goal.joints is None) == (goal.position is None):
        raise refuse("must have either joints, or position with axis or orientation")
    if goal.joints is None:
        return _turn(goal)
    for name in ("axis", "orientation", "tolerance"):
        if getattr(goal, name) is not None:
            raise refuse(f"has joints and {name}: {name} goes with position")
    return goal


def _path(path: Any) -> Any:
    if path.upright is None and path.plane is None:
        raise refuse("must have upright, plane or both")
    return path


def as_list(given: Any) -> Any:
    """A single value as a list of it."""
    return given if isinstance(given, list) else [given]


JOINTS = Value(Annotated[list[Number], Field(min_length=1)])
TOLERANCE = form(
    position=Value(Annotated[list[Positive], BeforeValidator(as_list)], 1),
    angle=Value(Positive),
    orientation=TURN,
)
GOAL = form(
    _goal, joints=JOINTS, position=POINT, axis=AXIS, orientation=TURN, tolerance=Value(TOLERANCE)
)
WAYPOINT = form(_turn, position=needed(POINT), axis=AXIS, orientation=TURN)
LINES = form(
    points=needed(Value(Annotated[list[WAYPOINT], Field(min_length=1)])),  # type: ignore[valid-type]
    speed=LENGTH,
    within=LENGTH,
)
PATH = form(
    _path,
    upright=Value(form(angle=needed(Value(Positive)), axis=Value(Vector), direction=DIRECTION)),
    plane=Value(form(point=needed(POINT), normal=needed(DIRECTION), within=needed(LENGTH))),
)
PLACE = form(position=needed(POINT), axis=needed(DIRECTION), retreat=LENGTH)
APPROACH = form(
    direction=DIRECTION, lateral=DIRECTION, camera_distance=LENGTH, cone=Value(NotNegative),
    aside=DISTANCE, shift=SPAN, lead=DIRECTION, truss=Value(bool),
)  # fmt: skip
OPTIONS = form(
    camera_point=Value(bool), drift_offset=Value(NotNegative | dict[Text, NotNegative], 1)
)

# -- robot and tool --------------------------------------------------------------------------


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
    """See :class:`optipromp.core.robots.grippers.MeshTool`; ``scale`` is for the mesh files."""

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
        required = item.default is MISSING
        keys[item.name] = (Number, ...) if required else (Number | None, None)
    return create_model(f"Model of {kind}", __base__=_ToolModel, **keys)


if TYPE_CHECKING:
    ToolModel = _ToolModel
else:
    _models = [MeshToolModel if kind == "mesh" else _tool_model(kind) for kind in TOOLS]
    ToolModel = Annotated[functools.reduce(operator.or_, _models), Field(discriminator="kind")]

ROBOT = form(
    file=needed(NAME),
    arm=NAME,
    tip=NAME,
    base=NAME,
    srdf=NAME,
    hold=Value(dict[Text, Number], default={}),
    package_dirs=Value(list[Text], default=[]),
    args=Value(dict[Text, Argument], default={}),
)

# -- the scene -------------------------------------------------------------------------------


def _points(given: Any) -> Any:
    """A list of way points as the mapping that holds them."""
    return {"points": given} if isinstance(given, list) else given


def _camera_is_known(scene: Any) -> Any:
    stated = {"frame": scene.frame}
    stated |= {f"objects[{k}].frame": item.frame for k, item in enumerate(scene.objects)}
    for name, frame in stated.items():
        if frame == "camera" and scene.camera is None:
            raise refuse(
                f"{name} is 'camera' and the scene has no camera: give its pose in the world, "
                "camera: {position: [x, y, z], orientation: [w, x, y, z]}"
            )
    return scene


_ONE_GOAL = Annotated[GOAL, Tag("one")]  # type: ignore[valid-type]
_GOALS = Annotated[list[GOAL], Field(min_length=1), Tag("several")]  # type: ignore[valid-type]
SCENE = form(
    _camera_is_known,
    format=Value(Literal[1], default=1),
    name=needed(NAME),
    robot=needed(Value(_text_or(ROBOT))),
    tool=Value(ToolModel),
    scale=Value(Positive),
    start=JOINTS,
    target=NAME,
    crop=Value(_text_or(dict[str, Any])),
    goal=Value(
        Annotated[
            _ONE_GOAL | _GOALS,
            Discriminator(lambda given: "several" if isinstance(given, list) else "one"),
        ]
    ),
    path=Value(PATH),
    waypoints=Value(Annotated[LINES, BeforeValidator(_points)]),
    base=Value(POSE),
    camera=Value(POSE),
    frame=Value(Frame, default="world"),
    approach=Value(APPROACH, default=APPROACH()),
    options=Value(OPTIONS, default=OPTIONS()),
    objects=Value(list[OBJECT], default=[]),  # type: ignore[valid-type]
    unseen=Value(OBJECT),
    attached=Value(list[ATTACHED], default=[]),  # type: ignore[valid-type]
    may_touch=Value(list[Annotated[list[Text], Field(min_length=2, max_length=2)]], default=[]),
    padding=Value(NotNegative, 1, default=0.0),
    place=Value(PLACE),
)


def parse(document: Any, source: str, schema: Any = SCENE) -> Any:
    """Check a document against the schema, by default of a scene.

    ``document``: the content of the file, as plain Python values. ``source``: the name of the
    document in messages, usually the file.
    """
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        details = error.errors(include_url=False)
        more = f" (and {len(details) - 1} more)" if len(details) > 1 else ""
        raise InvalidSceneError(f"{source}: {_describe(details[0])}{more}") from None
    except RecursionError:
        raise InvalidSceneError(f"{source}: nested too deep") from None


def _describe(error: ErrorDetails) -> str:
    path = ""
    for n, step in enumerate(error["loc"]):
        if n == 1 and error["loc"][0] in ("robot", "tool", "goal", "crop"):
            continue  # the kind of robot, tool, goal or crop, which is no key
        path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else str(step)
    value, kind = error["input"], error["type"]
    if kind == "union_tag_not_found":
        return f"{path}.kind is missing: valid are {', '.join(TOOLS)}"
    if kind == "union_tag_invalid":
        return f"{path}.kind is {short(value['kind'])}: {suggest(value['kind'], TOOLS)}"
    if kind == "model_attributes_type":
        return f"{path} is {short(value)}: must be a mapping with kind and parameters"
    return fault(path, value, [error])
