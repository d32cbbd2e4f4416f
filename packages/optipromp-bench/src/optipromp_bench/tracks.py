"""What an entry is asked for, by track, and the motion that it gives.

===========  ======================================================================================
``plan``     ``plan(scene, seed)`` gives one trajectory; None: the entry refuses the scene
``policy``   ``reset(scene, seed)``, then ``act(seen)`` every 20 ms gives joint velocities
``picture``  ``plan(picture, known, seed)`` gives one trajectory: colours and depth in, with the
             scene as known before any picture (robot, tool, approach, start, static objects)
===========  ======================================================================================

A scene ends when the tool is out of the plant. Once the target alone is in the tool and nothing is
harmed, its stem is cut. The tool then leaves as the entry says, else back along the way it came.

An entry is a class without arguments, in a process of its own (:mod:`optipromp_bench.serve`). A
motion is all that an entry did, so both engines execute it, and ``bench verify`` does so again.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidRequestError, printable
from optipromp.core.judging import extremes
from optipromp.core.parameters import parameter
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.task import posed
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import CURVE, Trajectory
from optipromp_bench.entrant import Motion, Refused, motion_of
from optipromp_bench.episode import LONGEST, Driven, Episode, Observation, leaving
from optipromp_bench.flight import Word
from optipromp_sim.simulation import Outcome
from optipromp_sim.simulation.rollouts import Agent, Turn, rollout

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


Track = Literal["plan", "policy", "picture"]
TRACKS: tuple[Track, ...] = ("plan", "policy", "picture")
CONDITION: Mapping[Track, str] = {"plan": "none", "policy": "sway", "picture": "none"}
"""Of each track by default; see :mod:`optipromp_sim.situations`."""
BACK = tuple(f"back_{name}" for name in CURVE)
"""Names of the way out's arrays in a file."""
LIMIT = 1.001  # share of a joint's limit that counts as within: rounding of files
AT_START = 1e-4  # [rad or m] of the trajectory's begin off the scene's start: rounding of files


class Planning(Protocol):
    """An entry of the track ``plan``."""

    def plan(self, scene: Scene, seed: int) -> Trajectory | Plan | Picked | None:
        """A motion from the scene's start; None, or a plan without success: refused.

        The way out of a ``Picked`` is its leg ``retreat``.
        """


class Acting(Protocol):
    """An entry of the track ``policy``.

    Where the class says ``leaves = True``, it goes on once its target is taken
    (``Observation.holding``), until the tool is 10 cm from where it took the target.
    """

    def reset(self, scene: Scene, seed: int) -> None:
        """A new episode in a scene, as first seen."""

    def act(self, seen: Observation) -> FloatArray:
        """Joint velocities (n,) [rad/s] for the next 20 ms."""


@dataclass(frozen=True, eq=False)
class Deed:
    """What an entry did in one scene."""

    # of the tracks ``plan`` and ``picture``; None: refused, or another track
    trajectory: Trajectory | None = None
    back: Trajectory | None = None  # the way out; None: as the tool came
    # (k, n) joint velocities of the track ``policy``; None: another track
    actions: FloatArray | None = None
    thought: float = 0.0  # wall time of the entry [s]; of a policy, the median of a call
    why: str = ""  # of a refusal, or of a motion that is not executed

    @property
    def refused(self) -> bool:
        """Whether there is nothing to execute."""
        return self.trajectory is None and self.actions is None

    def arrays(self) -> dict[str, FloatArray]:
        """The trajectories as arrays by name, for a file; empty without one."""
        out: dict[str, FloatArray] = {}
        for names, own in ((CURVE, self.trajectory), (BACK, self.back)):
            if own is not None:
                out |= zip(names, (own.times, *own.rows()), strict=True)
        return out


def asked(call: Callable[[], Any], scene: Scene) -> Deed:
    """The motion of an entry's answer, which is checked before it is executed."""
    began = time.perf_counter()
    answer = motion_of(call())
    thought = time.perf_counter() - began
    if isinstance(answer, Refused):
        return Deed(thought=thought, why=answer.why)
    wrong = refusal(answer, scene)
    return Deed(thought=thought, why=wrong) if wrong else Deed(*answer, thought=thought)


