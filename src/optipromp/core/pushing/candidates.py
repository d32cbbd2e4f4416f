"""The interface of candidate tool paths: how they are sampled, and how long the search goes on."""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

from optipromp.core.arrays import FloatArray
from optipromp.core.pushing.path import ToolPath


@dataclass(frozen=True)
class Round:
    """One round of a search.

    Attributes:
        candidates: how many tool paths are sampled.
        states: on how many states of the scene each is tried.
    """

    candidates: int
    states: int


@dataclass(frozen=True)
class Schedule:
    """How long a search goes on.

    Attributes:
        rounds: of one run.
        runs: largest number of runs; a further one begins where no path is good.
        kept: number of best candidates, about which the next ones are sampled.
        screened: number of these that are tried on ``states`` states after each round.
        states: number of states in the search; a followed trajectory is tried on all.
        fresh: share of the candidates that are sampled from the model's own spread.
        lenient: factor on the harm that counts as good, after each round that found no good path.
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
        entry: where paths begin along z_g [m]; -inf: anywhere.
        indifferent: a difference of harm that decides nothing where a path is preferred.
    """

    schedule: Schedule
    entry: float = -math.inf
    indifferent: float = 0.0

    @abstractmethod
    def path(self, x: FloatArray) -> ToolPath:
        """The path of a candidate (k,)."""

    @abstractmethod
    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """Penalty added to a candidate's harm: for a detour, for too little room for the tool."""

    @abstractmethod
    def first(self) -> FloatArray:
        """Candidates (m, k) that are tried before any is sampled; m may be 0."""

    def rather(self, x: FloatArray, path: ToolPath) -> list[FloatArray]:
        """Candidates that are preferred to the good one ``x`` (k,) if they are nearly as good.

        Nearly: their harm is larger by less than :attr:`indifferent`.
        """
        return []

    @abstractmethod
    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation (k,) of the candidates that a run begins with."""
