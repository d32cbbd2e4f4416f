"""A camera with a detector behind it, without images: late, noisy and blocked.

:class:`Detector` turns the truth of one moment into a :class:`~optipromp.core.scenes.look.Look`.
:class:`Eye` takes pictures at the detector's rate and delivers looks after its latency.
"""

import math
from collections import deque
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along
from optipromp.core.errors import InvalidRequestError
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.hand import tool_frame
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene, SceneObject, Stem
from optipromp_sim.detection import displaced, tilt, turned
from optipromp_sim.simulation.detector_parameters import DETECTORS as DETECTORS
from optipromp_sim.simulation.detector_parameters import DetectorParameters as DetectorParameters
from optipromp_sim.simulation.sight import Leaf, Sight, hand_pose, standing_pose, view_of

if TYPE_CHECKING:
    from optipromp_sim.simulation.simulation import FruitStates

LOWER = 0.05  # [m] of a stem that tells its direction: as long as peduncles are in pictures
LEAF_CAP = math.radians(60.0)  # about the line to the first picture, within which leaves hang
LEAST_DISTANCE = 0.1  # [m] of a false detection from the camera: a choice
SLACK = 1e-9  # [s] rounding of sums of times


class Truth(NamedTuple):
    """Where fruits are at one moment, in the base frame; a simulation may tell it."""

    ids: tuple[str, ...]
    """F names of objects of the scene; those left out are where the scene has them."""
    positions: FloatArray  # (F, 3) [m]
    rotations: FloatArray  # (F, 3, 3), local to base
    stem_ends: tuple[FloatArray, ...]
    """F polylines (N, 3) [m], root first; fewer than two points: no stem."""


@dataclass(frozen=True, eq=False)
class _Draws:
    """The random numbers of one picture, a row for each fruit."""

    error: FloatArray  # (F, 3) standard normal, as tilt
    tilt: FloatArray  # (F, 2)
    chance: FloatArray  # (F,) from 0 to 1, as held
    held: FloatArray  # (F, 3): chance of a miss, whether it is steady, chance of a stem
    swap: FloatArray  # (2,): whether two exchange ids, and which


class _Chances:
    """The random numbers of a detector of ``count`` fruits, whose slots take ``slot`` seconds."""

    def __init__(self, count: int, slot: float, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, 9])
        self.error = rng.standard_normal((count, 3))  # that stays, as tilt
        self.tilt = rng.standard_normal((count, 2))
        self._slot, self._phase = slot, slot * rng.random(count)
        self.leafy = rng.random((count, 3))
        self._slots = np.full(count, np.iinfo(np.int64).min)
        self._held = np.zeros((count, 3))

    def at(self, time: float) -> _Draws:
        """Those of a picture at a time [s]."""
        count = len(self._phase)
        normal, even = self.rng.standard_normal((count, 5)), self.rng.random((count, 4))
        slots = np.floor((time + self._phase) / self._slot).astype(np.int64)
        new = slots != self._slots
        self._held[new], self._slots = even[new, 1:], slots
        swap = self.rng.random(2)
        return _Draws(normal[:, :3], normal[:, 3:], even[:, 0], self._held.copy(), swap)


