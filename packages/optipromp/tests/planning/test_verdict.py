"""Status and harm of a trajectory are the same, whoever asks, and of the whole motion."""

import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.cli.fixtures import invoke
from tests.folders import rows, stated

from optipromp import OptiPrompError, judge, load_plan, write_plan
from optipromp.core.errors import Code, StartInvalidError
from optipromp.core.judging import centers
from optipromp.core.planning import PlanOptions, plan
from optipromp.core.planning.result import best_of
from optipromp.core.planning.task import resolve, spaced
from optipromp.core.planning.verdict import predicted, verdict_of
from optipromp.core.scenes import Scene, SceneObject, load_scene
from optipromp.core.trajectory import State, Trajectory
from optipromp.looks.reports import plan_report
from optipromp_sim.generate import generate

LOW = np.array([0.0, -0.3, 0.0, -2.2, 0.0, 3.0, 0.8])  # as in docs/scene-format.md
SEARCHED = Code.TIMEOUT, Code.GOAL_IN_COLLISION, Code.GOAL_UNREACHABLE, Code.NO_PLAN


def moved(scene: Scene, by: np.ndarray, **changes: Any) -> Scene:
    """The scene with its fruits elsewhere, and nothing else in it."""
    fruits = (o for o in scene.objects if o.role in ("target", "pushable"))

    return replace(scene, objects=tuple(o.at(o.position + by) for o in fruits), **changes)


def last_link(scene: Scene, q: np.ndarray) -> np.ndarray:
    """The middle of the last link's spheres (3,)."""
    robot = resolve(scene).robot
    own = np.asarray(robot.spheres.link) == robot.link_names.index("link7")
    return np.asarray(centers(robot, q[None])[0][own].mean(axis=0))


# --- where it begins -----------------------------------------------------------------------------


@pytest.mark.parametrize("preset", ["cluster", "truss", "table-top"])
@pytest.mark.parametrize("seed", range(3))
def test_no_motion_begins_with_the_last_link_in_a_fruit(preset: Any, seed: int) -> None:
    """Robustness 2: it was a success with harm 0.00, and 1,231 N in the simulation."""
    scene = generate(preset, seed)
    into = last_link(scene, LOW) + [0.05, 0.0, 0.0] - scene.target.position
    inside = moved(scene, into, start=LOW)
    made = plan(inside, seed=seed)
    assert made.status is Code.START_IN_COLLISION
    assert re.search(r"at the start .*link7 enters ripe \(target\) by \d+\.\d mm", made.message)
    assert ("link7", "ripe") in {(c.link, c.other) for c in made.contacts}
    reach = plan(scene, seed=seed).trajectory  # of another scene, but from wherever it begins
    still = Trajectory.through(np.vstack([LOW, LOW + 1e-3, reach.positions[-1]]), 1.0,
                               reach.joint_names)  # fmt: skip
    for motion in (made.trajectory, still):
        found = judge(inside, motion)
        assert found.status is Code.START_IN_COLLISION
        assert found.message == made.message


@pytest.mark.parametrize(("preset", "seed"), [("cluster", 3), ("table-top", 1)])
def test_what_the_last_link_strikes_on_its_way_is_harmed(preset: Any, seed: int) -> None:
    """It begins beside the fruits; in the simulation it tore one off, with a harm of 0.2 and 0.4
    by the model, which is led as slowly as the tool goes among fruits.
    """
    scene = generate(preset, seed)
    beside = last_link(scene, LOW) + [0.052, 0.0, 0.0455] - scene.target.position
    near = moved(scene, beside, start=LOW)
    made = plan(near, seed=seed)
    assert made.status is Code.HARM_PREDICTED
    assert re.search("the stem of n[12] is struck by link7 before the approach", made.message)
    found = judge(made.scene, made.trajectory)
    assert (found.status, found.prediction) == (made.status, made.prediction)


