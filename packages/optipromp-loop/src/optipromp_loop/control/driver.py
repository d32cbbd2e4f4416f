"""The arm's side of the controller: the course that runs, and the next one."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, frame_along, frozen, lengths, rotation
from optipromp.core.execution.streaming import Stretch
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import posed, spaced
from optipromp.core.planning.timing import needs, stopped
from optipromp.core.pushing.model import PushModel
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.scene import JointGoal, Scene, SceneObject
from optipromp.core.trajectory import Motion, State, Trajectory
from optipromp.core.values import Unlimited
from optipromp_loop.control.parameters import CONTROL, LoopParameters
from optipromp_loop.control.tracker import Tracked

TRACKED = 2e-4  # [m] largest error of a followed tool point: a choice
Moves = Callable[[FloatArray], FloatArray]  # Displacements (M, F, 3) of F fruits at times (M,) [s]


@dataclass(frozen=True, eq=False)
class Displacement:
    """The displacement of the plant against a plan's scene."""

    places: FloatArray  # (F, 3) rest positions in the plan's scene [m]
    # displacements of the fruits from these places over time, by the controller's clock
    moves: Moves
    length: float = CONTROL.field  # over which the displacement of a fruit counts [m]

    def at(self, points: FloatArray, times: FloatArray) -> FloatArray:
        """Displacement (M, 3) of tool points (M, 3) at times (M,) [s]."""
        if not len(self.places):
            return np.zeros_like(points)
        away = np.square(points[:, None] - self.places[None]).sum(axis=2) / self.length**2
        share = np.exp(away.min(axis=1, keepdims=True) - away)
        share /= share.sum(axis=1, keepdims=True)
        return np.asarray(np.einsum("mf,mfi->mi", share, self.moves(times)))


@dataclass(frozen=True, eq=False)
class Route:
    """A plan's trajectory with its tool poses.

    Attributes:
        plan: the plan, or None for a way back.
        trajectory: T waypoints.
        points, axes: (T, 3) of the tool.
        weight: (T,) share of the plant's displacement.
        scene: of the plan.
        pushes: the model of the pushes on the way; None: nothing is pushed.
        came: of a way out, the route that it leads back from, and the time in that route.
    """

    robot: Robot
    trajectory: Trajectory
    points: FloatArray
    axes: FloatArray
    weight: FloatArray
    scene: Scene
    plan: Plan | None = None
    pushes: PushModel | None = None
    came: tuple[Route, float] | None = None

    @classmethod
    def of(cls, plan: Plan) -> Route:
        """The route of a plan."""
        begin = float(plan.trajectory.times[plan.first])
        made = cls.along(plan.robot, plan.trajectory, plan.scene, begin)
        return replace(made, plan=plan, pushes=plan.push_model)

    @classmethod
    def along(
        cls, robot: Robot, trajectory: Trajectory, scene: Scene, begin: float = 0.0,
        came: tuple[Route, float] | None = None,
    ) -> Route:  # fmt: skip
        """The route of a motion that was planned in a ``scene``; from the time ``begin`` [s] on the
        whole motion of the plant counts; infinite: it does not count at all."""
        points, axes = robot.tool_pose(trajectory.positions)
        share = np.clip(trajectory.times / begin, 0.0, 1.0) if begin > 0.0 else 1.0
        weight = np.broadcast_to(share * share * (3.0 - 2.0 * share), len(points))
        return cls(robot, trajectory, points, axes, frozen(weight), scene, came=came)

    @property
    def approach(self) -> float:
        """Time in the route at which the approach begins [s]."""
        first = 0 if self.plan is None else self.plan.first
        return float(self.trajectory.times[first])

    @property
    def duration(self) -> float:
        """Duration of the trajectory [s]."""
        return self.trajectory.duration


@dataclass(frozen=True, eq=False)
class Course(Stretch):
    """A stretch that follows a route."""

    phase: float  # time in the route at ``begins`` [s]
    rate: Unlimited  # time of the curve over time of the route; infinite for an arm that waits

    def phase_at(self, time: float) -> float:
        """Time in the route at a ``time`` [s]."""
        return self.phase + max(time - self.begins, 0.0) / self.rate


