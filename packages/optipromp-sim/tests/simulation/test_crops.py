"""The laws of harm of a crop, each against its formula."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.geometry.shapes import Box, Sphere
from optipromp.core.scenes.crops import load_crop
from optipromp.core.scenes.scene import SceneObject
from optipromp_sim.generate import PRESETS
from optipromp_sim.generate import crop_of as crop_of_preset
from optipromp_sim.simulation import Cause, Simulation, SimulationParameters, simulate
from optipromp_sim.simulation.outcome import judge
from optipromp_sim.simulation.parameters import bearing

RADIUS = 0.015
MASS = 950.0 * 4.0 / 3.0 * np.pi * RADIUS**3
CROP = load_crop("strawberry")
PLATE = SceneObject("plate", "static", Box((0.2, 0.2, 0.02)), np.array([0.3, 0.0, 0.4]))


def crop_of(**values):
    crop = CROP
    for name, value in values.items():
        crop = crop.changed(name, value)
    return crop


def loose(height):
    """A fruit above the plate by ``height`` [m]."""
    place = [0.3, 0.0, 0.41 + RADIUS + height]
    return SceneObject("loose", "pushable", Sphere(RADIUS), place, physical={"mass": MASS})


def simulation(bench, *objects, crop=CROP, **parameters):
    scene = replace(bench.scene(*objects), crop=crop)
    return Simulation(scene, parameters=bench.parameters(**parameters), q=[0.5, 0.5, -0.5])


def verdict(made):
    return judge(made.world, made.rollout(), made._run.records.log)


@pytest.mark.parametrize("height", [0.1, 0.4])
def test_a_fall_is_a_blow_of_its_energy(bench, height):
    """Within 6 %: the work of the weight while the flesh gives way is in it."""
    made = simulation(bench, bench.fruit("ripe", (0.0, 0.0, 0.5)), PLATE, loose(height))
    while made.time < 0.6:
        made.step(made.reference)
    outcome = verdict(made)
    energy = outcome.crop.figures["loose"]["impact_energy"]
    assert energy == pytest.approx(MASS * 9.81 * height, rel=0.06)
    assert (Cause.CRUSHED in outcome.causes) is (MASS * 9.81 * height > 0.040)
    if height > 0.35:
        assert outcome.crop.decided == ("impact_energy",)
        assert outcome.crop.guesses == ()
        assert "loose by a blow of 0.05" in outcome.message


def test_a_force_bruises_by_how_long_it_lasts(bench):
    """y(t) = F (1 - exp(-t / T)), within 3 %."""
    made = simulation(bench, bench.fruit("ripe", (0.0, 0.0, 0.5)), PLATE, loose(0.0))
    body = made.world.shown[1].body
    made.data.xfrc_applied[body, 2] = -(8.0 - MASS * 9.81)
    for seconds, harmed in ((0.2, False), (0.8, True)):
        while made.time < seconds:
            made.step(made.reference)
        outcome = verdict(made)
        lasting = outcome.crop.figures["loose"]["pressed_force"]
        assert lasting == pytest.approx(8.0 * (1.0 - np.exp(-seconds / 0.5)), rel=0.03)
        assert ("pressed_force" in outcome.crop.decided) is harmed
        assert (made.harm().fruit > 1.0) is harmed
        assert "pressed_force" in outcome.crop.hangs_on  # a guess of 2.5 to 10 N


def pulled(bench, direction, crop):
    """The force in a ``direction`` (3,) at which a fruit comes off a stiff stem [N]."""
    made = simulation(
        bench, bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.06, stem_stiffness=5.0), crop=crop,
        engine={"gravity": 0.0}, stem={"bow_least": 0.0, "bow_most": 0.0},
    )  # fmt: skip
    body = made.world.shown[0].body
    while made.fruits().attached[0]:
        made.data.xfrc_applied[body, :3] = 10.0 * made.time * np.array(direction)
        made.step(made.reference)
        assert made.time < 2.0
    return 10.0 * made.time, verdict(made)


@pytest.mark.parametrize(("angle", "force"), [(0.0, 5.0), (45.0, 3.75), (75.0, 3.25), (90.0, 3.0)])
def test_a_fruit_comes_off_by_the_direction_of_the_pull(bench, angle, force):
    turn = np.deg2rad(angle)
    found, outcome = pulled(
        bench, (np.sin(turn), 0.0, -np.cos(turn)), crop_of(abscission_moment=1.0)
    )
    assert found == pytest.approx(force, rel=0.03)
    assert outcome.causes[0] is Cause.TORN
    assert outcome.crop.decided == ("abscission",)
    assert f"at {angle:.0f} degrees" in outcome.message or angle == 75.0


def test_a_fruit_comes_off_by_bending(bench):
    """A force across, at the fruit's centre, bends the calyx by force times radius."""
    found, outcome = pulled(bench, (1.0, 0.0, 0.0), crop_of(abscission_moment=0.02))
    assert found == pytest.approx(0.02 / RADIUS, rel=0.04)
    assert outcome.crop.decided == ("abscission_moment",)
    assert "bent with 0.02 N m" in outcome.message


