"""Plans to and from files.

``plan.json`` holds everything but the curves, and the digests of the other files.
``trajectory.csv`` and ``trajectory.npz`` hold the executable curve at a controller's rate.
``waypoints.npz`` holds the rows that define the three curves of a plan. The folder of a pick is
that of its reach, with ``retreat.npz`` and ``carry.npz``, the waypoints of the further legs, and
``retreat.csv`` and ``carry.csv`` at the controller's rate.
"""

import hashlib
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat

from optipromp.core import files
from optipromp.core.documents import read_document
from optipromp.core.errors import (
    Code,
    InvalidPlanError,
    InvalidRequestError,
    InvalidSceneError,
    OptiPrompError,
    printable,
)
from optipromp.core.judging import Metrics, Overlap
from optipromp.core.planning import Plan, Term
from optipromp.core.planning.leg_tasks import leg, stands, task_of
from optipromp.core.planning.legs import Picked
from optipromp.core.planning.result import AFTER, REACH, Said, Stage, ViaPoint
from optipromp.core.planning.task import changed, posed, resolve
from optipromp.core.planning.underway import underway
from optipromp.core.planning.verdict import verdict
from optipromp.core.pushing.model import Prediction
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import scene_from_dict, scene_to_dict
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import State, arrays, csv, from_arrays

FORMAT = 4
PUSHED = ("pushed_points", "pushed_axes")
FILES = ("trajectory.csv", "trajectory.npz", "waypoints.npz")
OF = "reach_sha256"  # of waypoints.npz, in the file of another leg
TOLD = "status"  # of another leg, and its message; without them it is a success
START = "start"  # (3, n) position, velocity and acceleration
SEARCHED = Code.TIMEOUT, Code.GOAL_IN_COLLISION, Code.GOAL_UNREACHABLE, Code.NO_PLAN
WORSE = Code.SUCCESS, Code.HARM_PREDICTED, Code.INVALID_PLAN, Code.START_IN_COLLISION, *SEARCHED
WRONG = "not a plan that this version wrote"
OVERLAY = ".overlay.png"
"""End of the name of a picture with what was found, beside the scene that was seen."""
ROWS = "rows.csv"
"""Name of the file of a study's rows."""
RATE = 1000.0  # [Hz] of the Panda's control interface


def write_plan(plan: Plan, folder: Path, *, rate: float = RATE) -> tuple[str, ...]:
    """Write a plan into ``folder``, all files or none.

    Args:
        plan: any plan, also a failed plan.
        folder: made if missing; files of an earlier plan are replaced.
        rate: of the rows in ``trajectory.csv`` and ``trajectory.npz`` [Hz].

    Returns:
        The names of the files.

    Raises:
        InvalidRequestError: the folder cannot be written; a rate that is not positive.
    """
    curve = plan.trajectory.resample(rate)
    contents: dict[str, bytes] = {
        "trajectory.csv": csv(curve),
        "trajectory.npz": files.npz(arrays(curve)),
        "waypoints.npz": files.npz(_waypoints(plan), compressed=True),
    }
    digests = {name: _digest(content) for name, content in contents.items()}
    document = _document(plan, folder) | {"sha256": digests}
    contents["plan.json"] = files.json_text(document).encode("utf-8")
    files.write_together(folder, contents)
    for leg_file in (folder / f"{name}.{kind}" for name in AFTER for kind in ("npz", "csv")):
        leg_file.unlink(missing_ok=True)  # of an earlier pick
    return tuple(contents)


class _Via(BaseModel):
    name: str
    position: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]


class _PlanFile(BaseModel):
    """The keys of ``plan.json`` that are read again."""

    format: Literal[4]
    sha256: dict[str, str]
    planner: str
    seed: Annotated[int, Field(ge=0)]
    risk: Annotated[float, Field(gt=0.0, lt=1.0)]
    status: Code
    message: Annotated[str, Field(min_length=1)]
    reason: str | None = None  # of older files: in the message, with the notes
    notes: tuple[str, ...] = ()
    metrics: Metrics
    terms: dict[str, Term]
    stages: tuple[Stage, ...]
    predicted_harm: Prediction | None
    contacts: tuple[Overlap, ...]
    time: dict[str, FiniteFloat]
    first: Annotated[int, Field(ge=0)]
    via: tuple[_Via, ...]
    scene_file: dict[str, Any] | None


