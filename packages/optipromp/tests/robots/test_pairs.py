"""Which links of a robot from a file are kept apart: SRDF, and what random configurations say."""

import numpy as np
import pytest
from tests.robots.links import Writer, joint
from tests.robots.stock import STOCK, stock

from optipromp.core import judging
from optipromp.core.errors import InvalidRobotError
from optipromp.core.optimization.costs.obstacles import self_overlap
from optipromp.core.optimization.evaluation import BodyPoints, Evaluation
from optipromp.core.robots import Robot, load_robot
from optipromp.core.scenes import JointGoal, Scene


def chain(radius: float = 0.05, count: int = 5) -> str:
    """Links l0 to l4, capsules of 0.3 m, each turning about z at the end of the one before."""
    body = (
        '<collision><origin xyz="0.15 0 0" rpy="0 1.5707963 0"/><geometry>'
        f'<capsule radius="{radius}" length="0.2"/></geometry></collision>'
    )
    links = "".join(f'<link name="l{i}">{body}</link>' for i in range(count))
    joints = "".join(
        joint(
            f"j{i}", f"l{i}", f"l{i + 1}",
            limit='<limit lower="-3" upper="3" velocity="1"/>',
            origin='<origin xyz="0.3 0 0"/>',
        )
        for i in range(count - 1)
    )  # fmt: skip
    return f'<robot name="snake">{links}{joints}</robot>'


def kept_apart(robot: Robot) -> set[tuple[str, str]]:
    pairs = robot.spheres.link[robot.self_pairs]
    return {(robot.link_names[a], robot.link_names[b]) for a, b in pairs}


def srdf(*pairs: tuple[str, str], name: str = "snake") -> str:
    rows = "".join(f'<disable_collisions link1="{a}" link2="{b}"/>' for a, b in pairs)
    return f'<robot name="{name}">{rows}</robot>'


def test_pairs_that_an_srdf_disables(write: Writer) -> None:
    path = write(chain(), "snake.urdf")
    before = kept_apart(load_robot(path))
    assert before == {(f"l{i}", f"l{j}") for i in range(5) for j in range(i + 2, 5)}
    write(srdf(("l3", "l1"), ("l0", "gripper")), "snake.srdf")
    assert before - kept_apart(load_robot(path)) == {("l1", "l3")}


@pytest.mark.parametrize(
    ("name", "robot", "honoured"),
    [
        ("snake.srdf", "snake", True),
        ("other.srdf", "snake", True),  # the only one of that robot
        ("snake.srdf", "lizard", False),
        ("other.srdf", "lizard", False),
    ],
)
def test_whose_srdf_it_is(write: Writer, name: str, robot: str, honoured: bool) -> None:
    path = write(chain(), "snake_with_hand.urdf")
    write(srdf(("l1", "l3"), name=robot), name)
    assert (("l1", "l3") in kept_apart(load_robot(path))) is not honoured


def test_a_malformed_srdf_is_named(write: Writer) -> None:
    path = write(chain(), "snake.urdf")
    write("<robot", "other.srdf")
    load_robot(path)  # of something else
    write("<robot", "snake.srdf")
    with pytest.raises(InvalidRobotError, match=r"snake\.srdf"):
        load_robot(path)


def test_links_that_never_come_near_are_left_out(write: Writer) -> None:
    text = chain().replace('lower="-3" upper="3"', 'lower="-0.2" upper="0.2"')
    robot = load_robot(write(text, "stiff.urdf"))
    assert ("l0", "l4") not in kept_apart(robot)
    assert {("l0", "l4"): "never near"}.items() <= {
        (a, b): why for a, b, why in robot.left_out
    }.items()


def test_only_the_covers_touch_at_home(urdf: Writer) -> None:
    """l0 is a box that a cover exceeds; l2 stands 5 mm before it at home, and may fold into it."""
    box = '<geometry><box size="0.3 0.3 0.02"/></geometry>'
    links = (
        f'<link name="l0"><collision>{box}</collision></link><link name="l1"/>'
        '<link name="l2"><collision><origin xyz="0.1 0 0.035"/><geometry><sphere radius="0.02"/>'
        '</geometry></collision><collision><origin xyz="0.4 0 0.2"/><geometry>'
        '<sphere radius="0.05"/></geometry></collision></link>'
    )
    joints = joint("j0", "l0", "l1", origin="") + joint(
        "j1", "l1", "l2", origin="", axis='<axis xyz="0 1 0"/>'
    )
    robot = load_robot(urdf(joints, links))
    assert robot.excess["l0"] > 0.005
    assert ("l0", "l2") in kept_apart(robot)
    assert robot.self_gaps(robot.home).min() >= 0.0
    assert robot.self_gaps(np.array([0.0, 0.3])).min() < 0.0  # 24 mm into the box


