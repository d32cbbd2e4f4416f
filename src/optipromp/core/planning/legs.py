"""``plan_pick``: a pick as one motion: approach, way in and way out, chosen together.

A reach and its way out are one proposal with one harm (:mod:`optipromp.core.planning.ways`); where
the least is not small, other approaches to the target are proposed, too. In a scene with a place
the carry follows.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.budget import clock
from optipromp.core.errors import Code, InvalidRequestError
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
from optipromp.core.planning.options import DEFAULTS, PlanOptions, Timed, stated
from optipromp.core.planning.parameters import BACK, LIFTING
from optipromp.core.planning.plan import STILL, check_request, other_reaches, plan
from optipromp.core.planning.result import CARRY, LIFT, REACH, RETREAT, Plan, Proposal, cheapest
from optipromp.core.planning.task import robot_of
from optipromp.core.planning.timing import eased, shortest
from optipromp.core.planning.verdict import whole
from optipromp.core.planning.ways import Legs, retreats
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
        return told[-1] if told else math.nan

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
    scene = scene if isinstance(scene, Scene) else load_scene(scene)
    if scene.target is None:
        raise InvalidRequestError(f"{scene.name} has no target: a pick needs one")
    if names := ", ".join(item.id for item, _ in scene.movers):
        told = "the legs of a pick know no motion; leave out the motions, or plan the reach alone"
        raise InvalidRequestError(f"in {scene.name} {names} move: {told}")
    reach = plan(scene, progress=progress, **request)
    return after(reach, progress, scene, **request)


def after(
    reach: Plan, progress: Callable[[str], None] | None = None, scene: Scene | None = None,
    **request: Any,
) -> Picked:  # fmt: skip
    """A pick from its reach, with the legs that come after; see :func:`plan_pick`.

    ``scene``: of which another approach is taken where the way out harms; None: the reach stays.
    """
    legs = {REACH: reach}
    if reach.robot.tool is None:
        raise InvalidRequestError(f"{reach.robot.name} has no tool, which would hold the target")
    if hopeful(reach):
        (progress or str)("retreat")
        legs = with_way_out(reach, scene, **request)
    if RETREAT in legs and legs[RETREAT].success and reach.scene.place is not None:
        scene, robot = carry_scene(legs)
        legs[CARRY] = plan(scene, progress=progress, **request | {"robot": robot})
    return Picked(legs)


def hopeful(reach: Plan) -> bool:
    """Whether a way out may make a pick of a reach: it does no more harm than a pick may do."""
    if reach.success or not reach.valid or stands(reach.scene):
        return reach.success
    model = retreat_model(reach)
    return model is not None and reach.harm <= model.threshold


def with_way_out(reach: Plan, scene: Scene | None = None, **request: Any) -> Legs:
    """A reach and its way out, or those by another approach, if these are less harmful.

    ``scene``, ``request``: see :func:`after`. The time of the options begins anew.
    """
    names = {item.name for item in fields(PlanOptions)} & request.keys()
    options = stated(request.get("options"), {name: request[name] for name in names}, plan)
    planner = request.get("planner", "opti-promp")
    settings: Timed = planner if isinstance(planner, Timed) else options
    solver = check_request(planner, request.get("strategy", "joint"), options)
    others = iter(()) if scene is None else other_reaches(reach, scene, solver, options)

    def next_reach() -> Iterator[Proposal[Legs]]:
        for other in others:
            yield from retreats(other, settings, longer=False)
            yield again
            return

    again = Proposal[Legs]((False, False, BACK.good), next_reach)
    proposed = lifted(reach, settings)
    if not stands(reach.scene):
        proposed = chain(retreats(reach, settings), [again])
    return next(cheapest(proposed, clock() + options.timeout), None) or stuck(reach)


def way_out(reach: Plan, options: Timed = DEFAULTS) -> Legs:
    """The legs by which the tool leaves the plant after a reach."""
    legs = with_way_out(reach, options=options if isinstance(options, PlanOptions) else None)
    return {name: one for name, one in legs.items() if name != REACH}


def lifted(reach: Plan, options: Timed) -> Iterator[Proposal[Legs]]:
    """Proposals of a reach with the lift and retreat after it, of a target that stands.

    The first height of which both are valid comes first; without one, those of the last height.
    """
    began = clock()

    def judged(k: int, up: FloatArray, back: FloatArray) -> Iterator[Proposal[Legs]]:
        legs = {REACH: reach}
        for name, q in ((LIFT, up), (RETREAT, back)):
            curve = shortest(eased(held(reach)[1], options), q, 0, LIFTING.speed)
            legs[name] = leg(leg_task(reach, name, curve), curve, clock() - began)
            if not legs[name].success:
                yield Proposal((True, -k), legs)
                return
        yield Proposal((False, k), legs)

    for k, (up, back) in enumerate(lifts(reach, held(reach)[1], distance_of(reach))):
        yield Proposal((False, k), partial(judged, k, up, back))


def stuck(reach: Plan) -> Legs:
    """A reach with a lift that the arm cannot make: it stays."""
    curve = Trajectory.still(reach.trajectory.positions[-1], STILL, reach.trajectory.joint_names)
    one = leg(leg_task(reach, LIFT, curve), curve, 0.0)
    reason = "the arm cannot lift the target straight up from its grasp"
    return {REACH: reach, LIFT: replace(one, status=Code.NO_PLAN, reason=reason)}


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