def load_plan(path: Path | str) -> Plan:
    """Load a plan of :func:`write_plan`: its folder, or the ``plan.json`` in it.

    The trajectory is judged again: metrics, contacts and prediction are the judge's, not the
    file's.

    Raises:
        InvalidPlanError: the status in the file is better than the judge's.
        InvalidRequestError: files are missing, damaged, of another plan, of another format or for
            another robot; the message names them.
        InvalidSceneError: the scene of the plan cannot be used.
    """
    path = Path(path)
    folder = path if files.is_folder(path) else path.parent
    file = folder / "plan.json" if files.is_folder(path) else path
    with suppress(OSError):  # the digests then do not agree
        files.settle(folder)
    content = read_document(file, InvalidRequestError, "a plan")
    with files.reading(path, WRONG, passes=(InvalidSceneError, InvalidPlanError)):
        found = _PlanFile.model_validate(content)
        _check_digests(folder, found.sha256)
        rows = files.read_npz(folder / "waypoints.npz")
        if found.scene_file is None:
            raise InvalidRequestError(
                "its scene was not written: it held a shape made in memory, or the plan was made "
                "with another robot or tool than the scene's"
            )
        scene = scene_from_dict(found.scene_file, base_dir=folder, source=str(path))
        return _plan(found, scene, rows, file)


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _check_digests(folder: Path, digests: Mapping[str, str]) -> None:
    """Refuse a folder with files of two plans, or with a part of a plan."""
    if set(digests) != set(FILES):
        raise InvalidRequestError(f"sha256: must name {', '.join(FILES)}")
    for name, digest in digests.items():
        if _digest(files.read_bytes(folder / name, InvalidRequestError)) != digest:
            raise InvalidRequestError(
                f"{folder / name}: is not the file that belongs to plan.json: must be of the same "
                "plan, as it was written"
            )


def _plan(found: _PlanFile, scene: Scene, rows: Mapping[str, Any], file: Path) -> Plan:
    """The plan of a file; refused if the judge's status is worse than the file's."""
    robot, _ = posed(scene)
    curves = [from_arrays(rows, prefix) for prefix in ("", "initial_", "followed_")]
    curve = curves[0]
    if any(one.joint_names != robot.joint_names for one in curves):
        raise InvalidRequestError(
            f"waypoints.npz has the joints {', '.join(curve.joint_names)}; {robot.name} has "
            f"{', '.join(robot.joint_names)}"
        )
    if found.first >= curve.n_waypoints:
        raise InvalidRequestError(f"first is {found.first}: must be below {curve.n_waypoints}")
    start = pushed = None
    if START in rows:
        stated = files.members(rows, {START: (float, "3n")}, {"n": robot.n_joints})
        start = State(*stated[START])
    if PUSHED[0] in rows:
        points, axes = files.members(rows, dict.fromkeys(PUSHED, (float, "P3")), {}).values()
        if not np.isfinite(points + axes).all():
            raise InvalidRequestError(f"{' and '.join(PUSHED)} must be finite")
        pushed = points, axes
    task = resolve(scene, robot, start)
    if task.underway.begun:
        task = underway(task, None, None)
    task = changed(replace(task, risk=found.risk), pushed=pushed)
    judged = verdict(task, curve)
    if WORSE.index(judged.status) > WORSE.index(found.status):
        raise InvalidPlanError(
            f"{file}: status is {found.status}; judged again it is {judged.status}: "
            f"{judged.message}"
        )
    return Plan(
        task=task,
        planner=found.planner,
        seed=found.seed,
        status=found.status,
        said=Said(found.reason or found.message, more=found.notes),
        trajectory=curve,
        initial=curves[1],
        followed=curves[2],
        prediction=judged.prediction,
        judgement=judged.judgement,
        terms=found.terms,
        stages=found.stages,
        time=found.time,
        first=found.first,
        via=tuple(ViaPoint(via.name, np.array(via.position)) for via in found.via),
    )


