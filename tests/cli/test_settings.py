"""``--set key=value``: settings of the planners from the command line."""

import json
from dataclasses import fields
from typing import Any

import pytest
from typer.testing import CliRunner

from optipromp.cli.catalogue import asked, documented
from optipromp.cli.main import app
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import PlanOptions
from optipromp.laboratory.planners.paper import PaperOptions


def call(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, ["plan", *arguments])
    return result.exit_code, result.stdout, result.stderr


def read(text: str) -> Any:
    return json.loads(text, parse_constant=pytest.fail)


def settings(pairs: list[str], **stated: Any) -> PlanOptions:
    options: PlanOptions = asked("opti-promp", "joint", pairs, stated)["options"]
    return options


# --- from text ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pair", "expected"),
    [
        ("max_step=0.03", PlanOptions(max_step=0.03)),
        ("waypoints=70", PlanOptions(waypoints=70)),
        ("waypoints=null", PlanOptions()),
        ("prediction=false", PlanOptions(prediction=False)),
        ("smoothness=1.0e-5", PlanOptions(smoothness=1e-5)),
        ("timeout=.inf", PlanOptions(timeout=float("inf"))),
        ("constraints=paper", PlanOptions(constraints="paper")),
        ("paper.drift_offset=0.03", PlanOptions(paper=PaperOptions(drift_offset=0.03))),
        (
            "paper.drift_offset={n1: 0.01, n2: 0.002}",
            PlanOptions(paper=PaperOptions(drift_offset={"n1": 0.01, "n2": 0.002})),
        ),
        ("paper.push=reciprocal", PlanOptions(paper=PaperOptions(push="reciprocal"))),
        ("paper.camera_point=no", PlanOptions(paper=PaperOptions(camera_point=False))),
        (
            "paper.alphas=[1.0, 2.0, 3.0, 0.0]",
            PlanOptions(paper=PaperOptions(alphas=(1.0, 2.0, 3.0, 0.0))),
        ),
    ],
)
def test_a_setting_is_read_as_yaml(pair: str, expected: PlanOptions) -> None:
    assert settings([pair]) == expected


def test_settings_add_up_and_the_last_of_a_key_counts() -> None:
    found = settings(
        ["max_step=0.01", "corridor=0.004", "max_step=0.02", "paper.epsilon=0.05"], duration=4.0
    )
    assert found == PlanOptions(
        max_step=0.02, corridor=0.004, duration=4.0, paper=PaperOptions(epsilon=0.05)
    )
    assert settings([], duration=None, timeout=None) == PlanOptions()


@pytest.mark.parametrize(
    ("pair", "message"),
    [
        ("max_step", r"--set max_step: write key=value"),
        ("max_stp=0.03", r"--set max_stp: no such setting; .*did you mean 'max_step'"),
        ("paper.drift_ofset=0.03", r"did you mean 'paper\.drift_offset'"),
        ("drift_offset=0.03", r"--set drift_offset: no such setting"),
        ("costs=[]", r"--set costs: no such setting"),
        ("paper=3", r"--set paper: no such setting"),
        ("max_step=[", r"--set max_step=\[: cannot read"),
        ("max_step=-1", r"max_step is -1; it must be at least 1e-06"),
        ("max_step=fast", r"max_step is fast; it must be of type float"),
        ("paper.epsilon=0", r"paper\.epsilon is 0; it must be positive"),
        ("constraints=all", r"constraints is all; it must be"),
        ("waypoints=2", r"waypoints is 2; it must be a whole number >= 3"),
        ("paper.alphas=[-1,1,1,0]", "negative"),
    ],
)
def test_what_is_wrong_is_said(pair: str, message: str) -> None:
    with pytest.raises(InvalidRequestError, match=message):
        settings([pair])


def test_every_setting_can_be_set_and_says_what_it_is() -> None:
    """But cost terms, which are objects, and the group of the paper's."""
    for options in (PlanOptions, PaperOptions):
        found = documented(options)
        assert set(found) == {f.name for f in fields(options)} - {"costs", "paper"}
        for name, (default, said) in found.items():
            assert default == getattr(options(), name)
            assert len(said) > 10, name


# --- from the command line ---------------------------------------------------------------------


def test_a_setting_is_heeded() -> None:
    code, stdout, _ = call("scenario-3", "--reach", "--set", "max_step=0.015", "--json")
    assert code == 0
    assert read(stdout)["metrics"]["max_step"] <= 0.015


def test_a_plan_that_does_harm_ends_with_one() -> None:
    code, stdout, _ = call("scenario-3", "--set", "prediction=false", "--json")
    document = read(stdout)
    assert code == 1
    assert document["status"] == "HARM_PREDICTED"
    assert document["predicted_harm"]["harm"] > document["predicted_harm"]["threshold"]
    assert document["predicted_harm"]["object"] in ("ripe", "n1", "n2")
    assert document["predicted_harm"]["object"] in document["message"]


def test_a_setting_of_the_paper_is_heeded() -> None:
    """The camera point is passed later or earlier: another motion of the same length."""
    documents = []
    for phase in ("0.4", "0.7"):
        code, stdout, _ = call(
            "scenario-3", "--planner", "promp", "--set", f"paper.camera_phase={phase}", "--json"
        )
        assert code == 1  # promp swallows n2
        documents.append(read(stdout))
    assert documents[0]["strategy"] is None
    assert documents[0]["metrics"]["duration"] != documents[1]["metrics"]["duration"]
