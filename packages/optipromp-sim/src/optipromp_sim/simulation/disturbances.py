"""Disturbances that the planner is not told of: plants that move, fruits that stand elsewhere."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, frozen, rotation
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.parameters import DisturbanceParameters

JUMP_TIME = 0.15  # [s] of a step of the roots: a plant that slips or is let go
GUSTS = 0.05, 0.2  # [Hz] of the envelope of a sway: gusts last 5-20 s
CARRIAGE_MASS = 1000.0  # [kg] of a moving root: the weight of a plant accelerates it by < 1e-2 m/s²
TRIES = 200  # draws of the phases of a root whose fruits would begin within others


class Chances(NamedTuple):
    """What a seed decides about the disturbances."""

    shift: FloatArray  # (2,) horizontal direction, as jump
    jump: FloatArray
    offset: FloatArray  # (3,) direction of the arm's error, as turn, an axis
    turn: FloatArray
    rng: np.random.Generator  # for the sway

    @classmethod
    def of(cls, seed: int) -> Self:
        """Those of a seed; no other draw of the simulation shares them."""
        rng = np.random.default_rng([seed, 7])
        angles, vectors = rng.uniform(0.0, 2.0 * np.pi, 2), rng.standard_normal((2, 3))
        shift, jump = np.column_stack([np.cos(angles), np.sin(angles)])
        offset, turn = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
        return cls(shift, jump, offset, turn, rng)


def horizontal(up: FloatArray) -> FloatArray:
    """(2, 3) two unit vectors across ``up`` (3,) and each other."""
    across: FloatArray = frame_along(np.asarray(up)).T[:2]
    return across


def disturbed(scene: Scene, given: DisturbanceParameters, seed: int) -> tuple[Scene, Pose]:
    """The true scene, in the frame where the arm believes its base to be, and the error of that.

    Objects on stems are moved aside by ``shift`` and down by ``lower``. Then the whole world is
    moved by the pose: true places are ``pose @ believed``.
    """
    chances, pose = Chances.of(seed), Pose()
    by = given.shift * chances.shift @ horizontal(scene.up) - given.lower * scene.up
    if by.any():
        scene = scene.each(lambda item: item.shifted(by) if item.stem else item)
    if given.arm_offset > 0.0 or given.arm_turn > 0.0:
        turn = rotation(chances.turn, float(np.radians(given.arm_turn)))
        pose = Pose(given.arm_offset * chances.offset, turn)
        scene = scene.transformed(pose)
    return scene, pose


@dataclass(frozen=True, eq=False)
class RootMotion:
    r"""Displacement of R roots over time, of M modes.

    :math:`x_r(t) = g(t) \sum_m a_m \sin(\omega_m t + \varphi_{rm}) + s((t - t_j) / T)\, j` with
    the envelope :math:`g(t) = 1 - \frac{\gamma}{2} (1 + \frac12 \sum_k \sin(\nu_k t + \psi_k))`
    and the quintic step :math:`s`.
    """

    amplitudes: FloatArray  # (M, 3) a [m]
    rates: FloatArray  # (M,) ω [rad/s]
    phases: FloatArray  # (R, M) φ [rad]
    gust: float  # γ, share by which the amplitude falls
    gust_rates: FloatArray  # (2,) ν [rad/s]
    gust_phases: FloatArray  # (2,) ψ [rad]
    jump: FloatArray  # (3,) j [m]
    jump_at: float  # t_j, when the step begins [s]

    def position(self, t: float) -> FloatArray:
        """(R, 3) displacements from the scene's places at time ``t`` [m]."""
        swing = np.sin(self.rates * t + self.phases) @ self.amplitudes
        u = min(max((t - self.jump_at) / JUMP_TIME, 0.0), 1.0)
        step = u**3 * (10.0 - 15.0 * u + 6.0 * u**2)
        gust = np.sin(self.gust_rates * t + self.gust_phases).sum()
        envelope = 1.0 - 0.5 * self.gust * (1.0 + 0.5 * gust) if self.gust > 0.0 else 1.0
        return np.asarray(envelope * swing + step * self.jump)


