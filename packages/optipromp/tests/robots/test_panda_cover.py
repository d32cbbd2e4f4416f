"""The spheres of the Panda and its hand, against the maker's meshes.

The meshes are those of the package example-robot-data (franka_description, Apache-2.0), which the
extra `[models]` installs. Distances are Coal's.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.robots.covers import away, directions
from tests.robots.stock import installed

from optipromp.core.robots import FrankaHand, Robot, load_robot

coal = pytest.importorskip("coal")
trimesh = pytest.importorskip("trimesh")

LINKS = [f"link{i}" for i in range(8)]
EXCESS = 0.015  # [m] as panda.yaml and FrankaHand state it
SHAPE = 0.002  # [m] as the corners of FrankaHand state it
RIM = 0.03  # [m] of the base's height, whose edge no sphere above the mounting plane can contain


@pytest.fixture(scope="module")
def meshes() -> Path:
    return installed("panda_description/meshes/collision/hand.stl").parent.parent


def surface(path: Path) -> np.ndarray:
    """Points (m, 3) of a mesh, vertices included, at most about 4 mm apart [m]."""
    mesh = trimesh.load(path, force="mesh")
    points, _ = trimesh.sample.sample_surface_even(mesh, 6000, seed=0)
    return np.concatenate([mesh.vertices, points])


def convex(path: Path) -> object:
    """The convex hull of a mesh, for Coal."""
    model = coal.MeshLoader().load(str(path))
    model.buildConvexHull(True, "Qt")
    return model.convex


def distance(body: object, point: np.ndarray) -> float:
    """From a point to a convex body [m]; below 0 inside."""
    dot, result = coal.Sphere(1e-9), coal.DistanceResult()
    there = coal.Transform3s(np.eye(3), point)
    return float(
        coal.distance(body, coal.Transform3s(), dot, there, coal.DistanceRequest(), result)
    )


def own(robot: Robot, link: str) -> np.ndarray:
    """The spheres (k, 4) of a link, in its frame."""
    mine = robot.spheres.link == robot.link_names.index(link)
    return np.column_stack([robot.spheres.center[mine], robot.spheres.radius[mine]])


def relative(robot: Robot, q: np.ndarray, link: int, other: int) -> Callable[..., np.ndarray]:
    """Maps points (m, 3) of a link's frame to that of another."""
    origins, rotations = robot.segment_frames(q)
    frames = [(np.zeros(3), np.eye(3)), *zip(origins, rotations, strict=True)]
    (o, r), (p, s) = frames[link], frames[other]
    return lambda points: (points @ r.T + o - p) @ s


def test_there_are_at_most_sixty_spheres_on_the_arm() -> None:
    assert len(load_robot("panda").spheres.radius) <= 60
    assert len(FrankaHand().spheres()) <= 14


@pytest.mark.parametrize("kind", ["collision", "visual"])
def test_every_point_of_the_arm_is_in_a_sphere(meshes: Path, kind: str) -> None:
    """Of its own link, or, at a joint, of a neighbour, whatever the angle."""
    if kind == "visual":
        pytest.importorskip("collada")
    panda = load_robot("panda")
    angles = np.linspace(panda.lower, panda.upper, 15)
    for i, link in enumerate(LINKS):
        points = surface(meshes / kind / (link + (".stl" if kind == "collision" else ".dae")))
        points = points[away(points, own(panda, link)) > 1e-9]
        if i == 0:
            points = points[points[:, 2] > RIM]
        left = np.full(len(points), -np.inf)
        for q in angles:
            outside = np.full(len(points), np.inf)
            for other in {max(i - 1, 0), min(i + 1, 7)} - {i}:
                there = relative(panda, q, i, other)(points)
                outside = np.minimum(outside, away(there, own(panda, LINKS[other])))
            left = np.maximum(left, outside)
        assert left.max(initial=-np.inf) <= 1e-9, link


