"""Fit the spheres of the built-in Panda and its hand to the maker's collision meshes.

For each link the fewest spheres are sought that contain every point of its convex collision mesh
(of the hand also of its simulated parts) and reach at most EXCESS beyond the arm: set cover over
candidate spheres, solved as an integer program (SciPy's HiGHS). What the neighbouring link fills at
every angle of the joint between counts as arm, and points of a link that lie in it need no cover:
no obstacle comes there.

    python scripts/fit_cover.py MESHES [--links link0,hand,…]

MESHES is ``…/example-robot-data/robots/panda_description/meshes/collision`` of the package
example-robot-data (Apache-2.0, as franka_description). Prints YAML for ``robots/data/panda.yaml``.
Takes about a minute a link. ``packages/optipromp/tests/robots/test_panda_cover.py`` checks the
result without this code.
"""

import argparse
import time
from pathlib import Path

import numpy as np
import trimesh
from scipy.ndimage import distance_transform_edt
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.spatial import ConvexHull

from optipromp.core.robots import load_robot
from optipromp.core.robots.tools import FINGER, PALM

EXCESS = 0.0159  # [m] on the grid; measured exactly it is at most 15 mm
VOXEL = 0.002  # [m] of the grid on which distances are measured
SPACING = 0.004  # [m] between candidate centres
WIDE_6 = 0.056  # [m] about that axis
RIM_6 = 0.035  # [m] along the axis of joint 7 from where link 7 covers the end of link 6
MARGIN = 0.0005  # [m] by which a point must lie inside its sphere
SAMPLE = 0.008  # [m] longest edge of the subdivided surface whose points are covered
TURNS = 16  # angles of a joint at which the neighbour is looked at
SECONDS = 30.0  # for one integer program
ROBOT = load_robot("panda")
PARTS = {"hand": [PALM], "finger": [*FINGER.values()]}


class Link:
    """The convex mesh of a link: its faces as half-spaces, and points of its surface."""

    def __init__(self, folder: Path, name: str) -> None:
        mesh = trimesh.load(folder / f"{name}.stl", force="mesh")
        faces = np.unique(ConvexHull(mesh.vertices).equations.round(9), axis=0)
        self.normals, self.offsets, self.bounds = faces[:, :3], -faces[:, 3], mesh.bounds
        mesh.merge_vertices()
        vertices, _ = trimesh.remesh.subdivide_to_size(mesh.vertices, mesh.faces, SAMPLE)
        for corners in PARTS.get(name, []):  # the shape that is simulated, too
            half = 1e-3 * np.array(corners)
            own = trimesh.convex.convex_hull(np.concatenate([half, half * [-1.0, 1.0, 1.0]]))
            more, _ = trimesh.remesh.subdivide_to_size(own.vertices, own.faces, SAMPLE)
            vertices = np.concatenate([vertices, more])
        cells = (vertices / (0.5 * SAMPLE)).round().astype(int)
        self.surface = vertices[np.unique(cells, axis=0, return_index=True)[1]]

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """How far (m,) points lie beyond the farthest face [m]; not above 0 inside."""
        out = np.full(len(points), -np.inf)
        for normal, offset in zip(self.normals, self.offsets, strict=True):
            np.maximum(out, points @ normal - offset, out=out)
        return out


def turned(angle: float) -> np.ndarray:
    """Rotation (3, 3) about z."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def filled(links: dict[str, Link], name: str, points: np.ndarray, margin: float) -> np.ndarray:
    """Which points (m,) in a link's frame a neighbour fills, ``margin`` deep, at every angle."""
    out = np.zeros(len(points), dtype=bool)
    if not name.startswith("link"):
        return out
    number, kin = int(name[-1]), ROBOT.kinematics
    for joint, other in ((number, number + 1), (number - 1, number - 1)):
        if not 0 <= joint < 7:
            continue
        place, base = kin.translation[joint], kin.rotation[joint]
        at = np.flatnonzero(~out)
        for angle in np.linspace(ROBOT.lower[joint], ROBOT.upper[joint], TURNS):
            turn = turned(angle)
            seen = (
                (points[at] - place) @ base @ turn
                if other > number
                else points[at] @ turn.T @ base.T + place
            )
            at = at[links[f"link{other}"].beyond(seen) <= -margin]
        out[at] = True
    return out


def end_of_six(links: dict[str, Link]) -> np.ndarray:
    """Points (m, 3) in link 7's frame, at every angle, of the end of link 6 that it turns in."""
    place, base = ROBOT.kinematics.translation[6], ROBOT.kinematics.rotation[6]
    points = (links["link6"].surface - place) @ base
    end = points[(points[:, 2] > RIM_6) & (np.hypot(points[:, 0], points[:, 1]) < WIDE_6)]
    angles = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    return np.concatenate([end @ turned(angle).T for angle in angles])


