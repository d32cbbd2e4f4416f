"""The content of a plan's pictures: its trajectories, and its objects at one moment."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from optipromp.core.arrays import FloatArray, rotation
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import curve_of, legs_of
from optipromp.core.planning.task import tool_motion
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.core.scenes.scene import SceneObject
from optipromp.core.trajectory import Trajectory, chained
from optipromp.looks.appearance import PUSHABLES, ROLES

PRIMITIVE, FOLLOWED, OPTIMISED = "#f0a33a", "#a0449c", "#1f5fb4"
RED, GREEN = "#c8322b", "#2f8f4e"  # wrong, right
COLOURS = ROLES | {"avoid": "#93a1b0"}
SAME = 1e-9  # [rad or m] largest difference of trajectories that coincide
STILL = 1e-3  # [m] an object that moves by less does not count as pushed
BENDS = 12  # pieces of a bent stem
KEYS = 16  # moments at which the push is predicted


@dataclass(frozen=True)
class Motion:
    """A trajectory of a plan, with the colour and width of its line."""

    name: str
    trajectory: Trajectory
    colour: str
    width: float


@dataclass(frozen=True)
class Moment:
    """A waypoint of the plan's trajectory, its time [s], and the event there in words."""

    waypoint: int
    time: float
    event: str

    def __str__(self) -> str:
        return f"{self.event}, {self.time:.1f} s"


@dataclass(frozen=True, eq=False)
class Placed:
    """An object of the scene at its place of a moment."""

    item: SceneObject  # as perceived
    position: FloatArray  # (3,) at the moment [m]
    rotation: FloatArray  # (3, 3) at the moment
    stem: FloatArray | None  # (k, 3) points, fruit first [m]; None without a stem
    colour: str  # of its label; pushables have different ones

    @property
    def shift(self) -> float:
        """Distance by which the object has been pushed [m]."""
        return float(np.linalg.norm(self.position - self.item.position))

    @property
    def label(self) -> str:
        """The object's id, and its shift where it has been pushed."""
        return self.item.id + (f", {1e3 * self.shift:.0f} mm" if self.shift > STILL else "")


def motions(made: Plan | Picked) -> tuple[Motion, ...]:
    """The reach's trajectories in the order of planning; of those that coincide, the first. Before
    them the way out of a pick."""
    plan, *later = legs_of(made).values()
    found: list[Motion] = []
    for name, trajectory, colour, width in (
        ("conditioned ProMP", plan.initial, PRIMITIVE, 4.6),
        ("followed path", plan.followed, FOLLOWED, 2.9),
        ("optimised", plan.trajectory, OPTIMISED, 1.3),
    ):
        if not any(
            np.allclose(trajectory.positions, m.trajectory.positions, rtol=0.0, atol=SAME)
            for m in found
        ):
            found.append(Motion(name, trajectory, colour, width))
    found = found if len(found) > 1 else [replace(found[0], width=2.0)]
    if later:
        found.insert(0, Motion("way out", chained([leg.trajectory for leg in later]), GREEN, 1.3))
    return tuple(found)


def moment(plan: Plan) -> Moment:
    """The moment at which the tool passes the last hanging neighbour; without any, the end."""
    q, hanging = plan.trajectory.positions, [t for t in plan.task.neighbours if t.stem]
    if still(plan):
        return Moment(0, 0.0, "the arm stays at its start")
    if not hanging:
        return Moment(len(q) - 1, plan.trajectory.duration, "at the goal")
    points, _ = plan.robot.tool_pose(q[plan.first :])
    height = (points - hanging[-1].position) @ plan.scene.frame[2]
    at = plan.first + int(np.argmin(np.abs(height)))
    return Moment(at, float(plan.trajectory.times[at]), f"as the tool passes {hanging[-1].id}")


def placed(plan: Plan, now: Moment) -> tuple[Placed, ...]:
    """The scene's objects at a moment, pushed ones at their predicted places."""
    moved = {} if still(plan) else _moved(plan, now)
    out, pushables = [], 0
    for item in plan.scene.objects:
        colour = COLOURS.get(item.role) or PUSHABLES[pushables % len(PUSHABLES)]
        pushables += item.role == "pushable"
        position, turn = moved.get(item.id, (item.position, 0.0))
        turned = rotation(plan.scene.frame[0], -turn) @ item.rotation
        stem = None
        if item.stem is not None:
            stem = bent(np.asarray(item.stem.points), position - item.position)
        out.append(Placed(item, position, turned, stem, colour))
    return tuple(out)


def _leg_at(made: Plan | Picked, time: float) -> tuple[Plan, float]:
    """The leg at a ``time`` [s], and the time since it began [s]."""
    *before, last = legs_of(made).values()
    for leg in before:
        if time <= leg.duration:
            return leg, time
        time -= leg.duration
    return last, time


def shown_at(made: Plan | Picked, time: float) -> tuple[Placed, ...]:
    """The objects of a plan or a pick at a ``time`` [s]; the picked one goes with the tool."""
    (leg, since), reach = _leg_at(made, time), legs_of(made)["reach"]
    row = int(np.searchsorted(leg.trajectory.times, since + 1e-9)) - 1
    there = placed(leg, Moment(max(row, int(leg is not reach)), time, ""))
    if leg is reach:
        return there
    at, out = {one.item.id: one for one in there}, list(held(made, time))
    for one in placed(reach, Moment(0, time, "")):
        if (moved := at.get(one.item.id)) is not None:
            place, stem = moved.position, one.item.stem
            bows = None if stem is None else bent(stem.points, place - one.item.position)
            out.append(replace(one, position=place, rotation=moved.rotation, stem=bows))
    return tuple(out)


