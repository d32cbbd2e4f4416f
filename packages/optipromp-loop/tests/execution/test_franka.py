"""The adapters of the Franka arm, with stand-ins for the makers' modules: no arm is at hand.

The stand-ins have the names and signatures of panda-python 1.1 and franky-control 2.0, and an arm
that is where it is asked to be. Where the real packages are installed, the names are compared.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from optipromp.core.errors import ExecutionError, InvalidRequestError
from optipromp.core.execution import Executor, Guard
from optipromp.core.execution.contract import ExecutorContract
from optipromp.core.robots.library import load_robot
from optipromp_loop.control import Franky, PandaPy

HOME = load_robot("panda").home
BUSY = Guard(late=2.0)  # a machine that runs other tests may let a tick wait


class IdealArm:
    """An arm that is where it is asked to be."""

    def __init__(self) -> None:
        self.q, self.dq, self.calls = np.array(HOME), np.zeros(7), list[str]()
        self.ordinary = False  # the kernel of its computer

    def ask(self, q: Any, dq: Any = None) -> None:
        self.q, self.dq = np.array(q), np.zeros(7) if dq is None else np.array(dq)

    def read(self) -> Any:
        clock = SimpleNamespace(to_sec=time.perf_counter)
        return SimpleNamespace(q=self.q.tolist(), dq=self.dq.tolist(), ddq_d=[0.0] * 7, time=clock)


class Context:
    def __init__(self, arm: IdealArm, frequency: float) -> None:
        self.arm, self.period, self.next = arm, 1.0 / frequency, time.perf_counter()

    def __enter__(self) -> "Context":
        return self

    def __exit__(self, *_: object) -> None:
        self.arm.calls.append("left")

    def ok(self) -> bool:
        time.sleep(max(0.0, self.next - time.perf_counter()))
        self.next += self.period
        return True


def panda_py(arm: IdealArm) -> dict[str, ModuleType]:
    """The modules ``panda_py`` and ``panda_py.controllers``."""

    class JointPosition:
        def __init__(self, stiffness: Any, damping: Any, filter_coeff: float = 1.0) -> None:
            assert np.shape(stiffness) == np.shape(damping) == (7,)

        def set_control(self, position: Any, velocity: Any = None) -> None:
            arm.ask(position, velocity)

    class Panda:
        def __init__(self, hostname: str, name: str = "panda") -> None:
            arm.calls.append(hostname)

        def get_state(self) -> Any:
            return arm.read()

        def start_controller(self, controller: Any) -> None:
            arm.calls.append("start")

        def stop_controller(self) -> None:
            arm.calls.append("stop")

        def create_context(self, frequency: float) -> Context:
            return Context(arm, frequency)

    module, controllers = ModuleType("panda_py"), ModuleType("panda_py.controllers")
    module.Panda, controllers.JointPosition = Panda, JointPosition  # type: ignore[attr-defined]
    return {"panda_py": module, "panda_py.controllers": controllers}


def franky(arm: IdealArm) -> dict[str, ModuleType]:
    """The module ``franky``."""

    class Robot:
        def __init__(self, fci_hostname: str, realtime_config: Any = "Enforce") -> None:
            arm.calls.append(fci_hostname)
            if realtime_config == "Enforce" and arm.ordinary:
                raise RealtimeException("the kernel has no real-time capabilities")
            if fci_hostname == "silent.local":
                time.sleep(60.0)

        @property
        def state(self) -> Any:
            return arm.read()

    class JointImpedanceTracker:
        def __init__(self, robot: Robot, *, stiffness: Any, damping: Any, period: float) -> None:
            self.context = Context(arm, 1.0 / period)
            arm.calls.append("start")

        def __enter__(self) -> "JointImpedanceTracker":
            return self

        def __exit__(self, *_: object) -> None:
            arm.calls.append("stop")

        def tick(self) -> float | None:
            return self.context.period if self.context.ok() else None

        def set_target(self, q: Any, dq: Any = None, tau_ff: Any = None) -> None:
            arm.ask(q, dq)

    module = ModuleType("franky")
    module.Robot = Robot  # type: ignore[attr-defined]
    module.JointImpedanceTracker = JointImpedanceTracker  # type: ignore[attr-defined]
    return {"franky": module}


@contextmanager
def standing_in(modules: dict[str, ModuleType]) -> Iterator[None]:
    before = {name: sys.modules.get(name) for name in modules}
    sys.modules.update(modules)
    try:
        yield
    finally:
        for name, module in before.items():
            sys.modules.pop(name)
            if module is not None:
                sys.modules[name] = module


class Adapter(ExecutorContract):
    duration = 0.6

    def make(self, arm: IdealArm) -> Executor:
        raise NotImplementedError

    def executor(self) -> Executor:
        self.arm = IdealArm()
        return self.make(self.arm)

    def test_control_is_taken_for_each_curve_and_given_back(self) -> None:
        executor = self.executor()
        assert self.arm.calls == ["arm.local"]
        executor.execute(self.curve(executor))
        assert self.arm.calls[1] == "start"
        assert self.arm.calls[-1] == "stop"

    def test_control_is_given_back_whatever_happens(self) -> None:
        executor = self.executor()

        def broken(now: float, state: object) -> bool:
            raise ZeroDivisionError

        with pytest.raises(ExecutionError, match="watch failed"):
            executor.execute(self.curve(executor), broken)
        assert self.arm.calls[-1] == "stop"
        assert executor.execute(self.curve(executor)).finished


class TestPandaPy(Adapter):
    def make(self, arm: IdealArm) -> Executor:
        with standing_in(panda_py(arm)):
            return PandaPy("arm.local", guard=BUSY)


class RealtimeException(Exception):  # noqa: N818
    """As franky's."""


