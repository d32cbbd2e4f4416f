"""No link of the arm may run into a stem or a target that hangs; the last link and the tool may."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
from tests.judging.builders import obj, to

from optipromp.core import judging
from optipromp.core.geometry import Sphere
from optipromp.core.planning import plan
from optipromp.core.robots.model import Robot
from optipromp.core.scenes import Scene, SceneObject, Stem, load_scene


def hanging(name: str, role: str, points: np.ndarray, radius: float) -> SceneObject:
    fruit = obj(role, Sphere(0.03), points[0], name=name)
    return replace(fruit, stem=Stem(points, radius))


def to_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Distances of points (..., 3) to a line of pieces (k, 3)."""
    out = np.full(points.shape[:-1], np.inf)
    for a, b in pairwise(line):
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        out = np.minimum(out, np.linalg.norm(points - a - share[..., None] * (b - a), axis=-1))
    return out


def deep(robot: Robot, scene: Scene, q: np.ndarray) -> dict[str, float]:
    """How deep the links but the last are in stems and target over configurations (M, n) [m]."""
    own = ~np.asarray(robot.spheres.distal)
    centers = np.array([robot.sphere_centers(row)[own] for row in q])
    radius = np.asarray(robot.spheres.radius)[own]
    out = {}
    for item in scene.objects:
        if item.stem is not None:
            gaps = to_line(centers, item.stem.points) - radius - item.stem.radius
            if gaps.min() < 0.0:
                out[f"the stem of {item.id}"] = -float(gaps.min())
        if item.role == "target":
            gaps = np.linalg.norm(centers - item.position, axis=-1) - radius - item.radius
            out |= {item.id: -float(gaps.min())} if gaps.min() < 0.0 else {}
    return out


def test_a_link_in_a_stem_is_a_contact_as_deep_as_the_line_is_in_its_spheres(panda: Robot) -> None:
    rng, met, roles = np.random.default_rng(5), 0, ("target", "pushable", "pushable")
    for _ in range(60):
        lines = [rng.uniform((0.1, -0.4, 0.1), (0.7, 0.4, 0.9), (3, 3)) for _ in roles]
        fruits = [
            hanging(f"f{i}", role, line, radius)
            for i, (role, line, radius) in enumerate(
                zip(roles, lines, rng.uniform(0.001, 0.01, 3), strict=True)
            )
        ]
        q = rng.uniform(panda.lower, panda.upper, (4, panda.n_joints))
        scene = to(None, *fruits)
        _, contacts = judging.clearances(scene, panda, q)
        told = (c for c in contacts if c.other.startswith("the stem") or c.role == "target")
        found = {c.other: c.depth for c in told}
        expected = deep(panda, scene, q)
        assert found.keys() == expected.keys()
        np.testing.assert_allclose([found[key] for key in expected], list(expected.values()))
        met += len(found)
    assert met > 30


def test_a_plan_that_leads_a_link_through_a_stem_is_no_success() -> None:
    """The forearm of a plan that was one; another fruit's stem hangs where it passes."""
    scene = load_scene("scenario-3")
    first = plan(scene)
    assert first.success
    q = first.trajectory.positions
    link = first.robot.link_names.index("link4")
    own = np.flatnonzero(first.robot.spheres.link == link)[0]
    way = np.array([first.robot.sphere_centers(row)[own] for row in q])
    root = way[np.linalg.norm(way - way[0], axis=1).argmax()] + [0.0, 0.0, -0.02]
    fruit = root + [0.0, 0.0, -0.25]  # clear of the arm
    other = hanging("other", "pushable", np.array([fruit, root]), 0.003)
    more = replace(scene, objects=(*scene.objects, other))
    assert deep(first.robot, more, q)
    verdict = judging.judge(more, first.robot, first.trajectory)
    assert "enters the stem of other (pushable)" in verdict.message
    again = plan(more)
    times = np.linspace(0.0, again.trajectory.duration, 2_000)
    fine = np.array([again.trajectory.at(time).q for time in times])
    assert not (again.success and deep(again.robot, more, fine))
