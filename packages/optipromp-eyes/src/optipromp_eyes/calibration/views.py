"""Views of a board, or of the arm's own tool, and the files that tell of them."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, OptiPrompError, suggest
from optipromp.core.files import is_file
from optipromp.core.promp.demonstrations import check_limits
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import flange_of
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.calibration.boards import Board
from optipromp_eyes.pictures import CameraModel, read_pixels


class BoardView(NamedTuple):
    """A board in a picture.

    Attributes:
        name: of the picture.
        hand: pose of the flange in the base.
        places: (N, 3) of points on the board [m].
        pixels: (N, 2) columns and rows where they are seen.
    """

    name: str
    hand: Pose
    places: FloatArray
    pixels: FloatArray


class SeenTool(NamedTuple):
    """The centre of the tool: (3,) as the camera sees it, and in the base [m]."""

    name: str
    camera: FloatArray
    base: FloatArray


_KEYS = "joints", "position", "orientation", "camera"


def read_views(
    folder: Path, poses: Path, board: Board, camera: CameraModel, robot: Robot | None = None
) -> tuple[tuple[BoardView, ...], tuple[str, ...]]:
    """The views of a board, and the pictures in which it was not found.

    ``poses``: YAML or JSON, a mapping from each picture's name to where the hand was: ``joints``
    (n,) of the robot, or ``position`` (3,) and ``orientation`` (quaternion ``w, x, y, z``) of the
    flange in the base.
    """
    views, without = [], []
    for name, entry in _entries(poses).items():
        what = f"{poses}: {name}"
        if not is_file(folder / name):
            raise InvalidRequestError(f"{what}: there is no such picture in {folder}")
        grey = read_pixels(folder / name, "L").astype(np.uint8)
        if grey.shape != (camera.height, camera.width):
            raise InvalidRequestError(
                f"{folder / name} has {grey.shape[1]} x {grey.shape[0]} pixels; the camera has "
                f"{camera.width} x {camera.height}"
            )
        hand, found = _hand(entry, robot, what), board.find(grey)
        if found is None:
            without.append(name)
        else:
            views.append(BoardView(name, hand, *found))
    return tuple(views), tuple(without)


def read_seen_tool(path: Path, robot: Robot | None = None) -> tuple[SeenTool, ...]:
    """Where a camera saw the centre of the tool.

    ``path``: YAML or JSON, a mapping from names to ``camera``, the tool's centre in the frame of
    the camera (3,) [m], and its ``position`` in the base (3,) or the robot's ``joints`` (n,).
    """
    found = []
    for name, entry in _entries(path).items():
        what = f"{path}: {name}"
        if "joints" in entry:
            arm, q = _joints(entry, robot, what)
            point = arm.tool_pose(q)[0]
        else:
            point = _numbers(entry, "position", 3, what)
        found.append(SeenTool(name, _numbers(entry, "camera", 3, what), point))
    return tuple(found)


def _entries(path: Path) -> dict[str, dict[str, Any]]:
    document = read_document(path, InvalidRequestError, "a mapping from names to joints or poses")
    if not isinstance(document, dict) or not all(isinstance(v, dict) for v in document.values()):
        raise InvalidRequestError(
            f"{path}: must be a mapping, such as 'a.png: {{joints: [0.1, 0.2, ...]}}'"
        )
    for name, entry in document.items():
        for key in entry:
            if key not in _KEYS:
                raise InvalidRequestError(f"{path}: {name}: {key!r}: {suggest(str(key), _KEYS)}")
    return {str(name): entry for name, entry in document.items()}


def _hand(entry: Mapping[str, Any], robot: Robot | None, what: str) -> Pose:
    if "joints" in entry:
        return flange_of(*_joints(entry, robot, what))
    place, turn = _numbers(entry, "position", 3, what), _numbers(entry, "orientation", 4, what)
    try:
        return Pose(place, turn)
    except OptiPrompError as error:
        raise InvalidRequestError(f"{what}: {error.message}") from None


def _joints(entry: Mapping[str, Any], robot: Robot | None, what: str) -> tuple[Robot, FloatArray]:
    """The robot, and the joints (n,) of an entry."""
    if robot is None:
        raise InvalidRequestError(f"{what}: joints tell nothing without the robot: give --known")
    q = _numbers(entry, "joints", robot.n_joints, what)
    limits = robot.lower, robot.upper
    check_limits(q[None], robot.joint_names, *limits, what, error=InvalidRequestError)
    return robot, q


def _numbers(entry: Mapping[str, Any], key: str, count: int, what: str) -> FloatArray:
    try:
        values = np.asarray(entry.get(key), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise InvalidRequestError(f"{what}: {key} must be {count} numbers")
    return values
