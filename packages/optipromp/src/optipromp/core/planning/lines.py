"""A goal by way points: a free motion to the first, then straight lines of the tool.

Inverse kinematics follows the lines from every branch of the first way point. Of the branches from
which all lines can be followed within the joint limits and without contacts, those with the least
motion of the joints come first. A free motion is planned to a branch; the first valid plan is
returned. The arm rests at every way point.
"""

import math
from dataclasses import dataclass
from dataclasses import replace as replaced
from itertools import islice, pairwise

import numpy as np

from optipromp.core import judging
from optipromp.core.arrays import FloatArray, lengths, rotation
from optipromp.core.budget import Budget, clock
from optipromp.core.errors import Code, InvalidRequestError
from optipromp.core.planning import goals
from optipromp.core.planning.collision import free, open_until
from optipromp.core.planning.follow import along_corners, keeps_path
from optipromp.core.planning.options import Searched
from optipromp.core.planning.parameters import GOAL, LINE
from optipromp.core.planning.pick import pick
from optipromp.core.planning.result import Failed, Planned, best_of
from optipromp.core.planning.task import Task
from optipromp.core.planning.timing import eased, shortest, tool_speeds
from optipromp.core.planning.verdict import judged
from optipromp.core.promp.model import ProMP
from optipromp.core.robots import ik
from optipromp.core.scenes.goals import Lines, axes_of, pose_name, turn_between
from optipromp.core.scenes.scene import RegionGoal
from optipromp.core.trajectory import Trajectory, chained


