"""Which joints are the arm and which link is the flange: by hand, by SRDF, by rule."""

import re

import numpy as np
import pytest
import yaml
from tests.cli.fixtures import completed, invoke
from tests.refusals import assert_refused
from tests.robots.arms import (
    ARM,
    CAMERA,
    GRIPPER,
    SHORT,
    TORSO,
    TWO,
    WHEELS,
    fixed,
    robot,
    series,
    slide,
)
from tests.robots.links import BALL, Writer, joint

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.library import Choice, load_arm, load_robot

CASES = {  # joints of the file, tip, base, number of joints of the arm, links of the tool
    "plain": (ARM, "alink6", "base", 6, ()),
    "frame at the end": ([*ARM, fixed("alink6", "end")], "end", "base", 6, ()),
    "tool0": (
        [*ARM, fixed("alink6", "ee_link"), fixed("alink6", "f"), fixed("f", "tool0")],
        "tool0", "base", 6, (),
    ),
    "gripper with mimic": (
        [*ARM, fixed("alink6", "palm"), *GRIPPER], "alink6", "base", 6, ("palm", "pad1", "pad2"),
    ),
    "fingers by name": (
        [*ARM, fixed("alink6", "mount"), slide("finger_joint", "mount", "tip")],
        "alink6", "base", 6, ("mount", "tip"),
    ),
    "two equal fingers without names": (
        [*ARM, *series("x", "alink6", 2), *series("y", "alink6", 2)],
        "alink6", "base", 6, ("xlink1", "xlink2", "ylink1", "ylink2"),
    ),
    "gripper on the last link": (
        [*ARM, joint("jaw", "alink6", "moving"), fixed("alink6", "grasp_frame")],
        "grasp_frame", "base", 6, ("moving",),
    ),
    "camera on the wrist": (
        [*ARM, *CAMERA, fixed("alink6", "end_effector_link")], "end_effector_link", "base", 6, (),
    ),
    "camera deeper than the flange": ([*ARM, *CAMERA], "alink6", "base", 6, ()),
    "wheels": (
        [*WHEELS, *series("a", "chassis", 5)], "alink5", "chassis", 5, (),
    ),
    "torso with a head": (
        [*TORSO, *series("head_", "column", 2), *series("a", "column", 7)],
        "alink7", "column", 7, (),
    ),
    "lift of one arm": ([*TORSO, *series("a", "column", 3)], "alink3", "foot", 4, ()),
    "arm on legs": (
        [t for k in range(4) for t in series(f"leg{k}_", "body", 3)] + series("a", "body", 6),
        "alink6", "body", 6, (),
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_rule(write: Writer, case: str) -> None:
    joints, tip, base, count, tool = CASES[case]
    loaded, arm = load_arm(write(robot(*joints)))
    assert (arm.tip, arm.base, arm.tool) == (tip, base, tool)
    assert loaded.n_joints == count
    assert loaded.joint_names == arm.joints
    assert not any(name.startswith(("left_", "right_", "finger", "jaw")) for name in arm.joints)


def test_a_frame_for_a_hand_that_is_not_there_is_the_flange(write: Writer) -> None:
    """In robosuite's models the flange's z is that of ``right_hand``, not of the last link."""
    text = robot(*ARM, fixed("alink6", "right_hand"), fixed("right_hand", "ee"))
    assert load_arm(write(text))[1].tip == "alink6"
    text = text.replace(f'<link name="right_hand">{BALL}</link>', '<link name="right_hand"/>')
    assert load_arm(write(text))[1].tip == "alink6"  # the hand is the link that it carries
    text = text.replace(f'<link name="ee">{BALL}</link>', '<link name="ee"/>')
    assert load_arm(write(text))[1].tip == "right_hand"


def test_fingers_ride_on_the_last_body_at_a_given_opening(write: Writer) -> None:
    path = write(robot(*ARM, fixed("alink6", "palm"), *GRIPPER))
    closed, opened = load_robot(path), load_robot(path, hold={"left_drive": 0.03})
    assert closed.held_joints == ("left_drive", "right_drive")
    for pad in ("pad1", "pad2"):
        mine = closed.spheres.link == closed.link_names.index(pad)
        assert closed.spheres.distal[mine].all()
        moved = opened.spheres.center[mine] - closed.spheres.center[mine]
        np.testing.assert_allclose(moved, [[0.0, 0.0, 0.03]])


@pytest.mark.parametrize(
    ("hold", "said"),
    [
        ({"left_drive": 1.0}, ["left_drive", "outside its limits [0, 0.04]"]),
        ({"a1": 0.5}, ["'a1'", "not of the arm: left_drive"]),
        ({"right_drive": 0.01}, ["'right_drive'", "by themselves"]),
    ],
)
def test_hold_refused(write: Writer, hold: dict[str, float], said: list[str]) -> None:
    path = write(robot(*ARM, fixed("alink6", "palm"), *GRIPPER))
    assert_refused(InvalidRobotError, ["robot.urdf", *said], load_robot, path, hold=hold)


def free(kind: str, parent: str, child: str) -> str:
    return joint(f"{parent}-{child}", parent, child, kind=kind, **SHORT)


@pytest.mark.parametrize("kind", ["planar", "floating"])
def test_an_arm_on_a_base_that_drives_or_floats(write: Writer, kind: str) -> None:
    wheeled = fixed("chassis", "base")
    path = write(robot(free(kind, "world", "chassis"), *WHEELS, wheeled, *ARM))
    with pytest.warns(UserWarning, match=rf"'world-chassis' is {kind}: taken as fixed, at zero"):
        found = load_robot(path)
    fixed_there = write(robot(fixed("world", "chassis"), *WHEELS, wheeled, *ARM), "other.urdf")
    assert found.joint_names == tuple(f"a{k + 1}" for k in range(6))
    home = np.full((1, 6), 0.3)
    for mine, theirs in zip(
        found.segment_frames(home), load_robot(fixed_there).segment_frames(home), strict=True
    ):
        np.testing.assert_array_equal(mine, theirs)


@pytest.mark.parametrize("kind", ["planar", "floating"])
@pytest.mark.parametrize("parent", ["alink3", "alink6"])
def test_an_arm_itself_neither_drives_nor_floats(write: Writer, kind: str, parent: str) -> None:
    path = write(robot(*ARM, free(kind, parent, "far"), *series("b", "far", 2)))
    with pytest.raises(InvalidRobotError, match=f"'{kind}'; .* only what an arm stands on"):
        load_robot(path)


def base_that_drives(*kinds: str, solid: bool = False) -> str:
    """Joints x, y and turn of ``kinds`` that carry ARM; links between without geometry."""
    axes, links, parts = ("1 0 0", "0 1 0", "0 0 1"), ["world", "rail", "wagon", "base"], []
    for kind, axis, name, parent, child in zip(kinds, axes, "xyt", links, links[1:], strict=False):
        limit = "" if kind == "continuous" else '<limit lower="-5" upper="5"/>'
        at = f'<axis xyz="{axis}"/>'
        parts.append(joint(name, parent, child, kind=kind, limit=limit, axis=at, origin=""))
    text = robot(*parts, *ARM)
    return text if solid else re.sub(f'(<link name="(?:world|rail|wagon)">){BALL}', r"\1", text)


def test_a_base_that_drives_is_no_part_of_the_arm(write: Writer) -> None:
    """Two slides and a turn, as simulators have them. Slides that can be seen are of a gantry."""
    path = write(base_that_drives("prismatic", "prismatic", "continuous"))
    driven, arm = load_arm(path)
    assert (driven.n_joints, driven.held_joints, arm.base) == (6, ("x", "y", "t"), "base")
    assert load_robot(path, base="world").n_joints == 9
    seen = write(base_that_drives("prismatic", "prismatic", "continuous", solid=True), "seen.urdf")
    assert load_robot(seen).n_joints == 9
    first = write(base_that_drives("revolute", "prismatic", "continuous"), "first.urdf")
    assert load_robot(first).n_joints == 9


def test_a_wrist_that_turns_a_jaw_is_of_the_arm(write: Writer) -> None:
    """As in an SO-100: the roll of the wrist carries the fixed jaw, and the gripper the other."""
    jaws = [joint("wrist_roll", "alink4", "fixed_jaw"), joint("gripper", "fixed_jaw", "moving_jaw")]
    found, arm = load_arm(write(robot(*series("a", "base", 4), *jaws)))
    assert found.joint_names[-1] == "wrist_roll"
    assert (arm.tip, found.held_joints) == ("fixed_jaw", ("gripper",))


@pytest.mark.parametrize("written", ['velocity="0"', 'effort="0" velocity="0.0"', ""])
def test_a_velocity_of_zero_is_none(write, written, recwarn):
    """Some programs write it where they know none. It is told, but where a robot file has others,
    and of joints that are held."""
    limit = f'<limit lower="-1" upper="1" {written}/>'
    held = joint("two", "base", "held", limit='<limit lower="-1" upper="1" velocity="0"/>')
    path = write(robot(held, joint("one", "held", "b", limit=limit)))
    found = load_robot(path, base="held")
    assert np.isinf(found.velocity).all()

    def heard() -> list[str]:
        told = [str(each.message) for each in recwarn]
        return [words for words in told if "states no limits of acceleration" not in words]

    told = heard()
    if "velocity" in written:
        (one,) = told
        for word in (f"{path.name}:1:", "joint 'one'", "velocity limit 0", "taken as none"):
            assert word in one
    else:
        assert not told
    head = "format: 1\nname: mine\nurdf: robot.urdf\nbase: held\nvelocity: [2.0]\n"
    assert load_robot(write(head, "mine.yaml")).velocity == 2.0
    assert heard() == told


def test_two_arms_alike_are_a_question(write: Writer) -> None:
    path = write(robot(*TWO))
    words = "2 arms are alike", "tip 'leftlink6'", "tip 'rightlink6'", "--tip", "flange:"
    assert_refused(InvalidRobotError, words, load_robot, path)
    assert load_robot(path, tip="rightlink6").joint_names == tuple(
        f"right{k + 1}" for k in range(6)
    )
    assert load_robot(path, tip="rightlink6", base="foot").joint_names[0] == "lift"
    assert load_robot(path, base="rightlink1", tip="rightlink6").n_joints == 5


def test_check_says_what_was_chosen(write: Writer) -> None:
    turned = joint("t", "alink6", "tcp", kind="fixed", axis="", limit="",
                   origin='<origin rpy="0 1.5707963 0"/>')  # fmt: skip
    path = write(robot(*TORSO, *series("head_", "column", 2), *series("a", "column", 6), turned))
    for tip, angle in (("alink6", "along the axis of a6"), ("tcp", "90 degrees from the axis")):
        result = completed("check", str(path), "--tip", tip)
        said = dict(line.split(maxsplit=1) for line in result.stdout.splitlines()[1:])
        assert said["flange"] == tip
        assert said["base"] == "column"
        assert said["held"] == "lift, head_1, head_2"
        assert angle in result.stdout
    assert "tip 'tcp' (same joints)" in invoke("check", str(path)).stdout


@pytest.mark.parametrize(
    ("choice", "said"),
    [
        (Choice(tip="nowhere"), ["no flange link 'nowhere'", "links:"]),
        (Choice(base="nowhere"), ["no base link 'nowhere'", "links:"]),
        (Choice(tip="leftlink6", base="rightlink2"), ["'rightlink2' is not between", "leftlink3"]),
        (Choice(srdf="none.srdf"), ["none.srdf", "cannot be read"]),
    ],
)
def test_refused(write: Writer, choice: Choice, said: list[str]) -> None:
    path = write(robot(*TWO))
    assert_refused(InvalidRobotError, said, load_arm, path, choice=choice)


def test_a_built_in_robot_takes_no_choice() -> None:
    with pytest.raises(InvalidRobotError, match="'panda' is built in"):
        load_robot("panda", tip="link7")


BOX = '<collision><geometry><box size="0.04 0.04 0.2"/></geometry></collision>'


def built(*joints: str) -> str:
    """A robot of revolute joints "name parent child axis more", each of whose links has a box."""
    links, out = ["base"], []
    for each in joints:
        name, parent, child, axis, *more = each.split(" ", 4)
        links.append(child)
        limit = '<limit lower="-2" upper="2" velocity="2" effort="50"/>' + "".join(more)
        out.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 0.25"/><axis xyz="{axis.replace(",", " ")}"/>{limit}</joint>'
        )
    bodies = "".join(f"<link name={name!r}>{BOX}</link>" for name in links)
    return f'<robot name="r">{bodies}{"".join(out)}</robot>'


ARM3 = ("j1 base a 0,0,1", "j2 a b 0,1,0", "j3 b c 0,1,0", "j4 c d 1,0,0")


def test_bars_of_a_linkage_hold_no_joint_before_them(write: Writer) -> None:
    """The turning base was held, as the bars beside the arm counted for another limb."""
    path = write(built(*ARM3, "q1 a p1 0,1,0", "q2 p1 p2 0,-1,0"))
    with pytest.warns(UserWarning, match="joint q1 and what it carries look like bars"):
        robot = load_robot(path)
    assert robot.joint_names == ("j1", "j2", "j3", "j4")
    assert robot.held_joints == ("q1", "q2")


def test_couplings_may_stand_in_a_robot_file(write: Writer) -> None:
    """As of a lift of two stages that one motor drives."""
    write(built(*ARM3))
    words = {"format": 1, "name": "r", "urdf": "robot.urdf"}
    words["mimic"] = {"j3": {"joint": "j2", "multiplier": -0.5, "offset": 0.2}}
    robot = load_robot(write(yaml.safe_dump(words), "r.yaml"))
    assert robot.joint_names == ("j1", "j2", "j4")
    np.testing.assert_allclose(robot.kinematics.multiplier, [1.0, 1.0, -0.5, 1.0])
    np.testing.assert_allclose(robot.kinematics.offset, [0.0, 0.0, 0.2, 0.0])
    words["mimic"] = {"j5": {"joint": "j2"}}
    with pytest.raises(InvalidRobotError, match=r"mimic: 'j5'.*j4"):
        load_robot(write(yaml.safe_dump(words), "r.yaml"))
    words["mimic"] = {"j3": {"joint": "j3"}}
    with pytest.raises(InvalidRobotError, match="mimic: joint 'j3' mimics itself"):
        load_robot(write(yaml.safe_dump(words), "r.yaml"))


def test_soft_limits_are_the_limits_where_they_are_narrower(write: Writer) -> None:
    soft = '<safety_controller soft_lower_limit="{}" soft_upper_limit="{}" k_velocity="20"/>'
    parts = ("j1 base a 0,0,1 " + soft.format(-1.5, 1.0), "j2 a b 0,1,0 " + soft.format(0, 0),
             "j3 b c 0,1,0 " + soft.format(-9, 9))  # fmt: skip
    with pytest.warns(UserWarning, match=r"'j1' <safety_controller> narrows its limits to \[-1.5"):
        robot = load_robot(write(built(*parts)))
    np.testing.assert_allclose(robot.lower, [-1.5, -2.0, -2.0])
    np.testing.assert_allclose(robot.upper, [1.0, 2.0, 2.0])


CONTROL = """<ros2_control name="arm" type="system">
<joint name="j1"><command_interface name="position"><param name="min">-1.0</param>
<param name="max">1.5</param></command_interface><state_interface name="position"/></joint>
<joint name="j2"><command_interface name="velocity"><param name="min">-0.5</param>
<param name="max"> 0.7 </param></command_interface></joint>
<joint name="j3"><command_interface name="position"><param name="max">-3</param>
</command_interface></joint></ros2_control></robot>"""


def test_limits_that_stand_beside_the_joints_are_told(write: Writer) -> None:
    """Of <ros2_control>, zeros, velocities in degrees, solids that are less than what is shown."""
    look = BOX.replace("collision", "visual")
    text = built(*ARM3).replace("</robot>", CONTROL)
    text = text.replace(
        "<link name='d'>" + BOX, "<link name='d'>" + look + BOX.replace("0.2", "0.05")
    )
    still = 'lower="0" upper="0" velocity="180"'.join(
        text.rsplit('lower="-2" upper="2" velocity="2"', 1)
    )
    with pytest.warns(UserWarning, match="robot.urdf") as told:
        robot = load_robot(write(still))
    words = "\n".join(str(each.message) for each in told)
    assert "j1' <ros2_control> narrows its limits to [-1, 1.5] from [-2, 2]" in words
    assert "j2' <ros2_control> narrows its velocities to [-0.5, 0.5] from [-2, 2]" in words
    assert "j3' <ros2_control> keeps [-inf, -3], nothing of its limits [-2, 2]" in words
    assert "urdf: j4 cannot move: both limits are the same" in words
    assert "urdf: j4 may move at 180 rad/s" in words
    assert "link 'd' is solid in 25 % of the width that is shown" in words
    assert (robot.lower[0], robot.velocity[1], robot.upper[2]) == (-1.0, 0.5, 2.0)


def test_a_passive_joint_of_the_srdf_is_no_joint_of_the_arm(write: Writer) -> None:
    path, groups = (
        write(built(*ARM3)),
        '<group name="arm"><chain base_link="base" tip_link="d"/></group>',
    )
    srdf = write(f'<robot name="r">{groups}<passive_joint name="j4"/></robot>', "r.srdf")
    told = r"calls joint 'j4' of the arm passive.*such as c "
    for choice in ({"srdf": srdf}, {"srdf": srdf, "tip": "d"}):
        with pytest.raises(InvalidRobotError, match=told):
            load_robot(path, **choice)
    assert load_robot(path, srdf=srdf, tip="c").n_joints == 3
