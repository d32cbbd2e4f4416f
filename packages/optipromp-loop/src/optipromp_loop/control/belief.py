"""What is believed at a time, and how a look changes it: a pure function of both.

Also which detection is of which track, and which tracks a look should have seen.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.geometry.distances import distances
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import SceneObject
from optipromp_loop.control.motion import Layout, Oscillators, PlantState
from optipromp_loop.control.tracks import (
    Frame,
    Seen,
    Track,
    TrackerParameters,
    new_track,
    push_noise,
)

_FAR = 1e6  # of a pair that is not allowed: above any sum of those that are
_POINTS = 120  # on a ray of sight, where it is held against static objects: at most 7 mm apart


@dataclass(frozen=True, eq=False)
class Pairing:
    """Detections and tracks that belong together."""

    tracks: IntArray  # (k,) indices of matched tracks, ascending
    detections: IntArray  # (k,) indices of their detections
    jumped: BoolArray  # (k,) whether a pair is outside the gate but nearer than two fruits can be
    loose: BoolArray  # (k,) whether a pair is outside half the gate
    new: IntArray  # (b,) indices of detections of what no track is of
    # standard deviation of an innovation along an axis, the median of all pairs [m]
    scale: float = 0.0


def pairing(
    state: PlantState,
    expected: FloatArray,
    noise: FloatArray,
    tracks: tuple[Track, ...],
    seen: Seen,
    parameters: TrackerParameters,
    looked_at: BoolArray,
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
    ``parameters.jump``.
    """
    count, found = len(tracks), len(seen.items)
    if not count or not found:
        none = np.zeros(0, dtype=np.int64)
        return Pairing(none, none, none.astype(bool), none.astype(bool), np.arange(found))
    innovations = seen.positions - expected[:, None]
    joint = state.spreads[:, None] + noise
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
    alike = target_of(tracks)[:, None] == wanted
    jumps = (close | (near <= parameters.jump) & alike & looked_at[:, None]) & free
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
    close: float = 0.0,
) -> BoolArray:
    """(F,) which fruits a look should have seen.

    A fruit is seen if its centre is in the cone of view and within ``reach`` [m], all of it is
    within the camera's limits, it is in no ball, and no other fruit, ball or static object is
    between it and the camera.

    ``look``: the camera's pose, angle of view and limits. ``positions``: (F, 3) expected centres
    [m]. ``radii``: (F,) of the fruits [m]. ``reach``: distance [m]. ``hiding``: balls (B, 4),
    centres and radii [m], e.g. of the arm; and static objects. ``close``: the near limit of a
    camera that states none [m].
    """
    count = len(positions)
    if not count:
        return np.zeros(0, dtype=bool)
    eye, forward = look.camera.position, look.camera.rotation[:, 2]
    ways = positions - eye
    away = np.maximum(np.sqrt((ways**2).sum(axis=1)), 1e-9)
    rays = ways / away[:, None]
    clear = (rays @ forward >= np.cos(0.5 * look.view)) & (away <= reach)
    clear &= (away - radii >= (look.near or close)) & (away + radii <= look.far)

    balls, static = hiding
    inside = np.linalg.norm(positions[:, None] - balls[:, :3], axis=2) < balls[:, 3]
    clear &= ~inside.any(axis=1)
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


@dataclass(frozen=True, eq=False)
class Belief:
    """All that the tracker knows at the time of a look."""

    time: float  # of the newest look [s]; minus infinity before the first
    state: PlantState  # of the motion
    tracks: tuple[Track, ...] = ()  # F tracks, in the order of the state's fruits
    begun: int = 0  # number of tracks ever started
    looks: int = 0  # number of looks
    left: int = 0  # detections and tracks that the last look left out, because there were too many


@dataclass(frozen=True, eq=False)
class Setting:
    """What does not change while the tracker runs."""

    parameters: TrackerParameters  # of the tracker
    frame: Frame  # vertical and horizontal axes
    static: Obstacles | None = None  # what hides fruits and does not move; None: nothing
    taken: frozenset[str] = frozenset()  # ids that no new track may have


@dataclass(frozen=True, eq=False)
class Arrival:
    """A look, and what was known with it."""

    seen: Seen  # the detections
    # displacement (3,) of each pushed track by the arm, by its id [m]
    pushed: Mapping[str, FloatArray]
    balls: FloatArray  # (B, 4) centres and radii of the arm's parts that hide fruits [m]

    @property
    def time(self) -> float:
        """Of the look [s]."""
        return self.seen.look.time


def first_belief(state: PlantState, first: tuple[SceneObject, ...], world: Setting) -> Belief:
    """The belief before any look: ``first`` objects, seen at an unknown earlier time."""
    given = world.parameters
    begun = [new_track(item.id, item, None, world.frame) for item in first]
    tracks = tuple(replace(one, confirmed=True, existence=given.detected) for one in begun)
    if tracks:
        across = world.frame.axes.T @ world.frame.axes * (given.sway**2 + given.swing**2)
        spread = [_white(track.spread, given) + across for track in tracks]
        places = np.array([item.position for item in first])
        state = state.with_fruits(_swings(tracks, given), places, np.array(spread), known=True)
    return Belief(-math.inf, state, tracks)


