"""A robot of your own: from a URDF to a plan.

Any serial URDF works by its path; nothing is registered. What a URDF does not say (accelerations,
a home posture, which links may touch) goes into a robot file beside it. Here both are written to
a temporary folder, as is a scene that uses them: a goal for the tool, and a post in the way. Then
clusters of fruits are placed in the arm's reach.

    python examples/04_your_own_robot.py
"""

import tempfile
import warnings
from pathlib import Path

import numpy as np

from optipromp import load_robot, load_scene, plan
from optipromp_sim.generate import generate

# Nobody has shown this arm how to move: the library says so once, and takes smooth motions.
warnings.filterwarnings("ignore", message="no built-in demonstrations")

AXES = {"yaw": "0 0 1", "pitch": "0 1 0", "roll": "0 0 1"}
CHAIN = [  # joint, what it does, where it stands on the link before [m], length of its link [m]
    ("base_yaw", "yaw", 0.15, 0.10),
    ("shoulder", "pitch", 0.10, 0.35),
    ("elbow", "pitch", 0.35, 0.30),
    ("wrist_roll", "roll", 0.30, 0.08),
    ("wrist_pitch", "pitch", 0.08, 0.08),
    ("flange_roll", "roll", 0.08, 0.05),
]


def urdf() -> str:
    """A six-joint arm of cylinders, upright at zero."""

    def link(name: str, length: float) -> str:
        return (
            f'<link name="{name}"><collision><origin xyz="0 0 {length / 2}"/>'
            f'<geometry><cylinder radius="0.035" length="{length}"/></geometry></collision></link>'
        )

    parts, parent = [link("base", 0.15)], "base"
    for name, kind, height, length in CHAIN:
        child = f"{name}_link"
        parts.append(link(child, length))
        parts.append(
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="0 0 {height}"/><axis xyz="{AXES[kind]}"/>'
            '<limit lower="-2.6" upper="2.6" velocity="2" effort="50"/></joint>'
        )
        parent = child
    parts.append('<link name="tool0"/>')
    parts.append(
        f'<joint name="mount" type="fixed"><parent link="{parent}"/><child link="tool0"/>'
        '<origin xyz="0 0 0.05"/></joint>'
    )
    return f'<robot name="six">{"".join(parts)}</robot>'


ROBOT = """
format: 1
name: six
urdf: six.urdf
flange: tool0
acceleration: [8, 8, 8, 12, 12, 12]
home: [0.0, 0.5, 1.2, 0.0, -0.8, 0.0]
allow_self:
  - [elbow_link, wrist_pitch_link]
  - [wrist_roll_link, flange_roll_link]
"""

SCENE = """
format: 1
name: round-a-post
robot: six.yaml
tool: {kind: cup, radius: 0.03}
goal: {position: [0.25, 0.45, 0.45], axis: [0.5, 0.866, 0.0]}
objects:
  - id: post
    role: static
    shape: {cylinder: {radius: 0.03, length: 1.0}}
    position: [0.50, 0.24, 0.5]
"""

with tempfile.TemporaryDirectory() as name:
    folder = Path(name)
    (folder / "six.urdf").write_text(urdf())
    (folder / "six.yaml").write_text(ROBOT)
    (folder / "scene.yaml").write_text(SCENE)

    robot = load_robot(folder / "six.yaml")
    print(f"{robot.name}: {', '.join(robot.joint_names)}; {len(robot.spheres.radius)} spheres")
    point, axis = robot.tool_pose(np.stack([robot.home, np.zeros(6)]))
    print(
        f"flange at home {point[0].round(3)}, upright {point[1].round(3)}, axis {axis[1].round(3)}"
    )

    result = plan(load_scene(folder / "scene.yaml"))

    picked = 0
    for seed in (2, 3, 4):  # clusters of fruits, placed in the arm's reach
        scene = generate("cluster", seed, folder / "six.yaml")
        picked += plan(scene).success

print(f"{result.scene.name}: {result.status} {result.message}")
print(f"clearance from the post: {1e3 * (result.metrics.clearance_static or 0.0):.1f} mm")
print(f"{picked} of 3 clusters reached")
if not (result.success and picked == 3):
    raise SystemExit(1)
