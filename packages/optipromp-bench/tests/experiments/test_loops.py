"""Loops under conditions: what they are given, what they executed, and how they are counted."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.arrays import frame_along
from optipromp.core.errors import InvalidRequestError
from optipromp.core.execution.streaming import Stretch
from optipromp.core.robots.library import load_robot
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import bare_robot
from optipromp.core.trajectory import State, Trajectory
from optipromp_bench.experiments.rows import STUDY, Row, row_of
from optipromp_bench.experiments.statistics import ALL, loop_summary, summary, wilson
from optipromp_bench.experiments.study import Study, run_study
from optipromp_bench.experiments.trials import again
from optipromp_sim.generate import NOISES, generate, noisy
from optipromp_sim.simulation import Simulation
from optipromp_sim.simulation.detector import DETECTORS, Detector, Truth
from optipromp_sim.situations import (
    CAMERA_OFF,
    CONDITIONS,
    LOOPS,
    SETTLE,
    cut,
    drop_one,
    executed,
    miscalibrated,
    seen_at_once,
)

ROW = Row(
    preset="cluster", seed=0, planner="opti-promp", noise_position=0.0, noise_angle=0.0,
    pushables=2, redraws=0, plan_status="success", success=True, picked=True, duration=8.0,
    unripe_force=1.0, loop="closed", condition="sway", result="clean", retreats=1, looks=100,
    cycle_median=0.002, cycle_p99=0.01, nis=3.0, worst_jump=1e-9, worst_limit=0.8,
)  # fmt: skip


def small(**changes) -> Study:
    given = {
        "presets": ("cluster", "mixed"), "planners": ("opti-promp",), "seeds": (0, 2),
        "loops": ("open", "closed"), "conditions": ("none", "sway"),
    }  # fmt: skip
    return Study(**{**given, **changes})


# --- conditions ---------------------------------------------------------------------------------


def test_the_conditions_differ_and_repeat_to_the_bit() -> None:
    scene = generate("cluster", 3)
    made = {name: condition(scene, 3) for name, condition in CONDITIONS.items()}
    again = {name: condition(scene, 3) for name, condition in CONDITIONS.items()}
    assert len(made) == 17
    for name, setting in made.items():
        assert (setting.scene is scene) == (name != "larger")
        assert setting.detector == again[name].detector
        assert setting.parameters == again[name].parameters
        for one, other in zip(setting.seen.objects, again[name].seen.objects, strict=True):
            assert one.id == other.id
            assert np.array_equal(one.position, other.position)
    wider = [item.radius for item in made["larger"].scene.objects if item.stem is not None]
    usual = [item.radius for item in scene.objects if item.stem is not None]
    np.testing.assert_allclose(wider, 1.15 * np.array(usual))
    told = {
        (s.detector, s.parameters, len(s.seen.objects), s.scene is scene) for s in made.values()
    }
    assert len(told) == 17


@pytest.mark.parametrize("seed", range(4))
def test_a_missed_pushable_is_one_of_the_three_nearest(seed: int) -> None:
    scene = generate("mixed", seed)
    target = scene.target
    (lost,) = {item.id for item in scene.objects} - {x.id for x in drop_one(scene, seed).objects}
    away = sorted(
        (float(np.linalg.norm(item.position - target.position)), item.id)
        for item in scene.pushables
    )
    parents = {item.stem.parent for item in scene.objects if item.stem is not None}
    assert lost in [name for _, name in away if name not in parents][:3]


def test_without_a_pushable_nothing_is_missed() -> None:
    scene = generate("cluster", 0)
    alone = replace(scene, objects=tuple(x for x in scene.objects if x.role != "pushable"))
    assert drop_one(alone, 0) is alone


def test_a_miscalibrated_camera_errs_at_first_as_it_does_later() -> None:
    """Without other errors, a look from where the first was made shows the scene as first seen."""
    scene = generate("cluster", 1)
    target = scene.target
    detector = replace(DETECTORS["perfect"], mount="beside", view=3.0, **CAMERA_OFF)
    seen = miscalibrated(scene, scene, detector, 5)
    eye = Detector(scene, bare_robot(scene), detector, 5)
    approach = scene.frame[2]
    eye.camera = lambda q: Pose(target.position - 0.3 * approach, frame_along(approach))
    look = eye.expose(0.0, bare_robot(scene).home, Truth((), np.zeros((0, 3)), (), ()))
    found = {item.id: item.position for item in look.in_base()}
    fruits = [item for item in seen.objects if item.role != "static"]
    for item, true in zip(fruits, (o for o in scene.objects if o.role != "static"), strict=True):
        np.testing.assert_allclose(found[item.id], item.position, atol=1e-9)
        assert 1e-4 < float(np.linalg.norm(item.position - true.position)) < 0.03


def test_plants_that_sway_are_first_seen_where_the_settled_fruits_are() -> None:
    pytest.importorskip("mujoco")
    scene = generate("mixed", 2)
    setting = CONDITIONS["sway"](scene, 2)
    simulation = Simulation(scene, 2, setting.parameters)
    start = State(simulation.state().q)
    while simulation.time < SETTLE - 1e-9:
        simulation.step(start)
    fruits = simulation.fruits()
    seen = {item.id: item for item in setting.seen.objects}
    away = []
    for item, now in zip(fruits.ids, fruits.positions, strict=True):
        np.testing.assert_allclose(seen[item].position, now, atol=1e-6)
        true = next(other for other in scene.objects if other.id == item)
        away.append(float(np.linalg.norm(seen[item].position - true.position)))
        shift = seen[item].position - true.position
        np.testing.assert_allclose(seen[item].stem.points, true.stem.points + shift, atol=1e-9)
    assert 1e-3 < max(away) < 0.06


def test_all_at_once_is_first_seen_as_stems_are_believed_to_be() -> None:
    """The plants sway before the first look; that stems are softer shows in the run alone."""
    pytest.importorskip("mujoco")
    scene = generate("cluster", 0)
    made = CONDITIONS["all"](scene, 0)
    swaying = CONDITIONS["sway"](scene, 0).parameters
    believed = seen_at_once(noisy(scene, 0, NOISES["detector"]), scene, 0, swaying)
    believed = drop_one(miscalibrated(believed, scene, made.detector, 0), 0)
    assert [item.id for item in made.seen.objects] == [item.id for item in believed.objects]
    for one, other in zip(made.seen.objects, believed.objects, strict=True):
        np.testing.assert_array_equal(one.position, other.position)
    assert made.parameters.stem.youngs_modulus == swaying.stem.youngs_modulus / 3.0


# --- executed curves ----------------------------------------------------------------------------


def move(q: np.ndarray, by: float, seconds: float) -> Trajectory:
    rows = q + np.linspace(0.0, by, 9)[:, None] * np.eye(len(q))[0]
    return Trajectory.through(rows, seconds / 8.0, load_robot("panda").joint_names)


def test_a_cut_curve_is_the_same_curve() -> None:
    curve = move(load_robot("panda").home, 0.4, 2.0)
    part = cut(curve, 0.77)
    assert part.duration == 0.77
    at = np.linspace(0.0, 0.77, 50)
    for one, other in zip(part.sample(at), curve.sample(at), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    assert cut(curve, 3.0) is curve
    assert cut(curve, 0.0) is None


def test_jumps_and_rates_are_those_of_the_executed_parts() -> None:
    robot = load_robot("panda")
    slow, start = move(robot.home, 0.2, 2.0), State(robot.home)
    whole = executed([Stretch(slow, 0.0)], robot, start)
    none = executed([], robot, start)
    assert not none.shares.any()
    assert not none.jumps.any()
    assert whole.jumps.max() < 1e-12
    assert 0.0 < whole.shares.max() < 1.0
    # the same curve again, from its middle on: no jump, the same rates
    times = np.linspace(0.0, 1.0, 9)
    rest = Trajectory(times, *slow.sample(times + 1.0), robot.joint_names)
    joined = executed([Stretch(slow, 0.0), Stretch(rest, 1.0)], robot, start)
    assert joined.jumps.max() < 1e-12
    np.testing.assert_allclose(joined.shares[:2], whole.shares[:2], rtol=1e-2)
    # from rest at the middle: position goes on, the velocity drops to 0
    middle = slow.at(1.0)
    stop = Trajectory.through(np.tile(middle.q, (3, 1)), 0.5, robot.joint_names)
    broken = executed([Stretch(slow, 0.0), Stretch(stop, 1.0)], robot, start)
    assert broken.jumps[0] < 1e-12
    assert broken.jumps[1] == pytest.approx(np.abs(middle.velocity).max())
    # a fast curve that is replaced before it moves counts for nothing
    fast = move(robot.home, 2.0, 0.2)
    assert executed([Stretch(fast, 0.0)], robot, start).shares.max() > 1.0
    early = executed([Stretch(fast, 0.0), Stretch(slow, 0.0)], robot, start)
    assert early.shares.max() == pytest.approx(whole.shares.max())
    begun = executed([Stretch(slow, 0.0)], robot, start, until=0.2)
    assert begun.shares.max() < whole.shares.max()


# --- studies ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"loops": ("close",)}, "did you mean 'closed'"),
        ({"conditions": ("sways",)}, "did you mean 'sway'"),
        ({"loops": ("open", "open")}, "loop is named twice"),
        ({"conditions": ("sway", "sway")}, "condition is named twice"),
        ({"conditions": ()}, "no condition"),
        ({"planners": ("straight",)}, "loops have one, opti-promp"),
        ({"noise": "low"}, "no noise"),
        ({"vary": True}, "variations"),
        ({"only_valid": True}, "refusals"),
        ({"loops": ()}, "conditions are of loops"),
    ],
)
def test_wrong_studies_of_loops_are_refused(change, named) -> None:
    with pytest.raises(InvalidRequestError, match=named):
        small(**change)


def test_rows_from_before_the_loops_stay_readable() -> None:
    columns = list(STUDY)
    old = columns[: columns.index("loop")]
    plain = replace(ROW, loop="", condition="", result="")
    texts = {
        name: "" if getattr(plain, name) is None else str(getattr(plain, name)) for name in old
    }
    row = row_of(texts)
    assert row.loop == row.condition == ""
    assert row.retreats is None
    assert row.key == ("cluster", 0, "opti-promp", "", "", "", "")


def test_cells_count_results_and_pool_the_presets() -> None:
    rows = [
        ROW,
        replace(ROW, seed=1, result="harmed", success=False, causes="crushed not_picked"),
        replace(ROW, preset="mixed", result="gave_up", success=False, cause="not_picked"),
        replace(ROW, preset="mixed", seed=1, result="refused", success=False, cause="no_plan",
                   duration=None, nis=None, cycle_p99=0.03),
        replace(ROW, preset="mixed", loop="open", result="missed", success=False,
                cause="not_picked"),
    ]  # fmt: skip
    cells = {(cell.preset, cell.loop): cell for cell in loop_summary(rows)}
    assert list(cells) == [
        ("cluster", "closed"), ("mixed", "closed"), ("mixed", "open"), (ALL, "closed"),
        (ALL, "open"),
    ]  # fmt: skip
    cell = cells[ALL, "closed"]
    assert (cell.runs, cell.clean, cell.harmed, cell.gave_up, cell.refused) == (4, 1, 1, 1, 1)
    assert (cell.rate, cell.low, cell.high) == (0.25, *wilson(1, 4))
    assert cell.causes == {"not_picked": 2, "crushed": 1, "no_plan": 1}
    assert (cell.retreats, cell.cycle_p99, cell.nis, cell.duration) == (4, 0.03, 3.0, 8.0)
    assert cells["mixed", "open"].missed == 1
    assert len(loop_summary(rows[:2])) == 1  # one preset is not pooled
    assert [(cell.preset, cell.planner) for cell in summary(rows)] == [
        ("sway", "closed"), ("sway", "open"),
    ]  # fmt: skip


@pytest.mark.slow
def test_every_loop_runs_and_tells_its_figures(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    chosen = small(presets=("mixed",), seeds=(0, 1), loops=LOOPS, conditions=("none",))
    rows = {row.loop: row for row in run_study(chosen, tmp_path, workers=1)}
    assert tuple(rows) == LOOPS
    for row in rows.values():
        assert row.result in ("clean", "harmed", "gave_up", "missed", "refused"), row.message
        assert row.success is (row.result == "clean")
        assert row.condition == "none"
    assert rows["open"].looks is None
    assert rows["open"].plan_time > 0.0
    row = rows["closed"]
    assert row.looks > 10
    assert 0.0 < row.cycle_median <= row.cycle_p99
    assert row.worst_jump < 1e-6
    assert 0.0 < row.worst_limit <= 1.0 + 1e-9
    with (tmp_path / "rows.csv").open() as stream:
        assert [line["loop"] for line in csv.DictReader(stream)] == list(LOOPS)
    repeated = again(rows["closed"])
    assert repeated.outcome.duration == rows["closed"].duration
    assert repeated.outcome.success == rows["closed"].success