def follow(
    route: Route, phase: float, state: State, begins: float, field: Displacement,
    parameters: LoopParameters = CONTROL,
) -> Course | None:  # fmt: skip
    """The course along a route from ``phase`` on, beginning in ``state`` at the time ``begins``.

    The curve is the path, moved with the plant, and the state's error beside it, which fades in the
    time of a blend: however often the path is moved anew, the error shrinks. Of several rates and
    blends, in order, the first counts with which the curve keeps the robot's limits. A blend that
    is longer than what is left of the path would swing past its end. None: with none of them, or
    the arm cannot reach the moved path.
    """
    ways = [(parameters.rates[0], parameters.blends[:3])]
    ways += [(rate, parameters.blends[1:]) for rate in parameters.rates[1:]]
    left, robot = route.duration - phase, route.robot
    for rate, blends in ways:
        path = _path(route, phase, begins, field, rate, parameters)
        if path is None:
            continue
        times, q, motion = path
        away = [np.subtract(*pair) for pair in zip(vars(state).values(), motion, strict=True)]
        for blend in blends:
            if left > 0.0 and blend > max(left * rate, parameters.blends[0]):
                continue
            knots = np.vstack([state.q, q + faded(away, blend, times)])
            at = np.append(0.0, times)
            curve = Trajectory.through(knots, at, robot.joint_names, begin=state)
            inside = (curve.positions >= robot.lower) & (curve.positions <= robot.upper)
            if inside.all() and needs(robot, curve).max() <= 1.0:
                return Course(curve, begins, phase, rate)
    return None


def faded(away: Sequence[FloatArray], blend: float, times: FloatArray) -> FloatArray:
    """The error (m, n) at ``times`` (m,) [s], of one that fades in the time ``blend`` [s].

    The quintic from ``away``, three (n,): the error, its velocity and its acceleration at 0, to a
    rest at 0.
    """
    s = np.clip(times / blend, 0.0, 1.0)[:, None]
    value = 1.0 - s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    rate = s - s**3 * (6.0 - 8.0 * s + 3.0 * s**2)
    bend = 0.5 * s**2 * (1.0 - s) ** 3
    return np.asarray(value * away[0] + blend * rate * away[1] + blend**2 * bend * away[2])


GAP = 0.025  # [s] from the begin of a curve to its next waypoint, at least: a choice
STEP = 0.02  # [s] of the differences that tell how the moved path moves: a choice


def _path(
    route: Route, phase: float, begins: float, field: Displacement, rate: float,
    parameters: LoopParameters,
) -> tuple[FloatArray, FloatArray, Motion] | None:  # fmt: skip
    """Times (m,) [s] after ``begins`` and configurations (m, n) of the rest of a route, moved with
    the plant, and how it moves at ``begins``; None: the arm cannot reach it."""
    made, robot, tail = route.trajectory, route.robot, parameters.tail
    rows = (made.times - phase) * rate
    end = max(float(rows[-1]), parameters.blends[0])
    rest = tail * np.array([1.0, 2.0, 3.0]) / 3.0  # the plant's motion fades in the tail
    times = np.append(rows[(rows > GAP) & (rows < end - GAP)], [end, *(end + rest)])
    at = np.concatenate([[-STEP, 0.0, STEP], times])
    late = np.clip(at - end, 0.0, tail)
    q, _, _ = made.sample(phase + at / rate)
    points, axes = robot.tool_pose(q)
    weight = np.interp(phase + at / rate, made.times, route.weight)
    shift = weight[:, None] * field.at(points, begins + at - 0.5 * late**2 / tail)
    q, errors = ik.each(robot, points + shift, axes, q)
    if errors.max() > TRACKED:
        return None
    before, now, after = q[:3]
    moves = (after - before) / (2.0 * STEP), (after - 2.0 * now + before) / STEP**2
    return times, q[3:], (now, *moves)


MOVED = 1e-4  # [m] of a predicted push, below which a fruit counts as free: a choice


def tracked_scene(
    base: Scene, tracked: Tracked, offset: FloatArray | None = None,
    start: FloatArray | None = None,
) -> Scene:  # fmt: skip
    """The scene to plan in: what stands still in ``base``, and the tracked fruits at rest.

    ``offset``: (3,) common displacement that is left out [m]; None: none. ``start``: (n,)
    of the arm; None: that of ``base``.
    """
    still = tuple(item for item in base.objects if item.role in ("static", "avoid"))
    told = {item.id: item for item in base.objects if item.stem is not None}
    seen = tracked.objects()
    by = [item.position - told[item.id].position for item in seen if item.id in told]
    common = np.median(by, axis=0) if by else np.zeros(3)
    if float(np.linalg.norm(common)) <= CONTROL.settled:  # they hang where they were told
        common = np.zeros(3)
    seen = tuple(_as_told(item, told.get(item.id), common) for item in seen)
    if offset is not None:
        seen = tuple(item.shifted(-offset) for item in seen)
    start = base.start if start is None else start
    return replace(base, objects=rooted([*still, *seen]), goal=None, start=start)


