"""What is probably wrong with views that no pose of the camera fits, or fits badly."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np

from optipromp.core.errors import OptiPrompError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.calibration.fitting import MOST_PLACE, fitted, linear, two_sides
from optipromp_eyes.calibration.views import BoardView
from optipromp_eyes.needed import opencv
from optipromp_eyes.pictures import CameraModel

SURE = 3.0  # deviations by which a camera or a board is in doubt: a choice
DOUBT = 0.01  # least error of a focal length, a centre or a side that is told: a choice


def _each(change: Callable[[Pose], Pose]) -> Callable[[list[BoardView]], list[BoardView]]:
    return lambda views: [view._replace(hand=change(view.hand)) for view in views]


MISTAKES: tuple[tuple[str, Callable[[list[BoardView]], list[BoardView]]], ...] = (
    (
        "the poses are the wrong way round: the base in the hand, not the hand in the base; or "
        "--mount is the other one",
        _each(Pose.inverse),
    ),
    (
        "the orientations are told as x, y, z, w; must be w, x, y, z",
        _each(lambda hand: Pose(hand.position, np.roll(hand.orientation, 1))),
    ),
    (
        "the poses are late by one picture",
        lambda views: [view._replace(hand=after.hand) for view, after in pairwise(views)],
    ),
    (
        "the poses are early by one picture",
        lambda views: [view._replace(hand=before.hand) for before, view in pairwise(views)],
    ),
)
"""Usual mistakes in poses, and the views without each. The last is taken back first."""


def reason(views: Sequence[BoardView], camera: CameraModel) -> str:
    """What is probably wrong: the fewest usual mistakes without which the views fit."""
    for mistakes in (some for count in range(4) for some in combinations(MISTAKES, count)):
        words, right = [said for said, _ in mistakes], list(views)
        for _, repair in reversed(mistakes):
            right = repair(right)
        if len(right) < len(views) - 1:  # poses are not late and early at once
            continue
        if _fits(right, camera):
            return f"Probably {', and '.join(words)}"
        sides = other_sides(right, two_sides(right, camera))
        if sides and _fits(sides[1], camera):
            return f"Probably {', and '.join([*words, sides[0]])}"
    if (intrinsics := other_camera(views, camera)) and _fits(views, intrinsics[1]):
        return f"Probably {intrinsics[0]}"
    return (
        "Compare --poses with the pictures (their order and times, metres and radians, the hand in "
        "the base, w, x, y, z), --mount, the sizes of the board and the camera's intrinsics"
    )


def _fits(views: Sequence[BoardView], camera: CameraModel) -> bool:
    with suppress(np.linalg.LinAlgError, OptiPrompError, ValueError):  # a trial may make no sense
        sides = two_sides(views, camera)
        x, z, _ = linear(*sides)
        off = [(g @ z).position - (x @ b).position for g, b in zip(*sides, strict=True)]
        if np.linalg.norm(off, axis=1).max() < ROUGH * MOST_PLACE:
            fitted(views, camera)
            return True
    return False


ROUGH = 5.0  # of the bound: a linear solution that leaves more is not refined in a trial
SMALLEST = 1e-4  # least factor on a board's sides that is tried: sides in 0.1 mm


def other_sides(
    views: Sequence[BoardView], poses: tuple[list[Pose], list[Pose]]
) -> tuple[str, list[BoardView]] | None:
    """The views with the board's sides that they tell, if others are beyond doubt."""
    (moved, seen), size, rows = poses, linear(*poses)[2], range(len(views))
    each = [linear(moved[:k] + moved[k + 1 :], seen[:k] + seen[k + 1 :])[2] for k in rows]
    sigma = math.sqrt(len(each) - 1) * float(np.std(each))  # of the jackknife
    if size <= SMALLEST or abs(size - 1.0) <= max(SURE * sigma, DOUBT):
        return None
    words = f"the board's sides are {size:.3g} times as long as told (--side, --marker)"
    return words, [view._replace(places=size * view.places) for view in views]


def other_camera(views: Sequence[BoardView], camera: CameraModel) -> tuple[str, CameraModel] | None:
    """The intrinsics that the board tells without the arm, if others are beyond doubt."""
    cv = opencv()
    places = [view.places.astype(np.float32) for view in views]
    pixels = [view.pixels.astype(np.float32) for view in views]
    flags = cv.CALIB_USE_INTRINSIC_GUESS | cv.CALIB_FIX_ASPECT_RATIO | cv.CALIB_ZERO_TANGENT_DIST
    flags |= cv.CALIB_FIX_K1 | cv.CALIB_FIX_K2 | cv.CALIB_FIX_K3
    stated, size = camera.matrix, (camera.width, camera.height)
    try:
        _, found, _, _, _, deviation, *_ = cv.calibrateCameraExtended(
            places, pixels, size, stated.copy(), np.zeros(5), flags=flags
        )
    except cv.error:
        return None  # the views tell no intrinsics
    known, seen = (matrix[[0, 1, 0, 1], [0, 1, 2, 2]] for matrix in (stated, found))
    sigma = deviation[:4, 0]  # in the same order
    sigma[:2] = sigma[:2].max()  # the focal lengths are of one ratio
    if not (np.abs(seen - known) > np.maximum(SURE * sigma, DOUBT * camera.fx)).any():
        return None
    told, listed = (", ".join(f"{value:.0f}" for value in values) for values in (known, seen))
    fx, fy, cx, cy = seen.tolist()
    return (
        f"the camera's intrinsics are wrong: fx, fy, cx, cy are {listed} by the board, and {told} "
        "in the camera file"
    ), replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)
