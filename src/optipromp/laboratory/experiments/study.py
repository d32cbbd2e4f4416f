"""A study: presets × planners × seeds on all cores, resumable, one row a run.

One process appends each row, whole, to ``rows.csv``; a study that begins again in the same folder
runs what is missing. ``study.json`` holds the settings that all rows share.
"""

import functools
import itertools
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any, cast

from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.files import check_folder
from optipromp.core.planning import PlanOptions
from optipromp.core.planning.planner import factory
from optipromp.core.robots.library import NOTHING, Choice
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.values import suggest
from optipromp.laboratory.experiments.baselines import STUDY_PLANNERS
from optipromp.laboratory.experiments.cluster import over
from optipromp.laboratory.experiments.eyes import check_eyes
from optipromp.laboratory.experiments.locking import locked
from optipromp.laboratory.experiments.loops import (
    LOOP_PLANNER,
    LoopChoice,
    check_loops,
    run_loops,
)
from optipromp.laboratory.experiments.row_files import FOLDER, RowFile
from optipromp.laboratory.experiments.runs import (
    Key,
    Row,
    run_scene,
    source_version,
    warm_up,
)
from optipromp.laboratory.experiments.sources import OWN, Source, digests
from optipromp.laboratory.experiments.variations import VARIATIONS
from optipromp.laboratory.generate import NOISES, PANDA, PRESETS, Noise, Preset

LOCK = ".lock"


@dataclass(frozen=True)
class Study:
    """The runs of a study.

    ``presets``: of the scenes. ``planners``: to compare. ``seeds``: first seed, and the last plus
    one. ``noise_position``: standard deviation of detected positions [m]. ``noise_angle``: standard
    deviation of detected stem directions [degrees]. ``only_valid``: plans that the judge refuses
    are not executed, and count as failures. ``robot``: name or path of the robot of the scenes.
    ``choice``: of the arm in the robot's file. ``vary``: every plan is executed under all of
    :data:`VARIATIONS`. ``noise``: name in :data:`optipromp.laboratory.generate.NOISES`, in place of
    the deviations. ``risk``: share of promised successes that may be broken. ``loops``: of
    :data:`optipromp.laboratory.experiments.loops.LOOPS`; the planner is opti-promp. Empty: planners
    are compared. ``conditions``: of :data:`optipromp.laboratory.experiments.conditions.CONDITIONS`;
    of loops. ``eyes``: of :data:`optipromp.laboratory.experiments.eyes.WAYS`, in place of
    conditions. ``finder``: of the fruits in rendered pictures, see
    :func:`optipromp.perception.detector.finder_named`. ``views``: pictures from as many sides are
    fused before a plan: 1 or 2. ``files``: scene files, whose names stand for presets; see
    :meth:`of_files`.
    """

    presets: tuple[str, ...] = PRESETS
    planners: tuple[str, ...] = STUDY_PLANNERS
    seeds: tuple[int, int] = (0, 20)
    noise_position: float = 0.0
    noise_angle: float = 0.0
    only_valid: bool = False
    robot: str | Path = PANDA
    choice: Choice = NOTHING
    vary: bool = False
    noise: str = ""
    risk: float = PlanOptions.risk
    loops: tuple[str, ...] = ()
    conditions: tuple[str, ...] = ("none",)
    eyes: tuple[str, ...] = ()
    finder: str = "geometry"
    views: int = 1
    files: tuple[Path, ...] = ()

    @classmethod
    def of_files(cls, files: Sequence[Path], **given: Any) -> "Study":
        """A study of scene files, by default of their own robots and of seed 0; refuses others."""
        for file in files:
            load_scene(file)
        names = tuple(file.name for file in files)
        return cls(names, files=tuple(files), **{"seeds": (0, 1), "robot": OWN} | given)

    def __post_init__(self) -> None:
        for name, given, valid in (
            ("preset", self.presets, tuple(file.name for file in self.files) or PRESETS),
            ("planner", self.planners, STUDY_PLANNERS),
        ):
            if not given:
                raise InvalidRequestError(f"no {name}: valid are {', '.join(valid)}")
            for item in given:
                if name == "planner":
                    factory(item)  # refuses an unknown name
                elif item not in valid:
                    raise InvalidRequestError(f"{name} is {item!r}: {suggest(item, valid)}")
            if len(set(given)) < len(given):
                raise InvalidRequestError(f"a {name} is named twice: {', '.join(given)}")
        first, end = self.seeds
        if not 0 <= first < end:
            raise InvalidRequestError(
                f"seeds are {first}:{end}; the first must not be negative, the end (which is not "
                "run) must be above it"
            )
        if self.noise and self.noise not in NOISES:
            raise InvalidRequestError(f"noise is {self.noise!r}: {suggest(self.noise, NOISES)}")
        if Noise(self.noise_position, self.noise_angle) != Noise() and self.noise:
            raise InvalidRequestError(f"noise {self.noise} and a deviation: state one of them")
        PlanOptions(risk=self.risk)  # refuses an invalid risk
        self._check_loops()

    def _check_loops(self) -> None:
        check_loops(self.loops, self.conditions)
        check_eyes(self.eyes, self.finder, self.views)
        if self.eyes and (not self.loops or self.conditions != ("none",)):
            raise InvalidRequestError("eyes are of loops, and take the place of conditions")
        if not self.loops:
            if self.conditions != ("none",):
                raise InvalidRequestError("conditions are of loops: state loops, too")
            return
        for name, given in (("loop", self.loops), ("condition", self.eyes or self.conditions)):
            if not given:
                raise InvalidRequestError(f"no {name} is named")
            if len(set(given)) < len(given):
                raise InvalidRequestError(f"a {name} is named twice: {', '.join(given)}")
        if self.planners != (LOOP_PLANNER,):
            raise InvalidRequestError(
                f"planners are {', '.join(self.planners)}; loops have one, {LOOP_PLANNER}"
            )
        noise = self.noise or Noise(self.noise_position, self.noise_angle) != Noise()
        if noise or self.vary or self.only_valid:
            raise InvalidRequestError(
                "loops take no noise, variations or refusals: their conditions have them"
            )

    def source(self, name: str) -> Source:
        """The source of the scenes of a preset, or of a file's name."""
        paths = {file.name: file for file in self.files}
        return paths[name] if self.files else cast(Preset, name)

    def scenes(self) -> Iterator[tuple[str, int]]:
        """Preset and seed of every scene, seeds outermost: a study cut short is a smaller one."""
        for seed in range(*self.seeds):
            for preset in self.presets:
                yield preset, seed

    @property
    def variations(self) -> tuple[str, ...]:
        """Names of the variations; an empty one for none."""
        return tuple(VARIATIONS) if self.vary else ("",)

    def __len__(self) -> int:
        return len(self.keys())

    def keys(self) -> list[Key]:
        """The keys of all rows, in the study's order."""
        conditions = self.eyes or self.conditions if self.loops else ("",)
        return [
            (*scene, planner, variation, loop, condition)
            for scene in self.scenes()
            for planner in self.planners
            for variation in self.variations
            for condition in conditions
            for loop in self.loops or ("",)
        ]

    def common(self) -> dict[str, Any]:
        """The settings that all rows of one folder share, by name."""
        return {
            "noise_position": self.noise_position,
            "noise_angle": self.noise_angle,
            "only_valid": self.only_valid,
            **({} if self.robot == PANDA else {"robot": f"{self.robot} {self.choice}"}),
            "vary": self.vary,
            **({"noise": self.noise} if self.noise else {}),
            "version": source_version(),
            "risk": self.risk,
            **({"loops": True} if self.loops else {}),
            **({"finder": self.finder, "views": self.views} if self.eyes else {}),
            **({"scenes": dict(digests(self.files))} if self.files else {}),
            **({FOLDER: str(self.files[0].absolute().parent)} if self.files else {}),
        }


