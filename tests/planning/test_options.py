"""Settings: every one is checked, and every one is heeded."""

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest

from optipromp.errors import Code, InvalidRequestError
from optipromp.optimization.constraints import Priority
from optipromp.optimization.terms import VelocityTerm
from optipromp.planning import Plan, PlanOptions, joint, plan
from optipromp.planning.primitives import learnt
from optipromp.planning.setup import bind
from optipromp.planning.starts import Starts
from optipromp.scenes import Stem, load_scene

NAN, INF = float("nan"), float("inf")


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("knots", 2), ("knots", 0), ("knots", -5), ("knots", 3.5), ("knots", NAN),
        ("duration", 0.0), ("duration", -1.0), ("duration", NAN), ("duration", INF),
        ("timeout", 0.0), ("timeout", -1.0), ("timeout", NAN),
        ("alphas", (1.0, 1.0, 1.0)), ("alphas", (1.0, -1.0, 1.0, 0.0)),
        ("alphas", (NAN, 1.0, 1.0, 0.0)), ("alphas", (1.0, 1.0, NAN, 0.0)),
        ("alphas", (1.0, 1.0, INF, 0.0)),
        ("epsilon", 0.0), ("epsilon", -0.01), ("epsilon", NAN), ("epsilon", INF),
        ("reduction", "mean"), ("push", "cubic"),
        ("push_weights", (1.0, 1.0)), ("push_weights", (1.0, 1.0, -1.0)),
        ("push_weights", (1.0, NAN, 1.0)),
        ("drift", "left"), ("window", "wide"),
        ("drift_offset", -0.01), ("drift_offset", NAN), ("berth", -0.1), ("berth", NAN),
        ("approach_speed", 0.0), ("approach_speed", -0.1), ("approach_speed", NAN),
        ("corridor", -0.01), ("corridor", NAN),
        ("smoothness", -1e-9), ("smoothness", INF),
        ("static_clearance", -0.01), ("static_clearance", NAN),
        ("avoid_clearance", -0.01), ("self_clearance", -0.01), ("limit_margin", -0.01),
        ("starts", 0), ("starts", 1.5),
        ("camera_phase", 0.0), ("camera_phase", 1.0), ("camera_phase", -0.1),
        ("camera_phase", NAN),
        ("max_step", 0.0), ("max_step", -0.1), ("max_step", INF),
        ("iterations", -1), ("iterations", 1.5),
        ("via_deviation", -1e-3), ("direction_deviation", -0.1),
        ("terms", (1.0,)),
    ],
)  # fmt: skip
def test_refusals_name_the_setting(name: str, value: Any) -> None:
    with pytest.raises(InvalidRequestError, match=rf"^{name} is .*must be") as caught:
        PlanOptions(**{name: value})
    assert caught.value.code is Code.INVALID_REQUEST


@pytest.mark.parametrize("value", [-1.0, NAN, INF])
def test_a_priority_is_a_stiffness(value: float) -> None:
    with pytest.raises(InvalidRequestError, match="priority"):
        PlanOptions(priority=Priority(drift=value))


def test_the_edges_are_allowed() -> None:
    PlanOptions(
        knots=3, timeout=INF, alphas=(0.0, 0.0, 0.0, 0.0), corridor=0.0, smoothness=0.0, starts=1,
        drift_offset=0.0, static_clearance=0.0, avoid_clearance=0.0, self_clearance=0.0,
        limit_margin=0.0, iterations=0, via_deviation=0.0, terms=(VelocityTerm(0.0),),
    )  # fmt: skip


def test_options_cannot_be_changed() -> None:
    with pytest.raises(AttributeError):
        PlanOptions().knots = 5  # type: ignore[misc]


