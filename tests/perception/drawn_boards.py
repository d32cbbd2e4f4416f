"""Boards drawn as a camera would see them, with poses that are known."""

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp_eyes import CameraModel
from optipromp_eyes.calibration import Board, BoardView

CAMERA = CameraModel(640, 480, 500.0, 505.0, 318.0, 241.0)
FINE = 4000.0  # [pixel/m] of the print
OVER = 2  # each way, pixels of the large picture that are averaged
MARGIN = 0.02  # [m] of white around a board


def printed(board: Board) -> tuple[NDArray[np.uint8], FloatArray]:
    """The print, and the place (2,) of its corner on the board [m]."""
    side, start = round(board.side * FINE), np.zeros(2)
    if board.pattern == "chessboard":
        black = np.add.outer(np.arange(board.rows + 1), np.arange(board.columns + 1)) % 2 == 1
        sheet = np.kron(np.where(black, 0, 255).astype(np.uint8), np.ones((side, side), np.uint8))
        start = np.full(2, -board.side)
    else:
        gap = 0.0 if board.pattern == "charuco" else board.marker
        columns, rows = board.columns, board.rows
        size = [n * board.side + (n - 1) * gap for n in (columns, rows)]
        sheet = board.drawn.generateImage([round(one * FINE) for one in size], marginSize=0)
    return np.pad(sheet, round(MARGIN * FINE), constant_values=255), start - MARGIN


def drawn(board: Board, pose: Pose, camera: CameraModel = CAMERA) -> NDArray[np.uint8]:
    """The picture (height, width) of a board at a pose in the frame of the camera."""
    sheet, start = printed(board)
    x, y = start + 0.5 / FINE  # the middle of the print's first pixel
    place = np.array([[1.0 / FINE, 0.0, x], [0.0, 1.0 / FINE, y], [0.0, 0.0, 1.0]])
    shown = camera.matrix @ np.column_stack([pose.rotation[:, :2], pose.position]) @ place
    middle = 0.5 * (OVER - 1)
    large = np.array([[OVER, 0, middle], [0, OVER, middle], [0, 0, 1.0]]) @ shown
    size = camera.width, camera.height
    big = cv2.warpPerspective(sheet, large, [OVER * n for n in size], borderValue=120)
    return np.asarray(cv2.resize(big, size, interpolation=cv2.INTER_AREA))


ACROSS, DOWN = np.meshgrid(np.arange(1, 7), np.arange(1, 5))
CORNERS = 0.03 * np.column_stack([ACROSS.ravel(), DOWN.ravel(), np.zeros(24)])
"""Places (24, 3) of corners on a board [m]."""


def seen_as(
    poses: list[Pose], hands: list[Pose], places: FloatArray = CORNERS, noise: float = 0.0,
    seed: object = 0,
) -> list[BoardView]:  # fmt: skip
    """Views of a board by pixels that are computed, not drawn: fast. ``noise`` [pixel]."""
    rng = np.random.default_rng(seed)
    return [
        BoardView(str(k), hand, places,
                  CAMERA.pixels(pose @ places) + rng.normal(0.0, noise, (len(places), 2)))
        for k, (pose, hand) in enumerate(zip(poses, hands, strict=True))
    ]  # fmt: skip


def views_from(count: int, seed: int, mount: str) -> tuple[Pose, list[Pose], list[Pose]]:
    """Pose of the camera in its mount; of each view the board in the camera, and the hand."""
    rng = np.random.default_rng(seed)
    camera = Pose([0.05, -0.03, 0.06], Rotation.from_rotvec([0.1, 0.05, 1.5]).as_matrix())
    board = Pose([0.5, 0.1, 0.2], Rotation.from_rotvec([3.1, 0.1, 0.2]).as_matrix())
    if mount == "base":
        camera = Pose([0.9, 0.2, 0.5], Rotation.from_rotvec([0.2, -1.9, 0.3]).as_matrix())
        board = Pose([-0.05, -0.04, 0.1], Rotation.from_rotvec([0.1, 0.1, 0.4]).as_matrix())
    seen, hands = [], []
    for _ in range(count):
        turn = Rotation.from_rotvec(rng.normal(0.0, [0.25, 0.25, 0.5])).as_matrix()
        middle = [rng.normal(0.0, 0.03), rng.normal(0.0, 0.02), rng.uniform(0.35, 0.45)]
        view = Pose(np.array(middle) - turn @ [0.105, 0.075, 0.0], turn)
        moved = camera @ view @ board.inverse()
        seen.append(view)
        hands.append(moved.inverse() if mount == "hand" else moved)
    return camera, seen, hands