def _as_told(item: SceneObject, told: SceneObject | None, common: FloatArray) -> SceneObject:
    """A tracked fruit with what a scene told of it, as far as the looks confirm that.

    A fruit that was told surely and hangs where it was told, beside what all fruits have moved in
    ``common`` (3,) [m], stays as it was told. Of other fruits, a stem that is bent or grows from
    another is kept, shifted with its fruit.
    """
    if told is None or told.stem is None or item.stem is None:
        return item
    moved = item.position - told.position
    if told.covariance is None and float(np.linalg.norm(moved - common)) <= CONTROL.settled:
        return replace(told.shifted(common), role=item.role)
    points = item.stem.points
    if len(told.stem.points) > 2:
        points = told.stem.points + (item.position - told.stem.points[0])
    return replace(item, stem=replace(item.stem, points=points, parent=told.stem.parent))


def tracked_at_most(scene: Scene, most: int) -> Scene:
    """The scene with at most so many fruits; those farther from the target are only avoided."""
    fruits = [item for item in scene.objects if item.role in ("target", "pushable")]
    if len(fruits) <= most:
        return scene
    centre = (scene.target or fruits[0]).position
    fruits.sort(key=lambda item: (item.role != "target", math.dist(item.position, centre)))
    far = {item.id for item in fruits[most:]}
    objects = (replace(o, role="avoid") if o.id in far else o for o in scene.objects)
    return replace(scene, objects=tuple(objects))


def first_tracks(scene: Scene, known: float) -> list[SceneObject]:
    """The fruits of a scene, to be tracked from the first; ``known``: deviation of others [m]."""
    assumed = known**2 * np.eye(3)
    fruits = (item for item in scene.objects if item.role in ("target", "pushable"))
    return [o if o.covariance is not None else replace(o, covariance=assumed) for o in fruits]


def target_row(tracked: Tracked) -> int | None:
    """The row of the confirmed target; None: there is none."""
    for row, (role, sure) in enumerate(zip(tracked.roles, tracked.confirmed, strict=True)):
        if role == "target" and sure:
            return row
    return None


def outside(robot: Robot, q: FloatArray, tracked: Tracked) -> bool:
    """Whether the target is outside of the tool at ``q`` (n,), as far as the looks tell."""
    row = target_row(tracked)
    if robot.tool is None or row is None:
        return robot.tool is not None
    spread = float(np.sqrt(np.linalg.eigvalsh(tracked.covariance[row])[-1]))  # along any direction
    return not inside(robot, q, tracked.positions[row], spread)


def inside(robot: Robot, q: FloatArray, place: FloatArray, spread: float = 0.0) -> bool:
    """Whether a ``place`` (3,), known to ``spread`` [m], is in the mouth of the tool at ``q``."""
    if robot.tool is None:
        return False
    point, axis = robot.tool_pose(q)
    along = float((place - point) @ axis)
    aside = float(np.linalg.norm(place - point - along * axis))
    wide = max(robot.tool.mouth[1], 0.01) + spread  # as deep below the tool point, at most
    return aside <= wide and -wide <= along <= robot.tool.depth + spread


def untold(look: Look, base: Scene, reach: float) -> Look:
    """A look without what ``base`` says is there to be avoided, within ``reach`` [m]: it stands."""
    known = [item.position for item in base.objects if item.role == "avoid"]
    kept = tuple(
        item
        for item in look.detections
        if item.role != "avoid"
        or all(math.dist(look.camera @ item.position, place) > reach for place in known)
    )
    return look if len(kept) == len(look.detections) else replace(look, detections=kept)


MOUTH = np.array([0.6, 1.2, 1.8])  # heights below the rim of balls of one radius: a choice


def mouth_balls(robot: Robot, q: FloatArray, eye: FloatArray | None) -> FloatArray:
    """Balls (B, 4) that fill the mouth of the tool at ``q`` (n,): centres and radii [m].

    They hide what is inside from an ``eye`` (3,) beside the tool; none for one that looks out of
    the mouth, or that is not known.
    """
    tool, none = robot.tool, np.zeros((0, 4))
    if tool is None or tool.mouth[0] <= 0.0 or eye is None:
        return none
    point, axis = robot.tool_pose(q)
    if float(np.linalg.norm(np.cross(eye - point, axis))) < tool.mouth[0]:
        return none
    along = tool.depth - MOUTH * tool.mouth[0]
    return np.column_stack([point + along[:, None] * axis, np.full(len(MOUTH), tool.mouth[0])])


