"""The judgement of a run, from the simulation alone.

Harm of fruits is by the laws of a crop (:mod:`optipromp.core.scenes.crops`):

- A blow: the work of the contact's normal force while the contact closes, without a pause [J]. It
  is the energy that the flesh takes up; of a fruit that falls, its kinetic energy.
- Pressing: the force that lasts, the contact's force F through a first-order lag,
  :math:`T y' = F - y`, as flesh creeps [N].
- An edge: the normal force of the contact points on the rim of a cup, finger tips or blades [N].
- Abscission: the stem's force on the fruit over the one that detaches it at its angle to the stem,
  and the bending moment at the calyx over that which detaches it.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import StrEnum
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, IntArray, lengths
from optipromp.core.robots.tools import WALL
from optipromp.core.scenes.crops import Crop, detaching
from optipromp_sim.simulation.contacts import ContactLog, in_tool, pressing
from optipromp_sim.simulation.grasps import on_lip, scissor_of, suction_of, wanted
from optipromp_sim.simulation.records import Rollout, StemCut
from optipromp_sim.simulation.world import Fruit, World

BEARABLE = "impact_energy", "pressed_force", "edge_force"
"""Rows of a crop that limit what a fruit bears in its contacts."""
DETACHING = "abscission", "abscission_moment"
"""Rows that limit the load of a stem; the figure of the first is the pull along the stem that is as
near to detaching as the true one [N]."""


class HarmLog(ContactLog):
    """Contacts, and the figures of a run that the rows of a ``crop`` limit, step by step."""

    def __init__(self, world: World, threshold: float, crop: Crop) -> None:
        super().__init__(world, threshold)
        self.crop, count, tool = crop, len(world.entities), world.robot.tool
        self._keep = math.exp(-self._timestep / crop["pressed_time"])  # of y, after a step
        # of pairs, by E times the first entity plus the second
        self._work, self._lasting = np.zeros((2, count**2))
        self._last = np.zeros(count**2, dtype=np.int64)  # step of their last touch
        self._worst = np.zeros((count, len(BEARABLE) + len(DETACHING)))
        self._of_tool = np.array([each.kind == "tool" for each in world.entities])
        self._edge: FloatArray | None = None  # axis of the tool, and height from which it is edge
        if tool is not None and suction_of(world) is None:  # whose lip is soft
            height = tool.front if scissor_of(world) is not None else tool.tip - WALL
            self._edge = np.append(tool.rotation[:, 2], height)

    def add(self, data: Any) -> None:
        """Count the contacts of ``data`` at the next step."""
        super().add(data)
        if not data.nefc:
            return
        rows, pairs, points, forces = pressing(data, self._world)
        at = np.asarray(data.contact.efc_address)[rows]
        normal = data.efc_force[at]
        # a row accelerates by MuJoCo's reference, less its regularisation R times its force
        gain = data.efc_aref[at] - data.efc_R[at] * normal
        power = -normal * (data.efc_vel[at] + 0.5 * self._timestep * gain)
        sharp = normal * self._on_edge(data, pairs, points)
        forces[pairs[:, 0] > pairs[:, 1]] *= -1.0
        ends = np.sort(pairs, axis=1)
        keys, of = np.unique(ends @ [len(self._of_tool), 1], return_inverse=True)
        power, sharp, *force = (np.bincount(of, each) for each in (power, sharp, *forces.T))
        gap = self._steps - self._last[keys]
        before = np.where((power > 0.0) & (gap == 1), self._work[keys], 0.0)
        self._work[keys] = before + np.maximum(power, 0.0) * self._timestep
        fresh = (1.0 - self._keep) * lengths(np.stack(force, axis=1))
        self._lasting[keys] = self._keep**gap * self._lasting[keys] + fresh
        self._last[keys] = self._steps
        figures = np.stack([self._work[keys], self._lasting[keys], sharp], axis=1)
        for side in ends.T:
            np.maximum.at(self._worst[:, : len(BEARABLE)], side, figures[of])

    def _on_edge(self, data: Any, pairs: IntArray, points: FloatArray) -> BoolArray:
        """Which contacts (C,) of ``pairs`` (C, 2) at ``points`` (C, 3) are of the tool's edge."""
        if self._edge is None:
            return np.zeros(len(pairs), dtype=np.bool_)
        body = data.body("tool")
        heights = (points - body.xpos) @ (body.xmat.reshape(3, 3) @ self._edge[:3])
        return np.asarray(self._of_tool[pairs].any(axis=1) & (heights > self._edge[3]))

    def pull(
        self, fruits: Sequence[Fruit], forces: FloatArray, up: FloatArray, moments: FloatArray,
        own: FloatArray,
    ) -> BoolArray:  # fmt: skip
        """Count the loads of the stems of W fruits; returns which fruits (W,) come off.

        ``forces`` (W, 3): of each stem on its fruit [N]. ``up`` (W, 3): unit, up the stem.
        ``moments`` (W, 3): about the calyx [N m]; what turns about the stem is left out. ``own``
        (W,): pulls along the stem that detach the fruits [N].
        """
        size, most = lengths(forces), [self.crop[name] for name in DETACHING]
        along = np.einsum("wi,wi->w", forces, up)
        angles = np.rad2deg(np.arccos(np.clip(along / np.maximum(size, 1e-12), -1.0, 1.0)))
        pulls = size / detaching(self.crop, angles) * most[0] ** 2 / own
        bends = lengths(np.cross(up, moments))
        loads, entities = np.column_stack([pulls, bends]), [fruit.entity for fruit in fruits]
        np.maximum.at(self._worst[:, len(BEARABLE) :], entities, loads)
        gone = loads > most
        for w in np.flatnonzero(gone.any(axis=1)).tolist():
            pulled = f"pulled with {size[w]:.1f} N at {angles[w]:.0f} degrees"
            bent = f"bent with {bends[w]:.2g} N m"
            self.torn[fruits[w].built.key] = pulled if gone[w, 0] else bent
        return np.asarray(gone.any(axis=1))

    def figures(self) -> Mapping[str, Mapping[str, float]]:
        """The largest figure of each law, of each fruit that was shown, by id."""
        laws, worst = (*BEARABLE, *DETACHING), self._worst.tolist()
        return {f.id: dict(zip(laws, worst[f.entity], strict=True)) for f in self._world.shown}

    def borne(self) -> Iterator[tuple[str, str, float, float]]:
        """See :class:`ContactLog`."""
        for id_, mine in self.figures().items():
            yield from ((id_, name, mine[name], self.crop[name]) for name in BEARABLE)


