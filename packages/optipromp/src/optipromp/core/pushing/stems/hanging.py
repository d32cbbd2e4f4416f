"""The push model of fruits on bending stems, and the candidate paths of a cup among them.

A candidate path passes each neighbour in a direction of the lateral plane with a lateral clearance.
The first candidate is the method's rule (:mod:`optipromp.core.pushing.rules`). The next candidates
pass all neighbours in the same direction.
"""

import copy
import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import step
from optipromp.core.compiled import kernel
from optipromp.core.geometry import signed_distance
from optipromp.core.geometry.obstacles import Obstacles, near
from optipromp.core.pushing import rules
from optipromp.core.pushing.model import (
    Candidates,
    Guided,
    Moved,
    Prediction,
    PushModel,
    Round,
    Schedule,
)
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP, ToolPath, through
from optipromp.core.pushing.stems import bending, kept_states, swinging
from optipromp.core.pushing.stems.cup import Mouth, fits, steps_inside
from optipromp.core.robots.cup_cover import NECK_RADIUS
from optipromp.core.robots.grippers import Scissor, Suction
from optipromp.core.robots.mounted import unmounted
from optipromp.core.robots.tool_protocol import Tool, finger_width
from optipromp.core.robots.tools import WALL, cone_of
from optipromp.core.scenes.scene import Scene, SceneObject, packed, rows_around

HANGING = PUSH.hanging
TOGETHER = 4  # states whose harm is computed between two steps of a plan that works in slices
WEIGHT = 4  # of these states, in steps, measured: a step takes 1 ms in the median, 4 states 2 to 5
NEW = np.zeros((0, 0, 0))  # kept of a push that begins
NOTHING = swinging.Harm(0.0, 0.0, 0.0, 0.0, 0.0, False)


class _Passed(NamedTuple):
    """The neighbours that paths pass, N of them, first met first."""

    centers: FloatArray  # (N, 3) [m]
    heights: FloatArray  # (N,) along the approach [m]
    radii: FloatArray  # (N,) [m]
    under: FloatArray  # (N,) by which a path is below each [m]


