"""From detections in a camera's frame to a trajectory that a controller accepts: an MCAP bag.

A detector gives fruits with a covariance each, in the frame of a camera under the cluster. The
plan leaves as a JointTrajectory at 1 kHz, with velocities and accelerations, and is read back and
judged.

    python examples/06_detections_to_controller.py    (needs the package optipromp-ros)
"""

import tempfile
from pathlib import Path

import numpy as np

import optipromp_ros as ros
from optipromp import Scene, SceneObject, judge, plan
from optipromp.core.geometry import Sphere
from optipromp.core.scenes import Pose, Stem, ToolSpec

camera = Pose([0.45, 0.0, 0.45], [0.966, 0.0, 0.0, 0.259])  # in the base's frame; looks up
seen = {  # role, centre in the camera's frame [m]; the stems lean by some degrees
    "ripe": ("target", [0.0, 0.0, 0.44], [0.0, 0.0, 1.0]),
    "n1": ("pushable", [0.0, 0.004, 0.304], [0.0, 0.16, 1.0]),
    "n2": ("pushable", [0.0, 0.002, 0.379], [0.0, -0.16, 1.0]),
}
fruits = [
    SceneObject(name, role, Sphere(0.015), np.array(at), stem=Stem.along(at, up, 0.2),
                covariance=np.diag([2e-3, 2e-3, 4e-3]) ** 2).transformed(camera)
    for name, (role, at, up) in seen.items()
]  # fmt: skip
scene = Scene("seen", "panda", tuple(fruits), tool=ToolSpec("cup", {"radius": 0.05}), camera=camera,
              start=np.array([1.42, 1.10, -1.26, -2.42, -1.69, 1.02, 0.8]))  # fmt: skip
made = plan(scene)
print(made.status, made.message)
with tempfile.TemporaryDirectory() as folder:
    bag = Path(folder) / "pick.mcap"
    points = ros.joint_trajectory(made.trajectory, rate=1000.0)
    ros.write_bag(bag, [ros.Recorded("/arm_controller/joint_trajectory", points)])
    verdict = judge(scene, ros.read_trajectory(bag, made.trajectory.joint_names))
print(f"{len(points.points)} points over {made.trajectory.duration:.2f} s: {verdict.status}")
if not verdict.status == made.status == "success":
    raise SystemExit(1)
