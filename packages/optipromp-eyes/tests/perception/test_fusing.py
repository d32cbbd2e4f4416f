"""Several pictures of one scene as one."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import told
from tests.perception.shots import SEED, written

from optipromp import load_scene
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.io import save_scene
from optipromp_bench.experiments.eyes import middle
from optipromp_eyes import Sighting, fused, look_at, seen_scene
from optipromp_eyes.finder import Region
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import Photograph, photograph


@pytest.fixture(scope="module")
def shots() -> list[Photograph]:
    scene = generate("cluster", 70210)
    return [photograph(scene, seed=seed) for seed in (70210, 70211, 70213)]


@pytest.fixture(scope="module")
def sights(shots: list[Photograph]) -> list[Sighting]:
    return [look_at(shot.picture, up=shot.scene.up) for shot in shots]


def test_one_picture_stays_as_it_is(sights: list[Sighting]) -> None:
    items = sights[0].look.in_base()
    one = fused(sights[:1])
    assert [fruit.views for fruit in one] == [1] * len(items)
    for fruit, item in zip(one, items, strict=True):
        assert fruit.item.id == item.id
        assert np.allclose(fruit.item.position, item.position, atol=1e-12)
        assert np.allclose(fruit.item.covariance, item.covariance, atol=1e-12)
        assert fruit.item.radius == pytest.approx(item.radius)


def test_three_pictures_know_more_than_one(shots: list[Photograph], sights: list[Sighting]) -> None:
    many = fused(sights)
    alone = sights[0].look.in_base()
    assert max(len(sight.detections) for sight in sights) <= len(many) <= len(alone) + 1
    thrice = [fruit for fruit in many if fruit.views == 3]
    assert len(thrice) >= len(alone) - 1  # which pixels are lit depends on the renderer's processor
    for fruit in thrice:
        true = min(
            (middle(item) for item in shots[0].fruits.values()),
            key=lambda place: float(np.linalg.norm(place - fruit.item.position)),
        )
        off = fruit.item.position - true
        before = min(alone, key=lambda item: float(np.linalg.norm(item.position - true)))
        assert fruit.item.covariance is not None
        assert before.covariance is not None
        assert np.trace(fruit.item.covariance) < 0.6 * np.trace(before.covariance)
        assert off @ np.linalg.solve(fruit.item.covariance, off) < 16.3  # 0.1 % are beyond


def test_what_one_picture_misses_another_adds(
    shots: list[Photograph], sights: list[Sighting]
) -> None:
    less = replace(
        sights[0],
        look=replace(sights[0].look, detections=sights[0].look.detections[1:]),
        detections=sights[0].detections[1:],
    )
    many = fused([less, sights[1]])
    assert len(many) == len(sights[1].detections)
    assert sorted(fruit.views for fruit in many)[0] == 1
    scene, _ = seen_scene([less, sights[1]], shots[0].scene)
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    assert len(fruits) == len(many)
    assert all(item.stem is not None for item in fruits)


def test_a_fruit_that_is_elsewhere_is_another(sights: list[Sighting]) -> None:
    look = sights[0].look
    apart = replace(look.camera, position=look.camera.position + [0.0, 0.0, 0.05])
    moved = replace(sights[0], look=replace(look, camera=apart))
    assert len(fused([sights[0], moved])) == 2 * len(look.detections)


def doubted(sight: Sighting, ripe: float) -> Sighting:
    """The sight by a finder that is so sure of what is ripe."""
    out = []
    for each in sight.detections:
        region = each.region
        if region.kind == "ripe":
            part = region.part, region.score, region.box, region.shape
            region = Region("ripe", *part, ripe=ripe)
        out.append(replace(each, region=region))
    return replace(sight, detections=tuple(out))


def test_a_second_picture_may_make_sure_that_a_fruit_is_ripe() -> None:
    """Odds of 7 to 3 and of 9 to 1 are 21 to 1 together; 9 to 1 alone is told."""
    known = generate("cluster", SEED)
    shots = [photograph(known, seed=seed) for seed in (SEED, SEED + 1)]
    first, second = (look_at(shot.picture, up=known.up) for shot in shots)
    with pytest.raises(InvalidRequestError, match=r"probability of 0\.70, below 0\.8; take an"):
        seen_scene(doubted(first, 0.7), known)
    _, words = seen_scene(doubted(first, 0.9), known)
    assert any("is ripe with a probability of 0.90" in each for each in words)
    both = [doubted(first, 0.7), doubted(second, 0.9)]
    (ripe,) = (fruit.ripe for fruit in fused(both) if fruit.item.role == "target")
    assert ripe == pytest.approx(21.0 / 22.0)
    scene, words = seen_scene(both, known)
    assert scene.target is not None
    assert not any("probability" in each for each in words)


def test_no_picture_is_refused() -> None:
    with pytest.raises(InvalidRequestError, match="at least one"):
        fused([])


def test_see_writes_one_scene_of_a_folder(shots: list[Photograph], tmp_path: Path) -> None:
    written(tmp_path, a=shots[0].picture, b=shots[1].picture)
    save_scene(shots[0].scene, tmp_path / "a.yaml")
    record = told("see", tmp_path, "--together")["together"]
    views = [fruit["views"] for fruit in record["fruits"]]
    assert set(views) <= {1, 2}
    assert views.count(2) >= len(views) - 1
    scene = load_scene(record["scene"])
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    assert len(fruits) == len(record["fruits"])