class TestFranky(Adapter):
    def make(self, arm: IdealArm) -> Executor:
        with standing_in(franky(arm)):
            return Franky("arm.local", guard=BUSY)

    def test_an_ordinary_kernel_connects_where_it_is_told_to(self) -> None:
        arm = IdealArm()
        arm.ordinary = True
        with pytest.raises(InvalidRequestError, match=r"RealtimeConfig\.Ignore connects"):
            self.make(arm)
        with standing_in(franky(arm)):
            assert Franky("arm.local", realtime_config="Ignore").state().q.shape == (7,)

    def test_after_it_is_closed_nothing_can_be_asked(self) -> None:
        with standing_in(franky(IdealArm())), Franky("arm.local") as arm:
            curve = self.curve(arm)
        with pytest.raises(ExecutionError, match="the connection to the arm is closed"):
            arm.state()
        with pytest.raises(ExecutionError, match=r"closed.*the arm has not moved"):
            arm.execute(curve)

    def test_an_arm_that_does_not_answer_is_not_waited_for(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr("optipromp_loop.control.franka.CONNECT", 0.1)
        with (
            standing_in(franky(IdealArm())),
            pytest.raises(ExecutionError, match="is another connection to it open"),
        ):
            Franky("silent.local")


del Adapter  # only its subclasses are tests


def test_the_names_are_those_of_panda_python() -> None:
    module = pytest.importorskip("panda_py", exc_type=ImportError)
    from panda_py import controllers

    for name in ("get_state", "start_controller", "stop_controller", "create_context"):
        assert callable(getattr(module.Panda, name))
    for name in ("q", "dq", "ddq_d"):
        assert hasattr(module.libfranka.RobotState, name)
    assert "position" in controllers.JointPosition.set_control.__doc__


def test_the_names_are_those_of_franky() -> None:
    module = pytest.importorskip("franky", exc_type=ImportError)
    assert hasattr(module.Robot, "state")
    for name in ("tick", "set_target", "__enter__", "__exit__"):
        assert hasattr(module.JointImpedanceTracker, name)
    for name in ("q", "dq", "ddq_d", "time"):
        assert hasattr(module.RobotState, name)
    assert hasattr(module.Duration, "to_sec")
    assert "realtime_config" in module.Robot.__init__.__doc__
    assert module.RealtimeException.__name__ == RealtimeException.__name__
