"""Surfaces in parts, and spheres that may overlap because their parts never meet."""

import tracemalloc

import numpy as np
import pytest
from tests.robots.links import Writer, joint

from optipromp.core.arrays import rotation
from optipromp.core.robots import load_robot
from optipromp.core.robots.tool_geometry import cover_box, cover_cylinder
from optipromp.readers.self_collision import hulls_touch, of_box, of_rod, parts_of_cover


@pytest.mark.parametrize("gap", [-0.0001, 0.0001])
def test_what_touches_is_told_from_what_does_not_at_any_turn(gap: float) -> None:
    """Two boxes, a corner of one at ``gap`` over a face of the other, or its edge, or its face."""
    corners = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    lower, box, rng = corners * [0.2, 0.3, 0.1], corners * 0.06, np.random.default_rng(0)
    turns = [rotation(axis / np.linalg.norm(axis), 1.0) for axis in rng.normal(size=(20, 3))]
    turns += [np.eye(3), rotation(np.array([1.0, 0.0, 0.0]), 0.25 * np.pi)]
    placed = np.array([box @ turn.T for turn in turns])
    placed[:, :, :2] += rng.uniform(-0.05, 0.05, (len(turns), 1, 2))
    placed[:, :, 2] += 0.05 + gap - placed[:, :, 2].min(axis=1)[:, None]
    out = rotation(np.array([0.0, 1.0, 0.0]), 0.5)
    work = tuple(np.empty(shape) for shape in ((4, 3), 4, (4, 4), 4, 3, 3))
    for each in placed:  # seen from the box, and with its points in a frame of their own
        assert hulls_touch(lower, each, np.eye(3), np.zeros(3), work) == (gap < 0.0)
        assert hulls_touch(each, (lower - 0.1) @ out, out, np.full(3, 0.1), work) == (gap < 0.0)


@pytest.mark.parametrize(
    ("triangles", "half"),
    [
        (of_box(np.array([0.3, 0.2, 0.02])), [0.15, 0.1, 0.01]),
        (of_rod(0.03, 0.2, 0.0), [0.03, 0.03, 0.1]),
        (of_rod(0.03, 0.2, 0.03), [0.03, 0.03, 0.13]),
    ],
    ids=["box", "cylinder", "capsule"],
)
def test_parts_hold_the_surface(triangles: np.ndarray, half: list[float]) -> None:
    """The hulls of the parts together reach as far as the surface in every direction, within
    0.5 mm, and each is in its sphere."""
    spheres = cover_box(2.0 * np.array(half), 0.01)
    found = parts_of_cover(spheres, triangles)
    ways = np.random.default_rng(0).normal(size=(500, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    reach = (found[:, :3] @ ways.T).max(axis=0)
    surface = triangles.reshape(-1, 3)
    assert np.abs(reach - (surface @ ways.T).max(axis=0)).max() < 5e-4
    np.testing.assert_allclose(np.abs(surface).max(axis=0), half, atol=1e-12)
    own = spheres[found[:, 3].astype(int)]
    away = np.linalg.norm(found[:, :3] - own[:, :3], axis=1) - own[:, 3]
    assert away.max() < 0.010  # a piece on the border of two spheres


@pytest.mark.parametrize(
    ("radius", "length", "ends", "most"), [(2.0, 0.3, 2.0, 200e6), (0.03, 10.0, 0.0, 400e6)]
)
def test_large_surfaces_take_no_more_memory(radius, length, ends, most):
    """A ball of 2 m radius had nine million pieces, a rod of 10 m took a gigabyte."""
    spheres, surface = cover_cylinder(radius, length, 0.01), of_rod(radius, length, ends)
    tracemalloc.start()
    found = parts_of_cover(spheres, surface)
    assert tracemalloc.get_traced_memory()[1] < most
    tracemalloc.stop()
    assert len(found) < 1000 * len(spheres)


def test_links_whose_covers_alone_touch(write: Writer) -> None:
    """A ball passes 12 mm over a plate, within the plate's cover; another one touches it."""
    plate = '<origin xyz="0 0.18 0"/><geometry><box size="0.3 0.3 0.02"/></geometry>'
    links = (
        f'<link name="l0"><collision>{plate}</collision></link><link name="l1"/>'
        '<link name="l2"><collision><origin xyz="0.1 0 {height}"/><geometry><sphere radius="0.02"/>'
        "</geometry></collision></link>"
    )
    joints = joint("j0", "l0", "l1", origin="") + joint("j1", "l1", "l2", origin="")
    free = load_robot(
        write(f'<robot name="r">{links.format(height=0.042)}{joints}</robot>', "free.urdf")
    )
    assert [(a, b) for a, b, why in free.left_out if "only the covers touch" in why] == [
        ("l0", "l2")
    ]
    assert not len(free.self_pairs)
    meets = load_robot(
        write(f'<robot name="r">{links.format(height=0.03)}{joints}</robot>', "meets.urdf")
    )
    assert len(meets.self_pairs)
