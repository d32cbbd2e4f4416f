"""The Franka adapter on franky, libfranka and a simulated FR3 with reflexes (``server.py``)."""

import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution import Executor
from optipromp.core.execution.contract import ExecutorContract
from optipromp.core.planning.timing import stopped
from optipromp.core.trajectory import State, Trajectory
from optipromp_loop.control import Franky

franky = pytest.importorskip("franky", exc_type=ImportError)
pytest.importorskip("franky_sim", exc_type=ImportError)

from tests.franka.paced import Paced  # noqa: E402
from tests.franka.server import serving  # noqa: E402

HOST = "127.0.48.10"
HOME = (0.3, -0.2, 0.1, -1.9, 0.1, 1.7, 0.6)  # [rad]


@pytest.fixture(scope="module")
def reflexes() -> Iterator[list[str]]:
    """Those of the arm that serves the tests. What they call is compiled before."""
    with serving(HOST) as seen:
        with connected() as arm:
            still = arm.state()
            arm.refusal(step(arm, 0.05), still)
            stopped(arm.robot, State(still.q, np.full(7, 0.01)))
        yield seen


def connected() -> Paced:
    return Paced(HOST)


def home(arm: Paced, at: tuple[float, ...] = HOME) -> None:
    """Move there by franky's own motion, and wait for rest."""
    arm.arm.recover_from_errors()
    arm.arm.relative_dynamics_factor = 0.3
    arm.arm.move(franky.JointMotion(list(at)))
    end = arm.now + 10.0
    while np.abs(arm.state().velocity).max() > 0.005:
        assert arm.now < end


class TestFrankyOnLibfranka(ExecutorContract):
    @pytest.fixture(autouse=True)
    def connection(self, reflexes: list[str]) -> Iterator[None]:
        with connected() as self.arm:
            yield
        assert reflexes == []

    def executor(self) -> Executor:
        home(self.arm)
        return self.arm

    def clock(self) -> float:
        return self.arm.led


def step(arm: Paced, by: float | FloatArray) -> Trajectory:
    """By ``by`` [rad] within 2 s."""
    s = np.linspace(0.0, 1.0, 21)[:, None]
    q = arm.state().q + by * s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    return Trajectory.through(q, 0.1, arm.joint_names)


def test_the_wrist_is_held_against_dry_friction(reflexes: list[str]) -> None:
    """50 N m/rad leave joint 7 off by 4.3 mrad at rest and by 5.2 mrad in motion."""
    with connected() as arm:
        home(arm)
        curve = step(arm, 0.05)
        done = arm.execute(curve)
        assert np.abs(done.positions - done.reference).max(axis=0)[6] < 0.003
        assert np.abs(arm.state().q - curve.positions[-1])[4:].max() < 0.002


def test_a_machine_that_lets_the_client_wait_changes_nothing(reflexes: list[str]) -> None:
    """Three times 0.6 s: a guard of 0.1 s of the arm's time ended the motion at the first."""
    waits = [1.5, 1.0, 0.5]  # [s] in the curve
    with connected() as arm:
        home(arm)

        def watch(now: float, _: State) -> None:
            if waits and now > waits[-1]:
                waits.pop()
                time.sleep(0.6)

        done = arm.execute(step(arm, 0.05), watch)
        assert done.finished, done.reason
        assert waits == []
        assert 2.0 <= arm.led < 2.5


def test_an_ordinary_kernel_is_told_what_to_do() -> None:
    if Path("/sys/kernel/realtime").exists():
        pytest.skip("this kernel has real-time capabilities")
    with pytest.raises(InvalidRequestError, match=r"RealtimeConfig\.Ignore connects"):
        Franky(HOST)


def test_a_closed_connection_leaves_the_arm_to_the_next(reflexes: list[str]) -> None:
    first = connected()
    curve = step(first, 0.05)
    first.close()
    with pytest.raises(ExecutionError, match="closed"):
        first.state()
    with pytest.raises(ExecutionError, match=r"closed.*the arm has not moved"):
        first.execute(curve)
    with connected() as second:
        assert second.state().q.shape == (7,)
        assert second.force().shape == (3,)
        assert np.linalg.norm(second.force()) < 5.0  # [N] nothing touches it


def test_a_second_connection_is_refused_in_time(reflexes, monkeypatch):
    monkeypatch.setattr("optipromp_loop.control.franka.CONNECT", 1.0)
    told = "does not answer within 1 s; is another connection to it open"
    with connected(), pytest.raises(ExecutionError, match=told):
        connected()


def test_nobody_listens_at_another_address() -> None:
    with pytest.raises(ExecutionError, match=r"127\.0\.48\.99 cannot be connected to"):
        Franky("127.0.48.99", realtime_config=franky.RealtimeConfig.Ignore)


@pytest.mark.parametrize("name", ["scenario-3", "cluster"])
def test_a_plan_is_followed_without_a_reflex(name: str) -> None:
    from tests.franka.streamed import streamed

    from optipromp import load_scene, plan
    from optipromp_sim.generate import generate

    scene = generate("cluster", 30000) if name == "cluster" else load_scene(name)
    row = streamed(plan(replace(scene, robot="fr3")), "127.0.48.11")
    assert row["foreseen"] == []
    assert row["reflexes"] == []
    assert row["finished"], row["message"]
    assert row["joint_error"] < row["lag"] + 0.002  # of dry friction, as at rest
    assert row["end_error"] < 0.003


def test_a_reflex_is_told_by_name_and_recovered_from(reflexes: list[str]) -> None:
    """The built-in Panda's joint 1 goes to 2.897 rad, an FR3's to 2.744 rad."""
    with connected() as arm:
        near = (2.6, *HOME[1:])
        home(arm, near)
        with pytest.raises(ExecutionError, match="reflex") as caught:
            arm.execute(step(arm, np.array([0.2, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])))
        assert len(reflexes) == 1
        assert reflexes[0] in ("joint_velocity_violation", "joint_position_limits_violation")
        assert reflexes[0] in caught.value.message
        home(arm, near)
        assert arm.execute(step(arm, -0.05)).finished
    reflexes.clear()