def unseen(tracked: Tracked, eye: FloatArray, since: float) -> dict[str, str | None]:
    """The confirmed fruits that no look has shown ``since`` a time [s], and what hides each.

    What hides a fruit is the track nearest to the ray to it from the ``eye`` (3,), where that track
    covers the ray; None: nothing that is tracked.
    """
    radii = np.array([shape.measure.bound for shape in tracked.shapes])
    out: dict[str, str | None] = {}
    for row in np.flatnonzero(tracked.confirmed & (tracked.last_seen < since)).tolist():
        way = tracked.positions[row] - eye
        far = float(np.linalg.norm(way))
        others = tracked.positions - eye
        along = others @ way / far
        aside = np.linalg.norm(others - along[:, None] * way / far, axis=1)
        covers = (aside < radii) & (along > 0.0) & (along < far - radii[row])
        covers[row] = False
        nearest = int(np.argmin(np.where(covers, aside, np.inf)))
        out[tracked.ids[row]] = tracked.ids[nearest] if covers.any() else None
    return out


def rests_known(tracked: Tracked, most: float) -> bool:
    """Whether the rest of every fruit in view is known to a standard deviation ``most`` [m]."""
    fresh = tracked.time - tracked.last_seen < 0.3  # [s] in view: a choice
    spread = np.linalg.eigvalsh(tracked.rest_covariance[fresh & tracked.confirmed])
    return bool(np.sqrt(spread.max(initial=0.0)) <= most)


def displaced(planned: Scene, tracked: Tracked) -> tuple[FloatArray, FloatArray, list[int]]:
    """The fruits of a plan's scene that are still tracked.

    Returns: Rest positions (F, 3) in the plan's scene [m], displacements (F, 3) of these fruits
    since [m], and the rows of their tracks.
    """
    before = {o.id: o.position for o in planned.objects if o.role in ("target", "pushable")}
    rows = [row for row, name in enumerate(tracked.ids) if name in before]
    places = np.array([before[tracked.ids[row]] for row in rows]).reshape(-1, 3)
    return places, tracked.rest[rows] - places, rows


def appeared(planned: Scene, tracked: Tracked) -> list[str]:
    """The confirmed fruits that a plan's scene does not have."""
    before = {item.id for item in planned.objects}
    sure = zip(tracked.ids, tracked.confirmed, strict=True)
    return [name for name, confirmed in sure if confirmed and name not in before]


def moved_by(planned: Scene, tracked: Tracked, apart: bool = False) -> float:
    """Largest motion of a fruit since a scene was planned in [m]; infinite for a new or lost fruit.

    ``apart``: against the mean of all.
    """
    fruits = {o.id for o in planned.objects if o.role in ("target", "pushable")}
    now = {name for name, sure in zip(tracked.ids, tracked.confirmed, strict=True) if sure}
    if appeared(planned, tracked) or fruits - now:
        return float(np.inf)
    _, by, _ = displaced(planned, tracked)
    by = by - by.mean(axis=0) if apart else by
    return float(np.linalg.norm(by, axis=1).max(initial=0.0))


def pushed_by(route: Route, phase: float) -> dict[str, FloatArray]:
    """Displacement (3,) of each fruit that the push of a route moves until ``phase`` [m], by id.

    A way out goes on with the push of the approach before it. None is moved before the approach,
    and while the tool surely touches nothing.
    """
    inward, until = route.came or (route, phase)
    model, times = inward.pushes, inward.trajectory.times
    rows = np.flatnonzero((times >= inward.approach) & (times <= until))
    if model is None or len(rows) < 2:
        return {}
    points, axes = inward.points[rows], inward.axes[rows]
    if route.came is not None:
        out = route.trajectory.times <= phase
        points, axes = np.vstack([points, route.points[out]]), np.vstack([axes, route.axes[out]])
    motion = spaced(points, axes)
    if model.clear(*motion):
        return {}
    found = model.moved(*motion)
    places = {item.id: item.position for item in route.scene.objects}
    pushed = {
        name: position - places[name]
        for name, position in zip(found.ids, found.positions, strict=True)
        if name in places
    }
    return {name: by for name, by in pushed.items() if float(np.linalg.norm(by)) > MOVED}


