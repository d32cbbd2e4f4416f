"""The model of the push of a cup among fruits on stems: what it predicts, in which states."""

from dataclasses import replace

import numpy as np
import pytest
from tests.pushing.fruits import TARGET
from tests.pushing.hanging import (
    BESIDE,
    CAMERA,
    CUP,
    LEANING,
    RIPE,
    STRAIGHT,
    UNDER,
    detected,
    fruit,
    harm,
    judged,
    led,
    model,
    scene,
)

from optipromp.core.geometry import Box
from optipromp.core.planning.task import resolve
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.rules import neighbours
from optipromp.core.pushing.stems.hanging import HANGING, TOGETHER, Hanging, applies
from optipromp.core.pushing.stems.swinging import Harm, score_of
from optipromp.core.robots.tools import Cup, FrankaHand
from optipromp.core.scenes import Scene, SceneObject
from optipromp_sim.generate import generate

# --- harm of known paths -----------------------------------------------------------------------


def test_a_fruit_that_hangs_low_meets_the_flange() -> None:
    """0.13 m under the target and 60 mm aside: the cup passes it, a flange of 60 mm does not."""
    low = fruit("n1", (0.06, 0.0, -0.15))
    one = scene(low)
    arguments = one, CUP, (low,), CAMERA, CUP.gripper_radius
    without, wide = Hanging(*arguments), Hanging(*arguments, (0.06, -0.13))
    narrow = Hanging(*arguments, (0.03, -0.13))
    shift = [
        float(np.linalg.norm(a.moved(*judged(STRAIGHT)).positions[1] - low.position))
        for a in (without, wide, narrow)
    ]
    assert shift[0] == shift[2] < 1e-6
    assert 0.01 < shift[1] < 0.04


def test_a_fruit_on_the_way_is_swallowed_and_named() -> None:
    a = model(UNDER, fruit("n2", (0.07, 0.0, -0.05), LEANING))
    assert harm(a, STRAIGHT) == PUSH.harm.hopeless
    prediction = a.predict(*judged(STRAIGHT))
    assert prediction.harmful
    assert (prediction.object, prediction.cause) == ("n1", "is swallowed")
    assert str(prediction).startswith("harm is predicted: n1 is swallowed (harm 3.00")


def test_one_state_in_longer_steps_tells_good_candidates_from_bad_ones() -> None:
    """Good and bad by all states in short steps; steps of 2 mm tell them apart no better (0.85)."""
    right: list[float] = []
    for seed in (100, 101):
        for preset in ("cluster", "side-clusters", "mixed"):
            task = resolve(generate(preset, seed))  # type: ignore[arg-type]
            a, rng = task.push_model(task.robot.home), np.random.default_rng(seed)
            mean, spread = a.candidates.spread(0)
            sampled = rng.normal(mean, spread, (30, len(mean)))
            paths = [a.candidates.path(x) for x in np.vstack([a.candidates.first(), sampled])]
            fast, slow = (np.array([harm(a, path, n) for path in paths]) for n in (1, a.states))
            good, bad = fast[slow < 0.3][:, None], fast[slow > 1.0]
            right.extend(np.ravel((good < bad) + 0.5 * (good == bad)))
    assert np.mean(right) > 0.8


def test_a_missed_target_is_named() -> None:
    a = model(BESIDE)
    for short in (led((0, 0, -0.25), (0, 0, -0.03)), led((-0.05, 0, -0.25), (-0.05, 0, 0))):
        assert harm(a, short) == PUSH.harm.hopeless
        assert a.cause(*judged(short)) == ("ripe", "is not inside at the end")


def test_a_pressed_stem_is_named() -> None:
    """A stiff stem that leans across the tool's way, far above its fruit."""
    a = model(fruit("n1", (0.045, 0.0, -0.1), (-0.08, 0.0, 0.06)))
    assert harm(a, STRAIGHT) > 1.0
    name, cause = a.cause(*judged(STRAIGHT))
    assert name == "n1"
    assert cause.startswith("has its stem pressed by ")
    assert float(cause.split()[-2]) > 2.0  # [N], what a stem bears


