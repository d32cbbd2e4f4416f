"""Where a camera is on the hand or in the base: from views of a board, or of the arm's own tool."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.calibration.fitting import (
    HandEye,
    Residual,
    fitted,
    jackknifed,
    refuse_misfit,
    turned,
    two_sides,
)
from optipromp_eyes.calibration.mistakes import other_camera, other_sides, reason
from optipromp_eyes.calibration.views import BoardView, SeenTool
from optipromp_eyes.pictures import CameraModel, Mount, check_near

FEWEST = 4  # views: three tell the pose, one more tells of errors: a choice
TURN, SPREAD = 4.0, 0.03
"""[deg], [m] least deviations of the hand's turns about, and of the tool's places along, the second
of two axes: choices."""
MOST_SIGMA = 0.05  # [m] deviation of the camera's place: a choice


def hand_eye(views: Sequence[BoardView], camera: CameraModel, mount: Mount) -> HandEye:
    """The pose of a camera on the hand, or in the base, from views of a board.

    The board stands still in the base for a camera on the hand, and is fixed on the hand for one in
    the base.

    Args:
        views: of one board.
        camera: its focal lengths and its middle; its pose is not used.
        mount: of the camera.

    Raises:
        InvalidRequestError: too few views, or views between which the hand does not turn about two
            axes; a camera with distortion; OpenCV is not installed.
    """
    if len(views) < FEWEST:
        raise InvalidRequestError(
            f"the board is in {len(views)} pictures; must be in {FEWEST} at least: take 10 to 20"
        )
    if camera.distortion:
        raise InvalidRequestError(
            "the camera file has a distortion: calibrate with pictures and numbers without it"
        )
    for view in views:
        check_near(view.hand.position, f"{view.name}: the hand")
    _refuse_few_turns([view.hand for view in views])
    camera = replace(camera, mount=mount)
    try:
        found = fitted(views, camera)
    except InvalidRequestError as fault:
        raise InvalidRequestError(f"{fault.message}. {reason(views, camera)}") from None
    doubts, mended = [], found
    if intrinsics := other_camera(views, camera):
        doubts.append(intrinsics[0])
        mended = fitted(views, intrinsics[1])
    near = mended.camera.pose, mended.board
    if sides := other_sides(views, two_sides(views, mended.camera, near)):
        doubts.append(sides[0])
        mended = fitted(sides[1], mended.camera)
    # what the doubts move is a systematic error, which leaving out views does not show
    pose, other = found.camera.pose, mended.camera.pose
    sigma = np.hypot(found.sigma, other.position - pose.position)
    turn = math.hypot(found.sigma_degree, turned(pose.inverse() @ other))
    return _checked(replace(found, sigma=sigma, sigma_degree=turn, doubts=tuple(doubts)))


def by_tool(seen: Sequence[SeenTool], camera: CameraModel) -> HandEye:
    """The pose of a standing camera from places of the tool's centre that it saw.

    The rigid motion of least squares (Kabsch 1976).

    Raises:
        InvalidRequestError: too few places, or places along one line.
    """
    if len(seen) < FEWEST:
        raise InvalidRequestError(
            f"the tool was seen in {len(seen)} places; must be {FEWEST} at least: take 10 or more"
        )
    there = np.array([each.camera for each in seen], dtype=np.float64)
    here = np.array([each.base for each in seen], dtype=np.float64)
    second = float(np.linalg.svd(here - here.mean(axis=0), compute_uv=False)[1])
    if second / math.sqrt(len(seen)) < SPREAD:
        raise InvalidRequestError(
            f"the places of the tool lie along a line: their deviation across it is "
            f"{1e3 * second / math.sqrt(len(seen)):.0f} mm; must be {1e3 * SPREAD:.0f} mm at "
            "least"
        )
    pose = _rigid(there, here)
    misses = np.linalg.norm(pose @ there - here, axis=1)
    pairs = zip(seen, misses.tolist(), strict=True)
    residuals = [Residual(one.name, math.nan, miss, math.nan) for one, miss in pairs]
    advice = ". Compare the names with the pictures, and the units: metres, radians"
    refuse_misfit(residuals, advice)
    rows = np.arange(len(seen))
    each = [_rigid(there[rows != k], here[rows != k]) for k in rows]
    return _checked(jackknifed(replace(camera, pose=pose, mount="base"), residuals, each, None))


def _rigid(there: FloatArray, here: FloatArray) -> Pose:
    """The pose that brings points (N, 3) there nearest to those here."""
    a, b = there.mean(axis=0), here.mean(axis=0)
    turn = Rotation.align_vectors(here - b, there - a)[0].as_matrix()
    return Pose(b - turn @ a, turn)


def _refuse_few_turns(hands: Sequence[Pose]) -> None:
    """Refuse turns about one axis only: along that axis the camera's place would be unknown."""
    rotations = Rotation.from_matrix(np.array([hand.rotation for hand in hands]))
    first, second = np.triu_indices(len(hands), 1)
    turns = (rotations[first].inv() * rotations[second]).as_rotvec(degrees=True)
    across = float(np.linalg.svd(turns, compute_uv=False)[1]) / math.sqrt(len(turns))
    if across < TURN:
        raise InvalidRequestError(
            f"the hand hardly turns between the pictures: by {across:.1f} degrees about the second "
            f"of two axes, must be {TURN:g} (root mean square). Tilt it by 15 to 30 degrees to "
            "all sides, and turn it about its own axis"
        )


def _checked(found: HandEye) -> HandEye:
    """The calibration; refused where its deviation is too large."""
    if (sigma := float(np.linalg.norm(found.sigma))) > MOST_SIGMA:
        advice = "Take more pictures, and turn the hand more between them"
        raise InvalidRequestError(
            f"the views tell the camera's place to {1e3 * sigma:.3g} mm (standard deviation): must "
            f"be {1e3 * MOST_SIGMA:g} at most. {'; '.join(found.doubts) or advice}"
        )
    return found
