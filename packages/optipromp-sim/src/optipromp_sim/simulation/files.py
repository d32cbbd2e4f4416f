"""Runs as files: ``rollout.npz``, ``outcome.json`` and, of closed loops, ``loop.npz``."""

import math
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core import files
from optipromp.core.arrays import BoolArray, FloatArray, IntArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.scenes.io import scene_to_dict
from optipromp_sim.simulation.execute import Loop, Run
from optipromp_sim.simulation.parameters import SimulationParameters


def run_document(run: Run) -> dict[str, Any]:
    """The JSON document of a run: its outcome, seed, version and times."""
    from importlib.metadata import version

    return {
        "scene": run.scene.name,
        "seed": run.seed,
        "version": version("optipromp"),
        **run.outcome.to_dict(),
        "seconds": run.seconds,
        "real_time_factor": run.real_time_factor,
    }


def write_run(
    run: Run, folder: Path, further: Mapping[str, bytes] | None = None
) -> tuple[str, ...]:
    """Write ``rollout.npz``, further files and, last, ``outcome.json``; each whole or not at all.

    Returns: The names of the files.
    """
    scene = None
    with suppress(OptiPrompError):  # a mesh that has no file
        scene = scene_to_dict(run.scene, base_dir=folder)
    contents = {
        "rollout.npz": files.npz(run.rollout.arrays(), compressed=True),
        **(further or {}),
        "outcome.json": files.json_text(
            run_document(run) | {"scene_file": scene, "parameters": asdict(run.parameters)}
        ).encode("utf-8"),
    }
    for name, content in contents.items():
        files.write_atomically(folder / name, content)
    return tuple(contents)


def read_parameters(document: Mapping[str, Any]) -> SimulationParameters:
    """The parameters in the document of ``outcome.json``; without any, the defaults."""
    groups, default = document.get("parameters") or {}, SimulationParameters()
    made = {}
    try:
        for name, group in groups.items():
            usual = getattr(default, name)
            known = asdict(usual)
            values = {key: math.inf if value is None else value for key, value in group.items()}
            for key, value in values.items():
                if _kind(value) is not _kind(known[key]):
                    raise TypeError(f"{name}.{key} is {value!r}")
            made[name] = type(usual)(**values)
        return SimulationParameters(**made)
    except (AttributeError, KeyError, TypeError) as error:
        raise InvalidRequestError(
            f"the parameters are not those of this version ({error})"
        ) from None


def _kind(value: object) -> type:
    """The type of a value; whole numbers count as the others."""
    return float if type(value) is int else type(value)


NAME = "loop.npz"
POINTS = 20  # of the path ahead, at each cycle: a choice

TEXTS = "stages", "ids", "begun", "reasons"
# type and shape of each array; see ``LoopRecord`` and ``POINTS``
ARRAYS: dict[str, tuple[type, str]] = {
    "times": (float, "C"),
    "plans": (int, "C"),
    "positions": (float, "CF3"),
    "covariance": (float, "CF33"),
    "confirmed": (bool, "CF"),
    "ahead": (float, "CP3"),
    "decided": (float, "D"),
    "last": (float, "n"),
    "looked": (float, "L2"),
    "discs": (float, "K5"),
}

Words = tuple[str, ...]


@dataclass(frozen=True, eq=False)
class LoopRecord:
    """What a controller saw and did in C cycles, of at most F tracked fruits, and D decisions."""

    times: FloatArray  # (C,) of the cycles [s]
    stages: Words  # C stages, words of :class:`~optipromp_loop.control.controller.LoopStage`
    plans: IntArray  # (C,) number of plans that were followed until then
    ids: Words  # names of the F tracks
    positions: FloatArray  # (C, F, 3) [m]; NaN where there was no such track
    covariance: FloatArray  # (C, F, 3, 3) of the positions [m²]; NaN as above
    confirmed: BoolArray  # (C, F) whether the track counted as a fruit
    # (C, 20, 3) tool points of the curve that runs, from now to its end [m]; NaN while no curve
    # runs
    ahead: FloatArray
    decided: FloatArray  # (D,) times of the decisions [s]
    begun: Words  # D stages that began
    reasons: Words  # D reasons
    last: FloatArray  # (n,) configuration at the end, which the rollout of the same pick has, too
    looked: FloatArray  # (L, 2) time [s] and full angle of view [rad] of each look
    # (K, 5) of each detection the row of its look, column and row of its middle and its radius, all
    # over its depth, and 1 for a target, else 0
    discs: FloatArray

    def sight(self, time: float) -> tuple[float, float, FloatArray] | None:
        """Age [s], angle of view [rad] and discs (k, 4) of the last look at a ``time`` [s].

        Looks count from their exposure on. Before the first there is none.
        """
        row = int(np.searchsorted(self.looked[:, 0], time + 1e-9)) - 1
        if row < 0:
            return None
        at, view = self.looked[row]
        return max(time - float(at), 0.0), float(view), self.discs[self.discs[:, 0] == row, 1:]

    def row(self, time: float) -> int:
        """The last cycle until a ``time`` [s]; the first before."""
        return max(int(np.searchsorted(self.times, time + 1e-9)) - 1, 0)

    def tracks(self, row: int) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Positions (k, 3), covariances (k, 3, 3) and confirmation (k,) of a cycle's tracks."""
        there = np.isfinite(self.positions[row, :, 0])
        return self.positions[row, there], self.covariance[row, there], self.confirmed[row, there]

    def why(self, time: float) -> str:
        """The reason of the last decision until a ``time`` [s]; empty before the first."""
        made = int(np.searchsorted(self.decided, time + 1e-9))
        return self.reasons[made - 1] if made else ""

    def path(self, row: int) -> FloatArray:
        """The points (k, 3) of the path ahead in a cycle [m]; none while the tool stands."""
        points = self.ahead[row]
        moves = np.isfinite(points).all() and float(np.ptp(points, axis=0).max()) > 1e-4  # [m]
        return points if moves else np.zeros((0, 3))

    def belongs(self, rollout: Mapping[str, Any]) -> bool:
        """Whether the arrays of a rollout are those of the same pick."""
        return np.array_equal(self.last, rollout["q"][-1])

    def words(self, row: int) -> str:
        """Stage and plan of a cycle in words."""
        stage = self.stages[row].replace("_", " ")
        return f"{stage}, plan {self.plans[row]}" if self.plans[row] else stage


