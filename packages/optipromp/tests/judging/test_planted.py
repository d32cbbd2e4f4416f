"""Faults planted in real plans: the judge finds each, wherever it is.

The curve is sampled with SciPy here, the bodies are placed by the planner's kernels. The variable
PLANTED sets how many cases each fault has (docs/judged.md).
"""

import os
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from hypothesis import assume, given, reject, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly
from tests.judging.builders import obj

from optipromp.core import judging
from optipromp.core.geometry import Sphere
from optipromp.core.planning import Plan, plan
from optipromp.core.scenes import Scene, Stem, load_scene
from optipromp.core.trajectory import State, Trajectory
from optipromp_sim.generate import generate

SCENES = ("scenario-3", "scenario-4", "cluster 0", "cluster 3", "cluster 2", "mixed 4")
often = settings(max_examples=int(os.environ.get("PLANTED", "25")), deadline=None)
whichever = st.integers(0, len(SCENES) - 1)
seeds = st.integers(0, 10**6)


@lru_cache
def planned(which: int) -> Plan:
    name, _, seed = SCENES[which].partition(" ")
    made = plan(generate(name, int(seed)) if seed else load_scene(name))
    assert made.success
    assert not faults(made)
    return made


def faults(made: Plan, scene: Scene | None = None, **other: Any) -> list[judging.Violation]:
    given_ = {"robot": made.robot, "trajectory": made.trajectory, **other}
    scene = scene or made.scene
    state = State(given_["trajectory"].positions[0])
    side = made.prediction is None
    return list(judging.judge(scene, start=state, stem_side=side, **given_).violations)


def curve(trajectory: Trajectory) -> Any:
    rows = [trajectory.positions, trajectory.velocities, trajectory.accelerations]
    return BPoly.from_derivatives(trajectory.times, np.stack(rows, axis=1))


def unit(rng: np.random.Generator) -> np.ndarray:
    out = rng.normal(size=3)
    return np.asarray(out / np.linalg.norm(out))


def with_pin(scene: Scene, at: np.ndarray, radius: float) -> Scene:
    return replace(scene, objects=(*scene.objects, obj("static", Sphere(radius), at, name="pin")))


@given(whichever, seeds, st.floats(1e-6, 0.02), st.floats(1e-3, 0.05))
@often
def test_a_waypoint_that_penetrates(which: int, seed: int, depth: float, radius: float) -> None:
    made, rng = planned(which), np.random.default_rng(seed)
    q = made.trajectory.positions[rng.integers(made.trajectory.n_waypoints)]
    one = rng.integers(len(made.robot.spheres.radius))
    depth = min(depth, radius)  # no deeper than to the middle of the pin
    reach = made.robot.spheres.radius[one] + radius - depth
    pin = made.robot.sphere_centers(q)[one] + reach * unit(rng)
    found = [v for v in faults(made, with_pin(made.scene, pin, radius)) if "pin" in v.message]
    assert [v.kind for v in found] == ["contact"]
    assert found[0].amount >= depth - 1e-9


@given(whichever, seeds, st.integers(15, 40))
@often
def test_a_collision_only_between_waypoints(which: int, seed: int, stride: int) -> None:
    made, rng = planned(which), np.random.default_rng(seed)
    whole = made.trajectory
    rows = np.unique(np.append(np.arange(0, whole.n_waypoints, stride), whole.n_waypoints - 1))
    sparse = Trajectory(
        whole.times[rows], whole.positions[rows], whole.velocities[rows], whole.accelerations[rows],
        whole.joint_names,
    )  # fmt: skip
    at_waypoints = made.robot.sphere_centers(sparse.positions)
    radius, executed = made.robot.spheres.radius, curve(sparse)
    for _ in range(300):  # until one is met by a sphere on its way, and at no waypoint
        part, one = rng.integers(len(rows) - 1), rng.integers(len(radius))
        time = rng.uniform(0.3, 0.7) * np.diff(sparse.times)[part] + sparse.times[part]
        pin = made.robot.sphere_centers(executed(time))[one] + 0.9 * radius[one] * unit(rng)
        if (np.linalg.norm(at_waypoints - pin, axis=2) > radius + 2e-3).all():
            break
    else:
        reject()
    scene = with_pin(made.scene, pin, 1e-3)
    _, met = judging.clearances(scene, made.robot, sparse.positions)
    assert not any(contact.other == "pin" for contact in met)
    found = faults(made, scene, trajectory=sparse)
    assert any(v.kind == "contact" and "pin" in v.message for v in found)


