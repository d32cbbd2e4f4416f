"""Which way round the fruits: the sides on which to pass whose push is foreseen to harm least.

The rules of :mod:`optipromp.pushing.sides` look at one fruit at a time. Where fruits hang close
together the way past one leads into the next or its stem. So the way that the rule asks for is
tried in a model of the push (:mod:`optipromp.pushing.swinging`); where that foresees harm, others
are drawn, and the optimised trajectory is tried again, as it is what the arm does.
"""

import math
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from optipromp.arrays import FloatArray, frozen, lengths
from optipromp.geometry import distances
from optipromp.geometry.obstacles import Obstacles, near, selected
from optipromp.planning.options import PlanOptions
from optipromp.planning.setup import Setup
from optipromp.pushing.bending import Stems, moved, stems
from optipromp.pushing.cup import Cup
from optipromp.pushing.neighbours import detection_variance
from optipromp.pushing.sides import UPRIGHT, Drift, passing_windows
from optipromp.pushing.swinging import mean_score
from optipromp.pushing.thread import along, evenly, length
from optipromp.robots.cup_cover import NECK_RADIUS
from optipromp.robots.tools import Cup as CupTool
from optipromp.scenes.scene import SceneObject

STEP = 0.003  # [m] of the tool point between two looks
SPEED = 0.07  # [m/s] of the tool among fruits
WALL = 0.002  # [m] of a cup that does not say how thick it is
HOPELESS = 3.0  # the most that one way the fruits may hang counts; others are not looked at then
GOOD, DETECTED_GOOD = 0.5, 0.2  # a score that needs no better one, and one of detected fruits
TOWARDS = np.deg2rad(15.0)  # most that each of them is turned to its stem's free side
SURE = 0.7  # times that: a score of a path whose trajectory is likely to be good
TURNS = np.deg2rad(45.0)  # between directions in which all neighbours are passed alike
ROUNDS, DRAWS = 6, 16  # of choices drawn where the rule's own is not good
FAR, NEAR = 1.0, 0.5  # [rad] deviation of drawn directions from the rule's, and from the best
STEM_SIDE = 0.3  # a score that passing on a stem's side must be better by
BESIDE = 0.1  # cosine from which a direction leads to the stem's side, not beside it
BERTHS = (0.4, 1.4)  # least and most that are drawn
KEPT = 0.6  # chance that a direction is drawn anew beside the best
UNSEEN, DETECTED_UNSEEN = 2, 24  # draws of where the fruits may hang otherwise than they were seen
SCREENED = 6  # of them in which a way is tried; the trajectory that follows it is in all
SHIFT = 0.003  # [m] deviation of a fruit whose scene does not say how well it was seen
WIDER = 1.5  # times the deviation of a detection: it is the unlikely that does harm
TURN, DETECTED_TURN = np.deg2rad(1.0), np.deg2rad(4.0)  # of its stem, and of one that was detected
AROUND = 0.4  # [m] about the target within which things are looked at
MOST = 24  # fruits beside the target; what they do to one another takes the square of the time
SLACK = 0.003  # [m] that the cup should keep from static things
SOME = 4  # obstacles that it takes longer to sort than to measure


def applies(setup: Setup, options: PlanOptions) -> bool:
    """Whether the model knows the scene: a cup for a target, neighbours that all hang.

    Not where there are more of them than it can try in the time of a plan.
    """
    target = setup.scene.target
    hanging = (target, *setup.neighbours)
    return (
        options.foresight
        and options.window == "rim"
        and isinstance(setup.robot.tool, CupTool)
        and 0 < len(setup.neighbours) <= MOST
        and all(thing is not None and thing.stem is not None for thing in hanging)
    )


