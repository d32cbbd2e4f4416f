"""One evaluation (cost and gradient of all terms) as the planning loop makes it, and in C++."""

import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

import numpy as np

from benchmarks.registry import NotAvailableError
from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.obstacles import Obstacles, pack
from optipromp.core.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere
from optipromp.core.optimization.costs.joints import VelocityCost
from optipromp.core.optimization.costs.obstacles import ObstacleCost, SelfCost
from optipromp.core.optimization.evaluation import BodyPoints
from optipromp.core.optimization.problem import Problem, Surroundings
from optipromp.core.optimization.problem import reach as arm_reach
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool
from optipromp_paper.paper import PushCost

SOURCE = Path(__file__).parent / "cpp" / "evaluation.cpp"
FLAGS = ("-O3", "-march=native", "-std=c++17")
WEIGHTS = (1.0, 1.0, 1.0, 0.01, 100.0)  # static, avoid, push, velocity, self
PUSH_WEIGHTS = (1.0, 0.5, 2.0)
EPSILON, CUTOFF, SELF_MARGIN = 0.02, 0.021, 0.03  # [m]
START = np.array([1.42, 1.10, -1.26, -2.42, -1.69, 1.02, 0.8])
END = np.array([0.1, -0.35, 0.05, -1.5, 0.1, 0.1, 0.8])  # the cup folded towards the forearm

Posed = tuple[Shape, FloatArray, FloatArray]


def panda_with_cup() -> Robot:
    """The Panda with a small cup on a long neck: 86 body spheres."""
    return with_tool(load_robot("panda"), Cup(0.03, length=0.12))


def reach(waypoints: int, joints: int = 7) -> FloatArray:
    """A smooth reach (T, n) of the Panda, or of a chain with more joints or fewer."""
    z = np.linspace(0.0, 1.0, waypoints)[:, None]
    share = z**3 * (10.0 - 15.0 * z + 6.0 * z**2)
    begin, end = np.resize(START, joints), np.resize(END, joints)
    return np.asarray(begin + share * (end - begin))


def shapes(count: int) -> list[Shape]:
    """A mixture of spheres, boxes, cylinders and capsules."""
    kinds: tuple[Shape, ...] = (
        Sphere(0.05), Box((0.12, 0.06, 0.09)), Cylinder(0.035, 0.14), Capsule(0.03, 0.12),
    )  # fmt: skip
    return [kinds[i % len(kinds)] for i in range(count)]


def near_obstacles(robot: Robot, q: FloatArray, count: int, seed: int = 3) -> list[Posed]:
    """Obstacles beside the path of the body, from touching it to 40 mm away."""
    rng = np.random.default_rng(seed)
    swept, radius = robot.sphere_centers(q), np.asarray(robot.spheres.radius)
    moving = np.flatnonzero(np.asarray(robot.spheres.segment) >= 2)
    out: list[Posed] = []
    for i, shape in enumerate(shapes(count)):
        waypoint = int((i + 0.5) / count * len(q))
        sphere = int(rng.choice(moving))
        away = rng.normal(size=3)
        gap = radius[sphere] + 0.6 * shape.measure.bound + rng.uniform(0.0, 0.04)
        out.append(
            (shape, swept[waypoint, sphere] + gap * away / np.linalg.norm(away), _rotation(rng))
        )
    return out