class Detector:
    """A camera and its detector.

    Errors are drawn for all fruits at every picture, so that those of one do not depend on what
    is seen of others. A fruit has slots of ``parameters.slot`` seconds, of a phase of its own. In
    a share ``missed_steadily`` of slots the chance of a miss is drawn once, in the others at every
    picture: the share of pictures in which a fruit is missed is the same.

    An object that has no stem and is no ball stands on a known board: its errors are horizontal,
    the camera's own left out. Detections have no ``physical``, and their stems no parents.

    Args:
        scene: the true one: shapes, roles, ids, lengths of stems, static objects.
        robot: with its tool.
        parameters: of camera and detector.
        seed: the same seed and the same calls give the same looks, to the bit.
    """

    def __init__(
        self, scene: Scene, robot: Robot, parameters: DetectorParameters, seed: int = 0
    ) -> None:
        self.scene, self.robot, self.parameters = scene, robot, parameters
        self.fruits = tuple(item for item in scene.objects if item.role != "static")
        self._rows = {item.id: row for row, item in enumerate(self.fruits)}
        palm = parameters.mount == "palm"
        self._sight = Sight(tuple(item.shape for item in self.fruits), scene, robot, palm)
        self.view = view_of(robot, parameters)
        self._hand, self._stand = hand_pose(robot, parameters), standing_pose(scene, parameters)
        self._chances = _Chances(len(self.fruits), parameters.slot, seed)
        self._false = np.random.default_rng([seed, 9, 1])
        self._false_count = 0
        shift = parameters.camera_offset * self._chances.rng.standard_normal(3)
        turn = math.radians(parameters.camera_turn) * self._chances.rng.standard_normal(3)
        self.miscalibration = Pose(shift, turned(turn))
        """The believed pose of the camera in its true frame."""
        self._leaves: tuple[Leaf, ...] | None = None

    def camera(self, q: FloatArray) -> Pose:
        """The true pose of the camera in the base frame at ``q`` (n,)."""
        if self.parameters.mount == "beside":
            return self._stand
        return tool_frame(self.robot, q) @ self._hand

    def believed(self, q: FloatArray) -> Pose:
        """The pose of the camera in the base frame at ``q`` (n,) as looks state it."""
        return self.camera(q) @ self.miscalibration

    def expose(self, time: float, q: FloatArray, fruits: "Truth | FruitStates") -> Look:
        """The detections of one picture.

        Args:
            time: of the exposure [s].
            q: (n,) configuration at that time.
            fruits: where they are at that time.

        Raises:
            InvalidRequestError: an id of ``fruits`` is not in the scene, or static, or repeats.
        """
        camera = self.camera(q)
        positions, rotations, stems = self._placed(fruits)
        draws = self._chances.at(time)
        if self._leaves is None:
            self._leaves = self._grown(camera, positions)
        seen = self._seen(camera, tool_frame(self.robot, q), positions, rotations, draws)
        found = [
            self._detection(row, camera, Pose(positions[row], rotations[row]), stems[row], draws)
            for row in np.flatnonzero(seen).tolist()
        ]
        found += self._wrong(camera, positions, rotations, stems)
        found = self._exchanged(found, draws)
        p = self.parameters
        return Look(time, self.believed(q), tuple(found), self.view, p.near, p.far)

    def _placed(
        self, fruits: "Truth | FruitStates"
    ) -> tuple[FloatArray, FloatArray, list[FloatArray]]:
        """Positions, rotations and stems, fruit first, of all fruits of the scene."""
        positions = np.array([item.position for item in self.fruits]).reshape(-1, 3)
        rotations = np.array([item.rotation for item in self.fruits]).reshape(-1, 3, 3)
        stems = [np.zeros((0, 3)) if o.stem is None else o.stem.points for o in self.fruits]
        if len(set(fruits.ids)) < len(fruits.ids):
            raise InvalidRequestError(f"ids repeat in {', '.join(fruits.ids)}: must be unique")
        for at, name in enumerate(fruits.ids):
            row = self._rows.get(name)
            if row is None:
                raise InvalidRequestError(f"{name!r} is no fruit of scene {self.scene.name!r}")
            positions[row], rotations[row] = fruits.positions[at], fruits.rotations[at]
            stems[row] = np.asarray(fruits.stem_ends[at])[::-1]
        return positions, rotations, stems

    def _grown(self, camera: Pose, positions: FloatArray) -> tuple[Leaf, ...]:
        """Leaves before some fruits, each in a direction within a cap about the camera's."""
        leaves = []
        for row, (chance, height, turn) in enumerate(self._chances.leafy.tolist()):
            if chance < self.parameters.leaf:
                way = camera.position - positions[row]
                axes = frame_along(way / np.linalg.norm(way))
                z = 1.0 - height * (1.0 - math.cos(LEAF_CAP))
                flat, turn = math.sqrt(1.0 - z * z), 2.0 * math.pi * turn
                direction = axes @ [flat * math.cos(turn), flat * math.sin(turn), z]
                radius = self.parameters.leaf_size * self.fruits[row].radius
                leaves.append(Leaf(row, direction, 2.0 * radius, radius))
        return tuple(leaves)

    def _seen(
        self, camera: Pose, frame: Pose, positions: FloatArray, rotations: FloatArray, draws: _Draws
    ) -> FloatArray:
        """Whether (F,) each fruit is found."""
        p = self.parameters
        local = (positions - camera.position) @ camera.rotation
        off = np.arctan2(np.hypot(local[:, 0], local[:, 1]), local[:, 2])
        chance = np.where(draws.held[:, 1] < p.missed_steadily, draws.held[:, 0], draws.chance)
        blind = np.full(len(positions), p.missed)
        if p.hidden != p.missed:
            share = self._sight.hidden(
                camera.position, frame, positions, rotations, self._leaves or ()
            )
            ramp = (share - p.hidden_from) / (p.hidden_to - p.hidden_from)
            blind += (p.hidden - p.missed) * np.clip(ramp, 0.0, 1.0)
        away = np.linalg.norm(local, axis=1)
        measured = (off <= 0.5 * self.view) & (away >= p.near) & (away <= p.far)
        return np.asarray(measured & (chance >= blind))

    def _detection(
        self, row: int, camera: Pose, pose: Pose, stem: FloatArray, draws: _Draws
    ) -> SceneObject:
        """The fruit as found, in the frame of the camera."""
        p, item = self.parameters, self.fruits[row]
        away = camera.inverse() @ pose
        distance = float(np.linalg.norm(away.position))
        far = (distance / p.reference) ** 2
        white, kept = math.sqrt(1.0 - p.steady), math.sqrt(p.steady)
        sigma, up = p.sigma(distance), camera.rotation.T @ self.scene.up
        error = sigma * (white * draws.error[row] + kept * self._chances.error[row])
        sight = away.position / max(distance, SLACK)
        error += (p.along - 1.0) * (error @ sight) * sight + p.bias * far * sight
        spread = sigma**2 * (np.eye(3) + (p.along**2 - 1.0) * np.outer(sight, sight))
        error, spread = displaced(item, error, spread, sigma**2, up, p.lower)
        place = away.position + error
        hanging = self._hanging(row, pose, stem, draws)
        if hanging is not None:
            angles = white * draws.tilt[row] + kept * self._chances.tilt[row]
            angles *= math.radians(p.angle) * far
            lower = camera.rotation.T @ hanging
            along = tilt(lower, angles) @ lower
            assert item.stem is not None
            base = float(np.linalg.norm(item.stem.points[0] - item.position))
            own = Stem.along(place, along, base + item.stem.length, item.stem.radius)
        return SceneObject(
            item.id, item.role, item.shape, place, away.orientation,
            stem=None if hanging is None else own, covariance=spread + self._calibration(place),
        )  # fmt: skip

    def _hanging(self, row: int, pose: Pose, stem: FloatArray, draws: _Draws) -> FloatArray | None:
        """The direction (3,) of the lower part of a stem that is seen and holds its fruit."""
        item = self.fruits[row]
        if item.stem is None or len(stem) < 2 or draws.held[row, 2] >= self.parameters.stem_seen:
            return None
        if np.linalg.norm(stem[0] - pose.position) > item.radius + LOWER:
            return None  # it has come off
        pieces = np.linalg.norm(np.diff(stem, axis=0), axis=1)
        heights = np.concatenate([[0.0], np.cumsum(pieces)])
        end = [np.interp(LOWER, heights, stem[:, axis]) for axis in range(3)]
        way = np.array(end) - stem[0]
        return way if np.linalg.norm(way) > 0.0 else None

    def _calibration(self, place: FloatArray) -> FloatArray:
        """Covariance (3, 3) that the camera's offset and turn add at ``place`` (3,) [m²]."""
        p = self.parameters
        across = place @ place * np.eye(3) - np.outer(place, place)
        turned = math.radians(p.camera_turn) ** 2 * across
        return np.asarray(float(p.told) * (p.camera_offset**2 * np.eye(3) + turned))

    def _wrong(
        self, camera: Pose, positions: FloatArray, rotations: FloatArray, stems: list[FloatArray]
    ) -> list[SceneObject]:
        """False fruits: each as one of the scene is found, anywhere in the cone, about as far."""
        p, rng, out, count = self.parameters, self._false, list[SceneObject](), len(positions)
        like = [k for k, item in enumerate(self.fruits) if item.role != "target"] or range(count)
        away = np.linalg.norm(positions - camera.position, axis=1)
        for _ in range(int(rng.poisson(p.false)) if count else 0):
            self._false_count += 1
            z = 1.0 - rng.random() * (1.0 - math.cos(0.5 * self.view))
            turn, flat = 2.0 * math.pi * rng.random(), math.sqrt(1.0 - z * z)
            distance = max(np.median(away) * rng.uniform(0.7, 1.3), LEAST_DISTANCE)  # a choice
            place = camera @ (
                distance * np.array([flat * math.cos(turn), flat * math.sin(turn), z])
            )
            row = int(rng.choice(like))
            draws = _Draws(
                rng.standard_normal((count, 3)), rng.standard_normal((count, 2)),
                rng.random(count), rng.random((count, 3)), rng.random(2),
            )  # fmt: skip
            stem, pose = stems[row] + (place - positions[row]), Pose(place, rotations[row])
            found = self._detection(row, camera, pose, stem, draws)
            out.append(replace(found, id=f"{found.id}-{self._false_count}", role="pushable"))
        return out

    def _exchanged(self, found: list[SceneObject], draws: _Draws) -> list[SceneObject]:
        """The detections, two neighbours of which have exchanged ids at times."""
        if len(found) < 2 or draws.swap[0] >= self.parameters.swapped:
            return found
        first = int(draws.swap[1] * len(found))
        away = [float(np.linalg.norm(o.position - found[first].position)) for o in found]
        away[first] = math.inf
        second = int(np.argmin(away))
        one, other = found[first], found[second]
        found[first], found[second] = replace(one, id=other.id), replace(other, id=one.id)
        return found


