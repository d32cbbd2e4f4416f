"""A pick in several legs: reach, retreat, carry; planned, judged, written, simulated."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli import fixtures
from tests.planning.builders import tool_speed

from optipromp import PlanOptions, load_pick, plan, plan_pick, simulate, write_pick
from optipromp.core.errors import Code, InvalidPlanError, InvalidSceneError
from optipromp.core.geometry import Box, Sphere
from optipromp.core.planning.leg_tasks import leg, leg_task
from optipromp.core.planning.legs import Picked, led_out
from optipromp.core.planning.result import CARRY, LIFT, REACH, RETREAT
from optipromp.core.planning.task import posed
from optipromp.core.planning.timing import shortest
from optipromp.core.planning.verdict import verdict
from optipromp.core.planning.ways import ways
from optipromp.core.scenes import Place, Scene, SceneObject, Stem, save_scene, scene_from_dict
from optipromp.core.scenes.io import scene_to_dict
from optipromp_sim.generate import generate

PLACE = Place(np.array([0.45, -0.35, 0.45]), np.array([0.0, 0.0, 1.0]))


def placing(kind: str, seed: int) -> Scene:
    """A generated scene beside whose place a punnet stands."""
    scene = generate(kind, seed)  # type: ignore[arg-type]
    punnet = SceneObject("punnet", "static", Box((0.1, 0.1, 0.05)), np.array([0.45, -0.5, 0.45]))
    return replace(scene, place=PLACE, objects=(*scene.objects, punnet))


@pytest.fixture(scope="module")
def picked() -> Picked:
    return plan_pick(placing("tight", 3))


@pytest.fixture(scope="module")
def caught() -> Picked:
    return plan_pick(placing("elongated", 2), options=PlanOptions(risk=0.1))


def test_another_approach_is_taken_where_the_way_out_harms() -> None:
    scene = generate("side-clusters", 743026)
    straight, picked = Picked(led_out(plan(scene))), plan_pick(scene)
    assert straight.reach.success
    assert straight.status is Code.HARM_PREDICTED
    assert picked.success, picked.message
    assert picked.failure < straight.failure
    assert picked.reach.scene.frame[2] @ straight.reach.scene.frame[2] < 0.99
    outcome = simulate(picked, scene).outcome
    assert outcome.success, outcome.message


@pytest.mark.parametrize("timeout", [0.03, 0.06])
def test_a_timeout_is_of_all_legs_and_a_pick_without_the_last_is_no_success(timeout, monkeypatch):
    """Of a pick that takes longer, among 800 fruits on stems. In the process's own time."""
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    scene = generate("tight", 3)
    places = np.random.default_rng(0).uniform([0.3, -0.7, 0.9], [0.9, 0.7, 1.3], (800, 3))
    many = tuple(
        SceneObject(f"p{k}", "pushable", Sphere(0.01), at, stem=Stem.along(at, scene.up, 0.1))
        for k, at in enumerate(places)
    )
    scene = replace(scene, place=PLACE, objects=(*scene.objects, *many))
    took = []
    while len(took) < 3 and min(took, default=9.0) > timeout:  # what disturbs it only adds
        began = time.perf_counter()
        made = plan_pick(scene, timeout=timeout)
        took.append(time.perf_counter() - began)
        assert made.status is Code.TIMEOUT, made.message
    assert min(took) < timeout + 0.05


def test_the_legs_join_and_the_judge_accepts_each(picked: Picked) -> None:
    assert picked.success, picked.message
    assert list(picked.legs) == [REACH, RETREAT, CARRY]
    reach, retreat, carry = picked.legs.values()
    for one, other in ((reach, retreat), (retreat, carry)):
        assert (one.trajectory.positions[-1] == other.trajectory.positions[0]).all()
    for one in picked.legs.values():
        assert verdict(one.task, one.trajectory).status is Code.SUCCESS
        assert np.abs(one.trajectory.velocities[[0, -1]]).max() < 1e-9
    tips, _ = retreat.robot.tool_pose(retreat.trajectory.positions)
    assert np.linalg.norm(tips[-1] - tips[0]) > 0.09
    tip, axis = carry.robot.tool_pose(picked.end)
    assert np.linalg.norm(tip - PLACE.position) < 1e-3
    assert axis @ PLACE.axis > np.cos(np.deg2rad(2.0))


