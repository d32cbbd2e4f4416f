"""Learnt entries: networks that give weights of a primitive, or velocities, from what is seen.

``scripts/train_policies.py`` trains them; docs/learners.md has data, hours and curves.
"""

from functools import cache
from importlib.resources import files
from typing import Any, ClassVar

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.planning import plan
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp_bench.entries.planners import gentle_plan
from optipromp_bench.env import SPEED, objects_in, state_of
from optipromp_bench.episode import Observation, joints_for
from optipromp_bench.primitive import COUNT, OfWeights

NEARER, WEAKER = 10.0, 0.1  # factors on the tool's place [m] and on forces [N]: choices
STRONGEST = 3.0  # of a force after its factor: a choice
WIDEST = 1.5  # of a weight: as in training


@cache
def session(name: str) -> Any:
    """The network of a file of this package, on one core."""
    try:
        import onnxruntime  # type: ignore[import-untyped]
    except ImportError:
        raise InvalidRequestError(
            f"learnt entries need onnxruntime: {installed_by('vision')}"
        ) from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    content = files("benchmarks.entries").joinpath("data", name).read_bytes()
    return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])


def told(name: str, **arrays: FloatArray) -> FloatArray:
    """What a network tells of one example."""
    given = {key: np.asarray(value, dtype=np.float32)[None] for key, value in arrays.items()}
    return np.asarray(session(name).run(None, given)[0][0], dtype=np.float64)


def hand_of(arm: FloatArray) -> FloatArray:
    """What a clone knows of its arm: the hand's place, axis and force (..., 9), all about equal.

    Args:
        arm: (..., 2n + 11) of :func:`optipromp_bench.env.state_of`; joints and times are left
            out, so what is learnt holds in all directions about the approach.
    """
    hand = np.array(arm[..., -11:-2], dtype=np.float64)
    hand[..., :3] *= NEARER
    hand[..., 6:] = np.clip(WEAKER * hand[..., 6:], -STRONGEST, STRONGEST)
    return hand


def proposals(scene: Scene) -> tuple[FloatArray, FloatArray]:
    """Proposed weights (k, 2, COUNT), and a score (k,) of each."""
    rows = told("set.onnx", objects=objects_in(scene)).reshape(-1, 2 * COUNT + 1)
    return np.clip(rows[:, :-1], -WIDEST, WIDEST).reshape(-1, 2, COUNT), rows[:, -1]


class SetNetwork:
    """The path that a network thinks the likeliest, trained on our plans; nothing is searched."""

    def plan(self, scene: Scene, seed: int) -> Trajectory | None:
        """See :class:`optipromp_bench.tracks.Planning`."""
        weights, score = proposals(scene)
        best = weights[int(score.argmax())]
        return gentle_plan(plan(scene, planner=OfWeights(weights=best), seed=seed), scene)


class Cloned:
    """The tool's velocity from what is seen now, cloned from our plans' steps.

    A network that tells the velocities of a chunk of periods is asked anew in each. What was told
    of one period is averaged, as ACT does (Zhao et al. 2023; its weights are nearly equal).
    """

    weights: ClassVar[str] = "clone.onnx"

    def reset(self, scene: Scene, seed: int) -> None:
        """See :class:`optipromp_bench.tracks.Acting`."""
        self.scene = scene
        self.robot: Robot = posed(scene)[0]
        self.chunks: list[FloatArray] = []  # the newest first

    def act(self, seen: Observation) -> FloatArray:
        """See :class:`optipromp_bench.tracks.Acting`."""
        state = state_of(seen, self.scene)
        chunk = told(self.weights, objects=state["objects"], arm=hand_of(state["arm"]))
        self.chunks = [chunk.reshape(-1, 3), *self.chunks][: chunk.size // 3]
        now = np.mean([rows[age] for age, rows in enumerate(self.chunks)], axis=0)
        frame = self.scene.frame
        velocity = SPEED * np.clip(now, -1.0, 1.0) @ frame
        return joints_for(self.robot, seen.q, velocity, frame[2])


class Act(Cloned):
    """Chunks of the tool's velocities by a transformer, cloned from our plans' steps."""

    weights: ClassVar[str] = "act.onnx"
