"""A folder holds one plan, whole, and nothing in it is believed that the judge does not find."""

import json
import os
import random
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import invoke, refused
from tests.folders import FILES, Arrays, read, rows, stated

from optipromp import OptiPrompError, load_plan, write_plan
from optipromp.core.errors import Code, InvalidPlanError, InvalidRequestError
from optipromp.core.files import COMMITTED, write_atomically, write_together
from optipromp.core.planning import Plan, plan
from optipromp.looks.reports import plan_report
from optipromp_page.stage import open_source


@pytest.fixture(scope="module")
def good() -> Plan:
    made = plan("scenario-3")
    assert made.success
    return made


@pytest.fixture(scope="module")
def harmful() -> Plan:
    made = plan("scenario-3", planner="promp")
    assert made.status is Code.HARM_PREDICTED
    return made


def elsewhere(arrays: Arrays) -> Arrays:
    """The motion from another start."""
    share = np.linspace(1.0, 0.0, len(arrays["positions"]))[:, None]
    return arrays | {"positions": arrays["positions"] + 0.05 * share * share}


def last_part(arrays: Arrays) -> Arrays:
    """The last two thirds of the motion."""
    cut = len(arrays["times"]) // 3
    shorter = {name: arrays[name][cut:] for name in ("positions", "velocities", "accelerations")}
    return arrays | shorter | {"times": arrays["times"][cut:] - arrays["times"][cut]}


def scaled(arrays: Arrays) -> Arrays:
    return arrays | {"positions": 10.0 * arrays["positions"]}


