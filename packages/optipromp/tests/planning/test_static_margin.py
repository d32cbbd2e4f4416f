"""Static things are not traded: a plan has room beside them, or tells what it lacks."""

from dataclasses import replace
from typing import Any

import pytest
from tests.planning.builders import block, without

from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.geometry import Box
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes import load_scene
from optipromp_paper.paper import Paper
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

MARGIN = judging.STATIC_MARGIN


def room(made: Plan) -> float:
    assert made.metrics.clearance_static is not None
    return made.metrics.clearance_static


def test_beside_a_table_top_a_plan_has_the_room_that_a_controller_needs() -> None:
    tried = [plan("paper-4", seed=seed) for seed in (25, 26, 27, 55, 56, 57)]
    taken = [made for made in tried if made.success]
    assert sum(room(made) >= MARGIN for made in taken) >= 5  # of seed 26 no clean path has it
    for made in taken:
        assert (room(made) < MARGIN) == ("a controller needs" in made.message)


def test_what_is_taken_goes_well_in_the_simulation() -> None:
    outcome = simulate(plan("paper-4", seed=1)).outcome
    assert outcome.success, outcome.message
    assert outcome.static_contacts == ()


@pytest.mark.parametrize("strategy", ["joint", "sequential"])
@pytest.mark.parametrize("seed", [3, 7])
def test_the_paper_s_planner_heeds_it_too(strategy: Any, seed: int) -> None:
    made = plan("paper-4", planner=Paper(strategy=strategy), seed=seed)
    assert made.status in (Code.SUCCESS, Code.HARM_PREDICTED)
    assert room(made) >= MARGIN


def test_where_none_has_room_the_best_is_a_success_with_a_note() -> None:
    """In this shelf the wrist is 4.1 mm over the board at the goal, whatever the elbow does."""
    made = plan(generate("shelf", 30009))
    assert made.status is Code.SUCCESS
    assert 0.0 < room(made) < MARGIN
    wanted = f"link7 comes within {1e3 * room(made):.1f} mm of board; a controller needs about 5 mm"
    assert f"note: {wanted}" in made.message


def test_a_target_close_to_a_wall_is_not_searched_for_room() -> None:
    """The cover of the cup is 3 mm from the wall at the goal, in whatever configuration."""
    three = without(load_scene("scenario-3"), "avoid", "pushable")
    at = three.target.position + [0.0, 0.078, 0.0]
    wall = block("static", Box((0.4, 0.04, 0.1)), at, "wall")
    scene = replace(three, objects=(*three.objects, wall))
    made = plan(scene)
    assert made.status is Code.SUCCESS, made.message
    assert 0.0 < room(made) < MARGIN
    assert "note: tool comes within " in made.message
    assert "of wall; a controller needs" in made.message
