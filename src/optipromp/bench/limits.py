"""What an entry may take: time to think, size of an answer, length of a motion; and its errors."""

from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.parameters import parameter
from optipromp.core.shown import printable

MOTION = 60.0  # [s] of a motion: a choice; plans take 4 to 12 s
ROWS = 100_000  # of a motion: a choice; a millisecond apart, 60 s have 60,000
ACTION = 1000  # joints of an action, far more than an arm has: a choice
LINE = 100_000  # [byte] of a line that an entry answers: a choice; one of a velocity has 200
WORDS = 300  # letters of a cause: a choice, a line of a table
RUN_FILE, ROW_FILE = 1_000_000, 64_000_000
"""Most bytes of run.json and of rows.csv, chosen: 4,000 scenes in two engines have 2 million."""
MOTION_FILE, SUBMISSION = 24_000_000, 500_000_000
"""Most bytes of the arrays of one motion (ROWS of seven joints have 18 million), and of a
submission's file (800 motions have 50 million), chosen."""
MEMBERS = 20_000  # files in a submission: a choice; 4,000 scenes have 4,002


@dataclass(frozen=True)
class Patience:
    """How long an entry may take for an answer, to its last byte; after that it is ended."""

    start: float = parameter(600.0, "s", "choice", "imports, networks; kernels compile at first")
    plan: float = parameter(60.0, "s", "choice", "of a scene; the slowest entry of ours takes 5 s")
    reset: float = parameter(30.0, "s", "choice", "policies that plan in reset take seconds")
    act: float = parameter(1.0, "s", "choice", "fifty times the 20 ms that an action is for")


PATIENCE = Patience()


class EntryError(InvalidRequestError):
    """What an entry did wrong in one scene: its row says so, and the run goes on."""


def words(text: str) -> str:
    """A text of an entry as a cause in a row: one printable line of at most WORDS letters."""
    line = printable(" ".join(text.split()))
    return line if len(line) <= WORDS else f"{line[: WORDS - 4]} ..."


def too_long(times: FloatArray) -> str:
    """Why a motion with these times [s] is not executed; empty: it may be."""
    if not np.isfinite(times).all() or len(times) > ROWS:
        return f"{len(times)} rows; must be at most {ROWS}, all finite"
    took = float(times[-1]) if len(times) else 0.0
    return f"takes {took:g} s; at most {MOTION:g}" if took > MOTION else ""