def test_after_the_reach_the_fruit_is_a_link_and_no_object(picked: Picked) -> None:
    target = picked.reach.scene.target
    for name in (RETREAT, CARRY):
        leg = picked.legs[name]
        assert target.id not in {item.id for item in leg.scene.objects}
        assert leg.robot.link_names[-2:] == (target.id, "tool")
        mine = leg.robot.spheres.link == leg.robot.link_names.index(target.id)
        centers = leg.robot.sphere_centers(leg.trajectory.positions[0])[mine]
        if name == RETREAT:
            assert np.abs(centers - target.position).max() < 1e-9
    carry = picked.legs[CARRY].scene
    assert {item.role for item in carry.objects} == {"static"}
    stems = [item for item in picked.reach.scene.pushables if item.stem is not None]
    assert {f"{item.id}:stem:0" for item in stems} <= {item.id for item in carry.objects}


def straight_back(picked: Picked) -> Picked:
    """The same reach, and the retreat back along it."""
    reach = picked.reach
    way = next(ways(reach.robot, reach.trajectory.positions, 0.1))
    assert way.q is not None
    back = shortest(reach.robot, way.q, 0, 0.1)
    return Picked({REACH: reach, RETREAT: leg(leg_task(reach, RETREAT, back), back, 0.0)})


def test_a_fruit_that_hangs_behind_the_tool_is_left_aside(caught: Picked) -> None:
    """Back along the reach the tool would tear it off; after a step aside it comes free."""
    assert caught.success, caught.message
    back = straight_back(caught)
    assert caught.legs[RETREAT].harm < back.legs[RETREAT].harm
    assert "n2" in simulate(back, failed_leg=True).outcome.torn
    outcome = simulate(caught).outcome
    assert outcome.success, outcome.message
    assert outcome.placed


def test_what_is_pressed_on_the_way_out_is_predicted(caught: Picked) -> None:
    """A harm that the way out adds is told, with the fruit and the pull."""
    model = straight_back(caught).legs[RETREAT].task.back
    reach = caught.reach
    tip, axis = reach.robot.tool_pose(reach.trajectory.positions[-1])
    down = tip - np.linspace(0.0, 0.1, 100)[:, None] * axis
    dragged = model.cause(down, np.tile(axis, (100, 1)))
    assert dragged[0] in {item.id for item in reach.scene.pushables}
    stays = model.harm(np.tile(tip, (3, 1)), np.tile(axis, (3, 1)), model.states)
    assert model.harm(down, np.tile(axis, (100, 1)), model.states) > stays


@pytest.mark.parametrize("asked", [{"approach_speed": 0.05}, {"duration": 6.0}])
def test_a_speed_or_a_duration_that_is_asked_for_holds_for_the_way_out(asked):
    scene = replace(placing("tight", 3), place=None)
    slow = plan_pick(scene, options=PlanOptions(**asked)).legs[RETREAT]  # type: ignore[arg-type]
    fastest = asked.get("approach_speed", 0.1) * 1.1
    assert tool_speed(slow) <= fastest < tool_speed(plan_pick(scene).legs[RETREAT])


@pytest.fixture(scope="module")
def unplaced() -> Picked:
    """A pick whose place is out of reach: its carry fails."""
    scene = placing("tight", 3)
    return plan_pick(replace(scene, place=replace(PLACE, position=np.array([1.6, 0.0, 0.4]))))


@pytest.fixture(scope="module")
def harmful() -> Picked:
    """A pick among fruits past which no retreat leads without harm."""
    return plan_pick(placing("table-top", 743009))


@pytest.mark.parametrize("name", ["harmful", "unplaced"])
def test_a_pick_whose_later_leg_failed_is_executed_up_to_there(name, request, tmp_path):
    made: Picked = request.getfixturevalue(name)
    *before, failed = made.legs
    assert [made.legs[leg].success for leg in made.legs] == [True] * len(before) + [False]
    write_pick(made, tmp_path)
    back = load_pick(tmp_path)
    assert (back.status, list(back.legs)) == (made.status, list(made.legs))
    assert back.message == made.message
    for run in (simulate(made), simulate(back)):
        outcome = run.outcome
        assert not outcome.success
        assert str(outcome.cause) == "not_placed"
        assert (outcome.picked, outcome.placed, outcome.torn) == (True, False, ())
        assert outcome.message.startswith(f"of the plan, {failed}: ")
        last = made.legs[before[-1]].trajectory.positions[-1]
        assert np.abs(run.rollout.q[-1] - last).max() < 0.01


def test_a_fruit_that_stays_is_written_with_the_legs_that_succeeded(tmp_path: Path) -> None:
    save_scene(placing("table-top", 743009), tmp_path / "bunch.yaml")
    target = placing("table-top", 743009).target
    out = tmp_path / "picks"
    asked = "plan", tmp_path / "bunch.yaml", "--targets", target.id, "--no-figures", "--out", out
    (left,) = fixtures.told(*asked, code=1)["left"]
    assert left["out"] == str(out / f"left-{target.id}")
    back = load_pick(left["out"])
    assert isinstance(back, Picked)
    assert back.reach.success
    assert str(back.status) == left["status"] == "HARM_PREDICTED"


