"""Which joints are the arm: by an SRDF, by the name of the arm, by a robot file."""

import json
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import invoke
from tests.robots.arms import ARM, GRIPPER, TWO, fixed, robot
from tests.robots.groups import along, groups
from tests.robots.links import Writer

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.library import Choice, load_arm, load_robot
from optipromp.core.scenes import scene_from_dict, scene_to_dict
from optipromp.core.scenes.scene import bare_robot


def listed(name: str, *joints: str) -> str:
    return f'<group name="{name}">' + "".join(f'<joint name="{j}"/>' for j in joints) + "</group>"


HAND = listed("hand", "left_drive")
BOTH = '<group name="arm_and_hand"><group name="arm"/><group name="hand"/></group>'
SRDFS = {
    "chain": ([along("arm", "base", "palm")], "palm"),
    "joints": ([listed("arm", *(f"a{k + 1}" for k in range(6))), HAND, BOTH], "alink6"),
    "a chain that runs into the gripper": ([along("arm", "base", "pad1")], "alink6"),
    "where the hand hangs": (
        [
            listed("arm", *(f"a{k + 1}" for k in range(6))),
            HAND,
            '<end_effector name="e" parent_link="palm" group="hand" parent_group="arm"/>',
        ],
        "palm",
    ),
}


@pytest.mark.parametrize(
    ("case", "where"),
    [(case, "robot.srdf") for case in SRDFS]
    + [("chain", "srdf/robot.srdf"), ("chain", "srdf/r.srdf")],
)
def test_srdf_beside(write: Writer, tmp_path: Path, case: str, where: str) -> None:
    parts, tip = SRDFS[case]
    path = write(robot(*ARM, fixed("alink6", "palm"), *GRIPPER))
    (tmp_path / "srdf").mkdir()
    write(groups(*parts), where)
    loaded, arm = load_arm(path)
    assert (arm.tip, loaded.n_joints) == (tip, 6)
    assert arm.why == f"group 'arm' of {Path(where).name}"


def test_srdf_given_beats_the_rule(write: Writer) -> None:
    """Of a torso with two arms the groups name one; the torso is in another group."""
    path = write(robot(*TWO))
    own = write(
        groups(along("arm", "column", "leftlink5"), along("arm_with_torso", "foot", "leftlink5")),
        "own.srdf",
    )
    loaded, arm = load_arm(path, choice=Choice(srdf=own))
    assert (arm.tip, arm.base, loaded.n_joints) == ("leftlink5", "column", 5)
    both = groups(along("l", "column", "leftlink6"), along("r", "column", "rightlink6"))
    with pytest.raises(InvalidRobotError, match="2 arms are alike"):
        load_robot(path, srdf=write(both, "both.srdf"))


def test_an_arm_of_two_is_chosen_by_its_name(write: Writer) -> None:
    path = write(robot(*TWO))
    for name in ("left", "right", "leftlink6"):
        loaded, arm = load_arm(path, choice=Choice(arm=name))
        assert (arm.tip, loaded.n_joints) == (f"{name.removesuffix('link6')}link6", 6)
    both = groups(along("one", "column", "leftlink6"), along("two", "column", "rightlink6"))
    own = write(both, "own.srdf")
    assert load_arm(path, choice=Choice(arm="two", srdf=own))[1].tip == "rightlink6"
    assert load_robot(path, arm="Left").joint_names[0] == "left1"
    with pytest.raises(InvalidRobotError, match=r"no arm 'leftlink7'.*did you mean 'leftlink6'"):
        load_robot(path, arm="leftlink7")
    with pytest.raises(InvalidRobotError, match="2 arms are alike"):
        load_robot(path, arm="link6")
    with pytest.raises(InvalidRobotError, match="goes without a tip"):
        load_robot(path, arm="left", tip="leftlink6")


def test_a_scene_and_the_command_line_choose_the_arm_by_name(write: Writer) -> None:
    path = write(robot(*TWO))
    document = {"name": "s", "robot": {"file": path.name, "arm": "right"}}
    scene = scene_from_dict(document | {"goal": {"joints": [0.1] * 6}}, base_dir=path.parent)
    assert bare_robot(scene).arm.tip == "rightlink6"
    assert scene_to_dict(scene, base_dir=path.parent)["robot"] == document["robot"]
    done = invoke("check", str(path), "--arm", "left", "--json")
    assert (done.exit_code, json.loads(done.stdout)["flange"]) == (0, "leftlink6")


def test_robot_file_chooses(write: Writer) -> None:
    write(robot(*TWO))
    write(groups(along("arm", "column", "rightlink6")), "g.srdf")
    head = "format: 1\nname: mine\nurdf: robot.urdf\n"
    assert load_arm(write(head + "srdf: g.srdf\n", "a.yaml"))[1].tip == "rightlink6"
    file = write(head + "flange: leftlink6\nbase: foot\n", "b.yaml")
    assert load_robot(file).n_joints == 7
    file = write(head + "flange: leftlink6\nhold: {lift: 0.02}\n", "c.yaml")
    assert load_robot(file).tool_pose(np.zeros(6))[0][2] == pytest.approx(
        load_robot(file, hold={"lift": 0.0}).tool_pose(np.zeros(6))[0][2] + 0.02
    )


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("<sdf/>", ["<sdf>", "SRDF starts with <robot>"]),
        ("<robot><group/></robot>", ["<group> needs name"]),
        ('<robot><group name="g"><chain tip_link="x"/></group></robot>', ["<chain>", "base_link"]),
        (groups(listed("g"), listed("g")), ["group 'g' is defined twice"]),
        (groups('<group name="g"><group name="g"/></group>'), ["'g' holds itself"]),
    ],
)
def test_srdf_refused(write: Writer, text: str, said: list[str]) -> None:
    path = write(robot(*ARM))
    with pytest.raises(InvalidRobotError) as caught:
        load_robot(path, srdf=write(text, "bad.srdf"))
    assert all(word in caught.value.message for word in ["bad.srdf", *said])
