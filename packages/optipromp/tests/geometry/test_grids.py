"""Distance grids of meshes and clouds: against analytic shapes and trimesh, cached, and refused."""

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from tests.refusals import assert_refused
from tests.robots.meshes import misnamed

from optipromp.core.errors import InvalidSceneError
from optipromp.core.geometry import Box, MeshShape, PointCloudShape, Sphere, distances, grids, pack
from optipromp.core.geometry.grids import (
    cloud_grid,
    distance_grid,
    mesh_grid,
    signed_grid,
    to_nearest,
)
from optipromp.core.geometry.loading import load_cloud, load_mesh

EYE = np.eye(3)
ZERO = np.zeros(3)
OPEN = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\nf 1 3 4\n"
CUBE_FACES = np.array(
    [
        [0, 2, 1], [1, 2, 3], [4, 5, 6], [5, 7, 6], [0, 1, 4], [1, 5, 4],
        [2, 6, 3], [3, 6, 7], [0, 4, 2], [2, 4, 6], [1, 3, 5], [3, 7, 5],
    ]
)  # fmt: skip


def box_mesh(size, **more):
    corners = np.array([[x, y, z] for z in (-0.5, 0.5) for y in (-0.5, 0.5) for x in (-0.5, 0.5)])
    return MeshShape(corners * size, CUBE_FACES, **more)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))
    grids._grid.cache_clear()
    return tmp_path / "cache"


def test_nodes_are_exact_for_a_box():
    mesh = box_mesh([0.3, 0.2, 0.4])
    origin, spacing = np.array([-0.25, -0.25, -0.3]), 0.05
    values = signed_grid(mesh.vertices[mesh.faces], origin, spacing, (11, 11, 13))
    nodes = origin + spacing * np.argwhere(np.ones(values.shape))
    expected = distances(pack([(Box((0.3, 0.2, 0.4)), np.zeros(3), EYE)]), nodes)[0][:, 0]
    np.testing.assert_allclose(values.ravel(), expected, atol=1e-12)


def test_agrees_with_trimesh():
    trimesh = pytest.importorskip("trimesh")
    pytest.importorskip("rtree")
    shape = trimesh.creation.torus(0.1, 0.04, major_sections=16, minor_sections=12)
    triangles = np.ascontiguousarray(shape.triangles, dtype=np.float64)
    origin, spacing = np.array([-0.17, -0.17, -0.07]), 0.0171
    values = signed_grid(triangles, origin, spacing, (20, 20, 9))
    chosen = np.random.default_rng(0).permutation(np.argwhere(np.ones(values.shape)))[:400]
    theirs = -trimesh.proximity.signed_distance(shape, origin + spacing * chosen)
    np.testing.assert_allclose(values[tuple(chosen.T)], theirs, atol=1e-6)
    assert (values < 0).any()


def test_mesh_distances_near_a_box():
    size = np.array([0.3, 0.2, 0.4])
    at, turn = np.array([0.5, -0.1, 0.2]), EYE[[1, 2, 0]]
    mesh = pack([(box_mesh(size), at, turn)])
    exact = pack([(Box(tuple(size)), at, turn)])
    points = at + np.random.default_rng(0).uniform(-0.3, 0.3, (500, 3))
    got, gradient = distances(mesh, points)
    want, _ = distances(exact, points)
    inside_grid = want[:, 0] < 0.02
    np.testing.assert_allclose(got[inside_grid], want[inside_grid], atol=0.6 * mesh.grid_spacing[0])
    assert np.isfinite(gradient).all()
    assert (got <= want + 0.6 * mesh.grid_spacing[0]).all()  # outside the grid: a lower bound


def test_grid_gradient_is_that_of_the_interpolation():
    obstacles = pack([(box_mesh([0.3, 0.2, 0.4]), [0.1, 0.0, 0.0], EYE)])
    points = np.random.default_rng(5).uniform(-0.5, 0.5, (200, 3))
    _, gradient = distances(obstacles, points)
    step, checked = 1e-7, 0
    for i in range(3):
        up = distances(obstacles, points + step * EYE[i])[0][:, 0]
        down = distances(obstacles, points - step * EYE[i])[0][:, 0]
        here = distances(obstacles, points)[0][:, 0]
        smooth = np.abs(up - 2 * here + down) < 1e-10
        checked += smooth.sum()
        np.testing.assert_allclose(
            gradient[smooth, 0, i], ((up - down) / (2 * step))[smooth], atol=1e-5
        )
    assert checked > 500
    assert (np.linalg.norm(gradient, axis=2) <= np.sqrt(3.0) + 1e-9).all()


