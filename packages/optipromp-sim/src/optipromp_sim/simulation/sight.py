"""What a camera without images sees: where it stands, and which share of a fruit is hidden."""

import math
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, lengths
from optipromp.core.geometry import distances, pack
from optipromp.core.geometry.obstacles import measures, packed_shapes
from optipromp.core.geometry.shapes import Cylinder, Shape
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.core.scenes.scene import JointGoal, Scene
from optipromp_sim.simulation.detector_parameters import DetectorParameters

RAYS = 24  # from the camera to a fruit: a choice; the hidden share has steps of 4 %
MOST_STEPS = 60  # of a ray: a choice
NEAREST = 1e-4  # [m] from a surface, at which a ray has met it: a choice
LEAST_STEP = 1e-3  # [m] of a ray: a choice, half of a leaf's thickness
STEEP = math.sqrt(0.5)  # sine of the least inclination of a steep approach: a choice
LEAF = 0.002  # [m] thickness: a choice


def hand_pose(robot: Robot, parameters: DetectorParameters) -> Pose:
    """The hand camera in the tool axes at the tool point.

    A camera in the palm is on the axis of the tool, ``palm_below`` behind the rim. Another is
    ``hand_aside`` beyond the outer radius of the mouth along the tool's x, and ``hand_below``
    behind the rim. The point of the tool axis ``aim`` before the rim is in the
    middle of the view.
    """
    tool = robot.tool
    outer, depth = (robot.gripper_radius, 0.0) if tool is None else (tool.mouth[1], tool.depth)
    if parameters.mount == "palm":
        return Pose(np.array([0.0, 0.0, depth - parameters.palm_below]))
    place = np.array([outer + parameters.hand_aside, 0.0, depth - parameters.hand_below])
    forward = np.array([0.0, 0.0, depth + parameters.aim]) - place
    forward /= np.linalg.norm(forward)
    y = np.array([0.0, 1.0, 0.0])
    return Pose(place, np.column_stack([np.cross(y, forward), y, forward]))


def view_of(robot: Robot, parameters: DetectorParameters) -> float:
    """Full angle of the camera's cone of view [rad]; the rim bounds that of one in the palm."""
    tool = robot.tool
    if parameters.mount != "palm" or tool is None or tool.mouth[0] <= 0.0:
        return parameters.view
    return min(parameters.view, 2.0 * math.atan2(tool.mouth[0], parameters.palm_below))


def standing_pose(
    scene: Scene, parameters: DetectorParameters, seen: FloatArray | None = None
) -> Pose:
    """The standing camera in the base frame: the scene's, if it has one.

    Else it looks at the target, or at the place ``seen`` (3,) in its stead. Where the approach is
    steep, the camera is ``stand_away`` from the target towards the robot's base, across the
    approach, and ``stand_below`` behind the target along the approach. Where the approach is level
    (into a shelf), the camera is ``stand_away`` behind the target along the approach and
    ``stand_below`` higher. Without a target it looks at the goal of the tool, or at the middle of
    the objects.
    """
    if scene.camera is not None:
        return scene.camera
    if seen is not None:
        pass
    elif scene.target is not None:
        seen = scene.target.position
    elif of_tool := [goal for goal in scene.goals if not isinstance(goal, JointGoal)]:
        seen = of_tool[0].position
    else:
        moving = [item.position for item in scene.objects if item.role != "static"]
        seen = np.mean(moving, axis=0) if moving else np.zeros(3)
    x, _, z = scene.frame
    if abs(z @ scene.up) < STEEP:
        level = scene.up - (scene.up @ z) * z
        level /= np.linalg.norm(level)
        place = seen - parameters.stand_away * z + parameters.stand_below * level
    else:
        across = -seen + (seen @ z) * z
        far = float(np.linalg.norm(across))
        across = across / far if far > 1e-6 else x  # [m] rounding: the base is behind the target
        place = seen + parameters.stand_away * across - parameters.stand_below * z
    return Pose(place, frame_along((seen - place) / np.linalg.norm(seen - place)))


class Leaf(NamedTuple):
    """A leaf before a fruit: row of the fruit, direction (3,) from the fruit, distance and radius
    [m]. The leaf moves with the fruit and does not turn."""

    row: int
    direction: FloatArray
    away: float
    radius: float


