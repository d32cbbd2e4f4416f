"""Situations of a trial: what differs from what is planned for, by name; picks in them.

Conditions (``conditions`` of ``optipromp bench study``; a table is in docs/closed-loop.md) say what
moves, and what is seen wrongly. Variations (its ``vary``) execute one plan in other worlds; their
ranges are those in which the guesses of the push models may be wrong.

Plants that sway are first seen at once, where the fruits are at that moment; the arm stands still
until then (``engine.settle``). A miscalibrated camera has seen the fruits at first, too. Looks have
zero-mean errors unless a condition has others. Errors and rates are sourced in
:data:`optipromp_sim.simulation.detector_parameters.DETECTORS` and
:data:`optipromp_sim.generate.NOISES`, displacements beside the constants below and in
:class:`optipromp_sim.simulation.DisturbanceParameters`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, TypedDict

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.execution.streaming import Stretch
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.crops import ROWS, Crop
from optipromp.core.scenes.held import pairs_among
from optipromp.core.scenes.objects import rooted
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.core.trajectory import SHORTEST_STEP, State, Trajectory
from optipromp_loop.control.controller import Controller
from optipromp_sim.generate import NOISES, noisy
from optipromp_sim.generate.noise import LOOK
from optipromp_sim.simulation import Eye, Loop, Simulation, closed_loop
from optipromp_sim.simulation.detector import Detector
from optipromp_sim.simulation.detector_parameters import DETECTORS, DetectorParameters
from optipromp_sim.simulation.parameters import SimulationParameters, of_crop
from optipromp_sim.simulation.records import used
from optipromp_sim.simulation.rollouts import Pick

LOWER = 0.010  # [m] from the height at which fruits are seen down to the true one: a choice
ASIDE = 0.015  # [m] of fruits after they were first seen: a choice
LEAP = 0.010  # [m] of fruits during the motion: a choice
JUMP_AT, LEAP_AT = 3.0, 2.0  # [s] of that leap in a closed loop, and in a blind motion: choices
SETTLE = 4.0  # [s] of sway before the first look, in which swings build up: a choice
SWAY: Mapping[str, Any] = {"sway": 0.010, "sway_frequency": 0.5, "sway_fastest": 1.6}
"""[m] [Hz] [Hz] of roots: fruits in wind sway by 10-30 mm, at a gutter's frequency to their own."""
LIGHT_WIND = 0.020  # [m] of the sway of a variation: a choice
CAMERA_OFF: Mapping[str, Any] = {
    "camera_offset": 0.005 / 3**0.5, "camera_turn": 1.0 / 3**0.5,
}  # fmt: skip
"""[m] [deg] about each of three axes: 5 mm and 1° in all, of a calibration by hand."""
BASE_OFF: Mapping[str, float] = {"arm_offset": 0.005, "arm_turn": 1.0}
"""[m] [deg] of the arm's base, of a calibration by hand: choices."""
LATE, BUSY = 0.010, 0.020  # [s] of commands in a cell (0-20 ms), over a busy network: choices
LIMP = 1.0 / 3.0  # of the stiffness of stems: the range in which it is a guess
TOOL_OFF = 0.005  # [m] lateral error of the tool's position: a choice
NEAR = 0.07  # [m] from the camera: the least range of a small stereo camera (D405)
FROZEN = 0.5  # [s] of a picture that stands still: a choice
EARLY = 0.150  # [s] of stamps before the exposure: a choice, a driver that stamps the request
BREAKS = 0.12  # [m] of the tool point from a target whose stem breaks: a choice, in view
LARGER, STIFF = 1.15, 5.0  # radius of fruits, stiffness of stems: choices beyond what is assumed
NEAREST = 3  # pushables of which one is missed: a choice
MISSED: Mapping[str, Any] = {"missed": 0.05, "hidden": 0.5}  # as the detector's


