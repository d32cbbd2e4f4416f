"""The guard: the action nearest to the wish that keeps all limits and harms nothing.

A wish is executed for one control period and then followed by a braking curve. It passes only if
the judge's code finds that whole motion within all limits and free of contacts, and the push model
predicts no harm on the way that the wish leads to and on the way out again. Where no action near
the wish passes, the arm goes on along the braking curve that passed one period before. So limits
and static objects hold by induction; harm is a prediction.
"""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry import distances
from optipromp.core.judging import Overlap, clearances, extremes, refined, swept
from optipromp.core.judging.speed import among_fruits, largest_speed
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.task import resolve, spaced
from optipromp.core.pushing.model import PushModel
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.pushing.path import STEP
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, Trajectory
from optipromp.core.values import array
from optipromp_loop.control.parameters import CONTROL
from optipromp_loop.control.plant import first_tracks, tracked_at_most
from optipromp_loop.control.solids import Solids
from optipromp_loop.control.tracker import Tracker
from optipromp_loop.control.tracks import TrackerParameters
from optipromp_loop.guard.motion import (
    ROUNDING,
    Change,
    Limits,
    fastest,
    joints_for,
    later,
    nearest,
    sampled,
    stopping,
)
from optipromp_loop.guard.plant import Course, Plant, Room, least, seen_scene, stays, unchanged
from optipromp_loop.guard.takeover import Takeover

T = TypeVar("T")
Kind = Literal["limits", "contact", "speed", "harm"]
Mover = Literal["policy", "guard", "loop"]
NEARLY = {"clearance_static": "what stands", "clearance_self": "another link"}
NEARLY |= dict.fromkeys(("clearance_avoid", "clearance_avoid_tool"), "what is to be avoided")
FASTER = 1.05  # times the speed among fruits; the judge allows 1.1 of it: a choice
SHARE = 0.9  # of a limit, in a wish that is to pass: a choice
LOOKS = 7  # poses of the tool in a prediction, 5 mm apart at the speed of a push: a choice
ASIDE = 0.002  # [m] of a fruit that the tool has pushed aside: a choice, as of what moved
OUT = 2.0  # times the harm that may be, on the way in and out again: an emergency, a choice
OUT_STATES = 4  # of the plant on the way out: a choice
# of the harm that may be, so that in no sample a fruit is swallowed: of a wish after one that was
SURE = 0.5  # refused, and where the loop takes over, which does better; a choice
HOPELESS = 10.0  # times the harm that may be: all larger harm is alike
EVERY = PUSH.hanging.every  # points of a motion in a step of the model
BEFORE = 40  # poses of the way here before the fruits, on which the loop leaves them: a choice
REST = 1e-3  # [rad/s or m/s] of an arm that stands: a choice
TRAIL = 400  # poses of the way here, each at least STEP apart, that are remembered: a choice


@dataclass(frozen=True)
class GuardParameters(Checked):
    """Timing, distances and risk of the guard."""

    period: float = parameter(0.02, "s", "choice", "of an action: 50 Hz")
    ahead: float = parameter(0.3, "s", "choice", "of a wish in a prediction, then the way back")
    margin: float = parameter(
        0.002, "m", "measured", "an arm in the simulation is 1 mm off its way"
    )
    risk: float = parameter(
        0.02, "1", "measured", "a fruit may be swallowed in one of 16 states; with 0.03 in three"
    )
    states: int = parameter(16, "1", "choice", "of the plant in a prediction; plans use 24 or 32")
    out: float = parameter(0.05, "m", "choice", "of the way back that must stay open")
    tries: int = parameter(3, "1", "choice", "actions near a wish; each takes 0.5 to 1 ms")
    near: float = parameter(0.1, "m", "choice", "distance from which on a barrier counts")
    rate: float = parameter(5.0, "1/s", "choice", "share of a distance that an action may use up")
    rows: int = parameter(16, "1", "choice", "nearest pairs of bodies that are barriers")
    off: float = parameter(0.1, "rad or m", "choice", "of a joint: beyond, the curve begins anew")
    changed: float = parameter(0.002, "m", "choice", "motion of a fruit that changes the scene")
    known: float = parameter(0.003, "m", "choice", "deviation of a fruit that states none")
    stood: float = parameter(1.0, "s", "choice", "of a policy held up, then the loop takes over")
    takeovers: int = parameter(3, "1", "choice", "by a loop that gave up each time")


