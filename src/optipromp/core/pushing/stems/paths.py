"""Candidate paths of a cup among fruits on stems.

A candidate path passes each neighbour in a direction of the lateral plane with a lateral clearance.
The first candidate is the method's rule (:mod:`optipromp.core.pushing.rules`). The next candidates
pass all neighbours in the same direction.
"""

import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.compiled import kernel
from optipromp.core.geometry import signed_distance
from optipromp.core.geometry.obstacles import Obstacles
from optipromp.core.pushing.candidates import Candidates, Round, Schedule
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import ToolPath, through
from optipromp.core.pushing.rules import (
    RULE,
    detection_variance,
    drift_choices,
    path_past,
    rim_windows,
    stem_side,
)
from optipromp.core.pushing.stems.cup import Mouth
from optipromp.core.scenes.scene import Scene, SceneObject

HANGING = PUSH.hanging


class PathsPast(Candidates):
    """Paths that pass each of N neighbours on a side: x has N angles, then N clearances.

    ``scene``: with a target. ``neighbours``: pushables in the way, first met first. ``cup``: led
    along the paths. ``obstacles``: static objects, and objects to avoid. ``camera``: (3,) where a
    path begins [m]. ``gripper_radius``: R_gripper [m]. ``states``: number of states on which the
    best candidates are tried.
    """

    indifferent = HANGING.stem_side

    def __init__(
        self, scene: Scene, neighbours: Sequence[SceneObject], cup: Mouth,
        obstacles: tuple[Obstacles, Obstacles], camera: FloatArray, gripper_radius: float,
        states: int,
    ) -> None:  # fmt: skip
        target = scene.target
        assert target is not None
        self.scene, self.target, self.neighbours, self.cup = scene, target, tuple(neighbours), cup
        self.aim = target.position + scene.approach.shift
        self.camera, self.gripper_radius = camera, gripper_radius
        self.entry = float(camera @ scene.frame[2])
        self.static, self.avoid = obstacles
        self._frame = np.array(scene.frame)
        self._centers = np.array([fruit.position for fruit in self.neighbours]).reshape(-1, 3)
        self._heights = self._centers @ self._frame[2]
        self._radii = np.array([fruit.radius for fruit in self.neighbours])
        self._capture = float(target.position @ self._frame[2]) - cup.rim - target.radius
        doubts = np.sqrt([detection_variance(fruit) for fruit in (target, *self.neighbours)])
        self._early = HANGING.capture + HANGING.lower * float(doubts[0])
        self._under = PUSH.rule.under + HANGING.lower * doubts[1:]
        self.schedule = Schedule(
            rounds=(Round(9, 1), *[Round(12, 1)] * 3), runs=1, kept=6, screened=4,
            states=states, fresh=0.3, lenient=1.6,
        )  # fmt: skip

    def path(self, x: FloatArray) -> ToolPath:
        """Past neighbour n at the angle ``x[n]`` from x_g, with ``x[N + n]`` radii of clearance."""
        directions, clearances = self._split(x)
        windows = rim_windows(
            self._heights, self._radii, directions, self.cup.rim, self._capture, self._under
        )
        corners = path_past(
            self._centers, directions, windows, self.gripper_radius + clearances * self._radii,
            self.aim, self._frame, self.camera,
            max(self.cup.rim + self.target.radius + self._early, 0.0),
        )  # fmt: skip
        return through(corners, HANGING.speed)

    def aside(self, x: FloatArray, path: ToolPath) -> float:
        """Half the relative detour, plus the lack of clearance of the cup from obstacles."""
        straight = math.dist(path.points[-1], path.points[0])
        return 0.5 * (path.length - straight) / straight + self._too_near(path.points)

    def first(self) -> FloatArray:
        """The rule's directions, then each of eight directions for all neighbours."""
        around = np.arange(0.0, 2.0 * np.pi - 1e-9, np.deg2rad(HANGING.apart))
        angles = np.repeat(around[:, None], len(self._rule) // 2, 1)
        alike = np.hstack([angles, np.full_like(angles, HANGING.clearance)])
        return np.vstack([self._rule, alike])

    def rather(self, x: FloatArray, path: ToolPath) -> list[FloatArray]:
        """The candidate, mirrored or turned to the rule's side where it passes on a stem's side."""
        if not len(self.neighbours):
            return []
        cosines = passed_towards(
            path.points, self._centers, self._leans, self._frame[2], self.cup.rim
        )
        wrong = cosines > np.sin(np.deg2rad(RULE.least_inclination))
        if not wrong.any():
            return []
        x_g, y_g, _ = self.scene.frame
        lean = np.arctan2(self._leans @ y_g, self._leans @ x_g)
        angles, clearances = x[: len(x) // 2], x[len(x) // 2 :]
        rule = self._rule[: len(angles)]
        turned = (np.where(wrong, other, angles) for other in (2.0 * lean + np.pi - angles, rule))
        return [np.concatenate([one, clearances]) for one in turned]

    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """About the rule's directions."""
        spread = np.repeat([HANGING.turned, HANGING.clearance_spread], len(self.neighbours))
        return self._rule, spread

    @cached_property
    def _leans(self) -> FloatArray:
        """Unit vectors (N, 3) in the lateral plane towards the stems; 0 for a stem without lean."""
        away = [
            stem_side(self.scene, fruit, "lateral-plane", self.gripper_radius)
            for fruit in self.neighbours
        ]
        return -np.array([np.zeros(3) if one is None else one for one in away]).reshape(-1, 3)

    @cached_property
    def _rule(self) -> FloatArray:
        x_g, y_g, _ = self.scene.frame
        drift = drift_choices(
            self.scene,
            self.neighbours,
            "shortest",
            depth=self.cup.rim,
            gripper_radius=self.gripper_radius,
        )[0]
        angles = np.arctan2(drift.directions @ y_g, drift.directions @ x_g)
        return np.concatenate([angles, np.full(len(angles), HANGING.clearance)])

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Directions (N, 3) and lateral clearances (N,) [radii] of a candidate."""
        x_g, y_g, _ = self.scene.frame
        angles, clearances = x[: len(x) // 2], x[len(x) // 2 :]
        directions = np.cos(angles)[:, None] * x_g + np.sin(angles)[:, None] * y_g
        return directions, np.clip(clearances, HANGING.clearance_least, HANGING.clearance_most)

    def _too_near(self, points: FloatArray) -> float:
        """Lack of clearance of the cup, led upright through ``points``: 1 for 4 mm, 5 at most."""
        heights = np.array([self.cup.base, 0.5 * (self.cup.base + self.cup.rim), self.cup.rim])
        where = points[:: 2 * HANGING.every]
        worst = 0.0
        for obstacles, slack in ((self.static, HANGING.slack), (self.avoid, 0.0)):
            if len(obstacles.kind):
                least, end = rooms(where, heights, self._frame[2], obstacles, self.cup.outer, slack)
                worst = max(worst, end - least)  # no path has more room than the goal
        return min(worst, 0.02) / 0.004


def passed_towards(
    points: FloatArray, centers: FloatArray, leans: FloatArray, up: FloatArray, rim: float
) -> FloatArray:
    """Cosines (N,) between ``leans`` (N, 3) and the directions of passing ``centers`` (N, 3).

    The tool point goes through ``points`` (P, 3), the rim ``rim`` [m] before it along ``up`` (3,).
    The cosine is the larger of those of rim and tool point at the height of a centre.
    """
    out = np.full(len(centers), -1.0)
    heights, flat = points @ up, points - np.outer(points @ up, up)
    for ahead in (rim, 0.0):
        at = np.argmax(heights + ahead >= (centers @ up)[:, None], axis=1)
        off = flat[at] - (centers - np.outer(centers @ up, up))
        along = np.einsum("ni,ni->n", off, leans)
        out = np.maximum(out, along / np.maximum(lengths(off), 1e-9))
    return out


@kernel
def rooms(
    points: FloatArray, heights: FloatArray, up: FloatArray, obstacles: Obstacles, radius: float,
    most: float,
) -> tuple[float, float]:  # fmt: skip
    """Least clearance of an upright tool along its path, and the clearance at the end [m].

    ``points``: (P, 3) of the tool point. ``heights``: (m,) over the tool point, along ``up`` (3,),
    at which the clearance is measured. ``obstacles``: from whose surfaces. ``radius``: of the tool
    [m]. ``most``: largest clearance that is returned [m].
    """
    least = room = most
    gradient, at = np.empty(3), obstacles.position
    for p in range(len(points)):
        room = most
        for h in heights:
            x, y, z = points[p, 0] + h * up[0], points[p, 1] + h * up[1], points[p, 2] + h * up[2]
            for k in range(len(obstacles.kind)):
                u, v, w = x - at[k, 0], y - at[k, 1], z - at[k, 2]
                if math.sqrt(u * u + v * v + w * w) - obstacles.bound[k] - radius < room:
                    room = min(room, signed_distance(obstacles, k, x, y, z, gradient) - radius)
        least = min(least, room)
    return least, room
