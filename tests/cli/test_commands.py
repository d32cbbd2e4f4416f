"""The commands, called in this process."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from optipromp.cli.main import app

runner = CliRunner()
HELP = {
    "plan": "optipromp plan scenario-3 --out reach",
    "scenarios": "optipromp scenarios --out paper --json",
    "learn": "optipromp learn recorded.npz --out reach.npz",
    "check": "optipromp check my-robot.urdf",
    "list": "built-in robots and scenes",
}


@pytest.fixture
def demonstrations(tmp_path: Path) -> Path:
    phase = np.linspace(0.0, 1.0, 40)
    goals = np.linspace(0.5, 1.0, 6)
    positions = goals[:, None, None] * (phase**2 * (3 - 2 * phase))[None, :, None] * np.ones(3)
    path = tmp_path / "recorded.npz"
    np.savez(path, positions=positions)
    return path


def test_help_names_every_command() -> None:
    result = runner.invoke(app, ["--help"])
    assert result.exit_code == 0
    assert all(name in result.stdout for name in HELP)


@pytest.mark.parametrize("name", HELP)
def test_help_of_a_command_shows_how_to_use_it(name: str) -> None:
    result = runner.invoke(app, [name, "--help"], env={"COLUMNS": "200"})
    assert result.exit_code == 0
    assert HELP[name] in result.stdout


def test_list_as_json_is_one_document() -> None:
    result = runner.invoke(app, ["list", "--json"])
    document = json.loads(result.stdout)
    assert result.exit_code == 0
    assert {"panda", "scara"} <= set(document["robots"])
    assert {f"scenario-{i}" for i in (1, 2, 3, 4)} <= set(document["scenes"])
    assert document["planners"] == ["promp", "i-promp", "opti-promp"]


def test_list_for_people_names_the_same() -> None:
    result = runner.invoke(app, ["list"])
    assert "panda" in result.stdout
    assert "opti-promp" in result.stdout


def test_planners_and_strategies_are_those_of_the_library() -> None:
    from optipromp.cli.plan import Planner, Strategy
    from optipromp.planning.options import PLANNERS, STRATEGIES

    assert tuple(Planner) == PLANNERS
    assert tuple(Strategy) == STRATEGIES


@pytest.mark.parametrize(
    ("item", "kind"),
    [("panda", "robot"), ("scara", "robot"), ("scenario-1", "scene"), ("scenario-4", "scene")],
)
def test_check_tells_the_kind_of_built_in_things(item: str, kind: str) -> None:
    result = runner.invoke(app, ["check", item, "--json"])
    document = json.loads(result.stdout)
    assert result.exit_code == 0, result.stderr
    assert (document["status"], document["kind"]) == ("success", kind)


def test_check_summarises_demonstrations(demonstrations: Path) -> None:
    document = json.loads(runner.invoke(app, ["check", str(demonstrations), "--json"]).stdout)
    assert document["kind"] == "demonstrations"
    assert document["demonstrations"] == 6
    assert document["samples"] == 240


@pytest.mark.parametrize(
    ("name", "content", "code"),
    [
        ("scene.yaml", "format: 1\nname: x\nrobot: panda\nobjets: []\n", "INVALID_SCENE"),
        ("scene.json", '{"name": "x", "robot": ', "INVALID_SCENE"),
        ("robot.urdf", "<robot name='a'>", "INVALID_ROBOT"),
        ("robot.yaml", "format: 1\nname: a\nurdf: none.urdf\n", "INVALID_ROBOT"),
        ("demos.csv", "time,a\n0,nan\n", "INVALID_DEMONSTRATION"),
        ("demos.npz", "no archive", "INVALID_DEMONSTRATION"),
        ("thing.doc", "?", "INVALID_REQUEST"),
    ],
)
def test_check_says_what_is_wrong_in_one_line(
    tmp_path: Path, name: str, content: str, code: str
) -> None:
    path = tmp_path / name
    path.write_text(content)
    result = runner.invoke(app, ["check", str(path)])
    assert result.exit_code == 2
    assert result.stdout == ""
    assert result.stderr.startswith(f"error {code}: ")
    assert result.stderr.count("\n") == 1
    assert str(tmp_path) in result.stderr


def test_an_error_under_json_is_still_one_document() -> None:
    result = runner.invoke(app, ["check", "nothing-of-that-name", "--json"])
    document = json.loads(result.stdout)
    assert result.exit_code == 2
    assert document["status"] == "INVALID_REQUEST"
    assert "scenario-1" in document["message"]


def test_plan_of_a_scene_that_is_not_there_has_every_key() -> None:
    result = runner.invoke(app, ["plan", "missing.yaml", "--json"])
    document = json.loads(result.stdout)
    assert result.exit_code == 2
    assert document["status"] == "INVALID_SCENE"
    assert list(document) == [
        "scene", "planner", "strategy", "status", "message", "metrics", "terms", "time",
    ]  # fmt: skip


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan"],
        ["plan", "scenario-3", "--planner", "best"],
        ["plan", "scenario-3", "--strategy", "both"],
        ["plan", "scenario-3", "--seed", "-1"],
        ["learn", "recorded.npz"],
        ["nothing"],
    ],
)
def test_wrong_usage_ends_with_two(arguments: list[str]) -> None:
    result = runner.invoke(app, arguments)
    assert result.exit_code == 2
    assert result.stdout == ""


@pytest.mark.parametrize(
    "option", [["--knots", "2"], ["--duration", "0"], ["--timeout", "-1"], ["--duration", "nan"]]
)
def test_options_out_of_range_are_refused_by_name(option: list[str]) -> None:
    result = runner.invoke(app, ["plan", "scenario-3", *option])
    assert result.exit_code == 2
    assert result.stderr.startswith("error INVALID_REQUEST: ")
    assert option[0].lstrip("-") in result.stderr


@pytest.mark.parametrize("command", [["plan", "scenario-3"], ["scenarios"]])
def test_an_unwritable_folder_is_refused_before_the_work(
    tmp_path: Path, command: list[str]
) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("in the way")
    result = runner.invoke(app, [*command, "--out", str(blocked / "reach")])
    assert result.exit_code == 2
    assert "cannot write" in result.stderr
    assert blocked.read_text() == "in the way"


def test_learn_leaves_a_primitive_that_check_knows(demonstrations: Path, tmp_path: Path) -> None:
    out = tmp_path / "reach.npz"
    arguments = ["learn", str(demonstrations), "--out", str(out), "--basis", "7", "--json"]
    document = json.loads(runner.invoke(app, arguments).stdout)
    assert document["basis"] == 7
    assert document["demonstrations"] == 6
    checked = json.loads(runner.invoke(app, ["check", str(out), "--json"]).stdout)
    assert (checked["kind"], checked["basis"]) == ("primitive", 7)


def test_learn_by_expectation_maximisation(demonstrations: Path, tmp_path: Path) -> None:
    out = tmp_path / "reach.npz"
    result = runner.invoke(app, ["learn", str(demonstrations), "--out", str(out), "--em"])
    assert result.exit_code == 0, result.stderr
    assert out.exists()


def test_learn_leaves_nothing_where_it_cannot_write(demonstrations: Path, tmp_path: Path) -> None:
    result = runner.invoke(
        app, ["learn", str(demonstrations), "--out", str(demonstrations / "x.npz")]
    )
    assert result.exit_code == 2
    assert result.stderr.startswith("error INVALID_REQUEST: cannot write")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["recorded.npz"]


def test_a_warning_is_one_line_on_standard_error(tmp_path: Path) -> None:
    path = tmp_path / "one.csv"
    path.write_text("time,a\n" + "".join(f"{t / 10},{t / 20}\n" for t in range(11)))
    result = runner.invoke(app, ["learn", str(path), "--out", str(tmp_path / "p.npz")])
    assert result.exit_code == 0, result.stderr
    assert result.stderr.startswith("warning: ")
    assert ".py" not in result.stderr
