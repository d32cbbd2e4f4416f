"""The model of the push of a cup among fruits on stems: what it predicts, of which paths."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from tests.pushing.fruits import TARGET, UP

from optipromp.geometry import Box, HalfSpace, Sphere, distances, pack
from optipromp.planning.task import resolve
from optipromp.pushing.hanging import HANGING, Hanging, applies, rooms
from optipromp.pushing.harm import Harm, score_of
from optipromp.pushing.model import Prediction, search
from optipromp.pushing.parameters import PUSH
from optipromp.pushing.path import ToolPath, through, turning
from optipromp.pushing.rules import neighbours, rule_paths
from optipromp.robots.library import load_robot
from optipromp.robots.tools import Cup, FrankaHand, with_tool
from optipromp.scenes import Scene, SceneObject, Stem
from optipromp.scenes.generate import generate

CUP = Cup(radius=0.025, opening=0.046)
CAMERA = TARGET - [0.0, 0.0, 0.25]
VERTICAL = (0.0, 0.0, 0.2)
LEANING = (0.05, 0.0, 0.2)


def fruit(name: str, off: Any, stem: Any = VERTICAL, role: Any = "pushable") -> SceneObject:
    at = TARGET + np.asarray(off, dtype=float)
    hung = Stem(np.array([at, at + np.asarray(stem, dtype=float)]))
    return SceneObject(name, role, Sphere(0.015), at, stem=hung)


RIPE = fruit("ripe", (0.0, 0.0, 0.0), (0.0, 0.0, 0.1), "target")
UNDER = fruit("n1", (0.003, 0.0, -0.08))  # on the approach line
BESIDE = fruit("n1", (0.07, 0.0, -0.08), LEANING)  # the cup passes it by 3 cm


def scene(*fruits: SceneObject) -> Scene:
    return Scene("bench", "panda", (RIPE, *fruits))


def model(*fruits: SceneObject, cup: Cup = CUP) -> Hanging:
    one = scene(*fruits)
    return Hanging(one, cup, neighbours(one, cup.gripper_radius), CAMERA, cup.gripper_radius)


def led(*corners: Any) -> ToolPath:
    """The tool led through corners relative to the target."""
    return through(TARGET + np.array(corners, dtype=float), 0.1)


STRAIGHT = led((0, 0, -0.25), (0, 0, 0))


def judged(path: ToolPath) -> tuple[np.ndarray, np.ndarray]:
    return path.points, np.tile(UP, (len(path.points), 1))


def harm(a: Hanging, path: ToolPath, states: int = 1) -> float:
    return a.harm(*judged(path), states)


def detected(obj: SceneObject, deviation: float = 0.005) -> SceneObject:
    return replace(obj, covariance=deviation**2 * np.eye(3))


def test_the_room_about_an_upright_tool_is_the_distance_less_its_radius() -> None:
    rng = np.random.default_rng(3)
    up = np.array([0.0, 0.6, 0.8])
    heights, none = np.array([-0.1, 0.0, 0.03]), np.eye(3)
    for count in range(5):
        balls = [(Sphere(0.02), at, none) for at in rng.uniform(-0.2, 0.2, (count, 3))]
        obstacles = pack([*balls, (HalfSpace(), np.array([0.0, 0.0, -0.3]), none)])
        points = rng.uniform(-0.2, 0.2, (12, 3))
        where = (points[:, None] + heights[:, None] * up).reshape(-1, 3)
        room = distances(obstacles, where)[0].reshape(12, -1).min(axis=1) - 0.03
        for most in (0.01, 0.3):
            expected = min(room.min(), most), min(room[-1], most)
            assert rooms(points, heights, up, obstacles, 0.03, most) == pytest.approx(expected)


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


def test_what_is_not_touched_is_not_harmed() -> None:
    a = model(BESIDE)
    assert harm(a, STRAIGHT, a.states) == 0.0
    prediction = a.predict(*judged(STRAIGHT))
    assert not prediction.harmful
    assert (prediction.object, prediction.cause) == ("", "nothing is harmed")


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
    for seed in range(100, 104):
        for preset in ("cluster", "side-clusters", "mixed"):
            task = resolve(generate(preset, seed))  # type: ignore[arg-type]
            a, rng = task.push_model(task.robot.home), np.random.default_rng(seed)
            assert isinstance(a, Hanging)
            mean, spread = a.spread(0)
            sampled = rng.normal(mean, spread, (30, len(mean)))
            paths = [a.path(x) for x in np.vstack([a.first(), sampled])]
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
    few = a.schedule.states
    assert few == a.searched < a.states
    before = harm(a, STRAIGHT, few)
    assert harm(a, STRAIGHT, a.states) < 0.1
    root = np.array(a.stems.root)
    root[few * a.count :] += [0.5, 0.0, 0.0]  # in the other states all hang elsewhere
    a.stems = a.stems._replace(root=root)
    assert harm(a, STRAIGHT, few) == before
    assert harm(a, STRAIGHT, a.states) == PUSH.harm.hopeless


# --- which paths -------------------------------------------------------------------------------


def test_candidates_begin_at_the_camera_and_end_at_the_target() -> None:
    a = model(UNDER, fruit("n2", (-0.02, 0.01, -0.14), LEANING))
    rng = np.random.default_rng(0)
    mean, spread = a.spread(0)
    for x in [*a.first(), *(mean + spread * rng.standard_normal((20, len(mean))))]:
        path = a.path(x)
        np.testing.assert_allclose(path.points[[0, -1]], [CAMERA, TARGET], atol=1e-12)
        off = path.points - TARGET
        widest = np.linalg.norm(off[:, :2], axis=1).max()
        assert widest < 0.03 + CUP.radius + HANGING.clearance_most * 0.015
        assert a.aside(x, path) >= 0.0


def test_the_first_candidate_is_the_rules_path() -> None:
    fruits = UNDER, fruit("n2", (-0.02, 0.01, -0.14), LEANING)
    one = scene(*fruits)
    a = model(*fruits)
    robot = with_tool(load_robot("panda"), CUP)
    (corners, *_) = rule_paths(one, neighbours(one, CUP.gripper_radius), robot, CAMERA)
    rule = through(corners, 0.1).points
    path = a.path(a.first()[0]).points
    gap = np.linalg.norm(path[:, None] - rule[None], axis=2).min(axis=1)
    assert gap.max() < 0.006  # the rims' rounded corners are taken in a little earlier


def test_a_path_of_no_harm_is_found_past_a_fruit_on_the_way() -> None:
    a = model(fruit("n1", (0.003, 0.0, -0.08), LEANING))
    found = list(search(a, partial(turning, UP, None), np.random.default_rng(0)))
    assert found[0][0].harm < a.good
    assert min(a.harm(*judged(path), a.states) for path, _ in found) < a.good
    assert harm(a, STRAIGHT, a.states) > 0.9 * PUSH.harm.hopeless


def test_a_path_along_a_wall_is_raised_by_what_it_lacks_in_clearance() -> None:
    a = model(UNDER)
    x = a.first()[0]
    way = a.path(x)
    k = len(way.points) // 2
    middle = way.points[k]
    out = np.array([1.0, 0.0, 0.0])
    raised = []
    for gap in (0.05, 0.004, 0.001, -0.001):
        at = middle + (CUP.radius + gap + 0.005) * out
        wall = SceneObject("wall", "static", Box((0.01, 0.2, 0.02)), at)
        raised.append(model(UNDER, wall).aside(x, way) - a.aside(x, way))
    assert raised[0] == 0.0
    assert raised[1] <= raised[2] < raised[3]
    assert raised[3] > 0.5


def test_a_detour_counts() -> None:
    a = model(UNDER)
    straight, round_about = STRAIGHT, led((0, 0, -0.25), (0.1, 0, -0.125), (0, 0, 0))
    assert a.aside(a.first()[0], straight) == pytest.approx(0.0, abs=1e-9)
    longer = (round_about.length - 0.25) / 0.25
    assert a.aside(a.first()[0], round_about) == pytest.approx(0.5 * longer)


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
    assert [obj.id for obj in a.neighbours] == ["n1"]
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


@pytest.mark.parametrize("lean", [0.0, 1.0, 2.5])
def test_a_path_on_a_stem_s_side_has_one_on_the_other_side_that_is_preferred(lean: float) -> None:
    """Mirrored at right angles to the lean; nothing is preferred to what passes away from it."""
    stem = (0.06 * np.cos(lean), 0.06 * np.sin(lean), 0.2)
    bench = model(fruit("n1", (0.0, 0.0, -0.08), stem))
    x_g, y_g, z_g = bench.scene.frame
    lateral = np.array(stem) - np.dot(stem, z_g) * z_g

    def side(x: np.ndarray) -> float:
        points = bench.path(x).points
        at = points[np.argmax((points - TARGET) @ z_g >= -0.08 - bench.cup.rim)]
        off = at - bench.neighbours[0].position
        return float((off - (off @ z_g) * z_g) @ lateral)

    angle = np.arctan2(lateral @ y_g, lateral @ x_g)
    for turn in (0.0, 0.7, -1.2):
        wrong, right = (np.array([angle + turn + back, 0.8]) for back in (0.0, np.pi))
        assert side(wrong) > 0.0 > side(right)
        preferred = bench.rather(wrong, bench.path(wrong))
        assert len(preferred) == 2
        for x in preferred:
            assert side(x) < 0.0
            assert x[1] == 0.8
            assert not bench.rather(x, bench.path(x))
        mirrored = bench._split(preferred[0])[0][0] + bench._split(wrong)[0][0]
        np.testing.assert_allclose(mirrored @ lateral, 0.0, atol=1e-12)
        assert not bench.rather(right, bench.path(right))


def test_nothing_is_preferred_where_no_stem_leans() -> None:
    bench = model(UNDER)
    x = bench.first()[1]
    assert bench.rather(x, bench.path(x)) == []
    assert model().rather(np.zeros(0), model().path(np.zeros(0))) == []


def test_of_two_harmless_sides_a_plan_takes_the_one_away_from_the_stem(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from optipromp.planning import plan

    crowd = generate("mixed", 43006)
    made = plan(crowd)
    assert made.success
    assert "side of its stem" not in made.message
    monkeypatch.setattr(Hanging, "rather", lambda *_: [])
    other = plan(crowd)
    assert other.success
    assert "side of its stem" in other.message
    assert made.prediction is not None
    assert other.prediction is not None
    assert made.prediction.harm < other.prediction.harm + HANGING.stem_side


def test_forces_are_those_of_the_led_cup() -> None:
    """Of each fruit that is pushed but the target; none where the cup passes clear of it."""
    bench = model(UNDER, fruit("n2", (0.07, 0.0, -0.08)))
    assert [item.id for item in bench.neighbours] == ["n1"]
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


def test_what_is_pushed_is_told_with_the_way_of_the_tool() -> None:
    forces = {"n1": 2.14, "n2": 0.5}
    found = Prediction(0.1, 1.0, "", "nothing is harmed", forces)
    told = found.pushes({"n1": (0.0621, -0.0002), "n2": None})
    assert told == "pushed, and passed at (x_g, y_g): n1 2.1 N (+62, +0) mm, n2 0.5 N"
    assert Prediction(0.1, 1.0, "", "nothing is harmed").pushes({"n1": (0.0, 0.0)}) == ""


@pytest.mark.parametrize("turn", [0.0, 2.0, 4.0])
def test_a_rim_under_the_middle_of_a_fruit_is_a_coin_that_the_model_knows_of(turn: float) -> None:
    """A neighbour level with the target, dead centre on the rim: a millimetre decides its fate."""
    cup = Cup(radius=0.033, opening=0.062)
    way = np.array([np.cos(turn), np.sin(turn), 0.0])
    beside = fruit("n1", 0.5 * sum(cup.mouth) * way - [0.0, 0.0, 0.001])
    bench = model(beside, cup=cup)
    states = range(bench.searched, bench.searched + bench.states)
    lost = [bench.harm_in(d, *judged(STRAIGHT)) for d in states]
    swallowed = sum(one.inside > PUSH.harm.inside_time for one in lost)
    assert 0 < swallowed < bench.states
    told = bench.predict(*judged(STRAIGHT))
    assert told.harm > 0.3
    assert told.probability > 0.05


def test_the_harm_of_a_path_is_the_mean_over_the_states_that_tell_it() -> None:
    """Also where the first of them is hopeless."""
    one = model(fruit("n1", (0.003, 0.0, -0.08), LEANING))
    states, alone = range(one.searched, one.searched + one.states), 0
    rng = np.random.default_rng(0)
    mean, spread = one.spread(0)
    for x in [*one.first(), *(mean + spread * rng.standard_normal((8, len(mean))))]:
        way = judged(one.path(x))
        at_goal = one.path(x).points[-1]
        parts = [one.harm_in(d, *way) for d in states]
        scores = [min(score_of(*part), PUSH.harm.hopeless) for part in parts]
        assert one.harm(*way, one.states) == pytest.approx(np.mean(scores))
        np.testing.assert_allclose(at_goal, TARGET, atol=1e-9)
        alone += scores[0] == PUSH.harm.hopeless > np.mean(scores)
    assert alone