class Cause(StrEnum):
    """The causes of failed runs, the gravest first."""

    UNSTABLE = "unstable"  # a NaN, or a warning of MuJoCo
    STATIC_CONTACT = "static_contact"  # arm or tool pressed a static object
    TORN = "torn"  # a fruit came off its stem
    CUT_OTHER = "cut_other"  # blades closed on something else than the stem that was to be cut
    STEM_CAUGHT = "stem_caught"  # a stem was pressed by arm or tool
    SWALLOWED_OTHER = "swallowed_other"  # another fruit is in the cup, or between the fingers
    AVOID_CONTACT = "avoid_contact"  # an arm link pressed a neighbouring cluster
    CRUSHED = "crushed"  # a fruit was pressed harder than it bears
    LIMIT = "limit"  # a joint left its range
    TRACKING = "tracking"  # the arm could not follow
    NOT_PICKED = "not_picked"  # the target is not in the tool; of a scissor: its stem is not cut
    NOT_PLACED = "not_placed"  # the target is not at its place


PRESSED: Mapping[str, str] = {
    "peak_force": "with {:.1f} N",
    "impact_energy": "by a blow of {:.3g} J (bears {:.3g})",
    "pressed_force": "with a lasting {:.3g} N (bears {:.3g})",
    "edge_force": "by an edge with {:.3g} N (bears {:.3g})",
}
"""What a fruit did not bear, in words: the figure, and what it bears."""


