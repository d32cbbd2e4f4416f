"""From demonstrations to initial trajectories: the conditioned ProMP of a setup."""

import functools
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.planning.setup import Setup
from optipromp.promp.basis import Basis
from optipromp.promp.conditioning import conditioned_mean
from optipromp.promp.demonstrations import load_demonstrations
from optipromp.promp.learning import fit
from optipromp.promp.model import ProMP
from optipromp.robots import ik
from optipromp.robots.model import Robot
from optipromp.robots.roll import level

BASIS = Basis(count=14, width=2.0, outside=1)
PAPER_BASIS = Basis(count=5, width=4.0, outside=1)
ACCELERATION = 40.0  # [rad per unit of phase²] deviation of the prior's acceleration
SPREAD = 3.0  # [rad] deviation of the prior's position
PAUSED = 0.1  # [rad per unit of phase] deviation from standing still
TRACKED = 1e-5  # [m] largest error of a followed task point


@functools.lru_cache(maxsize=8)
def _prior_covariance(basis: Basis) -> FloatArray:
    """Covariance (K, K) of smooth motions: accelerations are white, ends at rest."""
    z = np.linspace(0.0, 1.0, 201)
    acceleration, position = basis.second_derivative(z), basis.matrix(z)
    ends = basis.derivative(np.array([0.0, 1.0]))
    precision = (
        acceleration.T @ acceleration / (len(z) * ACCELERATION**2)
        + position.T @ position / (len(z) * SPREAD**2)
        + ends.T @ ends / 0.05**2
    )
    return np.asarray(np.linalg.inv(precision), dtype=np.float64)


def smooth_prior(robot: Robot, basis: Basis = BASIS) -> ProMP:
    """A ProMP that knows no task, only that motions are smooth and rest at both ends.

    What an arm without demonstrations is planned with, and what widens a learnt ProMP where its
    demonstrations say nothing.
    """
    n = robot.n_joints
    covariance = np.kron(np.eye(n), _prior_covariance(basis))
    mean = np.repeat(robot.home[:, None], basis.count, axis=1)
    return ProMP(basis, mean, 0.5 * (covariance + covariance.T), joint_names=robot.joint_names)


@functools.lru_cache(maxsize=8)
def widened(promp: ProMP, robot: Robot, share: float = 0.01) -> ProMP:
    """``promp`` with ``share`` of the smooth prior's covariance added.

    A ProMP learnt from few or alike demonstrations can be conditioned far from them only by
    extrapolating its sample covariance; with the prior added, what they do not explain is
    interpolated smoothly instead.
    """
    prior = smooth_prior(robot, promp.basis)
    return promp.with_weights(promp.mean, promp.covariance + share * prior.covariance)


@functools.lru_cache(maxsize=8)
def _built_in(name: str, basis: Basis) -> ProMP | None:
    source = resources.files("optipromp.promp") / "data" / f"{name}.npz"
    if not source.is_file():
        return None
    with resources.as_file(source) as path:
        return fit(load_demonstrations(path), basis)


def learnt(setup: Setup, demonstrations: ProMP | str | Path | None, basis: Basis = BASIS) -> ProMP:
    """The ProMP a plan starts from, widened by a little of the smooth prior.

    Args:
        setup: the scene and its robot.
        demonstrations: a learnt ProMP, demonstrations to learn from (``.npz`` of a ProMP or of
            demonstrations, CSV, a folder of CSVs), or None for the robot's built-in ones (a smooth
            prior where it has none).
        basis: used where something is learnt.

    Raises:
        InvalidDemonstrationError: a file that cannot be used.
        InvalidRequestError: a ProMP of another robot.
    """
    robot = setup.robot
    if isinstance(demonstrations, ProMP):
        promp = demonstrations
    elif demonstrations is not None:
        promp = from_file(Path(demonstrations), basis)
    else:
        found = _built_in(robot.name, basis)
        promp = smooth_prior(robot, basis) if found is None else found
    if promp.n_joints != robot.n_joints:
        raise InvalidRequestError(
            f"the ProMP has {promp.n_joints} joints, {robot.name} has {robot.n_joints}: "
            f"{', '.join(robot.joint_names)}"
        )
    return widened(promp, robot)


