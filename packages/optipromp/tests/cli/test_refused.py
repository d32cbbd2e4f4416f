"""Bad input at the command line: one line with code, file and field; exit 2; nothing written."""

import copy
import json
import os
import zipfile
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import completed, invoke
from tests.fuzzing.originals import chain, obj
from tests.scenes.documents import FRUIT, MINIMAL, with_fruit, with_object

NAMES = np.array([f"joint{k}" for k in range(1, 8)])
MOTION = (
    np.linspace(0.0, 1.0, 20)[None, :, None] * np.array([0.9, 1.0, 1.2])[:, None, None] * np.ones(7)
)


def cut(text: Any) -> str:
    return text if isinstance(text, str) else json.dumps(text)


SCENES: list[tuple[Any, str]] = [
    (with_fruit(position=[0, 0, 1e300]), "at most 1e+06"),
    (with_object(shape={"mesh": {"file": "/etc/a.stl"}}), "outside the folder"),
    (with_object(shape={"point_cloud": {"file": "secret.txt", "radius": 1}}), "three numbers"),
    (with_object(shape={"mesh": {"file": "open.obj"}}), "watertight"),
    (with_object(shape={"mesh": {"file": "nan.obj"}}), "vertex"),
    ("[" * 100_000, "nested too deep"),
]  # fmt: skip


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    lines = obj().decode().splitlines()
    (tmp_path / "open.obj").write_text("\n".join(lines[:-1]))
    (tmp_path / "nan.obj").write_text("\n".join(["v nan 0 0", *lines[1:]]))
    (tmp_path / "secret.txt").write_text("0 0 0\npassword: 1234\n")
    return tmp_path


COMPILING = "compiling kernels, once (about half a minute) ...\n"  # where the cache is empty


def refused(arguments: list[str], code: str, *words: str) -> None:
    """The command says so in one line, ends with 2 and leaves nothing."""
    before = set(Path().rglob("*"))
    result = invoke(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    told = result.stderr.removeprefix(COMPILING)
    assert told.startswith(f"error {code}: ")
    assert told.count("\n") == 1
    assert all(word in told for word in words), told
    assert "Traceback" not in result.stderr
    assert "1234" not in result.stderr
    assert set(Path().rglob("*")) <= before | {Path("out")}
    assert not any(Path("out").rglob("*"))


def test_a_robot_whose_mesh_is_no_mesh(folder: Path) -> None:
    mesh = '<collision><geometry><mesh filename="/etc/passwd"/></geometry></collision>'
    joint = '<joint name="j" type="continuous"><parent link="a"/><child link="b"/></joint>'
    links = f'<link name="a">{mesh}</link><link name="b"/>'
    (folder / "r.urdf").write_text(f'<robot name="r">{links}{joint}</robot>')
    refused(["check", "r.urdf"], "INVALID_ROBOT", "r.urdf", "its suffix must be")


@pytest.mark.parametrize(("content", "words"), SCENES)
def test_scenes(folder: Path, content: Any, words: str) -> None:
    (folder / "s.json").write_text(cut(content))
    refused(["plan", "s.json", "--out", "out"], "INVALID_SCENE", "s.json", words)


def broken(kind: str) -> None:
    """A file demos.npz (or what else it is) that holds no demonstrations."""
    path, good = Path("demos.npz"), {"positions": MOTION, "joint_names": NAMES}
    match kind:
        case "flipped" | "encrypted":
            np.savez(path, allow_pickle=False, **good)
            data = bytearray(path.read_bytes())
            if kind == "flipped":
                data[600] ^= 0xFF
            else:
                data[6] |= 1
                data[data.find(b"PK\x01\x02") + 8] |= 1
            path.write_bytes(bytes(data))
        case "bomb":
            with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
                archive.writestr("positions.npy", bytes(300_000_000))
        case "pipe":
            os.mkfifo(path)
        case "huge":
            np.savez(path, positions=MOTION * 1e300, joint_names=NAMES)


@pytest.mark.parametrize("kind", ["flipped", "encrypted", "bomb", "pipe", "huge"])
def test_demonstrations(folder: Path, kind: str) -> None:
    broken(kind)
    refused(
        ["plan", "scenario-3", "--demonstrations", "demos.npz", "--out", "out"],
        "INVALID_DEMONSTRATION", "demos.npz",
    )  # fmt: skip


def device() -> None:
    Path("s.yaml").symlink_to("/dev/zero")


def sparse() -> None:
    with Path("s.yaml").open("wb") as file:
        file.truncate(2_000_000_000)


@pytest.mark.parametrize("make", [device, sparse, lambda: os.mkfifo("s.yaml")])
def test_files_without_end(folder: Path, make: Callable[[], None]) -> None:
    make()
    refused(["plan", "s.yaml", "--out", "out"], "INVALID_SCENE", "s.yaml", "must")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--duration", "1e300"], "at most 1e+09"), (["--timeout", "nan"], "timeout is nan"),
        (["--rate", "-1"], "--rate is -1"),
    ],
)  # fmt: skip
def test_requests(folder: Path, options: list[str], words: str) -> None:
    refused(["plan", "scenario-3", "--out", "out", *options], "INVALID_REQUEST", words)


