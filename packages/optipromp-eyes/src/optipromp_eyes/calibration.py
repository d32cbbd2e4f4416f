"""Where a camera is on the hand or in the base: from views of a board, or of the arm's own tool.

Of a view k the arm tells the pose G_k of one mount in the other: the base in the hand for a camera
on the hand, the hand in the base for a camera that stands. With X the camera and Z the board, each
in its mount, the board in the camera is B_k = X⁻¹ G_k Z. A linear solution (Shah 2013) begins;
least squares of all corners' pixels ends.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, OptiPrompError, suggest
from optipromp.core.files import is_file
from optipromp.core.parameters import Checked, parameter
from optipromp.core.promp.demonstrations import check_limits
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import flange_of
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.boards import Board, opencv
from optipromp_eyes.pictures import CameraModel, Mount, check_near, read_pixels

OTHER = {"hand": "base", "base": "hand"}  # where the board is, by where the camera is


@dataclass(frozen=True)
class CalibrationParameters(Checked):
    """How exact views are, and what is refused, as it cannot tell a pose."""

    # 0.1 on drawn boards, 0.25 on drawn tags
    pixel: float = parameter(0.2, "pixel", "measured", "deviation of a corner")
    place: float = parameter(0.0005, "m", "guess", "deviation of each coordinate of the hand")
    angle: float = parameter(0.1, "deg", "guess", "deviation of the hand's turn about each axis")
    views: int = parameter(4, "1", "choice", "fewest; three tell it, one more tells of errors")
    # least deviations of the hand's turns about, and of the tool's places along
    turn: float = parameter(4.0, "deg", "choice", "the second of two axes, at least")
    spread: float = parameter(0.03, "m", "choice", "the second of two axes, at least")
    # a fit that leaves more has failed; a hand that is told in whole degrees leaves 6 mm and 1 deg
    most_place: float = parameter(0.010, "m", "choice", "root mean square of the views, at most")
    most_turn: float = parameter(3.0, "deg", "choice", "root mean square of the views, at most")
    most_sigma: float = parameter(0.05, "m", "choice", "deviation of the camera's place, at most")
    sure: float = parameter(3.0, "1", "choice", "deviations by which a camera or board is in doubt")
    doubt: float = parameter(0.01, "1", "choice", "least error of a focal length, a centre, a side")
    apart: float = parameter(5.0, "1", "choice", "pixels of a view over the board's, named above")
    most_pixel: float = parameter(
        3.0, "pixel", "choice", "root mean square, written above by force"
    )


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
            [pixel], or ``CalibrationParameters.pixel`` where that is more.
        apart: names of views that leave over ``CalibrationParameters.apart`` times as much, the
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


def hand_eye(
    views: Sequence[BoardView], camera: CameraModel, mount: Mount,
    parameters: CalibrationParameters | None = None,
) -> HandEye:  # fmt: skip
    """The pose of a camera on the hand, or in the base, from views of a board.

    The board stands still in the base for a camera on the hand, and is fixed on the hand for one in
    the base.

    Args:
        views: of one board.
        camera: its focal lengths and its middle; its pose is not used.
        mount: of the camera.
        parameters: what is refused.

    Raises:
        InvalidRequestError: too few views, or views between which the hand does not turn about two
            axes; a camera with distortion; OpenCV is not installed.
    """
    p = parameters or CalibrationParameters()
    if len(views) < p.views:
        raise InvalidRequestError(
            f"the board is in {len(views)} pictures; must be in {p.views} at least: take 10 to 20"
        )
    if camera.distortion:
        raise InvalidRequestError(
            "the camera file has a distortion: calibrate with pictures and numbers without it"
        )
    for view in views:
        check_near(view.hand.position, f"{view.name}: the hand")
    _refuse_few_turns([view.hand for view in views], p)
    camera = replace(camera, mount=mount)
    try:
        found = _fitted(views, camera, p)
    except InvalidRequestError as fault:
        reason = _reason(views, camera, p)
        raise InvalidRequestError(f"{fault.message}. {reason}") from None
    doubts, mended = [], found
    if intrinsics := _other_camera(views, camera, p):
        doubts.append(intrinsics[0])
        mended = _fitted(views, intrinsics[1], p)
    near = mended.camera.pose, mended.board
    if sides := _other_sides(views, _two_sides(views, mended.camera, near), p):
        doubts.append(sides[0])
        mended = _fitted(sides[1], mended.camera, p)
    # what the doubts move is a systematic error, which leaving out views does not show
    pose, other = found.camera.pose, mended.camera.pose
    sigma = np.hypot(found.sigma, other.position - pose.position)
    turn = math.hypot(found.sigma_degree, _turned(pose.inverse() @ other))
    return _checked(replace(found, sigma=sigma, sigma_degree=turn, doubts=tuple(doubts)), p)


def _fitted(views: Sequence[BoardView], camera: CameraModel, p: CalibrationParameters) -> HandEye:
    """The calibration without doubts; InvalidRequestError: no pose of the camera fits."""
    moved, seen = _two_sides(views, camera)
    x, z, _ = _linear(moved, seen)
    for _ in range(2):  # weights, and of two poses of a board the right one, come from the first
        moved, seen = _two_sides(views, camera, (x, z))
        weights = []
        for view, g, b in zip(views, moved, seen, strict=True):
            hand = (x.inverse() @ (Pose() if camera.mount == "hand" else g)).position
            weights.append(_weight(view, b, hand, camera, p))
        x, z = _refined(x, z, moved, seen, weights)
    residuals, squares = [], []
    for view, g, b in zip(views, moved, seen, strict=True):
        told = x.inverse() @ g @ z
        apart = told.inverse() @ b
        pixel = _pixels_off(view, told, camera)
        squares.append(_pixels_off(view, b, camera) ** 2)
        away = float(np.linalg.norm(apart.position))
        residuals.append(Residual(view.name, pixel, away, _turned(apart)))
    _refuse_misfit(residuals, p)
    data: tuple[list[Any], ...] = moved, seen, weights
    parts = [[rows[:k] + rows[k + 1 :] for rows in data] for k in range(len(views))]
    each = [_refined(x, z, *part)[0] for part in parts]
    own = max(math.sqrt(float(np.mean(squares))), p.pixel)
    worst = sorted(residuals, key=lambda one: -one.pixel)
    far = tuple(one.name for one in worst if one.pixel > p.apart * own)
    found = _told(replace(camera, pose=x), residuals, each, z)
    return replace(found, own=own, apart=far)


def _pixels_off(view: BoardView, board: Pose, camera: CameraModel) -> float:
    """Root mean square of what a board in the frame of the camera leaves in a view [pixel]."""
    off = camera.pixels(board @ view.places) - view.pixels
    return math.sqrt(float((off**2).sum(axis=1).mean()))


def _two_sides(
    views: Sequence[BoardView], camera: CameraModel, near: tuple[Pose, Pose | None] | None = None
) -> tuple[list[Pose], list[Pose]]:
    """What the arm tells of each view, G, and what the camera sees, B: by that view alone, or of
    two poses of a board the one near that by X and Z."""
    moved = [view.hand.inverse() if camera.mount == "hand" else view.hand for view in views]
    guesses: list[Pose | None] = [None] * len(views)
    if near is not None and near[1] is not None:
        guesses = [near[0].inverse() @ g @ near[1] for g in moved]
    return moved, [_board_in(v, camera, guess) for v, guess in zip(views, guesses, strict=True)]


def _refuse_misfit(residuals: Sequence[Residual], p: CalibrationParameters, then: str = "") -> None:
    squares = np.square([[each.metre, each.degree] for each in residuals])
    metre, degree = np.sqrt(squares.mean(axis=0)).tolist()
    if metre > p.most_place or degree > p.most_turn:  # the turn of a tool is not a number
        turn = "" if math.isnan(degree) else f" and {degree:.3g} degrees (at most {p.most_turn:g})"
        raise InvalidRequestError(
            f"no pose of the camera fits: the views leave {1e3 * metre:.3g} mm (must be at most "
            f"{1e3 * p.most_place:g}){turn}{then}"
        )


def _checked(found: HandEye, p: CalibrationParameters) -> HandEye:
    """The calibration; refused where its deviation is too large."""
    if (sigma := float(np.linalg.norm(found.sigma))) > p.most_sigma:
        advice = "Take more pictures, and turn the hand more between them"
        raise InvalidRequestError(
            f"the views tell the camera's place to {1e3 * sigma:.3g} mm (standard deviation): must "
            f"be {1e3 * p.most_sigma:g} at most. {'; '.join(found.doubts) or advice}"
        )
    return found


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


def _reason(views: Sequence[BoardView], camera: CameraModel, p: CalibrationParameters) -> str:
    """What is probably wrong: the fewest usual mistakes without which the views fit."""
    for mistakes in (some for count in range(4) for some in combinations(MISTAKES, count)):
        words, right = [said for said, _ in mistakes], list(views)
        for _, repair in reversed(mistakes):
            right = repair(right)
        if len(right) < max(p.views, len(views) - 1):  # poses are not late and early at once
            continue
        if _fits(right, camera, p):
            return f"Probably {', and '.join(words)}"
        sides = _other_sides(right, _two_sides(right, camera), p)
        if sides and _fits(sides[1], camera, p):
            return f"Probably {', and '.join([*words, sides[0]])}"
    if (intrinsics := _other_camera(views, camera, p)) and _fits(views, intrinsics[1], p):
        return f"Probably {intrinsics[0]}"
    return (
        "Compare --poses with the pictures (their order and times, metres and radians, the hand in "
        "the base, w, x, y, z), --mount, the sizes of the board and the camera's intrinsics"
    )


def _fits(views: Sequence[BoardView], camera: CameraModel, p: CalibrationParameters) -> bool:
    with suppress(np.linalg.LinAlgError, OptiPrompError, ValueError):  # a trial may make no sense
        sides = _two_sides(views, camera)
        x, z, _ = _linear(*sides)
        off = [(g @ z).position - (x @ b).position for g, b in zip(*sides, strict=True)]
        if np.linalg.norm(off, axis=1).max() < ROUGH * p.most_place:
            _fitted(views, camera, p)
            return True
    return False


ROUGH = 5.0  # of the bound: a linear solution that leaves more is not refined in a trial
SMALLEST = 1e-4  # least factor on a board's sides that is tried: sides in 0.1 mm


def _other_sides(
    views: Sequence[BoardView], poses: tuple[list[Pose], list[Pose]], p: CalibrationParameters
) -> tuple[str, list[BoardView]] | None:
    """The views with the board's sides that they tell, if others are beyond doubt."""
    (moved, seen), size, rows = poses, _linear(*poses)[2], range(len(views))
    each = [_linear(moved[:k] + moved[k + 1 :], seen[:k] + seen[k + 1 :])[2] for k in rows]
    sigma = math.sqrt(len(each) - 1) * float(np.std(each))  # of the jackknife
    if size <= SMALLEST or abs(size - 1.0) <= max(p.sure * sigma, p.doubt):
        return None
    words = f"the board's sides are {size:.3g} times as long as told (--side, --marker)"
    return words, [view._replace(places=size * view.places) for view in views]