LIES: dict[str, Callable[[Path], None]] = {
    "status": lambda folder: stated(folder, status="success"),
    "status and harm": lambda folder: stated(
        folder, status="success",
        predicted_harm={"harm": 0.0, "threshold": 1.0, "object": "", "cause": "nothing"},
    ),
    "elsewhere": lambda folder: rows(folder, elsewhere),
    "last part": lambda folder: rows(folder, last_part),
    "scaled": lambda folder: rows(folder, scaled),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_no_command_believes_what_the_judge_does_not(lie, good, harmful, tmp_path):
    write_plan(harmful if lie.startswith("status") else good, tmp_path)
    LIES[lie](tmp_path)
    wrong = "HARM_PREDICTED" if lie.startswith("status") else "INVALID_PLAN"
    told = f"plan.json: status is success; judged again it is {wrong}"
    for reader in (load_plan, open_source, plan_report):
        with pytest.raises(InvalidPlanError, match=told):
            reader(str(tmp_path))  # type: ignore[operator]
    scene = str(tmp_path / "seen.yaml")
    for words in (
        ["check"], ["validate"], ["report"], ["simulate"], ["export", "--mjcf", f"{scene}.xml"],
    ):  # fmt: skip
        said = refused(words[0], tmp_path, *words[1:], code=1)
        assert f"error INVALID_PLAN: {tmp_path / told}" in said


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("change", ["larger", "of another", "gone"])
def test_the_file_that_differs_is_named(name, change, good, harmful, tmp_path):
    write_plan(good, tmp_path / "a")
    write_plan(harmful, tmp_path / "b")
    path = tmp_path / "a" / name
    match change:
        case "larger" if name.endswith("npz"):
            np.savez(
                path, **{k: v if v.dtype.kind == "U" else 10 * v for k, v in read(path).items()}
            )
        case "larger":
            path.write_bytes(path.read_bytes().replace(b"1", b"2", 1))
        case "of another":
            path.write_bytes((tmp_path / "b" / name).read_bytes())
        case "gone":
            path.unlink()
    for command in ("check", "validate", "report", "simulate"):
        assert f"error INVALID_REQUEST: {path}: " in refused(command, tmp_path / "a")
    with pytest.raises(InvalidRequestError, match=name):
        load_plan(tmp_path / "a")


@pytest.mark.parametrize("digests", [None, {}, {"plan.json": "0"}, {"../x": "0"}])
def test_without_the_digests_it_is_no_plan(digests: Any, good: Plan, tmp_path: Path) -> None:
    write_plan(good, tmp_path)
    path = tmp_path / "plan.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"sha256": digests}))
    with pytest.raises(InvalidRequestError, match="sha256"):
        load_plan(tmp_path)


def test_a_folder_of_0_3_0_is_still_a_plan(good: Plan, tmp_path: Path) -> None:
    """Its file has a strategy, a stage its trust radii, and every plan the paper's functionals."""
    write_plan(good, tmp_path)
    document = json.loads((tmp_path / "plan.json").read_text())
    for stage in document["stages"]:
        stage |= {"trust_radius": 0.02, "tried_radii": [0.005, 0.02]}
    term = {"initial": 3.0, "followed": 2.0, "final": 1.0, "history": [2.0, 1.0], "stage": "joint"}
    stated(tmp_path, strategy="joint", stages=document["stages"], terms={"avoid": term})
    loaded = load_plan(tmp_path)
    assert loaded.status is good.status
    assert loaded.stages == good.stages
    assert vars(loaded.terms["avoid"]) == term | {"history": (2.0, 1.0)}


def test_other_files_of_the_folder_stay(good: Plan, harmful: Plan, tmp_path: Path) -> None:
    (tmp_path / "deeper").mkdir()
    for mine in (tmp_path / "notes.txt", tmp_path / "deeper" / "x", tmp_path / ".plan.json.swp"):
        mine.write_text("mine")
    for made in (good, harmful):
        write_plan(made, tmp_path)
        assert load_plan(tmp_path).status is made.status
    assert {path.name for path in tmp_path.iterdir()} == {
        *FILES, "plan.json", "notes.txt", "deeper", ".plan.json.swp",
    }  # fmt: skip
    assert (tmp_path / "deeper" / "x").read_text() == "mine"


def test_a_place_that_is_no_file_is_refused_before_anything_is_written(good, tmp_path):
    (tmp_path / "trajectory.csv").mkdir()
    with pytest.raises(InvalidRequestError, match=r"trajectory.csv: it is no file"):
        write_plan(good, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["trajectory.csv"]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a child of this process")
def test_a_folder_holds_one_plan_whenever_the_writer_is_killed(good, harmful, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    write_plan(good, tmp_path)
    wait, seen = random.Random(0), set()
    for kill in range(400):  # a loaded machine may write no plan in the first of them
        if kill >= 16 and len(seen) == 2:
            break
        child = os.fork()
        if child == 0:
            while True:
                write_plan(harmful, tmp_path, rate=50.0)
                write_plan(good, tmp_path, rate=50.0)
        time.sleep(wait.uniform(0.0, 0.2))
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)
        found = load_plan(tmp_path)  # of one plan, or its digests differ
        seen.add(found.status)
        one = good if found.success else harmful
        np.testing.assert_array_equal(found.trajectory.positions, one.trajectory.positions)
    assert seen == {good.status, harmful.status}
    write_plan(good, tmp_path)
    assert load_plan(tmp_path).success
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {*FILES, "plan.json", "notes.txt"}  # what the killed left is gone


@pytest.mark.parametrize("reader", ["load", "write"])
def test_what_was_committed_is_the_plan(reader, good, harmful, tmp_path):
    """As a kill leaves it between the renaming of the folder and that of its files."""
    write_plan(good, tmp_path / "a")
    write_plan(harmful, tmp_path / "b")
    aside = tmp_path / "a" / COMMITTED
    aside.mkdir()
    for name in ("plan.json", *FILES):
        (tmp_path / "b" / name).rename(aside / name)
    (aside / "plan.json").replace(tmp_path / "a" / "plan.json")  # the first was moved
    if reader == "load":
        assert load_plan(tmp_path / "a" / "plan.json").status is harmful.status
    else:
        write_together(tmp_path / "a", {"more.txt": b"more"})
    assert not aside.exists()
    assert load_plan(tmp_path / "a").status is harmful.status


def test_a_link_in_the_place_of_the_committed_is_not_followed(good: Plan, tmp_path: Path) -> None:
    (tmp_path / "secrets").mkdir()
    (tmp_path / "secrets" / "key").write_text("k")
    write_plan(good, tmp_path / "a")
    (tmp_path / "a" / COMMITTED).symlink_to(tmp_path / "secrets")
    assert load_plan(tmp_path / "a").success
    write_plan(good, tmp_path / "a")
    assert (tmp_path / "secrets" / "key").read_text() == "k"
    assert not (tmp_path / "a" / "key").exists()


@pytest.mark.skipif(os.name != "posix", reason="asks which processes run")
def test_what_a_killed_writer_left_goes_with_the_next_writing(tmp_path: Path) -> None:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    dead, living = (tmp_path / f".file.{p}-00.writing" for p in (child, os.getpid()))
    other = tmp_path / f".file2.{child}-00.writing"
    for path in (dead, living, other):
        path.write_text("half")
    write_atomically(tmp_path / "file", b"whole")
    assert {path.name for path in tmp_path.iterdir()} == {"file", living.name, other.name}


def test_a_plan_that_goes_on_is_judged_from_where_it_began(good: Plan, tmp_path: Path) -> None:
    """With the push so far, and not from the scene's start."""
    for share in (0.2, 0.7, 0.95):
        made = plan(good.scene, previous=good, at=share * good.trajectory.duration)
        assert made.success
        write_plan(made, tmp_path)
        again = load_plan(tmp_path)
        assert (again.status, again.prediction) == (made.status, made.prediction)
        assert again.metrics == made.metrics
        assert again.start is not None
        document = json.loads(invoke("validate", tmp_path, "--json").stdout)
        assert document["status"] == "success"
        assert document["predicted_harm"]["harm"] == made.prediction.harm
    arrays = read(tmp_path / "waypoints.npz")
    np.savez(tmp_path / "waypoints.npz", **{k: v for k, v in arrays.items() if k != "start"})
    stated(tmp_path)
    with pytest.raises(InvalidPlanError, match="at the start link7 enters n1"):
        load_plan(tmp_path)


@pytest.mark.parametrize("start", [np.zeros((2, 7)), np.full((3, 7), np.nan), np.full((3, 7), 9.0)])
def test_a_start_that_is_none_is_refused(start: Any, good: Plan, tmp_path: Path) -> None:
    write_plan(good, tmp_path)
    rows(tmp_path, lambda arrays: arrays | {"start": start})
    with pytest.raises(OptiPrompError, match="start"):
        load_plan(tmp_path)