def test_what_is_in_the_mouth_is_not_in_the_tool() -> None:
    """And the outside of the cup may brush a fruit by as much as its spheres stand out of it."""
    made = plan("scenario-3")
    end = made.trajectory.positions[-1]
    alone = replace(made.scene, objects=(made.scene.target,), start=end)
    assert plan(alone).success
    aside = made.scene.frame[0] * (made.robot.gripper_radius + made.scene.target.radius)
    for share, status in ((1.0, Code.SUCCESS), (0.7, Code.START_IN_COLLISION)):
        beside = SceneObject("n", "pushable", made.scene.target.shape,
                             made.scene.target.position + share * aside)  # fmt: skip
        assert plan(replace(alone, objects=(*alone.objects, beside))).status is status


@pytest.mark.parametrize("share", [0.6, 0.8, 0.95])
def test_a_motion_that_goes_on_may_begin_among_fruits(share: float) -> None:
    first = plan("scenario-3")
    at = share * first.trajectory.duration
    state = first.trajectory.at(at)
    assert plan(first.scene, previous=first, at=at).success
    for given_ in (state, State(state.q)):
        assert plan(first.scene, start_state=given_).status is not Code.START_IN_COLLISION
    stated = plan(replace(first.scene, start=state.q)).status
    assert stated is Code.START_IN_COLLISION or share < 0.7


# --- the whole motion ----------------------------------------------------------------------------