def _other_camera(
    views: Sequence[BoardView], camera: CameraModel, p: CalibrationParameters
) -> tuple[str, CameraModel] | None:
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
    if not (np.abs(seen - known) > np.maximum(p.sure * sigma, p.doubt * camera.fx)).any():
        return None
    told, listed = (", ".join(f"{value:.0f}" for value in values) for values in (known, seen))
    fx, fy, cx, cy = seen.tolist()
    return (
        f"the camera's intrinsics are wrong: fx, fy, cx, cy are {listed} by the board, and {told} "
        "in the camera file"
    ), replace(camera, fx=fx, fy=fy, cx=cx, cy=cy)


def by_tool(
    seen: Sequence[SeenTool], camera: CameraModel,
    parameters: CalibrationParameters | None = None,
) -> HandEye:  # fmt: skip
    """The pose of a standing camera from places of the tool's centre that it saw.

    The rigid motion of least squares (Kabsch 1976).

    Raises:
        InvalidRequestError: too few places, or places along one line.
    """
    p = parameters or CalibrationParameters()
    if len(seen) < p.views:
        raise InvalidRequestError(
            f"the tool was seen in {len(seen)} places; must be {p.views} at least: take 10 or more"
        )
    there = np.array([each.camera for each in seen], dtype=np.float64)
    here = np.array([each.base for each in seen], dtype=np.float64)
    second = float(np.linalg.svd(here - here.mean(axis=0), compute_uv=False)[1])
    if second / math.sqrt(len(seen)) < p.spread:
        raise InvalidRequestError(
            f"the places of the tool lie along a line: their deviation across it is "
            f"{1e3 * second / math.sqrt(len(seen)):.0f} mm; must be {1e3 * p.spread:.0f} mm at "
            "least"
        )
    pose = _rigid(there, here)
    misses = np.linalg.norm(pose @ there - here, axis=1)
    pairs = zip(seen, misses.tolist(), strict=True)
    residuals = [Residual(one.name, math.nan, miss, math.nan) for one, miss in pairs]
    advice = ". Compare the names with the pictures, and the units: metres, radians"
    _refuse_misfit(residuals, p, advice)
    rows = np.arange(len(seen))
    each = [_rigid(there[rows != k], here[rows != k]) for k in rows]
    return _checked(_told(replace(camera, pose=pose, mount="base"), residuals, each, None), p)