@dataclass(frozen=True, eq=False)
class StraightLine:
    """A straight line of the tool between the poses ``a`` and ``b``."""

    a: RegionGoal
    b: RegionGoal

    @property
    def length(self) -> float:
        """Way of the tool point [m]."""
        return math.dist(self.a.position, self.b.position)

    @property
    def count(self) -> int:
        """Number of waypoints, such that the tool's steps are short at full speed too."""
        turn = turn_between(axes_of(self.a), axes_of(self.b))
        steps = max(self.length / LINE.step, turn / LINE.turn)
        return max(LINE.fewest, math.ceil(steps) + 1)

    def poses(self, share: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Tool points (m, 3), and what :func:`ik.track` takes for axes, at shares (m,) of it."""
        points = self.a.position + share[:, None] * (self.b.position - self.a.position)
        u, v = axes_of(self.a), axes_of(self.b)
        if not len(u):
            return points, None
        about = np.cross(u, v).sum(axis=0)  # of frames: twice the axis, times the sine of the turn
        size = float(np.linalg.norm(about))
        angle = turn_between(u, v)
        if size < 1e-12:  # the tool does not turn
            axes = np.tile(u, (len(share), 1, 1))
        else:
            axes = np.array([u @ rotation(about / size, float(s) * angle).T for s in share])
        return points, axes[:, 0] if len(u) == 1 else axes[:, [2, 1]]

    def off(self, points: FloatArray) -> FloatArray:
        """Distances (m,) of points (m, 3) from the line [m]."""
        edge, off = self.b.position - self.a.position, points - self.a.position
        share = np.clip(off @ edge / max(float(edge @ edge), 1e-18), 0.0, 1.0)
        return lengths(off - share[:, None] * edge)


@dataclass(frozen=True, eq=False)
class Branch:
    """A branch of inverse kinematics at the first way point, and how far it leads."""

    begin: FloatArray  # (n,) configuration at the first way point
    lines: tuple[FloatArray, ...]  # waypoints (m, n) of each line that can be followed
    done: float = 0.0  # share of the next line that can be followed; 0 where all can
    why: str = ""  # the reason why it cannot be followed to its end; empty where all can

    def turns(self, start: FloatArray) -> float:
        """Largest motions of a joint, to the branch and along each line, in sum [rad or m]."""
        to = float(np.abs(self.begin - start).max())
        return to + sum(float(np.abs(np.diff(q, axis=0)).max(axis=1).sum()) for q in self.lines)


def along_lines(task: Task, promp: ProMP, options: Searched, budget: Budget) -> Planned | Failed:
    """The motion through the scene's way points to the goal, or the way point where it ends."""
    lines = task.scene.waypoints
    assert lines is not None
    if task.underway.running is not None:
        raise InvalidRequestError(
            "previous: the scene has waypoints: a motion through them cannot be planned anew on "
            "its way"
        )
    began, poses = clock(), lines.to(task.goal)
    legs = [StraightLine(a, b) for a, b in pairwise(poses)]
    first = replaced(task, scene=replaced(task.scene, goal=poses[0], waypoints=None), goal=poses[0])
    budget.say("inverse kinematics along the lines")
    begins = free(first, goals.find(first, task.seed, GOAL.many_starts), LINE.branches)
    if not len(begins):
        begins, reason = goals.choose(first, task.seed, budget=budget)
        if reason:
            code = Code.GOAL_IN_COLLISION if len(begins) else Code.GOAL_UNREACHABLE
            return Failed(code, f"waypoints[0]: {reason}")
    near = np.abs(begins - task.start).max(axis=1) < LINE.near
    begins = np.where(near[:, None] & (not task.state.moving), task.start, begins)
    branches: list[Branch] = []
    for begin in begins:
        branches.append(followed(task, legs, begin))
        if budget.spent() and any(not one.why for one in branches):
            break
    whole = sorted((one for one in branches if not one.why), key=lambda x: x.turns(task.start))
    if not whole:
        return Failed(Code.GOAL_UNREACHABLE, _refusal(branches, legs))
    seconds = clock() - began
    made = (_motion(task, first, legs, branch, (promp, options, budget)) for branch in whole)
    best = best_of(
        islice(made, LINE.tries), _wrong, lambda best: not _wrong(best) or budget.spent()
    )
    assert best is not None  # there is a whole branch
    return replaced(best, time={"inverse kinematics": seconds, **best.time})


def followed(task: Task, legs: list[StraightLine], begin: FloatArray) -> Branch:
    """How far the lines can be followed from a configuration ``begin`` (n,)."""
    done: list[FloatArray] = []
    for leg in legs:
        q, share, why = _track(task, leg, begin, leg.count)
        if why:
            return Branch(done[0][0] if done else begin, tuple(done), share, why)
        done.append(q)
        begin = q[-1]
    return Branch(done[0][0], tuple(done))


def _track(
    task: Task, leg: StraightLine, begin: FloatArray, count: int
) -> tuple[FloatArray, float, str]:
    """Waypoints (count, n) of a line from rest to rest, and where it ends early, with the reason.

    The tool's speed rises and falls smoothly over equal times between the waypoints.
    """
    robot = task.robot
    share = along_corners(np.array([[0.0], [1.0]]), count)[:, 0]
    points, axes = leg.poses(share)
    q, errors = ik.track(robot, points[1:], None if axes is None else axes[1:], begin)
    q, errors = np.vstack([begin, q]), np.append(0.0, errors)
    stops: list[tuple[int, str]] = []
    if (missed := np.flatnonzero(errors > LINE.tracked)).size:
        row = int(missed[0])
        room = np.minimum(q[row] - robot.lower, robot.upper - q[row])
        joint = int(np.argmin(room))
        if room[joint] < 1e-9:  # held there
            why = f"{robot.joint_names[joint]} is at its limit ({q[row][joint]:.3f})"
        else:
            why = f"it is out of the arm's reach (by {1e3 * errors[row]:.1f} mm)"
        stops.append((row, why))
    steps = np.abs(np.diff(q, axis=0))
    if (jumps := np.flatnonzero(steps.max(axis=1) > LINE.jump)).size:
        row = int(jumps[0])
        joint = int(np.argmax(steps[row]))
        why = f"{robot.joint_names[joint]} would have to jump by {steps[row][joint]:.2f}"
        stops.append((row + 1, why))
    if task.scene.path is not None:
        holds = keeps_path(task, q)
        if not holds.all():
            stops.append((int(np.argmin(holds)), "the path's constraints are broken"))
    last = min(stops, default=(count, ""))[0]
    if (row := open_until(task, q[:last])) < last:  # the judge decides beside meshes
        contacts = judging.clearances(task.scene, robot, q[: row + 1])[1]
        if contacts or (contacts := judging.clearances(task.scene, robot, q[:last])[1]):
            stops.append((row, "; ".join(map(str, contacts))))
    row, why = min(stops, default=(count - 1, ""))
    return q, float(share[row]), why


def _refusal(branches: list[Branch], legs: list[StraightLine]) -> str:
    """The reason why no branch leads to the goal: that of the branch which leads farthest."""
    best = max(branches, key=lambda one: (len(one.lines), one.done))
    k, count = len(best.lines), len(legs)
    leg = legs[k]
    at = f"{1e3 * best.done * leg.length:.0f} of {1e3 * leg.length:.0f} mm along it"
    if leg.length < LINE.step:
        at = f"after {best.done:.0%} of it"
    several = f" (the best of {len(branches)} branches)" if len(branches) > 1 else ""
    return (
        f"no straight line from {pose_name(k, count)} to {pose_name(k + 1, count)}: {at}, "
        f"{best.why}{several}"
    )


def _motion(
    task: Task, first: Task, legs: list[StraightLine], branch: Branch,
    how: tuple[ProMP, Searched, Budget],
) -> Planned:  # fmt: skip
    """The motion to a branch and along the lines, judged."""
    (promp, options, budget), began = how, clock()
    lines = task.scene.waypoints
    assert lines is not None
    parts, made = [], None
    if (branch.begin != task.start).any() or task.state.moving:
        budget.say("optimising (joint)")
        to_first = replaced(options, duration=None)
        free_part = pick(first, promp, to_first, branch.begin[None], budget)
        assert isinstance(free_part, Planned)  # without a push model
        made = free_part
        parts.append(made.trajectory)
    ours = replaced(task, robot=eased(task.robot, options))
    parts += [timed_line(ours, leg, q, lines) for leg, q in zip(legs, branch.lines, strict=True)]
    trajectory = chained(parts)
    if options.duration is not None:
        trajectory = trajectory.slowed(options.duration / trajectory.duration)
    judgement = judged(task, trajectory, stem_side=True)
    row = 0 if made is None else made.trajectory.n_waypoints - 1
    stages = () if made is None else made.stages
    optimised = made is None or made.optimised
    return Planned(
        trajectory, row, stages=stages, optimised=optimised, time={"joint": clock() - began},
        judgement=judgement,
    )  # fmt: skip


def _wrong(made: Planned) -> int:
    assert made.judgement is not None
    return len(made.judgement.violations)


def timed_line(task: Task, leg: StraightLine, q: FloatArray, lines: Lines) -> Trajectory:
    """The shortest trajectory along a line, from rest to rest, near enough and slow enough.

    ``q``: (m, n) waypoints; twice as many are taken while the curve leaves the line. ``lines``:
    with the largest distance and speed.
    """
    robot, speed = task.robot, lines.speed
    for left in reversed(range(LINE.refinements)):
        made = shortest(robot, q, None if speed is None else 0, speed or np.inf)
        share = np.linspace(0.0, 1.0, LINE.parts, endpoint=False)
        at = (made.times[:-1, None] + share * np.diff(made.times)[:, None]).ravel()
        points, _ = robot.tool_pose(made.sample(at)[0])
        if not left or leg.off(points).max() <= LINE.share * lines.within:
            break
        q, _, _ = _track(task, leg, q[0], 2 * len(q))
    if speed is not None:
        fastest = float(tool_speeds(robot, made, 0, LINE.parts).max())
        made = made.slowed(max(1.0, fastest / speed))
    return made
