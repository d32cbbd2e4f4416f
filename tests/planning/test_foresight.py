"""Which way is taken: the rule's where it does no harm, another where it does."""

import time
from dataclasses import replace

import numpy as np
import pytest

from optipromp.errors import Code
from optipromp.geometry import Box
from optipromp.planning import Plan, PlanOptions, foresight, joint, plan, starts
from optipromp.planning.setup import Setup, bind
from optipromp.pushing.harm import Harm, score_of
from optipromp.pushing.sides import Drift
from optipromp.pushing.thread import evenly
from optipromp.scenes import Scene, SceneObject, ToolSpec, load_scene
from optipromp.scenes.generate import generate

GENTLE, HARMFUL = (10, 13), (1, 9)  # clusters, by what the rule's way does to them
OPTIONS = PlanOptions()
RULE = PlanOptions(foresight=False)


def ruled(setup: Setup) -> Drift:
    return joint.sides(setup, OPTIONS)[0]


def path(setup: Setup, drift: Drift) -> np.ndarray:
    return joint.tool_path(setup, OPTIONS, drift)


def approach(result: Plan, setup: Setup) -> np.ndarray:
    """Configurations from the camera point on."""
    tools = result.robot.tool_pose(result.trajectory.positions)[0]
    camera = path(setup, ruled(setup))[0]
    return result.trajectory.positions[int(np.argmin(np.linalg.norm(tools - camera, axis=1))) :]


def same(one: Plan, other: Plan) -> bool:
    first, second = one.trajectory, other.trajectory
    return first.dt == second.dt and np.array_equal(first.positions, second.positions)


def seen(scene: Scene) -> Scene:
    """The same scene, known by detection."""
    noise = 0.001**2 * np.eye(3)
    found = [
        thing if thing.stem is None else replace(thing, covariance=noise) for thing in scene.objects
    ]
    return replace(scene, objects=tuple(found))


# --- which way ---------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", GENTLE)
def test_where_the_rules_way_does_no_harm_it_is_taken(seed: int) -> None:
    scene = generate("cluster", seed)
    assert same(plan(scene), plan(scene, options=RULE))


@pytest.mark.parametrize("seed", GENTLE)
def test_a_good_way_comes_first_and_nothing_is_drawn(seed: int) -> None:
    setup = bind(generate("cluster", seed))
    tried: list[Drift] = []

    def way(drift: Drift) -> np.ndarray:
        tried.append(drift)
        return path(setup, drift)

    model = foresight.foresight(setup)
    expected, drift = next(model.choices(ruled(setup), OPTIONS, way))
    assert len(tried) == 1
    assert expected < foresight.GOOD
    np.testing.assert_allclose(drift.directions, ruled(setup).directions, atol=1e-12)


@pytest.mark.parametrize("seed", HARMFUL)
def test_where_it_harms_another_way_is_found(seed: int) -> None:
    scene = generate("cluster", seed)
    setup = bind(scene)
    model = foresight.foresight(setup)
    rule, own = plan(scene, options=RULE), plan(scene)
    assert own.success, own.message
    assert not same(own, rule)
    harm = model.of_trajectory(approach(rule, setup))
    assert model.of_path(path(setup, ruled(setup))) >= foresight.HOPELESS
    assert harm == foresight.HOPELESS
    assert model.of_trajectory(approach(own, setup)) < 0.5 * harm


@pytest.mark.parametrize("seed", [*GENTLE, HARMFUL[0]])
def test_without_foresight_the_tool_goes_the_rules_way(seed: int) -> None:
    """All the way to the target, in all three axes."""
    scene = generate("cluster", seed)
    setup = bind(scene)
    ways = [path(setup, drift) for drift in joint.sides(setup, RULE)]
    result = plan(scene, options=RULE)
    tools = result.robot.tool_pose(approach(result, setup))[0]
    off = [
        np.linalg.norm(tools[:, None] - evenly(way, 2000)[None], axis=2).min(axis=1).max()
        for way in ways
    ]
    assert min(off) < 2.0 * OPTIONS.corridor