Hanging = Sequence[tuple[FloatArray, float]]
"""Centres (3,) [m] and radii [m] of the fruits that hang on one root."""


def root_motion(
    given: DisturbanceParameters, seed: int, up: FloatArray, hanging: Sequence[Hanging]
) -> RootMotion:
    """The motion of the roots.

    The amplitudes have one length, such that no displacement exceeds ``sway``. The sway reaches it
    when all modes are in step. Where each root moves by itself, no two fruits of different roots
    begin within each other.

    ``seed``: of frequencies, directions and phases. ``hanging``: of each root.
    """
    chances, flat, count = Chances.of(seed), horizontal(up), int(given.sway_modes)
    rng = chances.rng
    lowest, highest = np.log([given.sway_frequency, given.sway_fastest])
    rates = 2.0 * np.pi * np.exp(rng.uniform(lowest, highest, count))
    angles = rng.uniform(0.0, 2.0 * np.pi, count)
    gust_rates = 2.0 * np.pi * rng.uniform(*GUSTS, 2)
    gust_phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    all_ways = np.linspace(0.0, np.pi, 361)
    most = np.abs(np.cos(all_ways[:, None] - angles)).sum(axis=1).max()
    amplitudes = given.sway / most * np.column_stack([np.cos(angles), np.sin(angles)]) @ flat
    phases = np.tile(rng.uniform(0.0, 2.0 * np.pi, count), (len(hanging), 1))
    if given.sway_of == "roots":
        _spread(phases, amplitudes, rng, hanging)
    return RootMotion(
        amplitudes=frozen(amplitudes),
        rates=frozen(rates),
        phases=frozen(phases),
        gust=given.gust,
        gust_rates=frozen(gust_rates),
        gust_phases=frozen(gust_phases),
        jump=frozen(given.jump * chances.jump @ flat),
        jump_at=given.jump_at,
    )


def _spread(
    phases: FloatArray, amplitudes: FloatArray, rng: np.random.Generator, hanging: Sequence[Hanging]
) -> None:
    """Draw phases (R, M) for each root by itself, in place."""
    begun: list[tuple[FloatArray, FloatArray, float]] = []  # where it hangs, and where it begins
    for row, fruits in enumerate(hanging):
        best = -np.inf
        for _ in range(TRIES):
            drawn = rng.uniform(0.0, 2.0 * np.pi, phases.shape[1])
            by = np.sin(drawn) @ amplitudes
            rooms = (
                _room(center + by - there, center - other, radius + its)
                for center, radius in fruits
                for other, there, its in begun
            )
            room = min(rooms, default=0.0)
            if room > best:
                best, phases[row] = room, drawn
            if best >= 0.0:
                break
        by = np.sin(phases[row]) @ amplitudes
        begun += [(center, center + by, radius) for center, radius in fruits]


def _room(away: FloatArray, before: FloatArray, least: float) -> float:
    """Length of ``away`` (3,) less that of ``before`` (3,), or less ``least`` if it is shorter."""
    return float(np.linalg.norm(away)) - min(least, float(np.linalg.norm(before)))


def add_carriage(spec: Any, key: str, place: FloatArray) -> tuple[str, FloatArray]:
    """Add a body at ``place`` (3,) [m] that three slides carry; its name and its place.

    It stands for the root of a stem that moves; ``key`` is in the names of body and joints.
    """
    mujoco, name = engine(), f"root:{key}"
    body = spec.worldbody.add_body(name=name, pos=place)
    body.explicitinertial = True
    body.mass, body.inertia = CARRIAGE_MASS, [CARRIAGE_MASS] * 3  # it does not turn
    for k, axis in enumerate(np.eye(3)):
        body.add_joint(name=f"{name}:{k}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis)
    return name, place