def far_obstacles(robot: Robot, q: FloatArray, count: int, seed: int = 4) -> list[Posed]:
    """Obstacles anywhere within 1 m of the arm's shoulder, but 0.1 m or more from its path."""
    rng = np.random.default_rng(seed)
    swept = robot.sphere_centers(q).reshape(-1, 3)
    swept = swept[:: max(1, len(swept) // 2000)]
    out: list[Posed] = []
    for shape in shapes(count):
        while True:
            off = rng.uniform(-1.0, 1.0, 3)
            at = off + [0.0, 0.0, 0.3]
            room = float(np.min(np.linalg.norm(swept - at, axis=1)))
            if np.linalg.norm(off) < 1.0 and room > 0.2 + shape.measure.bound:
                break
        out.append((shape, at, _rotation(rng)))
    return out


def _rotation(rng: np.random.Generator) -> FloatArray:
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return np.asarray(turn * np.sign(np.linalg.det(turn)))


class Case:
    """A problem with all terms, its trajectory, and one evaluation of it.

    With ``cells`` the obstacles are packed as a scene's are, for a broad phase.
    """

    def __init__(
        self, robot: Robot, waypoints: int, obstacles: Sequence[Posed], cells: bool = False
    ) -> None:
        self.robot, self.q = robot, reach(waypoints, robot.n_joints)
        asked = CUTOFF + float(BodyPoints(robot).largest) + 1e-3 if cells else 0.0
        static, dynamic = (
            pack(list(obstacles[k::2]), reach=asked, within=arm_reach(robot) + 0.1) for k in (0, 1)
        )
        self.surroundings = Surroundings(static, dynamic, (len(dynamic.kind) + 1) // 2)
        self.goal, _ = robot.tool_pose(self.q[-1])
        self.goal = self.goal + [0.02, -0.01, 0.05]
        self.frame, self.first = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0]]), waypoints // 2
        costs = [
            ObstacleCost("static", WEIGHTS[0], EPSILON, "sum"),
            ObstacleCost("avoid", WEIGHTS[1], EPSILON, "sum"),
            PushCost(WEIGHTS[2], self.goal, self.frame, self.first, np.array(PUSH_WEIGHTS)),
            VelocityCost(WEIGHTS[3]),
        ]
        self.problem = Problem(
            robot, self.surroundings, costs, [SelfCost(WEIGHTS[4], SELF_MARGIN)], waypoints,
            cutoff=CUTOFF,
        )  # fmt: skip

    def __call__(self) -> tuple[float, FloatArray]:
        """Cost and gradient (T, n), as the solver asks for them."""
        merit = self.problem.evaluate(self.q).merit
        return merit, self.problem.gradient()

    def write(self, path: Path) -> None:
        """Everything the C++ program needs, as lines of name, count and values."""
        p, body, kin = self.problem, self.problem.evaluation.body, self.robot.kinematics
        if kin.kind.any() or not np.array_equal(kin.dof, np.arange(len(kin.kind))):
            raise ValueError("the C++ program knows revolute joints only, each its own")
        values: dict[str, object] = {
            "joints": self.robot.n_joints, "q": self.q, "rotation": kin.rotation,
            "translation": kin.translation, "axis": kin.axis, "radius": body.radius,
            "local": body.local, "segment": body.segment, "link_start": body.link_start,
            "link_bound": body.link_bound, "link_distal": body.link_distal,
            "groups": body.groups, "pairs": body.pairs, "first": self.first,
            "shared": self.surroundings.shared, "dt": p.dt, "cutoff": CUTOFF, "epsilon": EPSILON,
            "self_margin": SELF_MARGIN, "weights": WEIGHTS, "push_weights": PUSH_WEIGHTS,
            "goal": self.goal, "frame": self.frame, "static": _flat(self.surroundings.static),
            "dynamic": _flat(self.surroundings.dynamic),
        }  # fmt: skip
        with path.open("w", encoding="utf-8") as out:
            for name, value in values.items():
                numbers = np.asarray(value, dtype=np.float64).ravel()
                print(name, len(numbers), *(repr(float(v)) for v in numbers), file=out)


def _flat(o: Obstacles) -> FloatArray:
    """(K, 17): kind, position, rotation, size, bound."""
    count = len(o.kind)
    return np.column_stack(
        [o.kind, o.position, o.rotation.reshape(count, 9), o.size, o.bound]
    ).astype(np.float64)


class Program:
    """The C++ program, compiled now and fed one case; asked over a pipe."""

    def __init__(self, case: Case) -> None:
        compiler = shutil.which("g++")
        if compiler is None:
            raise NotAvailableError("no g++ on this machine")
        self._folder = tempfile.TemporaryDirectory()
        folder = Path(self._folder.name)
        binary, data = folder / "evaluation", folder / "case.txt"
        command = [compiler, *FLAGS, str(SOURCE), "-o", str(binary)]
        built = subprocess.run(command, capture_output=True, text=True)
        if built.returncode:
            raise RuntimeError(f"{' '.join(FLAGS)}: {built.stderr.strip().splitlines()[0]}")
        case.write(data)
        self._process = subprocess.Popen(
            [binary, data], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> "Program":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._process.communicate("quit\n")
        self._folder.cleanup()

    def ask(self, command: str) -> list[float]:
        """Send one command, return the numbers it prints."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(command + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"the C++ program ended at {command!r}")
        return [float(word) for word in line.split()]

    def difference(self, case: Case) -> float:
        """Largest relative difference of cost, terms and gradient to ours."""
        answer = self.ask("check")
        value = case.problem.evaluate(case.q)
        gradient = case.problem.gradient()
        self_cost = value.merit - sum(c.weight * value.costs[c.name] for c in case.problem.costs)
        ours = [value.merit, *value.costs.values(), self_cost]
        off = [abs(a - b) / abs(a) for a, b in zip(ours, answer, strict=False)]
        theirs = np.array(answer[len(ours) :]).reshape(gradient.shape)
        return max(*off, float(np.abs(theirs - gradient).max() / np.abs(gradient).max()))
