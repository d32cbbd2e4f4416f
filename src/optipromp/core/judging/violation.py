"""A reason why a trajectory is not valid."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Violation:
    """One reason why a trajectory is not valid.

    Args:
        kind: ``contact``, ``unchecked``, ``goal``, ``axis``, ``stem side``, ``limit``,
            ``velocity``, ``acceleration``, ``jerk``, ``speed``, ``start``, ``motion``, ``drift``,
            ``stem``, ``upright``, ``plane``, ``line`` or ``line speed``.
        message: the reason as a sentence, which is also ``str(violation)``.
        subject: the link, joint or object concerned; empty where there is none.
        time: of the largest amount [s]; None where the violation has no time.
        amount: size of the violation, in ``unit``; for a velocity, acceleration or jerk the share
            of the limit.
    """

    kind: str
    message: str
    subject: str = ""
    time: float | None = None
    amount: float | None = None
    unit: str = ""

    def __str__(self) -> str:
        return self.message