def from_file(path: Path, basis: Basis) -> ProMP:
    """A ProMP as saved by ``optipromp learn``, or learnt from the demonstrations in ``path``."""
    if path.suffix == ".npz" and path.is_file():
        with np.load(path, allow_pickle=False) as data:
            saved = "covariance" in data.files
        if saved:
            return ProMP.load(path)
    return fit(load_demonstrations(path), basis)


@dataclass(frozen=True, eq=False)
class ViaPoints:
    """Task points from camera to goal, in the order they are passed.

    Attributes:
        positions: (m, 3) of the tool point [m].
        axes: (m, 3) of the tool axis.
        phases: (m,), the first at t_1, the last at 1.
        deviations: (m,) [m] how closely the ProMP is held to them.
    """

    positions: FloatArray
    axes: FloatArray
    phases: FloatArray
    deviations: FloatArray


def camera_point(setup: Setup) -> FloatArray:
    """Where the camera looks from (3,): below the target, before the lowest fruit."""
    assert setup.goal_position is not None
    up = setup.scene.frame[2]
    lowest = 0.0
    for thing in setup.neighbours:
        lowest = min(lowest, float((thing.position - setup.goal_position) @ up) - thing.radius)
    below = lowest - setup.scene.approach.camera_distance
    return np.asarray(setup.goal_position + below * up)


def via_points(
    setup: Setup, positions: Sequence[FloatArray], camera_phase: float, deviation: float
) -> ViaPoints:
    """The camera point, then ``positions`` at evenly spaced phases, then the goal."""
    assert setup.goal_position is not None
    assert setup.goal_axis is not None
    points = np.array([camera_point(setup), *positions, setup.goal_position])
    deviations = np.full(len(points), deviation)
    deviations[0], deviations[-1] = 5.0 * deviation, 0.0
    return ViaPoints(
        points,
        np.tile(setup.goal_axis, (len(points), 1)),
        np.linspace(camera_phase, 1.0, len(points)),
        deviations,
    )


def on_branch(setup: Setup, via: ViaPoints, goal: FloatArray) -> FloatArray | None:
    """Configurations (m, n) at the via points, followed back from ``goal``; None: out of reach."""
    back, errors = ik.track(setup.robot, via.positions[-2::-1], via.axes[-2::-1], goal)
    if len(errors) and errors.max() > TRACKED:
        return None
    behind = level(setup.robot, np.vstack([goal, back]), setup.scene.frame[0], path=True)
    return behind[::-1]


def led_through(
    promp: ProMP,
    start: FloatArray,
    phases: FloatArray,
    values: FloatArray,
    variances: FloatArray,
    count: int,
    pause: float | None = None,
) -> FloatArray:
    """Mean (T, n), at ``count`` knots, of ``promp`` led through configurations, with exact ends.

    Args:
        promp: what is conditioned.
        start: (n,) at phase 0, exact.
        phases: (m,) of the configurations.
        values: (m, n).
        variances: (m,) [rad²] of each; 0 is exact.
        count: knots.
        pause: a phase at which the arm stands still.
    """
    places, spread = [(0.0, 0)], [0.0]
    targets = [start[None], values]
    if pause is not None:
        places.append((pause, 1))
        spread.append(PAUSED**2)
        targets.insert(1, np.zeros((1, len(start))))
    places += [(phase, 0) for phase in phases.tolist()]
    spread += variances.tolist()
    mean = conditioned_mean(promp, tuple(places), np.concatenate(targets), tuple(spread))
    out = promp.basis.evaluate(count) @ mean.T
    out[0], out[-1] = start, values[-1]  # a conditioned ProMP meets them to rounding
    return np.asarray(out)
