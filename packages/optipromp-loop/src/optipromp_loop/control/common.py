"""What the stages share: the robot, what is believed, the arm's curve, the picks so far."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.scene import Scene
from optipromp_loop.control import plant
from optipromp_loop.control.camera import CameraWatch
from optipromp_loop.control.driver import Driver
from optipromp_loop.control.felt import Felt
from optipromp_loop.control.parameters import LoopParameters
from optipromp_loop.control.solids import Solids
from optipromp_loop.control.tracker import Tracked, Tracker
from optipromp_loop.control.tracks import TrackerParameters


@dataclass
class Looks:
    """The looks that wait for their time, and what is known of the newest.

    Attributes:
        inbox: that wait.
        newest: time of the newest [s]; minus infinity: none has come.
        came: when it came, or the first cycle began [s].
        eye: (3,) place of the camera at it [m].
    """

    inbox: list[Look] = field(default_factory=list)
    newest: float = -math.inf
    came: float | None = None
    eye: FloatArray | None = None

    def due(self, time: float) -> list[Look]:
        """The looks whose time has come; looks may come late and out of order."""
        due = [look for look in self.inbox if look.time <= time]
        self.inbox = [look for look in self.inbox if look.time > time]
        newest = max((look.time for look in due), default=-math.inf)
        if self.came is None or newest > self.newest:
            self.came, self.newest = time, newest
        return due


class Common:
    """What every stage may read, and the few things that it may change.

    Attributes:
        scene: as it was told; ``robot``: with its tool; ``seed``: of the plans.
        tracker: of the fruits; ``camera``: checked against the arm's motion; ``looks``: that came.
        driver: of the arm; ``felt``: at its tool.
        picks: that were committed to, the last one runs.
        tries: looks again that are left, after a retreat or a refused pick.
        over: why there is no other try; empty: there may be one.
    """

    def __init__(
        self, scene: Scene, robot: Robot | None, seed: int, parameters: LoopParameters
    ) -> None:
        if moving := [item.id for item, _ in scene.movers if item.role != "pushable"]:
            told = "a closed loop follows fruits alone; leave the motion out, or plan without one"
            raise InvalidRequestError(f"{', '.join(moving)} move: {told}")
        self.robot, state = posed(scene, robot)
        self._told = scene = plant.tracked_at_most(scene, TrackerParameters.most)
        self.seed, self.parameters = seed, parameters
        self.camera, self.looks = CameraWatch(self.robot, parameters), Looks()
        self.felt = Felt(scene.up, parameters)
        self.driver = Driver(scene, self.robot, state, parameters)
        self.know_what_was_told()
        self.tries, self.over, self.picks = parameters.tries, "", list[Picked]()

    def know_what_was_told(self) -> None:
        """Forget what looks have shown of fruits and of things: it was seen elsewhere."""
        self.scene = scene = self._told
        first = plant.first_tracks(scene, self.parameters.known)
        self.tracker = Tracker(scene, first=first, tool=self._mouth)
        self._solids, self._appeared = Solids(scene), False
        self.driver.stands(scene)

    def _mouth(self, time: float) -> FloatArray:
        return plant.mouth_balls(self.robot, self.camera.configuration(time), self.looks.eye)

    def stands(self, look: Look, among: bool) -> None:
        """Take what a look shows, and nothing explains, into the scene; see :class:`Solids`."""
        q = self.camera.configuration(look.time)
        solids = self._solids.after(look, self.tracker, self.robot, q, among=among)
        if solids is not self._solids:
            self._appeared, self._solids, self.scene = True, solids, solids.scene
            self.driver.stands(self.scene)

    def blocked(self) -> bool:
        """Whether something has appeared since the last call, and the arm's course touches it."""
        new, self._appeared = self._appeared, False
        return (
            new
            and self.driver.course is not None
            and not self.driver.safe(self.driver.course.curve)
        )

    @property
    def holding(self) -> bool:
        """Whether the tool leaves with the target, or has left: a gripper may close."""
        return self.driver.held

    @property
    def plans(self) -> list[Plan]:
        """The reaches of the picks that were committed to."""
        return [pick.reach for pick in self.picks]

    @property
    def known(self) -> bool:
        """Whether fruits were known before the first look."""
        return any(item.role in ("target", "pushable") for item in self.scene.objects)

    def hidden(self, tracked: Tracked, since: float) -> dict[str, str | None]:
        """The fruits that no look has shown ``since`` a time [s], and what hides each."""
        return {} if self.looks.eye is None else plant.unseen(tracked, self.looks.eye, since)

    def left_out(self, tracked: Tracked, since: float) -> str:
        """In words, what a pick does not know: fruits out of sight, and those not tracked."""
        told = ""
        if missing := self.hidden(tracked, since):
            names = (f"{a} (behind {b})" if b else a for a, b in missing.items())
            told += f"; not seen from here: {', '.join(names)}"
        if self.tracker.left:
            told += f"; {self.tracker.left} that were seen are not tracked, as too many"
        return told