@dataclass(frozen=True, eq=False)
class Foresight:
    """The model of one scene.

    ``stems``: of the ``count`` fruits (the target, its neighbours, and others around that a tool
    which goes a long way round may meet) as they were seen, then ``draws`` times as they may hang.
    ``detected``: whether something is known no better than it was detected.
    """

    setup: Setup
    stems: Stems
    count: int
    draws: int
    detected: bool
    cup: Cup
    solid: Obstacles
    avoid: Obstacles

    @property
    def good(self) -> float:
        """A score that needs no better one."""
        return DETECTED_GOOD if self.detected else GOOD

    def of(
        self, points: FloatArray, axes: FloatArray, draws: int | None = None, worst: float = np.inf
    ) -> float:
        """Score of a way of the tool: points (P, 3) :data:`STEP` apart, axes (P, 3).

        The mean over the fruits as they were seen and ``draws`` ways they may hang (None: all);
        something no less than ``worst`` where it is more than that.
        """
        draws = self.draws if draws is None else draws
        return mean_score(
            self.stems, self.count, 1 + draws, points, axes, STEP / SPEED,
            self.cup, self.solid, HOPELESS, worst,
        )  # fmt: skip

    def of_path(
        self, corners: FloatArray, draws: int | None = None, worst: float = np.inf
    ) -> float:
        """Score of a way through corners (k, 3), with what it costs in length and clearance.

        ``draws`` and ``worst`` as in :meth:`of`, but None is :data:`SCREENED` draws.
        """
        draws = min(self.draws, SCREENED) if draws is None else draws
        far = length(corners)
        points = evenly(corners, int(far / STEP) + 2)
        assert self.setup.goal_axis is not None
        straight = math.dist(corners[-1], corners[0])
        detour = far - straight
        axes = np.full_like(points, self.setup.goal_axis)
        beside = 0.5 * detour / straight + self._touch(points)
        return beside + self.of(points, axes, draws, worst - beside)

    def of_trajectory(self, q: FloatArray) -> float:
        """Score of configurations (T, n) from the camera point on."""
        points, axes = self.setup.robot.tool_pose(q)
        count = int(length(points) / STEP) + 2
        axes = along(points, axes, count)
        axes /= lengths(axes)[:, None]
        points = evenly(points, count)
        return self.of(points, axes)

    def _touch(self, points: FloatArray) -> float:
        """How far the cup, led upright through ``points``, comes too near to what must not move."""
        base, rim = self.cup.base, self.cup.rim
        heights = np.array([base, 0.5 * (base + rim), rim])
        axis = self.setup.goal_axis
        assert axis is not None
        where = (points[::2, None] + heights[:, None] * axis).reshape(-1, 3)
        worst = 0.0
        for obstacles, slack in ((self.solid, SLACK), (self.avoid, 0.0)):
            close = obstacles
            if len(close.kind) > SOME:
                middle = 0.5 * (where.min(axis=0) + where.max(axis=0))
                far = float(np.linalg.norm(where - middle, axis=1).max()) + self.cup.outer
                close = near(obstacles, middle, far + slack)
            if not len(close.kind):
                continue
            away, _ = distances(close, where)
            nearest = away.min(axis=1).reshape(-1, 3).min(axis=1) - self.cup.outer
            # where the goal itself is closer, no way can do better
            worst = max(worst, float(min(slack, float(nearest[-1])) - nearest.min()))
        return min(worst, 0.02) / 0.004

    def choices(
        self, drift: Drift, options: PlanOptions, path: Callable[[Drift], FloatArray],
        deadline: float = np.inf, rule: bool = True,
    ) -> Iterator[tuple[float, Drift]]:  # fmt: skip
        """Choices of sides worth planning, each with the score of its path.

        The rule's own first (unless ``rule`` is False), then every neighbour the same way (the tool
        steps aside once), then draws about the rule's directions and about the best. A choice comes
        as soon as its path is good; where none of :data:`DRAWS` is, the best of them does. From the
        ``deadline`` on (of ``time.perf_counter()``) there is no more than one.
        """
        x_g, y_g, _ = self.setup.scene.frame
        count = len(drift.ids)
        ruled = np.arctan2(drift.directions @ y_g, drift.directions @ x_g)
        plain = np.full(count, options.berth)
        best = found = None

        def tried(angles: FloatArray, berths: FloatArray) -> _Tried:
            turned = self._turned(drift, angles, berths, options)
            wrong = float(self._stem_sides(turned.directions))
            worst = np.inf if found is None else found.score
            value = wrong + self.of_path(path(turned), worst=worst - wrong)
            return _Tried(value, angles, berths, turned)

        alike = self._leant(np.arange(0.0, 2.0 * np.pi - 1e-9, TURNS))
        alike = alike[np.argsort(self._stem_sides(self._directions(alike)), kind="stable")]
        first = [ruled, *alike] if rule else list(alike)

        def late() -> bool:
            return time.perf_counter() > deadline

        for draw in range(ROUNDS * DRAWS):
            if draw == len(first):
                rng = np.random.default_rng(0)
            if draw < len(first):
                now = tried(first[draw], plain)
            elif draw % 2 and best is not None:
                change = rng.random(count) < KEPT
                angles = best.angles + NEAR * change * rng.standard_normal(count)
                berths = best.berths + 0.3 * change * rng.standard_normal(count)
                now = tried(angles, np.clip(berths, *BERTHS))
            else:
                angles = ruled + FAR * rng.standard_normal(count)
                now = tried(angles, rng.uniform(*BERTHS, count))
            if found is None or now.score < found.score:
                found = now
            if best is None or now.score < best.score:
                best = now
            if now.score < SURE * self.good or draw % DRAWS == DRAWS - 1 or late():
                yield found.score, found.drift
                found = None
                if late():
                    return

    @cached_property
    def _away(self) -> tuple[FloatArray, FloatArray]:
        """Away from each stem: lateral part (N, 3) of the unit vector root to fruit, its length."""
        along = self.stems.axes[1 : 1 + len(self.setup.neighbours), 2]
        up = self.setup.scene.frame[2]
        away = along - (along @ up)[:, None] * up
        return away, lengths(away)

    def _leant(self, angles: FloatArray) -> FloatArray:
        """Angles (m,) for all neighbours, turned a little to the free side of each stem (m, N)."""
        x_g, y_g, _ = self.setup.scene.frame
        away, lean = self._away
        free = np.arctan2(away @ y_g, away @ x_g) - angles[:, None]
        free = (free + np.pi) % (2.0 * np.pi) - np.pi
        turned = np.clip(free, -TOWARDS, TOWARDS)
        return np.asarray(angles[:, None] + (lean > np.sin(UPRIGHT)) * turned)

    def _directions(self, angles: FloatArray) -> FloatArray:
        """Unit vectors (..., 3) at angles (...) from x_g towards y_g."""
        x_g, y_g, _ = self.setup.scene.frame
        return np.asarray(np.cos(angles)[..., None] * x_g + np.sin(angles)[..., None] * y_g)

    def _stem_sides(self, directions: FloatArray) -> FloatArray:
        """What passing neighbours (..., N, 3) on the side where their stems lean costs (...)."""
        away, lean = self._away
        wrong = np.einsum("ni,...ni->...n", away, directions) < -BESIDE * lean
        return np.asarray(STEM_SIDE * np.sum((lean > np.sin(UPRIGHT)) & wrong, axis=-1))

    def _turned(
        self, drift: Drift, angles: FloatArray, berths: FloatArray, options: PlanOptions
    ) -> Drift:
        """``drift`` with directions at angles (N,) from x_g towards y_g, and with berths (N,)."""
        scene, things = self.setup.scene, self.setup.neighbours
        directions = self._directions(angles)
        windows = passing_windows(scene, things, list(directions), options.window, self.cup.rim)
        return Drift(drift.ids, drift.centers, directions, windows, berths)


