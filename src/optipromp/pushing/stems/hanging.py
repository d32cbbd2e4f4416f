"""The push model of fruits on bending stems, and its candidate paths.

A candidate path passes each neighbour in some direction of the lateral plane, with some lateral
clearance. The first candidate is the method's rule (:mod:`optipromp.pushing.rules`). The next ones
pass all neighbours alike.
"""

import math
from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np

from optipromp.arrays import FloatArray, frozen, lengths
from optipromp.compiled import kernel
from optipromp.geometry import signed_distance
from optipromp.geometry.obstacles import Obstacles, near
from optipromp.pushing.model import Calibration, Moved, PushModel, Round, Schedule
from optipromp.pushing.parameters import PUSH
from optipromp.pushing.path import STEP, ToolPath, through
from optipromp.pushing.rules import (
    RULE,
    detection_variance,
    drift_choices,
    path_past,
    rim_windows,
    stem_side,
)
from optipromp.pushing.stems.bending import Stems, balls_of, bowed, moved, parents, stems
from optipromp.pushing.stems.cup import Mouth
from optipromp.pushing.stems.harm import BRIEFLY, Harm, score_of
from optipromp.pushing.stems.parting import part
from optipromp.pushing.stems.swinging import Led, clear, led, mean_score, steps_inside
from optipromp.robots.cup_cover import NECK_RADIUS
from optipromp.robots.tool_protocol import Tool
from optipromp.robots.tools import WALL
from optipromp.scenes.scene import Scene, SceneObject

HANGING = PUSH.hanging
KNOWN, DETECTED = (
    Calibration(own.harm, own.failed, PUSH.harm.risks, own.thresholds)
    for own in (PUSH.known, PUSH.detected)
)
RISK = PUSH.harm.risk
STIFFNESS_SPREAD = PUSH.beam.stiffness_spread
NOTHING = Harm(0.0, 0.0, 0.0, 0.0, 0.0, False)


def applies(scene: Scene, tool: Tool | None, neighbours: Sequence[SceneObject]) -> bool:
    """Whether the model applies: there is a tool, and the target hangs.

    It does so where nothing is in the way, too: a tool that does not come along its axis knocks the
    target away. It does not apply to more fruits than it can try in the time of a plan.
    """
    target = scene.target
    hangs = tool is not None and target is not None and target.stem is not None
    return hangs and len(neighbours) <= HANGING.most