def _document(plan: Plan, folder: Path) -> dict[str, Any]:
    from importlib.metadata import version

    scene = None
    with suppress(OptiPrompError):  # a mesh made in memory: the plan is still worth writing
        if _alike(posed(plan.scene)[0], plan.robot):
            scene = scene_to_dict(plan.scene, base_dir=folder)
    said = {"reason": plan.reason, "notes": list(plan.notes)}
    of_file = {"format": FORMAT, "version": version("optipromp"), "scene_file": scene}
    return plan.to_dict() | said | of_file


def _alike(one: Robot, other: Robot) -> bool:
    """Whether two robots have the same name, kind of tool, tool point, tool axis and spheres."""
    return (one.name, type(one.tool)) == (other.name, type(other.tool)) and all(
        np.array_equal(a, b)
        for a, b in (
            (one.tool_point, other.tool_point),
            (one.tool_axis, other.tool_axis),
            (one.spheres.center, other.spheres.center),
            (one.spheres.radius, other.spheres.radius),
        )
    )


def _waypoints(plan: Plan) -> dict[str, Any]:
    pushed = plan.task.underway.pushed
    return {
        **arrays(plan.trajectory),
        **arrays(plan.initial, "initial_"),
        **arrays(plan.followed, "followed_"),
        **({} if plan.start is None else {START: np.array([*vars(plan.start).values()])}),
        **({} if pushed is None else dict(zip(PUSHED, pushed, strict=True))),
    }


def write_pick(picked: Picked, folder: Path, *, rate: float = RATE) -> tuple[str, ...]:
    """Write a pick into ``folder``: its reach as :func:`write_plan` does, then the other legs.

    Returns:
        The names of the files.

    Raises:
        InvalidRequestError: the folder cannot be written; a rate that is not positive.
    """
    names = list(write_plan(picked.reach, folder, rate=rate))
    of = _of(folder)
    for name in AFTER:
        if name in picked.legs:
            one = picked.legs[name]
            rows = {OF: of, TOLD: [one.status, one.message], **arrays(one.trajectory)}
            content = files.npz(rows, compressed=True)
            files.write_atomically(folder / f"{name}.npz", content)
            files.write_atomically(folder / f"{name}.csv", csv(one.trajectory.resample(rate)))
            names += [f"{name}.npz", f"{name}.csv"]
    return tuple(names)


def load_pick(path: Path | str) -> Picked | Plan:
    """Load what :func:`write_pick` or :func:`write_plan` left: a pick, or a plan of one motion.

    Every leg is judged again. Legs of another reach than that of the folder are passed over. The
    leg that failed, if any, is the last one, with its status.

    Raises:
        InvalidPlanError: a leg that is a success by its file and not by the judge.
        OptiPrompError: what :func:`optipromp.core.output.load_plan` raises.
    """
    path = Path(path)
    reach, folder = load_plan(path), path.parent if path.name == "plan.json" else path
    if not reach.valid:
        return reach
    legs = {REACH: reach}
    for name in AFTER[not stands(reach.scene) :]:
        file = folder / f"{name}.npz"
        if not files.is_there(file):
            break
        rows = files.read_npz(file)
        with files.reading(file, "no leg that this version wrote"):
            curve, of = from_arrays(rows), str(rows[OF])
            status, message = map(str, rows.get(TOLD, (Code.SUCCESS, "")))
            code = Code(status)
        if of != _of(folder):
            break
        if curve.joint_names != reach.robot.joint_names:
            raise InvalidRequestError(f"{file}: must have the joints of {reach.robot.name}")
        legs[name] = leg(task_of(name, legs, curve), curve, 0.0)
        if code is not Code.SUCCESS:
            legs[name] = replace(legs[name], status=code, said=Said(printable(message)))
            break
        if not legs[name].success:
            raise InvalidPlanError(f"{file}: judged again: {legs[name].message}")
    return reach if len(legs) == 1 and reach.scene.place is None else Picked(legs)


def _of(folder: Path) -> str:
    return _digest(files.read_bytes(folder / "waypoints.npz", InvalidRequestError))