def test_a_fruit_that_is_met_before_the_approach_counts() -> None:
    made = plan("scenario-3")
    task = resolve(made.scene)
    model = task.push_model(made.trajectory.positions[-1])
    assert made.prediction is not None
    assert model is not None
    tips, _ = made.robot.tool_pose(made.trajectory.positions)
    where = tips[made.first // 2] + [0.0, 0.0, 0.02]  # where the rim passes on its way
    by_the_way = replace(
        next(o for o in made.scene.objects if o.id == "n1"), id="low", position=where, stem=None
    )
    root = where + [0.0, 0.0, 0.15]
    hung = replace(by_the_way, stem=replace(made.scene.target.stem, points=np.array([where, root])))  # type: ignore[union-attr,type-var]
    more = replace(made.scene, objects=(*made.scene.objects, hung))
    harm = predicted(resolve(more), made.trajectory)
    assert harm.harmful
    assert harm.object == "low"


def test_what_is_clear_is_left_alone() -> None:
    """Led through a motion that is clear of them, at any lean, no fruit moves."""
    rng, clear = np.random.default_rng(0), 0
    for seed in range(8):
        scene = generate("cluster", seed)
        model = resolve(scene).push_model(resolve(scene).robot.home)
        before = {o.id: o.position for o in scene.objects}
        for _ in range(12):
            axis = rng.standard_normal(3)
            ends = scene.target.position + rng.uniform(-0.35, 0.35, (2, 3))
            motion = spaced(ends, np.tile(axis / np.linalg.norm(axis), (2, 1)))
            if not model.clear(*motion):
                continue
            clear += 1
            found = model.moved(*motion)
            for name, place in zip(found.ids, found.positions, strict=True):
                np.testing.assert_allclose(place, before[name], atol=1e-9)
    assert 20 < clear < 80


def test_rows_far_apart_are_followed_along_their_curve() -> None:
    """A motion by few rows meets what the same motion by many rows meets."""
    made = plan("scenario-3")
    few = replace_rows(made.trajectory, 12)
    many = Trajectory(*(lambda t: (t, *few.sample(t)))(np.linspace(0.0, few.duration, 600)),
                      few.joint_names)  # fmt: skip
    task = resolve(made.scene)
    found, wanted = (predicted(task, motion) for motion in (few, many))
    assert found.harm == pytest.approx(wanted.harm, abs=0.15)


def replace_rows(motion: Trajectory, count: int) -> Trajectory:
    """The motion by ``count`` of its rows."""
    kept = np.unique(np.linspace(0, motion.n_waypoints - 1, count).round().astype(int))
    return Trajectory(motion.times[kept], *motion.rows(kept), motion.joint_names)


# --- whoever asks --------------------------------------------------------------------------------


Told = tuple[str, float | None]


def scenes() -> st.SearchStrategy[Scene]:
    """Scenes with other starts, camera distances and detection errors."""

    def drawn(name: str, seed: int, start: int, camera: float, sure: bool) -> Scene:
        scene = generate(name, seed) if name != "scenario-3" else load_scene(name)  # type: ignore[arg-type]
        scene = replace(scene, approach=replace(scene.approach, camera_distance=camera))
        if not sure:
            seen = (o if o.stem is None else replace(o, covariance=2.5e-5 * np.eye(3))
                    for o in scene.objects)  # fmt: skip
            scene = replace(scene, objects=tuple(seen))
        home = resolve(scene).start
        if start == 1:
            return replace(scene, start=LOW)
        if start == 2:
            return replace(scene, start=home + 0.15 * np.sin(np.arange(len(home)) + seed))
        if start == 3 and scene.target is not None:
            return moved(scene, last_link(scene, home) + [0.0, 0.05, 0.02] - scene.target.position)
        return replace(scene, start=None) if start == 4 else scene

    names = st.sampled_from(
        ["scenario-3", "cluster", "table-top", "side-clusters", "truss", "mixed"]
    )
    cameras, sure = st.sampled_from([0.02, 0.1, 0.4, 5.0]), st.sampled_from([True, True, False])
    return st.builds(drawn, names, st.integers(0, 40), st.integers(0, 4), cameras, sure)


NO_HARM = {"harm": 0.0, "threshold": 1.0, "object": "", "cause": "nothing is harmed"}
TAMPERED: dict[str, Callable[[Path], None]] = {
    "nothing": lambda folder: None,
    "status": lambda folder: stated(folder, status="success", predicted_harm=NO_HARM),
    "harm": lambda folder: stated(folder, predicted_harm=NO_HARM),
    "shifted": lambda folder: rows(
        folder, lambda a: a | {"positions": a["positions"] + 0.01}
    ),
    "bent": lambda folder: rows(
        folder, lambda a: a | {"positions": a["positions"] + 0.02
                               * np.sin(np.linspace(0.0, np.pi, len(a["times"])))[:, None]}
    ),
    "csv": lambda folder: (folder / "trajectory.csv").write_bytes(b"time\n") and None,
}  # fmt: skip


def asked(folder: Path, report: bool) -> dict[str, Told]:
    """What each reader of a plan's folder tells: its status and harm, or the code of its error."""
    out = dict[str, Told]()
    try:
        found = load_plan(folder)
        out["load_plan"] = str(found.status), found.prediction and found.prediction.harm
    except OptiPrompError as error:
        out["load_plan"] = f"error {error.code}", None
    for command in ("check", "validate"):
        document = json.loads(invoke(command, folder, "--json").stdout)
        harm = document.get("predicted_harm")
        failed = "metrics" not in document and "duration" not in document
        status = f"error {document['status']}" if failed else document["status"]
        out[command] = status, harm["harm"] if isinstance(harm, dict) else harm
    if report:
        try:
            page = plan_report(folder).decode()
            status = re.search(r'<p class="status \w+">(\w+), the reach in', page)
            harm = re.search(r"harm (\d+\.\d\d) of at most", page)
            out["report"] = status[1], None if harm is None else float(harm[1])
        except OptiPrompError as error:
            out["report"] = f"error {error.code}", None
    return out


def assert_one_verdict(
    scene: Scene, seed: int, again_at: float | None, tampered: str, report: bool = False
) -> None:
    options = PlanOptions(effort=40, timeout=float("inf"))
    made = plan(scene, seed=seed, options=options)
    if again_at is not None and made.trajectory.duration > 0.5:
        at = again_at * made.trajectory.duration
        q, robot = made.trajectory.at(at).q, made.robot
        if np.all((robot.lower <= q) & (q <= robot.upper)):
            made = plan(scene, seed=seed, options=options, previous=made, at=at)
        else:  # the best trajectory of a plan that failed; no arm is there
            with pytest.raises(StartInvalidError):
                plan(scene, seed=seed, options=options, previous=made, at=at)
    harm = made.prediction and made.prediction.harm
    verdict = verdict_of(made)
    verdicts = [verdict]
    if made.start is None:
        verdicts.append(judge(made.scene, made.trajectory, robot=made.robot))
    for found in verdicts:
        assert found.prediction == made.prediction
        if made.status in SEARCHED:
            assert made.status is not Code.GOAL_UNREACHABLE or found.status is not Code.SUCCESS
        else:
            assert found.status is made.status, (made.message, found.message)
    with TemporaryDirectory() as name:
        folder = Path(name)
        write_plan(made, folder, rate=50.0)
        TAMPERED[tampered](folder)
        told = asked(folder, report)
    if tampered == "nothing":
        judged = str(verdict.status) if made.status in SEARCHED else str(made.status)
        wanted = {"load_plan": (str(made.status), harm), "check": (str(made.status), harm),
                  "validate": (judged, harm)}  # fmt: skip
        assert {k: v for k, v in told.items() if k != "report"} == wanted
        if report:
            assert told["report"] == (str(made.status), harm if harm is None else round(harm, 2))
        return
    readers = {told[reader] for reader in ("load_plan", "check")}
    assert len(readers) == 1
    if told["validate"][0] == "success":  # a motion that is bent may be one
        assert verdict.status is Code.SUCCESS or tampered == "bent"
    if told["load_plan"][0].startswith("error"):
        assert told["validate"] == told["load_plan"]
    if tampered == "status" and verdict.status is not Code.SUCCESS:
        assert told["check"] == ("error INVALID_PLAN", None)
    if tampered == "harm":
        assert told["check"][1] == harm
    if tampered == "csv":
        assert told["check"] == ("error INVALID_REQUEST", None)


DRAWN = given(
    scenes(), st.integers(0, 3), st.none() | st.floats(0.05, 0.95), st.sampled_from([*TAMPERED])
)


@settings(max_examples=25, deadline=None)
@DRAWN
def test_whoever_asks_is_told_the_same(scene, seed, again_at, tampered):
    """Robustness 3 to 5."""
    assert_one_verdict(scene, seed, again_at, tampered)


@pytest.mark.parametrize("which", ["scenario-3", "shelf"])
def test_the_report_is_told_the_same(which: str) -> None:
    scene = load_scene(which) if which == "scenario-3" else generate("shelf", 5)
    assert_one_verdict(scene, 0, None, "nothing", report=True)


@pytest.mark.slow
@settings(max_examples=150, deadline=None)
@DRAWN
def test_whoever_asks_is_told_the_same_at_length(scene, seed, again_at, tampered):
    assert_one_verdict(scene, seed, again_at, tampered, report=tampered == "nothing")


# --- the one loop, and what a plan says ----------------------------------------------------------


def test_the_best_motion_is_the_first_of_least_rank_and_no_more_are_made() -> None:
    asked = []

    def motions() -> Iterator[tuple[int, str]]:
        for one in ((3, "a"), (1, "b"), (1, "c"), (0, "d"), (0, "e")):
            asked.append(one[1])
            yield one

    assert best_of(motions(), lambda one: one[0]) == (0, "d")
    assert asked == [*"abcde"]
    asked.clear()
    assert best_of(motions(), lambda one: one[0], lambda best: best[0] <= 1) == (1, "b")
    assert asked == [*"ab"]
    assert best_of(motions(), lambda one: one[0], best=(0, "before")) == (0, "before")
    assert best_of(iter(()), lambda one: one) is None


def test_the_notes_of_a_plan_are_fields_and_its_message_has_them(tmp_path: Path) -> None:
    """They were glued into the message, and cut out again where they were in the way."""
    made = plan("scenario-3")
    verdict = verdict_of(made)
    assert made.notes == verdict.notes != ()
    assert "note" not in made.reason
    assert made.message == "; note: ".join([made.reason, *made.notes]) == verdict.message
    assert made.notes[-1].startswith("by guessed limits: fruit ")
    unpushed = replace(
        verdict,
        prediction=replace(
            verdict.prediction, tell=lambda: verdict.prediction.told._replace(forces={})
        ),
    )
    assert unpushed.notes == verdict.judgement.notes  # where nothing is pushed there is no limit
    assert made.judgement.violations == ()
    assert made.to_dict()["message"] == made.message
    write_plan(made, tmp_path)
    again = load_plan(tmp_path)
    assert (again.message, again.reason, again.notes) == (made.message, made.reason, made.notes)
    assert again.judgement.metrics.to_dict() == made.metrics.to_dict()
    assert again.contacts == again.judgement.contacts == ()
    document = json.loads((tmp_path / "plan.json").read_text())
    del document["reason"], document["notes"]  # as older files are
    (tmp_path / "plan.json").write_text(json.dumps(document))
    assert load_plan(tmp_path).message == made.message
