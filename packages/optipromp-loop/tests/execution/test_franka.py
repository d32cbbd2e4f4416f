"""The adapter of a Franka arm by panda-python, with a stand-in for its modules: no arm is at hand.

The stand-in has the names and signatures of panda-python 1.1, and an arm that is where it is asked
to be. Where the real packages are installed, the names are compared. The adapter by franky has a
real libfranka and a simulated arm: ``tests/franka``.
"""

import sys
import time
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from optipromp.core.errors import ExecutionError
from optipromp.core.execution import Executor, Guard
from optipromp.core.execution.contract import ExecutorContract
from optipromp.core.robots.library import load_robot
from optipromp_loop.control import PandaPy

HOME = load_robot("panda").home
BUSY = Guard(late=2.0)  # a machine that runs other tests may let a tick wait


class IdealArm:
    """An arm that is where it is asked to be."""

    def __init__(self) -> None:
        self.q, self.dq, self.calls = np.array(HOME), np.zeros(7), list[str]()

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


class TestPandaPy(ExecutorContract):
    duration = 0.6

    def executor(self) -> Executor:
        self.arm = IdealArm()
        with pytest.MonkeyPatch.context() as patch:
            for name, module in panda_py(self.arm).items():
                patch.setitem(sys.modules, name, module)
            return PandaPy("arm.local", guard=BUSY)

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


def test_the_names_are_those_of_panda_python() -> None:
    module = pytest.importorskip("panda_py", exc_type=ImportError)
    from panda_py import controllers

    for name in ("get_state", "start_controller", "stop_controller", "create_context"):
        assert callable(getattr(module.Panda, name))
    for name in ("q", "dq", "ddq_d"):
        assert hasattr(module.libfranka.RobotState, name)
    assert "position" in controllers.JointPosition.set_control.__doc__
