r"""A way for a hand through things that stand on a board: where to push what, decided beforehand.

A thing in the way has to go to one side, and there has to be room for it there; where the target
stands close by it must not be pushed along. Which way does that is found by trying: ways of a few
corners are drawn at random, each is played through in the quasi-static model
(:mod:`optipromp.pushing.trials`), and the draw closes in on the best (cross-entropy method).

All of it happens in the plane of the board, in (u, v) along z_g and y_g from the target.
"""

import bisect
import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.pushing.plane import FRICTION, Plane, plane
from optipromp.pushing.trials import Bench, cost
from optipromp.robots.tools import FrankaHand
from optipromp.scenes.scene import Scene

SIDEWAYS = 0.12  # [m] the way leads aside at most
CORNERS = (3, 4)  # of a way, besides its ends: in the first run of the search, and after it
ATTEMPTS = 5  # runs of the search, until a way is good
ROUNDS = ((300, 1), (150, 1), (150, 1), (150, 1), (150, 1), (50, 4), (50, 4), (50, 4))
"""Of a run: how many ways are drawn, and in how many trials each is judged."""
CLOSER = ((80, 6), (80, 8), (60, 16))
"""The same, about the best way of a run that is not good enough yet and not hopeless."""
HOPELESS = 16.0  # a cost
FINAL = 3  # ways of a run that are judged to the end
KEPT = 20  # ways that the next draw closes in on
TRIALS = 30  # with everything a little elsewhere, for the ways that are left
GOOD = 1.2  # a cost that needs no better,
LENIENT = 2.0  # and after each run of the search this many times as much
SLIPPERY = 0.4, 1.4  # the friction of the trials, in that which is taken for granted

Judged = tuple[float, FloatArray]
"""A cost, and the numbers that a way is drawn as."""


@dataclass(frozen=True, eq=False)
class Way:
    """A way of the tool, and what it is expected to do.

    Attributes:
        corners: (k, 3) of the tool point, from the entry to the target [m].
        cost: expected; below 1 the target stands nearly still and everything goes where there is
            room.
    """

    corners: FloatArray
    cost: float


@dataclass(frozen=True, eq=False)
class Trials:
    """Where ways are tried: the plane, ``states`` (N, B, 3) of the things in it, frictions (N,).

    From the ``deadline`` on (of ``time.perf_counter()``) each call of :meth:`best` tries one.
    """

    plane: Plane
    bench: Bench
    states: FloatArray
    slips: FloatArray
    deadline: float = np.inf

    def best(
        self, drawn_as: Iterable[FloatArray], count: int, keep: int, known: Sequence[Judged] = ()
    ) -> list[Judged]:
        """The ``keep`` best of some ways and of those ``known``, by the first ``count`` trials."""
        out = list(known)
        for at in drawn_as:
            if out and time.perf_counter() > self.deadline:
                break
            limit = out[keep - 1][0] if len(out) >= keep else np.inf
            worth = cost(
                self.bench, drawn(self.plane, at), self.states[:count], self.slips[:count], limit
            )
            if worth < limit:
                bisect.insort(out, (worth, at), key=lambda item: item[0])
        return out[:keep]


def ways(
    scene: Scene,
    tool: FrankaHand,
    rng: np.random.Generator,
    count: int = 1,
    deadline: float = np.inf,
    behind: Sequence[FloatArray] = (),
) -> list[Way]:
    """The best ways found, best first.

    Args:
        scene: that :func:`optipromp.pushing.plane.ploughs`.
        tool: the hand.
        rng: where the draws come from.
        count: how many are wanted.
        deadline: ``time.perf_counter()`` after which no further way is tried.
        behind: convex polygons (k, 2) of the wrist behind the hand, as of its outline [m].
    """
    board = plane(scene, tool)
    target = scene.target
    assert target is not None
    states = np.tile(board.state, (1 + TRIALS, 1, 1))
    errors = rng.standard_normal((TRIALS, len(board.state), 2))
    states[1:, :, :2] += board.deviation[:, None] * errors
    slips = FRICTION * np.append(1.0, rng.uniform(*SLIPPERY, TRIALS))
    trials = Trials(board, board.bench(tool, behind), states, slips, deadline)

    best: list[Judged] = []
    for attempt in range(ATTEMPTS):
        bends = CORNERS[min(attempt, 1)]
        spread = np.array([0.06, *[0.05, 0.06] * bends])
        shares = np.linspace(1.0, 0.0, bends + 2)[1:-1]
        middle = np.array([0.0, *np.ravel([[share * board.entry, 0.0] for share in shares])])
        found = _search(trials, middle, spread, spread, ROUNDS, rng)
        good = GOOD * LENIENT**attempt
        if good < found[0][0] < HOPELESS:
            found += _search(trials, found[0][1], 0.3 * spread, spread, CLOSER, rng)
        best = sorted(best + found, key=lambda item: item[0])
        if best[0][0] < good or time.perf_counter() > deadline:
            break
    frame = scene.frame[[2, 1, 0]]
    out = []
    for worth, at in best[:count]:
        corners = drawn(board, at)
        out.append(Way(target.position + lowered(corners, board.drop) @ frame, worth))
    return out


def _search(
    trials: Trials,
    middle: FloatArray,
    deviation: FloatArray,
    spread: FloatArray,
    rounds: Sequence[tuple[int, int]],
    rng: np.random.Generator,
) -> list[Judged]:
    """One run of the cross-entropy method: some ways and what they cost, best first.

    Ways are judged with everything where it was seen (the first of ``trials``); those that do well
    there, and what is drawn near them, with everything a little elsewhere.
    """
    seen: list[Judged] = []
    for turn, (draws, count) in enumerate(rounds):
        if turn and count != rounds[turn - 1][1]:
            seen = trials.best((at for _, at in seen), count, KEPT)
        new = middle + deviation * rng.standard_normal((draws, len(middle)))
        seen = trials.best(new, count, KEPT, seen)
        best = np.array([at for _, at in seen])
        middle = best.mean(axis=0)
        deviation = best.std(axis=0) + 0.1 * spread
    return trials.best((at for _, at in seen), len(trials.slips), FINAL)


def drawn(board: Plane, at: FloatArray) -> FloatArray:
    """Corners (k, 2) of a way, from the numbers it is drawn as: v of the entry, u and v of each."""
    middle = at[1:].reshape(-1, 2)
    corners = np.vstack([[board.entry, at[0]], middle, [0.0, 0.0]])
    corners[:, 0] = np.clip(corners[:, 0], board.entry, 0.0)
    corners[:, 1] = np.clip(corners[:, 1], -SIDEWAYS, SIDEWAYS)
    return corners


def lowered(corners: FloatArray, drop: float) -> FloatArray:
    """Corners (k, 3) in (u, v) and along x_g of a way (k, 2): low, and up where it ends."""
    if drop == 0.0:
        return np.column_stack([corners, np.zeros(len(corners))])
    flat = np.vstack([corners, corners[-1:]])
    return np.column_stack([flat, [drop] * len(corners) + [0.0]])
