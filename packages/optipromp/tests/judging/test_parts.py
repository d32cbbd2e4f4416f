"""What the judge minds: held things, pairs that may touch, padding."""

from dataclasses import replace

import numpy as np
import pytest

from optipromp.core.geometry import Box, Sphere
from optipromp.core.judging import clearances
from optipromp.core.judging.clearance import nearest_static
from optipromp.core.judging.validator import entered
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import gravity_load
from optipromp.core.scenes import Attached, PoseGoal, Scene, SceneObject, ToolSpec

UP = np.array([0.0, 0.0, 1.0])
CUP = ToolSpec("cup", {"radius": 0.03})


def scene(*objects: SceneObject, **further: object) -> Scene:
    goal = PoseGoal(np.array([0.5, 0.0, 0.5]), UP)
    return Scene("s", "panda", objects, tool=CUP, goal=goal, **further)  # type: ignore[arg-type]


def ball(id_: str, at: np.ndarray, radius: float = 0.02, **further: object) -> SceneObject:
    return SceneObject(id_, "static", Sphere(radius), at, **further)  # type: ignore[arg-type]


def test_padding_takes_its_distance_from_every_clearance() -> None:
    rng = np.random.default_rng(0)
    bare = scene(*[ball(f"b{k}", rng.uniform(-0.8, 0.8, 3)) for k in range(6)])
    robot, state = posed(bare)
    q = state.q + 0.3 * rng.standard_normal((40, robot.n_joints))
    for one in q:
        free, _ = clearances(bare, robot, one[None])
        kept, contacts = clearances(replace(bare, padding=0.07), robot, one[None])
        assert kept["clearance_static"] == pytest.approx(free["clearance_static"] - 0.07)  # type: ignore[operator]
        assert kept["clearance_self"] == free["clearance_self"]
        met = any(c.role == "static" for c in contacts)
        assert met == (kept["clearance_static"] < 0.0)  # type: ignore[operator]


def test_an_objects_own_padding_replaces_the_scenes() -> None:
    at = np.array([0.0, 0.9, 0.5])
    free, own, usual = (
        scene(ball("b", at)),
        scene(ball("b", at, padding=0.02), padding=0.1),
        scene(ball("b", at), padding=0.1),
    )
    robot, state = posed(free)
    far, near, nearest = (clearances(s, robot, state.q[None])[0]["clearance_static"] for s in
                          (free, own, usual))  # fmt: skip
    assert (far - near, far - nearest) == pytest.approx((0.02, 0.1))
    found = nearest_static(own, robot, state.q[None])
    assert -found.depth == pytest.approx(near)


def test_only_the_named_link_may_touch_and_only_the_named_object() -> None:
    empty = scene()
    robot, state = posed(empty)
    tip, axis = robot.tool_pose(state.q)
    inside = ball("in-tool", tip - 0.06 * axis)
    link = robot.link_names.index("link7")
    row = int(np.flatnonzero(robot.spheres.link == link)[0])
    other = ball("in-link7", robot.sphere_centers(state.q)[row], 0.01)
    both = scene(inside, other)
    _, met = clearances(both, robot, state.q[None])
    assert {"in-tool", "in-link7"} <= {contact.other for contact in met}
    freed = replace(both, may_touch=(("in-tool", "tool"),))
    _, met = clearances(freed, robot, state.q[None])
    assert all(contact.link != "tool" or contact.other != "in-tool" for contact in met)
    assert "in-link7" in {contact.other for contact in met}
    wide = scene(ball("wide", tip - 0.12 * axis, 0.08), may_touch=(("tool", "wide"),))
    _, met = clearances(wide, robot, state.q[None])
    (contact,) = met  # the deepest of the others: the tool hides no other link
    assert contact.other == "wide"
    assert contact.link != "tool"


def test_a_held_thing_is_judged_against_things_links_and_fruits() -> None:
    held = Attached("plank", Box((0.5, 0.03, 0.02)), np.array([0.0, 0.0, -0.05]))
    laden = scene(attached=(held,))
    robot, state = posed(laden)
    tip, _ = robot.tool_pose(state.q)
    _, turns = robot.segment_frames(state.q)
    axes = turns[-1] @ robot.flange_rotation @ robot.tool.rotation
    end = tip + axes @ np.array([0.2, 0.0, -0.05])
    post = replace(laden, objects=(ball("post", end),))
    assert ("plank", "post") in {
        (c.link, c.other) for c in clearances(post, robot, state.q[None])[1]
    }
    assert not clearances(post, posed(scene())[0], state.q[None])[1]
    freed = replace(post, may_touch=(("plank", "post"),))
    assert not clearances(freed, posed(freed)[0], state.q[None])[1]
    fruit = SceneObject("n1", "pushable", Sphere(0.02), end)
    among = replace(laden, objects=(fruit,))
    (met,) = entered(among, robot, state.q, tip, axes[:, 2])
    assert (met.link, met.other) == ("plank", "n1")
    row = int(np.flatnonzero(robot.spheres.link == robot.link_names.index("link3"))[0])
    local = axes.T @ (robot.sphere_centers(state.q)[row] - tip)
    long = scene(attached=(Attached("plank", Sphere(0.05), local),))
    robot = posed(long)[0]
    (met,) = clearances(long, robot, state.q[None])[1]
    pair = tuple(sorted((met.link, met.other)))
    assert met.role == "the robot itself"
    assert "plank" in pair
    eased = replace(long, may_touch=(pair,))  # type: ignore[arg-type]
    left = clearances(eased, posed(eased)[0], state.q[None])[1]
    assert all(tuple(sorted((c.link, c.other))) != pair for c in left)


def test_a_held_mass_asks_its_weight_of_the_joints() -> None:
    held = Attached("crate", Box((0.1, 0.1, 0.1)), np.array([0.03, 0.0, 0.1]), mass=2.0)
    bare, state = posed(scene())
    robot, _ = posed(scene(attached=(held,)))
    up = UP
    q = state.q[None]
    _, turns = robot.segment_frames(state.q)
    tip, _ = robot.tool_pose(state.q)
    at = tip + turns[-1] @ robot.flange_rotation @ robot.tool.rotation @ held.position

    def height(q: np.ndarray) -> float:
        tips, _ = robot.tool_pose(q)
        _, turned = robot.segment_frames(q)
        axes = turned[-1] @ robot.flange_rotation @ robot.tool.rotation  # type: ignore[union-attr]
        return float((tips + axes @ held.position) @ up)

    assert height(state.q) == pytest.approx(at @ up)
    more = (gravity_load(robot, q, up) - gravity_load(bare, q, up))[0]
    for j in range(robot.n_joints):  # the torque is the slope of the potential energy
        step = np.zeros(robot.n_joints)
        step[j] = 1e-5
        slope = (height(state.q + step) - height(state.q - step)) / 2e-5
        assert more[j] == pytest.approx(2.0 * 9.81 * slope, abs=2e-2)