@pytest.mark.parametrize("seed", HARMFUL)
def test_the_trajectory_does_what_its_path_is_foreseen_to_do(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The tight corridor: the arm goes the way that was tried."""
    setup = bind(generate("cluster", seed))
    tried: list[np.ndarray] = []
    original = joint.tool_path

    def noted(setup: Setup, options: PlanOptions, drift: Drift) -> np.ndarray:
        tried.append(original(setup, options, drift))
        return tried[-1]

    monkeypatch.setattr(joint, "tool_path", noted)
    result = plan(setup.scene)
    tools = result.robot.tool_pose(approach(result, setup))[0]
    off = [
        np.linalg.norm(tools[:, None] - evenly(way, 2000)[None], axis=2).min(axis=1).max()
        for way in tried
    ]
    # the corridor is as wide along each of three axes, and knots a step apart cut its corners
    assert min(off) < np.sqrt(3.0) * OPTIONS.corridor + starts.TOOL_STEP / 2.0


@pytest.mark.parametrize("seed", [GENTLE[0], HARMFUL[1]])
def test_the_same_scene_gives_the_same_plan(seed: int) -> None:
    one, other = (plan(generate("cluster", seed)) for _ in range(2))
    assert same(one, other)
    assert one.message == other.message
    assert one.metrics == other.metrics


# --- how long ----------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", HARMFUL)
@pytest.mark.parametrize("budget", [1e-6, 0.05, 0.3])
def test_the_timeout_holds(seed: int, budget: float) -> None:
    scene = generate("cluster", seed)
    began = time.perf_counter()
    result = plan(scene, options=PlanOptions(timeout=budget))
    assert time.perf_counter() - began < budget + 0.5
    assert result.success or result.status in (Code.TIMEOUT, Code.INVALID_PLAN)
    assert result.trajectory.n_knots > 3


def test_from_the_deadline_on_there_is_one_choice() -> None:
    setup = bind(generate("cluster", HARMFUL[0]))
    model = foresight.foresight(setup)
    late = time.perf_counter() - 1.0
    choices = model.choices(ruled(setup), OPTIONS, lambda drift: path(setup, drift), late)
    assert len(list(choices)) == 1


def test_choices_end() -> None:
    setup = bind(generate("cluster", GENTLE[0]))
    model = foresight.foresight(setup)
    found = list(model.choices(ruled(setup), OPTIONS, lambda drift: path(setup, drift)))
    assert foresight.ROUNDS <= len(found) <= foresight.ROUNDS * foresight.DRAWS
    for score, drift in found:
        assert np.isfinite(score)
        assert drift.ids == ruled(setup).ids
        np.testing.assert_allclose(np.linalg.norm(drift.directions, axis=1), 1.0)
        np.testing.assert_allclose(drift.directions @ setup.scene.frame[2], 0.0, atol=1e-12)


# --- where it applies --------------------------------------------------------------------------


def stemless(scene: Scene, role: str) -> Scene:
    things = [replace(t, stem=None) if t.role == role else t for t in scene.objects]
    return replace(scene, objects=tuple(things))


def without(scene: Scene, role: str) -> Scene:
    return replace(scene, objects=tuple(t for t in scene.objects if t.role != role))


def test_it_applies_to_a_cup_among_fruits_that_hang() -> None:
    three = load_scene("scenario-3")
    assert foresight.applies(bind(three), OPTIONS)
    assert not foresight.applies(bind(three), RULE)
    assert not foresight.applies(bind(three), PlanOptions(window="paper"))
    for other in (
        stemless(three, "target"),
        stemless(three, "pushable"),
        without(three, "pushable"),
        replace(three, tool=ToolSpec("franka_hand", {})),
        generate("shelf", 0),
    ):
        assert not foresight.applies(bind(other), OPTIONS)


def test_where_it_does_not_apply_a_stems_side_is_a_fault() -> None:
    scene = generate("cluster", 11)  # the rule passes a vertical stem's other fruit wrongly
    strict = plan(scene, options=RULE)
    assert strict.status is Code.INVALID_PLAN
    assert strict.message.startswith("the tool passes n1 on the side of its stem")
    lenient = plan(scene)
    assert lenient.success
    assert lenient.message.endswith("note: the tool passes n1 on the side of its stem")


# --- the score ---------------------------------------------------------------------------------


def test_a_score_of_nothing_and_of_what_ends_all_hope() -> None:
    nothing = Harm(0.0, 0.0, 0.0, 0.0, 0.0, False)
    assert score_of(*nothing) == 0.0
    assert score_of(*nothing._replace(stem=2.0)) == pytest.approx(1.0)
    assert score_of(*nothing._replace(target=5.0)) == pytest.approx(1.0)
    assert score_of(*nothing._replace(fruit=30.0)) == pytest.approx(1.0)
    assert score_of(*nothing._replace(pinched=0.2)) == pytest.approx(1.0)
    for lost in (nothing._replace(missed=True), nothing._replace(inside=1.0)):
        assert score_of(*lost) > foresight.HOPELESS
    for name in ("stem", "fruit", "target", "pinched"):
        values = [score_of(*nothing._replace(**{name: f})) for f in np.linspace(0, 50, 20)]
        assert (np.diff(values) >= 0.0).all()


def test_fruits_may_hang_otherwise_than_they_were_seen() -> None:
    setup = bind(generate("cluster", 3))
    known, guessed = (foresight.foresight(bind(s)).stems for s in (setup.scene, seen(setup.scene)))
    assert setup.scene.target is not None
    places = [setup.scene.target.position, *(t.position for t in setup.neighbours)]
    for stems, draws in ((known, foresight.UNSEEN), (guessed, foresight.DETECTED_UNSEEN)):
        hung = (stems.root + stems.length[:, None] * stems.axes[:, 2]).reshape(-1, len(places), 3)
        assert len(hung) == draws + 1
        np.testing.assert_allclose(hung[0], places, atol=1e-12)
        for other in hung[1:]:
            assert 0.0 < np.linalg.norm(other - places, axis=1).max() < 0.03
    # what was detected hangs by a stem that is known less well
    turns = []
    for stems in (known, guessed):
        along = stems.axes[:, 2].reshape(-1, len(places), 3)
        turns.append(np.linalg.norm(along[1:] - along[0], axis=2).mean())
    assert turns[1] > 2.0 * turns[0]


def test_a_way_is_tried_in_a_few_draws_and_its_trajectory_in_all() -> None:
    setup = bind(seen(generate("cluster", GENTLE[0])))
    model = foresight.foresight(setup)
    root = np.array(model.stems.root)
    root[(1 + foresight.SCREENED) * model.count :] += 0.5  # the others hang elsewhere
    other = replace(model, stems=model.stems._replace(root=root))
    way = path(setup, ruled(setup))
    assert other.of_path(way) == model.of_path(way)
    assert other.of_path(way, foresight.DETECTED_UNSEEN) > model.of_path(way)
    along = approach(plan(setup.scene), setup)
    assert other.of_trajectory(along) > model.of_trajectory(along)


def test_the_model_knows_fruits_that_are_no_neighbours_too() -> None:
    """A tool that goes a long way round meets what is not near the line."""
    scene = generate("cluster", GENTLE[0])
    setup = bind(scene)
    known = foresight.foresight(setup)
    assert known.count == 1 + len(setup.neighbours)
    target = scene.target
    assert target is not None
    assert target.stem is not None
    away = np.array([0.07, 0.0, -0.05])
    beside = replace(
        target, id="beside", role="pushable", position=target.position + away,
        stem=replace(target.stem, points=target.stem.points + away),
    )  # fmt: skip
    setup = bind(replace(scene, objects=(*scene.objects, beside)))
    assert "beside" not in {thing.id for thing in setup.neighbours}
    model = foresight.foresight(setup)
    assert model.count == known.count + 1
    middle = beside.position - 0.06 * scene.frame[2]
    through = np.array([setup.scene.frame[2] * -0.2 + target.position, middle, beside.position])
    assert model.of_path(through) >= foresight.HOPELESS  # it would be taken in


def test_a_path_along_a_wall_costs_what_it_lacks_in_clearance() -> None:
    setup = bind(generate("cluster", GENTLE[0]))
    way = path(setup, ruled(setup))
    model = foresight.foresight(setup)
    tool_radius = setup.robot.gripper_radius
    x_g = setup.scene.frame[0]
    middle = evenly(way, 201)[100]
    costs = []
    for gap in (0.05, 0.004, 0.001, -0.001):
        at = middle + (tool_radius + gap + 0.005) * x_g
        wall = SceneObject("wall", "static", Box((0.01, 0.2, 0.02)), at)
        objects = (*setup.scene.objects, wall)
        near = foresight.foresight(bind(replace(setup.scene, objects=objects)))
        costs.append(near.of_path(way) - model.of_path(way))
    assert costs[0] == 0.0
    assert costs[1] <= costs[2] < costs[3]
    assert costs[3] > 0.5
