"""The circle from picture to pick (``eyes`` of a study): see, plan, execute in the truth.

``rendered``: the scene is photographed from beside and seen by the eyes; in the closed loop every
look is such a picture, from the palm. ``fitted``: looks are of the camera model with the numbers of
these eyes, :data:`optipromp_sim.simulation.detector_parameters.EYES`. When a second picture
is taken, and which fruit is the target, docs/eyes.md says.

What is executed is the scene as photographed: objects to avoid are the fruits of a real
neighbouring cluster. Its stems are bowed as in every simulation; those of the first picture are
straight.
"""

import functools
import math
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypedDict

import numpy as np

from optipromp.core.arrays import FloatArray, frame_along, rotation
from optipromp.core.errors import InvalidRequestError, check_one_of
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.held import pairs_among
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.objects import STEM_SLACK
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import JointGoal, Role, Scene, SceneObject, Stem
from optipromp_eyes.detector import finder_named
from optipromp_eyes.eyes import Detection, Sighting, look_at, seen_scene
from optipromp_eyes.finder import Finder, Found, Region
from optipromp_eyes.parameters import eyes_of
from optipromp_eyes.stems import SeenStem, Spheroid
from optipromp_sim.simulation.detector import Detector, Truth
from optipromp_sim.simulation.detector_parameters import EYES, DetectorParameters
from optipromp_sim.simulation.parameters import SimulationParameters
from optipromp_sim.simulation.photograph import FRUITS, Photograph, photograph
from optipromp_sim.simulation.sight import standing_pose
from optipromp_sim.simulation.simulation import FruitStates
from optipromp_sim.situations import CONDITIONS, Situation

OFTEN = 10_000  # pictures of one seed: above those of a pick


class RenderedDetector(Detector):
    """A detector that renders the moment and looks at the picture.

    Light, colours, background and the errors of depth are drawn anew for each picture. A picture
    takes a second, so ``parameters.rate`` is best low. Of ``parameters``, mount, rate and latency
    count. Stems are taken from a standing camera only: one below a fruit sees the stems of others.

    Args:
        scene: the true one.
        robot: with its tool.
        parameters: of camera and delays.
        seed: of all pictures.
        finder: of fruits and stems; None: by geometry.
    """

    def __init__(
        self, scene: Scene, robot: Robot, parameters: DetectorParameters, seed: int = 0,
        finder: Finder | None = None,
    ) -> None:  # fmt: skip
        super().__init__(scene, robot, parameters, seed)
        self._finder, self._first, self._count = finder, OFTEN * seed, 0

    def expose(self, time: float, q: FloatArray, fruits: Truth | FruitStates) -> Look:
        """The detections of one picture, rendered at ``time`` [s] with the arm at ``q`` (n,)."""
        self._count += 1
        mount = self.parameters.mount
        shot = photograph(self.moment(q, fruits), mount, self._first + self._count)
        p = eyes_of(self.scene.crop)
        look = look_at(shot.picture, time, up=self.scene.up, finder=self._finder, parameters=p).look
        if mount == "beside":
            return look
        return replace(look, detections=tuple(replace(o, stem=None) for o in look.detections))

    def moment(self, q: FloatArray, fruits: Truth | FruitStates) -> Scene:
        """The scene with the arm at ``q`` (n,) and the fruits where they are."""
        positions, rotations, stems = self._placed(fruits)
        moved = {}
        for item, place, turn, points in zip(self.fruits, positions, rotations, stems, strict=True):
            stem = None
            holds = (
                len(points) > 1 and np.linalg.norm(points[0] - place) <= item.radius + STEM_SLACK
            )
            if item.stem is not None and holds:
                stem = Stem(np.asarray(points), item.stem.radius)
            moved[item.id] = replace(
                item, position=place, orientation=to_quaternion(turn), stem=stem
            )
        objects = tuple(moved.get(item.id, item) for item in self.scene.objects)
        return replace(self.scene, start=q, camera=self._stand, objects=objects)


WAYS = "rendered", "fitted"


SIDES = 0.0, 70.0  # [deg] about the vertical, of the first and the second camera: a choice
LOWER = 0.05  # [m] below the target, at which the camera looks: a choice
OTHER = 1_000_000  # added to the seed of a further picture
RENDERED_RATE = 5.0  # [Hz] of rendered looks, each of which takes a second to make: a choice
STILL = Truth((), np.zeros((0, 3)), np.zeros((0, 3, 3)), ())
"""Fruits that are where the scene has them."""
NOTHING, NO_PIXELS = Found(()), np.zeros((0, 0), dtype=np.bool_)
NOT_SEEN = "not_seen"
"""Cause of a run in which no ripe fruit was seen."""


class Pictures(TypedDict, total=False):
    """What pictures show before a plan; columns of rows have these names."""

    pictures: int
    visible: int
    found: int
    false: int
    see_time: float


