"""``validate`` from end to end: files, bags and folders of anyone's trajectory."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import call

from optipromp import judge, load_scene, plan, robot_of
from optipromp.core.errors import InvalidRequestError
from optipromp.core.output import load_plan, write_plan
from optipromp.core.planning.task import posed
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes import Stem, save_scene
from optipromp.core.scenes.pose import Pose
from optipromp.core.trajectory import Trajectory, arrays, csv, read_trajectory
from optipromp_ros import Recorded, joint_trajectory, robot_trajectory, write_bag
from optipromp_sim.generate import generate


@pytest.fixture(scope="module")
def good(reach: Path) -> Trajectory:
    return load_plan(reach).trajectory


def told(path: Path, *more: str, scene: str = "scenario-3") -> tuple[int, dict[str, Any]]:
    code, stdout, _ = call("validate", str(path), "--scene", scene, "--json", *more)
    return code, json.loads(stdout)


def test_a_plan_is_valid_in_each_of_its_forms(reach, good, tmp_path):
    shuffled = [3, 0, 6, 1, 2, 5, 4]
    names = tuple(f"panda_{good.joint_names[j]}" for j in shuffled)
    rows = [values[:, shuffled] for values in good.rows()]
    (tmp_path / "other.csv").write_bytes(csv(Trajectory(good.times, *rows, names)))
    np.savez(tmp_path / "bare.npz", time=good.times + 7.0, positions=good.positions)
    write_bag(tmp_path / "one.mcap", [Recorded("/t", joint_trajectory(good, 1000.0))])
    write_bag(tmp_path / "two", [Recorded("/t", robot_trajectory(good, prefix="fr3_"))])
    files = ["other.csv", "bare.npz", "one.mcap", "two"]
    for path in (reach, reach / "trajectory.csv", reach / "trajectory.npz",
                 *(tmp_path / name for name in files)):  # fmt: skip
        code, document = told(path)
        assert code == 0, path
        assert document["status"] == "success"
        assert document["violations"] == []
        assert document["metrics"]["duration"] == pytest.approx(good.duration)
    for text, row in zip(
        read_trajectory(reach / "trajectory.csv", good.joint_names).rows(),
        read_trajectory(reach / "trajectory.npz", good.joint_names).rows(), strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(text, row, rtol=1e-14, atol=1e-300)  # of ten digits jerks err
    leaning = load_scene("scenario-3")
    leaning = replace(leaning, approach=replace(leaning.approach, direction=[0.4, 0.0, 0.9]))
    save_scene(leaning, tmp_path / "leaning.yaml")
    words = "validate", str(reach / "trajectory.csv"), "--scene", str(tmp_path / "leaning.yaml")
    assert "a plan that leans chose another: validate its folder" in call(*words)[2]
    code, stdout, _ = call("validate", str(reach))  # its own scene
    assert code == 0
    assert "success" in stdout


def test_probability_risk_forces_are_told(reach: Path, good: Trajectory, tmp_path: Path) -> None:
    np.savez(tmp_path / "t.npz", **arrays(good))
    strict = told(tmp_path / "t.npz", "--risk", "0.01")
    own = json.loads(call("validate", str(reach), "--risk", "0.01", "--json")[1])
    for code, document in (strict, (1, own)):
        assert (code, document["status"], document["risk"]) == (1, "HARM_PREDICTED", 0.01)
    usual = json.loads(call("validate", str(reach), "--json")[1])
    checked = json.loads(call("check", str(reach), "--json")[1])
    assert usual["predicted_harm"] == checked["predicted_harm"]
    assert usual["risk"] == checked["risk"] == 0.03
    assert 0.0 < usual["predicted_harm"]["probability"] < 1.0
    assert usual["predicted_harm"]["forces"].keys() == {"n1", "n2"}
    for words in (call("validate", str(reach))[1], call("check", str(reach))[1]):
        assert re.search(r"not clean with\s+probability \d+ %", words)


def test_faults_are_named_with_time_and_size(good: Trajectory, tmp_path: Path) -> None:
    """Each fault is told where it is judged: ``tests/judging``."""
    np.savez(tmp_path / "t.npz", **arrays(good.slowed(0.1)))
    code, document = told(tmp_path / "t.npz", "--out", str(tmp_path / "out"))
    assert (code, document["status"]) == (1, "INVALID_PLAN")
    found = {v["kind"]: v for v in document["violations"]}
    assert set(found) >= {"velocity", "acceleration", "jerk"}
    for one in found.values():
        assert one["amount"] > 0.0
        assert 0.0 <= one["time"] <= document["metrics"]["duration"]
    assert (tmp_path / "out" / "limits.png").read_bytes()[:4] == b"\x89PNG"
    assert json.loads((tmp_path / "out" / "verdict.json").read_text()) == document
    code, stdout, _ = call("validate", str(tmp_path / "t.npz"), "--scene", "scenario-3")
    assert code == 1
    assert all(name in stdout for name in found)


def write(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


NAMES = ",".join(f"joint{k}" for k in range(1, 8))
ROW = ",".join(["0.1"] * 7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty; expected a header time"),
        (f"{NAMES}\n{ROW}\n", "expected a header time"),
        (f"time,{NAMES},joint1\n0,{ROW},1\n", "each name once"),
        (f"time,{NAMES}\n0,{ROW}\n", "at least 2 waypoints"),
        (f"time,{NAMES}\n0,{ROW}\n0,{ROW}\n", "at least 2 waypoints"),
        (f"time,{NAMES}\n0,{ROW}\n2,{ROW}\n1,{ROW}\n", "times do not grow: 2 s at waypoint 1"),
        (f"time,{NAMES}\n0,{ROW}\n1,0.1\n", "line 3: 2 values, the header has 8"),
        (f"time,{NAMES}\n0,{ROW}\n1,{ROW.replace('0.1', 'inf', 1)}\n", "line 3: joint1 is 'inf'"),
        (f"time,{NAMES.replace('joint7', 'elbow')}\n0,{ROW}\n1,{ROW}\n", "joint7 is missing"),
        (f"time,{NAMES},joint2_velocity\n0,{ROW},0\n1,{ROW},0\n", "but not joint1_velocity"),
    ],
)
def test_files_that_hold_no_trajectory(text: str, message: str, tmp_path: Path) -> None:
    path = write(tmp_path / "t.csv", text)
    code, stdout, stderr = call("validate", str(path), "--scene", "scenario-3")
    assert code == 2
    assert stdout == ""
    assert message in stderr
    assert str(path) in stderr


def test_other_refusals(tmp_path: Path) -> None:
    names = tuple(f"joint{k}" for k in range(1, 8))
    for path, message in (
        (tmp_path / "none.csv", "cannot be read"),
        (tmp_path / "none.npz", "none.npz"),
        (write(tmp_path / "t.txt", ""), "a trajectory is a .csv, an .npz or a folder"),
        (tmp_path, "waypoints.npz"),
    ):
        with pytest.raises(InvalidRequestError, match=message):
            read_trajectory(path, names)
    times, q = np.arange(3.0), np.zeros((3, 7))
    single = np.array("joint1")  # without dimensions
    for held, message in (
        ({"positions": q}, "a trajectory has times"),
        ({"times": times, "positions": q[:, :6]}, r"positions have shape \(3, 6\)"),
        ({"times": times, "positions": q, "joint_names": single}, "3 times and 1 joints"),
    ):
        np.savez(tmp_path / "a.npz", **held)
        with pytest.raises(InvalidRequestError, match=message):
            read_trajectory(tmp_path / "a.npz", names)
    code, _, stderr = call("validate", str(write(tmp_path / "t.csv", "")))
    assert code == 2
    assert "add --scene SCENE" in stderr


def test_times_in_milliseconds_are_suspected(good: Trajectory, tmp_path: Path) -> None:
    """They were a success of 5,000 s, without a word."""
    for factor, said in ((1.0, False), (1e3, True)):
        slow = Trajectory.through(good.positions, factor * good.times, good.joint_names)
        np.savez(tmp_path / "t.npz", time=slow.times, positions=slow.positions)
        _, _, stderr = call("validate", str(tmp_path / "t.npz"), "--scene", "scenario-3")
        assert ("are its times milliseconds?" in stderr) is said


def test_a_trajectory_without_names_is_told_so(good: Trajectory, tmp_path: Path) -> None:
    """An empty ``joint_names`` was blamed on the positions."""
    nameless = joint_trajectory(good)
    nameless.joint_names = []
    write_bag(tmp_path / "t.mcap", [Recorded("/t", nameless)])
    code, _, stderr = call("validate", str(tmp_path / "t.mcap"), "--scene", "scenario-3")
    assert (code, "joint_names is empty" in stderr) == (2, True)


def test_check_tells_of_a_start_below_the_floor_and_offers_one(tmp_path: Path) -> None:
    scene = load_scene("scenario-3")
    low = replace(scene, start=np.array([0.0, 1.2, 0.0, -1.2, 0.0, 2.9, 0.8]))
    for name, one, said in (("usual", scene, False), ("low", low, True)):
        save_scene(one, tmp_path / f"{name}.yaml")
        _, stdout, stderr = call("check", str(tmp_path / f"{name}.yaml"))
        assert ("below the floor" in stderr) is said
        offered = re.search(r"start offered +(.*)", stdout)
        assert bool(offered) is said
    start = np.array([float(value) for value in offered[1].split(",")])
    assert plan(replace(scene, start=start)).success


def test_check_tells_of_a_start_in_a_fruit_a_root_too_low_and_a_goal_out_of_reach(tmp_path):
    """All were right."""
    scene = load_scene("scenario-3")
    first = scene.pushables[0]
    wrist = robot_of(scene).segment_frames(posed(scene)[1].q)[0][-1]
    for name, moved, code, said in (
        ("inside", first.at(wrist), 1, ("START_IN_COLLISION, at the start", first.id)),
        ("low", replace(first, stem=Stem.along(first.position, -scene.up, 0.1)), 0,
         (f"{first.id} would stand", "right")),
        ("far", scene.target.transformed(Pose(np.array([1.0, 0.0, 0.0]))), 0,
         ("goal out of reach", "right")),
    ):  # fmt: skip
        objects = tuple(moved if item.id == moved.id else item for item in scene.objects)
        save_scene(replace(scene, objects=objects), tmp_path / f"{name}.yaml")
        found, stdout, stderr = call("check", str(tmp_path / f"{name}.yaml"))
        assert found == code
        assert all(words in stdout + stderr for words in said)


def test_the_library_judges_files_too(reach: Path) -> None:
    assert judge("scenario-3", reach / "trajectory.csv").status == "success"
    assert judge(load_scene("scenario-3"), reach).status == "success"


STRETCHED = """
format: 1
name: stretched
robot: panda
start: [0.3, -0.2, 0.1, -1.9, 0.1, 1.7, 0.6]
goal: {joints: [0.3, -0.2, 0.1, -0.1, 0.1, 1.7, 0.6]}
objects: []
"""


def test_a_controller_says_what_it_would_abort(tmp_path: Path) -> None:
    """Joint 4 goes to -0.1 rad: the built-in Panda may (to -0.07), an FR3 may not (to -0.15)."""
    (tmp_path / "stretched.yaml").write_text(STRETCHED)
    made = plan(load_scene(tmp_path / "stretched.yaml"))
    write_plan(made, tmp_path / "made")
    assert call("validate", str(tmp_path / "made"))[0] == 0
    code, stdout, _ = call("validate", str(tmp_path / "made"), "--controller", "franka", "--json")
    assert code == 1
    document = json.loads(stdout)
    assert document["status"] == "success"
    assert document["controller"]["name"] == "franka"
    broken = {each["kind"]: each for each in document["controller"]["violations"]}
    place = broken["joint_position_limits_violation"]
    assert place["subject"] == "joint4"
    assert place["amount"] == pytest.approx(0.0518)
    assert place["time"] == pytest.approx(made.trajectory.duration)
    assert "joint_velocity_violation" in broken
    _, stdout, _ = call("validate", str(tmp_path / "made"), "--controller", "franka")
    told = "an FR3 allows -3.0421 to -0.1518 rad (joint_position_limits_violation)"
    assert told in " ".join(stdout.split())


def test_an_fr3_allows_plans_that_are_made_for_it(tmp_path: Path) -> None:
    """Also the rate of torque, by which a Panda's plan of the same scene is refused."""
    for scene, seed in (("scenario-3", None), ("cluster", 30000)):
        given = load_scene(scene) if seed is None else generate(scene, seed)
        write_plan(plan(replace(given, robot="fr3")), tmp_path / scene)
        code, stdout, _ = call("validate", str(tmp_path / scene), "--controller", "fr3", "--json")
        assert code == 0
        found = json.loads(stdout)["controller"]
        assert found["violations"] == []
        assert 0.5 < found["shares"]["torque rate"] < 0.75
        assert 0.1 < found["shares"]["velocity"] < 1.0
        assert 1.0 < found["power"] < 100.0


def test_an_arm_that_the_controller_cannot_move_is_refused(tmp_path: Path) -> None:
    still = np.array(load_scene("scenario-1").start)
    (tmp_path / "still.csv").write_bytes(
        csv(Trajectory.still(still, (0.0, 1.0), load_robot("scara").joint_names))
    )
    words = "validate", str(tmp_path / "still.csv"), "--scene", "scenario-1"
    code, _, stderr = call(*words, "--controller", "franka")
    assert code == 2
    assert "the controller franka moves 7 joints" in " ".join(stderr.split())
