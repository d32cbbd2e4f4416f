"""Names that a user mistypes in Python are told as on the command line."""

import copy
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from optipromp import IProMP, OptiProMP, PaperOptions, PlanOptions, plan, plan_many, plan_sequence
from optipromp.core.errors import InvalidRequestError
from optipromp.laboratory.planners.paper import Paper
from optipromp.laboratory.simulation.parameters import ControlParameters


@pytest.mark.parametrize(
    ("call", "wrong", "right"),
    [
        (lambda: PlanOptions(tiemout=3.0), "PlanOptions has no setting 'tiemout'", "timeout"),
        (lambda: OptiProMP(coridor=0.01), "OptiProMP has no setting 'coridor'", "corridor"),
        (lambda: IProMP(gaurd=True), "IProMP has no setting 'gaurd'", "guard"),
        (lambda: Paper(strtegy="joint"), "Paper has no setting 'strtegy'", "strategy"),
        (lambda: PaperOptions(epsilom=0.1), "PaperOptions has no setting", "epsilon"),
        (lambda: ControlParameters(sped=1.0), "ControlParameters has no setting", "speed"),
        (lambda: replace(PlanOptions(), duratoin=4.0), "has no setting 'duratoin'", "duration"),
        (lambda: PlanOptions(constraints="papers"), "constraints is papers", "paper"),
        (lambda: PaperOptions(drift="lateral"), "paper.drift is lateral", "lateral-plane"),
        (lambda: plan("scenario-3", timeuot=4.0), "plan has no argument 'timeuot'", "timeout"),
        (lambda: plan("scenario-3", planer="promp"), "plan has no argument", "planner"),
        (lambda: plan("scenario-3", strategy="jiont"), "strategy is 'jiont'", "joint"),
        (lambda: plan_many(["scenario-3"], workrs=1), "plan_many has no argument", "workers"),
        (lambda: plan_sequence("scenario-3", ["ripe"], risc=0.1), "has no argument", "risk"),
    ],
)  # fmt: skip
def test_a_wrong_name_is_refused_with_the_nearest(
    call: Callable[[], Any], wrong: str, right: str
) -> None:
    with pytest.raises(InvalidRequestError) as told:
        call()
    assert wrong in told.value.message
    assert f"did you mean {right!r}?" in told.value.message


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
    with pytest.raises(InvalidRequestError, match="timeout is -1"):
        plan("scenario-4", timeout=-1.0)


def test_settings_are_still_values() -> None:
    value = OptiProMP(corridor=0.01)
    assert pickle.loads(pickle.dumps(value)) == copy.deepcopy(value) == replace(value)
