"""Tracks: what is known of each fruit besides its motion, and what a look saw of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Shape
from optipromp.core.parameters import GRAVITY, Checked, parameter
from optipromp.core.pushing.parameters import PUSH
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import Role, SceneObject
from optipromp.core.scenes.rotations import product

ROLES: tuple[Role, ...] = ("target", "avoid", "pushable")
"""Roles of tracks. Of roles with as many votes the first holds."""


@dataclass(frozen=True)
class TrackerParameters(Checked):
    """Numbers of the tracker: motion, errors of looks, association, birth and death."""

    frequencies: tuple[float, ...] = parameter(
        (0.35, 0.5, 0.65, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8), "Hz", "measured", "of the sway"
    )
    damping: float = parameter(0.03, "1", "guess", "ratio of the sway's oscillators")
    sway: float = parameter(0.006, "m", "guess", "prior deviation of the sway along an axis")
    learning: float = parameter(0.7, "s", "measured", "in which amplitudes follow looks; 0: fixed")
    least_sway: float = parameter(0.25, "1", "choice", "least amplitude over its prior")
    swing: float = parameter(0.002, "m", "guess", "prior deviation of a fruit's own swing, an axis")
    most_swing: float = parameter(1.5, "1", "measured", "largest amplitude over its prior")
    swing_damping: float = parameter(0.02, "1", "guess", "ratio of a swing, beside its stem's")
    stem_damping: float = parameter(0.06, "s", "guess", "over its stiffness; as in the simulation")
    drift: float = parameter(0.001, "m/√s", "guess", "random walk of a rest position, an axis")
    steady: float = parameter(0.3, "1", "guess", "of a detection's covariance: looks leave it")
    grain: float = parameter(0.0002, "m", "choice", "least error: keeps covariances regular")
    pushed_share: float = parameter(0.3, "1", "guess", "error of a predicted push over its length")
    pushed_least: float = parameter(0.002, "m", "guess", "least error of a predicted push")
    stem_length: float = parameter(0.15, "m", "guess", "of a stem whose length was never seen")
    gate: float = parameter(13.93, "1", "choice", "largest square of a match: 99.7 % of χ², of 3")
    conflict: float = parameter(4.0, "1", "choice", "square for a target matched with what is none")
    near: float = parameter(0.6, "1", "choice", "over the sum of radii: two are one")
    shift: float = parameter(0.06, "m", "choice", "largest common displacement between two looks")
    # beside a common displacement, in standard deviations of an innovation along an axis
    alike: float = parameter(2.4, "1", "choice", "largest distance of a fruit from its place")
    felt: float = parameter(2.5, "1", "choice", "least common displacement, in the same")
    jump: float = parameter(1.3, "1", "choice", "as near, of a fruit that was not where expected")
    detected: float = parameter(0.9, "1", "guess", "probability to detect a visible fruit")
    spurious: float = parameter(0.05, "1", "guess", "probability of something else at its place")
    born: float = parameter(0.5, "1", "guess", "probability that a new detection is a fruit")
    confirm: int = parameter(2, "1", "choice", "matches after birth that confirm a track")
    within: int = parameter(3, "1", "choice", "looks at a visible fruit within which they must be")
    missed: int = parameter(3, "1", "choice", "misses after which a tentative track dies")
    die: int = parameter(12, "1", "choice", "misses in a row after which a confirmed track dies")
    reach: float = parameter(0.8, "m", "guess", "from the camera: beyond, a fruit is not missed")
    # where a look states no limit: depth cameras measure from 0.07-0.3 m on
    close: float = parameter(0.1, "m", "reported", "of a front: nearer, a fruit is not missed")
    late: float = parameter(0.2, "s", "choice", "age of a look that is still folded in")
    kept: int = parameter(2000, "1", "choice", "updates whose innovations are kept")
    # a look takes 9 ms and a prediction 2 then, with 48 tracks 24 and 5, of a cycle of 20 ms
    most: int = parameter(24, "1", "measured", "tracks; of a look the nearest twice as many count")
    beside: float = parameter(0.15, "m", "choice", "from the target: there odds count half")


@dataclass(frozen=True, eq=False)
class Seen:
    """Detections of a look in the base frame, in an order that depends on what was seen only."""

    items: tuple[SceneObject, ...]  # D detections, in the frame of the camera
    positions: FloatArray  # (D, 3) [m]
    covariances: FloatArray  # (D, 3, 3) [m²]
    turn: FloatArray  # (3, 3) the camera's rotation
    look: Look  # that they are of

    @classmethod
    def of(cls, look: Look) -> "Seen":
        """The detections of ``look``; static ones are left out."""
        items = [item for item in look.detections if item.role != "static"]
        turn = look.camera.rotation
        places = np.array([item.position for item in items]).reshape(-1, 3)
        positions = places @ turn.T + look.camera.position
        order = np.lexsort(positions.T)
        items = [items[k] for k in order]
        spread = np.array([item.covariance for item in items]).reshape(-1, 3, 3)
        return cls(tuple(items), positions[order], turn @ spread @ turn.T, turn, look)

    def nearest(self, centre: FloatArray, most: int) -> tuple["Seen", float]:
        """The ``most`` detections nearest to ``centre`` (3,), and the distance of the last [m]."""
        away = lengths(self.positions - centre)
        rows = np.sort(np.argsort(away, kind="stable")[:most])
        items = tuple(self.items[k] for k in rows.tolist())
        fewer = replace(
            self, items=items, positions=self.positions[rows], covariances=self.covariances[rows]
        )
        return fewer, float(away[rows].max())


@dataclass(frozen=True, eq=False)
class Track:
    """What is known of one fruit, its motion left out."""

    id: str  # of the track
    shape: Shape  # as last detected
    orientation: FloatArray  # quaternion (4,) in the base frame, as last detected
    physical: Mapping[str, float]  # as last detected
    votes: tuple[int, int, int]  # number of detections as target, avoid, pushable
    tilts: FloatArray  # (2,) sum of the seen tilts of the stem along the horizontal axes [rad]
    lengths: float  # sum of the seen lengths [m]
    stems: int  # number of seen stems
    spread: FloatArray  # (3, 3) covariance of the last detection [m²]
    # (3,) displacement by the arm at the last look [m]
    pushed: FloatArray = field(default_factory=lambda: np.zeros(3))
    outcomes: tuple[bool, ...] = ()  # whether it was found in the last looks at it, newest last
    # looks at it in which it was not found, in all for a tentative track, else in a row
    lost: int = 0
    jumps: int = 0  # looks in a row that found it outside the gate
    confirmed: bool = False  # whether it counts as a fruit
    existence: float = 0.5  # probability that there is a fruit
    last_seen: float = -math.inf  # time [s]; minus infinity for a track that no look has seen

    @property
    def radius(self) -> float:
        """Radius [m] of a ball that contains the shape."""
        return self.shape.measure.bound

    def length(self, parameters: TrackerParameters) -> float:
        """Length of the stem [m]: the mean of the seen ones, or the default."""
        return self.lengths / self.stems if self.stems else parameters.stem_length

    def direction(self, up: FloatArray, axes: FloatArray) -> FloatArray:
        """(3,) unit vector along the stem, from the fruit to the root."""
        if not self.stems:
            return up
        tilt = self.tilts / self.stems
        angle = math.hypot(*tilt)
        return np.asarray(math.cos(angle) * up + np.sinc(angle / np.pi) * (tilt @ axes))

    def swing(self, parameters: TrackerParameters) -> tuple[float, float]:
        r"""Angular frequency [rad/s] and damping ratio of the swing.

        A pendulum on an elastic stem of length L has ω² = g / L + 3 EI / (m L³). A stem that holds
        its fruit of mass m at a tilt t is at least so stiff that without the fruit it would turn
        by the angle ``grown_turn`` of the push model: EI ≥ m g L² sin t / (2 grown_turn).
        """
        arm, beam = self.length(parameters), PUSH.beam
        mass = beam.fruit_density * self.shape.volume
        tilt = 0.0 if not self.stems else math.hypot(*self.tilts) / self.stems
        round_beam = beam.youngs_modulus * math.pi * beam.diameter**4 / 64.0
        implied = 0.5 * mass * GRAVITY * arm**2 * math.sin(tilt) / beam.grown_turn
        elastic = 3.0 * max(round_beam, implied) / (mass * arm**3)
        omega = math.sqrt(GRAVITY / arm + elastic)
        zeta = parameters.swing_damping + 0.5 * parameters.stem_damping * elastic / omega
        return omega, min(zeta, 0.9)


def new_track(name: str, item: SceneObject, seen: Seen | None, plant: "Frame") -> Track:
    """The track that a detection starts.

    ``seen``: that it is of; None: it stands in the base frame. ``plant``: the vertical and the
    horizontal axes.
    """
    if item.role not in ROLES:
        raise InvalidRequestError(f"object {item.id} has role {item.role}: must be a fruit's")
    vote = ROLES.index(item.role)
    turn = np.eye(3) if seen is None else seen.turn
    camera = None if seen is None else seen.look.camera.orientation
    tilt, length, stems = _stem(item, turn, plant)
    assert item.covariance is not None
    return Track(
        id=name,
        shape=item.shape,
        orientation=item.orientation if camera is None else product(camera, item.orientation),
        physical=item.physical,
        votes=(int(vote == 0), int(vote == 1), int(vote == 2)),
        tilts=tilt,
        lengths=length,
        stems=stems,
        spread=np.asarray(turn @ item.covariance @ turn.T),
    )


@dataclass(frozen=True, eq=False)
class Frame:
    """The vertical ``up`` (3,) and two horizontal ``axes`` (2, 3), unit vectors."""

    up: FloatArray
    axes: FloatArray


def push_noise(push: FloatArray, given: TrackerParameters) -> FloatArray:
    """(F, 3, 3) covariance of the error of predicted pushes (F, 3) [m²]."""
    squares = (push**2).sum(axis=1)
    variance = np.where(squares > 0.0, given.pushed_share**2 * squares + given.pushed_least**2, 0.0)
    return np.asarray(variance[:, None, None] * np.eye(3))


def _stem(item: SceneObject, turn: FloatArray, frame: Frame) -> tuple[FloatArray, float, int]:
    if item.stem is None or item.stem.unseen:
        return np.zeros(2), 0.0, 0
    points = item.stem.points
    way = turn @ (points[-1] - points[0])
    flat = frame.axes @ way
    aside = math.hypot(*flat)
    angle = math.atan2(aside, float(frame.up @ way))
    return flat * (angle / aside if aside > 0.0 else 0.0), item.stem.length, 1
