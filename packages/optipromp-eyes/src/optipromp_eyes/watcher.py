"""Live eyes: a camera's callback feeds pictures in, the closed loop takes looks out."""

from concurrent.futures import Executor, Future
from contextlib import suppress
from threading import Lock

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.eyes import Sighting, look_at
from optipromp_eyes.finder import Finder
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import CameraModel, DepthPicture, Image8, taken


class Watcher:
    """Turns the pictures of a camera into looks.

    One picture is looked at at a time. Of those that come meanwhile the newest waits, and the
    others are left out. Any thread may feed pictures in; the thread of the controller takes looks:

        watcher = Watcher(camera, executor=ProcessPoolExecutor(1))
        watcher(rgb, depth, time)                    # in the camera's callback
        for look in watcher.looks():                 # in each cycle
            controller.see(look)

    Args:
        camera: that takes the pictures; None: each brings its own, by :meth:`watch`.
        up: (3,) upwards in the robot's base frame; None: its z axis.
        finder: of fruits and stems; None: that of :func:`look_at`.
        parameters: of the measuring.
        executor: that looks at pictures, such as ``ProcessPoolExecutor(1)``. A thread shares
            Python's lock with the controller and makes its cycles late. None: the caller looks, and
            waits for it.

    Attributes:
        skipped: number of pictures that were left out.
        sighting: the last one that :meth:`looks` gave; None: none yet.
    """

    def __init__(
        self,
        camera: CameraModel | None = None,
        *,
        up: FloatArray | None = None,
        finder: Finder | None = None,
        parameters: EyeParameters | None = None,
        executor: Executor | None = None,
    ) -> None:
        self.skipped = 0
        self.sighting: Sighting | None = None
        self._camera, self._executor = camera, executor
        self._settings = {"up": up, "finder": finder, "parameters": parameters}
        self._lock = Lock()
        self._running: Future[Sighting] | None = None
        self._next: tuple[DepthPicture, float] | None = None  # and the time of its exposure
        self._done: list[Sighting | BaseException] = []

    def __call__(
        self, rgb: Image8, depth: FloatArray, time: float, hand: Pose | None = None
    ) -> None:
        """Feed a picture in.

        Args:
            rgb: (height, width, 3) sRGB, 0 to 255.
            depth: (height, width) along the camera's z axis [m]; 0 or NaN: not measured.
            time: of the exposure, by the clock of the controller [s].
            hand: the flange in the base at that time; for a camera on it.

        Raises:
            InvalidRequestError: sizes that differ, or a camera on the hand and no ``hand``.
        """
        if self._camera is None:
            raise InvalidRequestError("the watcher has no camera: give it one, or use watch")
        self.watch(taken(rgb, depth, self._camera.on(hand)), time)

    def watch(self, picture: DepthPicture, time: float) -> None:
        """Feed a picture in that has its camera; ``time``: of the exposure [s]."""
        if self._executor is None:
            self._done.append(look_at(picture, time, **self._settings))  # type: ignore[arg-type]
            return
        with self._lock:
            self.skipped += self._next is not None
            self._next = picture, time
        self._go_on()

    def looks(self) -> tuple[Look, ...]:
        """The looks that were made since the last call, oldest first.

        Raises:
            Exception: what a finder raised.
        """
        with self._lock:
            done, self._done = self._done, []
        for each in done:
            if isinstance(each, BaseException):
                raise each
            self.sighting = each
        return tuple(each.look for each in done if isinstance(each, Sighting))

    def _go_on(self) -> None:
        """Begin the picture that waits, if none is looked at."""
        with self._lock:
            if self._running is not None or self._next is None:
                return
            due, self._next = self._next, None
            assert self._executor is not None
            self._running = self._executor.submit(look_at, *due, **self._settings)  # type: ignore[arg-type]
            running = self._running
        running.add_done_callback(self._ended)

    def _ended(self, future: "Future[Sighting]") -> None:
        if future.cancelled():  # the executor was shut down
            return
        with self._lock:
            self._running = None
            self._done.append(future.exception() or future.result())
        with suppress(RuntimeError):  # the executor was shut down
            self._go_on()
