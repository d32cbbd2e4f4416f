"""The cup's shape as fruits meet it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from optipromp.core.geometry import distances, pack
from optipromp.core.pushing.stems.cup import (
    Mouth,
    MouthPose,
    cup_distance,
    flange_of,
    fruit_gap,
    inside_cup,
    taken,
)
from optipromp.core.robots import Cup, FingerGripper, FrankaHand, load_robot, with_tool

CUPS = st.builds(
    lambda inner, wall, base, rim, neck, flange, under, cone: Mouth(
        inner, inner + wall, base, rim, 0.002, neck * inner, flange * inner, base - under, cone=cone
    ),
    st.floats(0.015, 0.04), st.floats(0.001, 0.01), st.floats(-0.06, -0.02), st.floats(0.0, 0.03),
    st.floats(0.2, 0.8), st.sampled_from([0.0, 1.0, 1.7]), st.floats(0.01, 0.08),
    st.sampled_from([0.0, 0.003, 0.02, 0.06]),
)  # fmt: skip


def outline(cup: Mouth, spacing: float = 2e-4) -> np.ndarray:
    """Points on the edges of wall, floor, neck, cone and flange, in the half-plane and mirrored."""
    flange = ((-cup.flange, cup.flange, cup.flange_top - 0.2, cup.flange_top),)
    boxes = (
        *(flange if cup.flange > cup.neck else ()),
        (cup.inner, cup.outer, cup.base, cup.rim),
        (-cup.outer, cup.outer, cup.base, cup.base + cup.floor),
        (-cup.neck, cup.neck, cup.base - 0.2, cup.base),
    )
    edges = []
    for left, right, low, high in boxes:
        x = np.linspace(left, right, int((right - left) / spacing) + 2)
        y = np.linspace(low, high, int((high - low) / spacing) + 2)
        edges += [np.stack([x, np.full_like(x, v)], axis=1) for v in (low, high)]
        edges += [np.stack([np.full_like(y, v), y], axis=1) for v in (left, right)]
    ends = np.array([[cup.outer, cup.base], [cup.neck, cup.base - cup.cone]])
    count = int(np.linalg.norm(ends[0] - ends[1]) / spacing) + 2
    edges += [np.linspace(*(ends * [side, 1.0]), count) for side in (-1.0, 1.0) if cup.cone]
    return np.vstack(edges)


def solid(cup: Mouth, rho: float, h: float) -> bool:
    wall = cup.inner <= rho <= cup.outer and cup.base <= h <= cup.rim
    floor = rho <= cup.outer and cup.base <= h <= cup.base + cup.floor
    flange = cup.neck < cup.flange >= rho and h <= cup.flange_top
    wide = np.interp(h, [cup.base - cup.cone, cup.base], [cup.neck, cup.outer])
    return wall or floor or flange or (rho <= (wide if cup.cone else cup.neck) and h <= cup.base)


@settings(max_examples=200, deadline=None)
@given(CUPS, st.floats(0.0, 0.1), st.floats(-0.15, 0.1))
def test_the_distance_to_the_cup_is_that_to_its_outline(cup: Mouth, rho: float, h: float) -> None:
    d = cup_distance(rho, h, cup)[0]
    if solid(cup, rho, h):
        assert d <= 1e-15
        return
    brute = np.linalg.norm(outline(cup) - [rho, h], axis=1).min()
    assert d <= brute + 1e-12
    # half the spacing of the samples along an edge that is d away
    assert np.hypot(d, 1e-4) >= brute - 1e-12


@settings(max_examples=200, deadline=None)
@given(CUPS, st.floats(0.0, 0.1), st.floats(-0.15, 0.1))
def test_its_gradient_is_that_of_finite_differences(cup: Mouth, rho: float, h: float) -> None:
    eps = 1e-7
    d, *gradient = cup_distance(rho, h, cup)
    assume(abs(d) > 1e-4)
    assert np.linalg.norm(gradient) == pytest.approx(1.0)
    found = np.empty(2)
    for c, way in enumerate(eps * np.eye(2)):
        high, *other = cup_distance(rho + way[0], h + way[1], cup)
        assume(np.allclose(other, gradient, atol=1e-2))  # not across a kink
        low, *other = cup_distance(rho - way[0], h - way[1], cup)
        assume(np.allclose(other, gradient, atol=1e-2))
        found[c] = (high - low) / (2.0 * eps)
    # an edge's curvature is 1/d where it ends, none before
    np.testing.assert_allclose(found, gradient, atol=1e-6 + eps / abs(d))


@pytest.mark.parametrize("tool", [Cup(0.03), Cup(0.05, length=0.15), FrankaHand()])
def test_the_flange_is_where_the_last_link_is(tool: Cup | FrankaHand) -> None:
    """Rays from outside at the tool axis meet the link's spheres at its radius in the median."""
    robot = with_tool(load_robot("panda"), tool)
    radius, top, low = flange_of(robot)
    link = robot.spheres.link == robot.link_names.index("link7")
    center, size = robot.spheres.center[link], robot.spheres.radius[link]
    away = center - robot.tool_point
    along, across = away @ robot.tool_axis, away @ np.linalg.svd(robot.tool_axis[None])[2][1:].T
    steps, reach, height = np.linspace(0.0, 0.15, 301), [], []

    def top_of(at: np.ndarray) -> np.ndarray:
        """Where rays along the axis from ``at`` (N, 2) leave the spheres (N,); -inf: they miss."""
        off = np.minimum(np.linalg.norm(across - at[:, None], axis=2) / size, 1.0)
        return np.where(off < 1.0, along + size * np.sqrt(1.0 - off**2), -np.inf).max(axis=1)

    for angle in np.linspace(0.0, 2.0 * np.pi, 50):
        toward = np.array([[np.cos(angle), np.sin(angle)]])
        reach.append(steps[np.isfinite(top_of(steps[:, None] * toward))].max())
        height.append(top_of(0.7 * radius * toward)[0])
    assert radius == pytest.approx(np.median(reach), abs=1.5e-3)
    assert top == pytest.approx(np.median(height), abs=1.5e-3)
    assert top < -tool.reach + 0.02
    assert low == pytest.approx(((center - robot.tool_point) @ robot.tool_axis - size).min())


