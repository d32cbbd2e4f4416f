"""Names that a user mistypes in Python are told as on the command line."""

import copy
import pickle
from dataclasses import replace
from importlib import import_module

import pytest
from tests.refusals import assert_refused

from optipromp import IProMP, OptiProMP, PlanOptions, plan, plan_many, plan_pick, plan_sequence
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.planners import make
from optipromp_paper.paper import Paper
from optipromp_sim.simulation.parameters import ControlParameters


@pytest.mark.parametrize(
    ("call", "wrong", "right"),
    [
        (lambda: PlanOptions(tiemout=3.0), "PlanOptions has no setting 'tiemout'", "timeout"),
        (lambda: IProMP(gaurd=True), "IProMP has no setting 'gaurd'", "guard"),
        (lambda: Paper(strtegy="joint"), "Paper has no setting 'strtegy'", "strategy"),
        (lambda: ControlParameters(sped=1.0), "ControlParameters has no setting", "speed"),
        (lambda: Paper(constraints="papers"), "constraints is 'papers'", "paper"),
        (lambda: plan("scenario-3", timeuot=4.0), "plan has no argument 'timeuot'", "timeout"),
        (lambda: plan("scenario-3", planer="promp"), "plan has no argument", "planner"),
        (lambda: plan_many(["scenario-3"], workrs=1), "plan_many has no argument", "workers"),
        (lambda: plan_sequence("scenario-3", ["ripe"], risc=0.1), "has no argument", "risk"),
    ],
)  # fmt: skip
def test_a_wrong_name_is_refused_with_the_nearest(call, wrong, right):
    assert_refused(InvalidRequestError, [wrong, f"did you mean {right!r}?"], call)


@pytest.mark.parametrize(
    ("call", "key"),
    [
        (lambda: plan("scenario-3", strategy="joint"), "strategy"),
        (lambda: plan_pick("scenario-3", strategy="joint"), "strategy"),
        (lambda: plan_many(["scenario-3"], strategy="joint"), "strategy"),
        (lambda: plan_sequence("scenario-3", ["ripe"], constraints="paper"), "constraints"),
        (lambda: PlanOptions(constraints="paper"), "constraints"),
        (lambda: PlanOptions(paper=None), "NAME"),
        (lambda: replace(PlanOptions(), constraints="paper"), "constraints"),
        (lambda: make("opti-promp", strategy="sequential"), "strategy"),
    ],
)
def test_a_setting_that_went_to_the_paper_s_planner_names_it(call, key):
    words = [f"write planner=optipromp.Paper({key}=...)", f"--planner paper --set {key}=..."]
    assert_refused(InvalidRequestError, words, call)


def test_the_options_of_0_3_0_name_the_planner_that_has_them() -> None:
    with pytest.raises(ImportError, match=r"write planner=optipromp\.Paper"):
        getattr(import_module("optipromp"), "PaperOptions")  # noqa: B009


def test_settings_are_arguments_named_as_on_the_command_line() -> None:
    made = plan("scenario-4", duration=9.0, risk=0.2)
    assert made.trajectory.duration == pytest.approx(9.0)
    assert made.risk == 0.2
    same = plan("scenario-4", options=PlanOptions(duration=9.0, risk=0.2))
    assert (made.trajectory.positions == same.trajectory.positions).all()
    both = plan("scenario-4", options=PlanOptions(duration=9.0), risk=0.2)
    assert (both.trajectory.duration, both.risk) == (made.trajectory.duration, 0.2)
    (many,) = plan_many(["scenario-4"], duration=9.0, workers=1)
    assert many.trajectory.duration == pytest.approx(9.0)


def test_settings_are_still_values() -> None:
    value = OptiProMP(corridor=0.01)
    assert pickle.loads(pickle.dumps(value)) == copy.deepcopy(value) == replace(value)