class _Sight(NamedTuple):
    sight: Sighting
    ripe: frozenset[str]  # ids of the fruits in the picture that truly are ripe
    told: Mapping[str, Any]  # of Pictures


def situation(
    condition: str, scene: Scene, seed: int, finder: str = "geometry", views: int = 1
) -> Situation:
    """The setting of a condition, or of eyes; the same arguments give the same setting.

    Of the ``views`` before a plan, see :class:`optipromp_bench.experiments.study.Study`.
    """
    if condition == "rendered":
        found = finder_named(finder, parameters=eyes_of(scene.crop))
        eye = functools.partial(RenderedDetector, finder=found)
        detector = replace(EYES["palm"], rate=RENDERED_RATE)
        see = functools.partial(_by_picture, finder=found)
        return _looked(see, scene, seed, eye, detector, cameras(scene), views)
    if condition == "fitted":
        return _looked(_by_model, scene, seed, Detector, EYES["palm"], cameras(scene), views)
    return CONDITIONS[condition](scene, seed)


def check_eyes(eyes: tuple[str, ...], finder: str, views: int) -> None:
    """Refuse names that are none."""
    for item in eyes:
        check_one_of("eyes", item, WAYS)
    if not 1 <= views <= len(SIDES):
        raise InvalidRequestError(f"views is {views}; must be 1 to {len(SIDES)}")
    if eyes:
        finder_named(finder)


def without_fruits(scene: Scene) -> Scene:
    """The scene as known before any picture."""
    gone = {item.id for item in scene.objects if item.role != "static"}
    return replace(
        scene, objects=scene.static, may_touch=pairs_among(scene.may_touch, gone),
        goal=JointGoal(posed(scene)[1].q), place=None,
    )  # fmt: skip


def aimed_at(scene: Scene, ripe: Collection[str], place: FloatArray) -> Scene:
    """The true scene, whose target is that of its ``ripe`` fruits nearest to a ``place`` (3,)."""
    fruits = [item for item in scene.objects if item.id in ripe]
    if not fruits:
        return scene
    aim = min(fruits, key=lambda item: float(np.linalg.norm(middle(item) - place)))
    if aim.role == "target":
        return scene
    roles: dict[str, Role] = {i.id: "pushable" for i in scene.objects if i.role == "target"}
    roles[aim.id] = "target"
    return scene.each(lambda item: replace(item, role=roles.get(item.id, item.role)))


DRAWN_TURN, DRAWN_TILT = 30.0, 12.0  # [deg] of the drawn camera about the bunch: choices
DRAWN_AWAY = 0.9, 1.25  # of a drawn camera's distance over that of a standing one: a choice
DRAWN_AIM = 0.02  # [m] deviation of each coordinate of what it looks at: a choice


def drawn_camera(scene: Scene, seed: int) -> Pose:
    """Where a picture is taken from that does not tell which fruit is the target.

    The camera stands beside the middle of the bunch as :func:`cameras` does beside the target, but
    turned about the vertical, tilted, at a distance and with an aim that are drawn.
    """
    rng = np.random.default_rng([seed, 11])
    bunch = [item.position for item in scene.objects if item.role in ("target", "pushable")]
    middle = np.mean(bunch, axis=0)
    away = standing_pose(scene, EYES["beside"], middle).position - middle
    across = np.cross(scene.up, away)
    tilt = rotation(across / np.linalg.norm(across), np.deg2rad(rng.uniform(-1, 1) * DRAWN_TILT))
    turn = rotation(scene.up, np.deg2rad(rng.uniform(-1, 1) * DRAWN_TURN))
    place = middle + rng.uniform(*DRAWN_AWAY) * (turn @ tilt @ away)
    way = middle - LOWER * scene.up + DRAWN_AIM * rng.standard_normal(3) - place
    return Pose(place, frame_along(way / np.linalg.norm(way)))


def cameras(scene: Scene) -> tuple[Pose, ...]:
    """Where pictures are taken from, in turn: beside the target, and turned about its vertical.

    A camera of hanging fruits looks below the target, where the others hang in the tool's way.
    """
    first = standing_pose(scene, EYES["beside"])
    if scene.target is None:
        return (first,)
    middle = scene.target.position
    if scene.camera is None and scene.target.stem is not None:
        way = middle - LOWER * scene.up - first.position
        first = Pose(first.position, frame_along(way / np.linalg.norm(way)))
    turns = (rotation(scene.up, np.deg2rad(angle)) for angle in SIDES)
    return tuple(
        Pose(middle + turn @ (first.position - middle), turn @ first.rotation) for turn in turns
    )