def test_no_jump_at_the_border_and_exact_far_off_a_face():
    obstacles = pack([(box_mesh([0.3, 0.2, 0.4]), np.zeros(3), EYE)])
    border = -obstacles.grid_origin[0, 0]
    d, _ = distances(obstacles, [[border - 1e-9, 0.05, 0.1], [border + 1e-9, 0.05, 0.1]])
    assert abs(d[0, 0] - d[1, 0]) < 1e-8
    far, gradient = distances(obstacles, [[2.0, 0.0, 0.0]])
    assert far[0, 0] == pytest.approx(1.85, abs=obstacles.grid_spacing[0])
    np.testing.assert_allclose(gradient[0, 0], [1, 0, 0], atol=1e-12)


def test_a_thin_plate_is_never_free_space():
    grid = mesh_grid(box_mesh([1.0, 0.5, 0.004]))
    assert grid.values.min() < 0
    obstacles = pack([(box_mesh([1.0, 0.5, 0.004]), np.zeros(3), EYE)])
    rng = np.random.default_rng(0)
    inside = rng.uniform(-0.49, 0.49, (500, 3)) * [1.0, 0.5, 0.003]
    assert distances(obstacles, inside)[0].max() <= 0.0


def test_cloud_distances():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    cloud = PointCloudShape(0.2 * directions / np.linalg.norm(directions, axis=1)[:, None], 0.01)
    obstacles = pack([(cloud, [1.0, 0.0, 0.0], EYE)])
    spacing = obstacles.grid_spacing[0]
    on_points = cloud.points + np.array([1.0, 0.0, 0.0])
    assert distances(obstacles, on_points)[0].max() <= -0.01 + 1e-9
    shell = pack([(Sphere(0.21), [1.0, 0.0, 0.0], EYE)])
    points = [1.0, 0.0, 0.0] + 1.2 * (on_points[:300] - [1.0, 0.0, 0.0])
    difference = distances(obstacles, points)[0] - distances(shell, points)[0]
    assert np.abs(difference).max() < 1.5 * spacing


def test_far_from_a_hollow_cloud_distances_are_a_little_short_and_never_long():
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(4000, 3))
    cloud = PointCloudShape(0.5 * directions / np.linalg.norm(directions, axis=1)[:, None], 0.01)
    grid = cloud_grid(cloud)
    nodes = np.stack(np.meshgrid(*map(np.arange, grid.values.shape), indexing="ij"), axis=-1)
    places = grid.origin + grid.spacing * nodes.reshape(-1, 3)
    true = cKDTree(cloud.points).query(places)[0] - 0.01
    inward = true - grid.values.ravel()  # by the largest error of interpolation everywhere
    near = true < 0.13
    assert inward.min() >= -1e-12
    assert np.ptp(inward[near]) < 1e-12
    assert near.any()
    assert true.max() > 0.4
    assert (inward - inward[near][0] <= 0.1 * (true + 0.01)).all()


@settings(max_examples=40, deadline=None)
@given(
    count=st.integers(1, 300), seed=st.integers(0, 10**6), near=st.sampled_from([0.0, 0.1, 9.0]),
    kind=st.sampled_from(["even", "hollow", "clusters", "flat", "one place"]),
)  # fmt: skip
def test_nearest_points_are_found_or_nearly(count, seed, near, kind):
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(count, 3))
    if kind == "hollow":
        points /= 2.0 * np.linalg.norm(points, axis=1)[:, None]
    elif kind == "clusters":
        points = 0.02 * points + rng.uniform(-1.0, 1.0, (3, 3))[rng.integers(3, size=count)]
    elif kind == "flat":
        points[:, 2] = 0.3
    elif kind == "one place":
        points[:] = points[0]
    step, slack = rng.uniform(0.05, 0.2), rng.choice([0.0, 0.1])
    origin = points.min(axis=0) - rng.uniform(0.0, 0.5, 3)
    shape = tuple(rng.integers(2, 15, 3).tolist())
    found = to_nearest(points, origin, step, shape, near, slack)
    nodes = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1)
    true = cKDTree(points).query(origin + step * nodes)[0]
    exact = true < near
    np.testing.assert_allclose(found[exact], true[exact], rtol=1e-12, atol=1e-15)
    assert (found <= true * (1.0 + 1e-12)).all()
    assert (found[~exact] >= np.maximum(near, true[~exact] / (1.0 + slack)) * (1.0 - 1e-12)).all()


def test_grids_are_cached_on_disk_and_a_broken_cache_is_rebuilt(cache):
    mesh = box_mesh([0.1, 0.1, 0.1])
    first = distance_grid(mesh)
    (file,) = cache.rglob("*.npz")
    assert distance_grid(box_mesh([0.1, 0.1, 0.1])) is first
    grids._grid.cache_clear()
    again = distance_grid(mesh)
    np.testing.assert_array_equal(again.values, first.values)
    for broken in (b"", b"PK\x03\x04 torn", file.read_bytes()[:1000]):
        file.write_bytes(broken)
        grids._grid.cache_clear()
        np.testing.assert_array_equal(distance_grid(mesh).values, first.values)
    distance_grid(PointCloudShape(np.zeros((1, 3)), 0.01))  # of a look, and of no file
    assert len(list(cache.rglob("*"))) == 2  # the folder and the file, no leftovers