def _told(
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
        max(_turned(one) for one in apart), board,
    )  # fmt: skip


def _refuse_few_turns(hands: Sequence[Pose], p: CalibrationParameters) -> None:
    """Refuse turns about one axis only: along that axis the camera's place would be unknown."""
    rotations = Rotation.from_matrix(np.array([hand.rotation for hand in hands]))
    first, second = np.triu_indices(len(hands), 1)
    turns = (rotations[first].inv() * rotations[second]).as_rotvec(degrees=True)
    across = float(np.linalg.svd(turns, compute_uv=False)[1]) / math.sqrt(len(turns))
    if across < p.turn:
        raise InvalidRequestError(
            f"the hand hardly turns between the pictures: by {across:.1f} degrees about the second "
            f"of two axes, must be {p.turn:g} (root mean square). Tilt it by 15 to 30 degrees to "
            "all sides, and turn it about its own axis"
        )


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


def _weight(
    view: BoardView, board: Pose, hand: FloatArray, camera: CameraModel, p: CalibrationParameters
) -> FloatArray:
    """(6, 6) that whitens a view's residuals; ``hand``: (3,) in the frame of the camera."""
    arms = view.places @ board.rotation.T
    x, y, z = (arms + board.position).T
    flat = np.zeros((len(arms), 2, 3))  # pixels over places
    flat[:, 0, 0], flat[:, 0, 2] = camera.fx / z, -camera.fx * x / z**2
    flat[:, 1, 1], flat[:, 1, 2] = camera.fy / z, -camera.fy * y / z**2
    slope = np.concatenate([np.cross(arms[:, None], flat), flat], axis=2).reshape(-1, 6)
    turned = np.vstack([np.eye(3), np.cross(board.position - hand, np.eye(3))])
    arm = math.radians(p.angle) ** 2 * turned @ turned.T
    arm[3:, 3:] += p.place**2 * np.eye(3)
    covariance = p.pixel**2 * np.linalg.inv(slope.T @ slope) + arm
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance)))


