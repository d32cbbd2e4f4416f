"""What a picker did, and what our planner would have done on what was seen then; pick by pick.

The recorded motion and ours are predicted by the same push model and judged by the same judge, each
to the end of its way out.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import plain
from optipromp.core.judging import RATES
from optipromp.core.planning import Picked, Plan, PlanOptions
from optipromp.core.planning.leg_tasks import aimed, leg, leg_task
from optipromp.core.planning.legs import plan_whole, takes
from optipromp.core.planning.result import REACH, RETREAT, Said
from optipromp.core.planning.task import posed, resolve, tool_motion
from optipromp.core.planning.verdict import Verdict, deciding
from optipromp.core.pushing.model import Prediction
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control import plant
from optipromp_loop.control.tracker import Tracker
from optipromp_loop.shadow.recording import Recording, Span, span_of

BESIDE = 0.05
"""[m] A gripper that closes farther from every fruit took none of them: a choice."""


@dataclass(frozen=True, eq=False)
class Shadowed:
    """A pick of a recording beside ours."""

    number: int  # from 1
    closed: float  # when the gripper closed [s]
    why: str = ""  # why the pick is not judged; empty: it is
    notes: tuple[str, ...] = ()  # what was not recorded or seen, in words
    span: Span | None = None  # the recorded motions; None: they are not known
    theirs: Picked | None = None  # the recorded motion, judged; None: it is not
    # what our planner would have done; or why it has no answer
    ours: Picked | OptiPrompError | None = None

    @property
    def harmful(self) -> bool:
        """Whether harm is predicted of the recorded motion."""
        push = self.theirs and push_of(self.theirs)
        return bool(push and push.harmful)

    @property
    def tried(self) -> Picked | None:
        """The pick that our planner would have tried; None: it would not have."""
        return self.ours if isinstance(self.ours, Picked) and self.ours.success else None

    @property
    def apart(self) -> float:
        """The largest distance between the two tool paths of the reach [m]; nan: one is missing."""
        if self.theirs is None or not isinstance(self.ours, Picked):
            return math.nan
        reaches = self.theirs.reach, self.ours.reach
        between = cdist(*(tool_motion(one.robot, one.trajectory.positions)[0] for one in reaches))
        return float(max(between.min(axis=0).max(), between.min(axis=1).max()))

    @property
    def seconds(self) -> FloatArray:
        """(2, 2) times of reach and way out [s], recorded and ours; nan: there is none."""
        out, span = np.full((2, 2), math.nan), self.span
        if span is not None:
            out[0] = span.closed - span.start, span.end - span.closed if span.out else math.nan
        if self.tried is not None:
            reach, *later = [one.duration for one in self.tried.legs.values()]
            out[1] = reach, sum(later) if later else math.nan
        return out

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        recorded, ours = self.seconds
        return dict(plain({
            "pick": self.number, "closed": self.closed, "why": self.why, "notes": self.notes,
            "harmful": self.harmful, "apart": self.apart,
            "refused": self.ours is not None and self.tried is None,
            "theirs": self.theirs and told(self.theirs), "ours": self.ours and told(self.ours),
            "seconds": {"recorded": recorded, "ours": ours},
        }))  # fmt: skip


def push_of(made: Picked) -> Prediction | None:
    """Of the legs that decide on the whole, the prediction of most harm over what may be done."""
    pushes = (leg.prediction for leg in deciding(made.legs).values())
    return max(filter(None, pushes), key=lambda one: one.harm / one.threshold, default=None)


def told(made: Picked | OptiPrompError) -> dict[str, Any]:
    """A pick in figures: its status, and the harm to the end of the way out."""
    if isinstance(made, OptiPrompError):
        return {"status": made.code, "message": made.message}
    push = push_of(made)
    said = {"harm": push.harm, "threshold": push.threshold, "object": push.object} if push else {}
    return {"status": made.status, "message": made.message, "probability": made.failure} | said


def shadowed(
    recording: Recording, scene: Scene, *, risk: float = PlanOptions.risk,
    progress: Callable[[int, int, str], None] = lambda *_: None,
) -> list[Shadowed]:  # fmt: skip
    """Every pick of a recording beside what our planner would have done.

    Args:
        recording: of an arm.
        scene: its robot, tool, approach and what stands still; its fruits are not used.
        risk: share of promised successes that may be broken, see :class:`PlanOptions`.
        progress: called with the number of picks done, of all, and words.
    """
    base, out, before = plant.without_fruits(scene), list[Shadowed](), -math.inf
    for k, mark in enumerate(recording.marks):
        made = Shadowed(k + 1, mark.closed)
        after = next((one.closed for one in recording.marks[k + 1 :]), math.inf)
        try:
            span = span_of(recording.arm, posed(base)[0], mark, before, after)
            made = replace(made, span=span)
            looks = [look for look in recording.looks if before <= look.time <= span.start]
            made = _beside(made, span, seen_scene(base, looks, span), risk)
        except OptiPrompError as error:
            made = replace(made, why=error.message)
        out.append(made)
        before = mark.closed if made.span is None else made.span.end
        progress(k + 1, len(recording.marks), f"{k + 1} of {len(recording.marks)} picks")
    return out


def _beside(made: Shadowed, span: Span, scene: Scene, risk: float) -> Shadowed:
    """A pick with both motions in a scene, whose target is what the gripper closed on."""
    theirs, notes = recorded_pick(scene, span, risk), list[str]()
    if RETREAT not in theirs.legs:
        why = "was not recorded" if span.out is None else "is not predicted of this tool"
        notes.append(f"its way out {why}: its harm is told to the grasp alone")
    made = replace(made, theirs=theirs, notes=tuple(notes))
    try:
        ours = plan_whole(scene, risk=risk)
    except OptiPrompError as error:
        return replace(made, ours=error)
    return replace(made, ours=ours if isinstance(ours, Picked) else Picked({REACH: ours}))


def seen_scene(base: Scene, looks: Sequence[Look], span: Span) -> Scene:
    """The scene as the tracker has it after some looks; its target is where the gripper closed.

    Raises:
        InvalidRequestError: there are no looks, or no fruit is there.
    """
    if not looks:
        raise InvalidRequestError("nothing was detected between the pick before and its begin")
    tracker, q = Tracker(base), span.reach.positions
    for look in looks:
        tracker.add(look)
    tracked = tracker.at(looks[-1].time)
    far = lengths(tracked.rest - posed(base)[0].tool_pose(q[-1])[0])
    far[~tracked.confirmed] = math.inf
    ripe = np.where(tracked.ripe, far, math.inf)
    if not np.isfinite(ripe).any():
        raise InvalidRequestError("no ripe fruit was detected before it began")
    if far.min() > BESIDE:
        where = f"the nearest is {1e3 * far.min():.0f} mm away"
        raise InvalidRequestError(f"the gripper closed where no fruit was seen: {where}")
    scene = plant.tracked_scene(base, tracked, start=q[0])
    return aimed(scene, tracked.ids[int(np.argmin(ripe))])


def recorded_pick(scene: Scene, span: Span, risk: float) -> Picked:
    """A recorded motion as a pick of judged legs; its goal is where the recorded tool ended."""
    assert scene.target is not None
    point, axis = posed(scene)[0].tool_pose(span.reach.positions[-1])
    way = replace(scene.approach, direction=axis, shift=point - scene.target.position)
    task = replace(resolve(replace(scene, approach=way)), risk=risk)
    legs = {REACH: _as_done(leg(task, span.reach, 0.0))}
    if span.out is not None and takes(scene, task.robot):
        legs[RETREAT] = _as_done(leg(leg_task(legs[REACH], RETREAT, span.out), span.out, 0.0))
    return Picked(legs)


def _as_done(one: Plan) -> Plan:
    """A recorded leg, of which rates are not judged: the arm did move so, and the derivatives of
    noisy encoders exceed any limit."""
    kept = tuple(fault for fault in one.judgement.violations if fault.kind not in RATES)
    said = Verdict(replace(one.judgement, violations=kept), one.prediction)
    return replace(
        one, planner="recorded", status=said.status, said=Said("", said), judgement=said.judgement,
    )  # fmt: skip