def after_look(belief: Belief, event: Arrival, world: Setting) -> tuple[Belief, FloatArray]:
    """The belief after a look, which must not be older than the belief, and the normalised
    innovations squared (k,) of the tracks that it found within the gate."""
    given, seen, tracks = world.parameters, event.seen, belief.tracks
    state = belief.state
    if belief.time > -math.inf:
        state = state.after(event.time - belief.time, given.drift)
    push = np.array([event.pushed.get(track.id, np.zeros(3)) for track in tracks]).reshape(-1, 3)
    expected = (state.layout.position @ state.mean).reshape(-1, 3) + push
    centre, far, found = _centre(tracks, expected, seen), math.inf, len(seen.items)
    if len(seen.items) > 2 * given.most:  # of what is farther away this look tells nothing
        seen, far = seen.nearest(centre, 2 * given.most)
        event = replace(event, seen=seen)
    left = found - len(seen.items)
    pushes = push_noise(push, given)
    noise = pushes[:, None] + seen.covariances[None]
    radii = np.array([track.radius for track in tracks])
    hiding = (event.balls, world.static)

    def shown(places: FloatArray) -> BoolArray:
        sight = visible(seen.look, places, radii, given.reach, hiding, given.close)
        return np.asarray(sight & (lengths(places - centre) <= far))

    looked_at = shown(expected)
    pairs = pairing(state, expected, noise, tracks, seen, given, looked_at)
    shaken = False
    sure = np.array([track.confirmed for track in tracks], dtype=bool)
    known = int(sure.sum())
    # a third of the tracks, and as many detections, have no partner well within the gate
    missed = min(known, len(seen.items)) - int((~pairs.loose).sum())
    if known > 2 and missed >= max(2.0, known / 3):
        shift = common_shift(expected[sure], seen.positions, pairs.scale, given)
        if shaken := bool(shift.any()):
            expected = expected + shift
            looked_at = shown(expected)
            pairs = pairing(state, expected, noise, tracks, seen, given, looked_at)
            state = state.shaken(math.sqrt(float(shift @ shift)))
    state, squares = _corrected(state, pairs, event, expected, (push, pushes), belief, given)
    if belief.time > -math.inf and given.learning > 0.0:
        share = -math.expm1(-(event.time - belief.time) / given.learning)
        state = state.learnt(share, _amplitudes(state.layout, given))
    if shaken:
        squares = np.zeros(0)
    tracks = _counted(tracks, pairs, event, push, looked_at, world)
    belief = replace(belief, time=event.time, state=state, tracks=tracks, left=left)
    return _renewed(belief, pairs, event, world, centre), squares


def _centre(tracks: tuple[Track, ...], expected: FloatArray, seen: Seen) -> FloatArray:
    """(3,) where the pick is: the target; else what was seen as one; else the camera [m]."""
    if (target := target_of(tracks)).any():
        return np.asarray(expected[target][0])
    wanted = [item.role == "target" for item in seen.items]
    return seen.positions[wanted].mean(axis=0) if any(wanted) else seen.look.camera.position


def _white(spread: FloatArray, given: TrackerParameters) -> FloatArray:
    """The part (..., 3, 3) of a detection's covariance that looks average out [m²]."""
    return np.asarray((1.0 - given.steady) * spread + given.grain**2 * np.eye(3))


def _amplitudes(layout: Layout, given: TrackerParameters) -> tuple[FloatArray, FloatArray]:
    """Least and most variances (m,) of the oscillators [m²]."""
    sizes = [2 * layout.bank, 2 * layout.count]
    each = np.repeat([given.sway**2 / max(layout.bank, 1), given.swing**2], sizes)
    most = given.most_swing**2 * each
    most[: sizes[0]] = np.inf
    return given.least_sway**2 * each, most


def _swings(tracks: tuple[Track, ...], given: TrackerParameters) -> Oscillators:
    omega, zeta = np.repeat([track.swing(given) for track in tracks], 2, axis=0).T
    return Oscillators(omega, zeta, np.full(len(omega), given.swing))