def record_of(loop: Loop, points: int = POINTS) -> LoopRecord:
    """The record of a pick in closed loop, with so many ``points`` of the path ahead."""
    trace, robot = loop.trace, loop.run.robot
    ids = tuple(dict.fromkeys(name for tracked in trace.tracks for name in tracked.ids))
    column = {name: k for k, name in enumerate(ids)}
    shape = len(trace.times), len(ids)
    positions = np.full((*shape, 3), np.nan)
    covariance = np.full((*shape, 3, 3), np.nan)
    confirmed = np.zeros(shape, dtype=bool)
    for row, tracked in enumerate(trace.tracks):
        at = [column[name] for name in tracked.ids]
        positions[row, at], covariance[row, at] = tracked.positions, tracked.covariance
        confirmed[row, at] = tracked.confirmed
    ahead = np.full((shape[0], points, 3), np.nan)
    begins = np.array([stretch.begins for stretch in trace.stretches])
    for row, time in enumerate(trace.times.tolist()):
        running = int(np.searchsorted(begins, time + 1e-9)) - 1
        if running >= 0:
            begin, curve = begins[running], trace.stretches[running].curve
            now = min(max(time - begin, 0.0), curve.duration)
            q = curve.sample(np.linspace(now, curve.duration, points))[0]
            ahead[row] = robot.tool_pose(q)[0]
    events = loop.controller.history
    looks = sorted(trace.looks, key=lambda look: look.time)
    discs = [
        (row, *(item.position[:2] / item.position[2]), item.radius / item.position[2],
         item.role == "target")
        for row, look in enumerate(looks)
        for item in look.detections
        if item.position[2] > 0.0
    ]  # fmt: skip
    return LoopRecord(
        trace.times, tuple(str(stage) for stage in trace.stages), trace.plans, ids, positions,
        covariance, confirmed, ahead, np.array([event.time for event in events], dtype=float),
        tuple(str(event.stage) for event in events), tuple(event.why for event in events),
        loop.run.rollout.q[-1],
        np.array([(look.time, look.view) for look in looks]).reshape(-1, 2),
        np.array(discs, dtype=float).reshape(-1, 5),
    )  # fmt: skip


def write_loop(loop: Loop, folder: Path) -> str:
    """Write ``loop.npz`` into a folder, whole or not at all; returns the file's name."""
    record = record_of(loop)
    words = {name: np.array(getattr(record, name), dtype=np.str_) for name in TEXTS}
    arrays = {name: getattr(record, name) for name in ARRAYS}
    files.write_atomically(folder / NAME, files.npz(words | arrays, compressed=True))
    return NAME


def read_loop(path: Path) -> LoopRecord:
    """The record in a file that :func:`write_loop` wrote."""
    data = {"looked": np.zeros((0, 2)), "discs": np.zeros((0, 5)), **files.read_npz(path)}
    with files.reading(path, "not a record of a closed loop"):
        words: dict[str, Any] = {name: files.texts(data[name]) for name in TEXTS}
        cycles, fruits, decisions = (len(words[name]) for name in ("stages", "ids", "begun"))
        if not cycles or len(words["reasons"]) != decisions:
            told = f"{cycles} cycles, {decisions} decisions and {len(words['reasons'])} reasons"
            raise ValueError(f"it has {told}: must have a reason for each decision")
        sizes = {"C": cycles, "F": fruits, "D": decisions, "P": POINTS}
        return LoopRecord(**words, **files.members(data, ARRAYS, sizes))


def ellipsoids(covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Half axes (k, 3) [m] of one standard deviation, and rotations (k, 3, 3) of the ellipsoids of
    covariances (k, 3, 3) [m²]."""
    values, turns = np.linalg.eigh(covariance)
    turns[np.linalg.det(turns) < 0.0, :, 0] *= -1.0
    return np.sqrt(np.maximum(values, 1e-8)), turns  # [m²] at least 0.1 mm