def test_a_fruit_pressed_against_a_wall_is_named_and_without_the_wall_is_not_harmed() -> None:
    wall = SceneObject("wall", "static", Box((0.04, 0.2, 0.2)), TARGET + [0.07, 0.0, -0.05])
    near = fruit("n1", (0.03, 0.0, -0.05))
    aside = led((0, 0, -0.25), (0, 0, -0.04), (0.02, 0, -0.04), (0, 0, -0.04), (0, 0, 0))
    free, walled = model(near), model(near, wall)
    assert not free.predict(*judged(aside)).harmful
    assert harm(walled, aside) == PUSH.harm.hopeless
    name, cause = walled.cause(*judged(aside))
    assert name == "n1"
    assert cause.startswith(("is pinched for ", "is swallowed"))


def test_a_pressed_target_is_named() -> None:
    """Between the cup and a wall behind it."""
    wall = SceneObject("wall", "static", Box((0.04, 0.2, 0.2)), TARGET + [0.06, 0.0, 0.0])
    a = model(wall)
    way = led((-0.06, 0, -0.25), (-0.06, 0, 0), (0.045, 0, 0), (0, 0, -0.05), (0, 0, 0))
    assert a.predict(*judged(way)).harmful
    name, cause = a.cause(*judged(way))
    assert name == "ripe"
    assert cause.startswith("is pressed by ")
    assert float(cause.split()[-2]) > 3.0  # [N]


def test_above_the_limit_a_harm_is_above_it_and_below_it_exact() -> None:
    a = model(detected(UNDER), fruit("n2", (-0.02, 0.01, -0.14), LEANING))
    rng = np.random.default_rng(0)
    for _ in range(15):
        aside = rng.uniform(-0.05, 0.05, 2)
        way = led((0, 0, -0.25), (*aside, -0.13), (*aside, -0.06), (0, 0, -0.025), (0, 0, 0))
        whole = a.harm(*judged(way), 7)
        assert a.harm(*judged(way), 7, whole + 1e-9) == whole
        if whole > 0.0:
            assert a.harm(*judged(way), 7, 0.5 * whole) > 0.5 * whole


# --- the score ---------------------------------------------------------------------------------


def test_a_score_of_nothing_and_of_what_ends_all_hope() -> None:
    nothing = Harm(0.0, 0.0, 0.0, 0.0, 0.0, False)
    assert score_of(*nothing) == 0.0
    assert score_of(*nothing._replace(stem=2.0)) == pytest.approx(1.0)
    assert score_of(*nothing._replace(target=5.0)) == pytest.approx(1.0)
    assert score_of(*nothing._replace(fruit=30.0)) == pytest.approx(1.0)
    assert score_of(*nothing._replace(pinched=0.2)) == pytest.approx(1.0)
    for lost in (nothing._replace(missed=True), nothing._replace(inside=1.0)):
        assert score_of(*lost) > PUSH.harm.hopeless
    for name in ("stem", "fruit", "target", "pinched"):
        values = [score_of(*nothing._replace(**{name: f})) for f in np.linspace(0, 50, 20)]
        assert (np.diff(values) >= 0.0).all()


# --- states ------------------------------------------------------------------------------------


def test_states_are_sampled_round_the_perceived_one() -> None:
    """The perceived one comes first; what was detected hangs by a stem that is known less well.

    Those that tell the harm are spread as the errors are, those of the search wider.
    """
    deviation = 0.005
    fruits = (UNDER, fruit("n2", (-0.02, 0.01, -0.14), LEANING))
    known = model(*fruits)
    seen = model(*(detected(obj, deviation) for obj in fruits))
    assert (known.states, seen.states) == (HANGING.states, HANGING.detected_states)
    places = np.array([obj.position for obj in known.fruits])
    turns = []
    for a in (known, seen):
        s = a.stems
        hung = (s.root + s.length[:, None] * s.axes[:, 2]).reshape(-1, a.count, 3)
        assert len(hung) == a.searched + a.states
        np.testing.assert_allclose(hung[0], places, atol=1e-12)
        np.testing.assert_allclose(
            s.root[: a.count], [t.stem.root for t in a.fruits if t.stem is not None], atol=1e-12
        )
        off = hung[1:] - places
        assert (np.linalg.norm(off, axis=2) > 0.0).all()
        assert np.linalg.norm(off, axis=2).max() < 0.05
        along = s.axes[:, 2].reshape(-1, a.count, 3)
        turns.append(np.linalg.norm(along[1:] - along[0], axis=2).mean())
    assert turns[1] > 2.0 * turns[0]
    s = seen.stems
    off = (s.root + s.length[:, None] * s.axes[:, 2]).reshape(-1, seen.count, 3) - places
    wide, told = off[1 : seen.searched, 1:].std(), off[seen.searched :, 1:].std()
    assert 0.7 < wide / (HANGING.wider * deviation) < 1.3  # it is the unlikely that does harm
    assert 0.8 < told / deviation < 1.2
    np.testing.assert_array_equal(model(*fruits).stems.root, known.stems.root)  # the same each time