class Sight:
    """Rays from a camera to the fruits of a scene, past all that hides them.

    ``shapes``: of the F objects that are looked for. ``scene``: whose static objects hide.
    ``robot``: whose tool hides: a round one as a cylinder from the floor of its mouth to its rim,
    another by its solids. ``inside``: whether the camera is in the tool, which then hides nothing.
    """

    def __init__(
        self, shapes: tuple[Shape, ...], scene: Scene, robot: Robot, inside: bool = False
    ) -> None:
        self.shapes, self.robot = shapes, robot
        static = [(item.shape, item.position, item.rotation) for item in scene.static]
        self._static = pack(static) if static else None
        self._parts = () if inside else _parts(robot)
        self._radii = np.array([shape.measure.bound for shape in shapes])

    def hidden(
        self, eye: FloatArray, frame: Pose, positions: FloatArray, rotations: FloatArray,
        leaves: tuple[Leaf, ...] = (),
    ) -> FloatArray:  # fmt: skip
        """The share (F,) of each object's disc, as seen from ``eye`` (3,), that is hidden.

        ``eye``: the camera [m]. ``frame``: of the tool axes at the tool point. ``positions``: (F,
        3) of the objects [m]. ``rotations``: (F, 3, 3) of the objects. ``leaves``: that hide.
        """
        count = len(self.shapes)
        if not count:
            return np.zeros(0)
        ways, reach = self._rays(eye, positions)
        shapes = [*self.shapes, *(part[0] for part in self._parts)]
        shapes += [Cylinder(leaf.radius, LEAF) for leaf in leaves]
        places = [frame @ part[1] for part in self._parts]
        places += [positions[leaf.row] + leaf.away * leaf.direction for leaf in leaves]
        turns = [frame.rotation @ part[2] for part in self._parts]
        turns += [frame_along(leaf.direction) for leaf in leaves]
        moving = packed_shapes(
            shapes,
            np.concatenate([positions, np.reshape(places, (-1, 3))]),
            np.concatenate([rotations, np.reshape(turns, (-1, 3, 3))]),
            measures(shapes),
        )
        own = np.repeat(np.arange(count), RAYS)
        along, met = np.zeros(count * RAYS), np.zeros(count * RAYS, dtype=bool)
        going = np.flatnonzero(reach > 0.0)
        for _ in range(MOST_STEPS):
            if not len(going):
                break
            points = eye + along[going, None] * ways[going]
            apart, _ = distances(moving, points)
            apart[np.arange(len(going)), own[going]] = np.inf
            clear = apart.min(axis=1)
            if self._static is not None:
                clear = np.minimum(clear, distances(self._static, points)[0].min(axis=1))
            met[going] = clear < NEAREST
            along[going] += np.maximum(clear, LEAST_STEP)
            going = going[(clear >= NEAREST) & (along[going] < reach[going])]
        return np.asarray(met.reshape(count, RAYS).mean(axis=1))

    def _rays(self, eye: FloatArray, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit directions (F·RAYS, 3), and the lengths [m] up to the fronts of the objects."""
        way = positions - eye
        away = np.maximum(lengths(way), 1e-9)
        across = frame_along(way / away[:, None])[:, :, :2]
        k = np.arange(RAYS) + 0.5
        turn = np.pi * (3.0 - np.sqrt(5.0)) * k  # sunflower: even over the disc
        disc = np.sqrt(k / RAYS)[:, None] * np.column_stack([np.cos(turn), np.sin(turn)])
        aside = np.einsum("fik,rk->fri", across, disc)
        ends = way[:, None] + self._radii[:, None, None] * aside
        far = np.linalg.norm(ends, axis=2)
        reach = far * (1.0 - self._radii / away)[:, None]
        return (ends / far[:, :, None]).reshape(-1, 3), reach.ravel()


def _parts(robot: Robot) -> tuple[tuple[Shape, FloatArray, FloatArray], ...]:
    """Shapes of the tool with position (3,) and rotation (3, 3) in the tool axes."""
    tool = robot.tool
    if tool is None:
        return ()
    if not tool.fingers:
        middle = 0.5 * (tool.front + tool.tip) - tool.reach
        shape = Cylinder(tool.mouth[1], tool.tip - tool.front)
        return ((shape, np.array([0.0, 0.0, middle]), np.eye(3)),)
    axes = tool.rotation
    return tuple(
        (
            solid.shape,
            (solid.position - tool.point) @ axes,
            axes.T @ from_quaternion(solid.orientation),
        )
        for solid in tool.solids()
    )
