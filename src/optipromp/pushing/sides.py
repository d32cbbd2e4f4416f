r"""On which side of a pushable the tool passes: constraints 1 and 2 of OptI-ProMP (method §5).

The tool passes on the side away from the stem: :math:`d_n\cdot(fk-X_n)\ge R_{gripper}` with a unit
vector :math:`d_n` of the lateral plane. The paper's rule takes :math:`d_n=\pm y_g` with the sign of
:math:`-y_g\cdot S_n`; the general one takes :math:`d_n` against the lateral part of the stem. The
``shortest`` one, the planner's default, takes the way that leads least far from the approach line
among those that keep well clear of the stem: a tool that passes beside a fruit, at right angles to
the lean of its stem, comes no nearer to the stem than to the fruit.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, product
from typing import Literal, get_args

import numpy as np

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.scenes.scene import Scene, SceneObject

DriftRule = Literal["shortest", "lateral-plane", "paper"]
Window = Literal["rim", "paper"]
RELEASE = 0.5  # radii past a pushable's centre at which the rim may come back
UNDER = 0.006  # [m] that a rim, tilted a little, stays under a fruit it crosses beneath
ROOM_TO_TURN = 0.02  # [m] of height to go from one side to another
ALIKE = 0.7  # cosine from which two directions are one
LEAST_INCLINATION = np.deg2rad(1.0)
UPRIGHT = np.deg2rad(4.0)  # a stem that leans less stands in no side's way
WIDEST_TURN = np.deg2rad(60.0)  # from straight away from the stem
CENTRED = 0.5  # gripper radii from the approach line within which a fruit gives no direction
MOST_CHOICES = 8


@dataclass(frozen=True, eq=False)
class Drift:
    """Directions in which the tool passes the neighbours of one plan.

    Attributes:
        ids: neighbours, first met first.
        centers: (N, 3) their centres [m].
        directions: (N, 3) unit vectors of the lateral plane.
        windows: (N, 2) from where to where, along z_g from the centre, the tool point passes [m].
        berths: (N,) how much farther than R_gripper it should pass, in radii of the pushable; None:
            as the options say.
    """

    ids: tuple[str, ...]
    centers: FloatArray
    directions: FloatArray
    windows: FloatArray
    berths: FloatArray | None = None


def stem_side(
    scene: Scene, thing: SceneObject, rule: DriftRule, gripper_radius: float
) -> FloatArray | None:
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
    away = None if length < least else -flat / length
    if rule == "lateral-plane" or scene.target is None:
        return away
    off = scene.target.position - thing.position
    inwards = (x_g @ off) * x_g + (y_g @ off) * y_g
    distance = float(np.linalg.norm(inwards))
    if distance <= max(CENTRED * gripper_radius, 1e-6):
        return away
    inwards = inwards / distance
    if away is None or length < np.sin(UPRIGHT) * float(np.linalg.norm(stem)):
        return np.asarray(inwards)
    return _towards(away, inwards, WIDEST_TURN)


def _towards(start: FloatArray, goal: FloatArray, most: float) -> FloatArray:
    """The unit vector ``start`` turned towards another, ``goal``, by ``most`` [rad] at most."""
    cosine = float(np.clip(start @ goal, -1.0, 1.0))
    if cosine >= np.cos(most):
        return goal
    across = goal - cosine * start
    length = float(np.linalg.norm(across))
    if length < 1e-9:
        return start
    return np.asarray(np.cos(most) * start + np.sin(most) * across / length)


def passing_windows(
    scene: Scene,
    things: Sequence[SceneObject],
    directions: Sequence[FloatArray],
    window: Window,
    depth: float,
) -> FloatArray:
    """Heights (N, 2) of the tool point over each pushable between which its drift holds [m].

    The paper's window is the pushable's own extent about its centre. What decides whether a fruit
    ends inside or outside the mouth is the rim, ``depth`` [m] above the tool point: it must be
    aside before it reaches the pushable, so the ``rim`` window begins lower, by the depth. It ends
    where the paper's does, unless the tool is wanted elsewhere by then: where the rim takes in the
    target, or where the next pushable asks for another direction. Then it ends as soon as the rim
    is safely past the centre.
    """
    radii = np.array([thing.radius for thing in things])
    if window == "paper" or scene.target is None:
        return np.stack([-radii, radii], axis=1).reshape(-1, 2)
    up = scene.frame[2]
    heights = np.array([thing.position @ up for thing in things])
    capture = float(scene.target.position @ up) - depth - scene.target.radius
    wanted = [capture - ROOM_TO_TURN]
    out = np.empty((len(things), 2))
    for n in range(len(things) - 1, -1, -1):
        released = -depth + RELEASE * radii[n]
        elsewhere = [
            heights[m] - depth - radii[m] - UNDER - ROOM_TO_TURN
            for m in range(n + 1, len(things))
            if float(directions[m] @ directions[n]) < ALIKE
        ]
        free = min([*wanted, *elsewhere]) - heights[n]
        out[n] = -depth - radii[n] - UNDER, min(radii[n], max(free, released))
    return out


def drift_choices(
    scene: Scene,
    things: Sequence[SceneObject],
    rule: DriftRule = "lateral-plane",
    *,
    window: Window = "rim",
    depth: float = 0.0,
    gripper_radius: float = 0.0,
) -> tuple[Drift, ...]:
    """Every combination of sides the tool may pass ``things`` on, at most :data:`MOST_CHOICES`.

    A stem that leans decides its side; a vertical one, or none, leaves both ways along y_g open.
    The first choice leaves the approach line least. ``window`` and ``depth``: see
    :func:`passing_windows`. ``gripper_radius`` [m]: what ``shortest`` measures distances by.

    Raises:
        InvalidRequestError: an unknown rule or window.
    """
    if window not in ("rim", "paper"):
        raise InvalidRequestError(f"window is {window!r}; use 'rim' or 'paper'")
    if rule not in get_args(DriftRule):
        raise InvalidRequestError(f"drift is {rule!r}; use one of {', '.join(get_args(DriftRule))}")
    y_g = scene.frame[1]
    centers = np.array([thing.position for thing in things]).reshape(-1, 3)
    options: list[list[FloatArray]] = []
    for thing in things:
        side = stem_side(scene, thing, rule, gripper_radius)
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
            passing_windows(scene, things, directions, window, depth),
        )
        for directions in chosen
    )
