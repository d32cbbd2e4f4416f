"""Frames by name: those that move, that change their parent, and the links of an arm."""

import math
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tests.robots.arms import GRIPPER, fixed, robot, series
from tests.robots.links import BALL
from tests.ros.camera_messages import frames

from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.robots import load_robot
from optipromp.core.scenes.hand import flange_of, tool_frame
from optipromp.core.scenes.pose import Pose
from optipromp_ros.frames import Frames, known_frames, link_prefix

MS = 10**6  # [ns]
BASE = {"base": Pose()}
TURN = Pose([3.0, 0.0, 0.0], Rotation.from_rotvec([0.0, 0.0, 1.0]).as_matrix())


def tree(*told: tuple[int, str, str, Pose]) -> Frames:
    """Frames that move: time [ms], parent, child, pose."""
    made = Frames()
    made.heard(frames(0, ("world", "/base", Pose([1.0, 0.0, 0.0]))), still=True)
    for time, *link in told:
        made.heard(frames(time * MS, tuple(link)), still=False)
    return made


def test_frames_that_move_are_between_their_times() -> None:
    made = tree((100, "world", "link7", TURN), (0, "world", "link7", Pose([2.0, 0.0, 0.0])))
    made.heard(frames(0, ("link7", "camera", Pose([0.0, 0.1, 0.0]))), still=True)
    half = made.find("/camera", BASE, 50 * MS)
    want = [1.5 - 0.1 * math.sin(0.5), 0.1 * math.cos(0.5), 0.0]
    assert half.position == pytest.approx(want, abs=1e-12)
    made.heard(frames(0, ("b", "a", Pose()), ("a", "b", Pose())), still=True)  # a loop
    for name, why in (
        ("camera", "'link7': not told within 0.2 s of then"), ("elsewhere", "must be 'base'"),
        ("a", "must be 'base', or hang on one of these"),
    ):  # fmt: skip
        with pytest.raises(InvalidRequestError, match=why):
            made.find(name, BASE, 500 * MS)


def test_a_frame_whose_turn_is_none_is_named() -> None:
    bad = frames(0, ("base", "eye", Pose()))
    bad.transforms[0].transform.rotation.w = 0.0
    with pytest.raises(InvalidSceneError, match="frame 'eye': "):
        tree().heard(bad, still=True)


def test_between_two_parents_the_earlier_one_counts() -> None:
    """As in tf2: a frame is never between its places in two frames."""
    hand, table = Pose([0.0, 0.0, 0.1]), Pose([5.0, 0.0, 0.0])
    told = [(time, "hand", "fruit", hand) for time in range(0, 500, 50)]
    told += [(time, "base", "fruit", table) for time in range(500, 1000, 50)]
    made = tree(*told)
    made.heard(frames(0, ("base", "hand", Pose([0.0, 1.0, 0.0]))), still=True)
    for time, want in ((475, [0.0, 1.0, 0.1]), (500, table.position), (1100, table.position)):
        assert made.find("fruit", BASE, time * MS).position == pytest.approx(want)


ASIDE, UP = Pose([0.4, 0.3, 0.6]), ("hand", "base")
TWICE = [
    (time, "base", "eye", Pose([x, 0.0, 0.0])) for x in (0.0, 0.1) for time in range(0, 900, 20)
]


@pytest.mark.parametrize(
    ("told", "why"),
    [
        ([(20 * k, UP[k % 2], "eye", ASIDE) for k in range(40)], "on base and hand in turn"),
        ([(0, "base", "eye", Pose()), (900, "base", "eye", ASIDE)], r"was told for 0\.900 s"),
        ([(0, "base", "eye", ASIDE), (900, "hand", "eye", ASIDE)], r"was told for 0\.900 s"),
        (TWICE, "the clock of its frames was set back"),
    ],
    ids=["two senders", "gap", "another parent after a gap", "clock set back"],
)  # fmt: skip
def test_what_nobody_knows_is_refused(told: list[tuple[int, str, str, Pose]], why: str) -> None:
    with pytest.raises(InvalidRequestError, match=f"'eye': .*{why}"):
        tree(*told).find("eye", BASE, 410 * MS)


def test_what_stands_still_is_known_across_a_gap_and_by_both_clocks() -> None:
    made = tree(*((time, "base", "eye", ASIDE) for time in (0, 3000, 100, 3100)))
    assert made.find("eye", BASE, 1500 * MS).position == pytest.approx(ASIDE.position)


def test_the_links_of_a_file_with_a_hand_are_known_frames(tmp_path: Path) -> None:
    """Whatever link comes first and last in the file; but not what a gripper moves."""
    text = robot(fixed("base", "mark"), *series("a", "base", 6), fixed("alink6", "palm"), *GRIPPER)
    first = '<link name="palm">' + BALL + "</link>"
    (tmp_path / "a.urdf").write_text(text.replace(first, "").replace('"r">', f'"r">{first}'))
    arm, up = load_robot(tmp_path / "a.urdf"), Pose([0.0, 0.0, 0.2])
    q = np.linspace(-0.5, 0.7, 6)
    known = known_frames(arm, "l_", Pose([0.0, 0.0, 2.0]), q)
    links = "base", "mark", *(f"alink{k}" for k in range(1, 7)), "palm"
    assert set(known) == {"", "tool", "world", *(f"l_{link}" for link in links)}
    wanted = {"": Pose(), "l_base": Pose(), "l_mark": up, "world": Pose([0.0, 0.0, -2.0])}
    for k, (origin, turn) in enumerate(zip(*arm.segment_frames(q), strict=True)):
        wanted[f"l_alink{k + 1}"] = Pose(origin, turn)
    wanted |= {"l_palm": wanted["l_alink6"] @ up, "tool": tool_frame(arm, q)}
    wanted["l_" + arm.arm.tip] = flange_of(arm, q)
    for name, want in wanted.items():
        np.testing.assert_allclose(known[name].position, want.position, atol=1e-12)
        np.testing.assert_allclose(known[name].rotation, want.rotation, atol=1e-12)
    assert set(known_frames(arm)) == {"", "base", "mark", "world"}
    (tmp_path / "b.urdf").write_text(robot(*series("a", "world", 6)))
    rooted = known_frames(load_robot(tmp_path / "b.urdf"), base=Pose([0.0, 0.0, 2.0]))
    assert rooted["world"].is_identity, "its own link of that name"


PANDA = load_robot("panda")
ALONE = {"link0", "camera_color_optical_frame"}
PLATFORM = {"link0", "wheel", *(f"arm_link{k}" for k in range(8)), "arm_camera_link"}
BOTH = {f"{side}_link{k}" for side in ("left", "right") for k in range(8)}


@pytest.mark.parametrize(
    ("names", "joints", "stated", "want"),
    [
        (ALONE, None, "", ""), (ALONE, "fr3_", "", ""), (set(), "fr3_", "", "fr3_"),
        (PLATFORM, "arm_", "", "arm_"), (PLATFORM, None, "", "arm_"), (PLATFORM, "", "", ""),
        (BOTH, "right_", "", "right_"), (BOTH, None, "left_", "left_"), (BOTH, "", "top_", "top_"),
        ({"cell/fr3_link0"}, "fr3_", "fr3_", "cell/fr3_"),
    ],
)  # fmt: skip
def test_the_arm_is_behind_the_prefix_of_its_joints(names, joints, stated, want):
    assert link_prefix(names, PANDA, joints, stated) == want


def test_of_two_arms_frames_want_a_prefix() -> None:
    with pytest.raises(InvalidRequestError, match="each of the prefixes"):
        link_prefix(BOTH, PANDA, None)
