"""Somebody's policy behind a guard: it goes straight at the ripe fruit, whatever hangs there.

    python examples/13_guard.py

A guard is one call in any loop. Here the arm is where it is commanded to be. On a robot, `state` is
what was measured, and what a camera saw goes in too: `guard(action, state, looks)`.
"""

from collections import Counter

import numpy as np

from optipromp import State, load_scene
from optipromp_loop.guard import Guard


class Straight:
    """The policy: velocities of the tool point towards a place, at up to 0.3 m/s."""

    def __init__(self, target: np.ndarray) -> None:
        self.target = target

    def act(self, point: np.ndarray) -> np.ndarray:
        """The velocity (3,) at a tool point (3,) [m/s]."""
        by = self.target - point
        return 0.3 * by / max(float(np.linalg.norm(by)), 0.05)


scene = load_scene("scenario-3")
guard, policy = Guard(scene), Straight(scene.target.position)
state = State(guard.robot.home if scene.start is None else scene.start)
reasons = Counter()
for _ in range(400):
    point, _ = guard.robot.tool_pose(state.q)
    safe = guard(guard.tool(policy.act(point), state), state)
    state = safe.reference
    reasons[safe.reason or "as the policy wants"] += 1
for reason, count in reasons.most_common(5):
    print(f"{count:4d} times: {reason}")
