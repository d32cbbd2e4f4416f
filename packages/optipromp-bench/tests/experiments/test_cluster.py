"""Studies on a Ray cluster: the rows of a local run, also where a worker is killed."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp_bench.experiments.cluster import RETRIES, over
from optipromp_bench.experiments.study import Study, run_study

ray = pytest.importorskip("ray")


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[None]:
    """One local cluster of two workers for all tests; its processes find these tests."""
    path = os.pathsep.join([str(Path(__file__).parents[4]), os.environ.get("PYTHONPATH", "")])
    ray.init(
        num_cpus=2, include_dashboard=False, log_to_driver=False, logging_level="ERROR",
        runtime_env={"env_vars": {"PYTHONPATH": path}},
    )  # fmt: skip
    yield
    ray.shutdown()


def dies_once(folder: str, number: int) -> int:
    """The square of a number, at the second try of number 3: the first kills its process."""
    marker = Path(folder) / f"tried-{number}"
    if number == 3 and not marker.exists():
        marker.write_text("")
        os.kill(os.getpid(), signal.SIGKILL)
    return number * number


def dies_always() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def fails(number: int) -> int:
    if number == 2:
        raise ValueError("two is wrong")
    return number


def gathered(function: Any, tasks: list[tuple[Any, ...]]) -> dict[int, Any]:
    told: dict[int, Any] = {}
    over(function, tasks, told.__setitem__, ray="auto")
    return told


def test_a_task_of_a_killed_worker_is_done_again(tmp_path: Path) -> None:
    told = gathered(dies_once, [(str(tmp_path), k) for k in range(8)])
    assert told == {k: k * k for k in range(8)}
    assert (tmp_path / "tried-3").exists()


@pytest.mark.slow  # workers that begin anew take half a minute
def test_a_task_that_always_kills_its_worker_is_told() -> None:
    told = gathered(dies_always, [()])
    assert isinstance(told[0], BrokenProcessPool)
    assert f"{RETRIES + 1} times" in str(told[0])


def test_an_error_names_its_task() -> None:
    with pytest.raises(ValueError, match="two is wrong") as caught:
        gathered(fails, [(k,) for k in range(4)])
    assert "while at task 2" in caught.value.__notes__


def test_rows_are_those_of_a_local_run(tmp_path: Path) -> None:
    study = Study(presets=("limp",), seeds=range(2), planners=("straight",))
    own = run_study(study, tmp_path / "own", workers=1)
    theirs = run_study(study, tmp_path / "ray", ray="auto")
    timeless = {"plan_time": 0.0, "simulation_time": 0.0}
    assert [replace(row, **timeless) for row in own] == [replace(row, **timeless) for row in theirs]
    again = run_study(study, tmp_path / "ray", ray="auto")
    assert again == theirs  # nothing is left to do


def test_no_cluster_is_told() -> None:
    ray.shutdown()
    with pytest.raises(InvalidRequestError, match="ray start --head"):
        over(fails, [(1,)], lambda *_: None, ray="127.0.0.1:1")
