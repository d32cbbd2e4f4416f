"""How many promises may be broken: the probability told, and what is promised for a risk."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from optipromp.core.errors import Code
from optipromp.core.output import load_plan, write_plan
from optipromp.core.planning import judge, plan
from optipromp.core.planning.options import PlanOptions
from optipromp.core.pushing.model import Calibration
from optipromp.core.pushing.packs.standing import Standing
from optipromp.core.pushing.parameters import DETECTED, KNOWN
from optipromp_sim.generate import NOISES, generate, noisy

EVERY = {"known": KNOWN, "detected": DETECTED, "packs": Standing.calibration}


@pytest.mark.parametrize("name", EVERY)
def test_more_harm_fails_more_often_and_more_risk_allows_more_harm(name: str) -> None:
    found = EVERY[name]
    assert len(found.harm) == len(found.failed)
    assert len(found.risk) == len(found.threshold)
    for rising in (found.harm, found.failed, found.risk, found.threshold):
        assert list(rising) == sorted(set(rising))
    assert found.harm[0] == 0.0
    assert found.failed[0] > 0.0
    assert found.failed[-1] < 1.0


def test_between_what_was_counted_a_probability_is_interpolated() -> None:
    found = Calibration((0.0, 1.0, 2.0), (0.01, 0.1, 0.5), (0.01, 0.05), (0.2, 1.0))
    assert found.probability(0.5) == pytest.approx(0.055)
    assert found.probability(9.0) == 0.5
    assert found.allowed(0.03) == pytest.approx(0.6)
    assert found.allowed(0.001) == 0.2


def test_what_a_small_risk_promises_a_large_one_promises_too() -> None:
    promised = {}
    for risk in (0.01, 0.03, 0.1):
        made = [
            plan(noisy(generate("cluster", seed), seed, NOISES["zero-mean"]), seed=seed,
                 options=PlanOptions(risk=risk))
            for seed in range(46000, 46008)
        ]  # fmt: skip
        promised[risk] = sum(one.success for one in made)
        for one in made:
            assert one.risk == risk
            if one.status in (Code.SUCCESS, Code.HARM_PREDICTED):
                assert one.success == (one.prediction.harm <= one.prediction.threshold)
    assert promised[0.01] < promised[0.1]
    assert promised[0.01] <= promised[0.03] <= promised[0.1]


def test_a_folder_keeps_the_risk_that_its_plan_was_promised_for(tmp_path: Path) -> None:
    straight = generate("cluster", 32022)
    approach = replace(straight.approach, cone=0.0, aside=0.0)
    straight = replace(straight, approach=approach)
    bold = plan(straight, options=PlanOptions(risk=0.1))
    assert bold.success
    assert bold.prediction is not None
    write_plan(bold, tmp_path)
    again = load_plan(tmp_path)
    assert (again.status, again.risk) == (bold.status, 0.1)
    assert json.loads((tmp_path / "plan.json").read_text())["risk"] == 0.1
    careful, daring = (judge(straight, bold.trajectory, risk=risk) for risk in (0.01, 0.1))
    assert careful.status == Code.HARM_PREDICTED
    assert daring.status == Code.SUCCESS
    assert "not clean with probability" in careful.message
