"""Trials: scenes are placed, planned or looped in, and executed; each is a row.

The planners of a study plan once a scene, and their plan is executed in one situation or in all
variations. Loops run in one situation each: a condition, or what eyes have seen.
"""

import functools
import hashlib
import math
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from optipromp.core.arrays import lengths
from optipromp.core.errors import Code, InvalidRequestError, OptiPrompError, check_one_of
from optipromp.core.planning import Picked, Plan, PlanOptions, planner_names
from optipromp.core.planning.legs import led_out, legs_of, plan_whole, takes
from optipromp.core.planning.planners import factory, make
from optipromp.core.planning.result import REACH
from optipromp.core.robots.library import NOTHING, UNTRUSTED, Choice
from optipromp.core.scenes.crops import Crop, crop_in_scene
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import Trajectory
from optipromp_bench.experiments.eyes import NOT_SEEN, Pictures, check_eyes, situation
from optipromp_bench.experiments.rows import ERROR, NO_PLAN, Key, Row, source_version
from optipromp_sim import situations
from optipromp_sim.generate import (
    NOISES,
    PANDA,
    PRESETS,
    Noise,
    Preset,
    crop_of,
    generate_with_report,
    noisy,
)
from optipromp_sim.generate.noise import perceived
from optipromp_sim.simulation import Outcome, Run, simulate
from optipromp_sim.simulation.parameters import bearing
from optipromp_sim.situations import LOOP_PLANNER, LOOPS, loop_figures, picked

STUDY_PLANNERS = (
    "straight", "promp", "i-promp", "i-promp-guard", "drift", "paper", "obstacles", "chomp",
    "opti-promp",
)  # fmt: skip


def study_planners() -> tuple[str, ...]:
    """All registered names: those of :data:`STUDY_PLANNERS` in that order, then all others."""
    known = planner_names()
    ours = tuple(name for name in STUDY_PLANNERS if name in known)
    return ours + tuple(name for name in known if name not in ours)


@dataclass(frozen=True, eq=False)
class Answer:
    """A planner's answer to a scene."""

    planner: str  # its name
    status: Code  # ``success`` only where the judge found no violation
    message: str  # the status in words
    trajectory: Trajectory | None  # to execute; None where the planner has none
    seconds: float  # wall time of planning the reach; with the ways out that led to another one [s]
    harm: float | None = None  # predicted harm of the push; None where no push model applies
    guard: float = 0.0  # time until which the tool's mouth is closed [s]; 0: it is open
    # predicted probability that the pick is not clean; None where it is not predicted
    failure: float | None = None
    tilt: float = 0.0  # angle between the planner's approach and the scene's [degrees]
    legs: Picked | None = None  # reach and way out; None where no target is taken out


def attempt(scene: Scene, planner: str, *, seed: int = 0, risk: float = PlanOptions.risk) -> Answer:
    """Plan a scene with a registered planner, and the way out after it.

    A pick is promised with its way out. It is the same for all planners, and ends with the tool
    away from the plant.

    ``scene``: as detected. ``planner``: one of :func:`study_planners`. ``risk``: share of promised
    successes that may be broken, see :class:`PlanOptions`.
    """
    solver = make(planner)
    options = PlanOptions(risk=risk)
    legs = legs_of(plan_whole(scene, planner=solver, seed=seed, options=options))
    made, told = legs[REACH], legs[REACH].prediction
    moves = bool(np.ptp(made.trajectory.positions, axis=0).max() > 0.0)
    if len(legs) == 1 and moves and takes_out(made):  # refused for its harm, and executed
        legs = led_out(made, options)
    whole = Picked(dict(legs))
    return Answer(
        planner, whole.status, whole.message if len(legs) > 1 else made.message,
        made.trajectory if moves else None, sum(leg.time["total"] for leg in legs.values()),
        None if told is None else told.harm,
        pushed(made) if getattr(solver, "guard", False) else 0.0,
        None if math.isnan(whole.failure) else whole.failure,
        float(np.rad2deg(np.arccos(min(made.scene.frame[2] @ scene.frame[2], 1.0)))),
        whole if moves and takes_out(made) else None,
    )  # fmt: skip


