"""Predicted harm against outcomes: the reliability table and the AUC."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import mannwhitneyu
from tests.experiments.test_study import ROW

from optipromp.laboratory.experiments.statistics import auc, calibration, wilson

values = st.lists(st.integers(0, 6).map(lambda k: 0.25 * k), min_size=1, max_size=20)


@given(values, values)
def test_the_auc_is_that_of_mann_and_whitney(above: list[float], below: list[float]) -> None:
    u = mannwhitneyu(above, below, method="asymptotic").statistic
    assert auc(above, below) == pytest.approx(u / (len(above) * len(below)))


def test_without_pairs_there_is_no_auc() -> None:
    assert np.isnan(auc([], [1.0]))
    assert np.isnan(auc([1.0], []))


def test_runs_are_counted_in_the_bin_of_their_probability() -> None:
    outcomes = [(0.0, True), (0.004, True), (0.01, False), (0.3, True), (0.1, False), (1.0, False)]
    rows = [
        replace(
            ROW, predicted_failure=told, success=ok,
            plan_status="HARM_PREDICTED" if told > 0.5 else "success",
        )
        for told, ok in outcomes
    ]  # fmt: skip
    rows += [
        replace(ROW, predicted_failure=None),  # no model
        replace(ROW, predicted_failure=0.1, picked=None),  # not executed
    ]
    found = calibration(rows)
    counted = [(b.low, b.high, b.runs, b.failures) for b in found.bins]
    assert counted == [
        (0.0, 0.01, 2, 0), (0.01, 0.02, 1, 1), (0.1, 0.2, 1, 1), (0.2, 0.4, 1, 0), (0.4, 1.0, 1, 1),
    ]  # fmt: skip
    assert [b.predicted for b in found.bins] == pytest.approx([0.002, 0.01, 0.1, 0.3, 1.0])
    assert sum(b.runs for b in found.bins) == 6
    for b in found.bins:
        assert b.rate == b.failures / b.runs
        assert (b.rate_low, b.rate_high) == wilson(b.failures, b.runs)
    assert (found.successes, found.failed) == (5, 2)
    assert found.auc == pytest.approx(7.0 / 9.0)


def test_without_predictions_there_is_no_calibration() -> None:
    assert calibration([replace(ROW, predicted_failure=None)]) is None