@pytest.mark.parametrize(
    ("begin", "end", "edge"),
    [((0.041, 0.0, 0.3), (0.041, 0.0, 0.469), True), ((0.0, 0.0, 0.5), (0.03, 0.0, 0.5), False)],
)
def test_the_rim_of_a_cup_is_an_edge_and_its_wall_is_none(bench, begin, end, edge):
    """The rim presses from below; the wall from within, 20 mm below the rim."""
    fruit = bench.fruit("ripe", (0.0, 0.0, 0.5), length=0.06, stem_stiffness=0.1)
    scene = replace(bench.scene(fruit, radius=0.04), crop=crop_of(edge_force=0.5))
    outcome = simulate(bench.line(begin, end), scene).outcome
    figure = outcome.crop.figures["ripe"]["edge_force"]
    assert outcome.peak_force["ripe"] > 0.5
    assert figure == pytest.approx(outcome.peak_force["ripe"] if edge else 0.0, rel=0.1)
    assert ("edge_force" in outcome.crop.decided) is edge


@pytest.mark.parametrize("ratio", [0.05, 0.14])
@pytest.mark.parametrize("length", [0.08, 0.25])
def test_a_fruit_swings_with_the_damping_of_its_crop(bench, ratio, length):
    """Amplitudes fall by exp(-2 π ζ / sqrt(1 - ζ²)) a period, within 2 % of ζ."""
    made = simulation(
        bench, bench.fruit("ripe", (0.0, 0.0, 0.5), length=length),
        crop=crop_of(damping_ratio=ratio), stem={"bow_least": 0.0, "bow_most": 0.0},
    )  # fmt: skip
    made.data.qvel[made.world.shown[0].spin] = 0.05
    places = []
    while made.time < 3.0:
        made.step(made.reference)
        places.append(made.fruits().positions[0, 0])
    x = np.array(places)
    tops = [k for k in range(1, len(x) - 1) if x[k - 1] < x[k] >= x[k + 1] and x[k] > 1e-6]
    fall = np.log(x[tops[0]] / x[tops[2]]) / 2.0
    assert fall / np.hypot(2.0 * np.pi, fall) == pytest.approx(ratio, rel=0.02)


def test_a_stem_is_caught_by_its_crops_grip_and_a_scene_without_a_crop_is_as_before(bench):
    crop = crop_of(abscission_moment=10.0)
    fruit = bench.fruit(
        "ripe", (0.0, 0.0, 0.5), length=0.06, abscission_force=100.0, stem_stiffness=0.01
    )
    scene = bench.scene(fruit)
    way = bench.line((0.10, 0.0, 0.52), (0.025, 0.0, 0.52), 1.0)
    without = simulate(way, scene).outcome
    held = simulate(way, replace(scene, crop=crop)).outcome
    assert without.crop is None
    assert "crop" not in without.to_dict()
    assert 2.0 < held.stem_force["ripe"] < 10.0
    assert without.stem_caught == ("ripe",)
    assert held.stem_caught == ()
    assert held.to_dict()["crop"]["figures"]["ripe"]["grip_force"] == held.stem_force["ripe"]
    assert held.stem_pressed == ()  # 0.3.0 judged a stated crop by its rows, too
    told = bearing(SimulationParameters(), crop_of_preset("cluster"))
    named = simulate(way, scene, parameters=told).outcome
    assert (named.stem_caught, named.stem_pressed) == ((), ("ripe",))
    assert not named.to_dict()["success_before"]
    assert replace(named, success=True, stem_pressed=()).success_before
    assert (without.stem_pressed, named.stem_force) == (("ripe",), without.stem_force)


def test_presets_name_their_crop_and_a_guess_is_no_limit():
    named = {preset: crop_of_preset(preset) for preset in (*PRESETS, "mine.yaml")}
    without = {preset for preset, crop in named.items() if crop is None}
    assert without == {"shelf", "standing", "vine", "trusses", "mine.yaml"}
    usual, crop = SimulationParameters(), named["field"]
    told = bearing(usual, crop)
    assert (told.thresholds.stem_force, usual.thresholds.stem_force) == (10.0, 2.0)
    assert replace(told, thresholds=usual.thresholds) == usual  # physics stays
    guessed = replace(crop.rows["grip_force"], guess=True)
    for other in (None, replace(crop, rows={**crop.rows, "grip_force": guessed})):
        assert bearing(usual, other) is usual
    mine = replace(usual, thresholds=replace(usual.thresholds, stem_force=3.0))
    assert bearing(mine, crop) is mine