class Refusal(NamedTuple):
    """Why an action does not pass."""

    kind: Kind
    words: str
    joints: BoolArray | None = None  # (n,) whose limits are at stake


@dataclass(frozen=True, eq=False)
class Safe:
    """The action that the guard gives.

    Attributes:
        velocity: (n,) of the joints at the end of the period [rad/s or m/s].
        reference: state at the end of the period.
        curve: the motion: its second row is ``reference``, from where on all joints brake to a
            stop. An arm that hears nothing more follows it to its end.
        acted: whether the wish was not executed as it was.
        braked: whether no action near the wish passed.
        reason: why the wish did not pass; empty: it did.
        probability: of harm, where the prediction of this action met fruits; else 0.
        mover: who moves the arm: the ``policy`` as it wished; the ``guard`` otherwise than it
            wished; the ``loop`` by its own pick, whose curve does not brake after the period, but
            ends at rest.
        holding: whether the loop leaves with the target, or has left: a gripper may close.
    """

    velocity: FloatArray
    reference: State
    curve: Trajectory
    acted: bool
    braked: bool
    reason: str
    probability: float
    mover: Mover
    holding: bool = False


def velocities(name: str, values: ArrayLike, size: int) -> FloatArray:
    """The ``values`` (size,) of a caller, finite or not; ``name`` begins the error."""
    try:
        out = np.array(values, dtype=np.float64)
        told = f"has shape {out.shape}"
    except (TypeError, ValueError):
        out, told = np.zeros(0), f"is {values!r:.60}"
    if out.shape != (size,):
        raise InvalidRequestError(f"{name} {told}: must be ({size},), velocities")
    return out


def typed(name: str, value: T, kind: type) -> T:
    """A ``value`` of a caller that is of a ``kind``; ``name`` begins the error."""
    if not isinstance(value, kind):
        raise InvalidRequestError(f"{name} is {value!r:.60}: must be of {kind.__name__}")
    return value


