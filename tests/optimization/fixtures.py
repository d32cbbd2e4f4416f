"""Robots, trajectories and problems that the tests of the optimisation share."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.geometry import Box, Capsule, Sphere, pack
from optipromp.core.optimization.costs import Cost
from optipromp.core.optimization.problem import Problem, Surroundings
from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool

WAYPOINTS = 8
EMPTY = pack([])


def mimic_urdf() -> str:
    """Revolute, prismatic and continuous joints; two mimics, one of them of a prismatic joint."""
    links, joints = ['<link name="base"/>'], []
    limit = '<limit lower="-1.5" upper="1.5" effort="1" velocity="2"/>'
    rows = [
        ("a", "revolute", "0 0 1", "0.02 0 0.2", limit, ""),
        ("lift", "prismatic", "0 0.6 0.8", "0 0.05 0.1", limit, ""),
        ("b", "revolute", "0 1 0", "0.1 0 0.15", limit, ""),
        ("a2", "revolute", "1 0 0", "0 0.02 0.2", limit, '<mimic joint="a" multiplier="-0.7"/>'),
        ("c", "continuous", "0 1 1", "0.05 0 0.2", '<limit effort="1" velocity="2"/>', ""),
        (
            "lift2", "prismatic", "1 0 0", "0 0 0.1", limit,
            '<mimic joint="lift" multiplier="0.5" offset="0.02"/>',
        ),
        ("d", "revolute", "0 1 0", "0 0 0.15", limit, ""),
    ]  # fmt: skip
    parent = "base"
    for name, kind, axis, xyz, limits, mimic in rows:
        child = f"link_{name}"
        links.append(
            f'<link name="{child}"><collision><origin xyz="0.01 0.02 0.05"/><geometry>'
            '<sphere radius="0.04"/></geometry></collision></link>'
        )
        joints.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="0.1 -0.2 0.3"/><axis xyz="{axis}"/>{limits}{mimic}</joint>'
        )
        parent = child
    return f'<robot name="mimic">{"".join(links)}{"".join(joints)}</robot>'


@dataclass(frozen=True, eq=False, repr=False)
class Case:
    """A robot and a smooth trajectory (T, n) of it."""

    name: str
    robot: Robot
    q: np.ndarray

    def __repr__(self) -> str:
        return f"Case({self.name})"

    def near_body(self, waypoint: int, index: int, away: float) -> np.ndarray:
        """A point beside a body sphere's centre at a waypoint, ``away`` from it [m]."""
        off = np.random.default_rng(index).normal(size=3)
        center = self.robot.sphere_centers(self.q[waypoint])[index]
        return np.asarray(center + away * off / np.linalg.norm(off))

    def surroundings(self) -> Surroundings:
        """Static, avoid and pushable objects, each close to or in the body at some waypoint."""
        radius = np.asarray(self.robot.spheres.radius)
        proximal = np.flatnonzero(
            ~np.asarray(self.robot.spheres.distal) & (np.asarray(self.robot.spheres.segment) >= 1)
        )
        last, mid, first = len(radius) - 1, int(proximal[-1]), int(proximal[len(proximal) // 2])
        turn = np.array([[0.36, 0.48, -0.8], [-0.8, 0.6, 0.0], [0.48, 0.64, 0.6]])
        static = [
            (Sphere(0.05), self.near_body(3, last, radius[last] + 0.045), np.eye(3)),
            (Box((0.1, 0.05, 0.2)), self.near_body(5, mid, radius[mid] + 0.04), turn),
        ]
        avoid = [(Capsule(0.03, 0.1), self.near_body(4, mid, radius[mid] + 0.025), turn)]
        push = [(Sphere(0.04), self.near_body(2, first, radius[first] + 0.035), np.eye(3))]
        return Surroundings(pack(static), pack([*avoid, *push]), len(avoid))

    def problem(
        self,
        terms: Sequence[Cost] = (),
        constraints: Sequence[Cost] = (),
        surroundings: Surroundings | None = None,
        cutoff: float = 0.08,
        end_fixed: bool = False,
    ) -> Problem:
        """A problem over the case's waypoints, in its own surroundings by default."""
        around = self.surroundings() if surroundings is None else surroundings
        return Problem(
            self.robot, around, terms, constraints, len(self.q), cutoff=cutoff, end_fixed=end_fixed
        )


def smooth(rng: np.random.Generator, begin: np.ndarray, size: float, waypoints: int) -> np.ndarray:
    """A trajectory without special structure (T, n), well inside any step limit."""
    z = np.linspace(0.0, 1.0, waypoints)[:, None]
    a, b, c = rng.normal(0.0, size, (3, len(begin)))
    return np.asarray(begin + a * z + b * np.sin(2.5 * z) + c * np.cos(3.1 * z) * z)


@pytest.fixture(scope="session")
def robots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Robot]:
    path: Path = tmp_path_factory.mktemp("robots") / "mimic.urdf"
    path.write_text(mimic_urdf(), encoding="utf-8")
    return {
        "panda": with_tool(load_robot("panda"), Cup(0.05)),
        "scara": with_tool(load_robot("scara"), Cup(0.03, length=0.0616)),
        "mimic": with_tool(load_robot(str(path)), Cup(0.04)),
    }


@pytest.fixture(scope="session")
def cases(robots: dict[str, Robot]) -> dict[str, Case]:
    """Every robot: all revolute; a prismatic lift; prismatic, continuous and mimic joints."""
    out = {}
    for name, robot in robots.items():
        rng, span = np.random.default_rng(5), robot.upper - robot.lower
        size = np.where(np.isfinite(span), 0.12 * span, 0.4)
        out[name] = Case(name, robot, smooth(rng, robot.home + 0.05, 0.5 * size, WAYPOINTS))
    return out


@pytest.fixture(scope="session", params=["panda", "scara", "mimic"])
def case(request: pytest.FixtureRequest, cases: dict[str, Case]) -> Case:
    """One after the other of the cases."""
    return cases[request.param]


@pytest.fixture(scope="session")
def panda(robots: dict[str, Robot]) -> Case:
    robot = robots["panda"]
    rng = np.random.default_rng(7)
    return Case("panda", robot, smooth(rng, robot.home, np.full(7, 0.25), WAYPOINTS))


@pytest.fixture(scope="session")
def check_gradient() -> Callable[[Problem, np.ndarray], None]:
    """The gradient of the merit equals central differences at every free waypoint and joint."""

    def check(problem: Problem, q: np.ndarray, step: float = 1e-6) -> None:
        problem.evaluate(q)
        gradient = problem.gradient().copy()
        expected = np.zeros_like(q)
        for t in range(problem.first, problem.last + 1):
            for j in range(q.shape[1]):
                moved = [q.copy(), q.copy()]
                moved[0][t, j] -= step
                moved[1][t, j] += step
                low, high = (problem.evaluate(m).merit for m in moved)
                expected[t, j] = (high - low) / (2.0 * step)
        size = np.linalg.norm(expected)
        assert size > 1e-3, "the term is not active: nothing is tested"
        assert np.linalg.norm(gradient - expected) < 2e-6 * size
        assert not gradient[: problem.first].any()
        assert not gradient[problem.last + 1 :].any()

    return check


def unbanded(matrix: np.ndarray) -> np.ndarray:
    """The symmetric matrix (N, N) in LAPACK's lower banded form."""
    size = matrix.shape[1]
    full = np.zeros((size, size))
    for d in range(matrix.shape[0]):
        index = np.arange(size - d)
        full[index + d, index] = full[index, index + d] = matrix[d, : size - d]
    return full


@pytest.fixture(scope="session", name="unbanded")
def unbanded_fixture() -> Callable[[np.ndarray], np.ndarray]:
    return unbanded