def takes_out(made: Plan) -> bool:
    """Whether a pick goes on with its way out."""
    return made.status in (Code.SUCCESS, Code.HARM_PREDICTED) and takes(made.scene, made.robot)


def pushed(made: Plan) -> float:
    """The time at which the last push of an i-promp plan is done [s]; 0 without a push."""
    if len(made.via) < 3:  # camera, pushes, goal
        return 0.0
    points, _ = made.robot.tool_pose(made.trajectory.positions)
    return float(made.trajectory.times[np.argmin(lengths(points - made.via[-2].position))])


Source = Preset | Path
"""A preset, which draws scenes, or the path of a scene file."""
OWN = ""
"""In place of a robot's name: the robot that a scene file names."""
FOLDER = "folder"  # setting of a study: of the scene files; another one makes no other study


@dataclass(frozen=True)
class Study:
    """The trials of a study."""

    presets: tuple[str, ...] = PRESETS  # of the scenes; the names of ``files``
    planners: tuple[str, ...] = STUDY_PLANNERS  # to compare
    seeds: tuple[int, int] = (0, 20)  # the first, and the last plus one
    noise_position: float = 0.0  # standard deviation of detected positions [m]
    noise_angle: float = 0.0  # standard deviation of detected stem directions [degrees]
    only_valid: bool = False  # plans that the judge refuses are not executed, and count as failures
    robot: str | Path = PANDA  # name or path of the robot of the scenes
    choice: Choice = NOTHING  # of the arm in the robot's file
    # every plan is executed under all of VARIATIONS; crop: with each guess of the crop at its ends
    vary: bool | Literal["crop"] = False
    noise: str = ""  # name in NOISES, in place of the deviations
    risk: float = PlanOptions.risk  # share of promised successes that may be broken
    loops: tuple[str, ...] = ()  # of LOOPS; the planner is opti-promp. Empty: planners are compared
    conditions: tuple[str, ...] = ("none",)  # of CONDITIONS; of loops
    eyes: tuple[str, ...] = ()  # of eyes.WAYS, in place of conditions
    finder: str = "geometry"  # of fruits in rendered pictures, see detector.finder_named
    views: int = 2  # pictures from as many sides are fused before a plan: 1 or 2
    files: tuple[Path, ...] = ()  # scene files, whose names stand for presets; see of_files
    crop: Crop | None = None  # of all scenes; None: that of a scene file

    @classmethod
    def of_files(cls, files: Sequence[Path], **given: Any) -> "Study":
        """A study of scene files, by default of their own robots and of seed 0; refuses others."""
        for file in files:
            load_scene(file)
        names = tuple(file.name for file in files)
        return cls(names, files=tuple(files), **{"seeds": (0, 1), "robot": OWN} | given)

    def __post_init__(self) -> None:
        _check_names("preset", self.presets, [file.name for file in self.files] or PRESETS)
        for planner in self.planners:
            factory(planner)  # refuses an unknown name
        _check_names("planner", self.planners, self.planners or STUDY_PLANNERS)
        first, end = self.seeds
        if not 0 <= first < end:
            raise InvalidRequestError(
                f"seeds are {first}:{end}; the first must not be negative, the end (which is not "
                "run) must be above it"
            )
        if self.noise:
            check_one_of("noise", self.noise, NOISES)
        deviates = Noise(self.noise_position, self.noise_angle) != Noise()
        if deviates and self.noise:
            raise InvalidRequestError(f"noise {self.noise} and a deviation: state one of them")
        PlanOptions(risk=self.risk)  # refuses an invalid risk
        if self.vary == "crop" and self.grown is None:
            raise InvalidRequestError(
                "guesses are varied of one crop: name it (--crop), unless all scene files name the "
                "same"
            )
        check_eyes(self.eyes, self.finder, self.views)
        if self.eyes and (not self.loops or self.conditions != ("none",)):
            raise InvalidRequestError("eyes are of loops, and take the place of conditions")
        if not self.loops:
            if self.conditions != ("none",):
                raise InvalidRequestError("conditions are of loops: state loops, too")
            return
        _check_names("loop", self.loops, LOOPS)
        _check_names("condition", self.eyes or self.conditions, self.eyes or situations.CONDITIONS)
        if self.planners != (LOOP_PLANNER,):
            raise InvalidRequestError(
                f"planners are {', '.join(self.planners)}; loops have one, {LOOP_PLANNER}"
            )
        if self.noise or deviates or self.vary or self.only_valid:
            raise InvalidRequestError(
                "loops take no noise, variations or refusals: their conditions have them"
            )

    def source(self, name: str) -> Source:
        """The source of the scenes of a preset, or of a file's name."""
        paths = {file.name: file for file in self.files}
        return paths[name] if self.files else cast(Preset, name)

    @functools.cached_property
    def grown(self) -> Crop | None:
        """The crop of all scenes; None where there is none, or several."""
        crops = [self.crop] if self.crop else [load_scene(file).crop for file in self.files]
        return crops[0] if crops and all(crop == crops[0] for crop in crops) else None

    @property
    def errors(self) -> Noise:
        """The errors of the detector."""
        return NOISES[self.noise] if self.noise else Noise(self.noise_position, self.noise_angle)

    @property
    def variations(self) -> tuple[str, ...]:
        """Names of the variations; an empty one for none."""
        if self.vary == "crop":
            return tuple(situations.crop_variations(self.grown))
        return tuple(situations.VARIATIONS) if self.vary else ("",)

    def __len__(self) -> int:
        return len(self.keys())

    def keys(self) -> list[Key]:
        """The keys of all rows in the study's order, seeds outermost: cut short, it is smaller."""
        conditions = self.eyes or self.conditions if self.loops else ("",)
        return [
            (preset, seed, planner, variation, loop, condition, "")
            for seed in range(*self.seeds)
            for preset in self.presets
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
            **({} if self.crop is None else {"crop": crop_in_scene(self.crop)}),
            "version": source_version(),
            "risk": self.risk,
            **({"loops": True} if self.loops else {}),
            **({"finder": self.finder, "views": self.views} if self.eyes else {}),
            **({"scenes": dict(digests(self.files))} if self.files else {}),
            **({FOLDER: str(self.files[0].absolute().parent)} if self.files else {}),
        }