class Hanging(PushModel):
    """The push model of fruits on bending stems, for one scene.

    Args:
        scene: the scene.
        tool: modelled as a cup with the tool's mouth, also where it has fingers. A tool that takes
            hold of nothing is a solid cylinder, and a missed target does not count as harm.
        neighbours: pushables in the way, first met first.
        camera: (3,) where a path begins [m].
        gripper_radius: R_gripper [m].
        flange: of the arm, see :func:`optipromp.pushing.stems.cup.flange_of`; none by default.
        risk: share of promised successes that may be broken.
    """

    speed, good = HANGING.speed, PUSH.harm.good
    indifferent = HANGING.stem_side

    def __init__(
        self, scene: Scene, tool: Tool, neighbours: Sequence[SceneObject], camera: FloatArray,
        gripper_radius: float, flange: tuple[float, float, float] = (0.0, -1.0, -1.0),
        risk: float = RISK,
    ) -> None:  # fmt: skip
        target = scene.target
        assert target is not None
        self.scene, self.target, self.neighbours = scene, target, tuple(neighbours)
        self.aim = target.position + scene.approach.shift
        self.camera, self.gripper_radius = camera, gripper_radius
        self.entry = float(camera @ scene.frame[2])
        inner, outer = tool.mouth
        base = tool.front - tool.reach
        inner = inner if inner > 0.0 else -outer  # solid
        self.cup = Mouth(inner, outer, base, tool.depth, WALL, NECK_RADIUS, *flange)
        self._frame = np.array(scene.frame)
        self._centers = np.array([fruit.position for fruit in self.neighbours]).reshape(-1, 3)
        self._heights = self._centers @ self._frame[2]
        self._radii = np.array([fruit.radius for fruit in self.neighbours])
        self._capture = float(target.position @ self._frame[2]) - tool.depth - target.radius
        doubts = np.sqrt([detection_variance(fruit) for fruit in (target, *self.neighbours)])
        self._early = HANGING.capture + HANGING.lower * float(doubts[0])
        self._under = PUSH.rule.under + HANGING.lower * doubts[1:]
        self.static, self.avoid = (
            near(
                scene.packed(scene.around(target.position, HANGING.around, role)),
                target.position,
                HANGING.around,
            )
            for role in ("static", "avoid")
        )
        fruits = (target, *self._hanging())
        detected = any(fruit.covariance is not None for fruit in fruits)
        self.fruits, self.count = fruits, len(fruits)
        self.calibration = DETECTED if detected else KNOWN
        self.threshold = self.calibration.allowed(risk)
        self.searched = HANGING.screened_states if detected else HANGING.screened_known
        self.states = HANGING.detected_states if detected else HANGING.states
        self.stems = _sampled(fruits, self.searched, self.states, tuple(scene.up.tolist()))
        self.schedule = Schedule(
            rounds=(Round(9, 1), *[Round(12, 1)] * 3), runs=1, kept=6, screened=4,
            states=self.searched, fresh=0.3, lenient=1.6,
        )  # fmt: skip

    def _hanging(self) -> list[SceneObject]:
        """The neighbours that hang, and the fruits that a tool on a detour may meet, by their ids.

        The order is the same for all approaches to one target.
        """
        scene, target, known = self.scene, self.target, {fruit.id for fruit in self.neighbours}

        def away(obj: SceneObject) -> float:
            return math.dist(obj.position, target.position)

        others = [
            obj
            for obj in scene.objects_at(scene.around(target.position, HANGING.around, "pushable"))
            if obj.id not in known and obj.stem is not None and away(obj) < HANGING.around
        ]
        others = sorted(others, key=away)[: HANGING.most - len(known)]
        hanging = [fruit for fruit in self.neighbours if fruit.stem is not None]
        return sorted([*hanging, *others], key=lambda fruit: fruit.id)

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        """See :class:`PushModel`; the parts are those of :class:`Harm`."""
        every = HANGING.screened_every if states == 1 else HANGING.every
        told = states > self.searched
        some = self._some(self.searched if told else 0, states)
        return mean_score(
            some, self.count, states, *_steps(points, axes, every), self.cup, self.static,
            PUSH.harm.hopeless, limit, not told,
        )  # fmt: skip

    def harm_in(self, state: int, points: FloatArray, axes: FloatArray) -> Harm:
        """The parts of the harm in one state."""
        return led(self._some(state, 1), *_steps(points, axes), self.cup, self.static).harm

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        """See :class:`PushModel`; in any state."""
        return bool(clear(self.stems, points, axes, self.cup))

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """See :class:`PushModel`.

        Where fruits are swallowed, all of them are named, and not whether the target comes inside
        too: the model does not know how many the cup holds.
        """
        so = *_steps(points, axes), self.cup, self.static
        told = range(self.searched, self.searched + min(self.states, HANGING.causes))
        worst = max((led(self._some(d, 1), *so) for d in told), key=_score)
        found = worst.harm
        names = [fruit.id for fruit in self.fruits]
        if found.inside > BRIEFLY:
            within = steps_inside(worst.positions, *so[:2], self.cup)[1:]
            most = max(int(within.max()), 1)
            first, *others = (
                name for name, steps in zip(names[1:], within.tolist(), strict=True)
                if steps * so[2] > BRIEFLY or steps == most
            )  # fmt: skip
            return first, f"and {' and '.join(others)} are swallowed" if others else "is swallowed"
        if found.missed:
            return names[0], "is not inside at the end"
        on_fruit, on_stem = worst.on_fruits, worst.on_stems
        on_fruit[0] = 0.0  # the force on the target is a part of its own
        crushed = int(np.argmax(on_fruit))
        parts = (
            ("stem", int(np.argmax(on_stem)), "has its stem pressed by {:.1f} N"),
            ("fruit", crushed, "is crushed by {:.1f} N"),
            ("target", 0, "is pressed by {:.1f} N"),
            ("pinched", crushed, "is pinched for {:.1f} s"),
        )
        alone = {
            part: score_of(*NOTHING._replace(**{part: getattr(found, part)})) for part, *_ in parts
        }
        part, k, what = max(parts, key=lambda item: alone[item[0]])
        return names[k], what.format(getattr(found, part))

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        """See :class:`PushModel`."""
        done = led(self._some(0, 1), *_steps(points, axes), self.cup, self.static)
        forces = zip(self.fruits[1:], done.on_fruits[1:].tolist(), strict=True)
        return {fruit.id: force for fruit, force in forces}

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        """See :class:`PushModel`."""
        done = led(self._some(0, 1), *_steps(points, axes), self.cup, self.static)
        gone = done.positions[-1] - np.array([balls_of(fruit).center for fruit in self.fruits])
        before = np.array([fruit.position for fruit in self.fruits])
        ids = tuple(fruit.id for fruit in self.fruits)
        return Moved(ids, before + gone, np.zeros(self.count))

    def _some(self, first: int, states: int) -> Stems:
        """So many states from the ``first`` on."""
        low, high = first * self.count, (first + states) * self.count
        return Stems(*(values[low:high] for values in self.stems))

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
        """Half the relative detour, plus a penalty for a cup too near to obstacles."""
        straight = math.dist(path.points[-1], path.points[0])
        return 0.5 * (path.length - straight) / straight + self._too_near(path.points)

    def first(self) -> FloatArray:
        """The rule's directions, then eight directions in which all neighbours are passed alike."""
        rule, _ = self.spread(0)
        angles = np.repeat(
            np.arange(0.0, 2.0 * np.pi - 1e-9, np.deg2rad(HANGING.apart))[:, None],
            len(rule) // 2,
            1,
        )
        alike = np.hstack([angles, np.full_like(angles, HANGING.clearance)])
        return np.vstack([rule, alike])

    def rather(self, x: FloatArray, path: ToolPath) -> list[FloatArray]:
        """See :class:`PushModel`: away from the stems on whose side a candidate passes.

        There it passes as mirrored, or as the rule has it.
        """
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
        return self._rule, np.repeat(
            [HANGING.turned, HANGING.clearance_spread], len(self.neighbours)
        )

    @cached_property
    def _leans(self) -> FloatArray:
        """Where the stem of each neighbour leans to (N, 3), in the lateral plane; 0: nowhere."""
        away = [
            stem_side(self.scene, fruit, "lateral-plane", self.gripper_radius)
            for fruit in self.neighbours
        ]
        return -np.array([np.zeros(3) if one is None else one for one in away]).reshape(-1, 3)

    @cached_property
    def _rule(self) -> FloatArray:
        x_g, y_g, _ = self.scene.frame
        drift = drift_choices(
            self.scene, self.neighbours, "shortest", depth=self.cup.rim,
            gripper_radius=self.gripper_radius,
        )[0]  # fmt: skip
        angles = np.arctan2(drift.directions @ y_g, drift.directions @ x_g)
        return np.concatenate([angles, np.full(len(angles), HANGING.clearance)])

    def _split(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Directions (N, 3) and lateral clearances (N,) [radii] of a candidate."""
        x_g, y_g, _ = self.scene.frame
        angles, clearances = x[: len(x) // 2], x[len(x) // 2 :]
        directions = np.cos(angles)[:, None] * x_g + np.sin(angles)[:, None] * y_g
        return directions, np.clip(clearances, HANGING.clearance_least, HANGING.clearance_most)

    def _too_near(self, points: FloatArray) -> float:
        """Lack of clearance of the cup, led upright through ``points`` [in units of 4 mm]."""
        heights = np.array([self.cup.base, 0.5 * (self.cup.base + self.cup.rim), self.cup.rim])
        where = points[:: 2 * HANGING.every]
        worst = 0.0
        for obstacles, slack in ((self.static, HANGING.slack), (self.avoid, 0.0)):
            if len(obstacles.kind):
                least, end = rooms(where, heights, self._frame[2], obstacles, self.cup.outer, slack)
                # where the goal itself is closer, no path can do better
                worst = max(worst, end - least)
        return min(worst, 0.02) / 0.004


def passed_towards(
    points: FloatArray, centers: FloatArray, leans: FloatArray, up: FloatArray, rim: float
) -> FloatArray:
    """Cosines (N,) between ``leans`` (N, 3) and the ways in which a tool passes ``centers`` (N, 3).

    The tool point goes through ``points`` (P, 3), the rim ``rim`` [m] before it along ``up`` (3,).
    Of rim and tool point, at the height of a centre, the one that is more towards its lean counts.
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
    """Least room about an upright tool on its way, and the room at its end [m].

    Args:
        points: (P, 3) of the tool point.
        heights: (m,) over it, along ``up`` (3,), where the room is measured.
        obstacles: from whose surfaces.
        radius: of the tool, as far as there is no room [m].
        most: the room that is given where there is more.
    """
    least = room = most
    gradient = np.empty(3)
    for p in range(len(points)):
        room = most
        for h in heights:
            x, y, z = points[p, 0] + h * up[0], points[p, 1] + h * up[1], points[p, 2] + h * up[2]
            for k in range(len(obstacles.kind)):
                u, v, w = (
                    x - obstacles.position[k, 0],
                    y - obstacles.position[k, 1],
                    z - obstacles.position[k, 2],
                )
                if math.sqrt(u * u + v * v + w * w) - obstacles.bound[k] - radius < room:
                    room = min(room, signed_distance(obstacles, k, x, y, z, gradient) - radius)
        least = min(least, room)
    return least, room


def _steps(
    points: FloatArray, axes: FloatArray, every: int = HANGING.every
) -> tuple[FloatArray, FloatArray, float]:
    """Points and tool axes (T, 3) of a path in steps of the model, and the time of a step [s]."""
    chosen = np.append(np.arange(0, len(points) - 1, every), len(points) - 1)
    return points[chosen], axes[chosen], every * STEP / HANGING.model_speed


def _score(push: Led) -> float:
    return score_of(*push.harm)


@lru_cache(maxsize=4)  # by identity: all approaches to a target meet the same fruits
def _sampled(
    fruits: tuple[SceneObject, ...], searched: int, states: int, vertical: tuple[float, ...]
) -> Stems:
    """The states that a path is searched in, the perceived one first; then those that tell harm.

    A path that was chosen for some states does better there than elsewhere. So its harm is told by
    ``states`` others, which are spread as the errors are. Those of the search are spread wider.
    """
    up, samples = np.array(vertical), searched - 1 + states
    wider = np.where(np.arange(samples) < searched - 1, HANGING.wider, 1.0)[:, None]
    cases = _cases(fruits, up)
    seen, count = cases[0], len(fruits)
    sure = [fruit.covariance is None for fruit in fruits]
    spread = np.array(
        [HANGING.shift if known else np.sqrt(detection_variance(fruit))
         for known, fruit in zip(sure, fruits, strict=True)]
    ) * np.where(sure, 1.0, wider)  # fmt: skip
    degrees = [HANGING.turn if known else HANGING.detected_turn for known in sure]
    turn = np.deg2rad(degrees) * seen.length
    shifted, swung = _normal((samples, len(fruits), 3))
    shift = spread[..., None] * shifted
    swing = turn[:, None] * (swung - (swung @ up)[..., None] * up)  # level
    place = np.array([balls_of(fruit).center for fruit in fruits])
    places = np.concatenate([place[None], place + shift])
    roots = np.concatenate([seen.root[None], seen.root + shift + swing])
    part(places, roots, seen.radius, seen.above, (1.0 - seen.upper) * seen.length)
    size, turn = _uniform((2, (samples + 1) * count))
    beam = PUSH.beam
    size = beam.bow_least + size * (beam.bow_most - beam.bow_least)
    return bowed(moved(cases, roots, places), size, 2.0 * np.pi * turn)


def _cases(fruits: Sequence[SceneObject], up: FloatArray) -> list[Stems]:
    """The stems as told or assumed; where that is a belief, also softer ones and stiffer ones.

    The stems of a plant are alike: in one case all of them are softer.
    """
    wide = np.array([_spread(fruit) for fruit in fruits])
    if (wide == 1.0).all():
        return [stems(fruits, up)]
    factors = np.stack([np.ones(len(fruits)), 1.0 / wide, wide])
    if (parents(fruits) >= 0).any():
        return [stems(fruits, up, factor) for factor in factors]
    every, count = stems([*fruits] * len(factors), up, factors.ravel()), len(fruits)
    return [
        Stems(*(values[k : k + count] for values in every))
        for k in range(0, len(factors) * count, count)
    ]


def _spread(fruit: SceneObject) -> float:
    """The factor by which a stem may well be softer or stiffer than told, or than assumed."""
    assumed = 1.0 if "stem_stiffness" in fruit.physical else STIFFNESS_SPREAD
    return fruit.physical.get("stem_stiffness_spread", assumed)


@lru_cache(maxsize=16)
def _uniform(shape: tuple[int, ...]) -> FloatArray:
    """Numbers between 0 and 1, always the same."""
    return frozen(np.random.default_rng(1).random(shape))


@lru_cache(maxsize=16)
def _normal(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Two arrays of standard normal numbers, always the same."""
    rng = np.random.default_rng(0)
    return frozen(rng.standard_normal(shape)), frozen(rng.standard_normal(shape))