class Eye:
    """A detector that takes pictures at its rate and delivers them late.

    Args:
        detector: that takes the pictures.
    """

    def __init__(self, detector: Detector) -> None:
        self.detector = detector
        self._first: float | None = None
        self._count = 0
        self._waiting: deque[Look] = deque()
        self._arm: deque[tuple[float, FloatArray]] = deque()  # times [s], configurations (n,)
        self._held: tuple[float, Look] | None = None  # end of a picture that stands still [s], it

    def see(self, time: float, q: FloatArray, fruits: "Truth | FruitStates") -> bool:
        """Take a picture if one is due; whether one was taken.

        Pictures are due ``1 / rate`` apart from the first call on. To be called at every tick; of
        pictures that fell due since the last call one is taken.
        """
        if self._first is None:
            self._first = time
        p = self.detector.parameters
        self._arm.append((time, q))
        while self._arm[0][0] < time - p.latency - 2.0 * abs(p.stamp) - 1.0 / p.rate:
            self._arm.popleft()
        due = math.floor((time - self._first + SLACK) * self.detector.parameters.rate)
        if due < self._count:
            return False
        self._count = due + 1
        look = self.detector.expose(time, q, fruits)
        self._waiting.append(self._frozen(look, time, q, fruits) if p.frozen > 0.0 else look)
        return True

    def _frozen(
        self, look: Look, time: float, q: FloatArray, fruits: "Truth | FruitStates"
    ) -> Look:
        """The look with the picture that stands still, while one does."""
        p, target = self.detector.parameters, self.detector.scene.target
        if self._held is None and target is not None:
            places = dict(zip(fruits.ids, fruits.positions, strict=True))
            place = places.get(target.id, target.position)
            away = np.linalg.norm(place - self.detector.camera(q).position)
            if away < p.frozen_at:
                self._held = time + p.frozen, look
        if self._held is None or time >= self._held[0]:
            return look
        return replace(look, detections=self._held[1].detections)

    def _stamped(self, look: Look) -> Look:
        """The look with its stamp, and the pose of the camera at that time."""
        at = look.time + self.detector.parameters.stamp
        times = [time for time, _ in self._arm]
        joints = np.array([q for _, q in self._arm]).T
        q = np.array([np.interp(at, times, joint) for joint in joints])
        return replace(look, time=at, camera=self.detector.believed(q))

    def delivered(self, now: float) -> tuple[Look, ...]:
        """The looks whose time and latency have passed at ``now`` [s], oldest first, each once."""
        out, stamp = list[Look](), self.detector.parameters.stamp
        latest = now - max(self.detector.parameters.latency, stamp) + SLACK
        while self._waiting and self._waiting[0].time <= latest:
            look = self._waiting.popleft()
            out.append(look if stamp == 0.0 else self._stamped(look))
        return tuple(out)
