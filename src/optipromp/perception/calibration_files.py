"""Files of a calibration: where the hand was in each picture, and where the tool was seen."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import is_file
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.values import suggest
from optipromp.perception.boards import Board
from optipromp.perception.calibration import BoardView, SeenTool
from optipromp.perception.pictures import CameraModel, flange_of, read_pixels

_KEYS = "joints", "position", "orientation", "camera"


def read_views(
    folder: Path, poses: Path, board: Board, camera: CameraModel, robot: Robot | None = None
) -> tuple[tuple[BoardView, ...], tuple[str, ...]]:
    """The views of a board, and the pictures in which it was not found.

    ``folder``: of the pictures. ``poses``: YAML or JSON, a mapping from each picture's name to
    where the hand was: ``joints`` (n,), or ``position`` (3,) and ``orientation`` (quaternion ``w,
    x, y, z``) of the flange in the base. ``board``: that they show. ``camera``: that took them.
    ``robot``: whose joints are told.
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
    the camera (3,) [m], and its ``position`` in the base (3,) or the arm's ``joints`` (n,).
    ``robot``: whose joints are told, with its tool.
    """
    found = []
    for name, entry in _entries(path).items():
        what = f"{path}: {name}"
        if "joints" in entry:
            point = _robot(robot, what).tool_pose(_joints(entry, robot, what))[0]
        else:
            point = _vector(entry, "position", 3, what)
        found.append(SeenTool(name, _vector(entry, "camera", 3, what), point))
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
        return flange_of(_robot(robot, what), _joints(entry, robot, what))
    place, turn = _vector(entry, "position", 3, what), _vector(entry, "orientation", 4, what)
    try:
        return Pose(place, turn)
    except OptiPrompError as error:
        raise InvalidRequestError(f"{what}: {error.message}") from None


def _robot(robot: Robot | None, what: str) -> Robot:
    if robot is None:
        raise InvalidRequestError(f"{what}: joints tell nothing without the robot: give --known")
    return robot


def _joints(entry: Mapping[str, Any], robot: Robot | None, what: str) -> FloatArray:
    return _vector(entry, "joints", _robot(robot, what).n_joints, what)


def _vector(entry: Mapping[str, Any], key: str, count: int, what: str) -> FloatArray:
    try:
        values = np.asarray(entry.get(key), dtype=np.float64)
    except (TypeError, ValueError, OverflowError):
        values = np.zeros(0)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise InvalidRequestError(f"{what}: {key} must be {count} numbers")
    return values
