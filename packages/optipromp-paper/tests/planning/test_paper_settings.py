"""Settings of the paper's planner: wrong values are refused, and every setting is heeded."""

from collections.abc import Callable
from dataclasses import fields
from typing import Any

import numpy as np
import pytest

from optipromp.core.planning import Plan
from optipromp.core.planning.options import Optimised
from optipromp_paper.paper import Paper

Planned = Callable[..., Plan]
JOINT: dict[str, Any] = {
    "alphas": (1.0, 5.0, 1.0, 1.0),
    "epsilon": 0.06,
    "reduction": "max",
    "push": "reciprocal",
    "push_weights": (1.0, 5.0, 1.0),
    "drift_offset": 0.03,
    "corridor": 1e-4,
}
SEQUENTIAL = JOINT | {
    "epsilon": 0.05,
    "reduction": "sum",
    "push": "quadratic",
    "corridor": 0.001,
    "trust_radii": (0.05,),
}


@pytest.mark.parametrize(
    ("strategy", "name"),
    [("joint", name) for name in JOINT] + [("sequential", name) for name in SEQUENTIAL],
)
def test_every_setting_is_heeded(strategy: str, name: str, planned: Planned) -> None:
    table = JOINT if strategy == "joint" else SEQUENTIAL
    more: dict[str, Any] = {}
    more |= {"push": "quadratic"} if (strategy, name) == ("sequential", "push_weights") else {}
    more |= {"epsilon": 0.06} if name == "reduction" else {}  # B_d keeps 1 cm from the clusters
    plain, changed = (
        planned("scenario-3", "paper", strategy=strategy, **settings)
        for settings in (more, {**more, name: table[name]})
    )
    one, other = plain.trajectory, changed.trajectory
    assert one.duration != other.duration or not np.array_equal(one.positions, other.positions)


def test_no_setting_is_forgotten_here() -> None:
    own = {item.name for item in fields(Paper)} - {item.name for item in fields(Optimised)}
    elsewhere = {"strategy", "constraints", "camera_phase", "via_deviation", "drift"}
    assert own | {"corridor"} == set(JOINT) | set(SEQUENTIAL) | elsewhere
