"""Many scenes at once: the plans of one at a time, in order, whatever happens on the way."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
import warnings
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import pytest
from numba import config

from optipromp.core.errors import Code, InvalidRequestError, InvalidSceneError, StartInvalidError
from optipromp.core.geometry import PointCloudShape
from optipromp.core.optimization.costs import Cost
from optipromp.core.planning import Plan, PlanOptions, plan, plan_many, sequence
from optipromp.core.planning.sequence import Result
from optipromp.core.planning.task import resolve
from optipromp.core.processes import run_each
from optipromp.core.scenes import SceneObject
from optipromp.core.scenes.io import load_scene, save_scene
from optipromp_sim.generate import generate


def without_times(result: object) -> dict[str, object]:
    assert isinstance(result, Plan)
    document = result.to_dict()
    del document["time"]
    for stage in document["stages"]:
        del stage["seconds"]
    return document


def test_plans_are_those_of_one_scene_at_a_time() -> None:
    scenes = ["scenario-4", *(generate("table-top", seed) for seed in range(8)), "scenario-3"]
    options = PlanOptions(max_step=0.05)
    together = plan_many(scenes, options, seed=3, workers=3)
    assert len(together) == len(scenes)
    for scene, result in zip(scenes, together, strict=True):
        alone = plan(scene, options=options, seed=3)
        assert isinstance(result, Plan)
        assert result.scene.name == alone.scene.name
        assert np.array_equal(result.trajectory.positions, alone.trajectory.positions)
        assert without_times(result) == without_times(alone)


def test_helpers_plan_and_their_arrays_come_back_read_only(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(self: object, scene: object) -> Result:
        return InvalidSceneError("planned here")

    monkeypatch.setattr(sequence._Job, "result", never)
    results = plan_many(["scenario-3"] * 4, planner="promp", workers=2)
    helped = [result for result in results if isinstance(result, Plan)]
    assert helped
    for array in (helped[0].trajectory.positions, helped[0].robot.lower, helped[0].scene.start):
        assert not array.flags.writeable


def test_a_plan_comes_back_with_the_scene_that_was_given(tmp_path: Path) -> None:
    """And with its robot, which is one for all plans that have the same."""
    file = tmp_path / "other.yaml"
    save_scene(replace(load_scene("scenario-3"), robot="scara", tool=None, start=None), file)
    given = [generate("table-top", seed) for seed in range(6)]
    scenes = [scene for pair in zip(given, [file] * 6, strict=True) for scene in pair] * 10
    results = plan_many(scenes, planner="promp", workers=2)
    for scene, result in zip(scenes, results, strict=True):
        assert isinstance(result, Plan)
        assert result.scene is scene or result.scene.robot == "scara" != scene
        assert result.robot.name == resolve(result.scene).robot.name
        assert result.robot.tool == resolve(result.scene).robot.tool


def test_helpers_see_the_callers_environment_of_now(tmp_path, monkeypatch):
    """Though the server that they come from may have started before it changed."""
    plan_many(["scenario-3"] * 2, planner="promp", workers=2)
    moved = {"OPTIPROMP_CACHE": "", "XDG_CACHE_HOME": str(tmp_path)}  # but not the kernels
    for name, value in (moved | {"NUMBA_CACHE_DIR": config.CACHE_DIR}).items():
        monkeypatch.setenv(name, value)
    scene = load_scene("scenario-3")
    cloud = PointCloudShape(np.array([[0.0, 0.0, 0.0], [0.05, 0.0, 0.0]]), 0.01, Path("c.npy"))
    seen = replace(
        scene, objects=(*scene.objects, SceneObject("c", "static", cloud, [0.0, 0.6, 0]))
    )

    def never(self: object, scene: object) -> Result:
        return InvalidSceneError("planned here")

    monkeypatch.setattr(sequence._Job, "result", never)
    results = plan_many([seen] * 4, planner="promp", workers=2)
    assert all(isinstance(result, Plan) for result in results)
    assert list(tmp_path.rglob("*.npz"))


def test_failures_are_values_in_their_places(tmp_path: Path) -> None:
    broken = tmp_path / "broken.yaml"
    broken.write_text("format: 1\nname: half a sc")
    bad_start = replace(load_scene("scenario-3"), start=np.full(7, 9.0))
    scenes = [broken, "scenario-3", bad_start, "scenario-1", "nowhere"]
    heard: list[int] = []
    results = plan_many(
        scenes, planner="promp", workers=2, progress=lambda index, _: heard.append(index)
    )
    assert sorted(heard) == [0, 1, 2, 3, 4]
    assert isinstance(results[0], InvalidSceneError)
    assert "broken.yaml" in results[0].message
    assert isinstance(results[1], Plan)
    assert isinstance(results[2], StartInvalidError)
    assert isinstance(results[3], Plan)
    assert results[3].status is Code.INVALID_PLAN
    assert isinstance(results[4], InvalidSceneError)


def test_wrong_requests_are_refused_before_anything_is_planned() -> None:
    with pytest.raises(InvalidRequestError, match="workers is 0"):
        plan_many(["scenario-3"], workers=0)
    with pytest.raises(InvalidRequestError, match="valid: promp"):
        plan_many(["scenario-3"], planner="best")  # type: ignore[arg-type]
    with pytest.raises(InvalidRequestError, match="cannot be sent"):
        plan_many(["scenario-3"] * 2, PlanOptions(costs=(_local_term(),)), workers=2)


def _local_term() -> Cost:
    @dataclass(frozen=True)
    class Local(Cost):
        name: str = "local"
        weight: float = 0.0

        def add(self, e: object, scale: float) -> float:
            return 0.0

    return Local()


def test_an_unexpected_error_of_a_plan_is_raised(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> Plan:
        raise ZeroDivisionError

    monkeypatch.setattr(sequence, "plan", broken)
    with pytest.raises(ZeroDivisionError):
        plan_many(["scenario-3"], workers=1)


def test_a_helper_that_is_killed_costs_at_most_its_own_scene() -> None:
    heard: list[int] = []

    def kill(index: int, _: object) -> None:
        heard.append(index)
        if len(heard) == 10:  # they plan
            os.kill(multiprocessing.active_children()[0].pid or 0, signal.SIGKILL)

    scenes = [generate("cluster", seed) for seed in range(8)] * 4
    with pytest.warns(RuntimeWarning, match="helper process"):
        results = plan_many(scenes, workers=2, progress=kill)
    lost = [result for result in results if not isinstance(result, Plan)]
    assert len(results) == len(scenes)
    assert sorted(heard) == list(range(len(scenes)))
    assert len(lost) <= 1
    assert all(error.code is Code.NO_PLAN for error in lost)


def deadly(number: int) -> int:
    if number in (3, 17):
        os._exit(1)
    return 2 * number


def cut_short(number: int) -> int | bytes:
    """A large result of the number 3, in the middle of which its process ends."""

    def ends(self: Connection, part: bytes) -> None:
        os.write(self.fileno(), part[:4096])
        if len(part) > 4096:
            os._exit(1)

    if number != 3:
        return number
    Connection._send = ends  # type: ignore[attr-defined]
    return bytes(50_000_000)


def test_a_process_that_ends_within_its_answer_holds_nobody_up() -> None:
    found: dict[int, object] = {}
    with pytest.warns(RuntimeWarning, match="helper process"):
        run_each(cut_short, [(number,) for number in range(6)], found.__setitem__, workers=2)
    assert isinstance(found.pop(3), BrokenProcessPool)
    assert found == {number: number for number in range(6) if number != 3}


def test_tasks_that_end_their_process_are_told_and_the_rest_is_done() -> None:
    found: dict[int, object] = {}
    with pytest.warns(RuntimeWarning, match="helper process"):
        run_each(deadly, [(number,) for number in range(30)], found.__setitem__, workers=2)
    assert {index for index, result in found.items() if isinstance(result, Exception)} == {3, 17}
    assert all(found[number] == 2 * number for number in set(range(30)) - {3, 17})


def remark(number: int = 0) -> int:
    warnings.warn(f"remark {number % 2}", stacklevel=1)
    return number


def test_warnings_of_helpers_are_given_here_each_once() -> None:
    found: dict[int, object] = {}
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        tasks = [(2 * number + 1,) for number in range(6)]  # remark 0 is of what prepares helpers
        run_each(remark, tasks, found.__setitem__, workers=2, prepare=remark)
    assert [found[i] for i in range(6)] == [number for (number,) in tasks]
    assert sorted(str(each.message) for each in told) == ["remark 0", "remark 1"]


MANY = """
import multiprocessing
from optipromp.core.planning import plan_many