class LoopFigures(TypedDict):
    """Figures of a pick; columns of rows have these names, and tell what they are."""

    retreats: int
    looks: int
    cycle_median: float
    cycle_p99: float
    nis: float | None
    worst_jump: float
    worst_limit: float


class Situation(NamedTuple):
    """What a trial is made of: the truth, what is known of it at first, and who looks."""

    scene: Scene  # the true one; the disturbances of ``parameters`` come on top
    seen: Scene  # as first seen
    detector: DetectorParameters
    parameters: SimulationParameters
    # makes the camera of a closed loop
    camera: Callable[[Scene, Robot, DetectorParameters, int], Detector] = Detector
    figures: Mapping[str, Any] = {}  # of the first pictures, for rows
    further: "Callable[[], Situation] | None" = None  # after one picture more; None: there is none


Draw = Callable[[np.random.Generator], dict[str, float]]
Shift = Callable[[Scene, np.random.Generator], FloatArray]


@dataclass(frozen=True)
class Change:
    """What a named situation changes; all else is as the planner assumes."""

    noise: str = ""  # of NOISES, errors of the first look
    detector: DetectorParameters = DETECTORS["zero-mean"]  # of later looks
    unseen: bool = False  # one of the pushables nearest to the target is not seen at first
    disturbance: Mapping[str, float] = field(default_factory=dict)  # fields of the simulation's
    settled: bool = False  # fruits are first seen where a sway of SETTLE seconds has brought them
    world: Mapping[str, Any] | Draw = field(default_factory=dict)  # of _changed, or what draws it
    shift: Shift | None = None  # of the true fruits (3,) [m]
    roots: bool = False  # whether stems' roots are shifted, too
    row: tuple[str, float] | None = None  # of the crop, and its other value

    def __call__(self, scene: Scene, seed: int) -> Situation:
        """The situation of a true scene; the same scene and seed give the same one."""
        rng = np.random.default_rng([seed, 2])
        drawn = self.world(rng) if callable(self.world) else self.world
        if self.row is not None and scene.crop is not None:
            scene = replace(scene, crop=scene.crop.changed(*self.row))
        p = of_crop(SimulationParameters(), scene.crop)
        seen = noisy(scene, seed, NOISES[self.noise]) if self.noise else scene
        if self.settled:  # before the fruits are shifted, and as stems are believed to be
            p = p.changed(engine={"settle": SETTLE})
            sway = {k: v for k, v in self.disturbance.items() if k.startswith(("sway", "gust"))}
            seen = seen_at_once(seen, scene, seed, p.changed(disturbance=sway))
        truth, p = _changed(scene, p, **drawn)
        if self.shift is not None:
            by, part = self.shift(truth, rng), "whole" if self.roots else "object"
            truth = _fruits(truth, lambda item: item.shifted(by, part))
        if self.detector.camera_offset or self.detector.camera_turn:
            seen = miscalibrated(seen, scene, self.detector, seed)
        if self.unseen:
            seen = drop_one(seen, seed)
        return Situation(truth, seen, self.detector, p.changed(disturbance=self.disturbance))


def _changed(
    scene: Scene, p: SimulationParameters, *, stiffness: float = 1.0, friction: float | None = None,
    density: float = 1.0, damping: float = 1.0, size: float = 1.0, calyx: Any = None,
    stretch: float = 0.0,
) -> tuple[Scene, SimulationParameters]:  # fmt: skip
    """A world with other materials: factors, but for ``friction``, ``calyx`` and ``stretch``.

    ``stiffness``: of every stem, also where it follows from the stem's lean. ``size``: radius of
    hanging balls.
    """
    of = p.stem
    stem: dict[str, Any] = {
        "youngs_modulus": stiffness * of.youngs_modulus, "grown_turn": of.grown_turn / stiffness,
        "calyx": calyx or of.calyx, "stretch": stretch or of.stretch,
    }  # fmt: skip
    for name in ("damping_time", "swing_damping", "damping_ratio"):
        stem[name] = damping * getattr(of, name)
    p = p.changed(stem=stem, fruit={"density": density * p.fruit.density})
    if friction is not None:
        same = {"friction": friction}
        p = p.changed(fruit=same, stem=same, robot={"tool_friction": friction})

    def sized(item: SceneObject) -> SceneObject:
        of = item.shape
        return replace(item, shape=Sphere(size * of.radius)) if isinstance(of, Sphere) else item

    return scene if size == 1.0 else _fruits(scene, sized), p


