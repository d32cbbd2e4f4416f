"""The interface of candidate tool paths, and the schedule of their search."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from optipromp.core.arrays import FloatArray
from optipromp.core.pushing.path import ToolPath


@dataclass(frozen=True)
class Round:
    """One round of a search.

    Attributes:
        candidates: number of tool paths that are sampled.
        states: number of states of the scene that each path is tried in.
    """

    candidates: int
    states: int


@dataclass(frozen=True)
class Schedule:
    """The rounds and numbers of a search.

    Attributes:
        rounds: of a run.
        runs: largest number of runs; the next run begins where no path is good.
        kept: number of best candidates, about which the next candidates are sampled.
        screened: number of best candidates that are tried in ``states`` states after each round.
        states: number of states in the search; a followed trajectory is tried in all states.
        fresh: share of the candidates that are sampled from :meth:`Candidates.spread`.
        lenient: factor on the harm that counts as good, after each round without a good path.
    """

    rounds: tuple[Round, ...]
    runs: int
    kept: int
    screened: int
    states: int
    fresh: float
    lenient: float


class Candidates(ABC):
    """The candidate paths of the tool in one scene, each given by k numbers.

    Attributes:
        schedule: of the search.
        entry: position along z_g at which paths begin [m]; -inf: anywhere.
        indifferent: largest additional harm of a path that is preferred to another, see
            :meth:`rather`.
    """

    schedule: Schedule
    entry: float = -math.inf
    indifferent: float = 0.0

    @abstractmethod
    def path(self, x: FloatArray) -> ToolPath:
        """The path of a candidate (k,)."""

    @abstractmethod
    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """Penalty that is added to a candidate's harm, for a detour or a lack of clearance."""

    @abstractmethod
    def first(self) -> FloatArray:
        """Candidates (m, k) that are tried before any sample; m may be 0."""

    def rather(self, x: FloatArray, path: ToolPath) -> list[FloatArray]:
        """Candidates that replace the good one ``x`` (k,), if their harm is nearly as small.

        Nearly: larger by less than :attr:`indifferent`.
        """
        return []

    @abstractmethod
    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (k,) of the first samples of a run."""
