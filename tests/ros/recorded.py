"""Synthetic recordings of an arm that is guided by hand."""

import itertools
from collections.abc import Sequence

import numpy as np

from optipromp_ros import Recorded, message

JOINTS = tuple(f"joint{k}" for k in range(1, 8))
STILL, MOVE = 1.0, 2.0  # [s] a phase of either
NANO = 10**9


def guided(
    count: int = 5, noise: float = 5e-4, rate: float = 100.0, seed: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) [s] and positions (m, 7): still, then motions with a still phase after each."""
    random = np.random.default_rng(seed)
    ends = random.uniform(-1.0, 1.0, (count + 1, 7))
    times = np.arange(0.0, STILL + count * (MOVE + STILL), 1.0 / rate)
    times[1:-1] += random.uniform(-0.2, 0.2, len(times) - 2) / rate
    q = np.tile(ends[0], (len(times), 1))
    for k, (start, end) in enumerate(itertools.pairwise(ends)):
        s = np.clip((times - STILL - k * (MOVE + STILL)) / MOVE, 0.0, 1.0)
        q += np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, end - start)
    return times, q + noise * random.standard_normal(q.shape)


def joint_states(
    times: np.ndarray,
    positions: np.ndarray,
    *,
    topic: str = "/joint_states",
    names: Sequence[str] = JOINTS,
    stamped: bool = True,
) -> list[Recorded]:
    """Messages whose names stand in another order each time, with a finger among them."""
    random = np.random.default_rng(0)
    names, out = [*names, "finger"], []
    for time, q in zip(times, positions, strict=True):
        order = random.permutation(len(names))
        stamp = 1_700_000_000 * NANO + round(time * NANO)
        header = message("std_msgs/msg/Header")
        if stamped:
            header.stamp.sec, header.stamp.nanosec = divmod(stamp, NANO)
        item = message(
            "sensor_msgs/msg/JointState", header=header, name=[names[k] for k in order],
            position=np.append(q, 0.04)[order],
        )  # fmt: skip
        out.append(Recorded(topic, item, stamp + (0 if not stamped else 3_000_000)))
    return out