AHEAD = np.array([0.1, 0.3, 0.6, 1.0])  # [s] at which the plant's motion is compared: a choice


class Driver:
    """Keeps the course of the arm, and moves routes with the plant.

    Attributes:
        course: that runs; None: the arm has not moved.
        route: that the course follows, or that the arm waits for; unset before the first.
        still: the scene of what stands still; its goal is the begin.
        held: whether the target moves with the tool.
    """

    def __init__(
        self, scene: Scene, robot: Robot, state: State, parameters: LoopParameters
    ) -> None:
        self.still = without_fruits(scene, state.q)
        self.robot, self._rest, self._parameters = robot, State(state.q), parameters
        self.course: Course | None = None
        self.route: Route
        self.held = False
        self._offset: FloatArray | None = None  # (1, 3) of the plant when the target was taken [m]
        self._shift = np.zeros((0, 3))
        self._followed = 0.0

    def stands(self, scene: Scene) -> None:
        """Take over what stands still in a scene."""
        self.still = replace(self.still, objects=without_fruits(scene).objects)

    def stands_at(self, q: FloatArray, begins: float | None = None) -> None:
        """Note where an arm that has not moved yet stands, ``q`` (n,).

        ``begins``: also of an arm that has, which from this time on waits there in its route [s].
        """
        if self.course is None:
            self._rest = State(q)
        elif begins is not None:
            phase = self.phase(begins)
            self.course = Course(self._standing(q), begins, phase, math.inf)

    def state(self, time: float) -> State:
        """Commanded state at a ``time`` [s]."""
        return self._rest if self.course is None else self.course.at(time)

    def rests(self, time: float) -> bool:
        """Whether the course has come to its end."""
        return self.course is None or self.course.ended(time)

    def phase(self, time: float) -> float:
        """Time in the route at a ``time`` [s]."""
        return 0.0 if self.course is None else self.course.phase_at(time)

    @property
    def waits(self) -> bool:
        """Whether the arm comes to rest, or stands, beside its route."""
        return self.course is not None and math.isinf(self.course.rate)

    def stuck(self, now: float) -> bool:
        """Whether the arm waits, and for long nothing has led onto its route."""
        return self.waits and now - self._followed > self._parameters.stuck

    def stand(self, begins: float) -> Stretch:
        """The curve of an arm that stands."""
        return Stretch(self._standing(self.state(begins).q), begins)

    def _standing(self, q: FloatArray) -> Trajectory:
        return Trajectory.still(q, (0.0, self._parameters.tail), self.robot.joint_names)

    def halt(self, now: float) -> Stretch | None:
        """Come to rest at once, and wait there for as long as this is asked; None: it does."""
        self._followed = now
        return None if self.waits or self.rests(now) else self.brake(now + self._parameters.lead)

    def brake(self, begins: float, state: State | None = None) -> Course:
        """The curve that comes to rest at once; the arm then waits where it is in its route.

        ``state``: to begin in; None: that of the course.
        """
        curve = stopped(self.robot, state or self.state(begins))
        self.course = Course(curve, begins, self.phase(begins), math.inf)
        self._followed = begins
        return self.course

    def set_out(self, route: Route, now: float, tracked: Tracked) -> Stretch:
        """Begin a route; where nothing leads onto it yet, come to rest and wait."""
        self.route = route
        taken = self.take(route, 0.0, now, tracked)
        if taken is None:
            self.course = taken = replace(self.brake(now + self._parameters.lead), phase=0.0)
            self._followed = now
        return taken

    def take(self, route: Route, phase: float, now: float, tracked: Tracked) -> Stretch | None:
        """Follow a route from ``phase`` [s] on; None: nothing leads onto it, the course goes on."""
        begins, field = now + self._parameters.lead, self._field(route, tracked)
        course = follow(route, phase, self.state(begins), begins, field, self._parameters)
        if course is None or not self.safe(course.curve):
            return None
        self._shift = _ahead(route, phase, begins, field)
        self.course, self.route, self._followed = course, route, now
        return course

    def hold(self, now: float, tracked: Tracked) -> None:
        """From now on the target moves with the tool, and the common sway of the plant counts.

        What is seen of fruits that the tool presses is its own motion: a way out that follows them
        follows itself.
        """
        route, self.held = self.route, True
        places, moved, _ = displaced(route.scene, tracked)
        rest = Displacement(places, lambda times: moved[None], self._parameters.field)
        self._offset = rest.at(route.points[-1:], np.zeros(1))

    def _field(self, route: Route, tracked: Tracked) -> Displacement:
        if (offset := self._offset) is not None:
            return Displacement(offset, lambda times: (offset + tracked.sway(times))[:, None])
        places, moved, rows = displaced(route.scene, tracked)
        length = self._parameters.field
        return Displacement(places, lambda times: moved + tracked.moves(times)[:, rows], length)

    def go_on(self, now: float, tracked: Tracked) -> Stretch | None:
        """Follow the route where the plant is now; None: the course goes on as it is."""
        route, begins = self.route, now + self._parameters.lead
        phase = self.phase(begins)
        if not self.waits and phase < route.duration:
            shift = _ahead(route, phase, begins, self._field(route, tracked))
            if np.abs(shift - self._shift).max() < self._parameters.still:
                return None
        return self.take(route, phase, now, tracked)

    def clear(self, tracked: Tracked, names: Collection[str]) -> bool:
        """Whether the course touches none of the tracked fruits of some ``names``."""
        seen = [item for item in tracked.objects() if item.id in names]
        solid = tuple(replace(item, role="static", stem=None, covariance=None) for item in seen)
        scene, course = replace(self.still, objects=(*self.still.objects, *solid)), self.course
        assert course is not None
        found = judging.judge(scene, self.robot, course.curve, course.curve.at(0.0), begun=True)
        return not any(contact.other in names for contact in found.contacts)

    def safe(self, curve: Trajectory) -> bool:
        """Whether a curve keeps the limits and touches nothing that stands, by the judge."""
        found = judging.judge(self.still, self.robot, curve, curve.at(0.0), begun=True)
        return all(v.kind in ("goal", "start", "motion") for v in found.violations)


