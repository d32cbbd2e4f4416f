"""One run of a study: a scene is generated, detected, planned in, and the plan is executed."""

import functools
import hashlib
import time
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, fields, replace
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from pydantic import TypeAdapter

import optipromp
from optipromp.core.errors import Code, OptiPrompError
from optipromp.core.planning import PlanOptions
from optipromp.core.robots.library import NOTHING, UNTRUSTED, Choice
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.laboratory.experiments.baselines import Answer, attempt
from optipromp.laboratory.experiments.sources import Source, detected, drawn, source_name
from optipromp.laboratory.experiments.variations import VARIATIONS, Variation
from optipromp.laboratory.generate import (
    NOISES,
    PANDA,
    Noise,
    Preset,
)

if TYPE_CHECKING:
    from optipromp.laboratory.simulation import Outcome, Run

NO_PLAN = "no_plan"
"""Cause of a run that was not executed because there was no plan to execute."""
ERROR = "error"
"""Cause of a run that raised an error; its message is the error's."""

Key = tuple[str, int, str, str, str, str]


@dataclass(frozen=True)
class Row:
    """One run.

    Attributes:
        preset: of the scene, or the name of its file.
        seed: of the scene, the detection noise, the planner and the physics.
        planner: see :func:`optipromp.laboratory.experiments.baselines.study_planners`.
        noise_position: standard deviation of detected positions [m].
        noise_angle: standard deviation of detected stem directions [degrees].
        noise: name of a noise, one of :data:`optipromp.laboratory.generate.NOISES`; empty for none.
        pushables: number of pushables in the scene.
        redraws: number of impossible scenes sampled before this one.
        plan_status: code of the plan in the scene as detected.
        success: whether the simulated run succeeded.
        cause: of a failure, the first of ``causes``; empty for a success.
        message: the outcome in words.
        picked: whether the target is in the tool at the end.
        swallowed: ids of other objects in the tool at the end, separated by spaces.
        unripe_force: largest force on any object but the target [N]; None: not executed.
        target_force: largest force on the target [N].
        static_force: largest force of arm or tool on static objects [N].
        torn: ids of fruits that came off, separated by spaces.
        stem_force: largest force of arm or tool on a stem [N].
        duration: of the executed motion [s].
        predicted_harm: of the plan's push; None where no push model applies.
        predicted_failure: predicted probability that the pick is not clean; None likewise.
        tilt: angle between the planner's approach and the scene's [degrees].
        plan_time: wall time of planning [s].
        simulation_time: wall time of the execution [s].
        version: of the library, with a digest of its source.
        variation: of the physics in which the plan was executed; empty for none.
        causes: all causes of failure, separated by spaces.
        loop: one of :data:`optipromp.laboratory.experiments.loops.LOOPS`; empty for a planner that
            is compared with others. With a loop, ``plan_status`` is ``success`` where it said that
            it was done, or was clean.
        condition: one of :data:`optipromp.laboratory.experiments.conditions.CONDITIONS`, or of
            :data:`optipromp.laboratory.experiments.eyes.WAYS`; empty without a loop.
        result: of a loop: ``clean``, ``harmed``, ``gave_up``, ``missed`` (nothing was harmed,
            nothing picked), ``refused`` (not executed) or ``error``.
        retreats: number of retreats.
        looks: number of looks that reached the controller.
        cycle_median, cycle_p99: wall time of the controller's cycles, median and 99 % [s].
        nis: mean of the tracker's normalised innovations squared; 3 where its covariances are true.
        worst_jump: largest jump of a joint at a takeover, of position, velocity or acceleration,
            each in SI units.
        worst_limit: largest share of a limit of velocity, acceleration or jerk.
        finder: of eyes; empty without eyes, as all below.
        views: least number of pictures before a plan.
        pictures: number of pictures before a plan.
        visible: fruits of which enough showed on these; counted in each.
        found: of the visible fruits, likewise.
        false: detections that no fruit matches, likewise.
        see_time: processor time of seeing these pictures [s].
    """

    preset: str
    seed: int
    planner: str
    noise_position: float
    noise_angle: float
    pushables: int
    redraws: int
    plan_status: str
    success: bool = False
    cause: str = ""
    message: str = ""
    picked: bool | None = None
    swallowed: str = ""
    unripe_force: float | None = None
    target_force: float | None = None
    static_force: float | None = None
    torn: str = ""
    stem_force: float | None = None
    duration: float | None = None
    predicted_harm: float | None = None
    predicted_failure: float | None = None
    tilt: float = 0.0
    plan_time: float = 0.0
    simulation_time: float = 0.0
    version: str = ""
    variation: str = ""
    noise: str = ""
    causes: str = ""
    loop: str = ""
    condition: str = ""
    result: str = ""
    retreats: int | None = None
    looks: int | None = None
    cycle_median: float | None = None
    cycle_p99: float | None = None
    nis: float | None = None
    worst_jump: float | None = None
    worst_limit: float | None = None
    finder: str = ""
    views: int | None = None
    pictures: int | None = None
    visible: int | None = None
    found: int | None = None
    false: int | None = None
    see_time: float | None = None

    @property
    def key(self) -> Key:
        """By which a row is unique: preset, seed, planner, variation, loop, condition."""
        return self.preset, self.seed, self.planner, self.variation, self.loop, self.condition