def folded(gap: float) -> str:
    """Two bars: at home, where the joint between them is at its limit, one lies over the other."""
    bar = '<collision><origin xyz="{} 0 0"/><geometry><box size="0.3 0.06 0.06"/></geometry>'
    upper, fore = (f"{bar.format(at)}</collision>" for at in (0.15, -0.15))
    links = f'<link name="base"/><link name="upper">{upper}</link><link name="elbow"/>'
    joints = (
        joint("turn", "base", "upper", origin="")
        + joint(
            "fold", "upper", "elbow", axis='<axis xyz="0 1 0"/>',
            origin=f'<origin xyz="0.3 0 {0.06 + gap}"/>', limit='<limit lower="0" upper="2.9"/>',
        )
        + joint(
            "tilt", "elbow", "fore", axis='<axis xyz="0 1 0"/>', origin='<origin xyz="-0.05 0 0"/>',
            limit='<limit lower="-1.5" upper="1.5"/>',
        )
    )  # fmt: skip
    return f'<robot name="fold">{links}<link name="fore">{fore}</link>{joints}</robot>'


@pytest.mark.parametrize("gap", [0.015, 0.005])
def test_a_home_at_a_limit_is_settled_by_surfaces(write: Writer, gap: float) -> None:
    """Covers meet there though the bars are apart, as in a Piper. Nothing goes unseen for it."""
    robot = load_robot(write(folded(gap)))
    assert robot.home[1] == robot.lower[1]
    assert sum(robot.excess.values()) > gap
    assert robot.self_gaps(robot.home).min() >= 0.0
    rng = np.random.default_rng(0)
    q = np.clip(robot.home + rng.uniform(-0.5, 0.5, (4000, 3)), robot.lower, robot.upper)
    origins, turns = robot.segment_frames(q)
    steps = np.linspace(-0.3, 0.0, 61)
    under = np.stack([steps, 0.0 * steps, np.full(61, -0.03)], axis=-1)  # a row of the upper face
    points = under @ turns[:, 2].transpose(0, 2, 1) + origins[:, 2, None] - origins[:, 0, None]
    inside = np.einsum("kpj,kji->kpi", points, turns[:, 0]) - [0.15, 0.0, 0.0]
    touch = (np.abs(inside) < [0.149, 0.029, 0.029]).all(axis=2).any(axis=1)
    short = (robot.self_gaps(q) < 0.0).any(axis=1)
    assert 500 < touch.sum() < 3000
    assert short[touch].all()


def test_bars_that_touch_at_home_are_told_so(write: Writer) -> None:
    robot = load_robot(write(folded(-0.002)))
    assert robot.self_gaps(robot.home).min() < 0.0


def test_the_rim_of_a_base_that_stands_on_its_plane_is_kept(urdf: Writer) -> None:
    """A rod swings down past a round base, 6 mm within its rim. The base's spheres are raised, so
    that the rim at its foot is in none of them. Its cover always meets that of the rod's hub."""
    links = (
        '<link name="base"><collision><origin xyz="0 0 0.05"/><geometry>'
        '<cylinder radius="0.1" length="0.1"/></geometry></collision></link><link name="l1"/>'
        '<link name="l2"><collision><origin xyz="0 0 -0.2"/><geometry>'
        '<cylinder radius="0.02" length="0.36"/></geometry></collision><collision><geometry>'
        '<sphere radius="0.115"/></geometry></collision></link>'
    )
    joints = joint("turn", "base", "l1", origin='<origin xyz="0 0 0.22"/>') + joint(
        "swing", "l1", "l2", origin='<origin xyz="0 0.114 0"/>', axis='<axis xyz="0 1 0"/>'
    )
    robot = load_robot(urdf(joints, links))
    fixed = robot.spheres.segment < 0
    assert (robot.spheres.center[fixed, 2] - robot.spheres.radius[fixed]).min() > -1e-6
    q = np.random.default_rng(0).uniform(robot.lower, robot.upper, (400, 2))
    down, round_ = np.meshgrid(np.linspace(-0.38, -0.02, 90), np.linspace(0.0, 2 * np.pi, 60))
    rod = np.stack([0.02 * np.cos(round_), 0.02 * np.sin(round_), down], -1).reshape(-1, 3)
    origins, turns = robot.segment_frames(q)
    points = rod @ turns[:, 1].transpose(0, 2, 1) + origins[:, 1, None]
    beside = np.hypot(points[..., 0], points[..., 1]) < 0.0995
    touch = (beside & (points[..., 2] > 0.0005) & (points[..., 2] < 0.0995)).any(axis=1)
    assert 10 < touch.sum() < 200
    short = (robot.self_gaps(q) < 0.0).any(axis=1)
    assert short[touch].all()
    goal = Scene("s", "r", (), goal=JointGoal(q[0]))
    judged = [bool(judging.clearances(goal, robot, row[None])[1]) for row in q]
    np.testing.assert_array_equal(judged, short)
    arrays = Evaluation(robot, BodyPoints(robot), len(q), 1.0)
    arrays.move_to(q)
    overlap = self_overlap(arrays, 0.0)
    np.testing.assert_array_equal(overlap > 0.0, short)


