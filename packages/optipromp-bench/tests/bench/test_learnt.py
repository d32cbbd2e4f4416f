"""Learnt entries: what they see is a set, and how they are trained."""

import csv
from pathlib import Path

import numpy as np
import pytest
from tests.loaded import script

from benchmarks.entries.learnt import hand_of, proposals, told
from optipromp.core.arrays import FloatArray
from optipromp_bench.env import MOST, WIDTH, objects_in
from optipromp_bench.primitive import COUNT
from optipromp_bench.sets import scene_of

pytest.importorskip("onnxruntime")


def test_objects_are_a_set() -> None:
    scene, _ = scene_of("wild", 110_004)
    objects = objects_in(scene)
    order = np.random.default_rng(0).permutation(MOST)
    first, other, half = (
        told("set.onnx", objects=rows) for rows in (objects, objects[order], 0.5 * objects)
    )
    assert np.allclose(first, other, atol=1e-4)
    assert not np.allclose(first, half)


def test_proposals_differ() -> None:
    scene, _ = scene_of("tight", 110_004)
    weights, score = proposals(scene)
    assert weights.shape == (len(score), 2, COUNT)
    apart = [np.abs(a - b).max() for k, a in enumerate(weights) for b in weights[:k]]
    assert max(apart) > 0.1


def test_a_turned_scene_has_turned_weights() -> None:
    """The batches of training are turned rigidly: lengths and heights stay."""
    rng = np.random.default_rng(1)
    objects = np.zeros((3, MOST, WIDTH), dtype=np.float32)
    objects[:, :4] = rng.normal(size=(3, 4, WIDTH))
    weights = rng.normal(size=(3, 2, COUNT))
    out, turned = script("train_policies").turned(objects, rng, np.swapaxes(weights, 1, 2))
    turned = np.swapaxes(turned, 1, 2)

    def lengths(rows: FloatArray, first: int) -> FloatArray:
        return np.asarray(np.linalg.norm(rows[:, :, first : first + 2], axis=-1))

    for first in (0, 3, 9):
        assert np.allclose(lengths(out, first), lengths(objects, first), atol=1e-5)
        assert np.array_equal(out[:, :, first + 2], objects[:, :, first + 2])
    assert np.allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(weights, axis=1), atol=1e-5)
    across = np.einsum("bki,bij->bkj", objects[:, :4, :2], weights)
    assert np.allclose(across, np.einsum("bki,bij->bkj", out[:, :4, :2], turned), atol=1e-4)


def test_a_network_is_trained_on_plans(tmp_path: Path) -> None:
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    train = script("train_policies")
    train.plans(tmp_path, range(299_000, 299_004), ("cluster", "tight", "field", "wild"))
    assert np.load(tmp_path / "plans-299000.npz")["weights"].shape[1:] == (2, COUNT)
    rng = np.random.default_rng(0)  # the path goes round the first of three fruits
    objects = np.zeros((400, MOST, WIDTH), dtype=np.float32)
    objects[:, :3, :3] = rng.uniform(-0.1, 0.1, (400, 3, 3))
    objects[:, 0, 13] = objects[:, 1:3, 14] = 1.0
    objects[:, 0, :3] = 0.0
    weights = np.repeat(8.0 * objects[:, 1, :2, None], COUNT, axis=2)
    np.savez(tmp_path / "plans-0.npz", objects=objects, weights=weights)
    (tmp_path / "plans-299000.npz").unlink()
    out = tmp_path / "set.onnx"
    train.train_set(tmp_path, out, 0.06)
    with out.with_suffix(".csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert float(rows[-1]["near"]) < 0.7 * float(rows[0]["near"])
    session = runtime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    (told_,) = session.run(None, {"objects": objects})
    assert told_.shape == (400, train.PROPOSALS * (2 * COUNT + 1))


@pytest.mark.parametrize("chunk", [1, 25])
def test_velocities_are_learnt_from_steps(chunk: int, tmp_path: Path) -> None:
    """Episodes of ten steps, in each of which the action is that toward one place."""
    pytest.importorskip("torch")
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    rng = np.random.default_rng(0)
    arm = np.repeat(rng.uniform(-0.2, 0.2, (150, 25)), 10, axis=0).astype(np.float32)
    arm[:, -1] = np.tile(0.02 * np.arange(10), 150)
    objects = np.zeros((1500, MOST, WIDTH), dtype=np.float16)
    objects[:, 0, 13] = 1.0
    action = -4.0 * arm[:, -11:-8]
    for k in range(3):
        part = slice(500 * k, 500 * (k + 1))
        np.savez(tmp_path / f"steps-{k}.npz", arm=arm[part], objects=objects[part],
                 action=action[part])  # fmt: skip
    out = tmp_path / "out.onnx"
    script("train_policies").train_steps(tmp_path, out, 0.3, chunk)
    with out.with_suffix(".csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert float(rows[-1]["loss"]) < 0.8 * float(rows[0]["loss"])
    session = runtime.InferenceSession(str(out), providers=["CPUExecutionProvider"])
    given = {"objects": objects.astype(np.float32), "arm": hand_of(arm).astype(np.float32)}
    (velocities,) = session.run(None, given)
    assert velocities.shape == (1500, 3 * chunk)
