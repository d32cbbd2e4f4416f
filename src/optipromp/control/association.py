"""Which detection is of which track, and which tracks a look should have seen."""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from optipromp.control.look import Look
from optipromp.control.motion import PlantState
from optipromp.control.tracks import Seen, Track, TrackerParameters
from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.geometry.distances import distances
from optipromp.core.geometry.obstacles import Obstacles

_FAR = 1e6  # of a pair that is not allowed: above any sum of those that are
_POINTS = 120  # on a ray of sight, where it is held against static objects: at most 7 mm apart


@dataclass(frozen=True, eq=False)
class Pairing:
    """Detections and tracks that belong together.

    Attributes:
        tracks: (k,) indices of matched tracks, ascending.
        detections: (k,) indices of their detections.
        jumped: (k,) whether a pair is outside the gate but nearer than two fruits can be.
        loose: (k,) whether a pair is outside half the gate.
        new: (b,) indices of detections of what no track is of.
        scale: standard deviation of an innovation along an axis, the median of all pairs [m].
    """

    tracks: IntArray
    detections: IntArray
    jumped: BoolArray
    loose: BoolArray
    new: IntArray
    scale: float = 0.0

    def surprised(self, tracks: int, detections: int) -> bool:
        """Whether a third of the tracks, and as many detections, two at least, found none that is
        well within the gate."""
        good = int((~self.loose).sum())
        return min(tracks, detections) - good >= max(2.0, tracks / 3)


def paired(
    state: PlantState,
    expected: FloatArray,
    noise: FloatArray,
    tracks: tuple[Track, ...],
    seen: Seen,
    parameters: TrackerParameters,
    looked_at: BoolArray | None = None,
) -> Pairing:
    """The pairs of least total cost within the gate, then those of least distance.

    The cost of a pair is d² + log det S of the innovation, and more where one is the target and
    the other is not. Confirmed tracks choose first. A detection without a track, but nearer to one
    than two fruits can be, is of that track: moved, if the track has no detection; else found
    twice.

    ``state``: predicted to the time of the look. ``expected``: (F, 3) positions of the tracks [m].
    ``noise``: (F, D, 3, 3) covariance of the error of each pair [m²]. ``tracks``: F tracks.
    ``seen``: D detections. ``parameters``: of the tracker. ``looked_at``: (F,) tracks that the look
    should have seen. One of these that has no detection takes one of its role from as far as
    ``parameters.jump``. None: all others as near.
    """
    count, found = len(tracks), len(seen.items)
    if not count or not found:
        none = np.zeros(0, dtype=np.int64)
        return Pairing(none, none, none.astype(bool), none.astype(bool), np.arange(found))
    looked = state.layout.position
    spread = np.einsum(
        "kin,kjn->kij",
        (looked @ state.covariance).reshape(count, 3, -1),
        looked.reshape(count, 3, -1),
    )
    innovations = seen.positions - expected[:, None]
    joint = spread[:, None] + noise
    square = np.einsum(
        "kdi,kdi->kd", innovations, np.linalg.solve(joint, innovations[..., None])[..., 0]
    )
    size = np.log(np.linalg.det(joint))
    cost = square + size - size.min()
    wanted = np.array([item.role == "target" for item in seen.items])
    cost += parameters.conflict * (target_of(tracks)[:, None] != wanted)
    alone = parameters.gate + parameters.conflict + float(size.max() - size.min())
    inside = square <= parameters.gate
    sure = np.array([track.confirmed for track in tracks])
    pairs: dict[int, int] = {}
    for rows in (np.flatnonzero(sure), np.flatnonzero(~sure)):
        columns = np.setdiff1d(np.arange(found), list(pairs.values()))
        block = np.ix_(rows, columns)
        pairs |= _cheapest(np.where(inside, cost, alone)[block], inside[block], rows, columns)

    away = np.sqrt((innovations**2).sum(axis=2))
    sizes = np.array([track.radius for track in tracks])
    near = away / (sizes[:, None] + np.array([item.radius for item in seen.items]))
    close = near <= parameters.near
    free = np.ones(found, dtype=bool)
    free[list(pairs.values())] = False
    jumps = close & free
    if looked_at is not None:
        alike = target_of(tracks)[:, None] == wanted
        jumps |= (near <= parameters.jump) & alike & looked_at[:, None] & free
    jumps[list(pairs)] = False
    every = np.arange(count), np.arange(found)
    moved = _cheapest(np.where(jumps, near, _FAR), jumps, *every)
    free[list(moved.values())] = False
    both = {**pairs, **moved}
    order = sorted(both)
    one = np.array(order, dtype=np.int64)
    other = np.array([both[k] for k in order], dtype=np.int64)
    return Pairing(
        one,
        other,
        np.array([k in moved for k in order], dtype=bool),
        square[one, other] > 0.5 * parameters.gate,
        np.flatnonzero(free & ~close.any(axis=0)),
        float(np.sqrt(np.median(joint.trace(axis1=2, axis2=3)) / 3.0)),
    )