def test_an_unwritable_cache_is_no_error(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "file"))
    assert distance_grid(box_mesh([0.1, 0.1, 0.1])).values.min() < 0


def test_one_shape_object_has_one_grid():
    mesh = box_mesh([0.1, 0.1, 0.1])
    obstacles = pack([(mesh, ZERO, EYE), (Sphere(0.1), ZERO, EYE), (mesh, [1, 0, 0], EYE)])
    assert obstacles.grid.tolist() == [0, -1, 0]
    d, _ = distances(obstacles, [[1.0, 0.0, 0.0]])
    assert d[0, 2] == pytest.approx(-0.05, abs=1e-2)
    assert d[0, 0] > 0.9


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: MeshShape(np.zeros((8, 3)), CUBE_FACES), "no area"),
        (lambda: MeshShape(box_mesh([1, 1, 1]).vertices, CUBE_FACES[:-1]), "not watertight"),
        (lambda: MeshShape(box_mesh([1, 1, 1]).vertices, CUBE_FACES + 5), "face indices"),
        (lambda: MeshShape(np.full((8, 3), np.nan), CUBE_FACES), "vertices[0, 0] is nan"),
        (lambda: PointCloudShape([[0, 0, 0], [0, np.inf, 0]], 0.1), "points[1, 1] is inf"),
    ],
)
def test_refuses_degenerate_shapes(make, words):
    assert_refused(InvalidSceneError, words, lambda: pack([(make(), np.zeros(3), EYE)]))


@pytest.mark.parametrize("suffix", ["obj", "stl", "ply"])
def test_loads_meshes(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    box = box_mesh([100.0, 200.0, 300.0])
    path = tmp_path / f"box.{suffix}"
    trimesh.Trimesh(box.vertices, box.faces).export(path)
    mesh = load_mesh(path, 0.001)
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), [0.1, 0.2, 0.3], atol=1e-7)
    assert (mesh.path, mesh.scale) == (path, 0.001)


def truncated_stl():
    return b"\0" * 80 + struct.pack("<I", 12) + b"\0" * 75


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("none.stl", None, "No such file"),
        ("empty.stl", b"", "is empty"),
        ("cut.stl", truncated_stl(), "cut.stl"),
        ("noise.ply", b"ply\nformat ascii 1.0\nelement vertex 3\n", "noise.ply"),
        ("noise.obj", bytes(range(256)), "noise.obj"),
        ("open.obj", OPEN, "open.obj"),
        ("far.obj", OPEN.replace(b"v 0 0 1", b"v 0 0 1e300"), "far.obj"),
        ("many.obj", OPEN + b"f 1 2 99999999999999999999\n", "many.obj"),
        ("box.dae", b"<x/>", "suffix"),
    ],
)
def test_refuses_mesh_files(tmp_path, name, content, words):
    pytest.importorskip("trimesh")
    path = tmp_path / name
    if content is not None:
        path.write_bytes(content)
    assert_refused(InvalidSceneError, [words, name], load_mesh, path)


@pytest.mark.parametrize("name", ["c.npy", "c.npz", "c.csv", "c.xyz", "c.ply"])
def test_loads_clouds(tmp_path, name):
    points = np.random.default_rng(0).normal(size=(10, 3))
    path = tmp_path / name
    match path.suffix:
        case ".npy":
            np.save(path, points)
        case ".npz":
            np.savez(path, points=points, other=np.zeros(2))
        case ".csv":
            np.savetxt(path, points, delimiter=",", header="x,y,z", comments="", fmt="%.17g")
        case ".xyz":
            np.savetxt(path, np.hstack([points, points]), fmt="%.17g")
        case ".ply":
            pytest.importorskip("trimesh").PointCloud(points).export(path)
    cloud = load_cloud(path, 0.01, 2.0)
    np.testing.assert_allclose(cloud.points, 2.0 * points, atol=1e-6)


@pytest.mark.parametrize(
    "head", ["i,z,Y,x\n", "# i;z [m];y (m);X_m;\n", "i z y x label\n", "// i z y x\n"]
)
def test_columns_of_a_cloud_are_those_of_its_names(tmp_path, head):
    points = np.random.default_rng(0).normal(size=(10, 3))
    mark = next((mark for mark in ",;" if mark in head), " ")
    label = "leaf" if "label" in head else ""
    rows = [mark.join(map(str, (k, *point[::-1], label))) for k, point in enumerate(points)]
    (tmp_path / "c.txt").write_text(head + "\n".join(rows))
    assert (load_cloud(tmp_path / "c.txt", 0.01).points == points).all()
    told = np.zeros(10, dtype=[(name, "f8") for name in ("intensity", "z", "y", "x")])
    told["x"], told["y"], told["z"] = points.T
    np.save(tmp_path / "c.npy", told)
    assert (load_cloud(tmp_path / "c.npy", 0.01).points == points).all()