def _corrected(
    state: PlantState,
    pairs: Pairing,
    event: Arrival,
    expected: FloatArray,
    pushes: tuple[FloatArray, FloatArray],
    belief: Belief,
    given: TrackerParameters,
) -> tuple[PlantState, FloatArray]:
    """The state after its matches, and the innovations (k,) of those within the gate.

    What is outside the gate for the first time may be an error of the look; the second time the
    fruit has another rest.
    """
    order = np.argsort(pairs.jumped, kind="stable")
    one, other, jumped = pairs.tracks[order], pairs.detections[order], pairs.jumped[order]
    if not len(one):
        return state, np.zeros(0)
    push, errors = pushes
    seen = event.seen.positions[other]
    noise = _white(event.seen.covariances[other], given) + errors[one]
    held = (push[one] ** 2).sum(axis=1) > 0.0
    again = jumped & ~held & [belief.tracks[k].jumps > 0 for k in one.tolist()]
    far = seen - expected[one]
    if again.any():  # it was no error of the look
        state = state.loosened(one[again], lengths(far[again]))
    odd = far * (jumped & ~again)[:, None]
    noise = noise + odd[:, :, None] * odd[:, None, :]
    state, squares = state.updated(one, seen - push[one], noise, one[held])
    return state, squares[: int((~jumped).sum())]


def _counted(
    tracks: tuple[Track, ...],
    pairs: Pairing,
    event: Arrival,
    push: FloatArray,
    looked_at: BoolArray,
    world: Setting,
) -> tuple[Track, ...]:
    """The tracks with what the look tells of their existence, role, shape and stem."""
    given = world.parameters
    found = dict(zip(pairs.tracks.tolist(), pairs.detections.tolist(), strict=True))
    jumped = set(pairs.tracks[pairs.jumped].tolist())
    counted = []
    for k, track in enumerate(tracks):
        if k in found:
            item = event.seen.items[found[k]]
            jumps = track.jumps + 1 if k in jumped else 0
            track = replace(_found(track, item, event, world), jumps=jumps)
        elif looked_at[k]:
            chance = track.existence * (1.0 - given.detected)
            track = replace(
                track,
                outcomes=(*track.outcomes, False)[-given.within :],
                lost=track.lost + 1,
                existence=chance / (chance + 1.0 - track.existence),
            )
        if push[k].any() or track.pushed.any():
            track = replace(track, pushed=push[k])
        counted.append(track)
    return tuple(counted)


def _found(track: Track, item: SceneObject, event: Arrival, world: Setting) -> Track:
    given = world.parameters
    new = new_track(track.id, item, event.seen, world.frame)
    outcomes = (*track.outcomes, True)[-given.within :]
    confirmed = track.confirmed or sum(outcomes) >= given.confirm
    chance = track.existence * given.detected
    a, b = track.votes, new.votes
    return replace(
        new,
        physical=new.physical or track.physical,
        votes=(a[0] + b[0], a[1] + b[1], a[2] + b[2]),
        tilts=track.tilts + new.tilts,
        lengths=track.lengths + new.lengths,
        stems=track.stems + new.stems,
        pushed=track.pushed,
        outcomes=outcomes,
        lost=0 if confirmed else track.lost,
        confirmed=confirmed,
        existence=min(chance / (chance + (1.0 - track.existence) * given.spurious), 1.0 - 1e-6),
        last_seen=event.time,
    )


def _renewed(
    belief: Belief, pairs: Pairing, event: Arrival, world: Setting, centre: FloatArray
) -> Belief:
    """The belief without dead tracks, and with new ones; of too many tracks the best.

    The target is the best; then odds count, and nearness to ``centre`` (3,).
    """
    given, tracks, state, left = world.parameters, belief.tracks, belief.state, belief.left
    alive = np.array(
        [track.lost < (given.die if track.confirmed else given.missed) for track in tracks],
        dtype=bool,
    )
    first, new = not belief.looks, pairs.new  # the first look confirms at once
    existence = given.detected if first else given.born
    if (over := int(alive.sum()) + len(new) - given.most) > 0:
        chance = np.array([*(track.existence for track in tracks), *[existence] * len(new)])
        places = (state.layout.position @ state.mean).reshape(-1, 3)
        places = np.concatenate([places, event.seen.positions[new]])
        near = 1.0 + (lengths(places - centre) / given.beside) ** 2
        worth = chance / (1.0 - chance) / near
        worth[: len(tracks)][target_of(tracks)] = np.inf
        worth[: len(tracks)][~alive] = -1.0
        best = np.zeros(len(worth), dtype=bool)
        best[np.argsort(-worth, kind="stable")[: given.most]] = True
        alive, new, left = best[: len(tracks)], new[best[len(tracks) :]], left + over
    if not alive.all():
        kept = np.flatnonzero(alive)
        state, tracks = state.only(kept), tuple(tracks[k] for k in kept.tolist())
    if any(track.stems for track in tracks):
        state = state.turned(_swings(tracks, given))
    fresh, number = [], belief.begun
    for k in new.tolist():
        while f"fruit-{number}" in world.taken:
            number += 1
        track = new_track(f"fruit-{number}", event.seen.items[k], event.seen, world.frame)
        fresh.append(replace(track, confirmed=first, existence=existence, last_seen=event.time))
        number += 1
    if fresh:
        swings = _swings(tuple(fresh), given)
        spread = _white(event.seen.covariances[new], given)
        state = state.with_fruits(swings, event.seen.positions[new], spread)
    return Belief(belief.time, state, tracks + tuple(fresh), number, belief.looks + 1, left)