def said(index, result):
    for helper in multiprocessing.active_children():  # none while it starts
        print(helper.pid, flush=True)

if __name__ == "__main__":
    print("begun", flush=True)
    try:
        plan_many(["scenario-3"] * 5000, workers=2, progress=said)
    except KeyboardInterrupt as own:
        raise own from None  # not what it came in the midst of
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
@pytest.mark.parametrize(("wait", "planning"), [(0.1, False), (0.6, False), (2.0, True)])
def test_an_interruption_ends_at_once_and_leaves_no_process(tmp_path, wait, planning):
    """Also while helpers start: Ctrl-C comes ``wait`` [s] later; the script ends of it alone."""
    script = tmp_path / "many.py"
    script.write_text(MANY)
    process = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, start_new_session=True,
    )  # fmt: skip
    try:
        assert process.stdout.readline() == "begun\n"
        helper = int(process.stdout.readline()) if planning else None
        time.sleep(wait)
        os.killpg(process.pid, signal.SIGINT)  # as a terminal does: to all processes
        _, stderr = process.communicate(timeout=20)
    except BaseException:
        os.killpg(process.pid, signal.SIGKILL)
        raise
    assert stderr.count("Traceback") == 1  # the caller's own
    assert stderr.rstrip().endswith("KeyboardInterrupt")
    if helper is not None:
        with pytest.raises(ProcessLookupError):
            os.kill(helper, 0)