def test_a_cloud_that_lies_on_its_side_or_has_no_size_is_refused(tmp_path):
    points = np.random.default_rng(0).normal(size=(50, 3))
    np.save(tmp_path / "c.npy", points.T)
    with pytest.raises(InvalidSceneError, match="is it transposed"):
        load_cloud(tmp_path / "c.npy", 0.01)
    np.save(tmp_path / "c.npy", points)
    for load, name in ((load_cloud, "c.npy"), (load_mesh, "m.stl")):
        for scale in (0.0, -1.0):
            (tmp_path / "m.stl").write_bytes(b"solid")
            given = (0.01, scale) if load is load_cloud else (scale,)
            with pytest.raises(InvalidSceneError, match=r"scale is .* above 0"):
                load(tmp_path / name, *given)


def test_pixels_without_depth_in_a_cloud_are_told(tmp_path):
    """Zeros at the base were START_IN_COLLISION without a hint."""
    points = np.random.default_rng(0).normal(size=(10, 3))
    points[3:5] = 0.0
    np.save(tmp_path / "c.npy", points)
    with pytest.warns(
        UserWarning, match=r"2 of 10 points are \(0, 0, 0\), as pixels without depth"
    ):
        load_cloud(tmp_path / "c.npy", 0.01)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("c.csv", "x,y,z\n1,2,3\n1,2\n", "row 2 is not"),
        ("c.xyz", "1 2 3\n1,5 2,5 3,5\n", "row 2 is not"),
        ("c.xyz", "# nothing\n", "must be (N, 3)"),
        ("c.npy", "no array", "cannot be read"),
        ("c.npz", "no array", "cannot be read"),
        ("c.csv", "1,2,nan\n", "points[0, 2] is nan"),
        ("c.csv", "i,x,z\n0,1,2\n", "columns x, z: must have x, y and z, each once"),
        (
            "c.csv",
            "1,2,3,4\n5,6,7,8\n9,0,1,2\n",
            "(3, 4): must be (N, 3), N >= 1: is it transposed?",
        ),
        ("c.csv", "".join(f"{k},{k % 3},1,2\n" for k in range(9)), "first column counts the rows"),
        ("c.txt", "1;2;3\n1;2;3\n", "its 2 points are all the same"),
    ],
)
def test_refuses_cloud_files(tmp_path, name, content, words):
    path = tmp_path / name
    path.write_text(content)
    assert_refused(InvalidSceneError, [words, name], load_cloud, path, 0.01)


@pytest.mark.parametrize(
    ("suffix", "index", "words"),
    [
        ("ply", 99, "face 1 names vertex 99: must be 0 to 3"),
        ("ply", -1, "face 1 names vertex -1: must be 0 to 3"),
        ("binary", 4, "face 1 names vertex 4: must be 0 to 3"),
        ("binary", -2, "face 1 names vertex -2: must be 0 to 3"),
        ("obj", 5, "face 2 names vertex 5: must be 1 to 4"),
        ("obj", 0, "face 2 names vertex 0: must be 1 to 4"),
        ("obj", -5, "face 2 names vertex -5: must be 1 to 4"),
    ],
)
def test_an_index_of_a_face_that_names_no_vertex_is_refused(tmp_path, suffix, index, words):
    pytest.importorskip("trimesh")
    path = misnamed(tmp_path, suffix, index)
    with pytest.raises(InvalidSceneError) as caught:
        load_mesh(path)
    assert caught.value.message == f"mesh {path}: {words}"


@pytest.mark.parametrize(("suffix", "index"), [("ply", 3), ("binary", 3), ("obj", 4), ("obj", -1)])
def test_a_mesh_of_right_indices_is_taken_as_trimesh_alone_takes_it(tmp_path, suffix, index):
    trimesh = pytest.importorskip("trimesh")
    path = misnamed(tmp_path, suffix, index)
    mesh, alone = load_mesh(path), trimesh.load(path)
    np.testing.assert_array_equal(mesh.vertices, alone.vertices)
    np.testing.assert_array_equal(mesh.faces, alone.faces)


def test_a_box_whose_corners_count_as_one_is_refused_with_the_scale():
    with pytest.raises(InvalidSceneError, match=r"box size\[1\] is 5e-10: must be 1e-07 .* scale"):
        Box((0.1, 5e-10, 0.1))
    assert Box((0.1, 1e-6, 0.1)).mesh().vertices.shape == (8, 3)
