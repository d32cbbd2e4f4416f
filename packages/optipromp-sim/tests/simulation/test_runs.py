"""Plans executed: references, the Panda, the four scenarios, failures of the simulation itself."""

import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.robots.meshes import FACES, TETRAHEDRON

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import HalfSpace, MeshShape, PointCloudShape
from optipromp.core.planning import plan
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.scene import SceneObject
from optipromp_sim.simulation import Cause, SimulationParameters, catalogue, simulate
from optipromp_sim.simulation.execute import Moving
from optipromp_sim.simulation.files import write_run
from optipromp_sim.simulation.outcome import judge
from optipromp_sim.simulation.world import build

PLANNERS = {
    "scenario-1": "promp",
    "scenario-2": "i-promp",
    "scenario-3": "opti-promp",
    "scenario-4": "opti-promp",
}


@pytest.fixture(scope="module")
def plans():
    return {name: plan(name, planner=planner) for name, planner in PLANNERS.items()}


@pytest.fixture(scope="module")
def runs(plans):
    return {name: simulate(made) for name, made in plans.items()}


@pytest.mark.parametrize("name", PLANNERS)
def test_what_is_executed_is_the_plan_in_its_own_time(plans, runs, name):
    motion, rollout = plans[name].trajectory, runs[name].rollout
    before = SimulationParameters().engine.settle
    assert rollout.motion == pytest.approx(before + motion.duration, abs=2e-3)
    at = np.clip(rollout.times - before, 0.0, motion.duration)
    np.testing.assert_allclose(rollout.reference, motion.sample(at)[0], atol=1e-9)
    ratios = plans[name].metrics
    for kind in ("velocity", "acceleration", "jerk"):
        assert rollout.limit_use[kind] == getattr(ratios, f"{kind}_ratio")


def test_a_slowed_execution_takes_its_time(plans):
    made = plans["scenario-3"]
    slow = SimulationParameters().changed(control={"speed": 0.5})
    run = simulate(made, parameters=slow)
    moved = run.rollout.motion - slow.engine.settle
    assert moved == pytest.approx(2.0 * made.trajectory.duration, abs=2e-3)
    assert run.rollout.limit_use["velocity"] == pytest.approx(0.5 * made.metrics.velocity_ratio)


def test_the_panda_follows_its_plan(runs):
    outcome = runs["scenario-3"].outcome
    assert outcome.tracking_error < 5e-3
    assert outcome.limit_use["torque"] < 1.0
    assert outcome.limit_use["position"] <= 1.0
    assert outcome.warnings == ()
    assert outcome.cut is None
    assert "cut" not in outcome.to_dict()


@pytest.mark.parametrize("name", ["scenario-1", "scenario-2"])
def test_the_papers_first_scenarios_hit_the_table_top(runs, name):
    outcome = runs[name].outcome
    assert outcome.cause is Cause.STATIC_CONTACT
    assert outcome.message.count(";") == len(outcome.causes) - 1
    assert {contact.other for contact in outcome.static_contacts} == {"table-top"}


@pytest.mark.parametrize("name", ["scenario-3", "scenario-4"])
def test_the_papers_last_scenarios_touch_nothing_static_and_tear_nothing(runs, name):
    outcome = runs[name].outcome
    assert outcome.static_contacts == ()
    assert outcome.avoid_contacts == ()
    assert outcome.torn == ()
    assert outcome.success == (outcome.cause is None)
    assert outcome.cause == (outcome.causes or (None,))[0]
    assert outcome.success <= (bool(outcome.picked) and not outcome.swallowed_others)


def test_the_same_seed_gives_the_same_run_to_the_last_bit(plans, runs):
    first, second = runs["scenario-4"], simulate(plans["scenario-4"])
    for name, values in first.rollout.arrays().items():
        assert values.tobytes() == second.rollout.arrays()[name].tobytes(), name
    assert first.outcome == second.outcome