COLUMNS: tuple[str, ...] = tuple(field.name for field in fields(Row))
_MAY_BE_NONE = {field.name for field in fields(Row) if "None" in str(field.type)}


def row_from_text(texts: Mapping[str, str]) -> Row:
    """A row from its CSV cells."""
    values = {name: texts[name] for name in COLUMNS if name in texts}  # older rows have fewer
    empty = dict.fromkeys(name for name in _MAY_BE_NONE if values.get(name) == "")
    return _reader().validate_python(values | empty)


@functools.cache
def _reader() -> TypeAdapter[Row]:
    return TypeAdapter(Row)


@functools.lru_cache(maxsize=1)
def source_version() -> str:
    """The library's version and a digest of its source, by which rows of other code differ."""
    root = Path(optipromp.__file__).resolve().parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        if path.relative_to(root).parts[0] in ("cli", "looks"):
            continue  # they change no row
        digest.update(path.relative_to(root).as_posix().encode())
        digest.update(path.read_bytes())
    try:
        version = metadata.version("optipromp")
    except metadata.PackageNotFoundError:  # run from its source
        version = "source"
    return f"{version}+{digest.hexdigest()[:10]}"


def run_scene(
    source: Source,
    seed: int,
    planners: Iterable[str],
    noise: Noise | str,
    version: str,
    only_valid: bool = False,
    robot: str | Path = PANDA,
    choice: Choice = NOTHING,
    vary: bool = False,
    risk: float = PlanOptions.risk,
) -> list[Row]:
    """Run every planner on one scene; all see the same errors of detection.

    ``source``: of the scene. ``seed``: of scene, noise, planners and physics. ``planners``: names,
    in the order in which they run. ``noise``: of the detector, or its name in :data:`NOISES`.
    ``version``: written into the rows. ``only_valid``: plans that the judge refuses are not
    executed, and count as failures. ``robot``: name or path of the scene's robot. ``choice``: of
    the arm in the robot's file. ``vary``: every plan is executed under all of :data:`VARIATIONS`.
    ``risk``: share of promised successes that may be broken.
    """
    scene, redraws = drawn(source, seed, robot, choice)
    errors = NOISES[noise] if isinstance(noise, str) else noise
    seen = detected(source, scene, seed, errors)
    row = functools.partial(
        Row, preset=source_name(source), seed=seed, noise_position=errors.position,
        noise_angle=errors.angle, noise=noise if isinstance(noise, str) else "",
        pushables=len(scene.pushables), redraws=redraws, version=version,
    )  # fmt: skip
    rows = []
    for planner in planners:
        made: Answer | None = None
        for name, change in (VARIATIONS if vary else {"": None}).items():
            try:
                made = made or attempt(seen, planner, seed=seed, risk=risk)
                values = _executed(made, scene, seed, only_valid, change)
            except OptiPrompError as error:
                values = {"plan_status": str(error.code), "cause": ERROR, "message": error.message}
            except Exception as error:  # the row tells of it, and the study goes on
                words = f"{type(error).__name__}: {error}"
                values = {"plan_status": ERROR, "cause": ERROR, "message": words}
            rows.append(row(planner=planner, variation=name, **values))
    return rows


