"""A small draw of `python -m scripts.judged`; docs/judged.md has the figures of a large one."""

from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, files
from typing import Any

import numpy as np
import pytest

try:
    files("example-robot-data")
except PackageNotFoundError:
    pytest.skip(
        "no example-robot-data: pip install 'packages/optipromp[models]'", allow_module_level=True
    )

oracles = pytest.importorskip("scripts.judged.__main__", reason="coal or mujoco not installed")

RUNS = {
    "still": partial(oracles.still, 60),
    "moving": partial(oracles.moving, 6),
    "own": partial(oracles.still, 80, own=True, mujocos=False),
    "own-moving": partial(oracles.moving, 6, own=True),
    "self": partial(oracles.selves, 80),
}


@pytest.mark.parametrize("name", RUNS)
def test_nothing_in_contact_is_called_free(name: str) -> None:
    tally = RUNS[name](seed=1)
    assert tally.missed == []
    assert tally.touching > 0
    if tally.ours:
        assert (np.array(tally.ours) - tally.theirs).max() < 3e-6


def test_the_distances_to_its_own_spheres_are_coals() -> None:
    tally = oracles.still(80, 2, own=True, mujocos=False)
    np.testing.assert_allclose(tally.ours, tally.theirs, atol=3e-6)


def test_a_judge_that_knows_the_robot_too_thin_is_found_out(monkeypatch):
    """The oracles can fail: with spheres 5 mm smaller contacts are missed."""
    made = oracles.arms

    def thinner(own: bool) -> list[Any]:
        every = made(own)
        for arm in every:
            spheres = arm.robot.spheres
            arm.robot = replace(arm.robot, spheres=spheres._replace(radius=spheres.radius - 5e-3))
        return every

    monkeypatch.setattr(oracles, "arms", thinner)
    assert oracles.still(60, 1, own=True, mujocos=False).missed
    assert oracles.moving(8, 1, own=True).missed