def _looked(
    see: Callable[[Scene, int], _Sight], scene: Scene, seed: int, eye: Callable[..., Detector],
    detector: DetectorParameters, places: Sequence[Pose], views: int, before: Sequence[_Sight] = (),
) -> Situation:  # fmt: skip
    """The setting after ``views`` pictures, or more until one shows a ripe fruit."""
    p = SimulationParameters()
    physics = replace(p, thing=replace(p.thing, avoid_as="fruits"))
    taken, seen = list(before), None
    while len(taken) < len(places) and (len(taken) < views or seen is None):
        shown = replace(scene, camera=places[len(taken)])
        taken.append(see(shown, seed + OTHER * len(taken)))
        try:
            seen = seen_scene([each.sight for each in taken], scene)[0]
        except InvalidRequestError:  # no ripe fruit is seen
            seen = None
    sums = {name: sum(each.told[name] for each in taken) for name in taken[-1].told}
    told = {**sums, "pictures": len(taken)}
    further, truth = None, scene
    if seen is not None and seen.target is not None:
        truth = aimed_at(scene, taken[-1].ripe, seen.target.position)
    if len(taken) < len(places):
        further = functools.partial(
            _looked, see, scene, seed, eye, detector, places, len(taken) + 1, taken
        )
    return Situation(truth, seen or without_fruits(scene), detector, physics, eye, told, further)


def _by_picture(scene: Scene, seed: int, finder: Finder) -> _Sight:
    shot = photograph(scene, "beside", seed)
    began = time.process_time()
    p = eyes_of(scene.crop)
    sight = look_at(shot.picture, up=scene.up, finder=finder, parameters=p)
    seconds = time.process_time() - began
    fruits, wrong = paired(shot, sight)
    visible = [fruit for fruit in fruits if fruit.visible]
    told: Pictures = {
        "visible": len(visible), "found": sum(fruit.detection is not None for fruit in visible),
        "false": len(wrong), "see_time": seconds,
    }  # fmt: skip
    ripe = frozenset(mark.id for mark in shot.marked if mark.kind == "ripe")
    return _Sight(sight, ripe, told)


def _by_model(scene: Scene, seed: int) -> _Sight:
    robot, state = posed(scene)
    look = Detector(scene, robot, EYES["beside"], seed).expose(0.0, state.q, STILL)
    return _Sight(Sighting(look, tuple(map(_detection, look.detections)), NOTHING), frozenset(), {})


def _detection(item: SceneObject) -> Detection:
    """A detection of the model as one of a picture that has no pixels."""
    region = Region("ripe" if item.role == "target" else "unripe", NO_PIXELS, 1.0)
    assert item.covariance is not None
    fit = Spheroid(
        item.position, item.rotation[:, 2], item.radius, item.radius, item.covariance,
        *([math.nan] * 6),
    )  # fmt: skip
    stem = None
    if item.stem is not None:
        way, length = item.stem.vector / item.stem.length, item.stem.length
        stem = SeenStem(way, length, math.radians(EYES["beside"].angle), length)
    return Detection(item, region, fit, stem)


LEAST_SHARE = 0.4  # of its outline that is seen of a visible fruit: a choice
LEAST_PIXELS = 150  # of a visible fruit: a choice


class Paired(NamedTuple):
    """A fruit of a photograph, and the detection that matches it."""

    item: SceneObject  # the true fruit, in the base frame
    center: FloatArray  # (3,) true middle of its extent in the frame of the camera [m]
    detection: Detection | None  # that matches it; None: it was not found
    share: float  # part of its outline that shows
    visible: bool  # whether enough shows that it must be found


def paired(shot: Photograph, sight: Sighting) -> tuple[list[Paired], list[Detection]]:
    """The fruits of a photograph beside what is seen of them, and the detections left over.

    A detection matches the nearest fruit, each once, the largest share first, if the centres are
    closer than the fruit's bounding radius. The centre of a fruit is the middle of its extent along
    its own axes. A detection of a fruit of which too little shows is not false.
    """
    free, fruits = list(sight.detections), []
    for mark in sorted((m for m in shot.marked if m.kind in FRUITS), key=lambda m: -m.share):
        item = shot.fruits[mark.id]
        center = shot.picture.camera.pose.inverse() @ middle(item)
        away = [float(np.linalg.norm(each.item.position - center)) for each in free]
        match = None
        if away and min(away) < item.radius:
            match = free.pop(int(np.argmin(away)))
        pixels = int(shot.mask(mark.id, *FRUITS).sum())
        visible = mark.share >= LEAST_SHARE and pixels >= LEAST_PIXELS
        fruits.append(Paired(item, center, match, mark.share, visible))
    return fruits, free


def middle(item: SceneObject) -> FloatArray:
    """The middle (3,) of a fruit's extent along its own axes, in the base frame [m]."""
    corners = item.shape.surface().reshape(-1, 3)
    return np.asarray(
        item.position + item.rotation @ (0.5 * (corners.min(axis=0) + corners.max(axis=0)))
    )
