"""Stems that are bowed at rest, and fruits that are never in one place, in the push model."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.pushing.fruits import CUP, DT, TARGET, UP, along, hung

from optipromp.core.geometry import pack
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.stems.bending import bowed, part
from optipromp.core.pushing.stems.contacts import place
from optipromp.core.pushing.stems.swinging import led


def test_a_bowed_stem_lies_on_its_arc_and_holds_its_fruit_in_place() -> None:
    s = bowed(hung(((0, 0, 0), (0.0, 0.0, 0.2))), np.array([0.04]), np.array([0.7]))
    length = s.length[0]
    free = 1.0 - s.above[0] / length
    for share in PUSH.beam.loaded:
        point = np.array(place.py_func(s, s.rest, 0, length, share))
        line = s.root[0] + share * length * s.axes[0, 2]
        off = 0.04 * length * np.sin(np.pi * min(share / free, 1.0))
        assert abs(np.linalg.norm(point - line) - off) < 1e-9
    np.testing.assert_allclose(place.py_func(s, s.rest, 0, length, 1.0), TARGET, atol=1e-9)


def test_a_straight_stem_is_a_strut_and_a_bowed_one_gives_way() -> None:
    """A rim that comes up under the middle of a fruit."""
    up = along((0.024, 0.0, -0.12), (0.024, 0.0, -0.01))
    axes = np.tile(UP, (len(up), 1))
    straight = hung(((0.3, 0, 0), (0.0, 0.0, 0.2)), ((0, 0, 0), (0.0, 0.0, 0.2)))
    arc = bowed(straight, np.array([0.03, 0.03]), np.array([1.0, 1.0]))
    forces = [led(s, up, axes, DT, CUP, pack([])).harm.fruit for s in (straight, arc)]
    assert forces[0] > 30.0
    assert forces[1] < 10.0


SCALE = st.floats(0.0, 0.06)


@settings(max_examples=200, deadline=None)
@given(st.lists(st.tuples(SCALE, SCALE, SCALE), min_size=2, max_size=5), st.floats(0.0, 0.02))
def test_parted_fruits_do_not_overlap_and_a_pair_keeps_its_middle(places, apart):
    fruit = np.array(places)[None] + 1e-3 * np.arange(len(places))[:, None]
    root = fruit + [0.0, 0.0, 0.2]
    count, before = len(places), fruit.copy()
    part(fruit, root, np.full(count, 0.01), np.full(count, 0.008), np.full(count, apart))
    np.testing.assert_allclose(fruit.mean(axis=1), before.mean(axis=1), atol=1e-9)
    gaps = np.linalg.norm(fruit[0, :, None] - fruit[0], axis=2)[np.triu_indices(count, 1)]
    first = np.linalg.norm(before[0, :, None] - before[0], axis=2)[np.triu_indices(count, 1)]
    if count == 2:
        assert gaps[0] > 0.02 - 1e-6
    if apart == 0.0 and (first > 0.0201).all():
        np.testing.assert_array_equal(fruit, before)
    else:
        assert gaps.min() > min(first.min(), 0.02) - 1e-9
