"""Kinematics, Jacobians and carried spheres equal Pinocchio's, which reads the same files."""

from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot

pin = pytest.importorskip("pinocchio")

CONFIGURATIONS = 1000
TOLERANCE = 1e-9


@dataclass
class Values:
    """Each joint of a URDF as multiplier * q[index] + offset (index -1: a constant)."""

    index: dict[str, int] = field(default_factory=dict)
    multiplier: dict[str, float] = field(default_factory=dict)
    offset: dict[str, float] = field(default_factory=dict)

    def add(self, name: str, index: int, multiplier: float = 1.0, offset: float = 0.0) -> None:
        self.index[name], self.multiplier[name], self.offset[name] = index, multiplier, offset


def samples(robot: Robot, seed: int) -> np.ndarray:
    low = np.where(np.isfinite(robot.lower), robot.lower, -4.0)
    high = np.where(np.isfinite(robot.upper), robot.upper, 4.0)
    return np.random.default_rng(seed).uniform(low, high, (CONFIGURATIONS, robot.n_joints))


def compare(robot: Robot, path: Path, flange: str, values: Values, seed: int = 0) -> None:
    """Tool pose, Jacobians and sphere centres at random configurations, to TOLERANCE."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    frame = model.getFrameId(flange)
    links = [model.getFrameId(robot.link_names[link]) for link in robot.spheres.link]
    q = samples(robot, seed)
    points, axes = robot.tool_pose(q)
    jp, ja = robot.tool_jacobian(q)
    centers = robot.sphere_centers(q)
    for t in range(CONFIGURATIONS):
        full = pin.neutral(model)
        for name in list(model.names)[1:]:
            joint = model.joints[model.getJointId(name)]
            i = values.index[name]
            value = values.multiplier[name] * (q[t, i] if i >= 0 else 0.0) + values.offset[name]
            if joint.nq == 2:
                full[joint.idx_q : joint.idx_q + 2] = np.cos(value), np.sin(value)
            else:
                full[joint.idx_q] = value
        pin.framesForwardKinematics(model, data, full)
        pose = data.oMf[frame]
        np.testing.assert_allclose(points[t], pose.translation, atol=TOLERANCE, rtol=0)
        np.testing.assert_allclose(axes[t], pose.rotation[:, 2], atol=TOLERANCE, rtol=0)
        there = [data.oMf[link].act(local) for link, local in zip(links, LOCAL, strict=True)]
        np.testing.assert_allclose(centers[t], there, atol=TOLERANCE, rtol=0)
        if t % 5:
            continue
        jacobian = pin.computeFrameJacobian(
            model, data, full, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        expected = np.zeros((6, robot.n_joints))
        for name in list(model.names)[1:]:
            if values.index[name] >= 0:
                column = jacobian[:, model.joints[model.getJointId(name)].idx_v]
                expected[:, values.index[name]] += values.multiplier[name] * column
        np.testing.assert_allclose(jp[t], expected[:3], atol=TOLERANCE, rtol=0)
        turning = np.cross(expected[3:].T, axes[t]).T
        np.testing.assert_allclose(ja[t], turning, atol=TOLERANCE, rtol=0)


LOCAL: list[np.ndarray] = []


@pytest.mark.parametrize("name", ["panda", "scara"])
def test_built_in_robots(name: str) -> None:
    robot, values = load_robot(name), Values()
    for i, joint in enumerate(robot.joint_names):
        values.add(joint, i)
    with resources.as_file(
        resources.files("optipromp.core.robots") / "data" / f"{name}.urdf"
    ) as path:
        LOCAL[:] = local_centers(robot, path)
        compare(robot, path, "flange", values)


def local_centers(robot: Robot, path: Path) -> list[np.ndarray]:
    """Sphere centres in their links' frames, found at one configuration."""
    model = pin.buildModelFromUrdf(str(path))
    data = model.createData()
    pin.framesForwardKinematics(model, data, robot.home.copy())
    centers = robot.sphere_centers(robot.home)
    places = [data.oMf[model.getFrameId(robot.link_names[i])] for i in robot.spheres.link]
    return [place.actInv(center) for place, center in zip(places, centers, strict=True)]


def generate(rng: np.random.Generator, folder: Path) -> tuple[Path, Values, str]:
    """A robot file over a random tree: all kinds of joints, mimics of mimics, branches."""
    links = ['<link name="base"/>']
    joints: list[str] = []
    values = Values()
    LOCAL.clear()
    independents: list[str] = []
    movable: list[str] = []
    n = 12
    parent = "base"

    def add(name: str, kind: str, child: str, mimic: str = "") -> None:
        center, radius = rng.normal(0, 0.1, 3), rng.uniform(0.01, 0.05)
        LOCAL.append(center)
        at = " ".join(repr(float(x)) for x in center)
        links.append(
            f'<link name="{child}"><collision><origin xyz="{at}"/><geometry>'
            f'<sphere radius="{radius!r}"/></geometry></collision></link>'
        )
        xyz = " ".join(repr(float(x)) for x in rng.normal(0, 0.3, 3))
        rpy = " ".join(repr(float(x)) for x in rng.uniform(-3, 3, 3))
        axis = " ".join(repr(float(x)) for x in rng.normal(0, 2, 3))
        limit = '<limit lower="0.1" upper="2.5" effort="1" velocity="1"/>'
        if name.startswith("chain"):
            limit = limit.replace('"0.1"', '"-2.5"')
        joints.append(
            f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>{limit}{mimic}</joint>'
        )

    for i in range(n):
        name, child = f"chain{i}", f"link{i}"
        kind = str(rng.choice(["revolute", "continuous", "prismatic", "fixed"]))
        kind, mimic = "revolute" if i == 0 else kind, ""
        if kind != "fixed":
            if movable and kind != "continuous" and rng.uniform() < 0.4:
                leader = str(rng.choice(movable))
                m, o = float(rng.uniform(0.2, 0.8) * rng.choice([-1, 1])), float(rng.normal(0, 0.1))
                mimic = f'<mimic joint="{leader}" multiplier="{m!r}" offset="{o!r}"/>'
                values.add(
                    name,
                    values.index[leader],
                    m * values.multiplier[leader],
                    m * values.offset[leader] + o,
                )
            else:
                values.add(name, len(independents))
                independents.append(name)
            movable.append(name)
        add(name, kind, child, mimic)
        parent = child
        if i in (3, 6):  # a branch whose joint is held at its limit nearest to zero
            values.add(f"branch{i}", -1, 0.0, 0.1)
            add(f"branch{i}", "prismatic" if i == 3 else "revolute", f"side{i}")
    path = folder / "random.urdf"
    path.write_text(f'<robot name="random">{"".join(links)}{"".join(joints)}</robot>')
    robot = folder / "random.yaml"
    robot.write_text(f"{{format: 1, name: random, urdf: random.urdf, flange: link{n - 1}}}")
    return robot, values, f"link{n - 1}"


@pytest.mark.parametrize("seed", range(4))
def test_random_trees(seed: int, tmp_path: Path) -> None:
    file, values, flange = generate(np.random.default_rng(seed), tmp_path)
    robot = load_robot(file)
    assert robot.held_joints == ("branch3", "branch6")
    compare(robot, tmp_path / "random.urdf", flange, values, seed)


def test_the_published_check_of_the_panda() -> None:
    point, _ = load_robot("panda").tool_pose(np.array([0, -1.2, 0, -2, 0, 1, 0.0]))
    np.testing.assert_allclose(point, [0.06086, 0.0, 0.76373], atol=5e-6)
