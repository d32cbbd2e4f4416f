"""The guard between two topics: what it sends where nothing is heard."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest
from tests.ros.looks import EPOCH, SIGMA, array_of

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes import load_scene
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp_ros import DetectionParameters, GuardFilter, message
from optipromp_ros.guard import COMMAND
from optipromp_ros.types import ERROR, OK, WARN

PERIOD = 20_000_000  # [ns]
CLASSES = DetectionParameters(roles={"ripe": "target", "unripe": "pushable"}, stems=())


class Arm:
    """An arm with a velocity controller, which keeps what it was sent last."""

    def __init__(self) -> None:
        self.filter = GuardFilter(load_scene("scenario-3"))
        robot = self.filter.guard.robot
        self.names, self.limits = robot.joint_names, robot
        self.q, self.now = np.array(robot.home), 0
        self.wish = np.zeros(7)
        self.wish[0] = 1.0

    def state(self, q: np.ndarray | None = None) -> None:
        position = self.q if q is None else q
        fields = {"name": self.names, "position": position}
        self.filter.heard(message("sensor_msgs/msg/JointState", **fields), self.now)

    def cycles(self, count: int, heard: bool = True) -> Iterator[np.ndarray]:
        """What is sent in each of these cycles."""
        for _ in range(count):
            self.now += PERIOD
            self.filter.heard(message(COMMAND, data=self.wish), self.now)
            if heard:
                self.state()
            sent = np.array(self.filter.tick(self.now).data)
            self.q = self.q + 0.02 * sent
            yield sent


def stopped(arm: Arm, before: np.ndarray, sent: list[np.ndarray]) -> None:
    """The arm braked within its limits, and then got zeros."""
    rates = np.abs(np.diff([before, *sent], axis=0)) / 0.02
    assert (rates <= arm.limits.acceleration * (1 + 1e-6)).all()
    assert sent[0][0] > 0.0 or before[0] < 0.2
    np.testing.assert_allclose(sent[-1], 0.0, atol=1e-9)


def test_states_that_stop_are_a_stop() -> None:
    arm = Arm()
    running = list(arm.cycles(20))
    assert running[-1][0] == pytest.approx(1.0)
    assert arm.filter.status().level == OK
    silent = list(arm.cycles(40, heard=False))
    late = next(k for k, sent in enumerate(silent) if sent[0] < 1.0 - 1e-9)
    assert late == 5  # a state counts for 0.1 s
    stopped(arm, silent[late - 1], silent[late:])
    status = arm.filter.status()
    assert status.level == ERROR
    assert status.message.startswith("joint states are 0.80 s old")
    again = list(arm.cycles(10))  # it goes on from where it stands
    assert np.abs(np.diff([silent[-1], *again], axis=0)).max() <= 0.02 * arm.limits.acceleration[0]
    assert again[-1][0] > 0.1
    assert arm.filter.status().level == OK


def test_states_that_are_not_understood_are_none() -> None:
    arm = Arm()
    *_, before = arm.cycles(20)
    sent = []
    for _ in range(40):
        arm.state(np.where(np.arange(7) == 2, np.nan, arm.q))
        sent += arm.cycles(1, heard=False)
    stopped(arm, before, sent)
    assert "joint3 is nan" in arm.filter.status().message
    with pytest.raises(InvalidRequestError, match="is missing; it names finger"):
        arm.filter.heard(message("sensor_msgs/msg/JointState", name=["finger"], position=[0.0]), 0)


def test_what_cannot_be_decided_brakes(monkeypatch: pytest.MonkeyPatch) -> None:
    arm = Arm()
    before = list(arm.cycles(20))[-1]
    monkeypatch.setattr(arm.filter.guard, "_see", lambda *_: (_ for _ in ()).throw(ValueError("x")))
    stopped(arm, before, list(arm.cycles(40)))
    assert arm.filter.status().message == "nothing can be decided: x"


def test_before_the_first_state_it_sends_zeros() -> None:
    """The controller may have kept the last velocity of a guard that was killed."""
    arm = Arm()
    assert not np.array(list(arm.cycles(3, heard=False))).any()
    assert arm.filter.status().level == ERROR
    assert arm.filter.status().message == "no joint states were heard"


def test_the_status_says_why_the_command_is_another() -> None:
    arm = Arm()
    arm.wish = np.full(7, np.nan)
    list(arm.cycles(1))
    assert arm.filter.status().level == WARN
    assert arm.filter.status().message == "the action is not finite"


def test_three_velocities_are_of_the_tool_and_other_numbers_are_refused() -> None:
    arm = Arm()
    arm.wish = np.array([0.0, 0.0, 0.1])
    *_, sent = arm.cycles(20)
    assert np.abs(sent).max() > 0.05
    with pytest.raises(InvalidRequestError, match="2 values: must be 7 velocities of joints, or 3"):
        arm.filter.heard(message(COMMAND, data=[0.0, 0.0]), 0)


def test_the_loop_picks_by_messages_where_a_policy_is_held_up() -> None:
    """The wrist is turned to the end of its range; the numbers of ROS's clock are large."""
    arm, scene, told = Arm(), load_scene("scenario-3"), list[tuple[str, str]]()
    known = (replace(o, covariance=SIGMA) for o in scene.objects if o.role != "static")
    fruits = Look(0.0, Pose(), tuple(known))
    arm.filter = GuardFilter(scene, CLASSES, takes_over=True)
    arm.now, arm.wish = EPOCH, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0])
    for k in range(900):
        if k % 5 == 0:
            arm.filter.heard(array_of(fruits, arm.now, frame="link0"), arm.now)
        list(arm.cycles(1))
        told.append(tuple(item.value for item in arm.filter.status().values))
        arm.wish = arm.wish * (told[-1][1] == "open")
    loop = ("loop", "open"), ("loop", "close")
    said = [pair for pair, _ in groupby(told)]
    assert said == [("policy", "open"), ("guard", "open"), *loop, ("policy", "close")]