# A value of each setting under which scenario 3 (or another) must be planned otherwise.
JOINT: dict[str, Any] = {
    "knots": 70,
    "duration": 9.0,
    "alphas": (1.0, 5.0, 1.0, 1.0),
    "epsilon": 0.06,
    "push": "reciprocal",
    "push_weights": (5.0, 1.0, 1.0),
    "window": "paper",
    "foresight": False,
    "drift_offset": 0.04,
    "corridor": 1e-4,
    "smoothness": 1e-3,
    "avoid_clearance": 0.06,
    "self_clearance": 0.2,
    "limit_margin": 0.6,
    "priority": Priority(corridor=1.0),
    "approach_speed": 0.05,
    "camera_phase": 0.6,
    "max_step": 0.03,
    "via_deviation": 0.01,
    "terms": (VelocityTerm(1.0),),
}
SEQUENTIAL: dict[str, Any] = {
    "knots": 90,
    "duration": 9.0,
    "alphas": (1.0, 5.0, 1.0, 1.0),
    "epsilon": 0.05,
    "reduction": "sum",
    "push": "quadratic",
    "drift_offset": 0.03,
    "corridor": 0.001,
    "camera_phase": 0.6,
    "max_step": 0.03,
    "iterations": 3,
    "via_deviation": 0.01,
}
ELSEWHERE = {  # tested by name below, or in test_requests.py
    "timeout",
    "drift",
    "static_clearance",
    "starts",
    "reduction",
    "camera_point",
    "direction_deviation",
    "berth",
    "iterations",
}


def differ(first: Plan, second: Plan) -> bool:
    one, other = first.trajectory, second.trajectory
    return one.dt != other.dt or not np.array_equal(one.positions, other.positions)


def test_the_joint_strategy_heeds_its_iterations(planned: Callable[..., Plan]) -> None:
    """Where there is something to do: by the rule alone, constraints contradict each other."""
    few, many = (
        planned("scenario-3", foresight=False, iterations=iterations) for iterations in (2, None)
    )
    assert len(few.stages[0].history) <= 3 < len(many.stages[0].history)
    assert differ(few, many)


@pytest.mark.parametrize("name", JOINT)
def test_the_joint_strategy_heeds(name: str, planned: Callable[..., Plan]) -> None:
    assert differ(planned("scenario-3", **{name: JOINT[name]}), planned("scenario-3"))


def test_the_joint_strategy_heeds_the_reduction(planned: Callable[..., Plan]) -> None:
    """Where two body points are near an obstacle: within a wide safety distance."""
    most = planned("scenario-3", epsilon=0.06, reduction="max")
    assert differ(most, planned("scenario-3", epsilon=0.06))


@pytest.mark.parametrize("name", SEQUENTIAL)
def test_the_sequential_strategy_heeds(name: str, planned: Callable[..., Plan]) -> None:
    changed = planned("scenario-3", strategy="sequential", **{name: SEQUENTIAL[name]})
    assert differ(changed, planned("scenario-3", strategy="sequential"))


def test_no_setting_is_forgotten_here() -> None:
    assert {item.name for item in fields(PlanOptions)} - set(JOINT) - ELSEWHERE == set()


def test_knots_and_duration_are_what_was_asked_for(planned: Callable[..., Plan]) -> None:
    for planner in ("promp", "i-promp", "opti-promp"):
        result = planned("scenario-3", planner, knots=77, duration=8.0)
        assert result.trajectory.n_knots == 77
        assert result.trajectory.duration == pytest.approx(8.0)
        assert result.metrics.duration == pytest.approx(8.0)


def test_a_duration_that_the_limits_do_not_allow_is_no_success(
    planned: Callable[..., Plan],
) -> None:
    result = planned("scenario-3", duration=0.3)
    assert result.status is Code.INVALID_PLAN
    assert "velocity reaches" in result.message
    assert result.metrics.velocity_ratio > 1.0


@pytest.mark.parametrize("planner", ["promp", "i-promp", "opti-promp"])
def test_without_a_duration_a_limit_is_used_up(planner: str, planned: Callable[..., Plan]) -> None:
    m = planned("scenario-3", planner, approach_speed=100.0).metrics
    assert max(m.velocity_ratio, m.acceleration_ratio) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("planner", ["promp", "i-promp", "opti-promp"])
