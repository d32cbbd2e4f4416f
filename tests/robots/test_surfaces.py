"""Whether surfaces touch, and pairs of spheres that say nothing because they never do."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from optipromp.arrays import rotation
from optipromp.robots import load_robot
from optipromp.robots.surfaces import NEAR, Neighbourhood, of_box, of_rod, surface


@pytest.mark.parametrize("gap", [0.0, 0.002, 0.5 * NEAR])
def test_what_touches_is_found_at_any_turn(gap: float) -> None:
    """Two boxes, a corner of one at ``gap`` from a face of the other."""
    near, box = Neighbourhood(of_box(np.array([0.2, 0.3, 0.1]))), of_box(np.full(3, 0.06))
    rng = np.random.default_rng(0)
    for _ in range(20):
        axis = rng.normal(size=3)
        turn = rotation(axis / np.linalg.norm(axis), float(rng.uniform(0.0, 3.0)))
        lowest = float((box @ turn.T)[:, 2].min())
        at = np.array([*rng.uniform(-0.05, 0.05, 2), 0.05 - lowest + max(gap - 0.003, 0.0)])
        assert near.touched(box, turn[None], at[None])[0]
        assert not near.touched(box, turn[None], at[None] + [0.0, 0.0, 2.0 * NEAR])[0]


def test_rods_and_triangles() -> None:
    rod = of_rod(0.03, 0.2, 0.0)
    assert np.hypot(rod[:, 0], rod[:, 1]).max() == pytest.approx(0.03)
    assert np.abs(rod[:, 2]).max() == pytest.approx(0.1)
    capsule = of_rod(0.03, 0.2, 0.03)
    assert np.abs(capsule[:, 2]).max() == pytest.approx(0.13)
    away = np.linalg.norm(capsule - np.clip(capsule, [0, 0, -0.1], [0, 0, 0.1]), axis=1)
    assert np.allclose(away, 0.03)
    triangle = np.array([[[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0]]])
    cells = surface(triangle)
    inside = np.random.default_rng(1).dirichlet([1.0, 1.0, 1.0], 500) @ triangle[0]
    assert np.linalg.norm(inside[:, None] - cells, axis=2).min(axis=1).max() < 0.5 * NEAR


def test_links_whose_covers_alone_touch(
    write: Callable[..., Path], joint: Callable[..., str]
) -> None:
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
