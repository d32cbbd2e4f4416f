"""Tools: where the tool point lies, what the spheres cover, what is refused."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from tests.refusals import assert_refused
from tests.robots.covers import worst_gap
from tests.robots.links import BALL, Writer, joint

from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.tools import Cup, FrankaHand, with_tool, without_tool


def cup_surface(cup: Cup) -> np.ndarray:
    """Dense points of outer wall, base or cone, rim and neck, in the flange frame."""
    angle = np.linspace(0.0, 2.0 * math.pi, 90, endpoint=False) + 0.003
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    inner = cup.radius if cup.opening is None else cup.opening / 2.0
    rows = [(cup.radius, cup.length + z) for z in np.linspace(0.0, cup.height, 40)]
    rows += [(r, cup.length) for r in np.linspace(0.0, cup.radius, 25)]
    cone = np.linspace([cup.radius, cup.length], [min(0.01, cup.radius), cup.length - cup.cone], 60)
    rows += cone.tolist()
    rows += [(r, cup.length + cup.height) for r in np.linspace(inner, cup.radius, 25)]
    rows += [(0.01, z) for z in np.linspace(0.0, cup.length, 25) if cup.length > 0.0]
    return np.concatenate([np.column_stack([r * ring, np.full(len(ring), z)]) for r, z in rows])


@settings(max_examples=25, deadline=None)
@given(
    radius=st.floats(0.01, 0.2),
    height=st.floats(0.01, 3.0),
    length=st.floats(0.0, 0.3),
    share=st.floats(0.05, 1.0),
    steep=st.sampled_from([0.0, 0.2, 0.6, 1.0]),
)
@example(radius=0.0390625, height=2.0, length=0.0, share=0.5, steep=0.0)
@example(radius=0.05, height=0.05, length=0.1, share=0.9, steep=0.7)
def test_cup_is_covered_and_little_more(radius, height, length, share, steep):
    most = min(math.degrees(math.atan2(length, max(radius - 0.01, 0.0))), 89.0)
    taper = steep * round(most, 2)
    cup = Cup(radius, height, length, height / 2, opening=2.0 * radius * share, taper=taper)
    cover = cup.spheres()
    assert worst_gap(cup_surface(cup), cover) <= 1e-9
    bulge = max(0.004, 0.09 * radius) + 1e-6
    body = cover[cover[:, 2] > length - 1e-9] if length else cover
    outward = np.hypot(cover[:, 0], cover[:, 1]) + cover[:, 3]
    if not cup.cone or radius <= height + bulge:  # spheres under a wide dish are larger
        assert (outward <= max(radius, 0.01) + bulge).all()
    assert ((body[:, 2] + body[:, 3]) <= length + height + bulge).all()


def test_a_cone_ends_on_the_neck() -> None:
    assert Cup(0.05).cone == 0.0
    assert Cup(0.05, taper=45).cone == pytest.approx(0.04)
    assert Cup(0.03, length=0.02, taper=45).cone == pytest.approx(0.02)
    assert Cup(0.008, taper=45).cone == 0.0  # thinner than the neck
    polygon = Cup(0.03, taper=45).outline()[-1]
    np.testing.assert_allclose(
        polygon, [[-0.05, -0.01], [-0.03, -0.03], [-0.03, 0.03], [-0.05, 0.01]]
    )


def test_a_second_tool_takes_the_place_of_the_first() -> None:
    panda = load_robot("panda")
    twice, once = with_tool(with_tool(panda, FrankaHand()), Cup(0.05)), with_tool(panda, Cup(0.05))
    np.testing.assert_array_equal(twice.spheres.center, once.spheres.center)
    np.testing.assert_array_equal(twice.self_pairs, once.self_pairs)
    bare = without_tool(once)
    assert bare.link_names == panda.link_names
    np.testing.assert_array_equal(bare.self_pairs, panda.self_pairs)
    np.testing.assert_array_equal(bare.tool_point, panda.tool_point)


def test_a_cup_among_the_fingers_of_the_robot_is_told_of(urdf: Writer) -> None:
    """A finger 0.15 m long stands beside a cup of 0.1 m of neck, and behind one of 0.16 m."""
    rod = (
        '<origin xyz="0.05 0 0.075"/><geometry><cylinder radius="0.005" length="0.15"/></geometry>'
    )
    links = f'<link name="a">{BALL}</link><link name="b">{BALL}</link><link name="finger">'
    links += f"<collision>{rod}</collision></link>"
    finger = joint("bf", "b", "finger", kind="fixed", axis="", limit="", origin="")
    robot = load_robot(urdf(joint("ab", "a", "b") + finger, links), tip="b")
    with pytest.warns(UserWarning, match="'finger' stands beside the mouth of the tool"):
        with_tool(robot, Cup(0.05, length=0.1))
    with_tool(robot, Cup(0.05, length=0.16))


def test_tool_against_the_forearm_is_seen() -> None:
    """At q6 = 0 the flange points back along the forearm, 0.088 beside it: a wide cup meets it."""
    panda = with_tool(load_robot("panda"), Cup(0.05))
    centers = panda.sphere_centers(np.array([0, 0, 0, -1.5, 0, 0, 0.8]))
    i, j = panda.self_pairs.T
    reach = panda.spheres.radius[i] + panda.spheres.radius[j]
    gaps = np.linalg.norm(centers[i] - centers[j], axis=1) - reach
    names = {panda.link_names[k] for k in panda.spheres.link[panda.self_pairs[gaps.argmin()]]}
    assert gaps.min() < 0.0
    assert names == {"link5", "tool"}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"radius": 0.0}, ["radius", "0.0"]),
        ({"radius": math.nan}, ["radius", "nan"]),
        ({"radius": 50}, ["radius is 50", "above 0 and at most 5 [m]"]),
        ({"radius": "0.05"}, ["radius", "'0.05'"]),
        ({"radius": True}, ["radius", "True"]),
        ({"radius": 0.05, "depth": 0.06}, ["depth", "0.06", "0.05]"]),
        ({"radius": 0.05, "opening": 0.11}, ["opening", "0.11", "0.1]"]),
        ({"radius": 0.05, "taper": -1}, ["taper is -1", "[0, 68.2] degrees"]),
        ({"radius": 0.05, "taper": 90}, ["taper is 90", "[0, 68.2] degrees", "neck of 0.1 metres"]),
        ({"radius": 0.05, "length": 0.0, "taper": 1}, ["taper is 1", "[0, 0] degrees"]),
    ],
)
def test_cup_refused(values: dict[str, float], words: list[str]) -> None:
    assert_refused(InvalidRequestError, ["tool cup", *words], Cup, **values)