def _linear(moved: Sequence[Pose], seen: Sequence[Pose]) -> tuple[Pose, Pose, float]:
    """X and Z of X B = G Z: the turns by one singular vector, then the places.

    The third is the factor on the places of the board by which the views fit best.
    """
    sums = sum(
        np.kron(b.rotation, g.rotation) for b, g in zip(seen, moved, strict=True)
    )  # vec(R_X) = (R_B x R_G) vec(R_Z) in each view
    left, _, right = np.linalg.svd(np.asarray(sums))
    x, z = (_turn(each.reshape(3, 3).T) for each in (left[:, 0], right[0]))
    rows = [np.hstack([np.eye(3), -g.rotation]) for g in moved]
    shift = [g.position - x @ b.position for b, g in zip(seen, moved, strict=True)]
    places = np.linalg.lstsq(np.vstack(rows), np.concatenate(shift), rcond=None)[0]
    arms = np.concatenate([x @ b.position for b in seen])[:, None]
    hands = np.concatenate([g.position for g in moved])
    scale = np.linalg.lstsq(np.hstack([np.vstack(rows), arms]), hands, rcond=None)[0][6]
    return Pose(places[:3], x), Pose(places[3:], z), float(scale)


def _turn(matrix: FloatArray) -> FloatArray:
    """The rotation nearest to a multiple, of either sign, of a matrix (3, 3)."""
    left, _, right = np.linalg.svd(matrix * np.sign(np.linalg.det(matrix)))
    return np.asarray(left @ right)


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


def _rigid(there: FloatArray, here: FloatArray) -> Pose:
    """The pose that brings points (N, 3) there nearest to those here."""
    a, b = there.mean(axis=0), here.mean(axis=0)
    turn = Rotation.align_vectors(here - b, there - a)[0].as_matrix()
    return Pose(b - turn @ a, turn)


def _pose(values: FloatArray) -> Pose:
    """Of a rotation vector and a place (6,)."""
    return Pose(values[3:], Rotation.from_rotvec(values[:3]).as_matrix())


def _vector(pose: Pose) -> FloatArray:
    return np.concatenate([Rotation.from_matrix(pose.rotation).as_rotvec(), pose.position])


def _turned(pose: Pose) -> float:
    """The angle of a pose's turn [degree]."""
    return math.degrees(float(np.linalg.norm(_vector(pose)[:3])))


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