def again(
    row: Row, robot: str = PANDA, risk: float = PlanOptions.risk, source: Source | None = None
) -> "Run | None":
    """A run made once more, for its picture; None where its plan is not executed.

    ``robot`` is the name or path of the scene's robot, ``risk`` that of the study, ``source`` the
    scene's where it is a file.
    """
    if row.loop:
        from optipromp.laboratory.experiments.loops import loop_again

        return loop_again(row, robot, risk, source)
    scene, seen = scenes_of(row, robot, source)
    made = attempt(seen, row.planner, seed=row.seed, risk=risk)
    if made.trajectory is None:
        return None
    return _executed_in(made, scene, row.seed, VARIATIONS.get(row.variation))


def scenes_of(row: Row, robot: str = PANDA, source: Source | None = None) -> tuple[Scene, Scene]:
    """The true scene of a run, and the scene as detected.

    The robot's name is from a study's file, so it is untrusted; see
    :class:`optipromp.core.robots.library.Choice`.
    """
    source = source or cast(Preset, row.preset)
    scene, _ = drawn(source, row.seed, robot, UNTRUSTED)
    noise = NOISES[row.noise] if row.noise else Noise(row.noise_position, row.noise_angle)
    return scene, detected(source, scene, row.seed, noise)


def _executed(
    made: Answer, scene: Scene, seed: int, only_valid: bool, change: Variation | None
) -> dict[str, Any]:
    """The values of a row for a plan that is executed in the true scene."""
    values: dict[str, Any] = {
        "plan_status": str(made.status),
        "plan_time": made.seconds,
        "predicted_harm": made.harm,
        "predicted_failure": made.failure,
        "tilt": made.tilt,
    }
    refused = only_valid and made.status != Code.SUCCESS
    if made.trajectory is None or refused:
        return {**values, "cause": NO_PLAN, "message": made.message}
    began = time.perf_counter()
    outcome = _executed_in(made, scene, seed, change).outcome
    return {
        **values,
        **outcome_values(outcome, scene.target),
        "simulation_time": time.perf_counter() - began,
    }


def outcome_values(outcome: "Outcome", target: SceneObject | None) -> dict[str, Any]:
    """The values of a row for the outcome of a run in a scene with that ``target``."""
    static = (contact.peak_force for contact in outcome.static_contacts)
    return {
        "success": outcome.success,
        "cause": "" if outcome.cause is None else str(outcome.cause),
        "causes": " ".join(outcome.causes),
        "message": outcome.message,
        "picked": outcome.picked,
        "swallowed": " ".join(outcome.swallowed_others),
        "unripe_force": outcome.unripe_peak_force,
        "target_force": None if target is None else outcome.peak_force.get(target.id),
        "static_force": max(static, default=0.0),
        "torn": " ".join(outcome.torn),
        "stem_force": max(outcome.stem_force.values(), default=0.0),
        "duration": outcome.duration,
    }


def _executed_in(made: Answer, scene: Scene, seed: int, change: Variation | None) -> "Run":
    """The run of an answer in the true scene, or in a variation of it."""
    from optipromp.laboratory.simulation import SimulationParameters, simulate

    assert made.trajectory is not None
    parameters = SimulationParameters()
    if change is not None:
        scene, parameters = change(scene, np.random.default_rng([seed, 2]))
    robot = replace(parameters.robot, guard_until=made.guard)
    return simulate(made.trajectory, scene, parameters=replace(parameters, robot=robot), seed=seed)


def warm_up(source: Source, planners: Iterable[str], robot: str | Path, choice: Choice) -> None:
    """Load and compile the planners' code, so that no row's time includes it."""
    with suppress(OptiPrompError):  # the rows tell of it
        scene, _ = drawn(source, 0, robot, choice)
        for planner in planners:
            attempt(scene, planner)
