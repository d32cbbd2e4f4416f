"""Learn a movement primitive, condition it, sample from it, and plan with it.

The demonstrations here are made up: reaches of the Panda from its ready pose to a few points,
with some wobble, in place of what you would record by guiding an arm. From a recording it is
`load_demonstrations("recorded.npz")` (or a CSV, or a folder of CSVs) in place of `recorded`.

`fit` turns them into a Gaussian over basis weights. Conditioning bends it through points: in
joints, or for the tool in space. What the demonstrations varied in stays free; what they agreed
on is kept.

    python examples/02_learn_from_demonstrations.py
"""

import numpy as np

from optipromp import (
    Basis,
    Cup,
    JointPoint,
    TaskPoint,
    condition,
    fit,
    load_robot,
    load_scene,
    with_tool,
)
from optipromp import plan as make_plan
from optipromp.core.robots import ik

rng = np.random.default_rng(3)
scene = load_scene("scenario-3")
robot = with_tool(load_robot("panda"), Cup(radius=0.05))
start, target = scene.start, scene.target
assert start is not None
assert target is not None

# Demonstrations: minimum-jerk motions to eight points about the target, (8, 60, 7).
phase = np.linspace(0.0, 1.0, 60)
ease = phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)
best = ik.solve(robot, target.position, np.array([0.0, 0.0, 1.0]), starts=64).joints[0]
recorded = []
for _ in range(8):
    point = target.position + rng.uniform(-0.06, 0.06, 3)
    end = ik.solve(robot, point, np.array([0.0, 0.0, 1.0]), starts=0, near=best[None]).joints[0]
    wobble = 0.02 * np.sin(np.pi * phase)[:, None] * rng.standard_normal(7)
    recorded.append(start + ease[:, None] * (end - start) + wobble)

primitive = fit(np.stack(recorded), Basis(count=8), joint_names=robot.joint_names)
print(f"learnt {len(primitive.joint_names)} joints from {len(recorded)} demonstrations")

reach = condition(
    primitive,
    [
        JointPoint(0.0, start),
        TaskPoint(1.0, target.position, axis=np.array([0.0, 0.0, 1.0])),
    ],
    task_map=robot.tool_map,
)
mean = reach.mean_trajectory(50)
tool, axis = robot.tool_pose(mean[-1])
print(
    f"conditioned mean ends {1e3 * np.linalg.norm(tool - target.position):.3f} mm from the target"
)

samples = reach.sample(rng, 20, np.linspace(0.0, 1.0, 50))
print(f"spread of 20 samples half-way: {samples[:, 25].std(axis=0).max():.4f} rad")

result = make_plan(scene, demonstrations=primitive)
print(f"plan with it: {result.status} {result.message}")
if not result.success:
    raise SystemExit(1)
