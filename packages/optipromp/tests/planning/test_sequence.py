"""Several ripe fruits of a bunch, picked one after the other."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from tests.cli.fixtures import completed, refused, told

from optipromp import load_plan, plan_pick, plan_sequence, simulate
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.geometry import Sphere
from optipromp.core.planning.leg_tasks import aimed
from optipromp.core.planning.sequence import HARMLESS
from optipromp.core.scenes import Scene, save_scene
from optipromp_sim.generate import generate

RIPE = ("ripe", "n1", "n2")


@pytest.fixture(scope="module")
def bunch() -> Scene:
    return generate("tight", 3)


def test_three_ripe_fruits_are_picked_and_nothing_is_harmed(bunch: Scene) -> None:
    found = plan_sequence(bunch, RIPE)
    assert found.success
    assert sorted(found.order) == sorted(RIPE)
    gone: set[str] = set()
    for id_, pick in zip(found.order, found.picks, strict=True):
        assert {item.id for item in pick.scene.objects} == {i.id for i in bunch.objects} - gone
        outcome = simulate(pick).outcome
        assert outcome.success, outcome.message
        assert outcome.target == id_
        gone.add(id_)


def test_the_first_pick_is_the_least_harmful_one_and_then_the_quickest(bunch: Scene) -> None:
    found = plan_sequence(bunch, RIPE)
    alone = {id_: plan_pick(aimed(bunch, id_)) for id_ in RIPE}
    harm = {id_: max(leg.harm for leg in made.legs.values()) for id_, made in alone.items()}
    first = min(RIPE, key=lambda id_: (max(harm[id_], HARMLESS), alone[id_].duration))
    assert found.order[0] == first
    assert (found.placed[0].end == alone[first].end).all()


def test_a_fruit_that_cannot_be_picked_stays_and_says_why(bunch: Scene, tmp_path: Path) -> None:
    wide = replace(bunch, objects=tuple(
        replace(item, shape=Sphere(0.03)) if item.id == "n1" else item for item in bunch.objects
    ))  # fmt: skip
    found = plan_sequence(wide, RIPE)
    assert not found.success
    assert sorted(found.order) == ["n2", "ripe"]
    (left,) = found.left
    assert (left.id, left.status) == ("n1", Code.INVALID_PLAN)
    assert "the half width of n1 across the approach is 30.0 mm" in left.message
    last = found.picks[-1].scene
    assert {item.role for item in last.objects if item.id == "n1"} == {"pushable"}
    save_scene(wide, tmp_path / "wide.yaml")
    done = completed("plan", tmp_path / "wide.yaml", "--targets", "n1,n2", code=1)
    assert "1 of 2 planned" in done.stdout
    assert "n1 stays: " in done.stdout
    assert "the half width of n1 across the approach" in " ".join(done.stdout.split())


@pytest.mark.parametrize("targets", [(), ("ripe", "ripe"), ("ripe", "gutter"), ("n9",)])
def test_wrong_targets_are_refused(bunch: Scene, targets: tuple[str, ...]) -> None:
    with pytest.raises(InvalidRequestError, match="target"):
        plan_sequence(bunch, targets)


def test_the_command_leaves_a_folder_for_each_pick(bunch: Scene, tmp_path: Path) -> None:
    file, out = tmp_path / "bunch.yaml", tmp_path / "picks"
    save_scene(bunch, file)
    document = told("plan", file, "--targets", ", ".join(RIPE), "--out", out)
    assert document == json.loads((out / "sequence.json").read_text())
    for pick, id_ in zip(document["picks"], document["order"], strict=True):
        assert (pick["target"], pick["status"]) == (id_, "success")
        kept = load_plan(Path(pick["out"]))
        assert kept.scene.target.id == id_
    refused("plan", tmp_path, "--targets", "ripe")
