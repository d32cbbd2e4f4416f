"""Movement primitives: learnt, and conditioned for the planners ``promp`` and ``i-promp``."""

import functools
import warnings
from collections.abc import Sequence
from importlib import resources
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray, frozen
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.planning.parameters import FOLLOW, PRIMITIVE
from optipromp.core.planning.task import Task
from optipromp.core.promp.basis import Basis
from optipromp.core.promp.conditioning import conditioned_mean
from optipromp.core.promp.demonstrations import check_limits, load_demonstrations
from optipromp.core.promp.learning import fit
from optipromp.core.promp.model import ProMP, is_primitive
from optipromp.core.robots import ik
from optipromp.core.robots.ik import level
from optipromp.core.robots.library import built_in_twin
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import PoseGoal

RECORDED = "panda", "scara"  # robots of the built-in demonstrations
BASIS = Basis(count=14, width=2.0, outside=1)  # of the primitives that a plan learns: a choice


@functools.lru_cache(maxsize=8)
def _prior_covariance(basis: Basis) -> FloatArray:
    """Covariance (K, K) of the weights of smooth motions: white acceleration, ends at rest."""
    z = np.linspace(0.0, 1.0, 201)
    acceleration, position = basis.evaluate(z, 2), basis.evaluate(z)
    ends = basis.evaluate(np.array([0.0, 1.0]), 1)
    precision = (
        acceleration.T @ acceleration / (len(z) * PRIMITIVE.acceleration**2)
        + position.T @ position / (len(z) * PRIMITIVE.position**2)
        + ends.T @ ends / 0.05**2  # [rad per unit of phase] standard deviation of end velocities
    )
    try:
        return np.asarray(np.linalg.inv(precision), dtype=np.float64)
    except np.linalg.LinAlgError:
        raise InvalidDemonstrationError(
            f"{basis.count} bases of width {basis.width:g} span no smooth motion: must be wider"
        ) from None


def smooth_prior(robot: Robot, basis: Basis = BASIS, about: FloatArray | None = None) -> ProMP:
    """A ProMP of smooth motions that rest at both ends, for an arm without demonstrations.

    ``about`` (n,) is its mean [rad or m]; None: the robot's home.
    """
    mean = robot.home if about is None else about
    return _smooth(robot.joint_names, tuple(mean.tolist()), basis)


@functools.lru_cache(maxsize=8)
def _smooth(joint_names: tuple[str, ...], about: tuple[float, ...], basis: Basis) -> ProMP:
    covariance = _of_joints(len(about), _prior_covariance(basis))
    mean = np.repeat(np.array(about)[:, None], basis.count, axis=1)
    return ProMP(basis, mean, covariance, joint_names=joint_names)


@functools.lru_cache(maxsize=64)
def _tell_unlearnt(name: str, joint_names: tuple[str, ...]) -> None:
    """Warn, once for each robot in a process, that it has no demonstrations."""
    warnings.warn(
        f"no built-in demonstrations are of the joints of robot '{name}' "
        f"({', '.join(joint_names)}): the primitive is any smooth motion about the start; "
        "demonstrations= or --demonstrations gives it one that was learnt",
        stacklevel=4,
    )


def _of_joints(n: int, covariance: FloatArray) -> FloatArray:
    """The covariance (nK, nK) of n independent joints, each with ``covariance`` (K, K)."""
    joint = np.kron(np.eye(n), covariance)
    return np.asarray(0.5 * (joint + joint.T))


@functools.lru_cache(maxsize=8)
def widened(promp: ProMP, joint_names: tuple[str, ...]) -> ProMP:
    """``promp`` with 1 % of the smooth prior's covariance added: a choice.

    The sample covariance of few or similar demonstrations extrapolates badly. With the prior added,
    conditioning far from the demonstrations interpolates smoothly. The prior depends on the joints
    alone, not on the tool.
    """
    promp = promp.for_joints(joint_names)
    prior = _of_joints(len(joint_names), _prior_covariance(promp.basis))
    return promp.with_weights(promp.mean, promp.covariance + 0.01 * prior)


@functools.lru_cache(maxsize=8)
def _built_in(name: str, basis: Basis) -> ProMP:
    source = resources.files("optipromp.core.promp") / "data" / f"{name}.npz"
    with resources.as_file(source) as path:
        return fit(load_demonstrations(path), basis)


def is_learnt(robot: Robot, demonstrations: object) -> bool:
    """Whether :func:`learnt` has demonstrations: given ones, or built-in ones of the joints."""
    return demonstrations is not None or built_in_twin(robot, RECORDED) is not None


