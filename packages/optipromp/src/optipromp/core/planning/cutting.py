r"""What hangs from a scissor after the cut.

The blades end on the target's stem, close, and hold the end of the stem. The fruit hangs below them
and swings. A tool whose changes of velocity are V in all, :math:`V = \int |dv|`, makes a pendulum
of length l that was at rest swing by :math:`V / \sqrt{g l}` at most. So the motion is as slow as
``CUTTING.sway`` asks, and the fruit counts with all the places that it may swing to.
"""

import math

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.geometry.shapes import Cone, Shape, Sphere
from optipromp.core.parameters import GRAVITY
from optipromp.core.planning.parameters import CUTTING
from optipromp.core.pushing.stems.bending import axis_of, hanging_balls
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import HeldUpright, PathConstraints
from optipromp.core.scenes.held import Attached
from optipromp.core.scenes.objects import mass_of
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory


def hung(scene: Scene, robot: Robot, q: FloatArray) -> tuple[Attached, PathConstraints]:
    """The target as it hangs from blades that closed at ``q`` (n,), and how they are kept level.

    Its shape holds all places of the fruit within an angle θ of plumb: the lean of its stem, the
    sway, and the lean of the tool. A ball of radius r whose centre is d from the blades stays in
    one of radius r + 2 d sin(θ/2).
    """
    target = scene.target
    assert target is not None
    down = -scene.up @ (robot.segment_frames(q)[1][-1] @ robot.tool_rotation)
    balls, pivot = hanging_balls(target), target.position + scene.approach.shift
    ends = target.position + axis_of(target) @ target.rotation.T
    middle = ends.mean(axis=0) - pivot
    lean = math.acos(min(1.0, -float(middle @ scene.up) / math.hypot(*middle)))
    wide = 2.0 * math.sin(0.5 * min(lean + CUTTING.sway + CUTTING.tilt, math.pi))
    away, radii = lengths(ends - pivot), np.array([balls.radius, balls.above])
    across, _, _ = target.shape.outlines(middle[None] / math.hypot(*middle) @ target.rotation)
    low, above = (radii + max(float(across[0]) - radii.max(), 0.0) + wide * away).tolist()
    shape: Shape = Sphere(max(low, above))
    place = away[0] * down
    if balls.apart > abs(low - above):
        shape, place = Cone(above, low, balls.apart), place - 0.5 * balls.apart * down
    turn = to_quaternion(frame_along(-down))
    upright = HeldUpright(math.degrees(CUTTING.tilt), -down, scene.up)
    return Attached(target.id, shape, place, turn, mass_of(target)), PathConstraints(upright)


def steady(scene: Scene, robot: Robot, motion: Trajectory) -> Trajectory:
    """A motion with the cut target, so slow that the target sways by ``CUTTING.sway`` at most."""
    target = scene.target
    assert target is not None
    at = motion.times[:-1, None] + np.diff(motion.times)[:, None] * np.linspace(
        0.0, 1.0, CUTTING.parts, endpoint=False
    )
    times = np.append(at, motion.times[-1])
    points, _ = robot.tool_pose(motion.sample(times)[0])
    speed = np.diff(points, axis=0) / np.diff(times)[:, None]
    changed = float(lengths(np.diff(speed, axis=0, prepend=0.0, append=0.0)).sum())
    most = CUTTING.sway * math.sqrt(GRAVITY * math.hypot(*scene.approach.shift))
    return motion.slowed(max(1.0, changed / most))
