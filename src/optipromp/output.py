"""Plans as files, and back.

``plan.json`` holds everything but the curves. ``trajectory.csv`` and ``trajectory.npz`` hold the
executable curve at a controller's rate. ``waypoints.npz`` holds the rows that define the three
curves of a plan.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, Field, FiniteFloat, ValidationError

from optipromp.arrays import FloatArray
from optipromp.documents import read_document
from optipromp.errors import Code, InvalidRequestError, InvalidSceneError, OptiPrompError
from optipromp.files import is_folder, json_text, npz, read_npz, write_atomically
from optipromp.judging import Metrics, Overlap, judge
from optipromp.planning import Plan, Term
from optipromp.planning.options import Planner, Strategy
from optipromp.planning.result import Stage, ViaPoint
from optipromp.planning.task import push_model, resolve
from optipromp.pushing.model import Prediction
from optipromp.robots.model import Robot
from optipromp.scenes.io import scene_from_dict, scene_to_dict
from optipromp.scenes.scene import Scene
from optipromp.trajectory import State, Trajectory
from optipromp.trajectory_files import arrays, csv, from_arrays

FORMAT = 3
PUSHED = ("pushed_points", "pushed_axes")
RATE = 1000.0  # [Hz] of the Panda's control interface


def write_plan(plan: Plan, folder: Path, *, rate: float = RATE) -> tuple[str, ...]:
    """Write a plan into ``folder``, each file whole or not at all, ``plan.json`` last.

    Args:
        plan: any plan, also one that failed.
        folder: made if need be; files of an earlier plan are replaced.
        rate: of the rows in ``trajectory.csv`` and ``trajectory.npz`` [Hz].

    Returns:
        The names of the files.

    Raises:
        InvalidRequestError: the folder cannot be written; a rate that is not positive.
    """
    curve = plan.trajectory.resample(rate)
    files: dict[str, bytes] = {
        "trajectory.csv": csv(curve),
        "trajectory.npz": npz(arrays(curve)),
        "waypoints.npz": npz(_waypoints(plan), compressed=True),
        "plan.json": json_text(_document(plan, folder)).encode("utf-8"),
    }
    for name, content in files.items():
        write_atomically(folder / name, content)
    return tuple(files)


class _Via(BaseModel):
    name: str
    position: Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]


class _PlanFile(BaseModel):
    """What ``plan.json`` must hold to be read again."""

    format: Literal[3]
    planner: Planner
    strategy: Strategy | None
    seed: Annotated[int, Field(ge=0)]
    status: Code
    message: Annotated[str, Field(min_length=1)]
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
    """Load what :func:`write_plan` left: a folder, or the ``plan.json`` in it.

    The trajectory is judged again: metrics and contacts are the judge's, whatever the file says.

    Raises:
        InvalidRequestError: files missing, damaged, of another format or for another robot; a
            ``success`` whose trajectory is none; the message names them.
        InvalidSceneError: the scene the plan was made for cannot be used.
    """
    path = Path(path)
    folder = path if is_folder(path) else path.parent
    file = folder / "plan.json" if is_folder(path) else path
    content = read_document(file, InvalidRequestError, "a plan")
    rows = read_npz(folder / "waypoints.npz")
    try:
        found = _PlanFile.model_validate(content)
        if found.scene_file is None:
            raise InvalidRequestError(
                "its scene was not written: it held a shape made in memory, or the plan was made "
                "with another robot or tool than the scene's"
            )
        scene = scene_from_dict(found.scene_file, base_dir=folder, source=str(path))
        robot = resolve(scene).robot
        curves = [from_arrays(rows, prefix) for prefix in ("", "initial_", "followed_")]
        return Plan(
            scene=scene,
            robot=robot,
            planner=found.planner,
            strategy=found.strategy,
            seed=found.seed,
            status=found.status,
            message=found.message,
            trajectory=curves[0],
            initial=curves[1],
            followed=curves[2],
            prediction=found.predicted_harm,
            terms=found.terms,
            stages=found.stages,
            time=found.time,
            first=found.first,
            via=tuple(ViaPoint(via.name, np.array(via.position)) for via in found.via),
            pushed=_pushed(rows),
            **_judged(found, scene, robot, curves),
        )
    except InvalidSceneError:
        raise
    except OptiPrompError as error:
        raise InvalidRequestError(f"{path}: {error.message}") from None
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(step) for step in first["loc"])
        raise InvalidRequestError(
            f"{path}: {where}: {first['msg']}; not a plan that this version wrote"
        ) from None
    except (KeyError, TypeError, ValueError) as error:
        raise InvalidRequestError(f"{path}: not a plan that this version wrote ({error})") from None


def _judged(
    found: _PlanFile, scene: Scene, robot: Robot, curves: Sequence[Trajectory]
) -> dict[str, Any]:
    """Metrics and contacts of the trajectory, the first of the curves."""
    curve = curves[0]
    if any(one.joint_names != robot.joint_names for one in curves):
        raise InvalidRequestError(
            f"waypoints.npz has the joints {', '.join(curve.joint_names)}; {robot.name} has "
            f"{', '.join(robot.joint_names)}"
        )
    if found.first >= curve.n_waypoints:
        raise InvalidRequestError(f"first is {found.first}: must be below {curve.n_waypoints}")
    start = State(curve.positions[0], curve.velocities[0], curve.accelerations[0])
    harm = found.predicted_harm
    known = harm is not None and push_model(resolve(scene, robot), curve.positions[-1]) is not None
    judged = judge(scene, robot, curve, start, stem_side=not known)
    wrong = judged.message or (str(harm) if harm is not None and harm.harmful else "")
    if found.status == Code.SUCCESS and wrong:
        raise InvalidRequestError(f"status is success, and the trajectory is none: {wrong}")
    return {"metrics": judged.metrics, "contacts": judged.contacts}


def _pushed(rows: Mapping[str, Any]) -> tuple[FloatArray, FloatArray] | None:
    if PUSHED[0] not in rows:
        return None
    points, axes = (np.asarray(rows[name], dtype=np.float64) for name in PUSHED)
    if (
        points.shape != axes.shape
        or points.shape[1:] != (3,)
        or not np.isfinite(points + axes).all()
    ):
        raise InvalidRequestError(f"{' and '.join(PUSHED)} must be finite, of one shape (P, 3)")
    return points, axes


def _document(plan: Plan, folder: Path) -> dict[str, Any]:
    from importlib.metadata import version

    scene = None
    with suppress(OptiPrompError):  # a mesh made in memory: the plan is still worth writing
        if _alike(resolve(plan.scene).robot, plan.robot):
            scene = scene_to_dict(plan.scene, base_dir=folder)
    return plan.to_dict() | {"format": FORMAT, "version": version("optipromp"), "scene_file": scene}


def _alike(one: Robot, other: Robot) -> bool:
    """Whether two robots have the same name, kind of tool, tool point, tool axis and spheres."""
    return (one.name, type(one.tool)) == (other.name, type(other.tool)) and all(
        np.array_equal(a, b)
        for a, b in (
            (one.tool_point, other.tool_point), (one.tool_axis, other.tool_axis),
            (one.spheres.center, other.spheres.center), (one.spheres.radius, other.spheres.radius),
        )
    )  # fmt: skip


def _waypoints(plan: Plan) -> dict[str, Any]:
    return {
        **arrays(plan.trajectory),
        **arrays(plan.initial, "initial_"),
        **arrays(plan.followed, "followed_"),
        **({} if plan.pushed is None else dict(zip(PUSHED, plan.pushed, strict=True))),
    }