@given(whichever, seeds, st.sampled_from([-1.0, 1.0]))
@often
def test_a_position_limit_broken_by_a_millionth(which: int, seed: int, side: float) -> None:
    made, rng = planned(which), np.random.default_rng(seed)
    fine = np.linspace(0.0, made.trajectory.duration, 20_001)
    joint = rng.integers(made.robot.n_joints)
    end = (side * curve(made.trajectory)(fine)[:, joint]).max() * side
    name = "upper" if side > 0 else "lower"
    for over, wanted in ((1e-6, ["limit"]), (-1e-6, [])):
        limits = np.array(getattr(made.robot, name))
        limits[joint] = end - side * over
        robot = replace(made.robot, **{name: limits})
        found = faults(made, robot=robot)
        assert [v.kind for v in found] == wanted
        if found:
            assert found[0].subject == made.robot.joint_names[joint]


@given(whichever, st.sampled_from(judging.RATES), st.floats(3e-6, 1.0))
@often
def test_a_rate_over_its_limit(which: int, rate: str, share: float) -> None:
    """By three millionths or by more; a millionth below it none is told."""
    made = planned(which)
    used = getattr(made.metrics, f"{rate}_ratio")
    for over, wrong in ((share, True), (-1e-6, False)):
        limit = np.array(getattr(made.robot, rate)) * used / (1.0 + over)
        found = faults(made, robot=replace(made.robot, **{rate: limit}))
        assert (rate in [v.kind for v in found]) is wrong


@given(whichever, seeds)
@often
def test_a_goal_two_millimetres_off(which: int, seed: int) -> None:
    made = planned(which)
    moved = 2e-3 * unit(np.random.default_rng(seed))
    objects = tuple(
        replace(o, position=o.position + moved, stem=None) if o.role == "target" else o
        for o in made.scene.objects
    )
    assert "goal" in [v.kind for v in faults(made, replace(made.scene, objects=objects))]


@given(whichever, seeds, st.floats(0.1, 1.5))
@often
def test_a_passage_on_the_side_of_the_stem(which: int, seed: int, lean: float) -> None:
    """The stem of a pushable that is passed is bent over to where the tool passes.

    Not of one so close under the target that the rim alone counts.
    """
    made, rng = planned(which), np.random.default_rng(seed)
    metrics, target = made.metrics, made.scene.target
    _, lateral, up = made.scene.frame
    under = {
        o.id: float((target.position - o.position) @ up) - o.radius - target.radius
        for o in made.scene.pushables
    }
    passed = [
        n for n, short in metrics.drift_shortfall.items()
        if short is not None and abs(metrics.M_p[n] or 0.0) > 1e-4
        and under[n] > made.robot.tool.depth
    ]  # fmt: skip
    assume(passed)
    name = str(rng.choice(passed))
    side = np.sign(metrics.M_p[name]) * lean

    def bent(item: Any) -> Any:
        return replace(item, stem=Stem.along(item.position, up + side * lateral, 0.2))

    scene = replace(
        made.scene, objects=tuple(bent(o) if o.id == name else o for o in made.scene.objects)
    )
    given_ = scene, made.robot, made.trajectory
    found = judging.judge(*given_, stem_side=True).violations
    assert name in [v.subject for v in found if v.kind == "stem side"]


@given(whichever, seeds, st.floats(1e-3, 1.0), st.floats(1e-6, 1e-5))
@often
def test_a_jump_in_velocity(which: int, seed: int, jump: float, within: float) -> None:
    """At a row or, at the ends, from rest."""
    made, rng = planned(which), np.random.default_rng(seed)
    whole = made.trajectory
    row, joint = rng.integers(1, whole.n_waypoints - 1), rng.integers(made.robot.n_joints)
    after = whole.velocities[row].copy()
    after[joint] += jump * made.robot.velocity[joint]
    jumped = Trajectory(
        np.insert(whole.times, row + 1, whole.times[row] + within),
        np.insert(whole.positions, row + 1, whole.positions[row] + within * after, axis=0),
        np.insert(whole.velocities, row + 1, after, axis=0),
        np.insert(whole.accelerations, row + 1, whole.accelerations[row], axis=0),
        whole.joint_names,
    )
    kinds = {v.kind for v in faults(made, trajectory=jumped)}
    assert {"acceleration", "jerk"} & kinds
    for end in (0, -1):
        speeds = np.array(whole.velocities)
        speeds[end, joint] += 1e-5
        pushed = Trajectory(
            whole.times, whole.positions, speeds, whole.accelerations, whole.joint_names
        )
        assert "motion" in {v.kind for v in faults(made, trajectory=pushed)}
