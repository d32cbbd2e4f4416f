"""Robot files: YAML beside a URDF or MJCF, with what it cannot state."""

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRobotError
from optipromp.readers.urdf import LENGTH_LIMIT, UrdfMimic

Finite = Annotated[float, Field(allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
Coordinate = Annotated[float, Field(ge=-LENGTH_LIMIT, le=LENGTH_LIMIT, allow_inf_nan=False)]
Radius = Annotated[float, Field(gt=0.0, le=LENGTH_LIMIT, allow_inf_nan=False)]

Limits = Annotated[
    list[Positive] | None, BeforeValidator(lambda stated: [] if stated == "none" else stated)
]
# acceleration of joints for which no file states a limit: choices, those of a slow arm
TURN, SLIDE = 10.0, 2.0  # [rad/s²], [m/s²]
GROWTH = 10.0  # [1/s] jerk over acceleration


class RobotFile(BaseModel):
    """The keys of a robot file; lists of numbers are in the order of the chain's joints.

    A link with an entry under ``spheres`` (also an empty list) has these spheres; every other link
    has spheres fitted to its geometry.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)
    format: Literal[1]
    name: str = Field(min_length=1)
    urdf: str = Field(min_length=1)
    flange: str | None = None  # the tip
    base: str | None = None  # joints before this link are held
    srdf: str | None = None  # its groups determine the arm
    package_dirs: list[str] = []  # folders that hold the packages of package:// names
    hold: dict[str, Finite] = {}  # values of joints that are not of the arm [rad or m]
    mimic: dict[str, UrdfMimic] = {}  # couplings of joints that the URDF or MJCF does not state
    args: dict[str, bool | int | Finite | str] = {}  # of a xacro, in place of its defaults
    scale: Positive = 1.0  # metres in one unit of length of the URDF
    velocity: list[Positive] | None = None  # overrides the URDF
    acceleration: Limits = None  # None: assumed, see TURN; empty: "none", there are no limits
    jerk: Limits = None
    home: list[Finite] | None = None
    spheres: dict[str, list[tuple[Coordinate, Coordinate, Coordinate, Radius]]] = {}
    allow_self: list[tuple[str, str]] = []


def read_robot_file(path: Path) -> RobotFile:
    """Read and check a robot file. Raises InvalidRobotError, also for unknown keys."""
    content = read_document(path, InvalidRobotError, "a robot file")
    if not isinstance(content, dict):
        raise InvalidRobotError(f"{path}: a robot file is a mapping of keys, starting 'format: 1'")
    try:
        return RobotFile.model_validate(content)
    except ValidationError as error:
        problems = "; ".join(_problem(e) for e in error.errors()[:5])
        raise InvalidRobotError(f"{path}: {problems}") from error


def _problem(error: Any) -> str:
    where = ".".join(str(part) for part in error["loc"])
    if error["type"] == "extra_forbidden":
        return f"unknown key '{where}'; known: {', '.join(RobotFile.model_fields)}"
    if error["type"] == "missing":
        return f"key '{where}' is missing"
    return f"{where}: {error['msg']}, got {error['input']!r}"
