r"""On which side of a pushable the tool passes: constraints 1 and 2 of OptI-ProMP (method §5).

The tool passes on the side away from the stem: :math:`d_n\cdot(fk-X_n)\ge R_{gripper}` with a unit
vector :math:`d_n` of the lateral plane. The paper's rule takes :math:`d_n=\pm y_g` with the sign of
:math:`-y_g\cdot S_n`; the general one takes :math:`d_n` against the lateral part of the stem.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Literal

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.scenes.scene import Scene, SceneObject

DriftRule = Literal["lateral-plane", "paper"]
Window = Literal["rim", "paper"]
CAPTURE_MARGIN = 0.003  # [m] under the target at which the rim must be free to close in
LEAST_INCLINATION = np.deg2rad(1.0)
MOST_CHOICES = 8


@dataclass(frozen=True, eq=False)
class Drift:
    """Directions in which the tool passes the neighbours of one plan.

    Attributes:
        ids: neighbours, first met first.
        centers: (N, 3) their centres [m].
        directions: (N, 3) unit vectors of the lateral plane.
        windows: (N, 2) from where to where, along z_g from the centre, the tool point passes [m].
    """

    ids: tuple[str, ...]
    centers: FloatArray
    directions: FloatArray
    windows: FloatArray


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


def passing_window(
    scene: Scene, thing: SceneObject, window: Window, depth: float
) -> tuple[float, float]:
    """Heights of the tool point over a pushable between which the drift holds [m].

    The paper's window is the pushable's own extent about its centre. What decides whether a fruit
    ends inside or outside the mouth is the rim, ``depth`` [m] above the tool point: it must be
    aside before it reaches the pushable, and may come back once it has passed the centre where
    otherwise it would be aside of the target too. So the ``rim`` window begins lower, by the depth,
    and ends where the rim begins to take in the target.
    """
    radius = thing.radius
    if window == "paper" or scene.target is None:
        return -radius, radius
    height = float((scene.target.position - thing.position) @ scene.frame[2])
    capture = height - depth - scene.target.radius - CAPTURE_MARGIN
    return -depth - radius, min(radius, max(capture, -depth))


def drift_choices(
    scene: Scene,
    things: Sequence[SceneObject],
    rule: DriftRule = "lateral-plane",
    *,
    window: Window = "rim",
    depth: float = 0.0,
) -> tuple[Drift, ...]:
    """Every combination of sides the tool may pass ``things`` on, at most :data:`MOST_CHOICES`.

    A stem that leans decides its side; a vertical one, or none, leaves both ways along y_g open.
    The first choice leaves the approach line least. ``window`` and ``depth``: see
    :func:`passing_window`.

    Raises:
        InvalidRequestError: an unknown rule or window.
    """
    if window not in ("rim", "paper"):
        raise InvalidRequestError(f"window is {window!r}; use 'rim' or 'paper'")
    if rule not in ("lateral-plane", "paper"):
        raise InvalidRequestError(f"drift is {rule!r}; use 'lateral-plane' or 'paper'")
    y_g = scene.frame[1]
    centers = np.array([thing.position for thing in things]).reshape(-1, 3)
    windows = np.array([passing_window(scene, t, window, depth) for t in things]).reshape(-1, 2)
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
    chosen = islice(product(*options), MOST_CHOICES)
    return tuple(
        Drift(
            tuple(thing.id for thing in things),
            centers,
            np.array(directions).reshape(-1, 3),
            windows,
        )
        for directions in chosen
    )