def test_a_path_is_told_by_other_states_than_it_was_searched_in() -> None:
    a = model(detected(BESIDE))
    few = a.candidates.schedule.states
    assert few == a.searched < a.states
    before = harm(a, STRAIGHT, few)
    assert harm(a, STRAIGHT, a.states) < 0.1
    root = np.array(a.stems.root)
    root[few * a.count :] += [0.5, 0.0, 0.0]  # in the other states all hang elsewhere
    a.stems = a.stems._replace(root=root)
    assert harm(a, STRAIGHT, few) == before
    assert harm(a, STRAIGHT, a.states) == PUSH.harm.hopeless


# --- where it applies --------------------------------------------------------------------------


def test_it_applies_to_a_mouth_for_a_target_that_hangs() -> None:
    known = scene(UNDER)
    near = neighbours(known, CUP.gripper_radius)
    assert applies(known, CUP, near)
    assert applies(known, FrankaHand(), near)
    assert not applies(known, None, near)
    assert applies(scene(), CUP, ())
    assert not applies(known, CUP, near * (HANGING.most + 1))
    standing = replace(UNDER, stem=None)
    assert applies(scene(standing), CUP, (standing,))  # it knows the target, which hangs
    stemless = replace(known, objects=(replace(RIPE, stem=None), UNDER))
    assert not applies(stemless, CUP, near)


def test_the_model_knows_fruits_that_are_no_neighbours_too() -> None:
    """A tool that goes a long way round meets what is not near the line; the nearest are known."""
    beside = fruit("beside", (0.09, 0.0, -0.05))
    a = model(UNDER, beside)
    assert [obj.id for obj in a.candidates.neighbours] == ["n1"]
    assert [obj.id for obj in a.fruits] == ["ripe", "beside", "n1"]
    into = led((0, 0, -0.25), (0.09, 0, -0.11), (0.09, 0, -0.05))
    assert harm(a, into) == PUSH.harm.hopeless
    around = [fruit(f"far-{i}", (0.2 + 0.002 * i, 0.1, 0.1)) for i in range(40)]
    many = model(UNDER, *around[::-1])
    assert many.count == 1 + HANGING.most
    nearest = {item.id for item in around[: HANGING.most - 1]}
    assert {item.id for item in many.fruits} == {"ripe", "n1"} | nearest


def told(scene: Scene, **physical: float) -> Scene:
    return replace(
        scene,
        objects=tuple(
            item if item.stem is None else replace(item, physical=physical)
            for item in scene.objects
        ),
    )


def model_of(scene: Scene) -> Hanging:
    task = resolve(scene)
    model = task.push_model(task.robot.home)
    assert isinstance(model, Hanging)
    return model


def test_the_model_takes_mass_and_stiffness_that_the_scene_tells() -> None:
    scene = generate("cluster", 66001)
    model = model_of(told(scene, mass=0.05, stem_stiffness=2e-3))
    assert (model.stems.mass == 0.05).all()
    doubled = model_of(told(scene, mass=1e-9, stem_stiffness=4e-3))
    single = model_of(told(scene, mass=1e-9, stem_stiffness=2e-3))
    np.testing.assert_allclose(doubled.stems.stiffness, 2.0 * single.stems.stiffness, rtol=1e-5)


def test_stiffness_is_a_belief_where_it_is_not_told() -> None:
    """One case as assumed, one with all stems softer, one with all of them stiffer."""
    scene = generate("cluster", 66001)
    sure = model_of(told(scene, stem_stiffness=2e-3, mass=1e-9))
    unsure = model_of(told(scene, stem_stiffness=2e-3, mass=1e-9, stem_stiffness_spread=3.0))
    n = sure.count
    np.testing.assert_array_equal(unsure.stems.root, sure.stems.root)
    for state, factor in enumerate((1.0, 1.0 / 3.0, 3.0)):
        rows = slice(state * n, (state + 1) * n)
        expected = factor * sure.stems.stiffness[rows]
        np.testing.assert_allclose(unsure.stems.stiffness[rows], expected, rtol=1e-5)
    assumed = model_of(told(scene, mass=1e-9)).stems.stiffness
    np.testing.assert_allclose(
        assumed[n : 2 * n], assumed[:n] / PUSH.beam.stiffness_spread, rtol=1e-5
    )


