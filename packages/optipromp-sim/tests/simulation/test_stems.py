"""Fruits hang still where a scene shows them, and swing as beams do, on stems of any stiffness."""

import itertools
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from tests.simulation.one_stem import loaded, tracked

from optipromp.core.arrays import frame_along
from optipromp.core.geometry.shapes import Capsule, Cone, Sphere
from optipromp.core.planning.task import posed, resolve
from optipromp.core.scenes.scene import SceneObject, Stem
from optipromp.core.trajectory import Trajectory
from optipromp_loop.control.parameters import CONTROL
from optipromp_sim.generate import PRESETS, generate
from optipromp_sim.simulation import SimulationParameters
from optipromp_sim.simulation.steps import Execution
from optipromp_sim.simulation.world import build

BERRY = Cone(0.019, 0.0098, 0.0378)
LONG = Capsule(0.019, 0.03)
RADIUS = 0.01  # [m] of a ball
STEP = 1e-3  # [s] of the simulation
REACH = {BERRY: 0.0379, LONG: 0.034}  # [m] of the shapes from their middle up to the calyx


def moved(scene, seed, seconds, **groups):
    """Largest displacement of each fruit on a stem while the arm stands still [m], by id."""
    world = build(scene, resolve(scene).robot, SimulationParameters(**groups), seed)
    q = np.tile(posed(scene, None)[1].q, (2, 1))
    stay = Trajectory.through(q, seconds - 0.5, world.robot.joint_names)
    run = Execution(world, stay, 50.0)
    rollout = run.run()
    assert not rollout.warnings
    assert not rollout.torn_at
    assert rollout.times[-1] == pytest.approx(seconds, abs=0.01)
    away = np.linalg.norm(rollout.fruit_positions - rollout.fruit_positions[0], axis=2).max(axis=0)
    hang = [fruit.built.has_stem for fruit in world.shown]
    return {k: d for k, d, stem in zip(rollout.fruit_ids, away, hang, strict=True) if stem}


def hung(name, shape, lean, length, at, stiffness):
    """A fruit at ``at`` (3,) whose axis and stem lean by ``lean`` [deg] from the vertical."""
    up = np.array([0.0, np.sin(np.radians(lean)), np.cos(np.radians(lean))])
    calyx = at + REACH[shape] * up
    return SceneObject(
        name, "pushable", shape, at, frame_along(up), Stem(np.array([calyx, calyx + length * up])),
        physical={"stem_stiffness": stiffness},
    )  # fmt: skip


def beside_a_target(*fruits):
    return replace(generate("cluster", 170000), objects=(
        SceneObject("ripe", "target", Sphere(0.018), np.array([0.45, -0.3, 0.9]),
                    stem=Stem(np.array([[0.45, -0.3, 0.9], [0.45, -0.3, 1.05]]))),
        *fruits,
    ))  # fmt: skip


STAND = "standing", "vine", "trusses"


