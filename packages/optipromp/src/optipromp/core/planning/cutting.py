r"""What hangs from a scissor after the cut.

The blades end on the target's stem, close, and hold the end of the stem. The fruit hangs below them
and swings. All fruits of a truss do so as one body, which the blades keep from turning about the
plumb line. A tool whose changes of velocity are V in all, :math:`V = \int |dv|`, makes a pendulum
of length l that was at rest swing by :math:`V / \sqrt{g l}` at most, and for every l by
:math:`(\max |a| + \int |da|) / g`: from :math:`l \ddot θ + g θ = -a` follows
:math:`g θ(t) = -a(t) + \int_0^t \cos(\sqrt{g/l}\,(t - s))\,da(s)`. So the motion is as slow as
``CUTTING.sway`` asks by either, and a fruit counts with all the places that it may swing to.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.geometry.shapes import Cone, Shape, Sphere, outlines
from optipromp.core.parameters import GRAVITY
from optipromp.core.planning.parameters import CUTTING
from optipromp.core.pushing.stems.bending import axis_of, hanging_balls
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.goals import HeldUpright, PathConstraints
from optipromp.core.scenes.held import Attached
from optipromp.core.scenes.objects import SceneObject, mass_of
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory


def hung(scene: Scene, robot: Robot, q: FloatArray) -> tuple[tuple[Attached, ...], PathConstraints]:
    """What is taken, as it hangs from blades that closed at ``q`` (n,); how they are kept level.

    All of it swings as one body, about the place of the cut, to where its centre of mass is below.
    A fruit's shape holds all its places within an angle θ of there: the lean of the body, the sway,
    and the lean of the tool. A ball of radius r whose centre is d from the blades stays in one of
    radius r + 2 d sin(θ/2).
    """
    axes, middle = robot.segment_frames(q)[1][-1] @ robot.tool_rotation, _below(scene)
    middle = middle / math.hypot(*middle)
    lean = math.acos(min(1.0, -float(middle @ scene.up)))
    wide = 2.0 * math.sin(0.5 * min(lean + CUTTING.sway + CUTTING.tilt, math.pi))
    turned = Rotation.align_vectors(-scene.up, middle)[0].as_matrix().T @ axes
    out = []
    for item in scene.taken:
        assert item.stem is not None
        balls, up = hanging_balls(item), item.stem.root - item.position
        up, ends = up / math.hypot(*up), _ends(item, scene)
        across, _, _ = outlines(item.shape, up[None] @ item.rotation)
        radii = np.array([balls.radius, balls.above])
        radii += max(float(across[0]) - radii.max(), 0.0) + wide * lengths(ends)
        low, above = radii.tolist()
        shape: Shape = Sphere(max(low, above))
        place = ends[0] @ turned
        if balls.apart > abs(low - above):
            shape, place = Cone(above, low, balls.apart), ends.mean(axis=0) @ turned
        turn = to_quaternion(frame_along(up @ turned))
        out.append(Attached(item.id, shape, place, turn, mass_of(item)))
    upright = HeldUpright(math.degrees(CUTTING.tilt), scene.up @ axes, scene.up)
    return tuple(out), PathConstraints(upright)


def _ends(item: SceneObject, scene: Scene) -> FloatArray:
    """Centres (2, 3) of a fruit's lower and upper ball, from the place of the cut [m]."""
    assert scene.aim is not None
    return np.asarray(item.position + axis_of(item) @ item.rotation.T - scene.aim)


def _below(scene: Scene) -> FloatArray:
    """The centre of mass (3,) of what is taken, from the place of the cut [m]."""
    masses = np.array([mass_of(item) for item in scene.taken])
    middles = [_ends(item, scene).mean(axis=0) for item in scene.taken]
    return np.asarray(masses / masses.sum() @ middles)


def steady(scene: Scene, robot: Robot, motion: Trajectory) -> Trajectory:
    """A motion with what was cut, so slow that it sways by ``CUTTING.sway`` at most.

    A body whose centre of mass is l below swings no wider than a pendulum of length l.
    """
    at = motion.times[:-1, None] + np.diff(motion.times)[:, None] * np.linspace(
        0.0, 1.0, CUTTING.parts, endpoint=False
    )
    times = np.append(at, motion.times[-1])
    points, _ = robot.tool_pose(motion.sample(times)[0])
    steps = np.diff(times)[:, None]
    speed = np.diff(points, axis=0) / steps
    changed = float(lengths(np.diff(speed, axis=0, prepend=0.0, append=0.0)).sum())
    gain = np.diff(speed, axis=0) / (0.5 * (steps[1:] + steps[:-1]))
    jerked = lengths(gain).max() + lengths(np.diff(gain, axis=0, prepend=0.0, append=0.0)).sum()
    most = CUTTING.sway * math.sqrt(GRAVITY * math.hypot(*_below(scene)))
    gentle = math.sqrt(float(jerked) / (GRAVITY * CUTTING.sway))
    return motion.slowed(max(1.0, min(changed / most, gentle)))
