"""``--set key=value``: settings of the planners from the command line."""

from dataclasses import fields
from typing import Any

import pytest
from tests.cli.fixtures import call, read
from typer.testing import CliRunner

from optipromp.cli.catalogue import asked, documented
from optipromp.cli.main import app
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import ConditionedProMP, IProMP, OptiProMP, PlanOptions
from optipromp_paper.paper import Paper


def settings(pairs: list[str], **stated: Any) -> Any:
    return asked("opti-promp", pairs, stated)["planner"]


# --- from text ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pair", "expected"),
    [
        ("max_step=0.03", OptiProMP(max_step=0.03)),
        ("waypoints=null", OptiProMP()),
        ("prediction=false", OptiProMP(prediction=False)),
        ("drift_offset={n1: 0.01, n2: 0.002}", Paper(drift_offset={"n1": 0.01, "n2": 0.002})),
        ("push=reciprocal", Paper(push="reciprocal")),
        ("camera_point=no", ConditionedProMP(camera_point=False)),
        ("guard=yes", IProMP(guard=True)),
        ("alphas=[1.0, 2.0, 3.0, 0.0]", Paper(alphas=(1.0, 2.0, 3.0, 0.0))),
    ],
)
def test_a_setting_is_read_as_yaml(pair: str, expected: Any) -> None:
    assert asked(expected.name, [pair], {})["planner"] == expected


def test_time_effort_and_risk_are_of_every_plan() -> None:
    for name in ("opti-promp", "promp", "paper"):
        found = asked(name, ["timeout=.inf", "effort=7"], {"timeout": None})["options"]
        assert found == PlanOptions(timeout=float("inf"), effort=7)


def test_settings_add_up_and_the_last_of_a_key_counts() -> None:
    found = settings(["max_step=0.01", "corridor=0.004", "max_step=0.02"], duration=4.0)
    assert found == OptiProMP(max_step=0.02, corridor=0.004, duration=4.0)
    assert settings([], duration=None, timeout=None) == OptiProMP()


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("max_step", r"--set max_step: write key=value"),
        ("max_stp=0.03", r"--set max_stp: no such setting; .*did you mean 'max_step'"),
        ("paper.drift_offset=0.03", r"--set paper\.drift_offset: .* --set drift_offset=\.\.\.;"),
        ("strategy=joint", r"--set strategy: .* --planner paper --set strategy=\.\.\.;"),
        ("constraints=paper", r"write planner=optipromp\.Paper\(constraints=\.\.\.\)"),
        ("drift_offset=0.03", r"--set drift_offset: no such setting"),
        ("costs=[]", r"--set costs: no such setting"),
        ("max_step=[", r"--set max_step=\[: cannot read"),
        ("max_step=-1", r"max_step is -1: must be at least 1e-06 \[rad or m\]"),
    ],
)
def test_what_is_wrong_is_said(pair: str, message: str) -> None:
    with pytest.raises(InvalidRequestError, match=message):
        settings([pair])


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("drift_ofset=0.03", r"did you mean 'drift_offset'"),
        ("paper.epsilon=0.1", r"--planner paper --set epsilon=\.\.\."),
    ],
)
def test_what_is_wrong_is_said_of_the_paper_s_too(pair: str, message: str) -> None:
    with pytest.raises(InvalidRequestError, match=message):
        asked("paper", [pair], {})


@pytest.mark.parametrize("arguments", [
    ("plan", "scenario-3", "--strategy", "sequential"),
    ("plan", "scenario-3", "--constraints", "paper"),
    ("simulate", "scenario-3", "--strategy", "sequential"),
])  # fmt: skip
def test_an_option_that_went_to_the_paper_s_planner_names_it(arguments: tuple[str, ...]) -> None:
    done = CliRunner().invoke(app, list(arguments), env={"COLUMNS": "300"})
    assert done.exit_code == 2
    key = arguments[2].removeprefix("--")
    assert f"or --planner paper --set {key}=..." in done.stderr


def test_every_setting_can_be_set_and_says_what_it_is() -> None:
    """But cost terms, which are objects."""
    kinds: tuple[Any, ...] = PlanOptions, Paper, ConditionedProMP, IProMP
    for options in kinds:
        found = documented(options)
        assert set(found) == {f.name for f in fields(options)} - {"costs"}
        for name, (default, said) in found.items():
            assert default == getattr(options(), name)
            assert len(said) > 10, name


# --- from the command line ---------------------------------------------------------------------


def test_a_setting_is_heeded() -> None:
    code, stdout, _ = call("plan", "scenario-3", "--reach", "--set", "max_step=0.015", "--json")
    assert code == 0
    assert read(stdout)["metrics"]["max_step"] <= 0.015