@pytest.mark.parametrize("preset", ["elongated", "truss", "field", "wild", *STAND])
def test_fruits_stay_where_they_hang_or_stand(preset):
    far = moved(generate(preset, 170001), 170001, 5.0)
    assert max(far.values()) < (2e-3 if preset in STAND else 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("preset", sorted(PRESETS))
@pytest.mark.parametrize("seed", [170000, 170003, 170016])
def test_the_fruits_of_every_preset_stay_for_long(preset, seed):
    assert max(moved(generate(preset, seed), seed, 15.0).values(), default=0.0) < 1e-3


@pytest.mark.parametrize("lean", [0.0, 20.0, 60.0, 85.0])
@pytest.mark.parametrize("length", [0.03, 0.10, 0.28])
def test_fruits_stay_on_stems_of_any_stiffness(length, lean):
    """From threads that could not hold a fruit off the vertical to steel."""
    stiffness = [1e-8, 1e-5, 1e-3, 0.02, 0.3, 100.0, 1e6]
    fruits = [
        hung(f"n{k}", (BERRY, LONG)[k % 2], lean, length, np.array([0.8 * k + 1.0, 0, 0.9]), value)
        for k, value in enumerate(stiffness)
    ]
    assert max(moved(beside_a_target(*fruits), 1, 3.0).values()) < 1e-4


def test_a_fruit_hangs_by_its_centre_of_mass():
    """A cone's is 10 mm from the middle of its axis, so it does not hang level about that."""
    fruit = hung("n1", BERRY, 70.0, 0.15, np.array([0.45, 0.12, 0.9]), 0.01)
    scene = beside_a_target(fruit)
    world = build(scene, resolve(scene).robot, SimulationParameters())
    built = next(item for item in world.fruits if item.id == "n1")
    data = world.data(posed(scene, None)[1].q)
    arm = data.xipos[built.body] - built.built.nodes[-2]
    torque = np.cross(arm, [0.0, 0.0, built.built.mass * 9.81])
    last = built.built.grown[-1] - built.built.bare[-1]
    np.testing.assert_allclose(last, torque, rtol=1e-6, atol=1e-9)


def beam(stiffness, length, mass, tension, lag):
    """Motion of a rigid ball on a light clamped beam that is pulled along its line.

    The line w(x) of the beam under the pull T has the fourth derivative T/EI times the second. The
    beam resists the displacement and the slope of its end, and damps in proportion to its bending
    (Kelvin-Voigt). The ball hangs on the end; its weight turns it back as well.

    Returns: The matrix (4, 4) of the linear motion of displacement, slope and their rates, and its
    column (4,) for a force across the beam at the ball's middle.
    """
    k = np.sqrt(tension / stiffness)
    x = np.linspace(0.0, length, 4001)
    c, s = np.cosh(k * x), np.sinh(k * x)
    slopes = np.array([k * s, k * (c - 1.0)])  # of cosh kx - 1 and sinh kx - kx
    ends = np.array([[c[-1] - 1.0, s[-1] - k * length], slopes[:, -1]])
    curves = np.linalg.inv(ends).T @ np.array([k**2 * c, k**2 * s])
    slopes = np.linalg.inv(ends).T @ slopes
    bending = stiffness * np.trapezoid(curves[:, None] * curves[None], x)
    pulled = tension * np.trapezoid(slopes[:, None] * slopes[None], x)
    pulled[1, 1] += tension * RADIUS
    inertia = mass * np.array([[1.0, RADIUS], [RADIUS, 1.4 * RADIUS**2]])
    elastic, damping = (np.linalg.solve(inertia, m) for m in (bending + pulled, lag * bending))
    force = np.linalg.solve(inertia, [1.0, RADIUS])
    motion = np.block([[np.zeros((2, 2)), np.eye(2)], [-elastic, -damping]])
    return motion, np.append([0.0, 0.0], force)


def pushed_beam(motion, force, steps):
    """Displacement of the ball while a unit force acts for ``steps``, then none for as many [m]."""
    turn = expm(STEP * motion)
    z, out = np.zeros(4), []
    for goal in (-np.linalg.solve(motion, force), np.zeros(4)):
        for _ in range(steps):
            z = goal + turn @ (z - goal)
            out.append(z[0] + RADIUS * z[1])
    return np.array(out)


def pushed_fruit(stiffness, length, mass, lean, lag, push, steps):
    """The same of a simulated ball under ``push`` [N]: its displacement across its stem."""
    up = np.array([np.sin(np.radians(lean)), 0.0, np.cos(np.radians(lean))])
    physical = {"mass": mass, "stem_stiffness": stiffness}
    stem = {"damping_time": lag, "swing_damping": 0.0, "density": 1.0}
    model, data = on_a_stem(length, up, RADIUS, physical, **stem)
    across = np.array([up[2], 0.0, -up[0]])
    both = [tracked(model, data, steps * STEP, force * across) for force in (push, 0.0)]
    return np.concatenate(both) @ across


@settings(max_examples=12, deadline=None, derandomize=True, phases=[Phase.generate])
@given(
    st.sampled_from([1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 0.1, 1.0]), st.floats(0.05, 0.25),
    st.floats(0.01, 0.04), st.floats(0.0, 50.0), st.sampled_from([0.01, 0.03, 0.06]),
)  # fmt: skip
def test_a_fruit_that_is_pushed_and_released_swings_as_on_a_beam(
    stiffness, length, mass, lean, lag
):
    """Frequency and decay, on stems from soft ones to wood (10 GPa, 6.7 mm thick)."""
    weight = mass * 9.81
    needed = weight * np.sin(np.radians(lean)) * length * (length + RADIUS)
    stiffness = max(stiffness, needed)  # none that is taken for stiffer
    motion, force = beam(stiffness, length, mass, weight * np.cos(np.radians(lean)), lag)
    slowest = np.abs(np.linalg.eigvals(motion)).min()
    steps = int(max(6.0 / slowest, 0.05) / STEP)
    expected = pushed_beam(motion, force, steps)
    push = 0.01 * length / expected.max()
    seen = pushed_fruit(stiffness, length, mass, lean, lag, push, steps)
    assert np.abs(seen - push * expected).max() < 0.08 * (0.01 * length)


BALL, BALL_MASS = 0.016, 0.016  # [m] [kg]


UP = np.array([0.0, 0.0, 1.0])


def on_a_stem(length, up=UP, radius=BALL, physical=None, **stem):
    """A ball on a stem of a length from root to fruit [m], as a model and its data."""
    whole = Stem.along(np.zeros(3), up, length + radius)
    own = physical or {"mass": BALL_MASS}
    ball = SceneObject("b", "pushable", Sphere(radius), np.zeros(3), stem=whole, physical=own)
    return loaded(ball, SimulationParameters().changed(stem=stem))


def let_go(length, aside, seconds, **stem):
    """Displacement of a ball [m] that is let go at ``aside`` [m], with its stem straight."""
    model, data = on_a_stem(length, **stem)
    turn = aside / (length + BALL)
    way = np.array([np.cos(0.5 * turn), 0.0, -np.sin(0.5 * turn), 0.0])
    root, free = (int(model.joint(name).qposadr[0]) for name in ("bend:b:0", "free:b"))
    data.qpos[root : root + 4] = data.qpos[free + 3 : free + 7] = way
    data.qpos[free : free + 3] = (length + BALL) * np.array([np.sin(turn), 0.0, 1 - np.cos(turn)])
    return tracked(model, data, seconds)[:, 0]


def turning(x):
    """Times [s] at which a swing turns, and how far it is then [m]."""
    far = np.abs(x)
    at = np.flatnonzero((far[1:-1] > far[:-2]) & (far[1:-1] >= far[2:])) + 1
    return at * STEP, far[at]


def test_a_stem_stretches_by_its_own_modulus_and_swings_as_before():
    default = SimulationParameters().stem
    for length, share in ((0.15, 1.0), (0.25, 1.0), (0.15, 0.3)):
        wanted = share * 5.0 * length / (default.youngs_modulus * np.pi / 4 * default.diameter**2)
        model, data = on_a_stem(length, stretch=share)
        assert np.abs(tracked(model, data, 1.0)).max() < 1e-5  # it hangs where the scene shows it
        pulled = -tracked(model, data, 1.0, (0.0, 0.0, -5.0))[-1, 2]
        assert pulled == pytest.approx(wanted, rel=0.03)
        model, data = on_a_stem(length)  # as ever: the weld alone yields
        assert -tracked(model, data, 1.0, (0.0, 0.0, -5.0))[-1, 2] < 1e-4
    (times, far), (later, near) = (turning(let_go(0.15, 0.03, 6.0, stretch=s)) for s in (0.0, 1.0))
    np.testing.assert_allclose(later[:10], times[:10], rtol=0.01)
    np.testing.assert_allclose(near[:10], far[:10], rtol=0.02)


@pytest.mark.parametrize("seed", [170001, 170005])
def test_the_fruits_of_a_truss_stay_on_stems_that_stretch(seed):
    stem = replace(SimulationParameters().stem, stretch=1.0)
    for preset in ("truss", "mixed"):
        assert max(moved(generate(preset, seed), seed, 3.0, stem=stem).values()) < 1e-3


@pytest.mark.parametrize("length", [0.15, 0.25])
def test_a_swing_dies_as_slowly_as_the_docs_say(length):
    """Damping ratio, time to a tenth, and what is left at the next look."""
    page = (Path(__file__).parents[4] / "docs" / "simulation.md").read_text(encoding="utf-8")
    (row,) = (line for line in page.splitlines() if line.startswith(f"| {1e3 * length:.0f} mm |"))
    told = [float(number) for number in re.findall(r"[\d.]+", row)][1:]
    x, aside, looks = let_go(length, 0.03, 32.0), 0.03, (0.5, 1.0, 2.0)
    times, far = turning(x)
    fall = np.log(far[0] / far[20]) / (20.0 * np.pi)
    rest = np.interp(looks, np.append(0.0, times), np.append(aside, far))
    gone = [STEP * np.flatnonzero(np.abs(x) > least)[-1] for least in (0.1 * aside, 5e-3)]
    means = [
        max(abs(x[k : k + round(span / STEP)].mean()) for k in range(500, 2000, 5))
        for span in (CONTROL.look, CONTROL.patient)
    ]
    measured = [
        2.0 * np.diff(times).mean(), fall / np.hypot(1.0, fall), gone[0], *(1e3 * rest), gone[1],
        *(1e3 * np.array(means)),
    ]  # fmt: skip
    np.testing.assert_allclose(told, measured, rtol=0.04)


@pytest.mark.parametrize("lean", [0.0, 30.0])
def test_fruits_stand_on_stems_from_below(lean):
    """Balls, cones and capsules, on stems that state no stiffness."""
    up = np.array([0.0, np.sin(np.radians(lean)), np.cos(np.radians(lean))])
    fruits = []
    for k, (shape, length) in enumerate(
        itertools.product((Sphere(0.022), BERRY, LONG), (0.03, 0.1))
    ):
        top, reach = np.array([1.0 + 0.8 * k, 0.0, 0.9]), REACH.get(shape, 0.0)
        stem = Stem(np.array([top - reach * up, top - (reach + length + 0.022) * up]))
        fruits.append(SceneObject(f"n{k}", "pushable", shape, top, frame_along(-up), stem))
    assert max(moved(beside_a_target(*fruits), 1, 4.0).values()) < 2e-3
