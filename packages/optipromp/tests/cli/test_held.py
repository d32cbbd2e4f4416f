"""Held and touchable things on the command line: planned, judged and carried."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from tests.cli.fixtures import completed, invoke, told

from optipromp.core.output import load_plan
from optipromp.core.planning.collision import free
from optipromp.core.planning.task import posed
from optipromp.core.scenes import scene_from_dict

SHOWN = Path(__file__).parents[4] / "docs/scene-format.md"


@pytest.fixture
def document() -> dict[str, Any]:
    """The scene of docs/scene-format.md: a punnet on the neck of a cup that may touch a board."""
    blocks = SHOWN.read_text().split("```yaml\n")[1:]
    (text,) = [block.split("```")[0] for block in blocks if "attached:" in block]
    found: dict[str, Any] = yaml.safe_load(text)
    return found


def planned(document: dict[str, Any], folder: Path) -> Any:
    (folder / "held.yaml").write_text(yaml.safe_dump(document))
    return invoke("plan", folder / "held.yaml", "--no-figures", "--out", folder / "plan", "--json")


def test_the_cup_goes_to_the_board_that_it_may_touch_and_the_punnet_goes_along(document, tmp_path):
    result = planned(document, tmp_path)
    assert result.exit_code == 0, result.stdout
    assert json.loads(result.stdout)["metrics"]["clearance_static"] > 0.0
    plan = load_plan(tmp_path / "plan")
    assert plan.robot.link_names[-2:] == ("punnet", "tool")
    assert len(free(plan.task, plan.trajectory.positions)) == len(plan.trajectory.positions)
    completed("check", tmp_path / "plan")
    (touch,) = told("simulate", tmp_path / "plan")["static_contacts"]
    assert (touch["link"], touch["other"]) == ("tool", "board")
    del document["may_touch"]
    assert json.loads(planned(document, tmp_path).stdout)["status"] == "GOAL_IN_COLLISION"


def test_more_padding_leads_the_arm_farther_away(document: dict[str, Any], tmp_path: Path) -> None:
    del document["padding"]
    post = document["objects"][1]
    post |= {"shape": {"sphere": {"radius": 0.03}}, "position": [0.35, 0.15, 0.5]}
    rooms = []
    for padding in (0.0, 0.05):
        post["padding"] = padding
        folder = tmp_path / f"{padding}"
        folder.mkdir()
        result = planned(document, folder)
        assert result.exit_code == 0, result.stdout
        rooms.append(json.loads(result.stdout)["metrics"]["clearance_static"] + padding)
    assert rooms[1] > 0.05
    assert rooms[1] > rooms[0]


def test_the_simulation_carries_the_mass(document: dict[str, Any], tmp_path: Path) -> None:
    """The joints' torques grow as the held mass asks, by the engine's own sum of forces."""
    mujoco = pytest.importorskip("mujoco")
    from optipromp_sim.simulation.world import build

    torques = {}
    for mass in (0.4, 2.4):
        document["attached"][0]["mass"] = mass
        scene = scene_from_dict(document)
        robot, state = posed(scene)
        world = build(scene, robot)
        assert world.model.body("attached:punnet").mass == pytest.approx(mass)
        data = world.data(state.q)
        mujoco.mj_forward(world.model, data)
        torques[mass] = np.array(data.qfrc_bias[: robot.n_segments])
        body = world.model.body("attached:punnet").id
        jacobian = np.zeros((3, world.model.nv))
        mujoco.mj_jac(world.model, data, jacobian, None, data.xipos[body], body)
    more = torques[2.4] - torques[0.4]
    wanted = 2.0 * 9.81 * jacobian[2, : len(more)]
    assert np.abs(more - wanted).max() < 0.02 * np.abs(wanted).max()