# -- against the meshes of robots of the trade ---------------------------------------------------

TOOLS = ("hand", "finger")
CONFIGURATIONS = 300


@pytest.mark.parametrize("name", STOCK)
def test_a_stock_robot(name: str) -> None:
    """Covered whole, by few spheres; and free of itself where its meshes are."""
    for needed in ("coal", "trimesh", *(["collada"] if name == "kinova" else [])):
        pytest.importorskip(needed)
    from tests.robots.touching import link_meshes, meshes_touch, random_configurations

    robot = load_robot(stock(name))
    places = {each.link: each for each in robot.geometry}
    arm = [i for i, n in enumerate(robot.link_names) if not any(word in n for word in TOOLS)]
    moving = robot.spheres.segment >= 0
    assert (np.isin(robot.spheres.link, arm) & moving).sum() <= 60
    for link, triangles in link_meshes(robot).items():
        mine = robot.spheres.link == robot.link_names.index(link)
        place = places[link]
        picked = np.random.default_rng(0).integers(len(triangles), size=3000)
        inner = np.random.default_rng(1).dirichlet([1.0] * 3, 3000)
        points = np.vstack(
            [triangles.reshape(-1, 3), np.einsum("pk,pki->pi", inner, triangles[picked])]
        )
        here = np.unique(points, axis=0) @ place.rotation.T + place.translation
        away = np.linalg.norm(here[:, None] - robot.spheres.center[mine], axis=2)
        outside = (away - robot.spheres.radius[mine]).min(axis=1)
        if place.segment < 0:  # the base: raised onto the plane it stands on
            assert (robot.spheres.center[mine, 2] - robot.spheres.radius[mine]).min() >= 0.0
            assert outside.max() <= 0.015, link
        else:
            assert outside.max() <= 1e-9, link
        assert robot.excess[link] <= 0.03, link
    q = random_configurations(robot, CONFIGURATIONS)
    gaps = robot.self_gaps(q).min(axis=1)
    theirs = meshes_touch(robot, q)
    assert not (theirs & (gaps > 0.001)).any()
    assert ((gaps < 0.0) == theirs).mean() >= STOCK[name][1]


@pytest.mark.parametrize(("turned", "kept"), [("0 0 0", False), ("0 0 0.5", True)])
def test_a_telescope_may_be_pushed_together(write: Writer, turned: str, kept: bool) -> None:
    """Tubes of one direction, and a wrist; a slide of another direction is no telescope's."""
    tube = '<collision><origin xyz="0.2 0 0"/><geometry><box size="0.4 {0} {0}"/></geometry>'
    links = "".join(
        f'<link name="t{k}">{tube.format(0.10 - 0.02 * k)}</collision></link>' for k in range(4)
    )
    slides = [
        joint(
            f"s{k}", f"t{k}", f"t{k + 1}", kind="prismatic", axis='<axis xyz="1 0 0"/>',
            limit='<limit lower="0" upper="0.4"/>',
            origin=f'<origin rpy="{turned if k == 1 else "0 0 0"}"/>',
        )
        for k in range(3)
    ]  # fmt: skip
    path = write(f'<robot name="r">{links}{"".join(slides)}</robot>')
    robot = load_robot(path, tip="t3")
    told = {(one, other) for one, other, why in robot.left_out if "one direction" in why}
    assert told == {("t1", "t3"), *(() if kept else (("t0", "t2"), ("t0", "t3")))}
    assert (robot.self_gaps(np.zeros((1, 3))).min(initial=np.inf) < 0.0) == kept
