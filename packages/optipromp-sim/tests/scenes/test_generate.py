"""Generated scenes: the same again by their seed, within what each preset says, solvable."""

import itertools
import zlib
from dataclasses import replace

import numpy as np
import pytest
from tests.scenes.sampled import made

from optipromp.core import judging
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import Box, Capsule, Ellipsoid, Sphere, distances
from optipromp.core.planning.task import resolve
from optipromp.core.robots import ik
from optipromp.core.robots.ik import rolled
from optipromp.core.scenes import Scene, load_scene, save_scene, scene_to_dict
from optipromp.core.scenes.scene import obstacles_of
from optipromp_sim.generate import PRESETS, generate, generator
from optipromp_sim.generate.checks import unsolvable
from optipromp_sim.generate.shelves import Footprint, apart

SEEDS = range(12)
BUNCHES = [
    preset
    for preset in PRESETS
    if preset not in ("shelf", "elongated", "truss", "field", "wild", "standing", "vine", "trusses")
]
BEFORE = [preset for preset in BUNCHES if preset != "tight"]


@pytest.fixture(scope="module")
def scenes() -> dict[tuple[str, int], Scene]:
    return {(preset, seed): made(preset, seed)[0] for preset in PRESETS for seed in SEEDS}


def of(scenes: dict[tuple[str, int], Scene], *presets: str) -> list[Scene]:
    return [scene for (preset, _), scene in scenes.items() if preset in presets]


@pytest.mark.parametrize("preset", PRESETS)
def test_a_seed_gives_the_same_scene_again(preset: str) -> None:
    assert scene_to_dict(generate(preset, 3)) == scene_to_dict(made(preset, 3)[0])
    assert scene_to_dict(made(preset, 3)[0]) != scene_to_dict(made(preset, 4)[0])


def test_a_preset_that_is_not_there_is_refused_by_name() -> None:
    with pytest.raises(InvalidRequestError, match="did you mean 'cluster'"):
        generate("clusters", 0)  # type: ignore[arg-type]
    with pytest.raises(InvalidRequestError, match="negative"):
        generate("cluster", -1)


def test_crowded_scenes_are_as_frequent_as_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """The number of pushables is kept, however often the rest is sampled again."""
    monkeypatch.setattr(generator, "PATIENCE", 3)
    for preset, low, most in (("mixed", 1, 4), ("tight", 2, 4), ("shelf", 2, 6)):
        for seed in range(4):
            rng = np.random.default_rng([zlib.crc32(preset.encode()), seed])
            drawn = int(rng.integers(low, most + 1))
            assert len(generate(preset, seed).pushables) == drawn


@pytest.mark.parametrize("preset", PRESETS)
def test_a_scene_outlives_its_file(preset: str, tmp_path) -> None:
    scene, _ = made(preset, 1)
    save_scene(scene, tmp_path / "scene.yaml")
    again = load_scene(tmp_path / "scene.yaml")
    before, after = scene_to_dict(scene), scene_to_dict(again)
    turned = [item.pop("orientation", None) for item in before["objects"]]
    turned_again = [item.pop("orientation", None) for item in after["objects"]]
    assert before == after
    for one, other in zip(turned, turned_again, strict=True):
        np.testing.assert_allclose(one or [1, 0, 0, 0], other or [1, 0, 0, 0], atol=1e-12)


def test_numbers_stay_within_what_the_preset_says(scenes) -> None:
    for scene in of(scenes, *BEFORE):
        gripper = scene.tool.parameters["radius"]
        assert 0.02 <= gripper <= 0.03
        assert 1 <= len(scene.pushables) <= 4
        assert scene.target.radius <= gripper - 0.004
        for fruit in (scene.target, *scene.pushables):
            assert 0.015 <= fruit.radius <= 0.020
            way = fruit.stem.vector / np.linalg.norm(fruit.stem.vector)
            assert way[2] >= np.cos(np.deg2rad(25.0)) - 1e-12
        for fruit in scene.pushables:
            off = fruit.position - scene.target.position
            assert 0.03 <= -off[2] <= 0.15
            assert np.abs(off[:2]).max() <= gripper
            assert 0.10 <= fruit.stem.length <= 0.30


def test_tight_fruits_are_close_and_level(scenes) -> None:
    for scene in of(scenes, "tight"):
        fruits = [scene.target, *scene.pushables]
        assert 2 <= len(scene.pushables) <= 4
        for k, fruit in enumerate(scene.pushables, start=1):
            gaps = [
                np.linalg.norm(fruit.position - other.position) - fruit.radius - other.radius
                for other in fruits[:k]
            ]
            assert -1e-12 <= min(gaps) <= 0.012 + 1e-12
            assert abs(fruit.position[2] - scene.target.position[2]) <= 0.012 + 1e-12


