"""What stock robot files (package example-robot-data, extra ``models``) should be read as.

``EXPECTED`` was written by hand: the joints of each arm, as first and last, and the links that may
be called its flange. The rule was made with these files at hand, so this is a record of what loads,
not a measure of how well the rule does on files that it has not met.
"""

from collections.abc import Callable
from dataclasses import dataclass

from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.description import Arm


@dataclass(frozen=True)
class Expected:
    """What a file should give; ``arms`` > 1 asks for a question that names as many tips."""

    path: str
    first: str = ""
    last: str = ""
    count: int = 0
    flanges: tuple[str, ...] = ()  # one of these; where asked, how the tips begin
    tool: str = ""  # a link that must be carried
    arms: int = 1


def _arm(path: str, first: str, last: str, count: int, flanges: str, tool: str = "") -> Expected:
    return Expected(path, first, last, count, tuple(flanges.split()), tool)


def _ask(path: str, arms: int, tips: str) -> Expected:
    return Expected(path, flanges=tuple(tips.split()), arms=arms)


UR = "shoulder_pan_joint", "wrist_3_joint", 6, "tool0 ee_link"
EXPECTED = (
    _arm("panda_description/urdf/panda.urdf", "panda_joint1", "panda_joint7", 7,
         "panda_link8 panda_hand_tcp", "panda_leftfinger"),
    _arm("ur_description/urdf/ur3_robot.urdf", *UR),
    _arm("ur_description/urdf/ur3_gripper.urdf", *UR),
    _arm("ur_description/urdf/ur5_robot.urdf", *UR),
    _arm("ur_description/urdf/ur5_gripper.urdf", *UR),
    _arm("ur_description/urdf/ur10_robot.urdf", *UR),
    _arm("xarm_description/urdf/xarm7.urdf", "joint1", "joint7", 7, "link_eef link7"),
    _arm("z1_description/urdf/z1.urdf", "joint1", "joint6", 6, "link06", "gripperMover"),
    _arm("b1_description/urdf/b1-z1.urdf", "joint1", "joint6", 6, "link06", "gripperMover"),
    _arm("kinova_description/robots/kinova.urdf", "j2s6s200_joint_1", "j2s6s200_joint_6", 6,
         "j2s6s200_end_effector j2s6s200_link_6", "j2s6s200_link_finger_1"),
    _arm("anymal_b_simple_description/robots/anymal-kinova.urdf", "j2s6s200_joint_1",
         "j2s6s200_joint_6", 6, "j2s6s200_end_effector", "j2s6s200_link_finger_1"),
    _arm("so_arm_description/urdf/so100.urdf", "shoulder_pan", "wrist_roll", 5, "gripper", "jaw"),
    _arm("so_arm_description/urdf/so101.urdf", "shoulder_pan", "wrist_roll", 5,
         "gripper_frame_link gripper_link", "moving_jaw_so101_v1_link"),
    _arm("tiago_description/robots/tiago.urdf", "arm_1_joint", "arm_7_joint", 7,
         "wrist_ft_tool_link arm_tool_link", "hand_index_flex_1_link"),
    _arm("tiago_description/robots/tiago_no_hand.urdf", "arm_1_joint", "arm_7_joint", 7,
         "wrist_ft_tool_link arm_tool_link"),
    _arm("talos_data/robots/talos_left_arm.urdf", "arm_left_2_joint", "arm_left_7_joint", 6,
         "wrist_left_ft_tool_link", "gripper_left_fingertip_1_link"),
    _arm("hextilt_description/urdf/hextilt_flying_arm_5.urdf", "flying_arm_5__j_base_link_link_1",
         "flying_arm_5__j_link_4_link_5", 5, "flying_arm_5__gripper flying_arm_5__link_5"),
    _arm("borinot_description/urdf/borinot_flying_arm_2.urdf", "flying_arm_2__j_bl_link1",
         "flying_arm_2__j_link1_link2", 2, "flying_arm_2__ee"),
    _ask("tiago_description/robots/tiago_dual.urdf", 2,
         "wrist_left_ft_tool_link wrist_right_ft_tool_link"),
    _ask("tiago_pro_description/robots/tiago_pro.urdf", 2,
         "arm_left_tool_link arm_right_tool_link"),
    _ask("pr2_description/urdf/pr2.urdf", 2, "l_wrist_roll_link r_wrist_roll_link"),
    _ask("baxter_description/urdf/baxter.urdf", 2, "left_wrist right_wrist"),
    _ask("talos_data/robots/talos_reduced.urdf", 2,
         "wrist_left_ft_tool_link wrist_right_ft_tool_link"),
    _ask("talos_data/robots/talos_full_v2.urdf", 2,
         "wrist_left_ft_tool_link wrist_right_ft_tool_link"),
    _ask("g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf", 2,
         "left_wrist_yaw_link right_wrist_yaw_link"),
    _ask("icub_description/robots/icub.urdf", 2, "l_hand r_hand"),
    _ask("romeo_description/urdf/romeo_small.urdf", 2, "l_wrist r_wrist"),
    _ask("alex_description/urdf/alex_sake_hands.urdf", 2, "LeftGripperYawLink RightGripperYawLink"),
    _ask("anymal_b_simple_description/robots/anymal.urdf", 4, "LF_FOOT RF_FOOT LH_FOOT RH_FOOT"),
    _ask("centauro_description/urdf/centauro.urdf", 2, ""),  # arm1_8 by the rule, ball1_tip by SRDF
)  # fmt: skip


def verdict(expected: Expected, choose: Callable[[], Arm]) -> tuple[str, Arm | str]:
    """``right``, ``asks`` or ``wrong``, and the arm or the error's message."""
    try:
        arm = choose()
    except InvalidRobotError as error:
        told = error.message
        asked = f"{expected.arms} arms are alike" in told
        named = all(f"tip '{tip}" in told for tip in expected.flanges)
        return ("asks" if expected.arms > 1 and asked and named else "wrong"), told
    right = (
        expected.arms == 1
        and (arm.joints[0], arm.joints[-1]) == (expected.first, expected.last)
        and len(arm.joints) == expected.count
        and arm.tip in expected.flanges
        and (not expected.tool or expected.tool in arm.tool)
    )
    return ("right" if right else "wrong"), arm
