"""A picker's recording: where its arm was, what was detected, when its gripper closed; its picks.

A recording is a JSON or YAML file with a table (``docs/shadow.md``), or a bag of ROS 2.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import lengths
from optipromp.core.documents import read_document, read_table
from optipromp.core.errors import InvalidRequestError, InvalidSceneError
from optipromp.core.files import check_inside, is_bag, reading
from optipromp.core.parameters import Checked, parameter
from optipromp.core.planning.task import posed
from optipromp.core.robots.measured import GAP, Measured, Series
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.held import RETREAT
from optipromp.core.scenes.io import object_of
from optipromp.core.scenes.look import Look
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.scene import Scene
from optipromp.core.scenes.schema import OBJECT, POSE, Model, values
from optipromp.core.trajectory import Trajectory
from optipromp.parts import part

UNKNOWN_VIEW = 1e-3
"""[rad] View of a camera whose place was not recorded: it misses nothing."""


@dataclass(frozen=True)
class CutParameters(Checked):
    """How the picks of a recording are cut."""

    step: float = parameter(0.05, "s", "choice", "between the waypoints of a recorded motion")
    # noise of 1e-3 rad over it gives a slope of 0.005 rad/s
    window: float = parameter(0.2, "s", "choice", "over which the slope of a joint is taken")
    still: float = parameter(0.03, "rad/s or m/s", "choice", "below it, every joint stands")
    away: float = parameter(RETREAT, "m", "choice", "of a pick's begin and end from its grasp")
    longest: float = parameter(120.0, "s", "choice", "from a grasp to the pick's begin or end")
    closes: float = parameter(0.2, "1", "choice", "share of the gripper's range that closes it")
    opens: float = parameter(0.1, "1", "choice", "share below which it is open again")
    looked: float = parameter(1.0, "s", "choice", "from a picture to the next that is looked at")


CUT = CutParameters()


class Mark(Model):
    """A pick, in times of the recording [s]; None of a begin and an end: they are found."""

    closed: float
    start: float | None = None
    end: float | None = None


@dataclass(frozen=True, eq=False)
class Recording:
    """What was recorded; looks and picks are sorted by time."""

    arm: Measured
    looks: Sequence[Look]
    marks: Sequence[Mark]
    cut: str  # how the picks were cut, in words
    lacks: Sequence[str]  # what was not recorded, and what follows from that


@dataclass(frozen=True, eq=False)
class Span:
    """The motions of one pick, in times of the recording [s]."""

    start: float
    closed: float
    end: float  # when the tool was out of the plant
    reach: Trajectory  # from start to closed
    out: Trajectory | None  # from closed to end; None: it was not recorded


class _Look(Model):
    time: float
    objects: list[OBJECT]
    camera: POSE | None = None
    view: float = 1.2


class _Picture(Model):
    time: float
    rgb: str
    depth: str | None = None
    camera: dict[str, Any] | str | None = None


class _File(Model):
    joint_states: str = "states.csv"
    gripper: str | None = None
    looks: list[_Look] | None = None
    pictures: list[_Picture] | None = None
    camera: dict[str, Any] | str | None = None
    picks: list[Mark] | None = None


def load_recorded(
    path: Path, scene: Scene, *, gripper: str | None = None, marks: Path | None = None, **bag: Any
) -> Recording:
    """The recording of a file or a bag.

    ``path``: JSON or YAML as ``docs/shadow.md`` has it, or a bag. ``scene``: whose robot was
    recorded. ``gripper``: joint that closes the gripper. ``marks``: a file with the ``picks``, in
    place of the gripper. ``bag``: further arguments of the part ``load_picks``.

    Raises:
        InvalidRequestError: no recording; neither marks nor a gripper.
        InvalidSceneError: a wrong value of a detection.
    """
    stated = None if marks is None else _read(marks).picks
    if is_bag(path):
        found: Recording = part("load_picks")(path, scene, gripper=gripper, marks=stated, **bag)
        return found
    file = _read(path)
    with reading(path, "no recording", passes=(InvalidSceneError,)):
        csv = check_inside(path.parent / file.joint_states, path.parent, InvalidRequestError)
        table = read_table(csv, InvalidRequestError, "time,<joint>,...")
        numbers = dict(zip(table.header, table.numbers(range(len(table.header))).T, strict=True))
        times, gripper = numbers.pop("time"), gripper or file.gripper
        arm = Measured(posed(scene)[0].joint_names, posed(scene)[0].turns, what=str(path))
        for time, *q in zip(times.tolist(), *numbers.values(), strict=True):
            arm.heard(time, list(numbers), q)
        closing = None if gripper is None else Series(times, numbers[gripper][:, None])
        looks = [_look(look) for look in file.looks or ()]
        seen = [] if looks else list(_seen(file, path, scene, arm))
        return recorded(arm, looks, closing, gripper, stated or file.picks, seen)


def _read(path: Path) -> _File:
    content = read_document(path, InvalidRequestError, "a recording")
    with reading(path, "no recording"):
        return _File.model_validate(content)


def recorded(
    arm: Measured, looks: Sequence[Look], closing: Series | None, gripper: str | None,
    stated: Sequence[Mark] | None, seen: Sequence[Look] = (),
) -> Recording:  # fmt: skip
    """A recording, whose picks are cut by what is ``stated``, else where the gripper closes: its
    joint (T, 1), ``closing``, is named ``gripper``; None: it was not recorded. ``seen``: what the
    eyes saw in its pictures, where there are no ``looks``."""
    arm.series()  # tells what is missing
    if stated is None and closing is None:
        raise InvalidRequestError(
            f"{arm.what}: neither a gripper nor picks are recorded: name the gripper's joint "
            "(--gripper JOINT), or the times at which it closed (--marks FILE)"
        )
    cut, lacks = "as the recording's marks say", list[str]()
    if stated is None and closing is not None:
        cut = f"where {gripper} closes; its first value counts as open"
        stated = [Mark(closed=time) for time in closings(closing)]
    if not looks:
        told = f"by our eyes, in {len(seen)} of its pictures" if seen else "no pick is judged"
        lacks.append(f"detections: {told}")
        looks = seen
    if looks and not any(item.stem for look in looks for item in look.detections):
        lacks.append("stems: each fruit is taken to hang from one that leads upwards")
    if blind := sum(look.view == UNKNOWN_VIEW for look in looks):
        told = f"where the camera was, in {blind} of {len(looks)} looks"
        lacks.append(f"{told}: a fruit that such a look does not show may be there")
    marks = sorted(stated or (), key=lambda mark: mark.closed)
    return Recording(arm, sorted(looks, key=lambda look: look.time), marks, cut, lacks)


def _look(given: _Look) -> Look:
    camera = Pose() if given.camera is None else Pose(**values(given.camera, 1.0))
    view, up = UNKNOWN_VIEW if given.camera is None else given.view, np.array([0.0, 0.0, 1.0])
    made = [(object_of(item, 1.0, None, {}, up), item.frame == "camera") for item in given.objects]
    here = camera.inverse()
    items = (item if there else item.transformed(here) for item, there in made)
    return Look(given.time, camera, tuple(items), view)


def _seen(file: _File, path: Path, scene: Scene, arm: Measured) -> Iterator[Look]:
    """What the eyes see in a file's pictures, at one in ``CUT.looked``; what a picture's camera
    states counts before what that of the file does."""

    def named(name: str) -> Path:
        return check_inside(path.parent / name, path.parent, InvalidRequestError)

    def camera(given: dict[str, Any] | str | None) -> Any:
        if isinstance(given, str):
            return read_document(named(given), InvalidRequestError, "a camera")
        return given or {}

    last = -math.inf
    for one in sorted(file.pictures or (), key=lambda one: one.time):
        if one.time < last + CUT.looked:
            continue
        last = one.time
        if one.depth is None:
            raise InvalidRequestError(
                f"picture {one.rgb} has no depth: name a file of it (depth: a.depth.png), which is "
                "registered to the colours, or state the detections as looks"
            )
        both = {**camera(file.camera), **camera(one.camera)}
        yield part("look_at_files")(named(one.rgb), named(one.depth), both, scene, one.time, arm.at)


def closings(joint: Series) -> Iterator[float]:
    """The times [s] at which a gripper closes whose ``joint`` (T, 1) is open at first."""
    away, closed = np.abs(joint.q[:, 0] - joint.q[0, 0]), False
    share = away / max(float(away.max()), 1e-9)
    for time, one in zip(joint.times.tolist(), share.tolist(), strict=True):
        if not closed and one > CUT.closes:
            yield time
        closed = one > (CUT.opens if closed else CUT.closes)


def span_of(arm: Measured, robot: Robot, mark: Mark, before: float, after: float) -> Span:
    """The motions of a pick between the end of the pick ``before`` and the grasp ``after`` it [s].

    The reach begins where the arm last stood, farther than ``CUT.away`` from where the gripper
    closed. The way out ends where the tool is as far from there.

    Raises:
        InvalidRequestError: the arm did not move before; where it was is unknown.
    """
    parts = (one for one in arm.series() if one.times[0] <= mark.closed <= one.times[-1])
    if (whole := next(parts, None)) is None:
        raise InvalidRequestError(f"no joint states came at {mark.closed:.2f} s, when it closed")
    low = max(before, float(whole.times[0]), mark.closed - CUT.longest)
    high = min(after, float(whole.times[-1]), mark.closed + CUT.longest)
    high = high if mark.end is None else min(high, mark.end)
    times = np.arange(low, max(high, mark.closed) + 0.5 * CUT.step, CUT.step)
    q, half = whole.at(times), round(0.5 * CUT.window / CUT.step)
    wide = np.pad(q, ((half, half), (0, 0)), mode="edge")
    still = np.abs(wide[2 * half :] - wide[: -2 * half]).max(axis=1) < CUT.still * CUT.window
    at = int(np.searchsorted(times[:-1], mark.closed))
    points, _ = robot.tool_pose(q)
    far = lengths(points - points[at]) >= CUT.away
    first = int(max(np.flatnonzero((still & far)[: at + 1]), default=0))
    if mark.start is not None:
        first = int(np.searchsorted(times[:at], mark.start))
    moving = first + np.flatnonzero(~still[first : at + 1])
    last = min(at, int(max(moving, default=-half)) + half)
    if last - first < 2:
        raise InvalidRequestError("the arm did not move before its gripper closed")
    end = at + int(np.argmax(far[at:])) if far[at:].any() and mark.end is None else len(q) - 1
    rows = np.searchsorted(whole.times, times[[first, end]])
    if (gap := float(np.diff(whole.times[max(rows[0] - 1, 0) : rows[1] + 1]).max())) > GAP:
        raise InvalidRequestError(f"where the arm was is unknown: no joint states for {gap:.2f} s")
    reach = Trajectory.through(q[first : last + 1], CUT.step, robot.joint_names)
    out, leaving = None, at + np.flatnonzero(~still[at : end + 1])
    if len(leaving) > 2:
        way = np.vstack([q[last], q[max(at, int(leaving[0]) - half) + 1 : end + 1]])
        out = Trajectory.through(way, CUT.step, robot.joint_names)
    return Span(float(times[first]), mark.closed, float(times[end]), reach, out)
