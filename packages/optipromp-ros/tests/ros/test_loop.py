"""A pick in closed loop with messages only, against the simulation; and what messages are read."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from tests.ros.camera_messages import frames, header, sent, states
from tests.ros.curves import Curves
from tests.ros.looks import EPOCH, SIGMA, array, array_of, seen

from optipromp.core.arrays import frame_along
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.geometry.shapes import Ellipsoid, Sphere
from optipromp.core.planning.task import posed
from optipromp.core.scenes import load_scene
from optipromp.core.scenes.hand import flange_of, tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control import Controller, LoopStage, without_fruits
from optipromp_loop.control.parameters import CONTROL
from optipromp_ros import (
    DetectionParameters,
    PickLoop,
    message,
    read_detections,
    read_trajectories,
    stretch_trajectory,
)
from optipromp_ros.scenes import xyz
from optipromp_ros.trajectories import nanoseconds
from optipromp_sim.generate import generate
from optipromp_sim.simulation import DETECTORS, Detector, Eye, Simulation
from optipromp_sim.simulation.rollouts import Pick, rollout

SCENE = load_scene("scenario-3")
ROBOT, START = posed(SCENE)
NAMES = [f"fr3_{name}" for name in ROBOT.joint_names]
CLASSES = DetectionParameters(
    roles={"ripe": "target", "unripe": "pushable", "unripe-bare": "pushable"},
    stems=("ripe", "unripe"),
)


def felt(pose, wrench, stamp):
    """The message of a sensor in the frame of the camera, whose ``pose`` in the base is given."""
    kind = "geometry_msgs/msg/Vector3"
    force = xyz(kind, pose.rotation.T @ wrench[:3])
    wrench = message("geometry_msgs/msg/Wrench", force=force, torque=message(kind))
    return message("geometry_msgs/msg/WrenchStamped", header=header(stamp, "camera"), wrench=wrench)


SET = 0.4  # [s] after the arm began to move, in travel


@dataclass
class Told:
    """A pick by messages alone: the loop as an agent of ``rollout``, and what it said.

    ``shift``: by which the clock of all stamps is set, 0.4 s after the arm began to move [s];
    ``steady``: whether the loop has another clock; ``silent``: whether no state comes, so long
    after the arm began to move [s].
    """

    loop: PickLoop
    curves: Curves
    camera: Pose  # in the frame of the tool
    shift: float = 0.0
    steady: bool = False
    silent: Callable[[float], bool] = lambda _: False
    outcome: Any = None
    begun: float = 0.0  # when the first curve took over [s]
    away: list[float] = field(default_factory=list)  # begins of curves from the measured arm [rad]
    said: list[tuple[float, int, str]] = field(default_factory=list)  # time [s], level, message
    speeds: list[tuple[float, float]] = field(default_factory=list)  # of the reference [rad/s]

    @property
    def joins(self) -> list[float]:
        """The jumps of the reference [rad]."""
        return [np.abs(after.q - before.q).max() for before, after in self.curves.joins]

    def __call__(self, pick: Pick[Any]) -> list[State] | None:
        """The references of a cycle; see :class:`optipromp_sim.simulation.rollouts.Agent`."""
        loop, now, state = self.loop, pick.arena.time, pick.state
        since = now - self.begun if self.begun else 0.0
        was = EPOCH + (round(self.shift * 1e9) if since > SET else 0)  # the stamp of time 0
        stamp = was + round(now * 1e9)
        if not self.silent(since):
            loop.heard(sent(states(NAMES, state.q, stamp, state.velocity)))
            sensor = tool_frame(loop.controller.robot, state.q) @ self.camera
            loop.heard(sent(felt(sensor, pick.arena.wrench(), stamp)))
        for look in pick.looks:
            with suppress(InvalidRequestError):  # where the arm was is unknown
                loop.heard(sent(array_of(look, was + round(look.time * 1e9))))
        curve = loop.tick(stamp, EPOCH + round(now * 1e9) if self.steady else None)
        status = loop.status()
        shut = {one.key: one.value for one in status.values}["gripper"] == "close"
        if shut and pick.taken is None and pick.arena.scene.target.id in pick.arena.held():
            pick.take()
        self.said.append((now, int(status.level), status.message))
        if curve is not None:
            assert curve.joint_names == NAMES
            motion = self.curves.heard(sent(curve), was)
            self.away.append(np.abs(motion.positions[0] - state.q).max())
        if now > 30.0 or (loop.ended and self.curves.ended(now)):
            return None
        turn = [self.curves.at(now + k * pick.arena.tick) for k in range(pick.ticks)]
        self.begun = self.begun or (self.curves.runs[1] if self.curves.runs else 0.0)
        self.speeds.append((now, float(np.abs(turn[-1].velocity).max())))
        return turn


def by_messages(shift: float = 0.0, steady: bool = False, **silent: Any) -> Told:
    """A pick by messages alone, against the simulation; see :class:`Told`."""
    scene = generate("cluster", 3)
    robot, start = posed(scene)
    eye = Eye(Detector(scene, robot, DETECTORS["zero-mean"], 0))
    parameters = replace(CLASSES, view=eye.detector.view, stem_length=0.2)
    feels = replace(CONTROL, weight_error=0.05)  # [N] of a sensor in the wrist
    # not in real time: the same on any machine
    controller = Controller(without_fruits(scene), parameters=feels)
    loop = PickLoop(scene, parameters=parameters, controller=controller)
    camera = tool_frame(robot, start.q).inverse() @ eye.detector.camera(start.q)
    loop.heard(sent(frames(0, ("tool", "camera", camera))))
    done = Told(loop, Curves(robot.joint_names, start), camera, shift, steady, **silent)
    done.outcome = rollout(done, Pick(Simulation(scene), eye))
    return done


def test_a_pick_by_messages_alone() -> None:
    done = by_messages()
    status = sent(done.loop.status())
    assert done.loop.controller.stage is LoopStage.DONE, done.loop.controller.events
    assert done.outcome.success, done.outcome.message
    assert len(done.joins) > 20
    assert max(done.joins) < 1e-6
    assert {level for _, level, _ in done.said} == {0}
    assert (status.name, status.message) == (
        "optipromp/loop", "outside with the target, by its weight",
    )  # fmt: skip
    assert {one.key: one.value for one in status.values}["stage"] == "done"


@pytest.mark.parametrize(("shift", "steady"), [(-1.0, False), (1.0, False), (-0.3, True)])
def test_a_clock_that_is_set_stops_the_arm_and_the_pick_goes_on(shift: float, steady: bool) -> None:
    done = by_messages(shift, steady)
    way = "back" if shift < 0.0 else "forward"
    words = f"the clock was set {way} by {abs(shift):.3f} s"
    begin, end = (ends(now for now, _, why in done.said if why == words) for ends in (min, max))
    assert begin == pytest.approx(done.begun + SET, abs=0.05)
    assert end - begin < 0.5
    assert all((level == 1) == (why == words) for _, level, why in done.said)
    speed = dict(done.speeds)
    assert speed[begin] > 0.01
    assert min(one for now, one in done.speeds if begin < now < begin + 0.5) == 0.0
    assert max(done.joins) < 0.005  # where the next begins from what is measured
    assert max(done.away) < 0.05
    assert done.loop.controller.stage is LoopStage.DONE
    assert done.outcome.success, done.outcome.message


def test_where_no_state_comes_the_arm_stops_on_its_curve() -> None:
    done = by_messages(silent=lambda since: SET < since < SET + 1.0)
    begin, end = (
        ends(now for now, _, why in done.said if why == "joint states are old") - done.begun
        for ends in (min, max)
    )
    assert 0.08 < begin - SET < 0.16  # the last state and 0.1 s
    assert end == pytest.approx(SET + 1.0, abs=0.05)
    assert all((level == 1) == (why == "joint states are old") for _, level, why in done.said)
    stood = begin + 0.65  # from 1.5 rad/s
    later = [one for now, one in done.speeds if stood < now - done.begun < end]
    assert max(later) == 0.0
    assert max(done.joins) < 1e-6
    assert done.outcome.success, done.outcome.message


class Leaping(Controller):
    """Its second curve begins beside the first."""

    def __call__(self, time: float, measured: State, reference: State) -> Stretch:
        super().__call__(time, measured, reference)
        leap = 0.05 * (len(self.cycles) == 2)
        curve = Trajectory.still(START.q + leap, (0.0, 1.0), self.robot.joint_names)
        return Stretch(curve, time + self.parameters.lead)


def test_a_curve_that_does_not_meet_the_running_one_is_not_sent() -> None:
    loop = PickLoop(SCENE, controller=Leaping(without_fruits(SCENE)), prefix="fr3_")
    for k, level in enumerate((0, 1, 0)):
        now = EPOCH + 20_000_000 * k
        loop.heard(states(NAMES, START.q, now))
        curve = loop.tick(now)
        status = loop.status()
        assert int(status.level) == level, status.message
        if k == 1:
            assert status.message.startswith("the curve begins with 0.05 from the running one")
        if curve is not None:
            (motion,) = read_trajectories(sent(curve), ROBOT.joint_names)
            assert motion.positions == pytest.approx(np.tile(START.q, (motion.n_waypoints, 1)))


@pytest.mark.parametrize(("silent", "why"), [(False, "looking"), (True, "the clock was set for")])
def test_a_cycle_that_is_late_is_no_clock_that_was_set(silent: bool, why: str) -> None:
    loop = PickLoop(SCENE, prefix="fr3_")
    for k in range(21):
        now = EPOCH + 20_000_000 * k
        if k in (0, 20) or not silent:
            loop.heard(states(NAMES, START.q, now))
        if k in (0, 20):
            loop.tick(now)
    assert loop.status().message.startswith(why)


def test_detections_become_a_look() -> None:
    camera = Pose([0.3, 0.1, 0.5], frame_along(np.array([0.0, 0.6, 0.8])))
    slim = seen("unripe", [0.1, 0.0, 0.4], size=(0.02, 0.02, 0.04), up=(0.6, 0.0, 0.8))
    ripe = seen("ripe", [0.0, 0.05, 0.3], id="a")
    bare = seen("unripe-bare", [0.0, 0.1, 0.3], spread=np.zeros((3, 3)))
    item = sent(array(ripe, slim, bare, seen("leaf", [0.0, 0.0, 0.2]), stamp=EPOCH))
    given = (CLASSES, 2.5), (None, None), (replace(CLASSES, least_score=0.95), None)
    with pytest.warns(UserWarning, match="left out: it has no --role (leaf|unripe-bare)="):
        look, usual, sure = (
            read_detections(item, {"camera": camera}, each, time=time) for each, time in given
        )
    assert (look.time, look.camera) == (2.5, camera)
    first, second, third = look.detections
    assert [(o.id, o.role) for o in look.detections] == [
        ("a", "target"), ("detection1", "pushable"), ("detection2", "pushable"),
    ]  # fmt: skip
    assert first.shape == Sphere(0.015)
    np.testing.assert_allclose(first.position, [0.0, 0.05, 0.3])
    np.testing.assert_allclose(first.covariance, SIGMA)
    assert second.shape == Ellipsoid((0.01, 0.01, 0.02))
    np.testing.assert_allclose(second.stem.points, [[0.1, 0.0, 0.4], [0.19, 0.0, 0.52]], atol=1e-12)
    assert third.stem is None
    np.testing.assert_allclose(third.covariance, 0.005**2 * np.eye(3))
    assert usual.time == pytest.approx(EPOCH / 1e9)
    assert not sure.detections


def test_wrong_detections_are_named() -> None:
    known = {"camera": Pose()}
    with pytest.raises(InvalidRequestError, match="frame_id is 'eye': must be 'camera'"):
        read_detections(array(frame="eye"), known)
    with pytest.raises(InvalidRequestError, match=r"detections\[0\].header.frame_id is 'eye'"):
        read_detections(array(seen("ripe", [0, 0, 1], header=header(EPOCH, "eye"))), known)
    with pytest.raises(InvalidRequestError, match=r"detections\[0\].bbox.size"):
        read_detections(array(seen("ripe", [0, 0, 1], size=(0.0, 0.1, 0.1))), known)
    with pytest.raises(InvalidSceneError, match="finite"):
        read_detections(array(seen("ripe", [0, np.nan, 1])), known)
    with pytest.raises(InvalidRequestError, match="is no look"):
        read_detections(states(NAMES, START.q, EPOCH), known)
    with pytest.raises(InvalidRequestError, match="role of class 'ripe' is 'static'"):
        DetectionParameters(roles={"ripe": "static"})
    with pytest.raises(InvalidRequestError, match="class 'red' has stems and no role"):
        DetectionParameters(stems=("red",))


def test_a_stretch_carries_the_time_at_which_it_takes_over() -> None:
    curve = Trajectory.through(START.q + np.zeros((3, 1)), 0.1, ROBOT.joint_names)
    item = sent(stretch_trajectory(Stretch(curve, 12.02), EPOCH, prefix="fr3_"))
    assert nanoseconds(item.header.stamp) == EPOCH + 12_020_000_000
    assert nanoseconds(item.points[0].time_from_start) == 0
    assert item.joint_names == NAMES


def test_a_camera_on_the_hand_is_where_the_arm_was_at_the_exposure() -> None:
    loop, held = PickLoop(SCENE, prefix="fr3_"), Pose([0.0, 0.05, -0.02])
    loop.heard(frames(0, ("fr3_flange", "bracket", held)))
    loop.heard(frames(0, ("bracket", "camera", Pose([0.0, 0.0, 0.01]))))
    taken = []
    loop.controller.see = taken.append
    with pytest.raises(InvalidRequestError, match="joint states must come first"):
        loop.heard(array(stamp=EPOCH))
    later = START.q + 0.1
    loop.heard(states(NAMES, START.q, EPOCH))
    loop.heard(states(NAMES, later, EPOCH + 100_000_000))
    loop.heard(array(stamp=EPOCH + 50_000_000))
    flange = flange_of(ROBOT, START.q + 0.05)
    np.testing.assert_allclose(
        taken[0].camera.position, flange @ np.array([0.0, 0.05, -0.01]), atol=1e-9
    )
    with pytest.raises(InvalidRequestError, match="frame_id is 'eye'"):
        loop.heard(array(frame="eye", stamp=EPOCH))
    with pytest.raises(InvalidRequestError, match=r"0.400 s after the newest joint states"):
        loop.heard(array(stamp=EPOCH + 500_000_000))
    assert len(taken) == 1
    with pytest.raises(InvalidRequestError, match="is of no use here"):
        loop.heard(message("std_msgs/msg/String"))


def test_without_joint_states_nothing_is_commanded_and_the_status_says_so() -> None:
    loop = PickLoop(SCENE)
    assert loop.tick(EPOCH) is None
    assert (loop.status().level, loop.status().message) == (1, "no joint states")
    loop.heard(states(NAMES, START.q, EPOCH))
    assert loop.tick(EPOCH + 20_000_000) is None
    assert (loop.status().level, loop.status().message) == (0, "looking")
    assert loop.tick(EPOCH + 500_000_000) is None
    assert loop.status().message == "joint states are old"
    assert len(loop.controller.cycles) == 1
    loop.heard(states(NAMES, START.q, EPOCH + 60_000_000_000))
    assert loop.tick(EPOCH + 520_000_000) is None
    status = loop.status()
    assert (status.level, status.message) == (1, "joint states are ahead of the clock")