def test_the_simulation_carries_the_fruit_to_its_place(picked: Picked) -> None:
    run = simulate(picked)
    assert run.success, run.outcome.message
    assert run.outcome.placed
    assert run.outcome.torn == ()
    row = run.rollout.fruit_ids.index("ripe")
    assert not run.rollout.attached[-1, row]
    held = picked.legs[CARRY].scene.attached[-1].position
    away = np.linalg.norm(run.rollout.fruit_positions[-1, row] - PLACE.position)
    assert abs(away - np.linalg.norm(held)) < 0.005


def test_a_leg_of_another_plan_is_passed_over_and_a_bad_one_refused(picked, tmp_path):
    write_pick(picked, tmp_path)
    (tmp_path / "carry.npz").write_bytes((tmp_path / "retreat.npz").read_bytes())
    with pytest.raises(InvalidPlanError, match=r"carry\.npz: judged again"):
        load_pick(tmp_path)
    write_pick(plan_pick(placing("tight", 4)), tmp_path / "other")
    for name in ("retreat.npz", "carry.npz"):
        (tmp_path / "other" / name).write_bytes((tmp_path / "retreat.npz").read_bytes())
    found = load_pick(tmp_path / "other")
    assert list(found.legs) == [REACH]


def test_two_picks_into_a_punnet_go_on_from_the_place(tmp_path: Path) -> None:
    save_scene(placing("tight", 3), tmp_path / "bunch.yaml")
    out = tmp_path / "picks"
    asked = "plan", tmp_path / "bunch.yaml", "--targets", "ripe,n1", "--no-figures", "--out", out
    document = fixtures.told(*asked)
    assert document["success"]
    picks = [load_pick(told["out"]) for told in document["picks"]]
    first, second = picks
    assert isinstance(second, Picked)
    assert np.abs(second.reach.trajectory.positions[0] - first.end).max() < 1e-9
    for told in document["picks"]:
        assert fixtures.told("simulate", told["out"])["placed"] is True


def test_a_place_is_kept_in_files_and_moves_with_the_frame() -> None:
    scene = placing("tight", 3)
    back = scene_from_dict(scene_to_dict(scene))
    assert back.place.position == pytest.approx(PLACE.position)
    assert back.place.retreat == PLACE.retreat
    assert posed(back)[0].tool is not None


def test_the_reach_is_that_of_the_scene_without_a_place(picked: Picked) -> None:
    alone = plan(replace(placing("tight", 3), place=None))
    assert (alone.trajectory.positions == picked.reach.trajectory.positions).all()


def test_a_place_needs_a_target() -> None:
    document = {"name": "s", "robot": "panda",
                "goal": {"position": [0.5, 0, 0.5], "axis": [0, 0, 1]},
                "place": {"position": [0.4, 0, 0.4], "axis": [0, 0, 1]}}  # fmt: skip
    with pytest.raises(InvalidSceneError, match="place and no target"):
        scene_from_dict(document)
    with pytest.raises(InvalidSceneError, match=r"place\.axis is missing"):
        scene_from_dict(document | {"place": {"position": [0.4, 0, 0.4]}})


SHELF_PLACE = Place(np.array([0.35, -0.45, 0.5]), np.array([0.0, -1.0, 0.0]))


def test_a_can_behind_packs_is_lifted_and_brought_to_its_place(tmp_path: Path) -> None:
    """Along the way back nothing that stands is pressed; the lift leaves the board first."""
    scene = replace(generate("shelf", 62000), place=SHELF_PLACE)
    save_scene(scene, tmp_path / "shelf.yaml")
    out = tmp_path / "pick"
    legs = fixtures.told("plan", tmp_path / "shelf.yaml", "--no-figures", "--out", out)["legs"]
    assert list(legs) == [REACH, LIFT, RETREAT, CARRY]
    pick = load_pick(out)
    lift, retreat = pick.legs[LIFT], pick.legs[RETREAT]
    tips, _ = lift.robot.tool_pose(lift.trajectory.positions)
    rise = (tips[-1] - tips[0]) @ scene.up
    assert rise == pytest.approx(np.linalg.norm(tips[-1] - tips[0]), abs=1e-3)
    back, _ = retreat.robot.tool_pose(retreat.trajectory.positions)
    assert ((back - tips[0]) @ scene.up).min() > 0.5 * rise
    assert fixtures.told("simulate", out)["placed"] is True
    board = f"{scene.static[0].id}"
    pairs = {frozenset(pair) for pair in retreat.scene.may_touch}
    assert frozenset(("can", board)) not in pairs