def _fruits(scene: Scene, change: Callable[[SceneObject], SceneObject]) -> Scene:
    objects = (change(item) if item.stem is not None else item for item in scene.objects)
    return replace(scene, objects=rooted(objects))


def _beside(scene: Scene, rng: np.random.Generator) -> FloatArray:
    """A shift (3,) [m] across the approach, to a side that is drawn."""
    turn = float(rng.uniform(0.0, 2.0 * np.pi))
    return np.asarray(TOOL_OFF * (np.cos(turn) * scene.frame[0] + np.sin(turn) * scene.frame[1]))


def _drawn(rng: np.random.Generator) -> dict[str, float]:
    """All materials at once, each from the range of its rows in :data:`VARIATIONS`."""
    return {
        "stiffness": float(3.0 ** rng.uniform(-1.0, 1.0)),
        "friction": float(rng.uniform(0.2, 0.8)),
        "density": float(rng.uniform(0.5, 1.5)),
        "damping": float(np.exp(rng.uniform(np.log(0.2), np.log(4.0)))),
        "size": float(rng.uniform(0.9, 1.1)),
    }


def drop_one(scene: Scene, seed: int) -> Scene:
    """The scene without one of the pushables that hang nearest to the target.

    A fruit from whose stem another hangs is not dropped.
    """
    target = scene.target
    assert target is not None
    rng = np.random.default_rng([seed, 11])
    parents = {item.stem.parent for item in scene.objects if item.stem is not None}
    near = sorted(
        (item for item in scene.pushables if item.id not in parents),
        key=lambda item: float(np.linalg.norm(item.position - target.position)),
    )
    if not near:
        return scene
    dropped = near[int(rng.integers(min(NEAREST, len(near))))].id
    objects = tuple(item for item in scene.objects if item.id != dropped)
    return replace(scene, objects=objects, may_touch=pairs_among(scene.may_touch, [dropped]))


def miscalibrated(seen: Scene, scene: Scene, detector: DetectorParameters, seed: int) -> Scene:
    """The scene ``seen`` as a camera sees it whose calibration is off.

    The camera looks along the approach at the target of the true ``scene``, from the distance of
    the first look. ``detector`` and ``seed`` give the error, which later looks have, too.
    """
    target = scene.target
    assert target is not None
    error = Detector(scene, posed(scene)[0], detector, seed).miscalibration
    approach = scene.frame[2]
    camera = Pose(target.position - LOOK * approach, frame_along(approach))
    moved = camera @ error @ camera.inverse()
    return seen.each(lambda item: item if item.role == "static" else item.transformed(moved))


def seen_at_once(seen: Scene, scene: Scene, seed: int, parameters: SimulationParameters) -> Scene:
    """The scene ``seen`` with its fruits where they are at the end of the settling.

    Fruits on stems, and their stems, are shifted by as much as those of the true ``scene`` have
    moved since the beginning of a simulation with ``seed`` and ``parameters``, whose arm stands.
    """
    now = Pick(Simulation(scene, seed, parameters), settle=parameters.engine.settle).arena.fruits()
    true = {item.id: item.position for item in scene.objects}
    moved = {name: now.positions[row] - true[name] for row, name in enumerate(now.ids)}
    return _fruits(seen, lambda item: item.shifted(moved[item.id]) if item.id in moved else item)