def common_shift(
    expected: FloatArray, seen: FloatArray, scale: float, parameters: TrackerParameters
) -> FloatArray:
    """The displacement (3,) that brings most tracks near detections [m].

    Zero unless it brings three tracks, half of them, and two more than none does, and is far
    above the errors of a look.

    ``expected``: (F, 3) positions of the confirmed tracks [m]. ``seen``: (D, 3) positions of the
    detections [m]. ``scale``: standard deviation of an innovation along an axis [m].
    ``parameters``: of the tracker.
    """
    alike = parameters.alike * scale
    away = seen - expected[:, None]
    small = (away**2).sum(axis=2) <= parameters.shift**2
    tried = np.concatenate([np.zeros((1, 3)), away[small]])
    for widened in (2.0, 1.0):  # a pair alone has the errors of two positions
        gaps = np.sqrt(((away - tried[:, None, None]) ** 2).sum(axis=3))
        least, which = gaps.min(axis=2), gaps.argmin(axis=2)
        near = least <= widened * alike
        pulls = away[np.arange(len(expected)), which] * near[..., None]
        if widened > 1.0:
            tried[1:] = (pulls.sum(axis=1) / np.maximum(near.sum(axis=1), 1)[:, None])[1:]
    counts = near.sum(axis=1)
    worth = np.where(near, least, alike).sum(axis=1)
    best = int(np.lexsort((worth, -counts))[0])
    if counts[best] < max(3, counts[0] + 2, 0.5 * len(expected)):
        return np.zeros(3)
    shift = np.asarray(pulls[best].sum(axis=0) / counts[best])
    return shift if float(shift @ shift) > (parameters.felt * scale) ** 2 else np.zeros(3)


def _cheapest(
    cost: FloatArray, allowed: BoolArray, rows: IntArray, columns: IntArray
) -> dict[int, int]:
    """The allowed pairs of the assignment of least total cost, row to column."""
    if not allowed.any():
        return {}
    one, other = linear_sum_assignment(cost)
    good = allowed[one, other]
    return dict(zip(rows[one[good]].tolist(), columns[other[good]].tolist(), strict=True))


def target_of(tracks: tuple[Track, ...]) -> BoolArray:
    """(F,) which track is the target: of those with a majority for it, that with most votes."""
    mask = np.zeros(len(tracks), dtype=bool)
    votes = np.array([track.votes for track in tracks]).reshape(-1, 3)
    score = np.where(votes[:, 0] >= votes.max(axis=1, initial=0), votes[:, 0], 0)
    if score.any():
        mask[int(score.argmax())] = True
    return mask


def visible(
    look: Look,
    positions: FloatArray,
    radii: FloatArray,
    reach: float,
    hiding: tuple[FloatArray, Obstacles | None],
) -> BoolArray:
    """(F,) which fruits a look should have seen.

    A fruit is seen if its centre is in the cone of view, within ``reach`` [m], and no other fruit,
    ball or static object is between it and the camera.

    ``look``: the camera's pose and angle of view. ``positions``: (F, 3) expected centres [m].
    ``radii``: (F,) of the fruits [m]. ``reach``: distance [m]. ``hiding``: balls (B, 4), centres
    and radii [m], e.g. of the arm; and static objects.
    """
    count = len(positions)
    if not count:
        return np.zeros(0, dtype=bool)
    eye, forward = look.camera.position, look.camera.rotation[:, 2]
    ways = positions - eye
    away = np.maximum(np.sqrt((ways**2).sum(axis=1)), 1e-9)
    rays = ways / away[:, None]
    clear = (rays @ forward >= np.cos(0.5 * look.view)) & (away <= reach)

    balls, static = hiding
    centres = np.concatenate([ways, balls[:, :3] - eye])
    sizes = np.concatenate([radii, balls[:, 3]])
    along = rays @ centres.T
    aside = (centres**2).sum(axis=1) - along**2
    before = (along > 0.0) & (along < away[:, None]) & (aside < sizes**2)
    before[np.arange(count), np.arange(count)] = False
    clear &= ~before.any(axis=1)
    if static is not None and clear.any():
        share = np.linspace(0.0, 1.0, _POINTS) * np.maximum(away - radii, 0.0)[:, None]
        points = eye + share[..., None] * rays[:, None]
        gaps, _ = distances(static, points.reshape(-1, 3))
        clear &= (gaps.min(axis=1).reshape(count, -1) >= 0.0).all(axis=1)
    return np.asarray(clear)
