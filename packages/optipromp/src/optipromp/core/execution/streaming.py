"""Curves that replace one another in motion: when each takes over, and who is asked for them."""

import threading
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Annotated

import numpy as np
from annotated_types import Unit

from optipromp.core.errors import ExecutionError
from optipromp.core.trajectory import State, Trajectory
from optipromp.core.values import Validated

PERIOD = 0.02  # [s] between two calls of a source, chosen: a camera's 50 Hz
TIE = 1e-9  # [s] by which times that were added up may differ, chosen
JOIN = {"q": 1e-4, "velocity": 1e-3, "acceleration": 1e-2}
"""Largest step of a joint where a curve takes over [rad or m, of it per s and s²]: chosen."""


@dataclass(frozen=True, eq=False)
class Stretch(Validated, label="stretch."):
    """A curve that takes over from the running one at a time of the executor.

    Args:
        curve: it ends at rest.
        begins: the executor's time of the curve's row 0 [s].

    Raises:
        InvalidRequestError: the curve is no trajectory, or ``begins`` is not finite.
    """

    curve: Trajectory
    begins: Annotated[float, Unit("s")]

    def at(self, time: float) -> State:
        """The state at the executor's time ``time`` [s]; after the end that of the last row."""
        return self.curve.at(time - self.begins)

    def ended(self, time: float) -> bool:
        """Whether the executor's time ``time`` [s] is at the curve's end or after it."""
        return time - self.begins >= self.curve.duration


Source = Callable[[float, State, State], Stretch | None]
"""Called with the executor's time [s], the measured state and the last commanded reference; returns
a stretch that takes over at its ``begins``, or None: what runs goes on."""


@dataclass(frozen=True)
class Line:
    """Stretches in the order in which they take over, each with the time of that [s].

    A stretch runs until the next takes over; the first runs before, too.
    """

    taken: tuple[tuple[float, Stretch], ...]

    @classmethod
    def of(cls, curve: Trajectory, begins: float = 0.0) -> "Line":
        """One curve that begins at ``begins`` [s]."""
        return cls(((begins, Stretch(curve, begins)),))

    def _running(self, time: float) -> int:
        return max(sum(takes <= time + TIE for takes, _ in self.taken) - 1, 0)

    def at(self, time: float) -> State:
        """The state of the stretch that runs at ``time`` [s]."""
        return self.taken[self._running(time)][1].at(time)

    def ended(self, time: float) -> bool:
        """Whether the last stretch has come to its end at ``time`` [s]."""
        return self.taken[-1][1].ended(time)

    def take(
        self, stretch: Stretch, now: float, most: Mapping[str, float] = JOIN, *, anew: bool = False
    ) -> "Line":  # fmt: skip
        """The line with a stretch that takes over at its begin, or ``now`` if that has passed.

        It comes in place of stretches that would take over later. What ran before ``now`` is left.

        Args:
            stretch: that takes over.
            now: the executor's time [s].
            most: largest step of a joint by field of a state, as :data:`JOIN`.
            anew: the arm has left the line, and the stretch begins where the arm is, by any step.

        Raises:
            ExecutionError: the stretch does not meet what runs when it takes over.
        """
        takes, running = max(stretch.begins, now), self._running(now)
        later = (one for one in self.taken[running + 1 :] if one[0] < stretch.begins)
        before = Line((self.taken[running], *later))
        gap = None if anew else gap_beyond(stretch.at(takes), before.at(takes), most)
        if gap is not None:
            what, joint, away = gap
            told = "" if what == "q" else f"{'an' if what[0] == 'a' else 'a'} {what} "
            raise ExecutionError(
                f"the curve begins with {told}{away:.4g} from the running one at "
                f"{stretch.curve.joint_names[joint]} (at most {most[what]:g})"
            )
        return Line((*before.taken, (takes, stretch)))


def gap_beyond(
    one: State, other: State, limits: Mapping[str, float]
) -> tuple[str, int, float] | None:
    """The first field whose largest difference exceeds its limit, the joint, the difference."""
    for what, most in limits.items():
        away = np.abs(getattr(one, what) - getattr(other, what))
        joint = int(np.argmax(away))
        if away[joint] > most:
            return what, joint, float(away[joint])
    return None


Question = tuple[float, State, State]
"""The arguments of a :data:`Source`."""


@dataclass(frozen=True)
class Reply:
    """What a source answered: a stretch and the reason to refuse its curve, or its failure."""

    asked: float
    stretch: Stretch | None = None
    refusal: str = ""
    error: BaseException | None = None


class Asking:
    """A source that is asked at once, by the thread that streams.

    ``source``: that is asked. ``refusal``: the reason to refuse a curve wherever it begins; empty
    if there is none.
    """

    def __init__(self, source: Source, refusal: Callable[[Trajectory], str]) -> None:
        self._source, self._refusal = source, refusal
        self._answers = SimpleQueue[Reply]()

    def ask(self, question: Question) -> None:
        """Put a question; the answer comes by :meth:`answers`, now or later."""
        self._answers.put(self._answered(question))

    def answers(self) -> Iterator[Reply]:
        """The answers since the last call; it does not wait for others."""
        while True:
            try:
                yield self._answers.get_nowait()
            except Empty:
                return

    def close(self) -> None:
        """Ask nothing more."""

    def _answered(self, question: Question) -> Reply:
        asked = question[0]
        try:
            found = self._source(*question)
            if found is None:
                return Reply(asked)
            if not isinstance(found, Stretch):
                raise TypeError(f"it returned a {type(found).__name__}, not a Stretch")
            return Reply(asked, found, self._refusal(found.curve))
        except BaseException as error:
            return Reply(asked, error=error)


class AskingApart(Asking):
    """A source that is asked by a thread of its own, with the newest question.

    A question that comes while the source works replaces the one that waits. After a failure the
    source is not asked again.
    """

    def __init__(self, source: Source, refusal: Callable[[Trajectory], str]) -> None:
        super().__init__(source, refusal)
        self._changed, self._open = threading.Condition(), True
        self._newest: Question | None = None
        self._thread = threading.Thread(target=self._work, name="source of curves", daemon=True)
        self._thread.start()

    def ask(self, question: Question) -> None:
        with self._changed:
            self._newest = question
            self._changed.notify()

    def close(self) -> None:
        """Ask nothing more; wait until the running call of the source has returned."""
        with self._changed:
            self._open = False
            self._changed.notify()
        self._thread.join()

    def _work(self) -> None:
        failed = False
        while not failed:
            with self._changed:
                self._changed.wait_for(lambda: self._newest is not None or not self._open)
                question, self._newest = self._newest, None
                if question is None or not self._open:
                    return
            answer = self._answered(question)
            self._answers.put(answer)
            failed = answer.error is not None
