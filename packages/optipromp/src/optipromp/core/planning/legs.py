"""``plan_pick``: a pick as one motion: approach, way in and way out, chosen together.

A reach and its way out are one proposal with one harm (:mod:`optipromp.core.planning.ways`); where
the least is not small, other approaches to the target are proposed, too. In a scene with a place
the carry follows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning.attempt import STILL
from optipromp.core.planning.cutting import steady
from optipromp.core.planning.leg_tasks import (
    carry_scene,
    distance_of,
    held,
    leg,
    leg_task,
    lifts,
    retreat_model,
    stands,
)
from optipromp.core.planning.options import DEFAULTS, PlanOptions, Timed
from optipromp.core.planning.parameters import LIFTING
from optipromp.core.planning.plan import Request, plan
from optipromp.core.planning.result import CARRY, LIFT, REACH, RETREAT, Plan, Proposal, cheapest
from optipromp.core.planning.task import cuts, robot_of
from optipromp.core.planning.timing import eased, shortest
from optipromp.core.planning.verdict import whole
from optipromp.core.planning.warming import one_thread
from optipromp.core.planning.ways import Legs, retreats
from optipromp.core.pushing.model import failing
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory, chained


@dataclass(frozen=True, eq=False)
class Picked:
    """A pick as a plan of several legs, each judged.

    Attributes:
        legs: by name, in the order of the motion: ``reach``, for what stands ``lift``,
            ``retreat``, ``carry``. A failed leg is the last one.
    """

    legs: dict[str, Plan]

    @property
    def reach(self) -> Plan:
        """The first leg."""
        return self.legs[REACH]

    @property
    def status(self) -> Code:
        """The status of the whole; see :func:`optipromp.core.planning.verdict.whole`."""
        return whole(self.legs)[0]

    @property
    def message(self) -> str:
        """The reasons for the status."""
        return whole(self.legs)[1]

    @property
    def success(self) -> bool:
        """Whether the whole is a success."""
        return self.status == Code.SUCCESS

    @property
    def failure(self) -> float:
        """Probability that the pick is not clean; nan where no leg tells it.

        A retreat tells that of the whole; the leg before the carry, that of a target that stands.
        """
        told = [leg.prediction.probability for leg in self.legs.values() if leg.prediction]
        swept = max(leg.metrics.unseen or 0.0 for leg in self.legs.values())
        return failing(told[-1], swept) if told else math.nan

    @property
    def duration(self) -> float:
        """Of all legs [s]."""
        return sum(leg.trajectory.duration for leg in self.legs.values())

    @property
    def end(self) -> FloatArray:
        """(n,) configuration at the end of the last leg."""
        *_, last = self.legs.values()
        return np.asarray(last.trajectory.positions[-1])

    def to_dict(self) -> dict[str, Any]:
        """Everything but the trajectories, as plain values for JSON: the reach, and the legs."""
        return self.reach.to_dict() | {
            "status": self.status,
            "message": self.message,
            "failure": None if math.isnan(self.failure) else self.failure,
            "legs": {name: leg.to_dict() for name, leg in self.legs.items()},
        }


def plan_pick(
    scene: Scene | str | Path, *, progress: Callable[[str], None] | None = None, **request: Any
) -> Picked:
    """Plan a pick and what comes after: the reach, the retreat, and the way to ``scene.place``.

    Args:
        scene: a scene, the name of a built-in scene, or the path of a scene file; with a target.
            Without a ``place`` the pick ends with the retreat.
        progress: called with a short text as each step begins.
        request: further arguments of :func:`optipromp.core.planning.plan.plan`.

    Returns:
        The legs. A leg that fails is returned too, with its code; no leg comes after it.

    Raises:
        InvalidRequestError: the scene has no target, objects that move, or a robot without a tool.
        OptiPrompError: an error of :func:`optipromp.core.planning.plan.plan`.
    """
    search = Request.of(plan_pick, progress=progress, **request).search(scene)
    scene = search.scene
    if scene.target is None:
        raise InvalidRequestError(f"{scene.name} has no target: a pick needs one")
    if names := ", ".join(item.id for item, _ in scene.movers):
        told = "the legs of a pick know no motion; leave out the motions, or plan the reach alone"
        raise InvalidRequestError(f"in {scene.name} {names} move: {told}")
    settings = search.planner if isinstance(search.planner, Timed) else search.options
    with one_thread():
        legs = next(cheapest(picks(search.reaches(), settings), search.late))
    if RETREAT not in legs or not legs[RETREAT].success or scene.place is None:
        return Picked(legs)
    if clock() + legs[REACH].time["total"] > search.late:  # a carry takes about as long as a reach
        return Picked(legs | {RETREAT: timed_out(legs[RETREAT], "the carry")})
    scene, robot = carry_scene(legs)
    left = search.began + search.options.timeout - clock()
    asked = request | {"progress": progress, "robot": robot, "timeout": left}
    carry = plan(scene, **asked)
    if cuts(legs[REACH].scene, robot.tool) and carry.success:
        made = steady(legs[REACH].scene, robot, carry.trajectory)
        carry = replace(leg(carry.task, made, carry.time["total"]), planner=carry.planner)
    return Picked(legs | {CARRY: carry})


def timed_out(leg: Plan, what: str) -> Plan:
    """A leg of a pick for whose rest, ``what``, there was no time."""
    said = leg.said._replace(before=f"time ran out before {what}: {leg.said.before}")
    return replace(leg, status=Code.TIMEOUT, said=said)


def picks(reaches: Iterable[Proposal[Plan]], settings: Timed) -> Iterator[Proposal[Legs]]:
    """Proposals of reaches, each with the legs that come after it as further proposals.

    The rank is whether a leg is not valid, whether the retreat ends badly (see :func:`retreats`;
    of a reach that alone fails, at least 1), and the harm of the whole.
    """
    for rank, made in reaches:
        if not isinstance(made, Plan):
            yield Proposal(rank, partial(_further, made, settings))
        elif hopeful(made):
            yield from outs(made, settings)
        else:
            yield Proposal((True, 1 + rank[1], rank[2]), {REACH: made})


def _further(
    make: Callable[[], Iterable[Proposal[Plan]]], settings: Timed
) -> Iterator[Proposal[Legs]]:
    return picks(make(), settings)


def hopeful(reach: Plan) -> bool:
    """Whether a way out may make a pick of a reach: it does no more harm than a pick may do."""
    if reach.robot.tool is None:
        raise InvalidRequestError(f"{reach.robot.name} has no tool, which would hold the target")
    if reach.success or not reach.valid or stands(reach.scene):
        return reach.success
    model = retreat_model(reach)
    return model is not None and reach.harm <= model.threshold


def outs(reach: Plan, settings: Timed) -> Iterator[Proposal[Legs]]:
    """Proposals of a reach with the legs by which the tool leaves the plant.

    Where time runs out before there is one, the reach alone is left.
    """
    find = lifted if stands(reach.scene) else retreats
    yield Proposal((True, 2, 0.0), {REACH: timed_out(reach, "a way out was found")})
    yield Proposal((False, False, 0.0), partial(find, reach, settings))


def led_out(reach: Plan, options: PlanOptions = DEFAULTS) -> Legs:
    """A reach and its least harmful way out, as legs; no carry comes after them."""
    return next(cheapest(outs(reach, options), clock() + options.timeout))


def lifted(reach: Plan, options: Timed) -> Iterator[Proposal[Legs]]:
    """Proposals of a reach with the lift and retreat after it, of a target that stands.

    The first height of which both are valid comes first; without one, those of the last height.
    Where the arm cannot lift the target from its grasp it stays.
    """
    began = clock()

    def judged(k: int, up: FloatArray, back: FloatArray) -> Iterator[Proposal[Legs]]:
        legs = {REACH: reach}
        for name, q in ((LIFT, up), (RETREAT, back)):
            curve = shortest(eased(held(reach)[1], options), q, 0, LIFTING.speed)
            legs[name] = leg(leg_task(reach, name, curve), curve, clock() - began)
            if not legs[name].success:
                yield Proposal((True, False, -k), legs)
                return
        yield Proposal((False, False, 0.0), legs)

    yield Proposal((True, False, 1.0), lambda: [Proposal((True, False, 1.0), stuck(reach))])
    for k, (up, back) in enumerate(lifts(reach, held(reach)[1], distance_of(reach))):
        yield Proposal((False, False, 0.0), partial(judged, k, up, back))


def stuck(reach: Plan) -> Legs:
    """A reach with a lift that the arm cannot make: it stays."""
    curve = Trajectory.still(reach.trajectory.positions[-1], STILL, reach.trajectory.joint_names)
    one = leg(leg_task(reach, LIFT, curve), curve, 0.0)
    reason = "the arm cannot lift the target straight up from its grasp"
    said = one.said._replace(before=reason, of=None, more=one.notes)
    return {REACH: reach, LIFT: replace(one, status=Code.NO_PLAN, said=said)}


def takes(scene: Scene, robot: Robot) -> bool:
    """Whether the robot's tool takes the target of a scene in which nothing moves."""
    tool = robot.tool
    return tool is not None and tool.mouth[0] > 0.0 and not (scene.target is None or scene.movers)


def plan_whole(scene: Scene | str | Path, **request: Any) -> Picked | Plan:
    """The pick where the tool takes the target or the scene has a place; else the reach alone, and
    where it fails."""
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if scene.place is None and not takes(scene, robot_of(scene)):
        return plan(scene, **request)
    picked = plan_pick(scene, **request)
    return picked if len(picked.legs) > 1 else picked.reach


def legs_of(made: Plan | Picked) -> Mapping[str, Plan]:
    """The legs of a pick by name; of a plan, it alone as ``reach``."""
    return made.legs if isinstance(made, Picked) else {REACH: made}


def curve_of(made: Plan | Picked) -> Trajectory:
    """The motion of all legs."""
    return chained([leg.trajectory for leg in legs_of(made).values()])