def _check_names(what: str, names: Sequence[str], valid: Sequence[str] | Mapping[str, Any]) -> None:
    """Refuse none at all, one that is not valid, and one that stands twice."""
    if not names:
        raise InvalidRequestError(f"no {what} is named: valid are {', '.join(valid)}")
    for name in names:
        check_one_of(what, name, valid)
    if len(set(names)) < len(names):
        raise InvalidRequestError(f"a {what} is named twice: {', '.join(names)}")


def digests(files: Sequence[Path]) -> Mapping[str, str]:
    """A digest of each file's content, by the file's name."""
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest()[:16] for file in files}


def drawn(
    source: Source, seed: int, robot: str | Path, choice: Choice, crop: Crop | None = None
) -> tuple[Scene, int]:
    """The true scene of a source and a seed, and the number of scenes drawn before it.

    A scene file gives the same scene for every seed. ``robot`` takes the place of its own, unless
    it is :data:`OWN`; ``choice`` is of the arm in the robot's file. ``crop``: None: that of
    the scene file, or none.
    """
    if not isinstance(source, Path):
        scene, report = generate_with_report(source, seed, robot, choice, crop)
        return scene, report.redraws
    scene = load_scene(source)
    scene = scene if crop is None else replace(scene, crop=crop)
    if robot != OWN:
        name = str(Path(robot).absolute()) if Path(robot).suffix else str(robot)
        return replace(scene, robot=name, choice=choice), 0
    return replace(scene, choice=replace(choice, untrusted=scene.choice.untrusted)), 0


def detected(source: Source, scene: Scene, seed: int, errors: Noise) -> Scene:
    """A scene as the planner sees it.

    The physical parameters that a preset drew are hidden from the planner. Those that a scene file
    states are known, and without errors of detection the file is seen as it is.
    """
    if not isinstance(source, Path):
        return noisy(scene, seed, errors)
    if errors == Noise():
        return scene
    return perceived(scene, np.random.default_rng([seed, 1]), errors)


