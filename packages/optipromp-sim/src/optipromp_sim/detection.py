"""How a detector of fruits errs: the one model behind scenes as detected and behind closed loops.

:mod:`optipromp_sim.generate.noise` makes a scene as detected once;
:mod:`optipromp_sim.simulation.detector` makes picture after picture of a camera.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.parameters import Checked, parameter
from optipromp.core.scenes.scene import SceneObject
from optipromp.core.values import Part


@dataclass(frozen=True)
class Noise(Checked, label="noise_"):
    """The errors of a detector. Covariances of positions do not include ``lower``."""

    signed: ClassVar[tuple[str, ...]] = ("lower",)
    position: float = parameter(0.0, "m", "choice", "deviation of each coordinate; 0: exact")
    angle: float = parameter(0.0, "deg", "choice", "deviation of a stem's tilt, each axis")
    lower: float = parameter(0.0, "m", "choice", "of what hangs; positive: seen lower than it is")
    missed: Part = parameter(0.0, "1", "choice", "probability that a fruit in view is missed")
    hidden: Part = parameter(0.0, "1", "choice", "the same, wholly hidden; else by the share")


NOISES: dict[str, Noise] = {
    "zero-mean": Noise(0.005, 5.0),
    "low": Noise(0.005, 5.0, lower=0.010),
    "high": Noise(0.005, 5.0, lower=-0.010),
    "missed": Noise(0.005, 5.0, missed=0.05, hidden=0.5),
    "detector": Noise(0.005, 5.0, lower=0.010, missed=0.05, hidden=0.5),
}
"""Noise by name, with the sources of
:data:`optipromp_sim.simulation.detector_parameters.DETECTORS`."""


def displaced(
    item: SceneObject, error: FloatArray, covariance: FloatArray, variance: float, up: FloatArray,
    lower: float,
) -> tuple[FloatArray, FloatArray]:  # fmt: skip
    """Error (3,) [m] and covariance (3, 3) [m²] of a position as detected.

    An object that has no stem and is no ball stands upright on a known board: its ``error`` is
    horizontal, and its ``covariance`` lacks the vertical ``variance``. Another is seen ``lower``.
    """
    if item.stem is None and not isinstance(item.shape, Sphere):
        return error - (error @ up) * up, covariance - variance * np.outer(up, up)
    return error - lower * up, covariance


def turned(vector: FloatArray) -> FloatArray:
    """Rotation (3, 3) about ``vector`` (3,) by its length [rad]."""
    angle = float(np.linalg.norm(vector))
    return np.eye(3) if angle == 0.0 else rotation(vector / angle, angle)


def tilt(vector: FloatArray, angles: FloatArray) -> FloatArray:
    """Rotation (3, 3) that tilts ``vector`` (3,) by angles (2,) [rad] about two axes across it."""
    across = frame_along(vector / np.linalg.norm(vector))[:, :2]
    return turned(across @ angles)
