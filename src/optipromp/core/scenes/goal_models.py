"""The models of the goals in a scene file, and of the path to them."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from optipromp.core.scenes.models import Model, Number, Positive, Quaternion, Vector, refuse
from optipromp.core.shown import short


def _free(given: Any) -> Any:
    """An empty list for ``free``, which is no list in a file."""
    if isinstance(given, str) or given == []:
        if given != "free":
            raise refuse(f"is {short(given)}: must be [x, y, z] or free")
        return []
    return given


def _three(given: list[float]) -> list[float]:
    if len(given) not in (0, 3):
        raise refuse(f"has {len(given)} entries: must have 3")
    return given


Axis = Annotated[list[Number], BeforeValidator(_free), AfterValidator(_three)]


def _turn(axis: list[float] | None, orientation: list[float] | None) -> None:
    """Refuse a pose unless it has exactly one of axis and orientation."""
    if (axis is None) == (orientation is None):
        both = "axis and orientation" if axis is not None else "position alone"
        raise refuse(
            f"has {both}: must have one of axis: [x, y, z], the tool axis; orientation: "
            "[w, x, y, z], of the tool's frame; axis: free, where the tool may point anywhere"
        )


def _number_or_list(given: Any) -> Any:
    return given if isinstance(given, list) else [given]


class ToleranceModel(Model):
    """How far the tool may end from a goal; see :class:`optipromp.core.scenes.goals.RegionGoal`."""

    position: Annotated[list[Positive], BeforeValidator(_number_or_list)] | None = None
    angle: Positive | None = None
    orientation: Quaternion | None = None


class GoalModel(Model):
    """A goal of the joints, or of the tool: its point, and its axis, orientation or neither."""

    joints: Annotated[list[Number], Field(min_length=1)] | None = None
    position: Vector | None = None
    axis: Axis | None = None
    orientation: Quaternion | None = None
    tolerance: ToleranceModel | None = None

    @model_validator(mode="after")
    def _one_form(self) -> GoalModel:
        if (self.joints is None) == (self.position is None):
            raise refuse("must have either joints, or position with axis or orientation")
        if self.joints is not None:
            for name in ("axis", "orientation", "tolerance"):
                if getattr(self, name) is not None:
                    raise refuse(f"has joints and {name}: {name} goes with position")
        else:
            _turn(self.axis, self.orientation)
        return self


class WaypointModel(Model):
    """A pose of the tool before the goal; see :class:`optipromp.core.scenes.lines.Lines`."""

    position: Vector
    axis: Axis | None = None
    orientation: Quaternion | None = None

    @model_validator(mode="after")
    def _one_form(self) -> WaypointModel:
        _turn(self.axis, self.orientation)
        return self


class LinesModel(Model):
    """See :class:`optipromp.core.scenes.lines.Lines`."""

    points: Annotated[list[WaypointModel], Field(min_length=1)]
    speed: Positive | None = None
    within: Positive | None = None


class UprightModel(Model):
    """See :class:`optipromp.core.scenes.goals.HeldUpright`."""

    angle: Positive
    axis: Vector | None = None
    direction: Vector | None = None


class PlaneModel(Model):
    """See :class:`optipromp.core.scenes.goals.OnPlane`."""

    point: Vector
    normal: Vector
    within: Positive


class PathModel(Model):
    """What the tool keeps on its whole way to a goal."""

    upright: UprightModel | None = None
    plane: PlaneModel | None = None

    @model_validator(mode="after")
    def _something(self) -> PathModel:
        if self.upright is None and self.plane is None:
            raise refuse("must have upright, plane or both")
        return self