def warm_up(source: Source, study: Study) -> None:
    """Load and compile the planners' code, so that no row's time includes it."""
    with suppress(OptiPrompError):  # the rows tell of it
        scene, _ = drawn(source, 0, study.robot, study.choice, study.crop)
        for planner in study.planners:
            attempt(scene, planner)


def run_trials(
    study: Study, preset: str, seed: int, condition: str, contenders: Sequence[str], version: str
) -> list[Row]:
    """All rows of contenders in one scene, which see the same errors; each is a row if it raises.

    ``condition``: of loops; else empty. ``contenders``: loops, or planners in the order in which
    they run. ``version``: written into the rows.
    """
    source = study.source(preset)
    scene, redraws = drawn(source, seed, study.robot, study.choice, study.crop)
    looping = bool(study.loops)
    first = Row(
        preset, seed, planner=LOOP_PLANNER, noise_position=study.errors.position,
        noise_angle=study.errors.angle, noise=study.noise, pushables=len(scene.pushables),
        redraws=redraws, version=version, condition=condition,
        finder=study.finder if study.eyes else "", views=study.views if study.eyes else None,
    )  # fmt: skip
    if looping:
        make = functools.partial(situation, condition, scene, seed, first.finder, study.views)
    else:
        make = functools.partial(_assumed, scene, detected(source, scene, seed, study.errors))
    begin = functools.cache(make)
    planned = functools.cache(lambda planner: _planned(begin(), planner, seed, study))
    rows = []
    for contender in contenders:
        mine = replace(first, loop=contender) if looping else replace(first, planner=contender)
        for variation in study.variations:
            row = replace(mine, variation=variation)
            try:
                row, _ = _tried(row, begin, planned, study)
            except OptiPrompError as error:
                row = _broken(row, str(error.code), error.message)
            except Exception as error:  # the row tells of it, and the study goes on
                row = _broken(row, ERROR, f"{type(error).__name__}: {error}")
            rows.append(row)
    return rows


def again(
    row: Row, robot: str = PANDA, risk: float = PlanOptions.risk, source: Source | None = None,
    crop: Crop | None = None,
) -> Run | None:  # fmt: skip
    """A trial made once more, for its picture; None where its plan is not executed.

    ``robot`` is the name or path of the scene's robot, ``risk`` that of the study, ``source`` the
    scene's where it is a file, ``crop`` that of the study.
    """
    setting = setting_of(row, robot, source, crop)
    study = Study(planners=(row.planner,), risk=risk, loops=(row.loop,) if row.loop else ())
    planned = functools.partial(_planned, setting, seed=row.seed, study=study)
    return _tried(row, lambda: setting, planned, study)[1]


def setting_of(
    row: Row, robot: str = PANDA, source: Source | None = None, crop: Crop | None = None
) -> situations.Situation:
    """What a row's trial was made of.

    The robot's name is from a study's file, so it is untrusted; see
    :class:`optipromp.core.robots.library.Choice`.
    """
    source = source or cast(Preset, row.preset)
    scene, _ = drawn(source, row.seed, robot, UNTRUSTED, crop)
    if row.loop:
        return situation(row.condition, scene, row.seed, row.finder, row.views or 1)
    noise = NOISES[row.noise] if row.noise else Noise(row.noise_position, row.noise_angle)
    return _assumed(scene, detected(source, scene, row.seed, noise))


def _assumed(scene: Scene, seen: Scene) -> situations.Situation:
    return situations.CONDITIONS["none"](scene, 0)._replace(seen=seen)


def _planned(
    setting: situations.Situation, planner: str, seed: int, study: Study
) -> tuple[Answer | None, situations.Situation]:
    """A plan in the scene as first seen, or after one picture more, and that situation.

    The plan is None where loops see no ripe fruit. In loops all plans have the seed 0.
    """
    if study.loops and setting.seen.target is None:
        return None, setting
    seed = 0 if study.loops else seed
    made = attempt(setting.seen, planner, seed=seed, risk=study.risk)
    while made.status != Code.SUCCESS and setting.further is not None:
        further = setting.further()
        if further.seen.target is None:
            break
        setting = further
        made = attempt(setting.seen, planner, seed=seed, risk=study.risk)
    return made, setting