def test_limp_stems_hang_plumb(scenes) -> None:
    for scene in of(scenes, "limp"):
        for fruit in (scene.target, *scene.pushables):
            way = fruit.stem.vector / np.linalg.norm(fruit.stem.vector)
            assert way[2] >= np.cos(np.deg2rad(2.0)) - 1e-12


def test_beds_and_vines_are_of_the_crops_they_name(scenes) -> None:
    beds = of(scenes, "standing")
    assert {scene.tool.kind for scene in beds} == {"suction", "finger_gripper"}
    assert all(item.stem.vector[2] < 0.0 for scene in beds for item in scene.pushables)
    vines = of(scenes, "vine")
    assert {type(scene.target.shape) for scene in vines} == {Capsule, Ellipsoid}
    assert all(abs(scene.frame[2] @ scene.up) < 1e-9 for scene in vines)
    assert {len(scene.taken) for scene in of(scenes, "trusses")} == {3, 4, 5}


def test_long_fruits_lie_along_their_stems_and_apart(scenes) -> None:
    for scene in of(scenes, "elongated"):
        fruits = [scene.target, *scene.pushables]
        for fruit in fruits:
            wide, long = 2 * fruit.shape.radius, fruit.shape.length + 2 * fruit.shape.radius
            assert 1.2 <= long / wide <= 1.4
            way = fruit.stem.vector / np.linalg.norm(fruit.stem.vector)
            np.testing.assert_allclose(fruit.rotation[:, 2], way, atol=1e-9)
            np.testing.assert_allclose(
                fruit.stem.points[0], fruit.position + 0.5 * long * way, atol=1e-9
            )
        share = np.linspace(-0.5, 0.5, 60)[:, None]
        for one, other in itertools.combinations(fruits, 2):
            cores = [
                fruit.position + share * fruit.shape.length * fruit.rotation[:, 2]
                for fruit in (one, other)
            ]
            least = np.linalg.norm(cores[0][:, None] - cores[1][None], axis=2).min()
            assert least >= one.shape.radius + other.shape.radius


def test_every_count_and_every_side_come_up() -> None:
    for preset, wanted in (("cluster", {1, 2, 3, 4}), ("shelf", {2, 3, 4, 5, 6})):
        crowds: set[int] = set()
        for seed in range(60):
            crowds.add(len(made(preset, seed)[0].pushables))
            if seed >= len(SEEDS) and crowds == wanted:
                break
        assert crowds == wanted
    sides: set[str] = set()
    for seed in range(40):
        scene, _ = made("table-top", seed)
        (gutter,) = scene.static
        off = gutter.position - scene.target.position
        beyond = np.abs(off) > 0.5 * np.array(gutter.shape.size)
        level = np.flatnonzero(beyond[:2])
        sides.add(
            "above" if not len(level) else ("+" if off[level[0]] > 0 else "-") + "xy"[level[0]]
        )
        assert not (beyond[2] and off[2] < 0)  # never on the side of the approach
        if seed >= len(SEEDS) and len(sides) == 5:
            break
    assert sides == {"+x", "-x", "+y", "-y", "above"}


def test_the_gutter_is_as_near_as_drawn(scenes) -> None:
    for scene in of(scenes, "table-top", "mixed"):
        away, _ = distances(obstacles_of(scene, "static"), scene.target.position[None])
        assert 0.03 - 1e-9 <= away.min() <= 0.08 + 1e-9


def test_neighbours_stand_on_both_sides(scenes) -> None:
    for scene in of(scenes, "side-clusters", "mixed"):
        aside = sorted(obj.position[1] - scene.target.position[1] for obj in scene.avoid)
        assert len(aside) == 2
        assert 0.12 <= -aside[0] <= 0.25
        assert 0.12 <= aside[1] <= 0.25