class PathsPast(Candidates):
    """Paths that pass each of N neighbours on a side: x has N angles, then N clearances.

    ``neighbours``: pushables in the way, first met first. ``cup``: led along the paths.
    ``obstacles``: static objects, and objects to avoid. ``camera``: (3,) where a path begins [m].
    ``gripper_radius``: R_gripper [m]. ``states``: number of states on which the best candidates are
    tried.
    """

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
        self.obstacles = obstacles
        self._frame = np.array(scene.frame)
        self._capture = float(target.position @ self._frame[2]) - cup.rim - target.radius
        doubts = np.sqrt([rules.detection_variance(fruit) for fruit in (target, *self.neighbours)])
        self._early = HANGING.capture + HANGING.lower * float(doubts[0])
        centers = np.array([fruit.position for fruit in self.neighbours]).reshape(-1, 3)
        self._passed = _Passed(
            centers, centers @ self._frame[2],
            np.array([fruit.radius for fruit in self.neighbours]),
            PUSH.rule.under + HANGING.lower * doubts[1:],
        )  # fmt: skip
        self.schedule = Schedule(
            rounds=(Round(9, 1), *[Round(12, 1)] * 3), runs=1, kept=6,
            states=states, fresh=0.3, lenient=1.6,
        )  # fmt: skip

    def path(self, x: FloatArray) -> ToolPath:
        """Past neighbour n at the angle ``x[n]`` from x_g, with ``x[N + n]`` radii of clearance."""
        (directions, clearances), passed = self._split(x), self._passed
        windows = rules.rim_windows(
            passed.heights, passed.radii, directions, self.cup.rim, self._capture, passed.under
        )
        corners = rules.path_past(
            passed.centers, directions, windows, self.gripper_radius + clearances * passed.radii,
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

    def spread(self, run: int) -> tuple[FloatArray, FloatArray]:
        """About the rule's directions."""
        spread = np.repeat([HANGING.turned, HANGING.clearance_spread], len(self.neighbours))
        return self._rule, spread

    @cached_property
    def _rule(self) -> FloatArray:
        x_g, y_g, _ = self.scene.frame
        drift = rules.drift_choices(
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
        for obstacles, slack in zip(self.obstacles, (HANGING.slack, 0.0), strict=True):
            if len(obstacles.kind):
                least, end = rooms_beside(
                    where, heights, self._frame[2], obstacles, self.cup.outer, slack
                )
                worst = max(worst, end - least)  # no path has more room than the goal
        return min(worst, 0.02) / 0.004


@kernel
def rooms_beside(points, heights, up, obstacles, radius, most):
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


def applies(scene: Scene, tool: Tool | None, neighbours: Sequence[SceneObject]) -> bool:
    """Whether the model applies: a tool, a target that hangs, and not too many neighbours.

    Without neighbours, too: a tool that does not come along its axis knocks the target away.
    """
    target = scene.target
    hangs = tool is not None and target is not None and target.stem is not None
    return hangs and len(neighbours) <= HANGING.most


class _Way(NamedTuple):
    """What a motion is, and how finely and how far its harm is told."""

    leaves: int = swinging.NEVER  # first point of the way out
    speed: float = 0.0  # of the cup on the way out [m/s]
    every: int = HANGING.every  # points a step
    hopeless: float = PUSH.harm.hopeless  # score from which no more is told


class _Before(NamedTuple):
    """Where the motion before has led: what is kept of each state, and its last points."""

    kept: FloatArray = NEW
    behind: FloatArray = np.zeros((0, 6))  # tool points and axes


class Hanging(PushModel):
    """The push model of fruits on bending stems, for one scene.

    Args:
        scene: the scene.
        tool: modelled as a cup with the tool's mouth, also where it has fingers. A tool that takes
            hold of nothing is a solid cylinder, and a missed target does not count as harm. A
            scissor misses where the target's stem does not end between its blades.
        neighbours: pushables in the way, first met first.
        camera: (3,) where a path begins [m].
        gripper_radius: R_gripper [m].
        flange: of the arm, see :func:`optipromp.core.pushing.stems.cup.flange_of`.
        risk: share of promised successes that may be broken.
    """

    def __init__(
        self, scene: Scene, tool: Tool, neighbours: Sequence[SceneObject], camera: FloatArray,
        gripper_radius: float, flange: tuple[float, float, float] = (0.0, -1.0, -1.0),
        risk: float = PUSH.harm.risk,
    ) -> None:  # fmt: skip
        target = scene.target
        assert target is not None
        inner, outer = tool.mouth
        inner = inner if inner > 0.0 else -outer  # solid
        base = tool.front - tool.reach
        walls = inner, outer, base, tool.depth, WALL
        cup = Mouth(*walls, NECK_RADIUS, *flange, *fingers_of(scene, tool))
        self.cup = cup._replace(cone=cone_of(tool))
        where = target.position, HANGING.around
        rows = (rows_around(scene, *where, role) for role in ("static", "avoid"))
        self.static, avoid = (near(packed(scene, each), *where) for each in rows)
        fruits = (target, *_hanging(scene, target, neighbours))
        hidden = any(fruit.stem is not None and fruit.stem.unseen for fruit in fruits)
        detected = hidden or any(fruit.covariance is not None for fruit in fruits)
        self.fruits = fruits
        self.calibration = PUSH.detected if detected else PUSH.known
        self.risk, self.threshold = risk, self.calibration.allowed(risk)
        self.searched = HANGING.screened_states if detected else HANGING.screened_known
        self.states = HANGING.detected_states if detected else HANGING.states
        self.stems = bending.sampled(fruits, self.searched, self.states, tuple(scene.up.tolist()))
        self.least = unfit(scene, tool, self.stems.axes[:: self.count, 2], self.searched)
        self.least += max(pressed_at_end(scene, tool) / PUSH.harm.target_force - 1.0, 0.0)
        self.good = PUSH.harm.good + self.least
        self._by: FloatArray | None = None  # (N, P, 3) drifts of the roots [m]
        self._way, self._before = _Way(), _Before()
        self.candidates = PathsPast(
            scene, neighbours, self.cup, (self.static, avoid), camera, gripper_radius, self.searched
        )

    @property
    def count(self) -> int:
        """Number of fruits."""
        return len(self.fruits)

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        way, (kept, behind) = self._way, self._before
        every = way.every
        if states == 1:
            every = HANGING.every if len(kept) else HANGING.screened_every
        if self.least > limit:
            return self.least
        told = max(states, len(kept)) > self.searched
        some, motion = self._steps(self.searched if told else 0, states, points, axes, every)
        hopeless, begin = way.hopeless, len(behind)
        leaves = way.leaves // every + max(begin - 1, 0)
        total, worst = 0.0, (limit - self.least) * states
        for first in range(0, states, TOGETHER):
            which = first, min(first + TOGETHER, states)
            total = swinging.summed_score(
                some, self.count, which, *motion, self.cup, self.static, hopeless, worst, not told,
                leaves, way.speed, total, begin, kept, False,
            )  # fmt: skip
            if not told and first == 0 and total >= hopeless:
                return self.least + float(total)
            if total > worst:
                break
            step(WEIGHT)
            sure = told and way.leaves in (0, swinging.NEVER) and 3 * which[1] >= states
            if sure and total <= HANGING.sure * self.threshold * which[1]:
                return self.least + float(total / which[1])
        return self.least + float(total / states)

    def led(self, state: int, points: FloatArray, axes: FloatArray) -> swinging.Led:
        """Effect of a motion of the tool on the fruits in one state."""
        one, motion = self._steps(state, 1, points, axes)
        way, (before, behind) = self._way, self._before
        leaves, begin = way.leaves // way.every, len(behind)
        first = self.searched if len(before) > self.searched else 0
        kept = before[state - first] if begin else kept_states.NOT_KEPT
        return swinging.led(one, *motion, self.cup, self.static, leaves, way.speed, begin, kept)

    def drifting(self, by: Mapping[str, FloatArray]) -> Self:
        moved = copy.copy(self)
        still = np.zeros_like(next(iter(by.values())))
        moved._by = np.stack([by.get(fruit.id, still) for fruit in self.fruits])
        return moved

    def leaving(self, first: int) -> Self:
        """The model of motions whose points from the ``first`` on lead the tool out again."""
        out = copy.copy(self)
        out.cup = self.cup._replace(rubbing=PUSH.swing.leaving)
        out._way = self._way._replace(leaves=first)
        out.least = 0.0  # the target is inside, or it was not picked
        return out

    def clear(self, points: FloatArray, axes: FloatArray) -> bool:
        every, (points, axes, _) = self._steps(0, self.searched + self.states, points, axes, 1)
        return bool(swinging.clear(every, points, axes, self.cup))

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        """See :class:`PushModel`; all swallowed fruits are named, before a missed target."""
        told = range(self.searched, self.searched + min(self.states, HANGING.causes))
        state, worst = max(
            ((state, self.led(state, points, axes)) for state in told),
            key=lambda one: swinging.score_of(*one[1].harm) + one[1].pulls.max() / PUSH.harm.pull,
        )
        found = worst.harm
        names = [fruit.id for fruit in self.fruits]
        if found.inside > PUSH.harm.inside_time:
            some, (points, axes, dt) = self._steps(state, 1, points, axes)
            within = steps_inside(worst.positions, points, axes, self.cup, some)[1:]
            most = max(int(within.max()), 1)
            first, *others = (
                name
                for name, steps in zip(names[1:], within.tolist(), strict=True)
                if steps * dt > PUSH.harm.inside_time or steps == most
            )
            return first, f"and {' and '.join(others)} are swallowed" if others else "is swallowed"
        if self.cup.inner < 0.0 < self.least:  # a suction cup
            force, bears = (1.0 + self.least) * PUSH.harm.target_force, PUSH.harm.target_force
            remedy = f"bears {bears:g}: state no tool.fruit, or a larger one"
            return names[0], f"is pressed by {force:.1f} N at the lip ({remedy})"
        if self.least > 0.5:  # in most states
            return names[0], "does not fit into the tool's mouth"
        if found.missed:
            place = "between the blades" if self.cup.cut else "inside"
            return names[0], f"is not {place} at the end"
        on_fruit, on_stem = worst.on_fruits, worst.on_stems
        if self._way.leaves == swinging.NEVER:
            on_fruit[0] = 0.0  # the force on the target is a separate part of the harm
        crushed = int(np.argmax(on_fruit))
        parts = (
            ("stem", int(np.argmax(on_stem)), "has its stem pressed by {:.1f} N"),
            ("fruit", crushed, "is crushed by {:.1f} N"),
            ("target", 0, "is pressed by {:.1f} N"),
            ("pinched", crushed, "is pinched for {:.1f} s"),
        )

        def alone(item: tuple[str, int, str]) -> float:
            return float(swinging.score_of(*NOTHING._replace(**{item[0]: getattr(found, item[0])})))

        name, k, what = max(parts, key=alone)
        if worst.pulls.max() / PUSH.harm.pull > alone((name, k, what)):
            k = int(worst.pulls.argmax())
            if math.isinf(worst.pulls[k]):
                return names[k], "jams under the tool on the way out"
            return names[k], f"is pulled along its stem by {worst.pulls[k]:.1f} N on the way out"
        return names[k], what.format(getattr(found, name))

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        forces = self.led(0, points, axes).on_fruits.tolist()
        return {fruit.id: force for fruit, force in zip(self.fruits[1:], forces[1:], strict=True)}

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        began = np.array([bending.hanging_balls(fruit).center for fruit in self.fruits])
        gone = self.led(0, points, axes).positions[-1] - began
        before = np.array([fruit.position for fruit in self.fruits])
        ids = tuple(fruit.id for fruit in self.fruits)
        return Moved(ids, before + gone, np.zeros(self.count))

    def _steps(
        self, first: int, states: int, points: FloatArray, axes: FloatArray,
        every: int | None = None,
    ) -> tuple[bending.Stems, tuple[FloatArray, FloatArray, float]]:  # fmt: skip
        """The stems of ``states`` states from the ``first`` on, and the motion at the steps.

        The motion is points and tool axes (T, 3), and the time of a step [s].
        """
        every, behind = every or self._way.every, self._before.behind
        low, high = first * self.count, (first + states) * self.count
        some = bending.Stems(*(values[low:high] for values in self.stems))
        chosen = np.append(np.arange(0, len(points) - 1, every), len(points) - 1)
        if self._by is not None:
            some = some._replace(drift=np.tile(self._by[:, chosen], (states, 1, 1)))
        points, axes = points[chosen], axes[chosen]
        if len(behind):
            points = np.concatenate([behind[:, :3], points[1:]])
            axes = np.concatenate([behind[:, 3:], axes[1:]])
        return some, (points, axes, every * STEP / HANGING.model_speed)


def after(model: Hanging, points: FloatArray, axes: FloatArray, states: int) -> Hanging:
    """The model of motions that go on from here, after the tool was led through points (P, 3).

    The next motion begins at the last point. The model may be asked for its harm in ``states``
    states at most and, where that is 1, for the places to which fruits move. P is 1 more than a
    multiple of ``HANGING.every``: points of both motions fall on the same steps. Not for roots that
    drift.
    """
    on, count, (before, behind) = copy.copy(model), model.count, model._before
    first = model.searched if states > model.searched else 0
    some, (points, axes, dt) = model._steps(first, states, points, axes)
    width = kept_states.width(dt)
    kept = before.copy() if len(before) else np.zeros((states, count, width))
    swinging.summed_score(
        some, count, (0, states), points, axes, dt, model.cup, model.static, math.inf, math.inf,
        False, swinging.NEVER, 0.0, 0.0, len(behind), kept, True,
    )  # fmt: skip
    on._before = _Before(kept, np.hstack([points, axes])[-((width - kept_states.ROWS) // 2) :])
    return on


def departing(model: Hanging, speed: float) -> Hanging:
    """The model of motions out at a ``speed`` [m/s], from rest where :func:`after` led.

    Only what happens on the way out is harm; the harm of a state is at most 1.
    """
    out = model.leaving(0)
    kept, behind = model._before
    out._before = _Before(kept_states.at_rest(kept), behind[-1:])
    out._way = _Way(0, speed, HANGING.every_out, 1.0)
    return out


class Leaving(Guided):
    """The push model of ways out after a push: on them, pulls along the stems are harm, too.

    The harm is that of the way out alone, from rest where the way in has led all fruits.

    ``model``: of the scene before the push. ``points``, ``axes``: (P, 3) of the tool on its way in.
    ``way_in``: prediction of that way, whose harm is part of every harm: the threshold is of the
    whole pick.
    """

    speed = HANGING.speed  # of the tool among fruits on the way out [m/s]

    def __init__(
        self, model: Hanging, points: FloatArray, axes: FloatArray,
        way_in: Prediction | None = None,
    ) -> None:  # fmt: skip
        super().__init__(model)
        known = model.calibration is PUSH.known
        self.calibration = PUSH.known_out if known else PUSH.detected_out
        self.way_in = way_in or Prediction(0.0, math.inf)
        self.threshold = self.calibration.allowed(model.risk)
        self.states = model.states // 2  # measured: 12 of 24 tell as well, docs/decisions.md
        self._going = after(model, points, axes, max(self.states, model.searched + 1))
        self._before = model, points, axes

    def at(self, speed: float) -> "Leaving":
        """The model of ways out at another speed [m/s]."""
        other = copy.copy(self)
        other.speed = speed
        return other

    @cached_property
    def _seen(self) -> Hanging:
        """The model of the perceived state."""
        model, points, axes = self._before
        return after(model, points, axes, 1)

    def harm(
        self, points: FloatArray, axes: FloatArray, states: int, limit: float = np.inf
    ) -> float:
        going = departing(self._going, self.speed)
        least = self.way_in.harm
        return least + going.harm(points, axes, states, limit - least)

    def cause(self, points: FloatArray, axes: FloatArray) -> tuple[str, str]:
        going = departing(self._going, self.speed)
        if self.way_in.harmful and going.harm(points, axes, self.states) < self.way_in.harm:
            return self.way_in.object, self.way_in.cause
        return going.cause(points, axes)

    def forces(self, points: FloatArray, axes: FloatArray) -> dict[str, float]:
        return departing(self._seen, self.speed).forces(points, axes)

    def moved(self, points: FloatArray, axes: FloatArray) -> Moved:
        return departing(self._seen, self.speed).moved(points, axes)


def _hanging(
    scene: Scene, target: SceneObject, neighbours: Sequence[SceneObject]
) -> list[SceneObject]:
    """The neighbours that hang, and the fruits that a tool on a detour may meet, sorted by id.

    So the order is the same for all approaches to a target.
    """
    known = {fruit.id for fruit in neighbours}

    def away(obj: SceneObject) -> float:
        return math.dist(obj.position, target.position)

    around = scene.objects_at(rows_around(scene, target.position, HANGING.around, "pushable"))
    others = [o for o in around if o.stem and o.id not in known and away(o) < HANGING.around]
    others = sorted(others, key=away)[: HANGING.most - len(known)]
    hanging = [fruit for fruit in neighbours if fruit.stem is not None]
    return sorted([*hanging, *others], key=lambda fruit: fruit.id)


def unfit(scene: Scene, tool: Tool, lines: FloatArray, first: int) -> float:
    """Share of the states from the ``first`` on in which a long target does not fit into the mouth.

    ``lines`` (S, 3) are the directions of its stem, with which it turns; that of state 0 is the
    perceived one. 0 for other targets and mouths: the contacts of a ball show what does not fit,
    those of two balls show too little of a fruit's width.
    """
    target, fit = scene.target, PUSH.harm.fit
    assert target is not None
    if tool.fingers or tool.mouth[0] <= 0.0 or not bending.hanging_balls(target).apart:
        return 0.0
    axis, seen, lines = scene.frame[2], lines[0], lines[first:]
    both = lines + seen
    # the approach as the perceived fruit meets it: turned back with the stem
    turned = axis - both * (both @ axis / (1.0 + lines @ seen))[:, None]
    aside, below, _ = fits(target, turned + 2.0 * (lines @ axis)[:, None] * seen, tool)
    room = np.minimum(aside, below - scene.approach.shift @ axis + fit)
    return float(np.clip(1.0 - room / fit, 0.0, 1.0).mean())


def pressed_at_end(scene: Scene, tool: Tool) -> float:
    """Force of a suction cup on a target whose stem stands, at the end of the approach [N].

    The stem cannot yield along its line: the cup does. 0 for other tools, and for stems that hang.
    """
    target, cup, axis = scene.target, unmounted(tool), scene.frame[2]
    assert target is not None
    if not isinstance(cup, Suction) or target.stem is None:
        return 0.0
    rise = target.position - target.stem.root
    along = -float(rise @ axis) / float(np.linalg.norm(rise)) if rise @ scene.up > 0.0 else 0.0
    deep = float(target.shape.support(-axis[None] @ target.rotation)[0]) - cup.fruit
    return cup.stiffness * max(deep + float(scene.approach.shift @ axis), 0.0) * max(along, 0.0)


def fingers_of(scene: Scene, tool: Tool) -> tuple[float, ...]:
    """The fields of :class:`Mouth` of a tool with fingers or blades, from ``cut`` on; or none.

    They are side by side along y_g, as the planner rolls them. ``cut`` is of a scissor that is led
    to the target's stem.
    """
    cut, target = 0.0, scene.target
    if not tool.fingers or not tool.mouth[0]:  # of full ones it is 0
        return ()
    if isinstance(unmounted(tool), Scissor) and target is not None and scene.approach.shift.any():
        balls = bending.hanging_balls(target)
        nodes = (item.stem.root for item in scene.taken[1:] if item.stem is not None)
        cut = max([balls.apart + balls.above, *(math.dist(one, balls.center) for one in nodes)])
    palm = [solid.corners for solid in tool.solids() if solid.part == "palm"]
    x, y, z = ((np.concatenate(palm) - tool.point) @ tool.rotation).T if palm else np.zeros((3, 1))
    sizes = float(np.abs(x).max()), float(np.abs(y).max()), float(z.min())
    return cut, finger_width(tool), *scene.frame[0].tolist(), *sizes
