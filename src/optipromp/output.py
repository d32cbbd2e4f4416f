"""Plans as files, and back.

``plan.json`` holds everything but the curves. ``trajectory.csv`` and ``trajectory.npz`` hold the
executable curve at a controller's rate. ``waypoints.npz`` holds the rows that define the three
curves of a plan.
"""

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.documents import read_document
from optipromp.errors import Code, InvalidRequestError, InvalidSceneError, OptiPrompError
from optipromp.files import json_text, npz, read_npz, write_atomically
from optipromp.judging import Metrics, Overlap
from optipromp.planning import Plan, Term
from optipromp.planning.result import Stage, ViaPoint
from optipromp.planning.task import resolve
from optipromp.pushing.model import Prediction
from optipromp.robots.model import Robot
from optipromp.scenes.io import scene_from_dict, scene_to_dict
from optipromp.trajectory_files import arrays, csv, from_arrays

__all__ = ["load_plan", "write_plan"]

FORMAT = 3
PUSHED = ("pushed_points", "pushed_axes")
RATE = 1000.0  # [Hz] of the Panda's control interface


def write_plan(
    plan: Plan, folder: Path, further: Mapping[str, bytes] | None = None, *, rate: float = RATE
) -> tuple[str, ...]:
    """Write a plan into ``folder``, each file whole or not at all, ``plan.json`` last.

    Args:
        plan: any plan, also one that failed.
        folder: made if need be; files of an earlier plan are replaced.
        further: more files by name (figures), written along.
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
        **(further or {}),
        "plan.json": json_text(_document(plan, folder)).encode("utf-8"),
    }
    for name, content in files.items():
        write_atomically(folder / name, content)
    return tuple(files)


def load_plan(path: Path | str) -> Plan:
    """Load what :func:`write_plan` left: a folder, or the ``plan.json`` in it.

    Raises:
        InvalidRequestError: files missing, damaged, or of another format; the message names them.
        InvalidSceneError: the scene the plan was made for cannot be used.
    """
    path = Path(path)
    folder = path if path.is_dir() else path.parent
    file = folder / "plan.json" if path.is_dir() else path
    document = read_document(file, InvalidRequestError, "a plan")
    rows = read_npz(folder / "waypoints.npz")
    try:
        if document["format"] != FORMAT:
            raise InvalidRequestError(f"format {document['format']!r} is unknown, not {FORMAT}")
        if document["scene_file"] is None:
            raise InvalidRequestError(
                "its scene was not written: it held a shape made in memory, or the plan was made "
                "with another robot or tool than the scene's"
            )
        scene = scene_from_dict(document["scene_file"], base_dir=folder, source=str(path))
        found = document["predicted_harm"]
        return Plan(
            scene=scene,
            robot=resolve(scene).robot,
            planner=document["planner"],
            strategy=document["strategy"],
            seed=document["seed"],
            status=Code(document["status"]),
            message=document["message"],
            trajectory=from_arrays(rows),
            initial=from_arrays(rows, "initial_"),
            followed=from_arrays(rows, "followed_"),
            prediction=Prediction(**found) if found else None,
            metrics=Metrics(**document["metrics"]),
            terms={name: Term(**_tuples(term)) for name, term in document["terms"].items()},
            stages=tuple(Stage(**_tuples(stage)) for stage in document["stages"]),
            contacts=tuple(Overlap(**contact) for contact in document["contacts"]),
            time=document["time"],
            first=document["first"],
            via=tuple(ViaPoint(v["name"], np.array(v["position"])) for v in document["via"]),
            pushed=(rows[PUSHED[0]], rows[PUSHED[1]]) if PUSHED[0] in rows else None,
        )
    except InvalidSceneError:
        raise
    except OptiPrompError as error:
        raise InvalidRequestError(f"{path}: {error.message}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InvalidRequestError(f"{path}: not a plan that this version wrote ({error})") from None


def _tuples(values: Mapping[str, Any]) -> dict[str, Any]:
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}


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