@dataclass(frozen=True)
class Contact:
    """All touches of one robot link and one object, or of one fruit and one object.

    Attributes:
        link: of the robot ("tool" for the tool).
        other: id of the scene's object.
        peak_force: largest force, summed over the contact points of one instant [N].
        duration: time in touch [s].
        first: when they first touched [s].
    """

    link: str
    other: str
    peak_force: float
    duration: float
    first: float


@dataclass(frozen=True)
class CropVerdict:
    """What a run did to fruits in a crop's units."""

    name: str  # of the crop
    # largest figure of each row that limits harm, by fruit and row [the row's unit]
    figures: Mapping[str, Mapping[str, float]]
    decided: tuple[str, ...]  # rows whose value a fruit did not bear
    guesses: tuple[str, ...]  # of these, those that nobody measured
    # guessed limits on which the verdict hangs: their range holds values that bear the largest
    # figure, and others that do not
    hangs_on: tuple[str, ...]


@dataclass(frozen=True)
class Outcome:
    """The judgement of a run.

    Attributes:
        success: whether the tool holds the target alone (in a cup's mouth, between fingers, or at
            the lip of a suction cup) and nothing was harmed; for a tool that cannot hold, whether
            nothing was harmed; for a scissor, whether it cut the target's stem alone, too.
        cause: the first of ``causes``; None for a success.
        message: the causes in words.
        picked: whether the target is in the tool and stays there at the end; None for a
            scene without a target, and for a tool that cannot hold. Of a scissor: whether the stem
            of the target was cut, or, without a target, the one nearest the goal.
        swallowed_others: other fruits whose axis is partly inside the tool at the end.
        entered: other fruits whose axis was partly inside the tool at any time.
        peak_force: largest force on each target and pushable, by id [N].
        torn: fruits that came off their stems.
        stem_caught: fruits whose stem was pressed by arm or tool beyond the thresholds.
        stem_pressed: the same by the definition of 0.3.0: by 2 N, unless the scene states a crop.
        stem_force: largest force of arm or tool on each stem, by the fruit's id [N].
        stem_tension: largest pull along each stem, by the fruit's id [N].
        static_contacts: of robot links with static objects, and of the tool.
        avoid_contacts: of B_d with avoid objects.
        tool_avoid_contacts: of last link and tool with avoid objects: allowed.
        arm_fruit_contacts: of B_d with targets and pushables.
        target_displacement: distance by which the target had moved when it entered the
            tool; the largest one where it never entered [m].
        swallowed_at: time at which the target entered the tool last [s], or None.
        displacement: largest distance of each target and pushable from its first position, by id
            [m].
        tracking_error: largest distance of the tool point from the reference [m].
        joint_error: largest distance of a joint from the reference [rad or m].
        limit_use: largest share of a limit: ``position`` (of the range), ``velocity``,
            ``acceleration``, ``jerk`` (of the reference) and ``torque``.
        overlapping: pairs of fruits, stems and objects that overlap in the scene, and so could not
            touch.
        parted: distance by which fruits that overlapped in the scene were moved apart before the
            run, by id [m].
        duration: of the motion, without the hold at the end [s].
        warnings: of MuJoCo, or of a value that is not finite.
        target: id of the target; None for a scene without one.
        causes: all causes of the failure, in the order of :class:`Cause`.
        cut: what a scissor did when it closed; None for another tool.
        placed: whether the target was brought to its place; None for a motion that is no pick in
            several legs.
        placed_off: distance of the target's centre from its place at the end [m]; None where it
            was not brought there.
        crop: by whose rows harm was judged; None: by the simulation's thresholds.
    """

    success: bool
    cause: Cause | None
    message: str
    picked: bool | None
    swallowed_others: tuple[str, ...] = ()
    entered: tuple[str, ...] = ()
    peak_force: Mapping[str, float] = field(default_factory=dict)
    torn: tuple[str, ...] = ()
    stem_caught: tuple[str, ...] = ()
    stem_pressed: tuple[str, ...] = ()
    stem_force: Mapping[str, float] = field(default_factory=dict)
    stem_tension: Mapping[str, float] = field(default_factory=dict)
    static_contacts: tuple[Contact, ...] = ()
    avoid_contacts: tuple[Contact, ...] = ()
    tool_avoid_contacts: tuple[Contact, ...] = ()
    arm_fruit_contacts: tuple[Contact, ...] = ()
    target_displacement: float | None = None
    swallowed_at: float | None = None
    displacement: Mapping[str, float] = field(default_factory=dict)
    tracking_error: float = 0.0
    joint_error: float = 0.0
    limit_use: Mapping[str, float] = field(default_factory=dict)
    overlapping: tuple[tuple[str, str], ...] = ()
    parted: Mapping[str, float] = field(default_factory=dict)
    duration: float = 0.0
    warnings: tuple[str, ...] = ()
    target: str | None = None
    causes: tuple[Cause, ...] = ()
    cut: StemCut | None = None
    placed: bool | None = None
    placed_off: float | None = None
    crop: CropVerdict | None = None

    @property
    def success_before(self) -> bool:
        """Whether it is a success by the definition of 0.3.0, too."""
        return self.success and not self.stem_pressed

    @property
    def result(self) -> str:
        """``clean``, ``harmed`` or ``missed`` (unharmed, but not picked or placed)."""
        if self.success:
            return "clean"
        harmless = {Cause.NOT_PICKED, Cause.NOT_PLACED}
        return "harmed" if set(self.causes) - harmless else "missed"

    @property
    def unripe_peak_force(self) -> float:
        """Largest force on a fruit or object that was not to be picked [N]."""
        others = (force for id_, force in self.peak_force.items() if id_ != self.target)
        return max(others, default=0.0)

    @property
    def told(self) -> str:
        """What was done, or the cause of the failure, in words."""
        if not self.success:
            return f"failed: {self.cause}"
        if self.picked is None:  # without a target, or by a tool that cannot hold
            return "nothing harmed"
        return f"{'picked and placed' if self.placed else 'picked'}, nothing harmed"

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain values for JSON."""
        document = asdict(self)
        document["cause"] = None if self.cause is None else str(self.cause)
        document["causes"] = [str(cause) for cause in self.causes]
        document["unripe_peak_force"] = self.unripe_peak_force
        document["success_before"] = self.success_before
        cut, crop = document.pop("cut"), document.pop("crop")
        document |= {} if crop is None else {"crop": crop}
        if self.cut is not None:
            document["cut"] = dict(zip(StemCut._fields, cut, strict=True))
        return document


def held(world: World, rollout: Rollout, index: int) -> BoolArray:
    """Whether the tool holds a fruit of ``world.shown`` (R,); blades hold nothing."""
    if rollout.cut is not None:
        return np.zeros(len(rollout.times), dtype=np.bool_)
    if suction_of(world) is not None:
        r = rollout
        return on_lip(world, r.contacts, r.tool_point, r.tool_axis, world.shown[index])
    return in_tool(world, rollout.q, rollout.states, world.shown[index])


def inside_words(world: World) -> str:
    """The place of a picked object, in words."""
    tool = world.robot.tool
    if tool is None:
        return "at the tool point"
    if suction_of(world) is not None:
        return "at the lip"
    return "between the fingers" if tool.fingers else "in the cup"


def judge(world: World, rollout: Rollout, log: ContactLog) -> Outcome:
    """Judge a rollout by ``world.parameters.thresholds``."""
    limits, shown = world.parameters.thresholds, world.shown
    target = next((fruit.id for fruit in shown if fruit.role == "target"), None)
    entities = world.entities
    inside = {fruit.id: held(world, rollout, i) for i, fruit in enumerate(shown)}
    moved = {
        fruit.id: np.linalg.norm(
            rollout.fruit_positions[:, i] - rollout.fruit_positions[0, i], axis=1
        )
        for i, fruit in enumerate(shown)
    }
    contacts = list(_contacts(world, log))
    static = tuple(c for c, _, kind in contacts if kind == "static")
    avoid = tuple(c for c, distal, kind in contacts if kind == "avoid" and not distal)
    brushed = tuple(c for c, distal, kind in contacts if kind == "avoid" and distal)
    arm_fruit = tuple(
        c for c, distal, kind in contacts if kind in ("fruit", "thing") and not distal
    )
    caught, pressed, stem_force = [], [], {}
    robot = [i for i, e in enumerate(entities) if e.kind in ("link", "tool")]
    peak_force = {}
    for fruit in shown:
        peak_force[fruit.id] = float(log.peak[fruit.entity].max())
        if fruit.stem_entity < 0:
            continue
        stem_force[fruit.id] = float(log.peak[fruit.stem_entity, robot].max())
        if log.hard[fruit.stem_entity, robot].max() > limits.stem_time:
            caught.append(fruit.id)
        if log.before.hard[fruit.stem_entity, robot].max() > limits.stem_time:
            pressed.append(fruit.id)
    picked = swallowed_at = None
    displacement = None if target is None else float(moved[target].max())
    tool = world.robot.tool
    if rollout.cut is not None:
        aimed = wanted(world)
        picked = {*aimed} <= {*rollout.cut.stems} if aimed else None
    elif target is not None and (tool is None or tool.mouth[0] > 0.0 or suction_of(world)):
        mine = inside[target]
        late = rollout.times >= rollout.times[-1] - limits.rest_time - 1e-9
        picked = bool(mine[late].all())
        outside = np.flatnonzero(~mine)
        if mine[-1]:
            entered = int(outside[-1]) + 1 if len(outside) else 0
            swallowed_at = float(rollout.times[entered])
            displacement = float(moved[target][: entered + 1].max())
    others = [fruit.id for fruit in shown if fruit.id != target]
    facts = Outcome(
        success=False, cause=None, message="", picked=picked,
        swallowed_others=tuple(id_ for id_ in others if inside[id_][-1]),
        entered=tuple(id_ for id_ in others if inside[id_].any()),
        peak_force=peak_force, torn=tuple(rollout.torn_at), stem_caught=tuple(caught),
        stem_pressed=tuple(pressed), stem_force=stem_force, stem_tension=dict(rollout.tension),
        static_contacts=static, avoid_contacts=avoid, tool_avoid_contacts=brushed,
        arm_fruit_contacts=arm_fruit, target_displacement=displacement, swallowed_at=swallowed_at,
        displacement={id_: float(values.max()) for id_, values in moved.items()},
        tracking_error=rollout.tracking_error, joint_error=rollout.joint_error, cut=rollout.cut,
        limit_use=dict(rollout.limit_use), overlapping=world.overlapping,
        parted=dict(world.parted), duration=rollout.motion, warnings=rollout.warnings,
        target=target,
    )  # fmt: skip
    if isinstance(log, HarmLog):
        facts = replace(facts, crop=_verdict(facts, log, log.crop))
    failures = list(_failures(facts, world, log))
    far = ", ".join(f"{id_} by {1e3 * by:.1f} mm" for id_, by in world.parted.items())
    note = f"; fruits that overlapped were pushed apart before: {far}" if far else ""
    if failures:
        causes, words = zip(*failures, strict=True)
        return replace(facts, cause=causes[0], causes=causes, message="; ".join(words) + note)
    told = f"the target alone is {inside_words(world)}, nothing was harmed"
    if picked is not None and facts.cut is not None:
        told = f"the stem of {wanted(world)[0]} alone is cut, nothing was harmed"
    if picked is None:
        told = "the motion was executed, nothing was harmed"
    return replace(facts, success=True, message=told + note)


def _verdict(outcome: Outcome, log: HarmLog, crop: Crop) -> CropVerdict:
    """The figures of a run beside the crop's rows."""
    figures = {
        id_: {**mine, "grip_force": outcome.stem_force.get(id_, 0.0)}
        for id_, mine in log.figures().items()
    }
    laws = [name for name in crop.rows if any(name in mine for mine in figures.values())]
    most = {name: max(mine[name] for mine in figures.values()) for name in laws}
    decided = tuple(
        name for name in laws
        if most[name] > crop[name] and (name != "grip_force" or outcome.stem_caught)
    )  # fmt: skip
    guesses = tuple(name for name in decided if crop.rows[name].guess)
    hangs_on = tuple(name for name in laws if crop.rows[name].hangs(most[name]))
    return CropVerdict(crop.name, figures, decided, guesses, hangs_on)


