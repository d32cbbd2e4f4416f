"""Detours: where an obstacle appears on the running motion, brake and plan from there."""

from __future__ import annotations

from dataclasses import dataclass

from optipromp.core import judging
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.in_time import later
from optipromp.core.planning.options import PlanOptions
from optipromp.core.planning.plan import plan
from optipromp.core.planning.result import Plan
from optipromp.core.planning.timing import stopped
from optipromp.core.planning.underway import running
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory, chained


@dataclass(frozen=True, eq=False)
class Detour:
    """What the arm does from a time of a running plan on.

    Attributes:
        trajectory: from the state of the running plan at that time; time 0 is that time.
        plan: from where the arm stopped; None where the running motion is free and goes on.
        brake: the curve from motion to rest, the first part of ``trajectory``; None likewise.
        contacts: what the brake's curve touches: the obstacle appeared too late or too near.
    """

    trajectory: Trajectory
    plan: Plan | None
    brake: Trajectory | None
    contacts: tuple[judging.Overlap, ...] = ()

    @property
    def success(self) -> bool:
        """Whether the arm arrives and touches nothing that it must not."""
        return not self.contacts and (self.plan is None or self.plan.success)


def detour(scene: Scene, previous: Plan, at: float, options: PlanOptions | None = None) -> Detour:
    """Go on with a running plan where its rest is free in a scene; else brake and plan anew.

    The arm brakes by the shortest curve within all limits, and plans from where it stopped.

    Args:
        scene: as it is seen at the time ``at``: objects that move are as in the scene of
            ``previous``, with times that begin with that plan.
        previous: the plan that runs.
        at: time in ``previous`` at which the obstacle is known [s].
        options: of the new plan.

    Raises:
        InvalidRequestError: a time outside of the running plan.
        OptiPrompError: what :func:`plan` raises.
    """
    end = previous.trajectory.duration
    if not 0.0 <= at <= end:
        raise InvalidRequestError(f"at is {at:g} s; the running plan lasts from 0 to {end:g} s")
    robot, now = previous.robot, later(scene, at)
    left, state = running(previous, at), previous.trajectory.at(at)
    if left is not None and not _contacts(now, previous, left):
        return Detour(left, None, None)
    if not state.moving:
        made = plan(now, robot=robot, start_state=state, options=options)
        return Detour(made.trajectory, made, None)
    brake = stopped(robot, state)
    then = later(now, brake.duration)
    made = plan(then, robot=robot, start_state=brake.at(brake.duration), options=options)
    return Detour(chained([brake, made.trajectory]), made, brake, _contacts(now, previous, brake))


def _contacts(scene: Scene, previous: Plan, curve: Trajectory) -> tuple[judging.Overlap, ...]:
    return judging.judge(scene, previous.robot, curve, curve.at(0.0), begun=True).contacts