def test_nothing_hangs_inside_anything_else(scenes) -> None:
    """By brute force: points on every stem and fruit against everything else."""
    for scene in of(scenes, *BUNCHES):
        fruits = [scene.target, *scene.pushables]
        solid = [obj for obj in scene.objects if obj.role in ("static", "avoid")]
        for one, other in itertools.combinations(fruits, 2):
            assert np.linalg.norm(one.position - other.position) >= one.radius + other.radius
        lines = {
            fruit.id: fruit.position + np.linspace(0, 1, 200)[:, None] * fruit.stem.vector
            for fruit in fruits
        }
        for fruit in fruits:
            for other in fruits:
                if other is fruit:
                    continue
                gap = np.linalg.norm(lines[fruit.id] - other.position, axis=1).min()
                assert gap >= other.radius + fruit.stem.radius
                pairs = lines[fruit.id][:, None] - lines[other.id][None]
                assert np.linalg.norm(pairs, axis=2).min() >= 2 * fruit.stem.radius - 1e-9
            for obj in solid:
                local = (np.vstack([lines[fruit.id], fruit.position]) - obj.position) @ obj.rotation
                if isinstance(obj.shape, Sphere):
                    away = np.linalg.norm(local, axis=1) - obj.shape.radius
                else:
                    over = np.abs(local) - 0.5 * np.array(obj.shape.size)
                    away = np.linalg.norm(np.maximum(over, 0), axis=1) + np.minimum(
                        over.max(axis=1), 0
                    )
                assert away[:-1].min() >= fruit.stem.radius - 1e-4
                assert away[-1] >= fruit.radius


def test_packs_stand_apart_on_their_board_before_the_target(scenes) -> None:
    for scene in of(scenes, "shelf"):
        board = next(obj for obj in scene.static if obj.id == "board")
        top = board.position[2] + 0.5 * board.shape.size[2]
        outlines = []
        for obj in (scene.target, *scene.pushables):
            height = obj.shape.size[2] if isinstance(obj.shape, Box) else obj.shape.length
            assert obj.position[2] - 0.5 * height == pytest.approx(top)
            if isinstance(obj.shape, Box):
                edge = np.linspace(-1, 1, 41)
                rim = np.array([p for p in itertools.product(edge, edge) if max(map(abs, p)) == 1])
                flat = (rim * 0.5 * np.array(obj.shape.size[:2])) @ obj.rotation[:2, :2].T
            else:
                turn = np.linspace(0, 2 * np.pi, 120)
                flat = obj.shape.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
            outlines.append(obj.position[:2] + flat)
            for wall in scene.static:
                away, _ = distances(obstacles_of(scene, "static"), obj.position[None])
                assert away.min() > 0, wall.id
        for one, other in itertools.combinations(outlines, 2):
            assert np.linalg.norm(one[:, None] - other[None], axis=2).min() > 0.0
        for outline in outlines[1:]:
            assert outline[:, 0].max() < scene.target.position[0]
            assert outline[:, 0].min() > board.position[0] - 0.5 * board.shape.size[0]


@pytest.mark.parametrize("preset", PRESETS)
def test_the_start_is_free_by_the_judge(preset: str, scenes) -> None:
    for scene in of(scenes, preset):
        setup = resolve(scene)
        _, touching = judging.clearances(scene, setup.robot, setup.start[None])
        assert not touching


def test_the_generator_and_the_judge_agree_on_what_is_solvable(scenes) -> None:
    for scene in of(scenes, "table-top", "shelf")[::3]:
        setup = resolve(scene)
        goals = ik.solve(
            setup.robot, scene.target.position, scene.frame[2], starts=200, distinct=0.05
        ).joints
        free = 0
        others = tuple(t for t in scene.objects if t.role in ("target", "static"))
        alone = replace(scene, objects=others)
        for goal in rolled(setup.robot, goals):
            free += not judging.clearances(alone, setup.robot, goal[None])[1]
        assert free > 0


def test_scenes_that_no_arm_could_solve_are_recognised() -> None:
    scene, _ = made("table-top", 0)
    target, gutter = scene.target, scene.static[0]
    rest = tuple(obj for obj in scene.objects if obj.role == "pushable")
    assert unsolvable(scene) is None
    inside = replace(gutter, position=target.position)
    assert unsolvable(replace(scene, objects=(target, *rest, inside))) is not None
    near = replace(
        gutter, position=target.position + [0.0, 0.0, -0.5 * gutter.shape.size[2] - 0.02]
    )
    assert unsolvable(replace(scene, objects=(target, *rest, near))) == "goal always in collision"
    far = replace(target, position=np.array([2.0, 0.0, 0.5]), stem=None)
    assert unsolvable(replace(scene, objects=(far, *rest))) == "target out of reach"


def test_footprints_apart() -> None:
    disc = Footprint(np.zeros(2), 0.03)
    half = np.array([0.02, 0.03])
    box = Footprint(np.array([0.06, 0.0]), float(np.linalg.norm(half)), half)
    assert apart(disc, box)
    assert apart(box, disc)
    turned = Footprint(box.center, box.radius, half, np.pi / 2)
    assert not apart(disc, turned)
    assert apart(box, Footprint(np.array([0.06, 0.062]), box.radius, half))
    assert not apart(box, Footprint(np.array([0.06, 0.058]), box.radius, half))