def without_fruits(scene: Scene, q: FloatArray | None = None) -> Scene:
    """The scene with robot and what stands still, and no fruits.

    Args:
        scene: with fruits, or without.
        q: (n,) its goal; None: its start.
    """
    still = tuple(item for item in scene.objects if item.role in ("static", "avoid"))
    rest = JointGoal(posed(scene)[1].q if q is None else q)
    return replace(scene, objects=still, goal=rest, waypoints=None, place=None)


def _ahead(route: Route, phase: float, begins: float, field: Displacement) -> FloatArray:
    """Displacements (4, 3) of the next points of a route [m]."""
    times = np.clip(phase + AHEAD, 0.0, route.duration)
    row = np.searchsorted(route.trajectory.times, times).clip(max=len(route.points) - 1)
    shift = field.at(route.points[row], begins + np.maximum(times - phase, 0.0))
    return route.weight[row, None] * shift


def path_back(robot: Robot, q: FloatArray, speed: float) -> Trajectory:
    """The trajectory through configurations ``q`` (k, n) at a ``speed`` of the tool [m/s]."""
    points, _ = robot.tool_pose(q)
    gone = np.append(0.0, np.cumsum(lengths(np.diff(points, axis=0)))) + 1e-6 * np.arange(len(q))
    count = max(math.ceil(gone[-1] / 0.01), 4)  # [m] between waypoints
    at = np.linspace(0.0, gone[-1], count + 1)
    even = np.stack([np.interp(at, gone, joint) for joint in q.T], axis=1)
    widths = np.full(count, max(gone[-1], 0.01) / count / speed)
    widths[[0, -1]] *= 2.0  # it begins and ends at rest
    back = Trajectory.through(even, np.append(0.0, np.cumsum(widths)), robot.joint_names)
    return back.slowed(max(float(needs(robot, back).max()), 1.0))


TURNS = 8  # parts of a turn, each at most 7 degrees: inverse kinematics stays on its branch
MISS = 1e-6  # [m] error above which a configuration is none: a choice


def views(robot: Robot, q: FloatArray, parameters: LoopParameters) -> list[FloatArray]:
    """Configurations (n,) from which a camera on the tool sees what it does not see from ``q``.

    The tool point stays. The tool axis turns by each of ``parameters.views`` [degrees], to four
    sides each; what the arm does not reach is left out.
    """
    point, axis = robot.tool_pose(q)
    across = frame_along(axis)[:, :2].T
    found = []
    for angle in parameters.views:
        for side in (across[0], across[1], -across[0], -across[1]):
            part = np.linspace(0.0, math.radians(angle), TURNS + 1)[1:]
            axes = np.array([rotation(side, one) @ axis for one in part])
            path, errors = ik.track(robot, np.tile(point, (TURNS, 1)), axes, q)
            if errors.max() <= MISS:
                found.append(path[-1])
    return found
