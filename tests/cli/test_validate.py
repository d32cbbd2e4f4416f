"""``validate`` from end to end: files, bags and folders of anyone's trajectory."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from optipromp import load_scene
from optipromp.cli.main import app
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import Sphere
from optipromp.core.output import load_plan
from optipromp.core.planning.task import resolve
from optipromp.core.scenes import SceneObject, save_scene
from optipromp.core.trajectory import Trajectory
from optipromp.core.trajectory_files import arrays, csv, read_trajectory
from optipromp.ros import Recorded, joint_trajectory, robot_trajectory, write_bag


def call(*words: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, list(words))
    return result.exit_code, result.stdout, result.stderr


@pytest.fixture(scope="module")
def good(reach: Path) -> Trajectory:
    return load_plan(reach).trajectory


def told(path: Path, *more: str, scene: str = "scenario-3") -> tuple[int, dict[str, Any]]:
    code, stdout, _ = call("validate", str(path), "--scene", scene, "--json", *more)
    return code, json.loads(stdout)


def test_a_plan_is_valid_in_each_of_its_forms(
    reach: Path, good: Trajectory, tmp_path: Path
) -> None:
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
    code, stdout, _ = call("validate", str(reach))  # its own scene
    assert code == 0
    assert "success" in stdout


def faulty(good: Trajectory, kind: str) -> Trajectory:
    """The plan with one fault."""
    times, (q, velocity, acceleration) = good.times, (np.array(v) for v in good.rows())
    names, middle = good.joint_names, good.n_waypoints // 3
    match kind:
        case "too fast":
            return good.slowed(0.1)
        case "a jump in velocity":
            velocity[middle] += 0.4
        case "a jump in position":
            q[middle, 3] += 0.05
        case "beyond a limit between rows":
            velocity[0, 1], ends = 30.0, [0, -1]
            return Trajectory(times[ends], q[ends], velocity[ends], acceleration[ends], names)
        case "a goal 2 mm off":
            q[:, 5] += np.linspace(0.0, 1.0, len(q)) ** 5 * 0.01
            return Trajectory.through(q, times, names)
        case "not from the start":
            q += 1e-4
        case "cut short":
            velocity, acceleration = velocity[:middle], acceleration[:middle]
            return Trajectory(times[:middle], q[:middle], velocity, acceleration, names)
    return Trajectory(times, q, velocity, acceleration, names)


FAULTS = {
    "too fast": {"velocity", "acceleration", "jerk"},
    "a jump in velocity": {"acceleration", "jerk"},
    "a jump in position": {"acceleration", "jerk"},
    "beyond a limit between rows": {"limit", "velocity", "motion"},
    "a goal 2 mm off": {"goal"},
    "not from the start": {"start"},
    "cut short": {"motion", "goal"},
}


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


@pytest.mark.parametrize("kind", FAULTS)
def test_each_fault_is_named_with_its_time_and_size(
    kind: str, good: Trajectory, tmp_path: Path
) -> None:
    np.savez(tmp_path / "t.npz", **arrays(faulty(good, kind)))
    code, document = told(tmp_path / "t.npz", "--out", str(tmp_path / "out"))
    assert code == 1
    assert document["status"] == "INVALID_PLAN"
    found = {v["kind"]: v for v in document["violations"]}
    assert set(found) >= FAULTS[kind]
    for name in FAULTS[kind]:
        assert found[name]["amount"] > 0.0
        assert 0.0 <= found[name]["time"] <= document["metrics"]["duration"]
    assert (tmp_path / "out" / "limits.png").read_bytes()[:4] == b"\x89PNG"
    assert json.loads((tmp_path / "out" / "verdict.json").read_text()) == document
    if kind == "a goal 2 mm off":
        code, stdout, _ = call("validate", str(tmp_path / "t.npz"), "--scene", "scenario-3")
        assert (code, "goal" in stdout) == (1, True)


def test_a_contact_between_two_rows_has_its_time(good: Trajectory, tmp_path: Path) -> None:
    """A pin, 2 mm thick, where the tool is in the middle of an interval."""
    scene = load_scene("scenario-3")
    middle = 0.5 * float(good.times[10] + good.times[11])
    point, _ = resolve(scene).robot.tool_pose(good.sample(middle)[0][0])
    pin = SceneObject("pin", "static", Sphere(0.001), point)
    save_scene(replace(scene, objects=(*scene.objects, pin)), tmp_path / "pin.yaml")
    np.savez(tmp_path / "t.npz", **arrays(good))
    code, document = told(tmp_path / "t.npz", scene=str(tmp_path / "pin.yaml"))
    assert code == 1
    (found,) = [v for v in document["violations"] if v["kind"] == "contact"]
    assert "pin" in found["message"]
    assert found["time"] == pytest.approx(middle, abs=0.3)
    assert found["amount"] > 0.0


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
        (f"time,{NAMES}\n0,{ROW}\n0,{ROW}\n", "times do not grow: 0 s at waypoint 0"),
        (f"time,{NAMES}\n0,{ROW}\n1,0.1\n", "line 3: 2 values, the header has 8"),
        (f"time,{NAMES}\n0,{ROW}\nx,{ROW}\n", "line 3: time is 'x', expected a finite number"),
        (f"time,{NAMES}\n0,{ROW}\nnan,{ROW}\n", "line 3: time is 'nan'"),
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
    np.savez(tmp_path / "a.npz", positions=np.zeros((3, 7)))
    with pytest.raises(InvalidRequestError, match="a trajectory has times"):
        read_trajectory(tmp_path / "a.npz", names)
    np.savez(tmp_path / "b.npz", times=np.arange(3.0), positions=np.zeros((3, 6)))
    with pytest.raises(InvalidRequestError, match=r"positions have shape \(3, 6\)"):
        read_trajectory(tmp_path / "b.npz", names)
    single = np.array("joint1")  # without dimensions
    np.savez(
        tmp_path / "c.npz", times=np.arange(3.0), positions=np.zeros((3, 7)), joint_names=single
    )
    with pytest.raises(InvalidRequestError, match="3 times and 1 joints"):
        read_trajectory(tmp_path / "c.npz", names)
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


def test_check_tells_of_a_start_below_the_floor(tmp_path: Path) -> None:
    scene = load_scene("scenario-3")
    low = replace(scene, start=np.array([0.0, 1.2, 0.0, -1.2, 0.0, 2.9, 0.8]))
    for name, one, said in (("usual", scene, False), ("low", low, True)):
        save_scene(one, tmp_path / f"{name}.yaml")
        _, _, stderr = call("check", str(tmp_path / f"{name}.yaml"))
        assert ("below the floor" in stderr) is said