def test_a_robot_without_spheres_there_has_no_flange() -> None:
    bare = load_robot("panda")
    spheres = bare.spheres
    kept = spheres.link != bare.link_names.index("link7")
    fewer = type(spheres)(*(values[kept] for values in spheres))
    assert flange_of(replace(bare, spheres=fewer)) == (0.0, -1.0, -1.0)


FINGERS = FingerGripper(0.06, finger_length=0.06, palm_length=0.05)
HAND = Mouth(  # as it opens along y; its width is along x
    *FINGERS.mouth, FINGERS.front - FINGERS.reach, FINGERS.depth, 0.0, 0.0, within=0.01, ax=1.0,
    palm_x=0.025, palm_y=0.05, palm_end=-FINGERS.reach,
)  # fmt: skip
AT = MouthPose(0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
PLACE = st.tuples(*[st.floats(-0.15, 0.15)] * 3)


@settings(max_examples=200, deadline=None)
@given(PLACE)
def test_fruits_meet_fingers_as_they_are(place: tuple[float, float, float]) -> None:
    """Against the solids of the tool, by the geometry that the judge has."""
    boxes = [(each.shape, each.position - FINGERS.point, np.eye(3)) for each in FINGERS.solids()]
    away = sorted(float(distances(pack([one]), np.array([place]))[0].min()) for one in boxes)
    gap, *push = fruit_gap(*place, 0.01, AT, HAND)
    assume(away[0] > 1e-4)
    assert gap == pytest.approx(away[0] - 0.01, abs=1e-9)
    assert np.linalg.norm(push) == pytest.approx(1.0)
    assume(away[1] - away[0] > 1e-4)
    further = fruit_gap(*(np.array(place) + 1e-5 * np.array(push)), 0.01, AT, HAND)[0]
    assert further - gap == pytest.approx(1e-5, abs=2e-6)


@settings(max_examples=300, deadline=None)
@given(PLACE, PLACE, st.booleans())
def test_what_is_held_is_asked_of_the_body(begin, end, round_mouth) -> None:
    """The tool, and the push model of it, against points along the axis of a body."""
    tool = Cup(0.03, depth=0.02) if round_mouth else FINGERS
    held = bool(tool.holds(np.array([begin]), np.array([end]))[0])
    points = np.array(begin) + np.linspace(0.0, 1.0, 2001)[:, None] * np.subtract(end, begin)
    x, y, z = points.T
    across = np.hypot(x, y) if round_mouth else np.maximum(np.abs(y), 3.0 * np.abs(x))
    away = np.maximum(across - tool.mouth[0], np.abs(z - 0.5 * (tool.tip + tool.front) + tool.reach)
                      - 0.5 * (tool.tip - tool.front))  # fmt: skip
    assume(abs(away.min()) > 1e-3)
    assert held == (away.min() < 0.0)
    apart = float(np.linalg.norm(np.subtract(end, begin)))
    ends = tool.front - tool.reach, tool.depth + 0.003  # the model asks for 3 mm
    mouth = HAND if not round_mouth else Mouth(*tool.mouth, *ends, 0.0, 0.0)
    mouth = mouth._replace(rim=ends[1])
    assert taken(*begin, *end, apart, AT, mouth) == held


def test_a_ball_that_reaches_between_the_fingers_counts_and_the_target_must_be_inside() -> None:
    top = 0.0, 0.0, 0.3
    for place, near in (((0.02, 0.02, 0.0), True), ((0.03, 0.02, 0.0), False)):
        assert bool(inside_cup(*place, *top, 0.015, 0.0, AT, HAND)) is near
        assert not taken(*place, *top, 0.0, AT, HAND)
    before = 0.0, 0.02, FINGERS.depth + 0.002
    assert inside_cup(*before, *top, 0.015, 0.0, AT, HAND)
    assert not taken(*before, *top, 0.0, AT, HAND)
