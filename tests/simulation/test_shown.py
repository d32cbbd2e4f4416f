"""Runs in a line, a table and a view."""

import re

import numpy as np
import pytest

from optipromp import plan
from optipromp.laboratory.simulation import simulate
from optipromp.laboratory.simulation.execute import Moving
from optipromp.laboratory.simulation.world import build


@pytest.fixture(scope="module")
def run():
    return simulate(plan("scenario-4"))


def test_a_run_has_a_line_and_a_table(run):
    assert re.fullmatch(r"<Run in scenario-4: picked, nothing harmed, \d\.\d\d s>", repr(run))
    html = run._repr_html_()
    assert "target taken in" in html
    assert run.outcome.message in html
    assert html.count("<tr") > 5


def test_a_run_has_a_view_that_needs_no_network(run, tmp_path):
    pytest.importorskip("viser")
    view = run.show()
    assert not re.search(r"""(?:src|href)=["']https?:""", view.html)
    view.save(tmp_path / "run.html")
    assert 1e5 < (tmp_path / "run.html").stat().st_size < 6e6


def test_the_view_puts_fruits_where_they_were(run):
    moving = Moving(build(run.scene, run.robot, run.parameters, run.seed))
    rollout = run.rollout
    for row in (0, len(rollout.times) // 2, -1):
        at = {moved.item.id: moved for moved in moving.at(rollout.states[row])}
        for id_, position in zip(rollout.fruit_ids, rollout.fruit_positions[row], strict=True):
            np.testing.assert_allclose(at[id_].position, position, atol=1e-9)
        stem = at["n1"].stem
        ends = np.linalg.norm(stem[[0, -1]] - at["n1"].position, axis=1)
        assert ends[1] < 0.05 < ends[0]  # the root first
