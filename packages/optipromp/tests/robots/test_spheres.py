"""Covers cover: dense samples of each shape lie inside, and the bulge is what was asked for."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.refusals import assert_refused
from tests.robots.covers import worst_gap
from tests.robots.links import Writer

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.tool_geometry import (
    MAX_SPHERES,
    cover_box,
    cover_capsule,
    cover_cylinder,
)

RNG = np.random.default_rng(0)


def unit(count: int) -> np.ndarray:
    v = RNG.normal(size=(count, 3))
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


@settings(max_examples=60, deadline=None)
@given(length=st.floats(0.0, 2.0), radius=st.floats(0.002, 0.3), bulge=st.floats(0.001, 0.05))
def test_capsule(length: float, radius: float, bulge: float) -> None:
    end = length * np.array([0.6, 0.0, 0.8])
    cover = cover_capsule(np.zeros(3), end, radius, bulge)
    points = RNG.uniform(0, 1, (2000, 1)) * end + radius * unit(2000)
    points = np.concatenate([points, radius * unit(500), end + radius * unit(500)])
    assert worst_gap(points, cover) <= 1e-9
    assert (cover[:, 3] <= radius + bulge + 1e-8).all() or len(cover) == 200
    along = cover[:, :3] @ np.array([0.6, 0.0, 0.8])
    assert (along - cover[:, 3] >= -radius - bulge - 1e-8).all() or len(cover) == 200


@settings(max_examples=60, deadline=None)
@given(size=st.tuples(*[st.floats(0.001, 2.0)] * 3), bulge=st.floats(0.005, 0.1))
def test_box(size: tuple[float, float, float], bulge: float) -> None:
    cover = cover_box(np.array(size), bulge)
    assert len(cover) <= MAX_SPHERES
    points = RNG.uniform(-0.5, 0.5, (3000, 3))
    face = RNG.integers(0, 3, 3000)
    points[np.arange(3000), face] = RNG.choice([-0.5, 0.5], 3000)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T
    assert worst_gap(np.concatenate([points, corners]) * size, cover) <= 1e-9


@settings(max_examples=60, deadline=None)
@given(radius=st.floats(0.005, 0.5), length=st.floats(0.005, 2.0), bulge=st.floats(0.005, 0.1))
def test_cylinder(radius: float, length: float, bulge: float) -> None:
    cover = cover_cylinder(radius, length, bulge)
    assert len(cover) <= MAX_SPHERES
    angle, height = RNG.uniform(0, 2 * np.pi, 3000), RNG.uniform(-0.5, 0.5, 3000) * length
    height[:1000], height[1000:1500] = length / 2, -length / 2
    reach = np.where(np.arange(3000) < 1500, np.sqrt(RNG.uniform(0, 1, 3000)), 1.0) * radius
    points = np.column_stack([reach * np.cos(angle), reach * np.sin(angle), height])
    assert worst_gap(points, cover) <= 1e-9


def body(robot_link: str, shape: str) -> str:
    place = '<origin xyz="0.1 0.2 0.3" rpy="0.4 0.5 0.6"/>'
    return (
        f'<link name="{robot_link}"><collision>{place}<geometry>{shape}</geometry></collision>'
        '</link><link name="b"/><link name="c"/>'
    )


@pytest.mark.parametrize(
    "shape",
    [
        '<box size="0.2 0.3 0.4"/>',
        '<cylinder radius="0.05" length="0.4"/>',
        '<cylinder radius="0.2" length="0.05"/>',
        '<capsule radius="0.05" length="0.4"/>',
        '<sphere radius="0.1"/>',
    ],
)
def test_placed_in_its_link(urdf: Writer, shape: str) -> None:
    """The middle of every shape, at its origin, is covered."""
    robot = load_robot(urdf(links=body("a", shape)))
    cover = np.column_stack([robot.spheres.center, robot.spheres.radius])
    assert worst_gap(np.array([[0.1, 0.2, 0.3]]), cover) < 0.0
    assert np.linalg.norm(robot.spheres.center.mean(axis=0) - [0.1, 0.2, 0.3]) < 1e-9


def test_visual_stands_in_for_collision(urdf: Writer) -> None:
    links = body("a", '<sphere radius="0.1"/>').replace("collision", "visual")
    assert load_robot(urdf(links=links)).spheres.radius[0] == 0.1


# -- meshes ----------------------------------------------------------------------------------


def export(path: Path) -> np.ndarray:
    """Write a mesh of two bodies; return dense points of its solid's surface."""
    trimesh = pytest.importorskip("trimesh")
    parts = [trimesh.creation.box((0.1, 0.1, 0.5)), trimesh.creation.icosphere(2, 0.05)]
    parts[1].apply_translation((0.4, 0, 0))
    mesh = trimesh.util.concatenate(parts)
    mesh.apply_transform(trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0.1, 0, 0)))
    mesh.export(str(path))
    points = mesh.vertices[mesh.faces]
    shares = RNG.dirichlet(np.ones(3), (len(points), 40))
    return np.concatenate([np.einsum("fsk,fkd->fsd", shares, points).reshape(-1, 3), mesh.vertices])


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_mesh(urdf: Writer, tmp_path: Path, suffix: str) -> None:
    """In each format, by the name of its package, scaled; shapes are those of test_fit.py."""
    (tmp_path / "meshes").mkdir()
    points = export(tmp_path / "meshes" / f"m.{suffix}")
    mesh = f'<mesh filename="package://{tmp_path.name}/meshes/m.{suffix}" scale="2 2 2"/>'
    links = f'<link name="a"><collision><geometry>{mesh}</geometry></collision></link>'
    robot = load_robot(urdf(links=links + '<link name="b"/><link name="c"/>'))
    cover = np.column_stack([robot.spheres.center, robot.spheres.radius])
    assert len(cover) <= 2 * MAX_SPHERES
    assert worst_gap(2.0 * points, cover) <= 1e-6  # files hold single precision
    reach = np.linalg.norm(cover[:, None, :3] - 2.0 * points[::7], axis=2).min(axis=1)
    assert (cover[:, 3] - reach).max() < 0.16


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("m.stl", b"", ["m.stl"]),
        ("m.stl", b"solid nothing\nendsolid nothing\n", ["m.stl"]),
        ("m.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", ["degenerate", "area"]),
        ("m.obj", b"v 0 0 0\nv 1 0 0\n", ["m.obj"]),
        ("m.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", ["m.obj"]),
        ("m.ply", b"ply\ngarbage", ["m.ply"]),
        ("m.xyzzy", b"what", ["m.xyzzy"]),
        ("m.obj", b"v 0 0 0\nv 500 0 0\nv 0 500 0\nf 1 2 3\n", ["millimetres", "500 m"]),
    ],
)
def test_bad_mesh(urdf: Writer, write: Writer, name: str, content: bytes, words: list[str]) -> None:
    pytest.importorskip("trimesh")
    write(content, name)
    path = urdf(links=body("a", f'<mesh filename="{name}"/>'))
    assert_refused(InvalidRobotError, ["link 'a'", *words], load_robot, path)
