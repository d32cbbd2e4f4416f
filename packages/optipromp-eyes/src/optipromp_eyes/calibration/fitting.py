"""Least squares of where a camera is: from all corners' pixels, and from what the arm may err.

Of a view k the arm tells the pose G_k of one mount in the other: the base in the hand for a camera
on the hand, the hand in the base for a camera that stands. With X the camera and Z the board, each
in its mount, the board in the camera is B_k = X⁻¹ G_k Z. A linear solution (Shah 2013) begins:
the Python interface of OpenCV 5 has none.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import polar
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.calibration.views import BoardView
from optipromp_eyes.needed import opencv
from optipromp_eyes.pictures import CameraModel

PIXEL = 0.2  # [pixel] deviation of a corner: measured, 0.1 on drawn boards, 0.25 on drawn tags
PLACE, ANGLE = 0.0005, 0.1  # [m], [deg] deviations of the hand along and about each axis: guesses
MOST_PLACE, MOST_TURN = 0.010, 3.0
"""[m], [deg] root mean square of the views: a fit that leaves more has failed; a hand that is told
in whole degrees leaves 6 mm and 1 degree."""
APART = 5.0  # pixels of a view over the board's own, from which on it is named: a choice


class Residual(NamedTuple):
    """What one view leaves: pixels (root mean square), metres, degrees; nan: not measured."""

    name: str
    pixel: float
    metre: float
    degree: float


@dataclass(frozen=True, eq=False)
class HandEye:
    """A camera with its pose, and how well that is known.

    Attributes:
        camera: with its mount.
        residuals: of each view.
        sigma: (3,) standard deviations of the camera's place along the axes of its mount [m], by
            the jackknife over views: it counts errors of the arm as well as of pixels. What the
            ``doubts`` would move is added.
        sigma_degree: standard deviation of its turn, of all axes together.
        spread: largest change of the place when one view is left out [m].
        spread_degree: largest change of the turn then.
        board: pose of the board, in the other mount; None: no board.
        doubts: intrinsics of the camera, or sides of the board, that the views contradict.
        own: what the board leaves in each view by itself, without the arm, as root mean square
            [pixel], or :data:`PIXEL` where that is more.
        apart: names of views that leave over :data:`APART` times as much, the
            worst first: wrong poses, or an arm that errs.
    """

    camera: CameraModel
    residuals: tuple[Residual, ...]
    sigma: FloatArray
    sigma_degree: float
    spread: float
    spread_degree: float
    board: Pose | None = None
    doubts: tuple[str, ...] = ()
    own: float = math.nan
    apart: tuple[str, ...] = ()

    def total(self, what: str) -> float:
        """Root mean square over the views of ``pixel``, ``metre`` or ``degree``."""
        return math.sqrt(float(np.mean([getattr(each, what) ** 2 for each in self.residuals])))


def fitted(views: Sequence[BoardView], camera: CameraModel) -> HandEye:
    """The calibration without doubts; InvalidRequestError: no pose of the camera fits."""
    moved, seen = two_sides(views, camera)
    x, z, _ = linear(moved, seen)
    for _ in range(2):  # weights, and of two poses of a board the right one, come from the first
        moved, seen = two_sides(views, camera, (x, z))
        weights = []
        for view, g, b in zip(views, moved, seen, strict=True):
            hand = (x.inverse() @ (Pose() if camera.mount == "hand" else g)).position
            weights.append(_weight(view, b, hand, camera))
        x, z = _refined(x, z, moved, seen, weights)
    residuals, squares = [], []
    for view, g, b in zip(views, moved, seen, strict=True):
        told = x.inverse() @ g @ z
        apart = told.inverse() @ b
        pixel = _pixels_off(view, told, camera)
        squares.append(_pixels_off(view, b, camera) ** 2)
        away = float(np.linalg.norm(apart.position))
        residuals.append(Residual(view.name, pixel, away, turned(apart)))
    refuse_misfit(residuals)
    data: tuple[list[Any], ...] = moved, seen, weights
    parts = [[rows[:k] + rows[k + 1 :] for rows in data] for k in range(len(views))]
    each = [_refined(x, z, *part)[0] for part in parts]
    own = max(math.sqrt(float(np.mean(squares))), PIXEL)
    worst = sorted(residuals, key=lambda one: -one.pixel)
    far = tuple(one.name for one in worst if one.pixel > APART * own)
    found = jackknifed(replace(camera, pose=x), residuals, each, z)
    return replace(found, own=own, apart=far)


def _pixels_off(view: BoardView, board: Pose, camera: CameraModel) -> float:
    """Root mean square of what a board in the frame of the camera leaves in a view [pixel]."""
    off = camera.pixels(board @ view.places) - view.pixels
    return math.sqrt(float((off**2).sum(axis=1).mean()))


def two_sides(
    views: Sequence[BoardView], camera: CameraModel, near: tuple[Pose, Pose | None] | None = None
) -> tuple[list[Pose], list[Pose]]:
    """What the arm tells of each view, G, and what the camera sees, B: by that view alone, or of
    two poses of a board the one near that by X and Z."""
    moved = [view.hand.inverse() if camera.mount == "hand" else view.hand for view in views]
    guesses: list[Pose | None] = [None] * len(views)
    if near is not None and near[1] is not None:
        guesses = [near[0].inverse() @ g @ near[1] for g in moved]
    return moved, [_board_in(v, camera, guess) for v, guess in zip(views, guesses, strict=True)]


def refuse_misfit(residuals: Sequence[Residual], then: str = "") -> None:
    """Refuse a fit that leaves more than :data:`MOST_PLACE` or :data:`MOST_TURN`."""
    squares = np.square([[each.metre, each.degree] for each in residuals])
    metre, degree = np.sqrt(squares.mean(axis=0)).tolist()
    if metre > MOST_PLACE or degree > MOST_TURN:  # the turn of a tool is not a number
        turn = "" if math.isnan(degree) else f" and {degree:.3g} degrees (at most {MOST_TURN:g})"
        raise InvalidRequestError(
            f"no pose of the camera fits: the views leave {1e3 * metre:.3g} mm (must be at most "
            f"{1e3 * MOST_PLACE:g}){turn}{then}"
        )


def jackknifed(
    camera: CameraModel, residuals: list[Residual], each: list[Pose], board: Pose | None
) -> HandEye:
    """The calibration with what leaving out each view changes."""
    apart = [camera.pose.inverse() @ one for one in each]
    shifts = np.array([one.position for one in each])
    turns = np.array([_vector(one)[:3] for one in apart])
    scale = math.sqrt(len(each) - 1)
    sigma, turn = scale * shifts.std(axis=0), scale * math.hypot(*turns.std(axis=0))
    return HandEye(
        camera, tuple(residuals), sigma, math.degrees(turn),
        max(float(np.linalg.norm(one.position)) for one in apart),
        max(turned(one) for one in apart), board,
    )  # fmt: skip


def _board_in(view: BoardView, camera: CameraModel, guess: Pose | None = None) -> Pose:
    """The board in the frame of the camera, by one view; of two solutions the one near a guess."""
    cv = opencv()
    given = view.places, view.pixels, camera.matrix, None
    if guess is None:
        _, turn, shift = cv.solvePnP(*given, flags=cv.SOLVEPNP_IPPE)
    else:
        near = _vector(guess)
        _, turn, shift = cv.solvePnP(*given, near[:3].copy(), near[3:].copy(), True)
    return _pose(np.concatenate([turn.ravel(), shift.ravel()]))


def _weight(view: BoardView, board: Pose, hand: FloatArray, camera: CameraModel) -> FloatArray:
    """(6, 6) that whitens a view's residuals; ``hand``: (3,) in the frame of the camera."""
    arms = view.places @ board.rotation.T
    x, y, z = (arms + board.position).T
    flat = np.zeros((len(arms), 2, 3))  # pixels over places
    flat[:, 0, 0], flat[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    flat[:, 1, 1], flat[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    slope = np.concatenate([np.cross(arms[:, None], flat), flat], axis=2).reshape(-1, 6)
    lever = np.vstack([np.eye(3), np.cross(board.position - hand, np.eye(3))])
    arm = math.radians(ANGLE) ** 2 * lever @ lever.T
    arm[3:, 3:] += PLACE**2 * np.eye(3)
    covariance = PIXEL**2 * np.linalg.inv(slope.T @ slope) + arm
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def linear(moved: Sequence[Pose], seen: Sequence[Pose]) -> tuple[Pose, Pose, float]:
    """X and Z of X B = G Z: the turns by one singular vector, then the places.

    The third is the factor on the places of the board by which the views fit best.
    """
    sums = sum(
        np.kron(b.rotation, g.rotation) for b, g in zip(seen, moved, strict=True)
    )  # vec(R_X) = (R_B x R_G) vec(R_Z) in each view
    left, _, right = np.linalg.svd(np.asarray(sums))
    multiples = (each.reshape(3, 3).T for each in (left[:, 0], right[0]))  # of turns, either sign
    x, z = (polar(each * np.sign(np.linalg.det(each)))[0] for each in multiples)
    rows = [np.hstack([np.eye(3), -g.rotation]) for g in moved]
    shift = [g.position - x @ b.position for b, g in zip(seen, moved, strict=True)]
    places = np.linalg.lstsq(np.vstack(rows), np.concatenate(shift), rcond=None)[0]
    arms = np.concatenate([x @ b.position for b in seen])[:, None]
    hands = np.concatenate([g.position for g in moved])
    scale = np.linalg.lstsq(np.hstack([np.vstack(rows), arms]), hands, rcond=None)[0][6]
    return Pose(places[:3], x), Pose(places[3:], z), float(scale)


def _refined(
    x: Pose, z: Pose, moved: Sequence[Pose], seen: Sequence[Pose], weights: Sequence[FloatArray]
) -> tuple[Pose, Pose]:
    """X and Z of least squares, from a first guess."""
    turns, shifts = np.array([g.rotation for g in moved]), np.array([g.position for g in moved])
    there, at = np.array([b.rotation for b in seen]), np.array([b.position for b in seen])
    whiten = np.array(weights)

    def misses(values: FloatArray) -> FloatArray:
        camera, board = _pose(values[:6]).inverse(), _pose(values[6:])
        turned = camera.rotation @ turns @ board.rotation @ there.swapaxes(1, 2)
        place = camera @ (turns @ board.position + shifts) - at
        off = np.hstack([Rotation.from_matrix(turned).as_rotvec(), place])
        return np.asarray(np.einsum("kij,kj->ki", whiten, off).ravel())

    found = least_squares(misses, np.concatenate([_vector(x), _vector(z)]), x_scale="jac").x
    return _pose(found[:6]), _pose(found[6:])


def _pose(values: FloatArray) -> Pose:
    """Of a rotation vector and a place (6,)."""
    return Pose(values[3:], Rotation.from_rotvec(values[:3]).as_matrix())


def _vector(pose: Pose) -> FloatArray:
    return np.concatenate([Rotation.from_matrix(pose.rotation).as_rotvec(), pose.position])


def turned(pose: Pose) -> float:
    """The angle of a pose's turn [degree]."""
    return math.degrees(float(np.linalg.norm(_vector(pose)[:3])))
