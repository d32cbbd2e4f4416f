"""``rollout``: an agent moves an arm, turn by turn, until it has nothing more to do; then the word.

A turn is a few references, or a whole curve. *Agents* are the :class:`Legs` of a plan, a controller
(:class:`optipromp_sim.simulation.execute.Controlled`) and, in the benchmark, a policy, alone or
behind a guard. *Arenas* are the arm in MuJoCo (:class:`optipromp_sim.simulation.Simulation`) and
the benchmark's cup in flight. An agent may sit behind messages, as in the tests of ROS's node. A
real arm is no arena: it wants a reference at each of up to 1,000 ticks a second, and a tick that
waited for an agent would end the motion. So its executor keeps the time, asks apart from its ticks
(:meth:`optipromp.core.execution.executor.Follower.follow`), and rclpy calls the node. What they ask
is the same controller (:meth:`optipromp_sim.simulation.execute.Controlled.asked`).
"""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Generic, Protocol, TypeVar

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import ExecutionError
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_sim.simulation.contacts import HarmSoFar
from optipromp_sim.simulation.detector import Eye
from optipromp_sim.simulation.records import Rollout
from optipromp_sim.simulation.simulation import FruitStates

Turn = Sequence[State] | Trajectory
"""References of the controller's next ticks, or a curve that is followed to its end."""


class Judged(Protocol):
    """The judgement of a run: ``clean``, ``harmed`` or ``missed``."""

    @property
    def result(self) -> str: ...


W = TypeVar("W", bound=Judged)
W_co = TypeVar("W_co", bound=Judged, covariant=True)


class Arena(Protocol[W_co]):
    """Where an arm moves; :class:`optipromp_sim.simulation.Simulation` tells of each."""

    @property
    def scene(self) -> Scene: ...
    @property
    def robot(self) -> Robot: ...
    @property
    def tick(self) -> float: ...
    @property
    def time(self) -> float: ...
    @property
    def broken(self) -> bool: ...
    def state(self) -> State: ...
    def step(self, reference: State) -> State: ...
    def follow(self, motion: Trajectory) -> tuple[Rollout | None, W_co]: ...
    def fruits(self) -> FruitStates: ...
    def held(self) -> tuple[str, ...]: ...
    def wrench(self) -> FloatArray: ...
    def harm(self) -> HarmSoFar: ...
    def grip(self) -> None: ...
    def rollout(self) -> Rollout | None: ...
    def outcome(self) -> W_co: ...


class Pick(Generic[W]):
    """A pick under way.

    Args:
        arena: where it happens.
        eye: the camera; None: nobody looks.
        settle: time for which the arm stands at first [s].
        period: of turns that are references, a multiple of the arena's tick [s].

    Attributes:
        arena, eye: see above; ``ticks`` of the arena has a turn of references.
        state, reference: of the arm after the last turn.
        began: time at which the arm had stood [s].
        looks: that came since the turn before.
        path: (n,) reference at the end of each turn.
        taken: (3,) the tool point where the target was cut off; None: it was not.
        records, word: of what was judged last; None: nothing was, or references came after it.
    """

    def __init__(
        self, arena: Arena[W], eye: Eye | None = None, settle: float = 0.0, period: float = 0.02
    ) -> None:
        self.arena, self.eye, self.ticks = arena, eye, round(period / arena.tick)
        self.state = arena.state()
        self.reference = State(self.state.q)
        for _ in range(round(settle / arena.tick)):
            self.state = arena.step(self.reference)
        self.began, self.looks = arena.time, tuple[Look, ...]()
        self.path = [self.reference.q]
        self.taken: FloatArray | None = None
        self.records: Rollout | None = None
        self.word: W | None = None
        self._see()

    @property
    def time(self) -> float:
        """Since the arm had stood [s]."""
        return self.arena.time - self.began

    @property
    def broken(self) -> bool:
        """Whether the physics broke down."""
        return self.arena.broken

    def point(self) -> FloatArray:
        """The tool point (3,) as measured."""
        return self.arena.robot.tool_pose(self.state.q)[0]

    def lead(self, turn: Turn) -> None:
        """Move the arm by a turn."""
        if isinstance(turn, Trajectory):
            self.records, self.word = self.arena.follow(turn)
            self.state, self.reference = self.arena.state(), State(turn.positions[-1])
            return
        self.word = None
        with suppress(ExecutionError):  # the arena is broken, and the judgement tells of it
            for each in turn:
                self.reference = each
                self.state = self.arena.step(each)
        self.path.append(self.reference.q)
        if not self.broken:
            self._see()

    def _see(self) -> None:
        if self.eye is None:
            return
        now = self.arena.time
        self.eye.see(now, self.state.q, self.arena.fruits())
        self.looks = self.eye.delivered(now)

    def take(self) -> None:
        """Cut the stem of the target, and hold the target in the tool, where it is now."""
        self.arena.grip()
        self.taken = self.point()

    def judged(self) -> W:
        """Stand still for a moment, as after a curve, and judge all that happened."""
        if self.word is None:
            self.records, self.word = self.arena.rollout(), self.arena.outcome()
        return self.word


P_contra = TypeVar("P_contra", bound=Pick[Any], contravariant=True)


class Agent(Protocol[P_contra]):
    """What moves an arm."""

    def __call__(self, pick: P_contra, /) -> Turn | None:
        """The next turn; None: there is nothing more to do."""


class Legs:
    """The curves of a plan: the first, and those of the way out once the target is held alone."""

    def __init__(self, *curves: Trajectory) -> None:
        self._left = list(curves)

    def __call__(self, pick: Pick[Any]) -> Turn | None:
        """See :class:`Agent`."""
        if not self._left:
            return None
        if pick.word is not None and pick.taken is None:
            if pick.word.result != "clean":
                return None
            pick.take()
        return self._left.pop(0)


def rollout(agent: Agent[Any], pick: Pick[W]) -> W:
    """The judgement once the agent has nothing more to do, or the physics broke down."""
    while not pick.broken and (turn := agent(pick)) is not None:
        pick.lead(turn)
    return pick.judged()
