"""An arm of your own, from a URDF to plans; scripts/notebooks.py makes the notebook."""

# %% [markdown]
# # My robot
#
# An arm of your own: from a URDF to a plan. Put the path of your file in place of the one that is
# written here.
#
# The same as a script: `python examples/notebooks/my_robot.py`.

# %%
import tempfile
import warnings
from pathlib import Path

import numpy as np

from optipromp import load_robot, load_scene, plan
from optipromp_sim.generate import generate

# Nobody has shown this arm how to move: the library says so once, and takes smooth motions.
warnings.filterwarnings("ignore", message="no built-in demonstrations")

# %% [markdown]
# A six-joint arm of cylinders, upright at zero: joint, axis, height on the link before [m],
# length of its link [m].

# %%
CHAIN = [
    ("base_yaw", "0 0 1", 0.15, 0.10),
    ("shoulder", "0 1 0", 0.10, 0.35),
    ("elbow", "0 1 0", 0.35, 0.30),
    ("wrist_roll", "0 0 1", 0.30, 0.08),
    ("wrist_pitch", "0 1 0", 0.08, 0.08),
    ("flange_roll", "0 0 1", 0.08, 0.05),
]
parts, parent, below = [], "base", 0.15
for name, axis, height, length in [*CHAIN, ("tool0", "", 0.05, 0.0)]:
    parts.append(
        f'<link name="{parent}"><collision><origin xyz="0 0 {below / 2}"/>'
        f'<geometry><cylinder radius="0.035" length="{below}"/></geometry></collision></link>'
    )
    child, kind = (f"{name}_link", "revolute") if axis else (name, "fixed")
    limit = f'<axis xyz="{axis}"/><limit lower="-2.6" upper="2.6" velocity="2" effort="50"/>'
    parts.append(
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {height}"/>{limit if axis else ""}</joint>'
    )
    parent, below = child, length
folder = Path(tempfile.mkdtemp())
urdf = f'<robot name="six">{"".join(parts)}<link name="tool0"/></robot>'
(folder / "six.urdf").write_text(urdf)
print(len(CHAIN), "joints")

# %% [markdown]
# What a URDF does not say goes into a robot file beside it: accelerations, a home posture, links
# that may touch.

# %%
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
(folder / "six.yaml").write_text(ROBOT)
robot = load_robot(folder / "six.yaml")
print(robot.name, *robot.joint_names)
point, axis = robot.tool_pose(robot.home[None])
print("the flange at home is at", point[0].round(3), "and points along", axis[0].round(3))

# %% [markdown]
# Look at the body spheres before anything else: they are what must not collide.

# %%
robot.plot()

# %% [markdown]
# A goal of the tool, and a post in the way.

# %%
SCENE = """
format: 1
name: round-a-post
robot: six.yaml
tool: {kind: cup, radius: 0.03}
goal: {position: [0.25, 0.45, 0.45], axis: [0.5, 0.866, 0.0]}
objects:
  - {id: post, role: static, shape: {cylinder: {radius: 0.03, length: 1.0}},
     position: [0.50, 0.24, 0.5]}
"""
(folder / "scene.yaml").write_text(SCENE)
result = plan(load_scene(folder / "scene.yaml"))
print(result.status, "-", result.message)
print(f"{1e3 * result.metrics.clearance_static:.0f} mm from the post")

# %% [markdown]
# Random clusters, placed in the reach of the arm.

# %%
made = [plan(generate("cluster", seed, folder / "six.yaml")) for seed in (2, 3, 4)]
for cluster in made:
    print(cluster.status, "-", len(cluster.scene.objects), "objects")

# %% [markdown]
# Rows for a controller, at its rate: positions, velocities and accelerations of each joint.

# %%
rows = made[0].trajectory.resample(500)
print(rows.positions.shape, "largest velocity", np.abs(rows.velocities).max().round(2), "rad/s")

# %%
assert result.success
assert all(cluster.success for cluster in made)
