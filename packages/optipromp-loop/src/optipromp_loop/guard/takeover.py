"""The loop in a policy's place: it has the arm from where the guard holds the policy up.

The controller of :mod:`optipromp_loop.control` goes on from where the arm comes to rest, and picks
by a pick that it commits itself to. A tool among fruits leaves them first, by the least harmful way
out of the way that it came. The policy has the arm again when the tool is out of the plant.
"""

import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.execution.streaming import Line, Stretch
from optipromp.core.planning.warming import compile_once
from optipromp.core.pushing.model import PushModel
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control.controller import Controller
from optipromp_loop.control.courses import Route, path_back
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.control.stages import LoopStage

STEPS = 4  # of a search in a period, each up to 1 ms: a choice, for periods of 5 ms
TRACKED = 1e-3  # [m] errors of the configurations on the way here, summed: a choice


class Takeover:
    """Who has the arm, and the loop's curve; ``period``: of an action [s].

    Attributes:
        controller: that has the arm; None: the policy has the arm.
        holding: whether the loop leaves with the target, or has left: a gripper may close.
        gone: how often the loop gave up; infinite once it has picked.
    """

    def __init__(self, period: float) -> None:
        compile_once()
        self._parameters = replace(
            CONTROL, period=period, lead=period, slice_steps=STEPS, standing_steps=STEPS
        )
        self.controller: Controller | None = None
        self.holding, self.gone, self._why = False, 0.0, ""
        self._now, self._line, self._since = 0.0, Line(()), math.inf

    def stood(self, now: float, stands: bool) -> float:
        """How long an arm that the guard holds up has stood [s]; ``stands``: whether it does."""
        self._since = min(self._since, now) if stands else math.inf
        return max(now - self._since, 0.0)

    def begin(
        self, scene: Scene, robot: Robot, now: float, curve: Trajectory, way: FloatArray,
        pushes: PushModel | None, why: str,
    ) -> None:  # fmt: skip
        """Take the arm over that comes to rest on a ``curve`` from the time ``now`` on [s].

        ``way``: tool poses (k, 6) of the way here, where the tool is among fruits; else empty.
        ``pushes``: the model of the pushes on it.
        """
        end, came = curve.positions[-1], None
        try:
            given = replace(scene, start=end)
            controller = Controller(given, robot=robot, parameters=self._parameters)
        except OptiPrompError:  # no plan may begin there, as beyond a limit
            self.gone += 1.0
            return
        if len(way):
            q, errors = ik.track(robot, way[::-1, :3], way[::-1, 3:], end)
            q = np.vstack([q[errors.cumsum() < TRACKED][::-1], end])
            led = path_back(robot, q, CONTROL.retreat_speed)
            came = replace(Route.along(robot, led, scene, math.inf), pushes=pushes)
        controller.goes_on(now, curve, came, why)
        self.controller, self._why = controller, why
        self._line, self._since = Line.of(curve, now), math.inf

    def ended(self, now: float) -> bool:
        """Whether the policy has the arm, from now on or before."""
        loop = self.controller
        if loop is not None and (loop.ended or loop.lost) and self._line.ended(now):
            self.gone = math.inf if loop.stage is LoopStage.DONE else self.gone + 1.0
            self.controller = None
        return self.controller is None

    def cycle(
        self, now: float, measured: State, looks: Iterable[Look]
    ) -> tuple[Trajectory, str, float]:
        """A period of the loop from the time ``now`` on [s].

        Returns: the curve, whose second row is a period later; what the loop does, and why; and the
        predicted probability that the pick which runs among fruits is not clean, else 0.
        """
        loop = self.controller
        assert loop is not None
        for look in looks:
            loop.see(look)
        return self._ahead(loop, now, loop(now, measured, self._line.at(now)))

    def hold(self, why: str) -> tuple[Trajectory, str, float]:
        """A period without a state of the arm: it comes to rest, and waits."""
        assert self.controller is not None
        now = self._now + self._parameters.period
        return self._ahead(self.controller, now, self.controller.hold(now, why))

    def _ahead(
        self, loop: Controller, now: float, made: Stretch | None
    ) -> tuple[Trajectory, str, float]:
        if made is not None:
            self._line = self._line.take(made, now, anew=loop.lost)
        self._now, period, last = now, self._parameters.period, self._line.taken[-1][1]
        self.holding = self.holding or loop.holding
        after = last.begins - now + last.curve.times
        after[-1] = max(after[-1], 2.0 * period)  # it stands
        rest = after > 1.5 * period
        ends = [self._line.at(now), self._line.at(now + period)]
        begin = np.array([[s.q, s.velocity, s.acceleration] for s in ends]).swapaxes(0, 1)
        q, v, a = (np.vstack(pair) for pair in zip(begin, last.curve.rows(rest), strict=True))
        times = np.concatenate([[0.0, period], after[rest]])
        told = loop.picks[-1].failure if loop.doing.among and loop.picks else 0.0
        words = f"the loop has the arm ({loop.stage}): {self._why}"
        curve = Trajectory(times, q, v, a, last.curve.joint_names)
        return curve, words, float(np.nan_to_num(told))