def refusal(motion: Motion, scene: Scene) -> str:
    """Why a motion from a scene's start is not executed; empty: it is."""
    begin = None
    for each in motion:
        if each is None:
            continue
        wrong = too_long(each.times) or against(each, scene, begin)
        names = posed(scene)[0].joint_names
        if not wrong and each.joint_names != names:
            wrong = f"joints {', '.join(each.joint_names)}; must be {', '.join(names)}"
        if wrong:
            return wrong if each is motion.reach else f"the way out: {wrong}"
        begin = each.positions[-1]
    return ""


def against(trajectory: Trajectory, scene: Scene, begins: FloatArray | None = None) -> str:
    """What a controller of the scene's robot would refuse a trajectory for; empty: nothing.

    The words have joint, value, limit and time of the gravest excess, and what would be right.
    ``begins``: configuration (n,) at which it has to begin, the end of a reach; None: the start.
    """
    robot, state = posed(scene)
    words, start = ("the start", state.q) if begins is None else ("the reach's end", begins)
    names, turns = robot.joint_names, robot.kinematics
    if (count := trajectory.positions.shape[1]) != len(names):
        return f"the motion has {count} joints; {robot.name} has {len(names)}: {', '.join(names)}"
    k = int(np.argmax(np.abs(trajectory.positions[0] - start)))
    begin = trajectory.positions[0, k]
    if abs(begin - start[k]) > AT_START:
        return f"{names[k]} begins at {begin:.6g}; {words} is {start[k]:.6g}: begin there"
    most = extremes(trajectory)
    values = np.stack([most.lowest, most.highest, *most.largest[:2]])
    limits = np.stack([robot.lower, robot.upper, robot.velocity, robot.acceleration])
    over = np.stack([limits[0] - values[0], values[1] - limits[1]]) / AT_START  # far above 1
    over = np.concatenate([over, values[2:] / (LIMIT * limits[2:])])
    if over.max() <= 1.0:
        return ""
    row, k = divmod(int(np.argmax(over)), len(names))
    unit = ("m" if (turns.kind[turns.dof == k] == 1).any() else "rad") + ("", "", "/s", "/s²")[row]
    right = "keep the path in its range" if row < 2 else "time it with optipromp.timing"
    return (
        f"{names[k]} reaches {values[row, k]:.4g} {unit} at {most.when[row, k]:.2f} s; its limit "
        f"is {limits[row, k]:.4g}: {right}"
    )


def acted(policy: Acting, episode: Episode, seed: int) -> tuple[Deed, Outcome | Word]:
    """Let a policy act until the episode is over, and judge it.

    Raises EntryError where the policy gave no velocities.
    """
    policy.reset(episode.scene, seed)
    agent = Driven(policy.act, getattr(policy, "leaves", False))
    try:
        word = rollout(leaving(agent), episode)
    except EntryError:
        raise
    except InvalidRequestError as error:
        raise EntryError(error.message) from None
    actions = np.array(agent.actions).reshape(-1, episode.robot.n_joints)
    return Deed(actions=frozen(actions), thought=float(np.median(agent.times or [0.0]))), word


def replay(actions: FloatArray) -> Agent[Episode]:
    """An agent that takes the actions (k, n) that a policy took."""
    left = iter(actions)

    def again(episode: Episode) -> Turn | None:
        velocity, why = next(left, None), ""
        if velocity is not None and episode.over(leaving=True):
            lasts = f"after {len(episode.path) - 1}, and lasts {LONGEST:g} s at most"
            why = f"the episode is over {lasts}"
        elif velocity is None and not episode.over(leaving=False):
            why = "after them the episode goes on"
        if why:
            raise InvalidRequestError(f"{len(actions)} actions; {why}")
        return None if velocity is None else episode.toward(velocity)

    return leaving(again)
