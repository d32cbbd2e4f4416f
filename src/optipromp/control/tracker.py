"""The tracker: looks in, fruits with positions, velocities, stems and covariances out.

A linear Kalman filter over all tracks jointly, so that the sway of the plant that they share is
learnt from each (:mod:`optipromp.control.motion`); detections are assigned to tracks by the least
total distance (:mod:`optipromp.control.association`).
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from optipromp.control.belief import Arrival, Belief, Record, Setting, begun, step
from optipromp.control.look import Look
from optipromp.control.motion import Plant
from optipromp.control.tracked import Innovations, Tracked, snapshot
from optipromp.control.tracks import Frame, Seen, TrackerParameters
from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.objects import SceneObject
from optipromp.core.scenes.scene import Scene

Balls = Callable[[float], FloatArray]
"""Of a time [s]: balls (B, 4) that hide fruits, centres in the base frame and radii [m]."""


@dataclass(frozen=True, eq=False)
class _Entry:
    """A look that the tracker folded in: the belief before and after, and the innovations."""

    before: Belief
    event: Arrival
    after: Belief
    record: Record


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
        plant = Plant(scene.up, given.frequencies, given.damping, given.sway)
        static = scene.obstacles("static") if scene.static else None
        self._world = Setting(given, Frame(scene.up, plant.axes), static, names)
        self._tool = tool
        self._start = begun(plant.still(), objects, self._world)
        self._entries: list[_Entry] = []
        self._records: list[Record] = []
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
            self._fold(event)
        self._forget()

    def at(self, time: float, pushed: Mapping[str, FloatArray] | None = None) -> Tracked:
        """The fruits at ``time`` [s], predicted from the newest look.

        A time before the newest look is answered from the last look that is kept before it.

        Args:
            time: [s].
            pushed: displacement (3,) [m] of tracks by the arm at that time, by their ids; None:
                as at the newest look.

        Raises:
            InvalidRequestError: the time or a push is not finite.
        """
        if not math.isfinite(time):
            raise InvalidRequestError(f"time is {time}: must be finite")
        belief = self._newest
        for entry in reversed(self._entries):
            if belief.time <= time:
                break
            belief = entry.before
        return snapshot(belief, time, self._world, None if pushed is None else _pushes(pushed))

    @property
    def statistics(self) -> Innovations:
        """The innovations of the last updates, oldest first."""
        records = (self._records + [entry.record for entry in self._entries])[
            -self.parameters.kept :
        ]
        counts = [len(record.ids) for record in records]
        return Innovations(
            np.repeat([record.time for record in records], counts),
            tuple(name for record in records for name in record.ids),
            np.concatenate([np.zeros(0), *(record.squares for record in records)]),
            self._dropped,
        )

    @property
    def _newest(self) -> Belief:
        return self._entries[-1].after if self._entries else self._start

    def _fold(self, event: Arrival) -> None:
        before = self._newest
        after, record = step(before, event, self._world)
        self._entries.append(_Entry(before, event, after, record))

    def _forget(self) -> None:
        """Keep the looks that a late look could come before, and one more."""
        oldest = self.time - self.parameters.late
        while len(self._entries) > 1 and self._entries[1].event.time < oldest:
            entry = self._entries.pop(0)
            self._start = entry.after
            self._records.append(entry.record)
        del self._records[: -self.parameters.kept]


def _pushes(pushed: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    pushes = {name: np.array(value, dtype=np.float64) for name, value in pushed.items()}
    for name, value in pushes.items():
        if value.shape != (3,) or not np.isfinite(value).all():
            raise InvalidRequestError(f"push of {name} is {value}: must be (3,) and finite")
    return pushes