def run_study(
    study: Study,
    folder: Path,
    *,
    workers: int | None = None,
    ray: str | None = None,
    progress: Callable[[int, int, Row | None], None] | None = None,
) -> list[Row]:
    """Run the runs of a study that its folder does not hold yet.

    Ctrl-C lets the scenes under way finish, keeps their rows and raises ``KeyboardInterrupt``.

    ``study``: what to run. ``folder``: holds the rows of earlier calls, and gets the new ones.
    ``workers``: number of processes; None: one a core. ``ray``: address of a Ray cluster in place
    of them; see :func:`optipromp.laboratory.experiments.cluster.over`. ``progress``: called with
    the number of runs done, of all runs, and the newest row (None at the beginning).

    Returns: The study's rows, those of earlier calls too, in the study's order.
    """
    if workers is not None and workers < 1:
        raise InvalidRequestError(f"workers is {workers}; it must be at least 1")
    if find_spec("mujoco") is None:
        raise InvalidRequestError(f"a study needs MuJoCo: {installed_by('sim')}")
    check_folder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    with locked(folder / LOCK):
        return _run(study, RowFile(folder, study.common()), workers, ray, progress)


def _run(
    study: Study,
    file: RowFile,
    workers: int | None,
    ray: str | None,
    progress: Callable[[int, int, Row | None], None] | None,
) -> list[Row]:
    """Run what is missing in the open file of a study; returns the study's rows in its order."""
    done = {row.key for row in file.rows}
    keys = study.keys()
    missing = [key for key in keys if key not in done]
    finished, total = sum(key in done for key in keys), len(keys)
    if progress is not None:
        progress(finished, total, None)

    def hear(index: int, result: Sequence[Row] | BrokenProcessPool) -> None:
        nonlocal finished
        if isinstance(result, BrokenProcessPool):
            raise InvalidRequestError(f"{result}; begin the study again to go on")
        for row in result:
            if row.key in done:
                continue
            file.append(row)
            done.add(row.key)
            finished += 1
            if progress is not None:
                progress(finished, total, row)

    function, jobs = _jobs(study, missing)
    robot = study.robot, study.choice
    over(
        function,
        jobs,
        hear,
        workers=workers,
        ray=ray,
        prepare=functools.partial(warm_up, study.source(study.presets[0]), study.planners, *robot),
    )
    held = {row.key: row for row in file.rows}
    return [held[key] for key in keys]


def _jobs(study: Study, missing: Sequence[Key]) -> tuple[Callable[..., list[Row]], list[Any]]:
    """A function, and its arguments for each group of missing rows."""
    if study.loops:
        finder = study.finder if study.eyes else ""
        given = LoopChoice(
            study.robot, study.choice, study.risk, source_version(), finder, study.views
        )
        by_condition = itertools.groupby(missing, key=lambda key: (key[0], key[1], key[5]))
        return run_loops, [
            (study.source(name), *rest, tuple(key[4] for key in group), given)
            for (name, *rest), group in by_condition
        ]
    noise = study.noise or Noise(study.noise_position, study.noise_angle)
    common = (
        noise, source_version(), study.only_valid, study.robot, study.choice, study.vary, study.risk
    )  # fmt: skip
    by_scene = itertools.groupby(missing, key=lambda key: key[:2])
    return run_scene, [
        (study.source(name), seed, tuple(dict.fromkeys(key[2] for key in group)), *common)
        for (name, seed), group in by_scene
    ]