_WHITE = DETECTORS["zero-mean"]
_ALL_MOVES = {
    "shift": ASIDE, "jump": LEAP, "jump_at": JUMP_AT + SETTLE, "lower": LOWER,
    "command_delay": LATE, **SWAY,
}  # fmt: skip

CONDITIONS: Mapping[str, Change] = {
    "none": Change(detector=DETECTORS["perfect"]),
    "zero-mean": Change(noise="zero-mean"),
    "detector": Change(noise="detector", detector=DETECTORS["detector"]),
    "missed": Change(unseen=True, detector=replace(_WHITE, **MISSED)),
    "lower": Change(disturbance={"lower": LOWER}),
    "aside": Change(disturbance={"shift": ASIDE, "jump": LEAP, "jump_at": JUMP_AT}),
    "sway": Change(disturbance=SWAY, settled=True),
    "calibration": Change(noise="zero-mean", detector=replace(_WHITE, **CAMERA_OFF)),
    "limp": Change(world={"stiffness": LIMP}),
    "near": Change(detector=replace(_WHITE, near=NEAR)),
    "frozen": Change(detector=replace(_WHITE, frozen=FROZEN)),
    "early": Change(detector=replace(_WHITE, stamp=-EARLY)),
    "breaks": Change(disturbance={"breaks": BREAKS}),
    "larger": Change(world={"size": LARGER}),
    "gust": Change(disturbance={**SWAY, "gust": 1.0}, settled=True),
    "stiff": Change(world={"stiffness": STIFF}),
    "all": Change(
        noise="detector", detector=replace(DETECTORS["detector"], **CAMERA_OFF), unseen=True,
        disturbance=_ALL_MOVES, settled=True, world={"stiffness": LIMP},
    ),
}  # fmt: skip
"""By name; docs/closed-loop.md describes them."""

VARIATIONS: Mapping[str, Change] = {
    "as assumed": Change(),
    "stems 3 times softer": Change(world={"stiffness": LIMP}),
    "stems 3 times stiffer": Change(world={"stiffness": 3.0}),
    "friction 0.2": Change(world={"friction": 0.2}),
    "friction 0.6": Change(world={"friction": 0.6}),
    "friction 0.8": Change(world={"friction": 0.8}),
    "stems stretch": Change(world={"stretch": 1.0}),
    "fruits half as heavy": Change(world={"density": 0.5}),
    "fruits 1.5 times as heavy": Change(world={"density": 1.5}),
    "fruits 10 % smaller": Change(world={"size": 0.9}),
    "fruits 10 % larger": Change(world={"size": 1.1}),
    "damping × 0.2": Change(world={"damping": 0.2}),
    "damping × 4": Change(world={"damping": 4.0}),
    "tool 5 mm off": Change(shift=_beside, roots=True),
    "fruits 10 mm lower": Change(shift=lambda scene, rng: -LOWER * np.asarray(scene.up)),
    "fruits turn freely": Change(world={"calyx": "free"}),
    "cluster 15 mm aside": Change(disturbance={"shift": ASIDE}),
    "jump 10 mm in motion": Change(disturbance={"jump": LEAP, "jump_at": LEAP_AT}),
    "sway 20 mm": Change(disturbance={"sway": LIGHT_WIND}),
    "arm 5 mm, 1 degree off": Change(disturbance=BASE_OFF),
    "commands 20 ms late": Change(disturbance={"command_delay": BUSY}),
    "all drawn at random": Change(world=_drawn),
}
"""By name. The first is the simulation's default, each next changes one thing, the last many."""


AS_CROP = "as the crop"
"""The first of the variations of a crop."""
SIZES = "width", "elongation", "stem_length"  # rows that scenes are made of, not their physics


def crop_variations(crop: Crop | None) -> Mapping[str, Change]:
    """As the crop, then each guess at its least and at its largest value, by name."""
    guesses = {} if crop is None else {k: crop.rows[k] for k in crop.guesses if k not in SIZES}
    ends = {f"{k} {end:.3g} {ROWS[k][0]}": (k, end) for k, r in guesses.items() for end in r.ends}
    return {AS_CROP: Change()} | {name: Change(row=row) for name, row in ends.items()}


