"""Stems that nobody saw: read, written, spread, planned for, judged and drawn."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cli import fixtures

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import Sphere
from optipromp.core.judging.distances import objects_of
from optipromp.core.pushing.stems.bending import sampled
from optipromp.core.scenes import Scene, SceneObject, save_scene, scene_from_dict
from optipromp.core.scenes.io import scene_to_dict
from optipromp.core.scenes.objects import ROOM, UNSEEN_SPREAD, UNSEEN_TILT, Stem, cleared
from optipromp_sim.generate import generate
from optipromp_sim.simulation.world import grown

UP = (0.0, 0.0, 1.0)


def unseen(scene: Scene, *names: str) -> Scene:
    """The scene, the stems of some fruits (none named: of all) not seen."""
    objects = (
        replace(item, stem=Stem.hidden(item.position, scene.up), sigma=0.002)
        if item.stem is not None and (not names or item.id in names)
        else item
        for item in scene.objects
    )
    return replace(scene, objects=cleared(objects, scene.up))


def document(**stem: Any) -> dict[str, Any]:
    fruit = {"id": "ripe", "role": "target", "shape": {"sphere": {"radius": 0.017}},
             "position": [0.45, 0.0, 0.9], "stem": {"unseen": True, **stem}}  # fmt: skip
    return {"name": "s", "robot": "panda", "tool": {"kind": "cup", "radius": 0.025},
            "objects": [fruit]}  # fmt: skip


def test_a_scene_file_says_that_nobody_saw_a_stem() -> None:
    scene = scene_from_dict(document(tilt=12.0, length=0.2))
    (fruit,) = scene.objects
    assert fruit.stem.unseen
    assert fruit.stem.tilt == 12.0
    assert fruit.stem.vector == pytest.approx([0.0, 0.0, 0.2])
    assert scene_to_dict(scene_from_dict(scene_to_dict(scene))) == scene_to_dict(scene)
    assert "ripe nobody saw" in scene.assumed[0]
    assert scene_from_dict(document()).objects[0].stem.tilt == UNSEEN_TILT  # type: ignore[union-attr]
    for wrong, words in (({"root": [0, 0, 1]}, "unseen"), ({"tilt": 80.0}, "0 to 60")):
        with pytest.raises(InvalidSceneError, match=words):
            scene_from_dict(document(**wrong))


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-0.05, 0.05)] * 2, st.floats(0.04, 0.12)), max_size=4))
def test_an_assumed_stem_clears_other_fruits_where_it_can(places: list[tuple[float, ...]]) -> None:
    """By dense points; a stem that cannot clear all has no less room than the upright one."""
    ball = Sphere(0.015)
    stem = Stem.hidden(np.zeros(3), np.array(UP))
    items = [SceneObject("a", "target", ball, np.zeros(3), stem=stem)]
    items += [SceneObject(f"n{k}", "pushable", ball, np.array(p)) for k, p in enumerate(places)]

    def room(line: Stem) -> float:
        points = np.linspace(0.0, 1.0, 40)[:, None] * line.vector
        gaps = [np.linalg.norm(points - np.array(p), axis=1).min() for p in places]
        return min(gaps, default=math.inf) - 0.015 - line.radius

    made = cleared(items, np.array(UP))[0].stem
    assert made.length == pytest.approx(stem.length)
    if room(stem) > ROOM + 1e-9:
        assert (made.points == stem.points).all()
    assert room(made) > min(room(stem), ROOM) - 1e-9


def test_the_states_of_the_push_model_have_the_spread_that_is_told() -> None:
    scene = unseen(generate("limp", 3))
    fruits = tuple(item for item in scene.objects if item.stem is not None)
    states, count = sampled(fruits, 1, 600, UP), len(fruits)
    ways = states.root.reshape(-1, count, 3)[1:, 0]
    first = fruits[0].stem
    aside = ways[:, :2] - ways[:, :2].mean(axis=0)
    wanted = math.radians(UNSEEN_TILT) * first.length
    assert aside.std() == pytest.approx(wanted, rel=0.2)
    assert ways[:, 2].std() > 0.5 * UNSEEN_SPREAD * first.length


def test_the_judge_keeps_the_arm_off_all_likely_stems() -> None:
    stem = Stem.hidden(np.array([0.4, 0.0, 0.8]), np.array(UP), 0.2, 30.0)
    ways = [one.vector / one.length for one in stem.likely()]
    assert len(ways) == 5
    assert [math.degrees(math.acos(way[2])) for way in ways] == pytest.approx([0] + [30] * 4)

    fruit = SceneObject("a", "target", Sphere(0.015), stem.points[0], stem=stem)
    scene = replace(generate("limp", 3), objects=(fruit,))
    objects, _ = objects_of(scene)
    assert sorted(objects.rows) == [0, *[1] * 5]  # the fruit, and pieces of stems


def test_a_plan_says_what_it_assumed_and_is_simulated(tmp_path: Path) -> None:
    true = generate("cluster", 61_503)
    seen = unseen(true, true.pushables[0].id)
    save_scene(true, tmp_path / "true.yaml")
    save_scene(seen, tmp_path / "seen.yaml")
    out = str(tmp_path / "reach")
    told = fixtures.told("plan", tmp_path / "seen.yaml", "--reach", "--no-figures", "--out", out)
    assert "nobody saw" in told["assumed"][0]
    assert "nobody saw" in told["message"]
    for given_scene in ([], ["--in", str(tmp_path / "true.yaml")]):
        assert fixtures.told("simulate", out, *given_scene)["picked"] is True


def test_the_simulation_draws_an_unseen_stem_by_its_seed() -> None:
    scene = unseen(generate("limp", 3))
    one, again, other = grown(scene, 1), grown(scene, 1), grown(scene, 2)
    for a, b, c in zip(one.objects, again.objects, other.objects, strict=True):
        if a.stem is None:
            continue
        assert (a.stem.points == b.stem.points).all()
        assert (a.stem.points != c.stem.points).any()
    assert not one.assumed
    assert grown(one, 1) is one
