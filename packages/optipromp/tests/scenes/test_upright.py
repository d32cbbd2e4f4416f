"""Stems that stand: at which stiffness they buckle, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import eigh

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import Sphere
from optipromp.core.parameters import GRAVITY
from optipromp.core.planning.task import posed
from optipromp.core.pushing.stems.bending import stems
from optipromp.core.scenes import Scene, SceneObject, Stem
from optipromp.core.scenes.objects import STANDS, least_stiffness

LENGTH = st.floats(0.01, 0.3)


def buckling(bends: float, rigid: float, pieces: int = 60) -> float:
    """EI [N m²] at which rigid pieces on springs, then a rigid length, fall under 1 N at the end.

    The turns of the springs are unknown; the end sinks by half the sum of length times turn².
    """
    h = bends / pieces
    turned = np.tril(np.ones((pieces, pieces)))  # of each piece, by the springs before it
    sizes = np.full(pieces, h)
    sizes[-1] += rigid
    stiff = np.eye(pieces) / h  # of EI 1; the spring at the root has half a piece
    stiff[0, 0] *= 2.0
    return float(1.0 / eigh(stiff, turned.T @ np.diag(sizes) @ turned, eigvals_only=True)[0])


@given(st.floats(0.001, 1.0), LENGTH, st.floats(0.0, 0.3), st.floats(0.0, 1.2))
def test_the_least_stiffness_is_twice_that_which_buckles(mass, bends, rigid, lean) -> None:
    line = bends + rigid
    least = float(least_stiffness(mass, line * np.cos(lean), bends, rigid))
    pressing = mass * GRAVITY * np.cos(lean)
    assert least == pytest.approx(STANDS * pressing * buckling(bends, rigid), rel=0.03)
    euler = 8.0 * pressing * line**2 / np.pi**2  # of a stem that bends up to the mass
    assert least <= euler * (1.0 + 1e-6)
    assert float(least_stiffness(mass, line, line, 0.0)) * np.cos(lean) == pytest.approx(euler)
    assert least_stiffness(mass, -line, bends, rigid) == 0.0


def mushroom(stiffness: float | None = None, length: float = 0.06) -> SceneObject:
    top = np.array([0.4, 0.0, 0.2])
    physical = {} if stiffness is None else {"stem_stiffness": stiffness}
    stem = Stem(np.array([top, top - [0.0, 0.0, length]]))
    return SceneObject("cap", "target", Sphere(0.02), top, stem=stem, physical=physical)


def test_a_stem_that_is_stated_too_soft_is_refused() -> None:
    mass = 950.0 * 4.0 / 3.0 * np.pi * 0.02**3
    least = float(least_stiffness(mass, 0.06, 0.04, 0.02))
    posed(Scene("bed", "panda", (mushroom(least),)))
    with pytest.raises(InvalidSceneError, match=r"'cap'.*stem_stiffness is .*must be at least"):
        posed(Scene("bed", "panda", (mushroom(0.99 * least),)))
    unsure = replace(mushroom(0.5 * least), sigma=0.003)  # its length has an error
    posed(Scene("bed", "panda", (unsure,)))
    stem = Stem(np.array([[0.4, 0.02, 0.2], [0.4, 0.0, 0.18]]), parent="cap")
    grown = SceneObject("n1", "pushable", Sphere(0.02), stem.points[0], stem=stem)
    with pytest.raises(InvalidSceneError, match="carries 63"):  # g, of two fruits
        posed(Scene("bed", "panda", (mushroom(1.1 * least), grown)))


@given(st.floats(0.03, 0.3), st.sampled_from([0.1, 0.5, 1.0, 2.0]))
def test_the_push_model_stands_too(length: float, factor: float) -> None:
    """However soft a state, a fruit that is pushed aside springs back."""
    for stiffness in (None, 1e-6):
        one = stems([mushroom(stiffness, length)], factor=np.array([factor]))
        assert np.linalg.eigvalsh(one.stiffness[0]).min() > 0.0