def varied(setting: Situation, variation: str, seed: int) -> Situation:
    """A situation in the world of a variation, of which nobody is told; empty: in its own."""
    if not variation:
        return setting
    changes = {**VARIATIONS, **crop_variations(setting.scene.crop)}
    other = changes[variation](setting.scene, seed)
    return setting._replace(scene=other.scene, parameters=other.parameters)


LOOPS = "open", "closed"
"""``open``: the plan in the scene as first seen is executed blind; ``closed``: the controller."""
LOOP_PLANNER = "opti-promp"


def loop_figures(done: Loop) -> LoopFigures:
    """Retreats, looks, times of cycles, innovations and smoothness of a pick."""
    controller = done.controller
    cycles = np.array(controller.cycles)
    start = State(posed(controller.scene, controller.robot)[1].q)
    until = float(done.run.outcome.duration)
    curve = executed(done.trace.stretches, controller.robot, start, until)
    nis = controller.tracker.statistics.consistent()[0]
    return {
        "retreats": sum(event.stage == "leave" for event in controller.events),
        "looks": len(done.trace.looks), "nis": nis if np.isfinite(nis) else None,
        "cycle_median": float(np.median(cycles)), "cycle_p99": float(np.quantile(cycles, 0.99)),
        "worst_jump": float(curve.jumps.max()), "worst_limit": float(curve.shares.max()),
    }  # fmt: skip


def picked(setting: Situation, seed: int) -> Loop:
    """A pick in closed loop."""
    controller = Controller(setting.seen)
    simulation = Simulation(setting.scene, seed, setting.parameters)
    eye = Eye(setting.camera(setting.scene, controller.robot, setting.detector, seed))
    return closed_loop(simulation, controller, eye)


class Smoothness(NamedTuple):
    """How smooth an executed curve is."""

    jumps: FloatArray  # (3,) largest of a joint's position, velocity, acceleration at a takeover
    shares: FloatArray  # (3,) largest, of the robot's limits of velocity, acceleration and jerk


def executed(
    stretches: Sequence[Stretch], robot: Robot, start: State, until: float = np.inf
) -> Smoothness:
    """The jumps and the rates of the parts of stretches that were executed.

    A stretch runs from its begin until the next begins, by the executor's times.

    ``stretches``: in the order in which they took over. ``robot``: whose limits hold. ``start``: of
    the arm before the first stretch. ``until``: executor's time at which the run ended [s].
    """
    jumps, shares = np.zeros(3), np.zeros(3)
    taken = [stretch for stretch in stretches if stretch.begins < until]
    ends = [*(one.begins for one in taken[1:]), until][: len(taken)]
    for k, (stretch, end) in enumerate(zip(taken, ends, strict=True)):
        before = start if k == 0 else taken[k - 1].at(stretch.begins)
        both = (vars(state).values() for state in (before, stretch.at(stretch.begins)))
        jumps = np.maximum(jumps, [np.abs(b - a).max() for a, b in zip(*both, strict=True)])
        part = cut(stretch.curve, end - stretch.begins)
        if part is not None:
            shares = np.maximum(shares, [*used(robot, part).values()])
    return Smoothness(jumps, shares)


def cut(curve: Trajectory, length: float) -> Trajectory | None:
    """The first ``length`` seconds of a curve, exactly; None where nothing is left."""
    if length >= curve.duration:
        return curve
    if length < 2.0 * SHORTEST_STEP:
        return None
    times = curve.times[curve.times < length - SHORTEST_STEP]
    kept = len(times)
    q, v, a = (
        np.concatenate([whole[:kept], end])
        for whole, end in zip(curve.rows(), curve.sample(length), strict=True)
    )
    return Trajectory(np.append(times, length), q, v, a, curve.joint_names)
