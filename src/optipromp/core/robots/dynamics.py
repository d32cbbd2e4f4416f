"""Masses and torque limits of the moving segments, and the torque of gravity."""

import warnings
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.parameters import GRAVITY
from optipromp.core.robots.kernels import PRISMATIC
from optipromp.core.robots.mounted import weight_of

if TYPE_CHECKING:
    from optipromp.core.robots.model import Robot


class Dynamics(NamedTuple):
    """Effort limit and inertia of each of the S moving segments with the links it carries.

    ``mass`` is 0 if the file states none, ``inertia`` is 0 if it states no tensor.
    """

    effort: FloatArray  # (S,) limit of the joint's torque or force [N m or N], may be infinite
    mass: FloatArray  # (S,) [kg]
    center: FloatArray  # (S, 3) of mass [m], in the segment's frame
    inertia: FloatArray  # (S, 3, 3) about the centre of mass [kg m²], in the segment's axes


def gravity_load(robot: "Robot", q: FloatArray, up: FloatArray) -> FloatArray:
    """Torque or force (m, S) [N m or N] that holds each segment at ``q`` (m, n) against gravity.

    ``up``: (3,) the upward vertical in the base frame. The tool has no weight; what it holds has
    (:func:`optipromp.core.robots.mounted.weight_of`). Zero for a robot without masses.
    """
    origins, rotations = robot.segment_frames(q)
    if robot.dynamics is None:
        return np.zeros(origins.shape[:2])
    kin, mass = robot.kinematics, robot.dynamics.mass
    center = robot.dynamics.center
    held, at = weight_of(robot.tool)
    if held:
        mass, center = np.array(mass), np.array(center)
        place = robot.flange_translation + robot.flange_rotation @ at
        center[-1] = (mass[-1] * center[-1] + held * place) / (mass[-1] + held)
        mass[-1] += held
    middles = origins + np.einsum("msij,sj->msi", rotations, center)
    axes = np.einsum("msij,sj->msi", rotations, kin.axis)
    beyond = np.cumsum(mass[::-1])[::-1]  # of each segment and all after it
    moments = np.cumsum((mass[:, None] * middles)[:, ::-1], axis=1)[:, ::-1]
    arms = moments - beyond[:, None] * origins
    turning = GRAVITY * np.einsum("msi,msi->ms", axes, np.cross(arms, up))
    sliding = GRAVITY * beyond * (axes @ up)
    return np.asarray(np.where(kin.kind == PRISMATIC, sliding, turning))


def warn_of_gravity(robot: "Robot", q: FloatArray, up: FloatArray, where: str) -> None:
    """Warn, once for all joints, if gravity asks for more than a joint's effort limit.

    ``q`` (m, n): configurations; ``where``: describes them in the message.
    """
    if robot.dynamics is None:
        return
    load, effort = np.abs(gravity_load(robot, q, up)).max(axis=0), robot.dynamics.effort
    told = []
    for s in np.flatnonzero(load > effort):
        unit = "N" if robot.kinematics.kind[s] == PRISMATIC else "N m"
        joint = robot.joint_names[int(robot.kinematics.dof[s])]
        told.append(f"{joint} needs {load[s]:.3g} {unit} (at most {effort[s]:.3g})")
    if told:
        warnings.warn(
            f"{robot.name} cannot hold itself {where}: gravity asks for more than the effort "
            f"limits of its file: {', '.join(told)}; in the simulation the arm falls",
            stacklevel=2,
        )
