"""The circle from picture to pick (``optipromp study --eyes``): see, plan, execute in the truth.

============  =====================================================================================
``rendered``  the scene is photographed from beside and seen by the eyes; in the closed loop every
              look is such a picture, from the palm. A second takes five: for a handful of scenes
``fitted``    looks are of the camera model with the numbers of these eyes,
              :data:`optipromp.laboratory.simulation.detector_parameters.EYES`
============  =====================================================================================

Where the first picture shows no ripe fruit, a second one is taken from the side. Where that shows
none either, the open loop gives up (cause ``not_seen``), and the closed one looks on its own.

The target is the lowest ripe fruit that is seen. Of several fruits that truly are ripe, the one
nearest to it becomes the true scene's target, so the pick of any ripe fruit counts.

What is executed is the scene as photographed: objects to avoid are the fruits of a real
neighbouring cluster. Its stems are bowed as in every simulation; those of the first picture are
straight.
"""

import functools
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from optipromp.core.arrays import rotation
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.scenes.held import pairs_among
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import JointGoal, Scene, SceneObject
from optipromp.core.scenes.values import suggest
from optipromp.laboratory.experiments.conditions import CONDITIONS, Situation
from optipromp.laboratory.experiments.seeing import SeenPicture, matched, middle
from optipromp.laboratory.simulation.detector import Detector, Truth, perceived_scene
from optipromp.laboratory.simulation.detector_parameters import EYES
from optipromp.laboratory.simulation.parameters import SimulationParameters
from optipromp.laboratory.simulation.photograph import photograph
from optipromp.laboratory.simulation.rendered import RenderedDetector
from optipromp.laboratory.simulation.sight import standing_pose
from optipromp.perception.eyes import look_at, seen_scene
from optipromp.perception.finder import Finder
from optipromp.perception.geometry import ByGeometry

WAYS = "rendered", "fitted"


def _network() -> Finder:
    from optipromp.perception.network import ByNetwork

    return ByNetwork()


FINDERS: Mapping[str, Callable[[], Finder]] = {"geometry": ByGeometry, "network": _network}
"""Makers of finders, by name."""

SIDES = 0.0, 70.0  # [deg] about the vertical, of the first and the second camera: a choice
RENDERED_RATE = 5.0  # [Hz] of rendered looks, each of which takes a second to make: a choice
NOT_SEEN = "not_seen"
"""Cause of a run in which no ripe fruit was seen."""


def situation(condition: str, scene: Scene, seed: int, finder: str) -> Situation:
    """The setting of a condition, or of eyes; the same arguments give the same setting."""
    if condition == "rendered":
        return _rendered(scene, seed, FINDERS[finder]())
    return _fitted(scene, seed) if condition == "fitted" else CONDITIONS[condition](scene, seed)


def check_eyes(eyes: tuple[str, ...], finder: str) -> None:
    """Refuse names that are none.

    Raises:
        InvalidRequestError: an unknown way of seeing, or an unknown finder.
    """
    for item in eyes:
        if item not in WAYS:
            raise InvalidRequestError(f"eyes is {item!r}: {suggest(item, WAYS)}")
    if finder not in FINDERS:
        raise InvalidRequestError(f"finder is {finder!r}: {suggest(finder, tuple(FINDERS))}")


def seen_figures(pictures: list[SeenPicture]) -> dict[str, Any]:
    """What rows tell of the pictures before a plan: counts, and the time of seeing [s]."""
    last = pictures[-1]
    visible = [fruit for fruit in last.fruits if fruit.visible]
    return {
        "pictures": len(pictures),
        "visible": len(visible),
        "found": sum(fruit.found for fruit in visible),
        "false": last.false,
        "see_time": sum(picture.seconds for picture in pictures),
    }


def without_fruits(scene: Scene) -> Scene:
    """The scene as known before any picture."""
    gone = {item.id for item in scene.objects if item.role != "static"}
    return replace(
        scene, objects=scene.static, may_touch=pairs_among(scene.may_touch, gone),
        goal=JointGoal(posed(scene)[1].q),
    )  # fmt: skip


def aimed_at(scene: Scene, ripe: set[str], seen: SceneObject) -> Scene:
    """The true scene, whose target is that of its ``ripe`` fruits nearest to a seen one."""
    fruits = [item for item in scene.objects if item.id in ripe]
    if not fruits:
        return scene
    aim = min(fruits, key=lambda item: float(np.linalg.norm(middle(item) - seen.position)))
    if aim.role == "target":
        return scene
    roles = {aim.id: "target", **({scene.target.id: "pushable"} if scene.target else {})}
    return replace(
        scene,
        objects=tuple(replace(o, role=roles.get(o.id, o.role)) for o in scene.objects),  # type: ignore[arg-type]
    )


def _cameras(scene: Scene) -> list[Pose]:
    """The standing camera, and the same turned about the vertical through the target."""
    first = standing_pose(scene, EYES["beside"])
    seen = first.position if scene.target is None else scene.target.position
    out = []
    for angle in SIDES:
        turn = rotation(scene.up, np.deg2rad(angle))
        out.append(Pose(seen + turn @ (first.position - seen), turn @ first.rotation))
    return out


def _rendered(scene: Scene, seed: int, finder: Finder) -> Situation:
    pictures: list[SeenPicture] = []
    seen, truth = without_fruits(scene), scene
    for k, camera in enumerate(_cameras(scene)):
        shot = photograph(replace(scene, camera=camera), "beside", seed + k)
        began = time.process_time()
        sight = look_at(shot.picture, up=scene.up, finder=finder)
        pictures.append(matched(shot, sight, time.process_time() - began))
        try:
            seen, _ = seen_scene(sight, scene)
        except InvalidRequestError:  # no ripe fruit is seen
            continue
        assert seen.target is not None
        ripe = {mark.id for mark in shot.marked if mark.kind == "ripe"}
        truth = aimed_at(scene, ripe, seen.target)
        break
    detector = replace(EYES["palm"], rate=RENDERED_RATE)
    eye = functools.partial(RenderedDetector, finder=finder)
    return Situation(truth, seen, detector, _physics(), eye, seen_figures(pictures))


def _fitted(scene: Scene, seed: int) -> Situation:
    robot, state = posed(scene)
    seen, count = without_fruits(scene), 0
    for camera in _cameras(scene):
        count += 1
        eye = Detector(replace(scene, camera=camera), robot, EYES["beside"], seed + count - 1)
        look = eye.expose(0.0, state.q, Truth((), np.zeros((0, 3)), np.zeros((0, 3, 3)), ()))
        try:
            seen = perceived_scene(look, scene)
        except InvalidRequestError:  # the target is not seen
            continue
        break
    return Situation(scene, seen, EYES["palm"], _physics(), Detector, {"pictures": count})


def _physics() -> SimulationParameters:
    p = SimulationParameters()
    return replace(p, thing=replace(p.thing, avoid_as="fruits"))
