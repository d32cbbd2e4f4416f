"""The loop takes the arm where the guard holds a policy up; the arm is where it is told.

Picks in the physics are in ``packages/optipromp-bench/tests/guard/test_takeover.py``.
"""

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.judging import RATES, extremes
from optipromp.core.planning.task import posed
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp_loop.guard import Guard, GuardParameters, Safe
from optipromp_sim.generate import generate

PERIOD = GuardParameters.period
STILL = np.zeros(7)


@pytest.fixture(scope="module")
def cluster() -> Scene:
    return generate("cluster", 941_000)


def shown(time: float, scene: Scene) -> Look:
    """A look at the fruits of a scene, known to 1 mm."""
    eye = Pose(np.array([0.5, -0.3, -0.2]), np.eye(3))
    items = [o for o in scene.objects if o.role in ("target", "pushable")]
    known = [replace(item, covariance=1e-6 * np.eye(3), stem=None) for item in items]
    return Look(time, eye, tuple(item.transformed(eye.inverse()) for item in known), view=3.0)


class Arm:
    """An arm that follows a guard exactly, and a policy that goes straight at the target.

    Once the target is held the policy goes back.
    """

    def __init__(self, guard: Guard, looks: bool = True) -> None:
        self.guard, self.looks, self.scene = guard, looks, guard.scene
        self.states, self.told = [posed(self.scene)[1]], list[Safe]()

    @property
    def time(self) -> float:
        return PERIOD * len(self.told)

    def wish(self) -> FloatArray:
        assert self.scene.target is not None
        state = self.states[-1]
        by = self.scene.target.position - self.guard.robot.tool_pose(state.q)[0]
        by = -0.02 * self.scene.frame[2] if self.told and self.told[-1].holding else by
        return self.guard.tool(0.15 * by / max(float(np.linalg.norm(by)), 0.05), state)

    def step(self, wish: FloatArray) -> Safe:
        looks = [shown(self.time, self.scene)] if self.looks and len(self.told) % 4 == 0 else []
        return self.follow(self.guard(wish, self.states[-1], looks, self.time))

    def follow(self, safe: Safe) -> Safe:
        self.told.append(safe)
        self.states.append(safe.reference)
        return safe

    def until(self, mover: str, most: int = 800) -> Safe:
        """The first action of a mover."""
        return next(s for _ in range(most) if (s := self.step(self.wish())).mover == mover)

    def motion(self) -> Trajectory:
        rows = (np.array([getattr(s, name) for s in self.states])
                for name in ("q", "velocity", "acceleration"))  # fmt: skip
        return Trajectory(PERIOD * np.arange(len(self.states)), *rows, self.guard.robot.joint_names)


def test_the_loop_picks_and_the_policy_has_the_arm_again(cluster: Scene) -> None:
    arm = Arm(Guard(cluster, takes_over=True))
    arm.until("loop")
    assert arm.guard.leads
    arm.until("policy")
    assert not arm.guard.leads
    movers = [name for name, _ in groupby(arm.told, lambda safe: safe.mover)]
    assert movers == ["policy", "guard", "loop", "policy"]
    assert cluster.target is not None
    away = [
        float(np.linalg.norm(arm.guard.robot.tool_pose(s.q)[0] - cluster.target.position))
        for s in arm.states
    ]
    assert min(away) < 0.01
    assert away[-1] > 0.08  # out again
    assert [safe.holding for safe in arm.told].index(True) > int(np.argmin(away)) - 30
    for _ in range(50):
        assert arm.step(arm.wish()).mover == "policy"
    arm.step(STILL)
    for _ in range(50):
        arm.step(STILL)
    most, robot = extremes(arm.motion()), arm.guard.robot
    limits = np.array([getattr(robot, name) for name in RATES])
    assert (most.largest[:2] <= limits[:2] * (1.0 + 1e-6)).all()
    steps = np.abs(np.diff([s.velocity for s in arm.states], axis=0))
    assert (steps <= PERIOD * robot.acceleration * (1.0 + 1e-6)).all()


def test_without_a_state_of_the_arm_the_loop_comes_to_rest_and_goes_on(cluster: Scene) -> None:
    arm = Arm(Guard(cluster, takes_over=True))
    arm.until("loop")
    while not arm.step(STILL).reason.startswith("the loop has the arm (push)"):
        pass
    for _ in range(20):
        arm.step(STILL)
    assert arm.states[-1].moving
    for _ in range(60):
        safe = arm.guard.blind("no state")
        assert safe is not None
        assert safe.mover == "loop"
        arm.follow(safe)
    assert not arm.states[-1].moving
    arm.until("policy")
    assert arm.told[-1].holding


def test_a_policy_held_up_for_a_second_hands_over_and_a_loop_that_gives_up_soon_does_not(
    cluster: Scene,
) -> None:
    """A wrist is turned beyond its range; the fruits are out of reach."""
    far = cluster.each(lambda item: item.shifted(np.array([1.5, 0.0, 0.0])))
    arm = Arm(Guard(far, takes_over=True, parameters=GuardParameters(takeovers=2)))
    for _ in range(700):
        arm.step(np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0]))
    spells = [(name, len([*some])) for name, some in groupby(arm.told, lambda safe: safe.mover)]
    assert [name for name, _ in spells] == ["policy", *2 * ["guard", "loop"], "guard"]
    second = round(GuardParameters.stood / PERIOD)
    assert second < spells[1][1] < 2 * second
    assert spells[3][1] in (second, second + 1)
    assert spells[-1][1] > 2 * second
    led = next(safe for safe in arm.told if safe.mover == "loop")
    assert led.reason == "the loop has the arm (observe): joint7 would leave its range"


def test_without_looks_the_guard_stands_and_without_a_time_it_says_what_it_needs(
    cluster: Scene,
) -> None:
    arm = Arm(Guard(cluster, takes_over=True), looks=False)
    for _ in range(400):
        assert arm.step(arm.wish()).mover != "loop"
    assert not arm.states[-1].moving
    with pytest.raises(InvalidRequestError, match="time is None: a guard that takes over needs it"):
        arm.guard(STILL, arm.states[-1])
