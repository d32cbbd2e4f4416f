"""Masses and torque limits of the moving segments, summed over their links."""

import numpy as np

from optipromp.core.arrays import frozen
from optipromp.core.robots.description import rotation_of
from optipromp.core.robots.dynamics import Dynamics
from optipromp.readers.chain import Chain
from optipromp.readers.urdf import UrdfModel


def dynamics(model: UrdfModel, chain: Chain) -> Dynamics:
    """The dynamics of a chain; the inertials of links add up by the parallel-axis theorem."""
    count = len(chain.effort)
    mass, center, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    whole = np.ones(count, dtype=bool)
    bodies = [
        (place, given)
        for name, place in chain.placements.items()
        if place.segment >= 0 and (given := model.links[name].inertial) and given.mass > 0.0
    ]
    middles = [p.rotation @ np.array(given.xyz) + p.translation for p, given in bodies]
    for (place, given), middle in zip(bodies, middles, strict=True):
        mass[place.segment] += given.mass
        center[place.segment] += given.mass * middle
    center[mass > 0.0] /= mass[mass > 0.0, None]
    for (place, given), middle in zip(bodies, middles, strict=True):
        if given.tensor is None:
            whole[place.segment] = False
            continue
        xx, xy, xz, yy, yz, zz = given.tensor
        turn, off = place.rotation @ rotation_of(given.rpy), middle - center[place.segment]
        own = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        inertia[place.segment] += own + given.mass * (off @ off * np.eye(3) - np.outer(off, off))
    inertia[~whole] = 0.0
    return Dynamics(frozen(chain.effort), frozen(mass), frozen(center), frozen(inertia))