def test_no_sphere_of_the_arm_reaches_farther_beyond_it_than_stated(meshes: Path) -> None:
    """Beyond its own link, and a neighbour that fills the place whatever the angle."""
    panda = load_robot("panda")
    bodies = [convex(meshes / "collision" / f"{link}.stl") for link in LINKS]
    angles = np.linspace(panda.lower, panda.upper, 15)
    for i, link in enumerate(LINKS):
        spheres = own(panda, link)
        around = (spheres[:, None, :3] + spheres[:, None, 3:] * directions(200)).reshape(-1, 3)
        for point in around:
            beyond = distance(bodies[i], point)
            for other in {max(i - 1, 0), min(i + 1, 7)} - {i}:
                if beyond > EXCESS:
                    there = (relative(panda, q, i, other)(point[None])[0] for q in angles)
                    beyond = min(beyond, max(distance(bodies[other], p) for p in there))
            assert beyond <= EXCESS, (link, point)


def hand_parts(meshes: Path, kind: str) -> list[np.ndarray]:
    """Points (m, 3) of palm, left and right finger in the flange frame [m]."""
    suffix = ".stl" if kind == "collision" else ".dae"
    hand = FrankaHand()
    palm, finger = (surface(meshes / kind / (name + suffix)) for name in ("hand", "finger"))
    at = np.array([0.0, hand.gripper_radius, 0.0584])
    right = finger * [-1.0, -1.0, 1.0] + at * [1.0, -1.0, 1.0]
    return [points @ hand.rotation.T for points in (palm, finger + at, right)]


@pytest.mark.parametrize("kind", ["collision", "visual"])
def test_every_point_of_the_open_hand_is_in_a_sphere(meshes: Path, kind: str) -> None:
    if kind == "visual":
        pytest.importorskip("collada")
    for points in hand_parts(meshes, kind):
        assert away(points, FrankaHand().spheres()).max() <= 1e-9


def hulls(folder: Path) -> list[object]:
    """The parts of the hand's one shape, for Coal."""
    out = []
    for k, solid in enumerate(FrankaHand().solids()):
        path = folder / f"{k}.stl"
        trimesh.convex.convex_hull(solid.corners).export(path)
        out.append(convex(path))
    return out


def test_the_hand_s_shape_is_the_maker_s(meshes: Path, tmp_path: Path) -> None:
    """No point of the hand's skin stands out of palm and fingers by more than 2 mm.

    The collision mesh of a finger is its convex hull, which fills what the finger leaves free.
    """
    pytest.importorskip("collada")
    bodies = hulls(tmp_path)
    for points in hand_parts(meshes, "visual"):
        assert max(min(distance(body, p) for body in bodies) for p in points[::3]) <= SHAPE
    assert FrankaHand().front == pytest.approx(0.066, abs=1e-4)


def beyond_hand(meshes: Path) -> Callable[[np.ndarray], float]:
    """How far a point of the flange frame is from the convex meshes of palm and fingers [m]."""
    hand = FrankaHand()
    palm, finger = (convex(meshes / "collision" / f"{n}.stl") for n in ("hand", "finger"))
    at = np.array([0.0, hand.gripper_radius, 0.0584])

    def beyond(flange: np.ndarray) -> float:
        point = flange @ hand.rotation
        right = point * [-1.0, -1.0, 1.0]  # that finger is the left one, turned about z
        return min(distance(palm, point), *(distance(finger, p - at) for p in (point, right)))

    return beyond


def test_the_hand_s_shape_reaches_little_beyond_the_maker_s(meshes: Path) -> None:
    """By 3 mm at most: each corner, from the convex meshes of palm and fingers."""
    beyond = beyond_hand(meshes)
    for solid in FrankaHand().solids():
        assert max(map(beyond, solid.corners)) <= 3e-3, solid.name


def test_no_sphere_of_the_hand_reaches_farther_beyond_it_than_stated(meshes: Path) -> None:
    beyond = beyond_hand(meshes)
    for x, y, z, radius in FrankaHand().spheres():
        around = np.array([x, y, z]) + radius * directions(200)
        assert max(map(beyond, around)) <= EXCESS, (x, y, z)


def test_what_stands_between_the_open_fingers_is_free() -> None:
    """A ball of 50 mm between the finger tips touches no sphere of the hand."""
    hand = FrankaHand()
    spheres = hand.spheres()
    away = np.linalg.norm(spheres[:, :3] - hand.point, axis=1) - spheres[:, 3]
    assert away.min() > 0.025
