r"""On which side of a pushable the tool passes: constraints 1 and 2 of OptI-ProMP (method §5).

The tool passes on the side away from the stem: :math:`d_n\cdot(fk-X_n)\ge R_{gripper}` with a unit
vector :math:`d_n` of the lateral plane. The paper's rule takes :math:`d_n=\pm y_g` with the sign of
:math:`-y_g\cdot S_n`; the general one takes :math:`d_n` against the lateral part of the stem.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.scenes.scene import Scene, SceneObject

DriftRule = Literal["lateral-plane", "paper"]
LEAST_INCLINATION = np.deg2rad(1.0)
MOST_CHOICES = 8


@dataclass(frozen=True, eq=False)
class Drift:
    """Directions in which the tool passes the neighbours of one plan.

    Attributes:
        ids: neighbours, first met first.
        centers: (N, 3) their centres [m].
        directions: (N, 3) unit vectors of the lateral plane.
        half_heights: (N,) half of each passing window along z_g [m].
    """

    ids: tuple[str, ...]
    centers: FloatArray
    directions: FloatArray
    half_heights: FloatArray


def stem_side(scene: Scene, thing: SceneObject, rule: DriftRule) -> FloatArray | None:
    """Direction (3,) away from the stem of ``thing``, or None where its stem gives no side."""
    if thing.stem is None:
        return None
    x_g, y_g, _ = scene.frame
    stem = thing.stem.vector
    least = np.sin(LEAST_INCLINATION) * float(np.linalg.norm(stem))
    if rule == "paper":
        share = float(y_g @ stem)
        return None if abs(share) < least else np.asarray(-np.sign(share) * y_g)
    flat = (x_g @ stem) * x_g + (y_g @ stem) * y_g
    length = float(np.linalg.norm(flat))
    return None if length < least else -flat / length


def drift_choices(
    scene: Scene, things: Sequence[SceneObject], rule: DriftRule = "lateral-plane"
) -> tuple[Drift, ...]:
    """Every combination of sides the tool may pass ``things`` on, at most :data:`MOST_CHOICES`.

    A stem that leans decides its side; a vertical one, or none, leaves both ways along y_g open.
    The first choice leaves the approach line least.

    Raises:
        InvalidRequestError: an unknown rule.
    """
    if rule not in ("lateral-plane", "paper"):
        raise InvalidRequestError(f"drift is {rule!r}; use 'lateral-plane' or 'paper'")
    y_g = scene.frame[1]
    centers = np.array([thing.position for thing in things]).reshape(-1, 3)
    options: list[list[FloatArray]] = []
    for thing in things:
        side = stem_side(scene, thing, rule)
        if side is not None:
            options.append([side])
            continue
        assert scene.target is not None  # things are neighbours of a target
        away = float(y_g @ (scene.target.position - thing.position))
        first = 1.0 if away >= 0.0 else -1.0
        options.append([first * y_g, -first * y_g])
    chosen = list(product(*options))[:MOST_CHOICES]
    return tuple(
        Drift(
            tuple(thing.id for thing in things),
            centers,
            np.array(directions).reshape(-1, 3),
            np.array([thing.radius for thing in things]),
        )
        for directions in chosen
    )
