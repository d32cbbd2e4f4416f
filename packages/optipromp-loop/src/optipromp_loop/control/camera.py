"""A camera's faults: pictures that stand still, and stamps that are not of the exposure.

A picture stands still if its detections, in the frame of the camera, are equal to the last digit
although the camera moved. Such a look tells nothing and is left out.

Stamps are compared with the arm's own motion. A camera on the arm has a pose in the last link that
is constant; if that pose is constant only for the arm a while after the stamps, the stamps are
wrong and the poses are right. Things that stand still have places in the base frame that are
constant; if they are constant only for the arm a while after the stamps, stamps and poses are
wrong: the pose was taken at the stamp. Both shifts are found by least squares over recent looks.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, lengths
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp_loop.control.parameters import LoopParameters

STEP = 0.005  # [s] of the numerical derivative by the shift: a choice
ROUNDS = 3  # of Gauss and Newton: a choice, the residuals are nearly linear in the shift
FLOOR = 0.001  # [m] least deviation of a residual, so that an exact fit has an error: a choice
OUTLYING = 3.0  # residual over the median from which a detection counts as another thing's: choice
CHAIN = 0.02  # [m] of the same thing between two looks, by stamps that err: a choice
MOVED = 0.005  # [m] of the camera between two looks that are compared: a choice
STANDING = 0.2  # [s] between two such looks of a camera that stands: a choice
LOOKS = 25  # that are compared: a choice, a fit of 8 fruits takes 2 ms
POSES_MOST = 1.0  # [s] of a shift by the poses, which the arm's own motion tells exactly: a choice
AGREE = 3  # successive fits that must agree: a choice


class Fit(NamedTuple):
    """A shift [s], its standard deviation [s], and the share of the variance that it explains."""

    shift: float
    error: float
    share: float


NO_FIT = Fit(0.0, np.inf, 0.0)


def fitted(
    points: Callable[[float], FloatArray], owner: IntArray, most: float, begin: float = 0.0
) -> Fit:
    """The shift with which points of each owner are nearest to each other.

    Args:
        points: of a shift [s]: (N, 3) places [m]; rows that are not known are NaN.
        owner: (N,) which thing each place is of.
        most: largest shift [s].
        begin: a shift to begin with [s].
    """
    rows = owner[:, None] == np.unique(owner)
    enough = rows @ rows.sum(axis=0) > 2
    used = enough

    def spread(values: FloatArray) -> FloatArray:
        """The values (N, 3) less the mean of their owner; zero where not used."""
        own = rows & used[:, None]
        total = own.T @ np.where(used[:, None], values, 0.0)
        means = total / np.maximum(own.sum(axis=0), 1)[:, None]
        return np.where(used[:, None], values - rows @ means, 0.0)

    shift, square = begin, 0.0
    for k in range(ROUNDS):
        before, now = points(shift - STEP), points(shift)
        used = enough & np.isfinite(before + now).all(axis=1)
        if used.sum() < 4:
            return NO_FIT
        if k > 0:  # before, a shift makes more of a difference than another thing
            rest = lengths(spread(now))
            used &= rest <= OUTLYING * np.median(rest[used]) + FLOOR
        slope, off = spread((now - before) / STEP), spread(now)
        square = float((slope**2).sum())
        if square <= 0.0:
            return NO_FIT
        shift = float(np.clip(shift - (slope * off).sum() / square, -most, most))
    count = max(3 * int(used.sum()) - 3 * rows.shape[1] - 1, 1)
    left = float((spread(points(shift)) ** 2).sum())
    first = float((spread(points(0.0)) ** 2).sum())
    error = np.sqrt(max(left / count, FLOOR**2) / square)
    return Fit(shift, float(error), 1.0 - left / first if first > 0.0 else 0.0)


class _Sample(NamedTuple):
    """A look by its stamp."""

    time: float  # [s]
    camera: Pose  # as stated
    places: FloatArray  # (D, 3) detections in the frame of the camera [m]
    things: IntArray  # (D,) which thing each is of


class _Estimate:
    """A shift that successive fits agree on; ``shift`` is what is corrected [s]."""

    def __init__(self) -> None:
        self.shift, self.adopted = 0.0, 0
        self._fits: list[float] = []
        self.last = 0.0  # shift of the last fit that counted [s]

    def add(self, fit: Fit, p: LoopParameters) -> bool:
        """Take in a fit; whether another shift is adopted."""
        small = abs(fit.shift) < p.stamp
        if fit.error > p.stamp_error or not (small or fit.share >= p.explained):
            return False
        self.last, wanted = fit.shift, 0.0 if small else fit.shift
        if abs(wanted - self.shift) < p.stamp:
            self._fits = []
            return False
        self._fits = [*self._fits, wanted][-AGREE:]
        if len(self._fits) < AGREE or np.ptp(self._fits) > p.stamp:
            return False
        self.shift, self._fits, self.adopted = float(np.mean(self._fits)), [], self.adopted + 1
        return True


class CameraWatch:
    """Checks looks against the arm's own motion.

    Args:
        robot: that carries the camera, or not.
        parameters: see :class:`LoopParameters`.

    Attributes:
        standing: time since when the picture stands still [s]; None: it does not.
        refused: why the stamps cannot be used; empty: they can.
        news: what was noticed since the list was last emptied.
    """

    def __init__(self, robot: Robot, parameters: LoopParameters) -> None:
        self.robot, self._p = robot, parameters
        self.standing: float | None = None
        self.refused, self.news = "", list[str]()
        self._arm: deque[tuple[float, FloatArray]] = deque()
        self._known: tuple[FloatArray, FloatArray] | None = None  # (K,) and (n, K) of these
        self._picture: Look | None = None  # the first look with the last picture
        self._samples: list[_Sample] = []
        self._things = 0
        self._poses, self._pictures = _Estimate(), _Estimate()

    @property
    def shift(self) -> float:
        """Time from stamps to exposures that is corrected [s]."""
        return self._poses.shift + self._pictures.shift

    def follow(self, time: float, q: FloatArray) -> None:
        """Note where the arm is, ``q`` (n,), at a ``time`` [s]."""
        if self._arm and time <= self._arm[-1][0]:
            return
        self._arm.append((time, np.array(q)))
        self._known = None
        while self._arm[0][0] < time - self._p.remembered:
            self._arm.popleft()

    def configuration(self, time: float) -> FloatArray:
        """(n,) where the arm was at a ``time`` [s]; the first or last known before or after."""
        return np.asarray(self._configurations(np.array([time]))[0])

    def checked(self, look: Look, still: bool) -> Look | None:
        """The look with the time and the pose of its exposure; None: it tells nothing.

        ``still``: whether nothing is pushed, so that stamps may be judged by the fruits.
        """
        if self._stands(look):
            return None
        if still and self._arm:
            self._judge(look)
        return self._corrected(look)

    # -- pictures

    def _stands(self, look: Look) -> bool:
        """Whether the picture is one before, though the camera moved."""
        before = self._picture
        if before is None or not look.detections or not _equal(before, look):
            if self.standing is not None:
                self.news.append("the camera's pictures go on")
            self._picture, self.standing = look, None
            return False
        by = before.camera.inverse() @ look.camera
        turn = float(np.linalg.norm(by.rotation - np.eye(3))) / np.sqrt(2.0)
        far = float(np.linalg.norm(by.position))
        moved = far > self._p.picture_moved or turn > self._p.picture_turned
        if self.standing is None and moved:
            self.standing = look.time
            self.news.append("the camera's picture stands still while the camera moves")
        return self.standing is not None

    # -- stamps

    def _corrected(self, look: Look) -> Look:
        if self.shift == 0.0:
            return look
        stamp = look.time + self._poses.shift
        if self._pictures.shift == 0.0:
            return replace(look, time=stamp)
        then = stamp + self._pictures.shift
        frames = self.robot.segment_frames(self._configurations(np.array([stamp, then])))
        before, after = (Pose(place[-1], turn[-1]) for place, turn in zip(*frames, strict=True))
        return replace(look, time=then, camera=after @ (before.inverse() @ look.camera))

    def _judge(self, look: Look) -> None:
        """Compare the look with those before, where the camera moved in between."""
        last = self._samples[-1] if self._samples else None
        if last is not None:
            moved = float(np.linalg.norm(look.camera.position - last.camera.position))
            if moved < MOVED and look.time - last.time < STANDING:
                return
        places = np.array([item.position for item in look.detections]).reshape(-1, 3)
        self._samples = [*self._samples, _Sample(look.time, look.camera, places, self._same(look))]
        oldest = look.time - self._p.remembered + 2.0 * self._p.stamp_most
        self._samples = [one for one in self._samples[-LOOKS:] if one.time >= oldest]
        seen = np.array([sample.camera.position for sample in self._samples])
        if np.ptp(seen, axis=0).max() < 2.0 * MOVED:
            return  # a camera that stands tells nothing of its stamps
        if self._poses.shift != 0.0 or np.nanstd(self._hands(0.0), axis=0).max() > FLOOR:
            one = np.zeros(len(self._samples), dtype=np.int64)
            self._fit("poses", self._poses, self._hands, one, POSES_MOST)
        things = np.concatenate([sample.things for sample in self._samples])
        if len(things):
            self._fit("pictures", self._pictures, self._bases(), things, self._p.stamp_most)

    def _fit(
        self, what: str, estimate: _Estimate, points: Callable[[float], FloatArray],
        owner: IntArray, most: float,
    ) -> None:  # fmt: skip
        """Fit a shift, and adopt, tell or refuse it; ``most``: largest that is corrected [s]."""
        found = fitted(points, owner, 2.0 * most, estimate.last)
        if abs(found.shift) >= self._p.stamp:  # a short motion has several minima
            others = (fitted(points, owner, 2.0 * most, side * most) for side in (-1.5, 1.5))
            found = max(found, *others, key=lambda fit: np.nan_to_num(fit.share))
        if not estimate.add(found, self._p):
            return
        by = estimate.shift
        words = f"{1e3 * abs(by):.0f} ms {'early' if by > 0.0 else 'late'}"
        told = f"stamps are {words}, by the {what}" if by else f"stamps are right, by the {what}"
        if abs(by) > most:
            self.refused = f"{told}, more than is corrected: synchronise the camera's clock"
        elif estimate.adopted > self._p.stamp_changes:
            self.refused = f"{told}, and were otherwise before: synchronise the camera's clock"
        else:
            told += "; they are corrected" if by else ""
        self.news.append(self.refused or told)

    def _same(self, look: Look) -> IntArray:
        """(D,) which thing each detection is of: the nearest of the look before, if it is near."""
        now = self._corrected(look)
        found = np.array([now.camera @ item.position for item in look.detections]).reshape(-1, 3)
        out = np.arange(len(found)) + self._things
        self._things += len(found)
        if self._samples and len(found) and len(self._samples[-1].places):
            last = self._samples[-1]
            before = self._corrected(Look(last.time, last.camera, ())).camera @ last.places
            away = np.linalg.norm(found[:, None] - before, axis=2)
            nearest = away.argmin(axis=1)
            mutual = away.argmin(axis=0)[nearest] == np.arange(len(found))
            good = mutual & (away.min(axis=1) < CHAIN)
            out[good] = last.things[nearest[good]]
        return out

    def _hands(self, shift: float) -> FloatArray:
        """(S, 3) places of the camera in the last link, of the arm ``shift`` after the stamps."""
        times = np.array([sample.time for sample in self._samples])
        origins, turns = self._links(times + shift)
        seen = np.array([sample.camera.position for sample in self._samples])
        return np.asarray(np.einsum("sji,sj->si", turns, seen - origins))

    def _bases(self) -> Callable[[float], FloatArray]:
        """Of a shift: (N, 3) places of all detections, of the arm that long after the stamps."""
        times = np.array([sample.time for sample in self._samples]) + self._poses.shift
        origins, turns = self._links(times)
        places = np.concatenate([one.camera @ one.places for one in self._samples])
        row = np.repeat(np.arange(len(times)), [len(one.places) for one in self._samples])
        local = np.einsum("nji,nj->ni", turns[row], places - origins[row])

        def points(shift: float) -> FloatArray:
            origins, turns = self._links(times + shift)
            return np.asarray(np.einsum("nij,nj->ni", turns[row], local) + origins[row])

        return points

    # -- the arm

    def _configurations(self, times: FloatArray) -> FloatArray:
        if self._known is None:
            self._known = np.array([t for t, _ in self._arm]), np.array([q for _, q in self._arm]).T
        known, joints = self._known
        return np.array([np.interp(times, known, joint) for joint in joints]).T

    def _links(self, times: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (S, 3) and rotations (S, 3, 3) of the last link; NaN outside of what is known."""
        origins, turns = self.robot.segment_frames(self._configurations(times))
        places = np.array(origins[:, -1])
        first, last = self._arm[0][0], self._arm[-1][0]
        places[(times < first - 1e-9) | (times > last + 1e-9)] = np.nan
        return places, turns[:, -1]


def _equal(one: Look, other: Look) -> bool:
    """Whether the detections of two looks are equal to the last digit."""
    pairs = zip(one.detections, other.detections, strict=False)
    return len(one.detections) == len(other.detections) and all(
        np.array_equal(a.position, b.position) and np.array_equal(a.orientation, b.orientation)
        for a, b in pairs
    )