def held(made: Plan | Picked, time: float) -> tuple[Placed, ...]:
    """What was picked, where the tool has it at a ``time`` [s]; nothing before the reach ends."""
    (leg, since), reach = _leg_at(made, time), legs_of(made)["reach"]
    taken, robot = reach.scene.taken, leg.robot
    if leg is reach or not taken:
        return ()
    q = leg.trajectory.at(since).q
    axes, at = robot.segment_frames(q)[1][-1] @ robot.tool_rotation, robot.tool_pose(q)[0]
    fruits = zip(taken, leg.scene.attached[-len(taken) :], strict=True)
    poses = ((i, at + axes @ f.position, axes @ from_quaternion(f.orientation)) for i, f in fruits)
    return tuple(Placed(*pose, None, COLOURS["target"]) for pose in poses)


@dataclass(frozen=True, eq=False)
class PushedPlaces:
    """The predicted ``places`` of the objects at each of the ``times`` [s]."""

    times: FloatArray
    places: tuple[tuple[Placed, ...], ...]

    def at(self, now: float) -> tuple[Placed, ...]:
        """The places nearest in time."""
        return self.places[int(np.abs(self.times - now).argmin())]

    def shifts(self) -> dict[str, float]:
        """The largest distance by which each object is pushed, by id [m]."""
        of_each = zip(*self.places, strict=True)  # object, in time; the target goes with the tool
        pushed = (row for row in of_each if row[0].item.role != "target")
        return {row[0].item.id: max(each.shift for each in row) for row in pushed}


def pushed(made: Plan | Picked) -> PushedPlaces:
    """The predicted places of the scene's objects along a plan or a pick."""
    (plan, *later), end = legs_of(made).values(), curve_of(made).duration
    last = plan.trajectory.n_waypoints - 1
    pushes = plan.push_model is not None
    rows = np.linspace(plan.first, last, KEYS).round().astype(int) if pushes else [0]
    times = plan.trajectory.times[np.unique(np.append(0, rows))]
    times = np.append(times, np.linspace(plan.duration, end, KEYS * len(later) + 1)[1:])
    return PushedPlaces(times, tuple(shown_at(made, float(time)) for time in times))


def tool_path(plan: Plan) -> FloatArray:
    """The tool path (P, 3) that was chosen and followed [m]; empty where none was."""
    if np.array_equal(plan.initial.positions, plan.followed.positions):
        return np.zeros((0, 3))
    return np.asarray(plan.robot.tool_pose(plan.followed.positions[plan.first :])[0])


def conditioned_on(plan: Plan) -> tuple[tuple[str, FloatArray, str], ...]:
    """Name, tool point (3,) and colour of each point that the primitive was conditioned on. The
    colours are those of the paper's figure 3: the start yellow, the camera cyan, fruits green, the
    target red. A fruit's pushed pose is light green, as in figure 5."""
    if not plan.via:
        return ()
    start, _ = plan.robot.tool_pose(plan.trajectory.positions[0])
    colours = {"camera": "#18c5d9", "goal": COLOURS["target"]}
    points = [("start", np.asarray(start), "#f5d90a")]
    for via in plan.via:
        fruit = "#b7e36b" if via.name.endswith(" pushed") else "#2f9e44"
        points.append((via.name, via.position, colours.get(via.name, fruit)))
    return tuple(points)


def spread(wanted: Sequence[float], gap: float) -> FloatArray:
    """Heights (k,) in the order of the ``wanted`` ones, near these and at least ``gap`` apart."""
    from scipy.optimize import isotonic_regression  # slow to import

    order = np.argsort(wanted, kind="stable")
    steps = gap * np.arange(len(order))
    out = np.empty(len(order))
    if len(order):
        out[order] = isotonic_regression(np.asarray(wanted)[order] - steps).x + steps
    return out


def bent(points: FloatArray, shift: FloatArray) -> FloatArray:
    """A stem (k, 3), fruit first, whose fruit has moved by ``shift``: bent as a loaded cantilever.
    The deflection at a share s of the length from the root is (3s² - s³) / 2 of that at the end."""
    along = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    at = np.union1d(along, np.linspace(0.0, along[-1], BENDS + 1))
    shape = np.stack([np.interp(at, along, column) for column in points.T], axis=1)
    s = 1.0 - at / along[-1]
    return np.asarray(shape + 0.5 * (3.0 * s**2 - s**3)[:, None] * shift)


def still(plan: Plan) -> bool:
    """Whether the arm does not move."""
    q = plan.trajectory.positions
    return bool((q == q[0]).all())


def _moved(plan: Plan, now: Moment) -> dict[str, tuple[FloatArray, float]]:
    q, model = plan.trajectory.positions, plan.push_model
    if model is None or now.waypoint <= plan.first:
        return {}
    found = model.moved(*tool_motion(plan.robot, q[plan.first : now.waypoint + 1]))
    return {
        name: (place, float(turn))
        for name, place, turn in zip(found.ids, found.positions, found.turns, strict=True)
    }
