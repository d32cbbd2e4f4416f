"""The tracker: looks in, fruits with positions, velocities, stems and covariances out.

A linear Kalman filter over all tracks jointly, so that the sway of the plant that they share is
learnt from each (:mod:`optipromp_loop.control.motion`); detections are assigned to tracks by the
least total distance (:mod:`optipromp_loop.control.belief`).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtri

from optipromp.core.arrays import BoolArray, FloatArray, read_only
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Shape
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import Role, SceneObject, Stem
from optipromp.core.scenes.scene import Scene, obstacles_of
from optipromp_loop.control.belief import (
    Arrival,
    Belief,
    Setting,
    after_look,
    first_belief,
    target_of,
)
from optipromp_loop.control.motion import bare_plant
from optipromp_loop.control.tracks import ROLES, Frame, Seen, TrackerParameters, push_noise


@dataclass(frozen=True, eq=False)
class Tracked:
    """The fruits at a time, as all looks before tell. F tracks, in the order of their birth.

    Attributes:
        time: [s].
        ids: of the tracks.
        roles: one is ``target`` at most.
        positions: (F, 3) [m].
        covariance: (F, 3, 3) of the positions [m²], with the share of the detector's errors that
            looks do not average out.
        rest: (F, 3) positions without sway, swing and push [m].
        rest_covariance: (F, 3, 3) [m²], with the same share.
        shapes: as last detected.
        existence: (F,) probability that there is a fruit.
        confirmed: (F,) whether the track counts as a fruit.
        last_seen: (F,) times [s].
    """

    time: float
    ids: tuple[str, ...]
    roles: tuple[Role, ...]
    positions: FloatArray
    covariance: FloatArray
    rest: FloatArray
    rest_covariance: FloatArray
    shapes: tuple[Shape, ...]
    existence: FloatArray
    confirmed: BoolArray
    last_seen: FloatArray
    _belief: Belief = field(repr=False)
    _world: Setting = field(repr=False)

    @property
    def ripe(self) -> BoolArray:
        """(F,) whether a track was detected as a target at least as often as otherwise."""
        return np.array([one.votes[0] >= max(one.votes) for one in self._belief.tracks], dtype=bool)

    def sway(self, times: FloatArray) -> FloatArray:
        """The predicted common displacement (M, 3) of the plant [m], at ``times`` as of moves."""
        state = self._belief.state
        count, half = 2 * state.layout.bank, state.layout.half
        a, b, _, _ = state.oscillators.some(slice(count)).transition(self._ahead(times)[:, None])
        x = a * state.mean[:count] + b * state.mean[half : half + count]
        return np.asarray(x.reshape(len(x), -1, 2).sum(axis=1) @ state.layout.axes)

    def moves(self, times: FloatArray) -> FloatArray:
        """The predicted displacement of each fruit from its rest, without pushes.

        Args:
            times: (M,) [s], not before the snapshot's.

        Returns:
            (M, F, 3) [m].
        """
        return self._belief.state.moves(self._ahead(times))

    def objects(self) -> tuple[SceneObject, ...]:
        """The confirmed fruits at rest, each with its stem and the covariance of its rest."""
        out, frame = [], self._world.frame
        for k in np.flatnonzero(self.confirmed).tolist():
            track, place = self._belief.tracks[k], self.rest[k]
            line = track.direction(frame.up, frame.axes)
            stem = Stem.along(place, line, track.length(self._world.parameters))
            spread, turn = self.rest_covariance[k], track.orientation
            item = (track.id, self.roles[k], track.shape, place, turn, stem, spread, track.physical)
            out.append(SceneObject(*item))
        return tuple(out)

    def _ahead(self, times: FloatArray) -> FloatArray:
        ahead = np.asarray(times, dtype=np.float64) - self.time
        if ahead.ndim != 1 or not (ahead >= -1e-9).all():
            raise InvalidRequestError(
                f"times {times} must be (M,) and not before the snapshot's {self.time:g} s"
            )
        return ahead


def snapshot(belief: Belief, time: float, world: Setting) -> Tracked:
    """The belief, predicted to ``time`` [s]: a time before the belief's counts as the belief's."""
    given = world.parameters
    ahead = time - belief.time if belief.time > -np.inf else 0.0
    state = belief.state.after(max(ahead, 0.0), given.drift)
    tracks, layout = belief.tracks, state.layout
    count = len(tracks)
    lasting = given.steady * np.array([track.spread for track in tracks]).reshape(-1, 3, 3)
    push = np.array([track.pushed for track in tracks]).reshape(-1, 3)
    at = 2 * layout.half + np.arange(3 * count).reshape(-1, 3)
    rest = state.covariance[at[:, :, None], at[:, None, :]]
    winner = target_of(tracks)
    return Tracked(
        time=max(time, belief.time),
        ids=tuple(track.id for track in tracks),
        roles=tuple(
            "target" if best else ROLES[1 + int(track.votes[2] > track.votes[1])]
            for best, track in zip(winner.tolist(), tracks, strict=True)
        ),
        positions=read_only((layout.position @ state.mean).reshape(-1, 3) + push),
        covariance=_even(state.spreads + lasting + push_noise(push, given)),
        rest=read_only(state.mean[at]),
        rest_covariance=_even(rest + lasting),
        shapes=tuple(track.shape for track in tracks),
        existence=read_only(np.array([t.existence for t in tracks])),
        confirmed=read_only(np.array([t.confirmed for t in tracks], dtype=bool)),
        last_seen=read_only(np.array([t.last_seen for t in tracks])),
        _belief=Belief(time, state, tracks),
        _world=world,
    )


def _even(spread: FloatArray) -> FloatArray:
    return read_only(0.5 * (spread + spread.transpose(0, 2, 1)))


@dataclass(frozen=True, eq=False)
class Innovations:
    """How far detections were from where the tracker expected them, in its own measure.

    Attributes:
        squares: (N,) normalised innovations squared, each given the tracks before it in its look:
            independent χ² of 3 degrees of freedom if the model holds.
        dropped: number of looks that came too late.
    """

    squares: FloatArray
    dropped: int = 0

    def consistent(self, level: float = 0.95) -> tuple[float, float, float, bool]:
        """The mean of the squares, the band that holds it with probability ``level``, and whether
        the band does. Without an update the mean is NaN and the band holds nothing."""
        count = len(self.squares)
        if not count:
            return float("nan"), 0.0, float("inf"), False
        tail = 0.5 * (1.0 - level)
        low, high = chdtri(3 * count, [1.0 - tail, tail]) / count
        mean = float(self.squares.mean())
        return mean, float(low), float(high), bool(low <= mean <= high)


Balls = Callable[[float], FloatArray]
"""Of a time [s]: balls (B, 4) that hide fruits, centres in the base frame and radii [m]."""


@dataclass(frozen=True, eq=False)
class _Entry:
    """A look that the tracker folded in: the belief before and after, and the innovations."""

    before: Belief
    event: Arrival
    after: Belief
    squares: FloatArray


class Tracker:
    """Tracks the fruits of a plant that moves, from looks that come late and out of order.

    Args:
        scene: gives the vertical and the static objects, which hide fruits; its other objects are
            not tracked.
        parameters: of motion, looks, association, birth and death.
        tool: the balls of the arm and its tool that hide fruits at a time; None: none hides.
        first: objects with covariances that begin as confirmed tracks, under their ids.

    Raises:
        InvalidRequestError: a first object has no covariance or is static; ids of first objects
            repeat, or are more than ``parameters.most``.
    """

    def __init__(
        self,
        scene: Scene,
        parameters: TrackerParameters | None = None,
        *,
        tool: Balls | None = None,
        first: Iterable[SceneObject] = (),
    ) -> None:
        given = TrackerParameters() if parameters is None else parameters
        objects = tuple(first)
        names = frozenset(item.id for item in objects)
        if len(names) < len(objects):
            raise InvalidRequestError("ids of first objects repeat: must be unique")
        if len(names) > given.most:
            raise InvalidRequestError(f"{len(names)} first objects: must be {given.most} at most")
        for item in objects:
            if item.covariance is None:
                raise InvalidRequestError(f"first object {item.id} has no covariance")
        plant = bare_plant(scene.up, given.frequencies, given.damping, given.sway)
        static = obstacles_of(scene, "static") if scene.static else None
        self._world = Setting(given, Frame(scene.up, plant.layout.axes), static, names)
        self._tool = tool
        self._start = first_belief(plant, objects, self._world)
        self._entries: list[_Entry] = []
        self._squares: list[FloatArray] = []
        self._dropped = 0

    @property
    def parameters(self) -> TrackerParameters:
        """Those that the tracker was made with."""
        return self._world.parameters

    @property
    def time(self) -> float:
        """Time of the newest look [s]; minus infinity before the first."""
        return self._newest.time

    @property
    def left(self) -> int:
        """Number of detections and tracks that the newest look left out, as too many."""
        return self._newest.left

    def add(self, look: Look, pushed: Mapping[str, FloatArray] | None = None) -> None:
        """Fold a look in.

        A look that is older than the newest is folded in where it belongs, and the looks after it
        again; one that is older by more than ``late`` is dropped and counted.

        Args:
            look: its time may be before that of looks added earlier.
            pushed: displacement (3,) [m] of tracks by the arm at the look's time, by their ids;
                a track that is not named is not pushed.

        Raises:
            InvalidRequestError: a time or a push is not finite.
        """
        if not math.isfinite(look.time):
            raise InvalidRequestError(f"the look's time is {look.time}: must be finite")
        if look.time < self.time - self.parameters.late:
            self._dropped += 1
            return
        pushes = _pushes(pushed or {})
        balls = np.zeros((0, 4)) if self._tool is None else np.asarray(self._tool(look.time))
        again = [Arrival(Seen.of(look), pushes, balls.reshape(-1, 4))]
        while self._entries and self._entries[-1].event.time > look.time:
            again.append(self._entries.pop().event)
        for event in reversed(again[1:] + again[:1]):
            before = self._newest
            self._entries.append(_Entry(before, event, *after_look(before, event, self._world)))
        oldest = self.time - self.parameters.late  # of looks that a late one could come before
        while len(self._entries) > 1 and self._entries[1].event.time < oldest:
            entry = self._entries.pop(0)
            self._start = entry.after
            self._squares.append(entry.squares)
        del self._squares[: -self.parameters.kept]

    def at(self, time: float) -> Tracked:
        """The fruits at ``time`` [s], predicted from the newest look.

        A time before the newest look is answered from the last look that is kept before it.

        Raises:
            InvalidRequestError: the time is not finite.
        """
        if not math.isfinite(time):
            raise InvalidRequestError(f"time is {time}: must be finite")
        belief = self._newest
        for entry in reversed(self._entries):
            if belief.time <= time:
                break
            belief = entry.before
        return snapshot(belief, time, self._world)

    @property
    def statistics(self) -> Innovations:
        """The innovations of the last updates, oldest first."""
        squares = self._squares + [entry.squares for entry in self._entries]
        kept = squares[-self.parameters.kept :]
        return Innovations(np.concatenate([np.zeros(0), *kept]), self._dropped)

    @property
    def _newest(self) -> Belief:
        return self._entries[-1].after if self._entries else self._start


def _pushes(pushed: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    pushes = {name: np.array(value, dtype=np.float64) for name, value in pushed.items()}
    for name, value in pushes.items():
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InvalidRequestError(f"push of {name} is {value}: must be (3,) and finite")
    return pushes
