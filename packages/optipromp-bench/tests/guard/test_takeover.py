"""A policy that goes straight at the fruit: alone, guarded, and where the loop takes over."""

import gymnasium
import numpy as np
import pytest

from optipromp_bench.env import Guarded

SCENE = {"preset": "cluster", "scene": 941_000}
WAYS = {
    "alone": (None, "harmed", set()),
    "guarded": (False, "", {"policy", "guard"}),
    "takes over": (True, "clean", {"policy", "guard", "loop"}),
}


@pytest.mark.parametrize("way", WAYS)
def test_it_harms_alone_stands_before_a_guard_and_is_clean_where_the_loop_takes_over(
    way: str,
) -> None:
    """The episode ends after 2 s in which a guarded arm stands."""
    takes_over, end, movers = WAYS[way]
    env = gymnasium.make("optipromp/Pick-v0", presets="cluster")
    env = env if takes_over is None else Guarded(env, takes_over)
    seen, _ = env.reset(seed=1, options=SCENE)
    told, reasons, still, over = set[str](), list[str](), 0, False
    while not over and still < 100:
        point = seen["arm"][14:17]  # of the tool from the target
        action = -0.5 * point / max(float(np.linalg.norm(point)), 0.05)
        seen, _, ended, cut, info = env.step(action)
        over, safe = ended or cut, info.get("guard")
        if safe is not None:
            told, reasons = told | {safe.mover}, [*reasons, safe.reason]
            still = (still + 1) * (safe.mover == "guard" and not safe.reference.moving)
    env.close()
    assert told == movers
    assert info["harm"] < 1.0 or not movers
    assert ("outcome" in info and info["outcome"].result) == (end or False)
    if takes_over:
        assert reasons[-1] == "the loop has the arm (take): harm is predicted"
        assert "the loop has the arm (leave): harm is predicted" in reasons  # it was among fruits