def _failures(outcome: Outcome, world: World, log: ContactLog) -> Iterator[tuple[Cause, str]]:
    """The causes of failure and each in words, in the order of :class:`Cause`."""
    limits = world.parameters.thresholds
    if outcome.warnings:
        yield Cause.UNSTABLE, "the simulation broke down: " + "; ".join(outcome.warnings)
    worst = _hardest(world, outcome.static_contacts, limits.static_force)
    if worst is not None:
        yield Cause.STATIC_CONTACT, f"{worst.link} presses {worst.other} with {_force(worst)}"
    if outcome.torn:
        words = (f"{i} ({log.torn[i]})" if i in log.torn else i for i in outcome.torn)
        yield Cause.TORN, f"torn off: {', '.join(words)}"
    if outcome.cut is not None:
        shut_on = [f"the stem of {i}" for i in outcome.cut.stems if i not in wanted(world)]
        shut_on += list(outcome.cut.fruits)
        if shut_on:
            yield Cause.CUT_OTHER, f"the blades closed on {', '.join(shut_on)}"
    if outcome.stem_caught:
        forces = ", ".join(f"{i} ({outcome.stem_force[i]:.1f} N)" for i in outcome.stem_caught)
        yield Cause.STEM_CAUGHT, f"stems pressed: {forces}"
    if outcome.swallowed_others:
        others = ", ".join(outcome.swallowed_others)
        yield Cause.SWALLOWED_OTHER, f"also {inside_words(world)}: {others}"
    worst = _hardest(world, outcome.avoid_contacts, limits.avoid_force)
    if worst is not None:
        yield Cause.AVOID_CONTACT, f"{worst.link} presses {worst.other} with {_force(worst)}"
    crushed = [
        f"{id_} {PRESSED[name].format(figure, most)}"
        for id_, name, figure, most in log.borne()
        if figure > most
    ]
    if crushed:
        yield Cause.CRUSHED, f"pressed too hard: {', '.join(crushed)}"
    if outcome.limit_use.get("position", 0.0) > 1.0 + 1e-3:
        yield Cause.LIMIT, "a joint left its range"
    if outcome.tracking_error > limits.tracking_error:
        yield Cause.TRACKING, f"the tool was {1e3 * outcome.tracking_error:.0f} mm off its path"
    if outcome.picked is False and outcome.cut is not None:
        yield Cause.NOT_PICKED, f"the stem of {wanted(world)[0]} is not cut"
    elif outcome.picked is False:
        yield Cause.NOT_PICKED, f"the target is not {inside_words(world)}"


def _contacts(world: World, log: ContactLog) -> Iterator[tuple[Contact, bool, str]]:
    """Contacts of robot links: the contact, whether the link is distal, the other's kind."""
    entities = world.entities
    for a, link in enumerate(entities):
        if link.kind not in ("link", "tool"):
            continue
        for b, other in enumerate(entities):
            if log.peak[a, b] > 0.0:
                figures = (float(each[a, b]) for each in (log.peak, log.time, log.first))
                yield Contact(link.name, other.name, *figures), link.distal, other.kind


def _hardest(world: World, contacts: Iterable[Contact], limit: float) -> Contact | None:
    """The hardest of the contacts above a force [N], of those that the scene does not allow."""
    minded = (c for c in contacts if not world.scene.may_meet(c.link, c.other))
    worst = max(minded, key=lambda c: c.peak_force, default=None)
    return worst if worst is not None and worst.peak_force > limit else None


def _force(contact: Contact) -> str:
    return f"{contact.peak_force:.1f} N"
