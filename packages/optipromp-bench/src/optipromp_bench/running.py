"""One scene of the benchmark: an entry is asked, and both engines execute what it gives.

The entry sees a scene named :data:`NEUTRAL`, and a seed of its own: nothing from which the true
scene, the physics or the looks could be drawn again.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import read_npz
from optipromp.core.planning.task import posed
from optipromp.core.trajectory import CURVE, Trajectory
from optipromp_bench import tracks
from optipromp_bench.entrant import Motion
from optipromp_bench.episode import ARENAS, ENGINES, Engine, Episode, as_it_came
from optipromp_bench.experiments.eyes import aimed_at, drawn_camera, without_fruits
from optipromp_bench.experiments.rows import Key, Row
from optipromp_bench.flight import Word
from optipromp_bench.serve import Apart, hired
from optipromp_bench.sets import BITS, DEVELOPMENT, SHORT, drawn, scene_of
from optipromp_sim.generate.plants import untold
from optipromp_sim.simulation import Outcome
from optipromp_sim.simulation.photograph import photograph
from optipromp_sim.simulation.rollouts import Legs, Pick, rollout
from optipromp_sim.situations import CONDITIONS, Situation, varied

NEUTRAL = "scene"
"""Name of every scene that an entry gets."""
STEADY = "none", "zero-mean", "detector", "missed", "calibration"
"""Conditions in which plants stand still, so that the engine ``flight`` has them, too."""


@dataclass(frozen=True)
class Exercise:
    """What is asked of an entry."""

    entry: str  # name, or MODULE:CLASS
    track: tracks.Track  # one of TRACKS
    # of the scene
    preset: str
    seed: int
    condition: str = "none"  # of CONDITIONS
    # of VARIATIONS; empty: none
    variation: str = ""
    engines: tuple[Engine, ...] = ENGINES  # that execute the motion
    word: str = DEVELOPMENT  # of the set, which the entry does not get
    patience: tracks.Patience = tracks.PATIENCE  # the time that the entry has
    digest: str = ""  # of the entry's source, which may not change; empty: it may

    @property
    def keys(self) -> list[Key]:
        """Of its rows."""
        return [Row(self.preset, self.seed, engine=engine).key for engine in self.engines]

    def drawn(self, purpose: str, bits: int = BITS) -> int:
        """The seed of ``physics`` and looks, or of the ``entry``; see :mod:`.sets`."""
        return drawn(self.word, self.preset, self.seed, purpose, bits)


def situated(task: Exercise) -> tuple[Situation, str]:
    """The setting of a task and the digest of its scene."""
    scene, digest = scene_of(task.preset, task.seed)
    seed = task.drawn("physics")
    setting = CONDITIONS[task.condition](scene, seed)
    setting = setting._replace(seen=replace(untold(setting.seen), name=NEUTRAL))
    return varied(setting, task.variation, seed), digest


Deeds = Mapping[Engine, tracks.Deed]
"""By engine: a policy acts anew in each, one trajectory is executed in all."""


def attempted(task: Exercise) -> tuple[list[Row], Deeds]:
    """Ask an entry for its motion in a scene, and execute it in every engine.

    Errors of the entry are rows; those of the task are raised.
    """
    entry = hired(task.entry, task.track, task.patience, task.digest)
    setting, digest = situated(task)
    seed, rows, deeds = task.drawn("entry", SHORT), list[Row](), dict[Engine, tracks.Deed]()
    if task.track != "policy":
        assert isinstance(entry, Apart)
        given = SHOWN[task.track](task, setting)
        try:
            entry.begin()
            deed = tracks.asked(lambda: entry.plan(*given, seed), setting.seen)
        except tracks.EntryError as error:
            return [_row(task, digest, engine, error) for engine in task.engines], {}
        deeds = dict.fromkeys(task.engines, deed)
        return executed_rows(task, setting, digest, deeds), deeds
    for engine in task.engines:
        try:
            entry.begin()
            episode = Episode(setting, task.drawn("physics"), engine=engine)
            deeds[engine], word = tracks.acted(entry, episode, seed)
        except tracks.EntryError as error:
            rows.append(_row(task, digest, engine, error))
            continue
        rows.append(_row(task, digest, engine, word, deeds[engine].thought, episode.time))
    return rows, deeds


def _pictured(task: Exercise, setting: Situation) -> tuple[Any, ...]:
    """A picture, and the scene as known before it."""
    shown = replace(setting.scene, camera=drawn_camera(setting.scene, task.drawn("camera")))
    picture = photograph(shown, "beside", task.drawn("physics")).picture
    return picture, replace(without_fruits(setting.scene), name=NEUTRAL)


SHOWN: Mapping[tracks.Track, Callable[[Exercise, Situation], tuple[Any, ...]]] = {
    "plan": lambda _, setting: (setting.seen,),
    "picture": _pictured,
}
"""What an entry of each track that plans is shown, before its seed."""


def executed_rows(task: Exercise, setting: Situation, digest: str, deeds: Deeds) -> list[Row]:
    """The rows of motions, each executed anew in its engine."""
    return [_executed(task, setting, digest, engine, deed) for engine, deed in deeds.items()]


def _executed(
    task: Exercise, setting: Situation, digest: str, engine: Engine, deed: tracks.Deed
) -> Row:
    seed, reach = task.drawn("physics"), deed.trajectory
    if deed.actions is not None:
        episode = Episode(setting, seed, engine=engine)
        word = rollout(tracks.replay(deed.actions), episode)
        return _row(task, digest, engine, word, deed.thought, episode.time)
    if reach is None:
        return _row(task, digest, engine, deed.why, deed.thought)
    try:
        truth, robot = setting.scene, posed(setting.scene)[0]
        if task.track == "picture":  # the target is the ripe fruit nearest to the tool at the end
            point, _ = robot.tool_pose(reach.positions[-1])
            ripe = [item.id for item in truth.objects if item.role == "target"]
            truth = aimed_at(truth, ripe, np.asarray(point))
        back = deed.back or as_it_came(robot, reach.positions)
        arena = ARENAS[engine](setting._replace(scene=truth), seed, reach.positions[0])
        word = rollout(Legs(reach, back), Pick(arena))
    except (OptiPrompError, RuntimeError, ValueError) as error:
        return _row(task, digest, engine, error, deed.thought)
    return _row(task, digest, engine, word, deed.thought, reach.duration + back.duration)


def _row(
    task: Exercise, digest: str, engine: str, told: Outcome | Word | Exception | str,
    thought: float = 0.0, duration: float = 0.0,
) -> Row:  # fmt: skip
    """What became of one scene in one engine: a judgement, an error, or why it is refused."""
    row = Row(task.preset, task.seed, engine=engine, picked=False, digest=digest, thought=thought)
    if isinstance(told, str | Exception):
        result = "refused" if isinstance(told, str) else "error"
        return replace(row, result=result, cause=tracks.words(str(told)))
    between = "; " if isinstance(told, Word) else " "
    return replace(
        row, result=told.result, picked=bool(told.picked),
        cause=tracks.words(between.join(told.causes)),
        force=round(float(told.unripe_peak_force), 3), duration=round(duration, 4),
    )  # fmt: skip


def rows_and_arrays(task: Exercise) -> tuple[list[Row], dict[str, FloatArray]]:
    """:func:`attempted` with the motions as arrays, for a file."""
    rows, motions = attempted(task)
    if task.track == "policy":
        return rows, {str(k): cast(FloatArray, m.actions) for k, m in motions.items()}
    return rows, next(iter(motions.values())).arrays() if motions else {}


def again(task: Exercise, content: bytes, where: str) -> list[Row]:
    """The rows of a motion from a file's content, executed once more."""
    arrays = read_npz(where, content=content, most=tracks.MOTION_FILE)
    wanted = set(task.engines if task.track == "policy" else (*CURVE, *tracks.BACK))
    for name, array in arrays.items():
        if name not in wanted or array.dtype != np.float64 or not np.isfinite(array).all():
            raise InvalidRequestError(
                f"{where} has {name} of type {array.dtype}; must be finite float64, of "
                f"{', '.join(sorted(wanted))}"
            )
    setting, digest = situated(task)
    count = len(posed(setting.seen)[1].q)
    if task.track == "policy":
        for name, array in arrays.items():
            if array.ndim != 2 or array.shape[1] != count:
                raise InvalidRequestError(
                    f"{where}: {name} has shape {array.shape}; must be k actions of {count} joints"
                )
        motions = {e: tracks.Deed(actions=arrays[e]) for e in task.engines if e in arrays}
        return executed_rows(task, setting, digest, motions)
    if not arrays:
        return []
    if set(arrays) not in (set(CURVE), wanted):
        told = f"must have {CURVE}, and {tracks.BACK} or none of these"
        raise InvalidRequestError(f"{where} has {', '.join(arrays)}; {told}")
    names = posed(setting.seen)[0].joint_names
    parts = (CURVE, tracks.BACK)[: len(arrays) // len(CURVE)]
    named = [{own: arrays[name] for own, name in zip(CURVE, part, strict=True)} for part in parts]
    given = Motion(*(Trajectory(**curve, joint_names=names) for curve in named))
    if wrong := tracks.refusal(given, setting.seen):
        raise InvalidRequestError(f"{where} holds a motion that no controller takes: {wrong}")
    return executed_rows(task, setting, digest, dict.fromkeys(task.engines, tracks.Deed(*given)))
