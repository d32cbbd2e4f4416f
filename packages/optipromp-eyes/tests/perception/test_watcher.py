"""Live eyes: which pictures are looked at, and what comes out."""

import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from threading import Event

import numpy as np
import pytest
from tests.perception.shots import shot_of

from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp_eyes import CameraModel, DepthPicture, EyeParameters, Finder, Found, Watcher, look_at
from optipromp_loop.control import Look

CAMERA = CameraModel(8, 6, 10.0, 10.0, 3.5, 2.5)
BLACK = np.zeros((6, 8, 3), np.uint8), np.zeros((6, 8))


class Slow(Finder):
    """Finds nothing, once it is let."""

    def __init__(self) -> None:
        self.let, self.began = Event(), Event()

    def find(self, picture: DepthPicture) -> Found:
        self.began.set()
        assert self.let.wait(10.0)
        return Found(())


class Broken(Finder):
    """Raises, whatever it is shown."""

    def find(self, picture: DepthPicture) -> Found:
        raise ValueError("no lens")


def test_of_pictures_that_come_meanwhile_the_newest_is_looked_at() -> None:
    finder = Slow()
    with ThreadPoolExecutor(1) as pool:
        watcher = Watcher(CAMERA, finder=finder, executor=pool)
        watcher(*BLACK, 0.0)
        assert finder.began.wait(10.0)
        for k in range(1, 5):
            watcher(*BLACK, 0.1 * k)
        assert watcher.looks() == ()
        finder.let.set()
        looks = list[Look]()
        begun = time.monotonic()
        while len(looks) < 2 and time.monotonic() < begun + 10.0:
            looks += watcher.looks()
    assert [look.time for look in looks] == [0.0, 0.4]
    assert watcher.skipped == 3
    assert watcher.looks() == ()


def test_what_a_finder_raises_reaches_the_controller_and_does_not_end_the_watch() -> None:
    with ThreadPoolExecutor(1) as pool:
        watcher = Watcher(CAMERA, finder=Broken(), executor=pool)
        watcher(*BLACK, 0.0)
    with pytest.raises(ValueError, match="no lens"):
        watcher.looks()
    assert watcher.looks() == ()


def test_a_process_gives_the_looks_of_the_caller() -> None:
    shot, given = shot_of(), EyeParameters(tilt=10.0)
    picture = shot.picture
    here = Watcher(picture.camera, up=shot.scene.up, parameters=given)
    here(picture.rgb, picture.depth, 1.5)
    (mine,) = here.looks()
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        there = Watcher(picture.camera, up=shot.scene.up, parameters=given, executor=pool)
        there(picture.rgb, picture.depth, 1.5)
    (theirs,) = there.looks()
    alone = look_at(picture, 1.5, up=shot.scene.up, parameters=given).look
    assert mine.time == theirs.time == 1.5
    assert len(alone.detections) >= 3
    for a, b, c in zip(mine.detections, theirs.detections, alone.detections, strict=True):
        assert (a.position == b.position).all()
        assert (a.position == c.position).all()
    assert len(there.sighting.detections) == len(theirs.detections)


def test_a_camera_on_the_hand_is_where_the_hand_was() -> None:
    mounted = CameraModel(8, 6, 10.0, 10.0, 3.5, 2.5, Pose([0.0, 0.1, 0.0]), "hand")
    watcher = Watcher(mounted)
    watcher(*BLACK, 0.0, Pose([1.0, 0.0, 0.5]))
    (look,) = watcher.looks()
    assert look.camera.position == pytest.approx([1.0, 0.1, 0.5])
    with pytest.raises(InvalidRequestError, match="tell where the hand was"):
        watcher(*BLACK, 0.1)
    with pytest.raises(InvalidRequestError, match="has no camera"):
        Watcher()(*BLACK, 0.0)


def test_pictures_that_wait_when_the_executor_ends_are_left_out() -> None:
    finder = Slow()
    pool = ThreadPoolExecutor(1)
    watcher = Watcher(CAMERA, finder=finder, executor=pool)
    watcher(*BLACK, 0.0)
    watcher(*BLACK, 0.1)
    pool.shutdown(wait=False)
    finder.let.set()
    pool.shutdown()
    assert [look.time for look in watcher.looks()] == [0.0]
