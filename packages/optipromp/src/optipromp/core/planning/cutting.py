r"""Where a scissor cuts, and what hangs from it after the cut.

The blades end on the target's stem, close, and hold the end of the stem. The fruit hangs below them
and swings. A tool whose changes of velocity are V in all, :math:`V = \int |dv|`, makes a pendulum
of length l that was at rest swing by :math:`V / \sqrt{g l}` at most. So the motion is as slow as
``CUTTING.sway`` asks, and the fruit counts with all the places that it may swing to.
"""

import math
from dataclasses import replace

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.geometry import distances, pack
from optipromp.core.geometry.shapes import Cone, Shape, Sphere
from optipromp.core.parameters import GRAVITY
from optipromp.core.planning.parameters import CUTTING
from optipromp.core.pushing.path import evenly
from optipromp.core.pushing.stems.bending import axis_of, hanging_balls
from optipromp.core.robots.grippers import Scissor
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import unmounted
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.goals import HeldUpright, PathConstraints
from optipromp.core.scenes.held import Attached
from optipromp.core.scenes.objects import mass_of
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory


def cuts(scene: Scene, tool: Tool | None) -> bool:
    """Whether the ``tool`` is a scissor, and the target hangs on a stem."""
    hangs = scene.target is not None and scene.target.stem is not None
    return hangs and isinstance(unmounted(tool), Scissor)


def from_side(scene: Scene) -> bool:
    """Whether the approach of a scene is nearer to the level than to the vertical."""
    return abs(float(scene.frame[2] @ scene.up)) < math.sqrt(0.5)


def aimed_at_stem(scene: Scene, tool: Tool | None) -> Scene:
    """The scene whose approach ends on the target's stem, if the ``tool`` is a scissor.

    The place is the lowest one that is ``cut`` from the fruit; of a stem that is nowhere twice as
    far from the fruit, half of the way to its farthest place. The place does not vary where the
    scene states no lateral distance; from below, the axis does not where it states no cone: turned
    about the stem, the blades would meet the fruit. An approach whose ``shift`` is stated stays as
    it is.
    """
    target, blades, approach = scene.target, unmounted(tool), scene.approach
    if target is None or target.stem is None or not isinstance(blades, Scissor):
        return scene
    if approach.shift.any():
        return scene
    points = evenly(target.stem.points, int(np.ceil(target.stem.length / CUTTING.along)) + 1)
    far, _ = distances(pack([(target.shape, target.position, target.rotation)]), points)
    above = points[int(np.argmax(far >= min(blades.cut, 0.5 * far.max())))]
    cone = approach.cone if from_side(scene) or approach.cone is not None else 0.0
    aside = 0.0 if approach.aside is None else approach.aside
    approach = replace(approach, shift=above - target.position, cone=cone, aside=aside)
    return scene.approached(approach)


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