class _Tried(NamedTuple):
    """A choice, as directions (N,) [rad] and berths (N,), with its score."""

    score: float
    angles: FloatArray
    berths: FloatArray
    drift: Drift


def foresight(setup: Setup) -> Foresight:
    """The model of a scene that it :func:`applies` to."""
    tool, target = setup.robot.tool, setup.scene.target
    assert isinstance(tool, CupTool)
    assert target is not None
    inner = tool.radius - WALL if tool.opening is None else tool.opening / 2.0
    cup = Cup(
        max(inner, 0.5 * tool.radius), tool.radius, tool.depth - tool.height, tool.depth, WALL,
        NECK_RADIUS,
    )  # fmt: skip
    scene, around = setup.scene, setup.surroundings
    solid = near(around.static, target.position, AROUND)
    avoid = near(selected(around.dynamic, slice(around.shared)), target.position, AROUND)
    known = {thing.id for thing in setup.neighbours}

    def near_by(thing: SceneObject) -> float:
        return float(np.linalg.norm(thing.position - target.position))

    others = [
        thing
        for thing in scene.things(scene.around(target.position, AROUND, "pushable"))
        if thing.id not in known and thing.stem is not None and near_by(thing) < AROUND
    ]
    if len(others) > MOST - len(known):
        others = sorted(others, key=near_by)[: MOST - len(known)]
    things = (target, *setup.neighbours, *others)
    detected = any(thing.covariance is not None for thing in things)
    draws = DETECTED_UNSEEN if detected else UNSEEN
    return Foresight(
        setup, _hanging(things, draws), len(things), draws, detected, cup, solid, avoid
    )  # fmt: skip


def _hanging(things: Sequence[SceneObject], draws: int) -> Stems:
    """The fruits as they were seen, and ``draws`` times as they may hang."""
    seen = stems(things)
    sure = [thing.covariance is None for thing in things]
    spread = [SHIFT if known else WIDER * np.sqrt(detection_variance(t))
              for known, t in zip(sure, things, strict=True)]  # fmt: skip
    turn = np.array([TURN if known else DETECTED_TURN for known in sure]) * seen.length
    shifted, swung = _normal((draws, len(things), 3))
    shift = np.reshape(spread, (-1, 1)) * shifted
    swing = turn[:, None] * swung * [1.0, 1.0, 0.0]
    fruit = np.array([thing.position for thing in things])
    fruits = np.concatenate([fruit[None], fruit + shift])
    roots = np.concatenate([seen.root[None], seen.root + shift + swing])
    return moved(seen, roots, fruits)


@lru_cache(maxsize=16)
def _normal(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Two arrays of standard normal numbers, always the same."""
    rng = np.random.default_rng(0)
    return frozen(rng.standard_normal(shape)), frozen(rng.standard_normal(shape))
