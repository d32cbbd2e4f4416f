"""The suite itself: every metric is well formed, and a crash in a benchmark is a row."""

import shutil
import sys
import time
from pathlib import Path

import pytest

from benchmarks.evaluation import Case, Program, near_obstacles, panda_with_cup, reach
from benchmarks.peers import Answer
from benchmarks.registry import SUITE, Context
from benchmarks.run import apart, load_suite
from benchmarks.suite.planners import Score, ours
from benchmarks.timing import in_turn
from optipromp.core.planning import plan
from optipromp.core.scenes import load_scene


def test_every_benchmark_says_what_it_does() -> None:
    load_suite()
    benchmarks = list(SUITE)
    assert len(benchmarks) > 10
    for benchmark in benchmarks:
        assert benchmark.about, benchmark.name
        assert benchmark.metrics, benchmark.name


def test_a_child_that_dies_is_a_row(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    load_suite()
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nkill -SEGV $$\n", encoding="utf-8")
    python.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(python))
    names = [m.name for m in SUITE["start"].metrics][:2]
    found = apart(SUITE["start"], names, Context())
    assert [row.metric.name for row in found] == names
    assert all("ended with -11" in row.reason for row in found)


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("g++") is None, reason="no g++")
def test_the_cpp_program_agrees_with_our_kernels() -> None:
    robot = panda_with_cup()
    assert len(robot.spheres.radius) == 86
    case = Case(robot, 24, near_obstacles(robot, reach(24), 13))
    value = case.problem.evaluate(case.q)
    weighted = sum(t.weight * value.costs[t.name] for t in case.problem.costs)
    assert min(value.costs.values()) > 0.0, "a term that is not active is not compared"
    assert value.merit > weighted, "nor is self-collision"
    with Program(case) as program:
        assert program.difference(case) < 1e-9
        assert program.ask("time 2")[0] > 0.0


def test_calls_are_timed_in_turn() -> None:
    order: list[str] = []

    def named(name: str) -> object:
        def call() -> None:
            order.append(name)
            time.sleep(2e-3)

        return call

    times = in_turn({"a": named("a"), "b": named("b")}, 3, batch=1e-6)  # type: ignore[dict-item]
    assert "".join(order[-6:]) == "ababab"
    assert min(times["a"]) > 1e-3


@pytest.mark.slow
def test_success_of_a_planner_is_what_the_judge_says() -> None:
    """Our plan passes a fruit on the side of its stem, where no harm is predicted: a success."""
    scene = load_scene("scenario-3")
    made = plan(scene)
    assert made.success
    assert "on the side of its stem" in made.message
    score = Score()
    score.add(ours(), scene, 0)
    assert (score.success, score.valid) == ([True], [True])
    assert not score.faults
    score.add(ours("straight"), scene, 0)  # touches nothing it must not, and swallows both
    assert (score.success, score.valid) == ([True, False], [True, True])
    (fault,) = score.faults
    assert "swallowed" in fault
    score.add(lambda *_: Answer(None, "none"), scene, 0)
    assert (score.success, score.valid) == ([True, False, False], [True, True, False])
