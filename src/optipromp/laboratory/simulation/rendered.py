"""A camera of a closed loop whose every look is a rendered picture that the eyes see."""

from dataclasses import replace

import numpy as np

from optipromp.control.look import Look
from optipromp.core.arrays import FloatArray
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.objects import STEM_SLACK
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import Scene, Stem
from optipromp.laboratory.simulation.detector import Detector, Truth
from optipromp.laboratory.simulation.detector_parameters import DetectorParameters
from optipromp.laboratory.simulation.photograph import photograph
from optipromp.perception.eyes import look_at
from optipromp.perception.finder import Finder
from optipromp.perception.parameters import eyes_of

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

    def expose(self, time: float, q: FloatArray, fruits: Truth) -> Look:
        """The detections of one picture, rendered at ``time`` [s] with the arm at ``q`` (n,)."""
        self._count += 1
        mount = self.parameters.mount
        shot = photograph(self.moment(q, fruits), mount, self._first + self._count)
        p = eyes_of(self.scene.crop)
        look = look_at(shot.picture, time, up=self.scene.up, finder=self._finder, parameters=p).look
        if mount == "beside":
            return look
        return replace(look, detections=tuple(replace(o, stem=None) for o in look.detections))

    def moment(self, q: FloatArray, fruits: Truth) -> Scene:
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