def test_a_truss_is_believed_softer_and_stiffer_as_a_whole() -> None:
    scene = generate("truss", 20001)
    model = model_of(scene)
    n, give = model.count, model.stems.compliance[:, -1, -1]
    assert model.stems.joint.shape == (len(give), n, 3, 3)
    assert (give[n : 2 * n] > give[:n]).all()
    assert (give[2 * n : 3 * n] < give[:n]).all()


def test_forces_are_those_of_the_led_cup() -> None:
    """Of each fruit that is pushed but the target; none where the cup passes clear of it."""
    bench = model(UNDER, fruit("n2", (0.07, 0.0, -0.08)))
    assert [item.id for item in bench.candidates.neighbours] == ["n1"]
    through_both = bench.predict(*judged(STRAIGHT)).forces
    assert set(through_both) == {"n1"}
    assert through_both["n1"] > 1.0
    assert "n2" in bench.forces(*judged(STRAIGHT))
    far = led((0.3, 0, -0.25), (0.3, 0, -0.2))
    assert bench.predict(*judged(far)).forces == {}


def test_every_swallowed_fruit_is_named_and_not_the_target() -> None:
    """Both hang in the way of a wide cup; whether the ripe one comes in too is not known."""
    wide = Cup(radius=0.05, opening=0.096)
    both = fruit("n1", (0.004, 0.012, -0.09)), fruit("n2", (-0.004, -0.012, -0.05))
    bench = model(*both, cup=wide)
    found = bench.predict(*judged(STRAIGHT))
    assert found.harmful
    assert str(found).startswith("harm is predicted: n1 and n2 are swallowed (harm ")


@pytest.mark.parametrize("turn", [0.0, 2.0, 4.0])
def test_a_rim_under_the_middle_of_a_fruit_is_a_coin_that_the_model_knows_of(turn: float) -> None:
    """A neighbour level with the target, dead centre on the rim: a millimetre decides its fate."""
    cup = Cup(radius=0.033, opening=0.062)
    way = np.array([np.cos(turn), np.sin(turn), 0.0])
    beside = fruit("n1", 0.5 * sum(cup.mouth) * way - [0.0, 0.0, 0.001])
    bench = model(beside, cup=cup)
    states = range(bench.searched, bench.searched + bench.states)
    lost = [bench.led(d, *judged(STRAIGHT)).harm for d in states]
    swallowed = sum(one.inside > PUSH.harm.inside_time for one in lost)
    assert 0 < swallowed < bench.states
    told = bench.predict(*judged(STRAIGHT))
    assert told.harm > 0.3
    assert told.probability > 0.05


def test_the_harm_of_a_path_is_the_mean_over_the_states_that_tell_it() -> None:
    """Also where the first is hopeless. Of a third or more, where these tell next to none."""
    one, early = model(fruit("n1", (0.003, 0.0, -0.08), LEANING)), 0
    states, alone = range(one.searched, one.searched + one.states), 0
    rng = np.random.default_rng(0)
    mean, spread = one.candidates.spread(0)
    for x in [*one.candidates.first(), *(mean + spread * rng.standard_normal((8, len(mean))))]:
        way = judged(one.candidates.path(x))
        at_goal = one.candidates.path(x).points[-1]
        parts = [one.led(d, *way).harm for d in states]
        scores = [min(score_of(*part), PUSH.harm.hopeless) for part in parts]
        some = range(one.states // 3, one.states, TOGETHER)
        sure = [k for k in some if np.mean(scores[:k]) <= HANGING.sure * one.threshold]
        told = scores[: min(sure, default=one.states)]
        assert one.harm(*way, one.states) == pytest.approx(np.mean(told))
        np.testing.assert_allclose(at_goal, TARGET, atol=1e-9)
        early += len(told) < one.states
        alone += scores[0] == PUSH.harm.hopeless > np.mean(scores)
    assert alone
    assert 0 < early < len(one.candidates.first()) + 8