def learnt(task: Task, demonstrations: ProMP | str | Path | None, basis: Basis = BASIS) -> ProMP:
    """The ProMP of a plan, widened by a little of the smooth prior.

    ``demonstrations``: a ProMP; a file of a ProMP or of demonstrations (``.npz``, CSV, a folder of
    CSVs); or None: the built-in demonstrations of the robot's joints
    (:func:`optipromp.core.robots.library.built_in_twin`). Where there are none, the smooth prior
    about the start takes their place, with a warning.
    """
    robot = task.robot
    if demonstrations is not None:
        promp = _given(demonstrations, basis, robot)
    elif is_learnt(robot, demonstrations):
        promp = _built_in(str(built_in_twin(robot, RECORDED)), basis)
    else:
        promp = smooth_prior(robot, basis, task.start)
        _tell_unlearnt(robot.name, robot.joint_names)
    return widened(promp, robot.joint_names)


def _given(given: object, basis: Basis, robot: Robot) -> ProMP:
    """The ProMP that a user gives: a ProMP, the file of one, or demonstrations to learn it from."""
    if not isinstance(given, ProMP | str | Path):
        kind = type(given).__name__
        raise InvalidRequestError(f"demonstrations are {kind}; they must be a ProMP or a path")
    what = "the ProMP" if isinstance(given, ProMP) else str(given)
    joints, lower, upper = robot.joint_names, robot.lower, robot.upper
    if not isinstance(given, ProMP) and not is_primitive(Path(given)):
        recorded = load_demonstrations(given).for_robot(joints, lower, upper, what, robot.turns)
        return fit(recorded, basis)
    promp = given if isinstance(given, ProMP) else ProMP.load(given)
    mean = promp.for_joints(joints, what).mean_trajectory(PRIMITIVE.checked)
    # the mean of few bases overshoots; only beyond the limits by a joint's range it has other units
    told = f"{what}, its mean at {len(mean)} phases"
    check_limits(mean, joints, lower, upper, told, upper - lower)
    return promp


def via_points(
    task: Task, positions: Sequence[FloatArray], deviation: float
) -> tuple[FloatArray, FloatArray]:
    """Tool points (m, 3) [m]: the camera point, ``positions`` and the goal.

    Also their standard deviations (m,) [m]: five times ``deviation`` at the camera point, 0 at the
    goal.
    """
    assert isinstance(task.goal, PoseGoal)
    points = np.array([task.camera, *positions, task.goal.position])
    deviations = np.full(len(points), deviation)
    deviations[0], deviations[-1] = 5.0 * deviation, 0.0
    return points, deviations


def on_branch(task: Task, points: FloatArray, goal: FloatArray) -> FloatArray | None:
    """Configurations (m, n) at tool points (m, 3), followed back from the configuration ``goal``.

    None where a point is out of reach.
    """
    assert isinstance(task.goal, PoseGoal)
    axes = np.tile(task.goal.axis, (len(points) - 1, 1))
    back, errors = ik.track(task.robot, points[-2::-1], axes, goal)
    if len(errors) and errors.max() > FOLLOW.task_tracked:
        return None
    behind = level(task.robot, np.vstack([goal, back]), task.scene.frame[0], path=True)
    return behind[::-1]


def led_through(
    promp: ProMP, start: FloatArray, phases: FloatArray, values: FloatArray, variances: FloatArray,
    count: int, pause: float | None = None,
) -> FloatArray:  # fmt: skip
    """Mean (T, n) of ``promp`` at ``count`` waypoints, conditioned on configurations.

    ``start``: (n,) at phase 0, exact. ``phases``: (m,) of the configurations. ``values``: (m, n)
    the configurations. ``variances``: (m,) of the configurations [rad²]; 0 is exact. ``count``:
    number T of waypoints. ``pause``: a phase at which the arm stands still; None: none.
    """
    places, spread = [(0.0, 0)], [0.0]
    targets = [start[None], values]
    if pause is not None:
        places.append((pause, 1))
        spread.append(PRIMITIVE.paused**2)
        targets.insert(1, np.zeros((1, len(start))))
    places += [(phase, 0) for phase in phases.tolist()]
    spread += variances.tolist()
    mean = conditioned_mean(promp, tuple(places), np.concatenate(targets), tuple(spread))
    out = promp.basis.evaluate(count) @ mean.T
    out[0], out[-1] = start, values[-1]  # a conditioned ProMP meets them up to rounding
    return np.asarray(out)


@functools.lru_cache(maxsize=8)
def end(promp: ProMP) -> FloatArray:
    """The last configuration (n,) of a ProMP's mean."""
    return frozen(promp.mean_trajectory(np.array([1.0]))[0])