def in_seven(seven: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Which points (m, 3) of link 6 are in the spheres (k, 4) of link 7 at every angle."""
    place, base = ROBOT.kinematics.translation[6], ROBOT.kinematics.rotation[6]
    seen, inside = (points - place) @ base, np.ones(len(points), dtype=bool)
    for angle in np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False):
        away = np.linalg.norm((seen @ turned(angle))[:, None] - seven[:, :3], axis=2)
        inside &= (away < seven[:, 3] - MARGIN).any(axis=1)
    return inside


def candidates(links: dict[str, Link], name: str) -> tuple[np.ndarray, np.ndarray]:
    """Centres (m, 3) and the largest radii (m,) that reach at most EXCESS beyond the arm [m]."""
    link = links[name]
    pad = 2.5 * EXCESS
    low, high = link.bounds + [[-pad], [pad]]
    axes = [  # the frame's planes are planes of the grid, and of the candidates
        np.arange(round(a / SPACING) * SPACING, b + VOXEL, VOXEL)
        for a, b in zip(low, high, strict=True)
    ]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    points = grid.reshape(-1, 3)
    beyond = link.beyond(points)
    solid = beyond <= 0.0
    near = np.flatnonzero(~solid & (beyond < pad))
    if name != "link6":  # link 7 may push what link 6 must keep from
        solid[near] = filled(links, name, points[near], 0.0)
    away = distance_transform_edt(~solid.reshape(grid.shape[:3]), sampling=VOXEL)
    allowed = away <= EXCESS
    if name == "link0":
        allowed &= grid[..., 2] > 0.5 * VOXEL  # it stands on its mounting plane
    radius = distance_transform_edt(allowed, sampling=VOXEL) - 0.5 * VOXEL
    step = (slice(None, None, round(SPACING / VOXEL)),) * 3
    centers, radius = grid[step].reshape(-1, 3), radius[step].ravel()
    large = radius > EXCESS
    return centers[large], radius[large]


def cover(points: np.ndarray, centers: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """The fewest of the candidate spheres, (k, 4), that contain all points."""
    rng = np.random.default_rng(0)
    asked = rng.choice(len(points), min(400, len(points)), replace=False)
    while True:
        within = np.linalg.norm(points[asked, None] - centers, axis=2) <= radius - MARGIN
        if not within.any(axis=1).all():
            raise SystemExit(f"no candidate contains {points[asked][~within.any(axis=1)][:3]}")
        _, first = np.unique(np.packbits(within, axis=0).T, axis=0, return_index=True)
        columns = within[:, first]
        result = milp(
            np.ones(len(first)), integrality=np.ones(len(first)), bounds=Bounds(0, 1),
            constraints=LinearConstraint(columns.astype(float), 1.0, np.inf),
            options={"time_limit": SECONDS},
        )  # fmt: skip
        chosen = first[result.x > 0.5]
        found = np.column_stack([centers[chosen], radius[chosen]])
        gaps = np.linalg.norm(points[:, None] - found[:, :3], axis=2) - found[:, 3]
        missed = np.flatnonzero(gaps.min(axis=1) > -0.5 * MARGIN)
        if not len(missed):
            print(f"# optimal within {100 * result.mip_gap:.0f} %", end="")
            return found
        asked = np.union1d(asked, rng.choice(missed, min(150, len(missed)), replace=False))


def main() -> None:
    """Print the spheres of the links asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("meshes", type=Path)
    names = ["link7", *(f"link{i}" for i in range(7)), "hand", "finger"]
    parser.add_argument("--links", default=",".join(names))
    options = parser.parse_args()
    links = {name: Link(options.meshes, name) for name in names}
    seven = np.zeros((0, 4))  # the spheres of link 7, where they are fitted before link 6
    for name in options.links.split(","):
        start = time.perf_counter()
        points = links[name].surface
        points = points[~filled(links, name, points, 1e-3)]
        if name == "link0":
            points = points[points[:, 2] > RIM]
        if name == "link7":
            points = np.concatenate([points, end_of_six(links)])
        if name == "link6":
            points = points[~in_seven(seven, points)]
        found = cover(points, *candidates(links, name))
        if name == "link7":
            seven = found
        found = found[np.lexsort(found[:, :3].T)]
        print(f", {len(points)} points, {time.perf_counter() - start:.0f} s")
        print(f"  {name}:  # {len(found)} spheres")
        for row in found:
            print(f"    - [{', '.join(f'{value:.4f}' for value in row)}]", flush=True)


RIM = 0.025  # [m] of the base's height whose edge no sphere above the mounting plane can contain

if __name__ == "__main__":
    main()
