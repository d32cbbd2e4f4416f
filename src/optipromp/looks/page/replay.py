"""Replays of executed plans: arm, objects and contacts, one plan or two side by side."""

import functools
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, InvalidSceneError, OptiPrompError
from optipromp.core.files import is_file, is_folder, is_there, read_npz, reading
from optipromp.core.output import load_plan
from optipromp.core.planning import Plan
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.io import load_scene, scene_from_dict, scene_names
from optipromp.core.scenes.scene import Scene
from optipromp.laboratory.experiments.rows import ROWS
from optipromp.laboratory.simulation.files import NAME, LoopRecord, read_loop, read_parameters
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.looks.page.stage import PlanNodes
from optipromp.perception.pictures import OVERLAY, Image8, read_pixels

ROLLOUTS_APART = 1.3  # [m] between two rollouts side by side
LEAST_FORCE = 0.02  # [N] a contact with less force is not drawn


@dataclass(frozen=True, eq=False)
class Replay:
    """An executed plan.

    Attributes:
        name: shown to the user.
        scene, robot, seed: of the world.
        arrays: of :meth:`optipromp.laboratory.simulation.rollout.Rollout.arrays`.
        success: whether the target alone was picked and nothing was harmed.
        message: of the outcome.
        parameters: of the physics.
        record: of the controller; None for a plan that was executed without looking.
    """

    name: str
    scene: Scene
    robot: Robot
    seed: int
    arrays: dict[str, Any]
    success: bool
    message: str
    parameters: SimulationParameters
    record: LoopRecord | None = None

    @property
    def duration(self) -> float:
        """Time of the last record [s]."""
        return float(self.arrays["times"][-1])

    @functools.cached_property
    def _moving(self) -> Any:
        from optipromp.laboratory.simulation.execute import Moving
        from optipromp.laboratory.simulation.world import build

        return Moving(build(self.scene, self.robot, self.parameters, self.seed))

    def show(self, stage: PlanNodes, now: float) -> str:
        """Show arm, objects, contacts and what the controller thinks at the time ``now`` [s].

        Returns: Forces and stage in words.
        """
        arrays = self.arrays
        row = int(np.abs(arrays["times"] - now).argmin())
        stage.pose(arrays["q"][row])
        for moved in self._moving.at(arrays["states"][row]):
            stage.put(*moved)
        found = arrays["contacts"][arrays["contacts"][:, 0] == row]
        felt = found[np.linalg.norm(found[:, 6:], axis=1) > LEAST_FORCE]
        stage.forces(felt[:, 3:6], felt[:, 6:])
        told = [self._words(felt)]
        if self.record is not None:
            told = [self._thought(stage, self.record, now), *told]
        return "  \n".join(filter(None, told))

    def _thought(self, stage: PlanNodes, record: LoopRecord, now: float) -> str:
        """Show tracks and path ahead; returns the stage, and why it began, in words."""
        row = record.row(now)
        stage.tracks(*record.tracks(row))
        stage.ahead(record.path(row), int(record.plans[row]), record.stages[row] == "retreat")
        why = record.why(now)
        return f"**{record.words(row)}**" + (f": {why}" if why else "")

    def _words(self, felt: FloatArray) -> str:
        names = [entity.label for entity in self._moving.world.entities]
        pairs: dict[str, FloatArray] = {}
        for row in felt:
            key = f"{names[int(row[1])]} on {names[int(row[2])]}"
            pairs[key] = pairs.get(key, np.zeros(3)) + row[6:]
        return "  \n".join(f"{key}: {np.linalg.norm(force):.2f} N" for key, force in pairs.items())


def load_replay(folder: Path) -> Replay:
    """The replay of what ``optipromp simulate`` left in a folder."""
    outcome = read_document(folder / "outcome.json", InvalidRequestError, "an outcome")
    arrays: dict[str, Any] = dict(read_npz(folder / "rollout.npz"))
    with reading(folder, "not a rollout that this version wrote", passes=(InvalidSceneError,)):
        scene = scene_from_dict(outcome["scene_file"], base_dir=folder, source=str(folder))
        robot = posed(scene)[0]
        if arrays["contacts"].shape[1] != 9 or arrays["q"].shape[1] != robot.n_joints:
            raise InvalidRequestError(f"{folder}: its arrays do not fit its scene")
        record = read_loop(folder / NAME) if is_file(folder / NAME) else None
        if record is not None and not record.belongs(arrays):  # of an earlier run
            record = None
        return Replay(folder.name, scene, robot, int(outcome["seed"]), arrays,
                      bool(outcome["success"]), str(outcome["message"]),
                      read_parameters(outcome), record)  # fmt: skip


def execute(plan: Plan, name: str) -> Replay:
    """Execute a plan in the simulation."""
    from optipromp.laboratory.simulation import simulate

    run = simulate(plan, seed=plan.seed)
    arrays = {key: np.asarray(value) for key, value in run.rollout.arrays().items()}
    return Replay(name, run.scene, run.robot, run.seed, arrays, run.success, run.outcome.message,
                  run.parameters)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Source:
    """A scene, its plan, executed plans of it, and the picture in which it was seen, if any."""

    scene: Scene
    plan: Plan | None = None
    replays: tuple[Replay, ...] = ()
    seen: Image8 | None = None


def open_source(item: str, beside: str | None = None) -> Source:
    """The source in a scene file, a built-in scene, or a folder of a plan or a rollout.

    ``item``: name or path. ``beside``: a second folder of a rollout, replayed beside the first.
    """
    folder = Path(item)
    replays = tuple(
        load_replay(Path(name))
        for name in (item, beside)
        if name is not None and is_there(Path(name) / "rollout.npz")
    )
    if beside is not None and len(replays) < 2:
        raise InvalidRequestError(f"{item} and {beside} are not both folders of a rollout")
    if is_folder(folder) and item not in scene_names():
        if is_there(folder / ROWS):
            raise InvalidRequestError(
                f"{item} is a study: 'optipromp report {item}' writes a page about it"
            )
        if is_there(folder / "plan.json"):
            plan = load_plan(folder)
            return Source(plan.scene, plan, replays, _seen(folder / "seen"))
        if replays:
            return Source(replays[0].scene, None, replays)
        raise InvalidRequestError(
            f"{item} holds neither a plan (plan.json) nor a rollout (rollout.npz)"
        )
    if folder.name == "plan.json":
        return open_source(str(folder.parent), beside)
    return Source(load_scene(item), seen=_seen(folder))


def _seen(scene: Path) -> Image8 | None:
    """The picture that ``see`` left beside a scene; None: there is none that can be read."""
    picture = scene.with_suffix(OVERLAY)
    if is_file(picture):
        with suppress(OptiPrompError):
            return read_pixels(picture, "RGB").astype("uint8")
    return None
