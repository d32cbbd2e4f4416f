"""A second engine, written apart, says what the main simulation says."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.output import write_plan
from optipromp.core.planning import plan
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.io import scene_to_dict
from optipromp_bench.experiments.trials import attempt
from optipromp_bench.running import Exercise, attempted
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

second = pytest.importorskip("optipromp_bench.flight")


def test_it_places_the_tool_where_the_house_does() -> None:
    robot = resolve(generate("cluster", 0)).robot
    rng = np.random.default_rng(0)
    for q in rng.uniform(robot.lower, robot.upper, (20, 7)):
        place, turn = second.flange(q)
        point, axis = robot.tool_pose(q)
        np.testing.assert_allclose(place + robot.tool.reach * turn[:, 2], point, atol=1e-6)
        np.testing.assert_allclose(turn[:, 2], axis, atol=1e-9)


CASES = [("tight", 20000), ("field", 20003)]


@pytest.mark.parametrize(("preset", "seed"), CASES)
def test_both_engines_pick_what_is_planned(preset: str, seed: int, tmp_path: Path) -> None:
    made = plan(generate(preset, seed))  # type: ignore[arg-type]
    assert made.success
    assert simulate(made).success
    write_plan(made, tmp_path)
    rows = np.loadtxt(tmp_path / "trajectory.csv", delimiter=",", skiprows=1)
    document = json.loads((tmp_path / "plan.json").read_text())["scene_file"]
    word = second.Flight(document, rows[0, 1:8]).along(rows[:, 0], rows[:, 1:8])
    assert word.success, word


def test_both_engines_see_what_a_straight_way_harms() -> None:
    scene = generate("cluster", 20001)
    made = attempt(scene, "straight")
    rows = made.trajectory.resample(1000.0)
    flown = second.Flight(scene_to_dict(scene), rows.positions[0])
    word = flown.along(rows.times, rows.positions)
    assert not word.success
    assert not simulate(made.trajectory, scene).success


def test_a_target_that_is_taken_leaves_with_the_cup_and_the_others_stay() -> None:
    made = plan(generate("tight", 20000))
    own = made.trajectory.resample(1000.0)
    flown = second.Flight(scene_to_dict(made.scene), own.positions[0])
    assert flown.along(own.times, own.positions).success
    places = {name: flown.place(name)[0] for name in flown.ids}
    flown.take()
    for name, place in places.items():
        np.testing.assert_allclose(flown.place(name)[0], place, atol=1e-6)
    flown.to(own.positions[-1], 0.005)
    for name in set(flown.ids) - {flown.target}:
        assert np.linalg.norm(flown.place(name)[0] - places[name]) < 1e-3
    back = own.positions[::-1][:2000]  # 2 s of the way it came
    word = flown.along(np.arange(len(back)) * 0.001, back)
    assert word.picked
    assert flown.place(flown.target)[0] @ made.scene.frame[2] < (
        places[flown.target] @ made.scene.frame[2] - 0.05
    )


def test_a_fruit_that_the_floor_draws_along_its_stem_is_harmed() -> None:
    """The floor of a cup that is drawn back along its reach lies on a pushed fruit."""
    task = Exercise("push-aside", "plan", "mixed", 173105, engines=("flight",))
    (row,), _ = attempted(task)
    assert row.result == "harmed"
    assert "pulled by" in row.cause


def test_it_hangs_a_fruit_where_the_scene_shows_it() -> None:
    """With the cup far away nothing moves, and nothing is harmed."""
    scene = generate("cluster", 20000)
    start = resolve(scene).start
    times, q = np.array([0.0, 1.0]), np.array([start, start])
    word = second.Flight(scene_to_dict(scene), start).along(times, q)
    assert (word.picked, word.swallowed, word.harm) == (False, (), ())
    far = replace(scene, robot="gen3")
    with pytest.raises(ValueError, match="Panda"):
        second.Flight(scene_to_dict(far), start)


@pytest.mark.parametrize(("taper", "wide"), [(None, 0.01), (0.0, 0.01), (45.0, 0.02)])
def test_the_cup_has_the_cone_that_the_scene_says(taper: float | None, wide: float) -> None:
    """5 mm under the floor of a cup of 25 mm: as wide as the neck, or a cone."""
    mujoco = pytest.importorskip("mujoco")
    tool = {"radius": 0.025, "height": 0.05, "length": 0.1, "taper": taper}
    model = second.model_of({"objects": [], "tool": tool})
    data, hit = mujoco.MjData(model), np.zeros(1, dtype=np.int32)
    mujoco.mj_forward(model, data)
    for turn in np.linspace(0.0, 6.0, 20):
        out = np.array([np.cos(turn), np.sin(turn), 0.0])
        away = mujoco.mj_ray(model, data, 0.1 * out + [0, 0, 0.095], -out, None, 1, -1, hit)
        assert 0.1 - away == pytest.approx(wide, abs=1e-4)


def test_the_cup_is_as_deep_as_the_scene_says() -> None:
    """Nothing stands on its floor: a long fruit reaches as far down as there is room."""
    mujoco = pytest.importorskip("mujoco")
    tool = {"radius": 0.025, "height": 0.05, "length": 0.1}
    model = second.model_of({"objects": [], "tool": tool})
    data, hit = mujoco.MjData(model), np.zeros(1, dtype=np.int32)
    mujoco.mj_forward(model, data)
    for x, y in ((0.0, 0.0), (0.005, 0.0), (0.0, -0.02)):
        above, down = np.array([x, y, 0.3]), np.array([0.0, 0.0, -1.0])
        away = mujoco.mj_ray(model, data, above, down, None, 1, -1, hit)
        assert 0.3 - away == pytest.approx(0.1 + second.WALL)
