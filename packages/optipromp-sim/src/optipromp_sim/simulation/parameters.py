"""Every physical parameter of the simulation, with its default, unit, kind and source.

The groups have the form of :mod:`optipromp.core.parameters`; :func:`catalogue` lists them.
Parameters that the push models have too are taken from there.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Self

from optipromp.core.errors import InvalidRequestError
from optipromp.core.parameters import Checked, Parameter, parameter
from optipromp.core.parameters import catalogue as listed
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.crops import Crop
from optipromp.core.values import Count, Part, Positive

STEM_FORCE = 2.0  # [N] that a stem bears by the definition of 0.3.0: a choice


@dataclass(frozen=True)
class FruitParameters(Checked):
    """Fruits: objects with role target or pushable."""

    density: float = parameter(PUSH.beam.fruit_density, "kg/m^3", "reported", "0.9-1.0 g/cm^3")
    friction: float = parameter(0.4, "1", "guess", "fruit skin on plastics; 0.2-0.6 reported")
    rolling_friction: float = parameter(1e-4, "m", "guess", "of objects without a stem")
    contact_time: float = parameter(0.006, "s", "guess", "flesh gives about 1 mm at 10 N")


@dataclass(frozen=True)
class StemParameters(Checked):
    """Stems: peduncles as chains of capsules with elastic ball joints."""

    diameter: float = parameter(PUSH.beam.diameter, "m", "reported", "2-3 mm; of the elastic beam")
    truss_diameter: float = parameter(PUSH.beam.truss_diameter, "m", "reported", "3-5 mm")
    youngs_modulus: float = parameter(PUSH.beam.youngs_modulus, "Pa", "guess", "10 to 100 MPa")
    density: float = parameter(1000.0, "kg/m^3", "guess", "turgid green tissue: mostly water")
    # A stem that its scene shows off the vertical holds its fruit there: it is as stiff as this
    # turn implies, where its modulus alone would need more turn to have grown in
    grown_turn: float = parameter(PUSH.beam.grown_turn, "rad", "guess", "root to tip, if unloaded")
    damping_time: float = parameter(0.06, "s", "guess", "damping over stiffness (Kelvin-Voigt)")
    swing_damping: float = parameter(2e-4, "N m s/rad", "guess", "at the root: leaves brake it")
    damping_ratio: float = parameter(0.0, "1", "choice", "in place of both dampings; 0: they hold")
    stretch: float = parameter(0.0, "1", "choice", "over F L / E A under a pull F; 0: none")
    bow_least: float = parameter(PUSH.beam.bow_least, "1", "guess", "of a straight stem's middle")
    bow_most: float = parameter(PUSH.beam.bow_most, "1", "guess", "drawn evenly between both")
    segment_length: Positive = parameter(0.025, "m", "choice", "of one capsule of the chain")
    least_segments: Count = parameter(3, "1", "choice", "of the shortest stem")
    most_segments: int = parameter(10, "1", "choice", "of the longest stem")
    armature: float = parameter(2e-6, "kg m^2", "choice", "of each joint; stems are stable without")
    friction: float = parameter(0.3, "1", "guess", "green stem on plastics")
    abscission_force: float = parameter(5.0, "N", "reported", "pull that tears a fruit off")

    calyx: Literal["rigid", "free"] = parameter("rigid", "", "choice", "rigid: turns with the stem")
    truss_force: float = parameter(15.0, "N", "guess", "of all its fruits: three times one")


@dataclass(frozen=True)
class ThingParameters(Checked):
    """Objects without stems (cans, boxes on a shelf), static objects, neighbouring clusters."""

    density: float = parameter(PUSH.plane.density, "kg/m^3", "guess", "part-filled packs")
    friction: float = parameter(PUSH.plane.friction, "1", "guess", "packs, shelf and tool")
    contact_time: float = parameter(0.004, "s", "choice", "time constant of hard contacts")
    # a neighbouring cluster yields as a solid, or is fruits on stems
    avoid_as: Literal["soft", "fruits"] = parameter("soft", "", "choice", "what a cluster is")
    cluster_stiffness: float = parameter(200.0, "1/s^2", "guess", "of a soft one, by pressing mass")
    cluster_fruits: int = parameter(6, "1", "guess", "fruits of a real neighbouring cluster")
    cluster_stem: float = parameter(0.15, "m", "guess", "length of the stems of a real cluster")


@dataclass(frozen=True)
class RobotParameters(Checked):
    """The arm. Its masses, inertias and torque limits are those that its URDF states."""

    link_density: float = parameter(800.0, "kg/m^3", "guess", "of links without a stated mass")
    tool_mass: float = parameter(0.35, "kg", "guess", "of a cup: printed, with its neck")
    hand_mass: float = parameter(0.73, "kg", "reported", "of a Franka hand; not traced")
    armature: float = parameter(0.1, "kg m^2 or kg", "guess", "rotor behind the gear, as in models")
    joint_friction: float = parameter(0.2, "N m or N", "guess", "dry; unknown to the controller")
    joint_damping: float = parameter(0.5, "N m s/rad or N s/m", "guess", "viscous; likewise")
    tool_friction: float = parameter(0.35, "1", "guess", "printed plastics")
    guard_until: float = parameter(0.0, "s", "choice", "until then a lid closes the mouth; 0: none")


@dataclass(frozen=True)
class ControlParameters(Checked):
    """Speed of the execution and the joint controller (computed torque)."""

    speed: Positive = parameter(1.0, "1", "choice", "of the trajectory's own; 0.5: twice the time")
    frequency: float = parameter(40.0, "rad/s", "guess", "of the closed joint loop")
    damping_ratio: float = parameter(1.0, "1", "choice", "critically damped")
    rate: Positive = parameter(1000.0, "Hz", "published", "of the Panda's control interface")
    hold: float = parameter(0.5, "s", "choice", "standing still at the end before judging")


@dataclass(frozen=True)
class EngineParameters(Checked):
    """Settings of MuJoCo."""

    timestep: Positive = parameter(0.001, "s", "choice", "of the integrator (discrete)")
    gravity: float = parameter(PUSH.beam.gravity, "m/s^2", "choice", "standard")
    settle: float = parameter(0.0, "s", "choice", "of simulation before the motion begins")
    iterations: int = parameter(30, "1", "choice", "most of the Newton solver a step")


@dataclass(frozen=True)
class DisturbanceParameters(Checked):
    """Disturbances that the planner is not told of; by default there are none."""

    sway: float = parameter(0.0, "m", "choice", "bound, horizontal, of roots; wind: 10-30 mm")
    sway_frequency: Positive = parameter(0.3, "Hz", "choice", "lowest: gutter or row as a whole")
    sway_fastest: float = parameter(1.6, "Hz", "choice", "highest: a fruit on 10 cm of stem")
    sway_modes: Count = parameter(3, "1", "choice", "harmonic motions that the sway is the sum of")
    # roots move alike (gutter), or with phases of their own (roots)
    sway_of: Literal["gutter", "roots"] = parameter("gutter", "", "choice", "what sways as one")
    gust: Part = parameter(0.0, "1", "choice", "share by which the amplitude falls and rises")
    shift: float = parameter(0.0, "m", "choice", "horizontal, from the scene's fruits to the true")
    lower: float = parameter(0.0, "m", "choice", "likewise, downwards")
    jump: float = parameter(0.0, "m", "choice", "horizontal step of all roots during the run")
    jump_at: float = parameter(0.0, "s", "choice", "time at which that step begins")
    arm_offset: float = parameter(0.0, "m", "choice", "believed place of the arm's base to true")
    arm_turn: float = parameter(0.0, "deg", "choice", "likewise, turn of the arm's base")
    command_delay: float = parameter(0.0, "s", "choice", "of references to joints; cells: 0-20 ms")
    breaks: float = parameter(0.0, "m", "choice", "of the tool when the stem breaks; 0: never")

    @property
    def in_motion(self) -> bool:
        """Whether roots move during a run."""
        return self.sway > 0.0 or self.jump > 0.0


@dataclass(frozen=True)
class Thresholds(Checked):
    """Limits of a success; a failure names the first limit that it exceeds."""

    static_force: float = parameter(0.5, "N", "choice", "a harder touch fails the run")
    avoid_force: float = parameter(0.5, "N", "choice", "of a cluster by a link but the last")
    stem_force: float = parameter(STEM_FORCE, "N", "choice", "pressed harder: caught")
    stem_time: float = parameter(0.05, "s", "choice", "and for longer than this")
    fruit_force: float = parameter(10.0, "N", "reported", "papers grip with less, not to bruise")
    inside_margin: float = parameter(0.0, "m", "choice", "of the target's centre below the rim")
    tracking_error: float = parameter(0.02, "m", "choice", "beyond it something stopped the arm")
    placed: float = parameter(0.02, "m", "choice", "largest error of a fruit's place")
    rest_time: float = parameter(0.3, "s", "choice", "of the target in the tool, up to the end")


@dataclass(frozen=True)
class SimulationParameters:
    """All parameters of the simulation."""

    fruit: FruitParameters = field(default_factory=FruitParameters)
    stem: StemParameters = field(default_factory=StemParameters)
    thing: ThingParameters = field(default_factory=ThingParameters)
    robot: RobotParameters = field(default_factory=RobotParameters)
    control: ControlParameters = field(default_factory=ControlParameters)
    engine: EngineParameters = field(default_factory=EngineParameters)
    disturbance: DisturbanceParameters = field(default_factory=DisturbanceParameters)
    thresholds: Thresholds = field(default_factory=Thresholds)

    def __post_init__(self) -> None:
        stem, d = self.stem, self.disturbance
        bowed = stem.bow_least <= stem.bow_most <= 0.2
        for name, value, ok, wanted in (
            ("stem.most_segments", stem.most_segments, stem.most_segments >= stem.least_segments,
             "least_segments or more"),
            ("stem.bow_least", stem.bow_least, bowed, "in 0 <= bow_least <= bow_most <= 0.2"),
            ("disturbance.sway_fastest", d.sway_fastest, d.sway_fastest >= d.sway_frequency,
             "sway_frequency or more"),
        ):  # fmt: skip
            if not ok:
                raise InvalidRequestError(f"{name} is {value}: must be {wanted}")

    def changed(self, **groups: Mapping[str, Any]) -> Self:
        """With other values of some parameters of some groups, by name."""
        made = {name: replace(getattr(self, name), **values) for name, values in groups.items()}
        return replace(self, **made)


def of_crop(parameters: SimulationParameters, crop: Crop | None) -> SimulationParameters:
    """The parameters with the crop's values where they are the defaults; None: as they are."""
    if crop is None:
        return parameters
    usual = SimulationParameters()
    for (branch, leaf), row in OF_CROP.items():
        group = getattr(parameters, branch)
        if getattr(group, leaf) == getattr(getattr(usual, branch), leaf):
            parameters = parameters.changed(**{branch: {leaf: crop[row]}})
    return parameters


def bearing(parameters: SimulationParameters, crop: Crop | None) -> SimulationParameters:
    """The parameters with what a crop's stems bear, where that is cited; physics stays."""
    limits = parameters.thresholds
    if crop is None or crop.rows["grip_force"].guess or limits.stem_force != STEM_FORCE:
        return parameters
    return parameters.changed(thresholds={"stem_force": crop["grip_force"]})


OF_CROP: Mapping[tuple[str, str], str] = {
    ("fruit", "density"): "density",
    ("stem", "diameter"): "stem_diameter",
    ("stem", "youngs_modulus"): "stem_modulus",
    ("stem", "damping_ratio"): "damping_ratio",
    ("stem", "abscission_force"): "abscission",
    ("thresholds", "stem_force"): "grip_force",
}
"""The parameters that a crop has rows of."""


def catalogue(parameters: SimulationParameters | None = None) -> Iterator[Parameter]:
    """Every parameter by its dotted name, with unit, kind and source."""
    return listed(parameters or SimulationParameters())