class Guard:
    """Filters the actions of any policy.

    Args:
        scene: with robot, tool, static objects and fruits. What it does not have is not guarded.
        robot: with its tool; None: the scene's.
        parameters: see :class:`GuardParameters`.
        takes_over: whether the closed loop takes the arm, and picks the scene's target, where the
            guard has held the policy up for ``parameters.stood``, or would brake before harm to
            fruits. It needs looks, and the time of each call. Once the tool is out again the policy
            has the arm.
    """

    def __init__(
        self,
        scene: Scene,
        robot: Robot | None = None,
        *,
        parameters: GuardParameters | None = None,
        takes_over: bool = False,
    ) -> None:
        if moving := [item.id for item, _ in scene.movers if item.role != "pushable"]:
            told = "what moves is not guarded against; leave the motion out"
            raise InvalidRequestError(f"{', '.join(moving)} move: {told}")
        self.parameters = GuardParameters() if parameters is None else parameters
        self._base = Solids(tracked_at_most(scene, TrackerParameters.most))
        self._tracker: Tracker | None = None  # made when the first look comes
        self._takeover = Takeover(self.parameters.period) if takes_over else None
        self._curve: Trajectory | None = None
        self._trail = np.zeros((0, 6))  # tool points and axes on the way here, oldest first
        self._stays: float | None = None  # share of harm of a stop here; None: not known
        self._pushing = 0  # rows at the end of the trail since which the tool may touch fruits
        self._last = self._trail  # (k, 6) poses since the last step of the push that is kept
        task = resolve(self._base.scene, robot)
        spheres = task.robot.spheres
        of_tool = spheres.distal & (spheres.link >= task.robot.n_own_links)
        self._body = replace(task.robot, spheres=spheres._replace(distal=of_tool))
        """The robot whose tool alone may touch fruits and stems, for :meth:`_by_wrist`."""
        self._refused = False  # whether harm was predicted since the tool was clear of fruits
        self._room, self._courses = Room({}, {}), tuple[Course, ...]()
        self._place(Plant.of(task, self.parameters.risk))

    @property
    def robot(self) -> Robot:
        """With its tool."""
        return self._plant.task.robot

    @property
    def scene(self) -> Scene:
        """As it is known now."""
        return self._plant.task.scene

    @property
    def time(self) -> float:
        """Of the newest look [s]; minus infinity before the first."""
        return -math.inf if self._tracker is None else self._tracker.time

    @property
    def _wrist(self) -> frozenset[str]:
        """The links behind the tool that may touch fruits which the tool has pushed aside."""
        spheres = self.robot.spheres
        links = np.unique(spheres.link[spheres.distal & ~self._body.spheres.distal])
        return frozenset(self.robot.link_names[link] for link in links)

    @property
    def leads(self) -> bool:
        """Whether the loop has the arm, and not the policy."""
        return self._takeover is not None and self._takeover.controller is not None

    def __call__(
        self,
        action: FloatArray,
        state: State,
        looks: Iterable[Look] = (),
        time: float | None = None,
    ) -> Safe:
        """The action nearest to a policy's that keeps all limits and harms nothing.

        Args:
            action: (n,) velocities of the joints, to be reached within a period [rad/s or m/s]. One
                that is not finite counts as 0.
            state: of the joints, as measured or commanded.
            looks: that came since the last call, by the clock of ``time``.
            time: now [s]; None: that of the newest look. A guard that takes over needs it.

        Raises:
            InvalidRequestError: an action or a state of another size or type, looks that are none,
                or a time that is not finite, or that a guard needs which takes over.
        """
        wish = velocities("action", action, self.robot.n_joints)
        now = None if time is None else float(array("time", time))
        typed("looks", looks, Iterable)
        come, loop = [typed("a look", look, Look) for look in looks], self._takeover
        own = self._own(state)
        if loop is not None and now is None:
            raise InvalidRequestError("time is None: a guard that takes over needs it")
        if loop is not None and now is not None and not loop.ended(now):
            self._see(come, now, own.q)
            return self._led(*loop.cycle(now, own, come))
        begin = self._anchored(own)
        self._see(come, now, own.q)
        safe, told = self._decided(wish, begin)
        if loop is not None and now is not None:
            stood = loop.stood(now, safe.acted and bool(np.abs(safe.velocity).max() < REST))
            harms = safe.braked and told is not None and told.kind == "harm"
            if harms or stood >= self.parameters.stood:
                self._hand_over(loop, now, safe.reason)
        return safe

    def feel(self, time: float, force: FloatArray) -> None:
        """Take a measured force in, for a loop that has the arm; see :meth:`.Controller.feel`."""
        loop = None if self._takeover is None else self._takeover.controller
        if loop is not None:
            loop.feel(time, force)

    def _decided(self, wish: FloatArray, begin: State) -> tuple[Safe, Refusal | None]:
        """The action nearest to a wish, and why the last that was tried does not pass."""
        whole = bool(np.isfinite(wish).all())
        first: Refusal | None = None if whole else Refusal("limits", "the action is not finite")
        wish, asked = wish if whole else np.zeros_like(wish), wish
        waiting, tries = [np.clip(wish, *self._box(begin.q))], self.parameters.tries
        told: Refusal | None = None
        while waiting and tries > 0:
            wanted, tries = waiting.pop(0), tries - 1
            step = Change.of(self.robot, begin, wanted, self.parameters.period)
            curve = stopping(self.robot, step, self.parameters.period)
            told = self._refusal(curve)
            probability = 0.0
            if told is None:
                told, probability = self._predicted(step)
            if told is None:
                if first is None and (np.abs(wanted - asked) > 1e-9).any():
                    joint = self.robot.joint_names[int(np.argmax(np.abs(wanted - asked)))]
                    first = Refusal("limits", f"{joint} would pass its limit of velocity or range")
                return self._given(curve, first, probability), None
            if first is None:
                first = told
            if told.kind == "harm":  # what nobody wished may harm where the wish did not
                break
            waiting += self._instead(told, begin.q, wanted)
        if self._curve is None:  # nothing passed before: brake from here
            still = Change.of(self.robot, begin, np.zeros_like(wish), self.parameters.period)
            self._curve = stopping(self.robot, still, self.parameters.period)
        return self._given(self._curve, first, 0.0, braked=True), told

    def _hand_over(self, loop: Takeover, now: float, why: str) -> None:
        """Let the loop have the arm from the end of the period on, if it sees a target."""
        blind, curve = now - self.time > CONTROL.look_age or self.scene.target is None, self._curve
        if blind or curve is None or loop.gone >= self.parameters.takeovers:
            return
        end = np.concatenate(self.robot.tool_pose(curve.positions[-1]))
        among = self._pushing or not self._clear(end[None])
        way = self._trail[-self._pushing - BEFORE :] if among else self._trail[:0]
        begins, pushes = now + self.parameters.period, next(iter(self._plant.hanging), None)
        loop.begin(self.scene, self.robot, begins, curve, way, pushes, why)

    def _led(self, curve: Trajectory, words: str, probability: float) -> Safe:
        """The action of the loop."""
        return replace(self._given(curve, Refusal("harm", words), probability), mover="loop")

    def blind(self, reason: str) -> Safe | None:
        """The action of a period in which nothing can be decided, as without a state of the arm.

        The arm goes on along the braking curve that passed last; at its end it stands. None:
        nothing was given before, so the arm is not known to move. ``reason``: of :class:`Safe`.
        """
        if self._takeover is not None and self.leads:
            return self._led(*self._takeover.hold(reason))
        if self._curve is None:
            return None
        return self._given(self._curve, Refusal("limits", reason), 0.0, braked=True)

    def tool(self, linear: FloatArray, state: State, axis: FloatArray | None = None) -> FloatArray:
        """The action (n,) of a velocity of the tool point; see :func:`.motion.joints_for`."""
        axis = None if axis is None else array("axis", axis, 3)
        return joints_for(self.robot, self._own(state).q, velocities("linear", linear, 3), axis)

    # -- the state of the arm

    def _own(self, state: State) -> State:
        """A state, if it is of this arm."""
        if typed("state", state, State).q.shape != self.robot.home.shape:
            raise InvalidRequestError(
                f"state has {state.q.size} joints; {self.robot.name} has {self.robot.n_joints}"
            )
        return state

    def _anchored(self, state: State) -> State:
        """The state that the next period begins in: on the curve, if the arm follows it."""
        if self._curve is not None:
            begin = State(*(row[0] for row in self._curve.rows()))
            state = replace(state, q=self.robot.turns.onto(state.q, begin.q))
            if np.abs(begin.q - state.q).max() <= self.parameters.off:
                return begin
        self._curve, robot = None, self.robot
        lower, upper = np.minimum(robot.lower, state.q), np.maximum(robot.upper, state.q)
        sizes = np.abs([state.velocity, state.acceleration])
        rates = [*np.maximum(sizes, [robot.velocity, robot.acceleration]), robot.jerk]
        self._limits = Limits(lower, upper, np.stack(rates))
        self._walk(np.concatenate(robot.tool_pose(state.q)))
        self._measure(state.q)
        return state

    def _given(
        self, curve: Trajectory, refusal: Refusal | None, probability: float, braked: bool = False
    ) -> Safe:
        """Hand an action out, and remember where it leads to."""
        p = self.parameters
        reference = State(*(row[1] for row in curve.rows()))
        self._curve = later(curve, p.period)
        pose = np.concatenate(self.robot.tool_pose(reference.q))
        if np.linalg.norm(pose[:3] - self._trail[-1, :3]) > STEP:
            self._walk(pose)
        words = "" if refusal is None else refusal.words
        holding = self._takeover is not None and self._takeover.holding
        return Safe(
            reference.velocity, reference, curve, bool(words), braked, words, probability,
            "guard" if words else "policy", holding,
        )  # fmt: skip

    def _walk(self, pose: FloatArray) -> None:
        """Remember where the tool is, and whether it may touch fruits there."""
        self._trail, self._stays = np.vstack([self._trail[-TRAIL:], pose]), None
        free = self._clear(pose[None])
        if not (self._pushing or not free):
            return
        if not self._pushing:
            self._last, self._courses = self._trail[-2:-1], self._plant.fresh
        self._pushing = min(self._pushing + 1, len(self._trail))
        self._last = sampled(np.vstack([self._last, pose]))
        whole = (len(self._last) - 2) // EVERY * EVERY  # the last point may be a part of a step
        if whole > 0:
            way, states = self._last[: whole + 1], self.parameters.states
            self._courses = tuple(one.on(way, states) for one in self._courses)
            self._last = self._last[whole:]
        if free and not self._aside():
            self._pushing = 0

    # -- the plant

    def _place(self, plant: Plant) -> None:
        """Take over a plant, as it is known now."""
        self._plant, self._stays = plant, None
        if not self._pushing:
            self._courses = plant.fresh
        if self._curve is not None:
            self._measure(self._curve.positions[0])

    def _measure(self, q: FloatArray) -> None:
        """How near to objects the arm is, and what it touches: it may stay, not go deeper."""
        found, contacts = clearances(self._plant.judged, self.robot, q[None])
        contacts, before = [*contacts, *self._by_wrist(q[None])], self._room
        touched = {c.other: -least(-c.depth, before.touched.get(c.other)) for c in contacts}
        self._room = Room(
            touched,
            {
                name: min(self.parameters.margin, least(value, before.clear.get(name)))
                for name in NEARLY
                if (value := found[name]) is not None
            },
        )

    def _see(self, come: Sequence[Look], time: float | None, q: FloatArray) -> None:
        """Fold looks in, made with the arm at ``q`` (n,). While the tool pushes, the pushed fruits
        stay where the models lead."""
        p = self.parameters
        if not come:
            return
        if self._tracker is None:
            told = self._base.told
            self._tracker = Tracker(told, first=first_tracks(told, p.known))
        for look in come:
            self._tracker.add(look, self._pushed())
            among = bool(self._pushing)
            self._base = self._base.after(look, self._tracker, self.robot, q, among=among)
        seen = self._tracker.at(self.time if time is None else time)
        own, added = self._plant.pushed if self._pushing else frozenset[str](), self._plant.added
        if (self._pushing or not added) and unchanged(
            self._base.scene, self.scene, seen, p.changed, own
        ):
            return
        scene = seen_scene(self._base.scene, self.scene, seen, p.changed)
        during = self._plant.during_push(scene) if self._pushing else None
        scene = scene if during is None else during.task.scene
        before = {item.id: item for item in self.scene.objects}
        same = before.keys() == {item.id for item in scene.objects} and all(
            stays(item, before[item.id], p.changed) for item in scene.objects
        )
        if not same or (self._plant.added and not self._pushing):
            self._place(during or Plant.of(resolve(scene, self.robot), p.risk))

    def _pushed(self) -> dict[str, FloatArray]:
        """Displacement (3,) of each fruit by the tool now, as the push models predict [m]."""
        out: dict[str, FloatArray] = {}
        if self._pushing:
            places = {item.id: item.position for item in self.scene.objects}
            moved = [one.seen.moved(*np.split(self._last, 2, axis=1)) for one in self._courses]
            if self._plant.standing:
                way = spaced(*np.split(self._trail[-self._pushing - 1 :], 2, axis=1))
                moved += [model.moved(*way) for model in self._plant.standing]
            for one in moved:
                pairs = zip(one.ids, one.positions, strict=True)
                out |= {name: place - places[name] for name, place in pairs}
        return out

    def _aside(self) -> frozenset[str]:
        """The fruits that the tool has pushed aside, or holds aside."""
        return frozenset(k for k, by in self._pushed().items() if math.hypot(*by) > ASIDE)

    # -- judging an action

    def _refusal(self, curve: Trajectory) -> Refusal | None:
        """Why a motion must not be executed, by the judge's code; None: it may."""
        robot, most = self.robot, extremes(curve)
        lower, upper, rates = self._limits
        out = np.stack([lower - most.lowest, most.highest - upper]) > ROUNDING
        broken = np.vstack([out, most.largest > rates * (1.0 + ROUNDING)])
        if broken.any():
            row, joint = np.argwhere(broken)[0]
            what = ("range", "range", "limit of velocity", "limit of acceleration", "limit of jerk")
            words = f"{robot.joint_names[joint]} would leave its {what[row]}"
            return Refusal("limits", words, np.asarray(broken.any(axis=0)))
        times, q, _, complete = refined(robot, curve)
        found, contacts, _, _ = swept(self._plant.judged, robot, q, times)
        if not complete:
            return Refusal("contact", "the motion is too fast to be checked for contacts")
        if self._wrist and self._plant.models:
            contacts = [*contacts, *self._by_wrist(q, times)]
        for one in contacts:
            if one.depth > self._room.touched.get(one.other, 0.0):
                return Refusal("contact", f"{one.link} would touch {one.other}")
        for name, room in self._room.clear.items():
            value = found[name]
            if value is not None and value < room:
                return Refusal("contact", f"{NEARLY[name]} would be {1e3 * value:.1f} mm away")
        steps = curve.resample(1.0 / self.parameters.period)  # as it is executed, row by row
        poses = robot.tool_pose(steps.positions)
        fast = among_fruits(self._plant.judged, robot, steps, np.arange(steps.n_waypoints), *poses)
        if fast is not None and fast[0] > FASTER * largest_speed(self._plant.judged):
            return Refusal("speed", f"the tool would move at {fast[0]:.2f} m/s among fruits")
        return None

    def _by_wrist(self, q: FloatArray, times: FloatArray | None = None) -> list[Overlap]:
        """Contacts of links behind the tool with fruits and stems, at ``q`` (m, n).

        These may pass where a fruit hung that the tool has pushed aside.
        """
        _, contacts, _, _ = swept(self._plant.judged, self._body, q, times)
        fruits = [c for c in contacts if c.link in self._wrist and c.role in ("pushable", "target")]
        aside = self._aside() if fruits else frozenset()
        return [c for c in fruits if c.other.removeprefix("the stem of ") not in aside]

    def _predicted(self, step: Change) -> tuple[Refusal | None, float]:
        """Why a wish that is followed for a while would harm; the probability of harm."""
        if not self._plant.models:
            return None, 0.0
        times = np.linspace(0.0, self.parameters.ahead, LOOKS)
        ahead = np.hstack(self.robot.tool_pose(step.at(times)[0]))
        if not self._pushing and self._clear(np.vstack([self._trail[-1:], ahead])):
            self._refused = False
            return None, 0.0
        most = SURE if self._refused or self._takeover is not None else 1.0
        share, probability = self._share(ahead, most)
        if share <= most:
            if self._share(ahead, OUT * most, out=True)[0] <= OUT * most:
                return None, probability
            self._refused = True
            return Refusal("harm", "harm is predicted on the way out from there"), probability
        if self._pushing and not step.begin.moving:  # it may go on if it adds nothing to a harm
            if self._stays is None:
                self._stays = self._share(ahead[:1], HOPELESS)[0]
            stays = self._stays
            if stays > 1.0 and self._share(ahead, stays)[0] <= stays:
                return None, probability
        self._refused = True
        return Refusal("harm", "harm is predicted"), probability

    def _share(self, ahead: FloatArray, limit: float, out: bool = False) -> tuple[float, float]:
        """Predicted harm over what may be, and the probability of harm.

        The tool goes on through ``ahead`` (k, 6); if ``out``, then back along its way. A share
        above ``limit`` may be any number above it.
        """
        p, way = self.parameters, self._last if self._pushing else self._trail[-1:]
        points = sampled(np.vstack([way, ahead]))
        first, share, probability = len(points) - 1, 0.0, 0.0
        if out:
            came = np.vstack([self._trail, ahead])
            gone = np.append(0.0, np.cumsum(lengths(np.diff(came[::-1, :3], axis=0))))
            back = came[::-1][: int(np.searchsorted(gone, p.out)) + 1]
            points = np.concatenate([points, sampled(back)[1:]])
        places, axes = np.split(points, 2, axis=1)
        harms: list[tuple[PushModel, float]] = []
        for one in self._courses if self._pushing else self._plant.fresh:
            states = min(OUT_STATES, p.states) if out else p.states
            going, most = one.going.leaving(first), one.going.threshold * limit
            harms.append((going, going.harm(places, axes, states, most)))
        for model in () if out else self._plant.standing:  # what stands does not come back
            way = np.vstack([self._trail[-self._pushing - 1 :], ahead])
            places, axes = spaced(*np.split(way, 2, axis=1))
            states = min(p.states, model.states)
            harms.append((model, model.harm(places, axes, states, model.threshold * limit)))
        for model, harm in harms:
            share += harm / model.threshold
            if model.calibration is not None:
                probability = max(probability, model.calibration.probability(harm))
        return share, probability

    def _clear(self, poses: FloatArray) -> bool:
        """Whether the tool, led through poses (k, 6), surely touches no fruit."""
        parts = np.split(poses, 2, axis=1)
        way = spaced(*parts) if len(poses) > 1 else tuple(parts)
        return all(model.clear(*way) for model in self._plant.models)

    # -- actions near a wish

    def _box(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Velocities (n,) from which each joint alone can stop within its range."""
        robot = self.robot
        limits = SHARE * robot.acceleration, SHARE * robot.jerk
        up, down = (
            fastest(room, *limits) for room in (self._limits.upper - q, q - self._limits.lower)
        )
        return -np.minimum(down, robot.velocity), np.minimum(up, robot.velocity)

    def _instead(self, told: Refusal, q: FloatArray, wanted: FloatArray) -> Iterator[FloatArray]:
        """Actions to try in place of one that did not pass."""
        along = self.robot.tool_jacobian(q)[0]
        tool = along @ wanted
        speed = float(np.linalg.norm(tool))
        if told.kind == "speed" and speed > 0.0:
            yield wanted * min(SHARE * largest_speed(self.scene) / speed, 0.5)
            return
        if told.kind == "contact":
            rows, least = self._barriers(q)
            beside = nearest(wanted, rows, least) if len(rows) else None
            if beside is not None:
                yield np.clip(beside, *self._box(q))
        if told.joints is not None:
            wanted = np.where(told.joints, 0.0, 2.0 * wanted)
        yield 0.5 * wanted

    def _barriers(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slopes (R, n) of the nearest distances, and the least rates of change (R,) of these."""
        p, width = self.parameters, 1e-5  # [rad or m] of the differences
        rooms = self._distances(np.vstack([q, q + width * np.eye(len(q))]))
        near = np.argsort(rooms[0], kind="stable")[: p.rows]
        near = near[rooms[0, near] < p.near]
        slopes = (rooms[1:, near] - rooms[0, near]).T / width
        low, high = self._box(q)
        box = np.vstack([np.eye(len(q)), -np.eye(len(q))])
        least = -p.rate * (rooms[0, near] - p.margin)
        return np.vstack([slopes, box]), np.concatenate([least, low, -high])

    def _distances(self, q: FloatArray) -> FloatArray:
        """Distances (m, R) of the body at ``q`` (m, n) from objects, and of its links [m]."""
        around, body = self._plant.around, self._body.spheres
        spheres, out = self.robot.sphere_centers(q), [self.robot.self_gaps(q)]
        for objects, which in ((around.static, slice(None)), (around.dynamic, ~body.distal)):
            if len(objects.kind):
                some = spheres[:, which]
                apart, _ = distances(objects, some.reshape(-1, 3))
                out.append(apart.min(axis=1).reshape(len(q), -1) - body.radius[which])
        return np.hstack(out)
