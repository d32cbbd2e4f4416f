"""What is believed at a time, and how a look changes it: a pure function of both."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from optipromp.control.association import Pairing, common_shift, paired, target_of, visible
from optipromp.control.motion import Layout, Oscillators, PlantState
from optipromp.control.tracks import Frame, Seen, Track, TrackerParameters, new_track, push_noise
from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.pose import Pose


@dataclass(frozen=True, eq=False)
class Belief:
    """All that the tracker knows at the time of a look.

    Attributes:
        time: of the newest look [s]; minus infinity before the first.
        state: of the motion.
        tracks: F tracks, in the order of the state's fruits.
        begun: number of tracks ever started.
        looks: number of looks.
        left: detections and tracks that the last look left out, because there were too many.
    """

    time: float
    state: PlantState
    tracks: tuple[Track, ...] = ()
    begun: int = 0
    looks: int = 0
    left: int = 0


@dataclass(frozen=True, eq=False)
class Setting:
    """What does not change while the tracker runs.

    Attributes:
        parameters: of the tracker.
        frame: vertical and horizontal axes.
        static: what hides fruits and does not move; None: nothing.
        taken: ids that no new track may have.
    """

    parameters: TrackerParameters
    frame: Frame
    static: Obstacles | None = None
    taken: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class Arrival:
    """A look, and what was known with it.

    Attributes:
        seen: the detections.
        pushed: displacement (3,) of each pushed track by the arm, by its id [m].
        balls: (B, 4) centres and radii of the arm's parts that hide fruits [m].
    """

    seen: Seen
    pushed: Mapping[str, FloatArray]
    balls: FloatArray

    @property
    def time(self) -> float:
        """Of the look [s]."""
        return self.seen.look.time


@dataclass(frozen=True, eq=False)
class Record:
    """Innovations of one look: ``squares`` (k,) of the tracks ``ids``."""

    time: float
    ids: tuple[str, ...]
    squares: FloatArray


def begun(state: PlantState, first: tuple[SceneObject, ...], world: Setting) -> Belief:
    """The belief before any look: ``first`` objects, seen at an unknown earlier time."""
    given = world.parameters
    identity = np.eye(3)
    tracks = tuple(
        replace(
            new_track(item.id, item, identity, None, world.frame),
            confirmed=True,
            existence=given.detected,
        )
        for item in first
    )
    if tracks:
        across = world.frame.axes.T @ world.frame.axes * (given.sway**2 + given.swing**2)
        spread = [_white(track.spread, given) + across for track in tracks]
        places = np.array([item.position for item in first])
        state = state.with_fruits(_swings(tracks, given), places, np.array(spread), known=True)
    return Belief(-math.inf, state, tracks)


def step(belief: Belief, event: Arrival, world: Setting) -> tuple[Belief, Record]:
    """The belief after a look, which must not be older than the belief, and its innovations."""
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
        sight = visible(seen.look, places, radii, given.reach, hiding)
        return np.asarray(sight & (lengths(places - centre) <= far))

    looked_at = shown(expected)
    pairs = paired(state, expected, noise, tracks, seen, given, looked_at)
    shaken = False
    sure = np.array([track.confirmed for track in tracks], dtype=bool)
    if sure.sum() > 2 and pairs.surprised(int(sure.sum()), len(seen.items)):
        shift = common_shift(expected[sure], seen.positions, pairs.scale, given)
        if shaken := bool(shift.any()):
            expected = expected + shift
            looked_at = shown(expected)
            pairs = paired(state, expected, noise, tracks, seen, given, looked_at)
            state = state.shaken(math.sqrt(float(shift @ shift)))
    state, record = _corrected(state, pairs, event, expected, (push, pushes), belief, given)
    if belief.time > -math.inf and given.learning > 0.0:
        share = -math.expm1(-(event.time - belief.time) / given.learning)
        state = state.learnt(share, _amplitudes(state.layout, given))
    if shaken:
        record = Record(event.time, (), np.zeros(0))
    tracks = _counted(tracks, pairs, event, push, looked_at, world)
    belief = replace(belief, time=event.time, state=state, tracks=tracks, left=left)
    return _renewed(belief, pairs, event, world, centre), record


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
) -> tuple[PlantState, Record]:
    """The state after its matches; those within the gate come first and are recorded.

    What is outside the gate for the first time may be an error of the look; the second time the
    fruit has another rest.
    """
    order = np.argsort(pairs.jumped, kind="stable")
    one, other, jumped = pairs.tracks[order], pairs.detections[order], pairs.jumped[order]
    if not len(one):
        return state, Record(event.time, (), np.zeros(0))
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
    count = int((~jumped).sum())
    ids = tuple(belief.tracks[k].id for k in one[:count].tolist())
    return state, Record(event.time, ids, squares[:count])


def _counted(
    tracks: tuple[Track, ...],
    pairs: Pairing,
    event: Arrival,
    push: FloatArray,
    looked_at: BoolArray,
    world: Setting,
) -> tuple[Track, ...]:
    """The tracks with what the look tells of their existence, role, shape and stem."""
    given, camera = world.parameters, event.seen.look.camera
    found = dict(zip(pairs.tracks.tolist(), pairs.detections.tolist(), strict=True))
    jumped = set(pairs.tracks[pairs.jumped].tolist())
    counted = []
    for k, track in enumerate(tracks):
        if k in found:
            item = event.seen.items[found[k]]
            jumps = track.jumps + 1 if k in jumped else 0
            track = replace(_found(track, item, event, world, camera), jumps=jumps)
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


def _found(track: Track, item: SceneObject, event: Arrival, world: Setting, camera: Pose) -> Track:
    given = world.parameters
    new = new_track(track.id, item, event.seen.turn, camera.orientation, world.frame)
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
    first, new = not belief.looks and given.first_confirmed, pairs.new
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
        item, seen = event.seen.items[k], event.seen
        track = new_track(
            f"fruit-{number}", item, seen.turn, seen.look.camera.orientation, world.frame
        )
        fresh.append(replace(track, confirmed=first, existence=existence, last_seen=event.time))
        number += 1
    if fresh:
        swings = _swings(tuple(fresh), given)
        spread = _white(event.seen.covariances[new], given)
        state = state.with_fruits(swings, event.seen.positions[new], spread)
    return Belief(belief.time, state, tracks + tuple(fresh), number, belief.looks + 1, left)