@pytest.mark.parametrize("speed", [0.05, 0.1])
def test_the_tool_is_as_slow_among_fruits_as_asked_for(
    planner: str, speed: float, planned: Callable[..., Plan]
) -> None:
    """From t_1 on, and no slower than that; before it the tool may be faster."""
    result = planned("scenario-3", planner, approach_speed=speed, camera_phase=0.4, knots=101)
    tools = result.robot.tool_pose(result.trajectory.positions)[0]
    speeds = np.linalg.norm(np.diff(tools, axis=0), axis=1) / result.trajectory.dt
    assert speeds[40:].max() == pytest.approx(speed, rel=1e-9)
    m = result.metrics
    assert max(m.velocity_ratio, m.acceleration_ratio) < 1.0
    fast = planned("scenario-3", planner, camera_phase=0.4, knots=101, duration=2.0)
    assert fast.trajectory.duration == pytest.approx(2.0)  # a duration overrides it


def test_clearances_are_kept(planned: Callable[..., Plan]) -> None:
    m = planned("scenario-4", foresight=False, static_clearance=0.025).metrics
    plain = planned("scenario-4", foresight=False).metrics
    assert m.clearance_static is not None
    assert m.clearance_static > 0.02
    assert m.clearance_static > (plain.clearance_static or 0.0)


def test_steps_are_kept(planned: Callable[..., Plan]) -> None:
    assert planned("scenario-3", max_step=0.03).metrics.max_step <= 0.03


def test_the_margin_to_the_limits_is_kept(planned: Callable[..., Plan]) -> None:
    result = planned("scenario-3", limit_margin=0.3)
    q, robot = result.trajectory.positions, result.robot
    assert result.success
    assert np.minimum(q - robot.lower, robot.upper - q).min() > 0.299


def test_the_drift_offset_is_kept(planned: Callable[..., Plan]) -> None:
    for offset in (0.035, 0.055):
        m = planned("scenario-3", drift_offset=offset, foresight=False).metrics
        for name, value in m.M_p.items():
            assert value is not None
            assert -np.sign(m.stem_projection[name] or 0.0) * value >= offset - 1e-3


def test_the_drift_rule_is_heeded() -> None:
    """Only where a stem leans out of the lateral direction do the rules differ."""
    scene = load_scene("scenario-3")
    objects = tuple(
        replace(o, stem=Stem(np.array([o.position, o.position + [-0.04, 0.05, 0.25]])))
        if o.id == "n1" else o
        for o in scene.objects
    )  # fmt: skip
    leaning = replace(scene, objects=objects)
    general, paper = (
        plan(leaning, options=PlanOptions(drift=rule, foresight=False))
        for rule in ("lateral-plane", "paper")
    )  # type: ignore[arg-type]
    assert differ(general, paper)
    tools = [p.robot.tool_pose(p.trajectory.positions)[0] for p in (general, paper)]
    n1 = next(o for o in objects if o.id == "n1")
    at = [t[np.argmin(np.abs(t[:, 2] - n1.position[2])), 0] - n1.position[0] for t in tools]
    assert at[0] > at[1] + 0.01  # away from a stem that leans to -x too


@pytest.mark.parametrize("starts", [1, 2, 5])
def test_the_number_of_starts_is_heeded(starts: int) -> None:
    """So many goal configurations at once, each with every choice of sides."""
    scene = load_scene("scenario-3")
    undecided = tuple(replace(o, stem=None) for o in scene.objects if o.id != "n1")
    setup = bind(replace(scene, objects=undecided, start=None))
    goals = setup.robot.home + 1e-3 * np.arange(6)[:, None] * np.ones(7)  # six motions alike
    options = PlanOptions(starts=starts)
    promp = learnt(setup, None)
    choices = joint.sides(setup, options)
    batch = next(Starts(setup, promp, options, goals).batches(choices))
    assert len(batch) == 2 * starts
    assert len({tuple(start.q[-1]) for start in batch}) == starts
    assert len({float(start.drift.directions[0, 1]) for start in batch}) == 2


def test_the_camera_phase_divides_the_motion(planned: Callable[..., Plan]) -> None:
    """At t_1 the tool is at the camera point, below the lowest fruit."""
    for phase in (0.4, 0.7):
        result = planned("scenario-3", "promp", camera_phase=phase)
        tools = result.robot.tool_pose(result.trajectory.positions)[0]
        knot = round(phase * (len(tools) - 1))
        lowest = min(o.position[2] for o in result.scene.pushables) - 0.015
        np.testing.assert_allclose(tools[knot], [0.45, 0.0, lowest - 0.1], atol=2e-3)
