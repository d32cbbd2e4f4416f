"""A policy that goes straight at the fruit: alone, guarded, and where the loop takes over."""

from typing import Any

import gymnasium
import numpy as np
import pytest

from optipromp.core.arrays import FloatArray
from optipromp_bench.env import Guarded
from optipromp_loop.guard import Safe

SCENE = {"preset": "cluster", "scene": 941_000}
STANDS = 100  # periods
SHARE = 0.5  # of the fastest action


def straight(seen: dict[str, FloatArray]) -> FloatArray:
    """The tool's action towards the target, see :func:`optipromp_bench.env.state_of`."""
    point = seen["arm"][14:17]
    return np.asarray(-SHARE * point / max(float(np.linalg.norm(point)), 0.05))


def driven(env: gymnasium.Env[Any, Any]) -> tuple[dict[str, Any], list[Safe]]:
    """The last ``info`` of an episode, which ends where the arm stands; and what the guard gave."""
    seen, info = env.reset(seed=1, options=SCENE)
    told, still, over = list[Safe](), 0, False
    while not over and still < STANDS:
        seen, _, ended, cut, info = env.step(straight(seen))
        told += [info["guard"]] if "guard" in info else []
        stands = bool(told) and told[-1].mover == "guard" and not told[-1].reference.moving
        still, over = (still + 1) * stands, ended or cut
    env.close()
    return info, told


@pytest.fixture
def env() -> Any:
    return gymnasium.make("optipromp/Pick-v0", presets="cluster")


def test_alone_it_harms(env: Any) -> None:
    info, _ = driven(env)
    assert info["outcome"].result == "harmed"


def test_before_a_guard_it_stands(env: Any) -> None:
    info, told = driven(Guarded(env))
    assert "outcome" not in info
    assert info["harm"] < 1.0
    assert {safe.mover for safe in told} == {"policy", "guard"}


def test_where_the_loop_takes_over_the_fruit_is_picked_clean(env: Any) -> None:
    info, told = driven(Guarded(env, takes_over=True))
    assert info["is_success"]
    movers = [safe.mover for safe in told]
    first = movers.index("loop")
    assert set(movers[first:]) == {"loop"}
    assert 0.1 < first / len(movers) < 0.9
    reasons = list(dict.fromkeys(safe.reason for safe in told[first:]))
    assert reasons[0].startswith("the loop has the arm (leave): harm is predicted")
    assert reasons[-1].startswith("the loop has the arm (take): harm is predicted")
    assert any(safe.probability > 0.0 for safe in told[first:])