def test_a_start_in_degrees_is_told(folder: Path) -> None:
    (folder / "s.json").write_text(json.dumps(MINIMAL | {"start": [0, 0, 0, -90, 0, 90, 0]}))
    refused(["plan", "s.json", "--out", "out"], "START_INVALID", "joint", "degrees?")


def test_objects_of_hundreds_of_metres_are_told(folder: Path) -> None:
    floor = {"id": "floor", "role": "static", "shape": {"box": {"size": [800, 800, 0.1]}}}
    scene = copy.deepcopy(MINIMAL)
    scene["objects"].append(floor | {"position": [0, 0, -0.5]})
    (folder / "s.json").write_text(json.dumps(scene))
    result = completed("check", "s.json")
    assert "warning: object 'floor' reaches" in result.stderr
    assert "millimetres?" in result.stderr


def test_a_scene_may_read_where_it_is_allowed(folder, monkeypatch):
    other = folder / "other"
    (other / "scenes").mkdir(parents=True)
    (folder / "cube.obj").write_bytes(obj())
    (folder / "arm.urdf").write_text(chain(Random(1)))
    scene = {"format": 1, "name": "s", "robot": "../../arm.urdf", "objects": [FRUIT]}
    (other / "scenes/s.json").write_text(json.dumps(scene))
    monkeypatch.chdir(other)
    refused(["check", "scenes/s.json"], "INVALID_SCENE", "outside the folder")
    monkeypatch.setenv("OPTIPROMP_FOLDERS", str(folder))
    completed("check", "scenes/s.json")


@pytest.mark.parametrize("name", ["a[/bold]$\\frac{$%s{}", "ü–→"])
def test_names_are_no_markup(folder: Path, name: str) -> None:
    scene = copy.deepcopy(MINIMAL) | {"name": name}
    scene["objects"][0]["id"] = name
    (folder / "s.json").write_text(json.dumps(scene))
    result = completed("plan", "s.json", "--out", "out")
    assert name in result.stdout
    assert json.loads(Path("out/plan.json").read_text())["scene"] == name
    assert Path("out/reach.png").exists()


@pytest.mark.parametrize("id_", ["../../../away", "/away", "a" * 300, "..", 'a:b*c?"<>|'])
def test_an_id_leads_to_no_other_folder(folder: Path, id_: str) -> None:
    scene = copy.deepcopy(MINIMAL)
    scene["objects"][0]["id"] = id_
    (folder / "s.json").write_text(json.dumps(scene))
    completed("plan", "s.json", "--targets", id_, "--out", "out", "--no-figures")
    (home,) = (path for path in (folder / "out").iterdir() if path.is_dir())
    assert home.name.startswith("1-")
    assert (home / "plan.json").exists()
    assert [path.parent for path in folder.rglob("plan.json")] == [home]
    assert not list(folder.parent.glob("*away*"))


LONG = "a" * 5_000  # no file can have this name; looking for it raises
ARM = ["--robot", "arm.urdf"]


@pytest.mark.parametrize(
    "command",
    [
        ["plan", LONG], ["plan", "s.json", "--demonstrations", LONG], ["plan", "s.json", "--robot",
        LONG + ".urdf"], ["plan", "s.json", *ARM, "--srdf", LONG],
        ["plan", "s.json", "--previous", LONG],
        ["plan", "s.json", *ARM, "--package-dir", LONG], ["plan", "s.json", "--out", LONG],
        ["simulate", LONG], ["simulate", "s.json", "--in", LONG], ["validate", LONG],
        ["validate", LONG, "--scene", "s.json"], ["validate", "s.csv", "--scene", LONG],
        ["check", LONG], ["check", LONG + ".urdf"], ["check", LONG + ".yaml"], ["view", LONG],
        ["report", LONG, "--out", "r.html"], ["export", LONG, "--mjcf", "s.xml"],
        ["export", "s.json", "--mcap", LONG], ["learn", LONG, "--out", "learnt.npz"],
        ["generate", "--preset", "cluster", "--robot", LONG + ".urdf", "--out", "g"],
        ["generate", "--preset", "cluster", "--out", LONG],
        ["bench", "study", "presets=cluster", "seeds=0:1", "--out", LONG],
    ],
    ids=lambda command: " ".join(part[:12] for part in command),
)  # fmt: skip
def test_names_that_no_file_can_have(folder: Path, command: list[str]) -> None:
    (folder / "s.json").write_text(json.dumps(MINIMAL))
    (folder / "arm.urdf").write_text(chain(Random(1)))
    (folder / "cube.obj").write_bytes(obj())
    before = sorted(path.name for path in folder.iterdir())
    result = invoke(*command)
    assert result.exit_code == 2, result.output
    assert result.exception is None or isinstance(result.exception, SystemExit)
    assert LONG[:100] in "".join(result.stderr.split())
    assert sorted(path.name for path in folder.iterdir()) == before


def test_a_device_is_not_replaced(folder: Path) -> None:
    np.savez("demos.npz", positions=MOTION, joint_names=NAMES)
    Path("learnt.npz").symlink_to("/dev/full")
    refused(["learn", "demos.npz", "--out", "learnt.npz"], "INVALID_REQUEST", "it is no file")
    assert Path("learnt.npz").is_symlink()
    refused(["learn", "demos.npz", "--out", "x.npz", "--bases", "100000"], "INVALID_REQUEST", "200")