Planned = Callable[[str], tuple[Answer | None, situations.Situation]]
"""The plan of a planner, and the situation that it is of."""


def _tried(
    row: Row, begin: Callable[[], situations.Situation], planned: Planned, study: Study
) -> tuple[Row, Run | None]:
    """The row of one trial, and its run; None: nothing is executed.

    A pick looks again, and its seed is that of physics and looks; else a plan is executed blind in
    the true scene.
    """
    if row.loop not in ("", "open"):
        return _looped(_borne(begin(), row.preset), row)
    made, setting = planned(row.planner)
    row = replace(row, **cast(Pictures, setting.figures))
    if made is None:
        return replace(
            row, plan_status=str(Code.NO_PLAN), cause=NOT_SEEN, message="no ripe fruit is seen",
            result="gave_up",
        ), None  # fmt: skip
    row = replace(
        row, plan_status=str(made.status), plan_time=made.seconds, predicted_harm=made.harm,
        predicted_failure=made.failure, tilt=made.tilt,
    )  # fmt: skip
    heeded = study.only_valid or study.loops
    if made.trajectory is None or (heeded and made.status != Code.SUCCESS):
        result = "refused" if study.loops else ""
        return replace(row, cause=NO_PLAN, message=made.message, result=result), None
    began = time.perf_counter()
    run = _executed(made, setting, row)
    return replace(
        _told(row, run.outcome, setting.scene.target),
        result=run.outcome.result if study.loops else "",
        simulation_time=time.perf_counter() - began,
    ), run


def _borne(setting: situations.Situation, preset: str) -> situations.Situation:
    """A situation with what the stems of the crop bear that a preset's fruits are of."""
    crop = crop_of(preset) if setting.scene.crop is None else None
    return setting._replace(parameters=bearing(setting.parameters, crop))


def _executed(made: Answer, setting: situations.Situation, row: Row) -> Run:
    assert made.trajectory is not None
    setting = _borne(situations.varied(setting, row.variation, row.seed), row.preset)
    p = setting.parameters
    p = replace(p, robot=replace(p.robot, guard_until=made.guard))
    motion = made.legs or made.trajectory
    return simulate(motion, setting.scene, parameters=p, seed=row.seed, failed_leg=True)


def _looped(setting: situations.Situation, row: Row) -> tuple[Row, Run]:
    began = time.perf_counter()
    done = picked(setting, row.seed)
    outcome = done.run.outcome
    said = done.stage == "done" or outcome.success
    row = replace(_told(row, outcome, setting.scene.target), **cast(Pictures, setting.figures))
    return replace(
        row,
        plan_status=str(Code.SUCCESS if said else Code.NO_PLAN),
        result=done.result,
        **loop_figures(done),
        simulation_time=time.perf_counter() - began,
    ), done.run


def _broken(row: Row, status: str, message: str) -> Row:
    result = ERROR if row.loop else ""
    return replace(row, plan_status=status, cause=ERROR, message=message, result=result)


def _told(row: Row, outcome: Outcome, target: SceneObject | None) -> Row:
    """The row with the outcome of a run in a scene with that ``target``."""
    static = (contact.peak_force for contact in outcome.static_contacts)
    return replace(
        row,
        success=outcome.success,
        cause="" if outcome.cause is None else str(outcome.cause),
        causes=" ".join(outcome.causes),
        message=outcome.message,
        picked=outcome.picked,
        success_before=outcome.success_before,
        swallowed=" ".join(outcome.swallowed_others),
        unripe_force=outcome.unripe_peak_force,
        target_force=None if target is None else outcome.peak_force.get(target.id),
        static_force=max(static, default=0.0),
        torn=" ".join(outcome.torn),
        stem_force=max(outcome.stem_force.values(), default=0.0),
        duration=outcome.duration,
    )