def test_a_number_that_stops_being_one_fails_the_run(bench, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    for bad in (np.nan, 1e30):
        run = bench.execution(scene)
        run.data.xfrc_applied[run.world.fruits[0].body, 0] = bad
        rollout, contacts = run.run(), run.records.log
        assert rollout.warnings
        assert rollout.times[-1] < 0.1
        assert np.isfinite(rollout.fruit_positions).all()
        outcome = judge(run.world, rollout, contacts)
        assert (outcome.success, outcome.cause) == (False, Cause.UNSTABLE)
        assert "simulation broke down" in outcome.message
    assert not list(tmp_path.glob("*.TXT"))


def test_every_shape_can_be_a_static_object(bench, tmp_path, monkeypatch):
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))
    vertices = np.vstack([TETRAHEDRON, TETRAHEDRON + [0.2, 0, 0]])  # two that share nothing
    faces = np.vstack([FACES, FACES + 4])
    cloud = np.random.default_rng(0).uniform(-0.1, 0.1, (200, 3))
    objects = [
        SceneObject("floor", "static", HalfSpace(), np.array([0.0, 0.0, -1.2])),
        SceneObject("hull", "static", MeshShape(TETRAHEDRON, FACES), np.array([0.8, 0, 0])),
        SceneObject("pair", "static", MeshShape(vertices, faces), np.array([0.8, 0.5, 0])),
        SceneObject("cloud", "static", PointCloudShape(cloud, 0.01), np.array([-0.8, 0.0, 0.0])),
    ]
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)), *objects)
    world = build(scene, resolve(scene).robot)
    names = [world.model.geom(i).name for i in range(world.model.ngeom)]
    assert sum(name.startswith("static:pair") for name in names) > 10
    assert sum(name.startswith("static:hull") for name in names) == 1
    assert sum(name.startswith("static:cloud") for name in names) == 200
    assert simulate(bench.still((0.3, 0.3, 0.0)), scene).outcome.static_contacts == ()


def test_wrong_requests_are_refused(bench, plans):
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    with pytest.raises(InvalidRequestError, match="needs the scene"):
        simulate(bench.still())
    with pytest.raises(InvalidRequestError, match="gantry has x, y, z"):
        simulate(plans["scenario-3"].trajectory, scene)
    with pytest.raises(InvalidRequestError, match="record_rate"):
        simulate(bench.still(), scene, record_rate=0.0)
    with pytest.raises(InvalidRequestError, match=r"StemParameters\.diameter is -1"):
        bench.parameters(stem={"diameter": -1.0})
    with pytest.raises(InvalidRequestError, match="avoid_as"):
        bench.parameters(thing={"avoid_as": "glass"})


def test_without_mujoco_the_error_says_what_to_install(bench, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(InvalidRequestError, match=r"pip install -e 'packages/optipromp-sim'"):
        simulate(bench.still(), bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5))))


def test_every_parameter_says_its_unit_and_its_source():
    entries = list(catalogue(SimulationParameters()))
    assert len(entries) > 40
    for entry in entries:
        assert entry.source, entry.name
        assert entry.kind in ("measured", "reported", "published", "guess", "choice")


def test_a_run_is_written_whole(runs, tmp_path):
    assert write_run(runs["scenario-4"], tmp_path) == ("rollout.npz", "outcome.json")
    document = json.loads((tmp_path / "outcome.json").read_text())
    assert document["success"] is runs["scenario-4"].success
    assert document["scene"] == "scenario-4"
    with np.load(tmp_path / "rollout.npz") as archive:
        assert archive["q"].shape[1] == 7
        assert archive["fruit_positions"].shape[1:] == (3, 3)
        assert list(archive["fruit_ids"]) == ["ripe", "n1", "n2"]


def test_the_docs_list_every_parameter():
    page = Path(__file__).resolve().parents[4] / "docs" / "simulation.md"
    text = page.read_text(encoding="utf-8")
    for entry in catalogue():
        assert f"| `{entry.name}` |" in text, entry.name
        if isinstance(entry.value, float):
            assert f"| `{entry.name}` | {entry.value:g} |" in text, entry.name


@pytest.fixture(scope="module")
def run(runs):
    return runs["scenario-4"]


def test_a_run_has_a_line_and_a_table(run):
    assert re.fullmatch(r"<Run in scenario-4: picked, nothing harmed, \d\.\d\d s>", repr(run))
    html = run._repr_html_()
    assert "target taken in" in html
    assert run.outcome.message in html
    assert html.count("<tr") > 5


def test_a_run_has_a_view_that_needs_no_network(run, tmp_path):
    pytest.importorskip("viser")
    view = run.show()
    assert not re.search(r"""(?:src|href)=["']https?:""", view.html)
    view.save(tmp_path / "run.html")
    assert 1e5 < (tmp_path / "run.html").stat().st_size < 6e6


def test_the_view_puts_fruits_where_they_were(run):
    moving = Moving(build(run.scene, run.robot, run.parameters, run.seed))
    rollout = run.rollout
    for row in (0, len(rollout.times) // 2, -1):
        at = {moved.item.id: moved for moved in moving.at(rollout.states[row])}
        for id_, position in zip(rollout.fruit_ids, rollout.fruit_positions[row], strict=True):
            np.testing.assert_allclose(at[id_].position, position, atol=1e-9)
        stem = at["n1"].stem
        ends = np.linalg.norm(stem[[0, -1]] - at["n1"].position, axis=1)
        assert ends[1] < 0.05 < ends[0]  # the root first
