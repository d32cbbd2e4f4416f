"""Few spheres over meshes: all of the surface, little beyond it, fitted once."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.robots.covers import worst_gap
from tests.robots.links import Writer

from optipromp.core.files import npz
from optipromp.core.robots import load_robot
from optipromp.core.robots.resolved import read_resolved
from optipromp.readers import fit

trimesh = pytest.importorskip("trimesh")

RADIUS, LENGTH = 0.05, 0.30  # [m] of a capsule, between the middles of its ends
TURN = trimesh.transformations.rotation_matrix(0.7, (1, 2, 3), (0.1, 0.0, 0.0))


def capsule() -> np.ndarray:
    """Triangles (f, 3, 3) of a capsule along z [m]."""
    mesh = trimesh.creation.capsule(height=LENGTH, radius=RADIUS)
    mesh.apply_translation(-mesh.bounds.mean(axis=0))
    return np.asarray(mesh.vertices[mesh.faces])


def beyond_capsule(points: np.ndarray) -> np.ndarray:
    z = np.clip(points[:, 2], -LENGTH / 2.0, LENGTH / 2.0)
    axis = np.column_stack([np.zeros((len(z), 2)), z])
    return np.asarray(np.linalg.norm(points - axis, axis=1) - RADIUS)


def on_triangles(triangles: np.ndarray, count: int = 20_000) -> np.ndarray:
    """Random points of the surface, and its corners."""
    rng = np.random.default_rng(0)
    crossed = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(crossed, axis=1)
    face = rng.choice(len(triangles), count, p=area / area.sum())
    points = np.einsum("ms,msk->mk", rng.dirichlet(np.ones(3), count), triangles[face])
    return np.concatenate([points, triangles.reshape(-1, 3)])


def around(spheres: np.ndarray) -> np.ndarray:
    """Points on the spheres."""
    v = np.random.default_rng(0).normal(size=(500, 3))
    v /= np.linalg.norm(v, axis=1, keepdims=True)
    return np.asarray((spheres[:, None, :3] + spheres[:, None, 3:] * v).reshape(-1, 3))


def test_pieces_are_small_and_leave_nothing_out() -> None:
    triangles = np.concatenate([capsule(), [[[0, 0, 0], [1, 0, 0], [0.5, 1e-4, 0]]]])
    pieces = fit.cut(triangles, 0.01)
    assert np.linalg.norm(pieces[:, [1, 2, 0]] - pieces, axis=2).max() <= 0.01

    def area(t: np.ndarray) -> float:
        return float(np.linalg.norm(np.cross(t[:, 1] - t[:, 0], t[:, 2] - t[:, 0]), axis=1).sum())

    assert area(pieces) == pytest.approx(area(triangles), rel=1e-9)


@given(st.floats(0.0, 1.0), st.floats(1e-6, 0.01), st.floats(0.1, 10.0))
def test_a_thin_triangle_gives_no_more_pieces_than_its_length(foot, height, length):
    triangle = np.array([[[0.0, 0.0, 0.0], [length, 0.0, 0.0], [foot * length, 0.0, height]]])
    pieces = fit.cut(triangle, 0.01)
    assert len(pieces) <= 10.0 * length / 0.01
    assert pieces.min() >= -1e-12
    assert (pieces.max(axis=(0, 1)) <= [length + 1e-12, 0.0, height + 1e-12]).all()


def test_a_capsule_is_covered_and_the_excess_is_as_stated() -> None:
    triangles = capsule()
    [(spheres, excess)] = fit.fit_covers([triangles], 8, [0.03])
    assert len(spheres) <= 8
    assert worst_gap(on_triangles(triangles), spheres) <= 0.0
    assert beyond_capsule(around(spheres)).max() <= excess + fit.VOXEL
    assert excess < 0.012  # eight equal spheres in a row reach 6 mm beyond


def test_spheres_are_halved_however_their_points_lie() -> None:
    """Points of a sphere may lie in one plane, which nothing halves across."""
    mesh = trimesh.creation.box((0.04, 0.04, 0.04))
    triangles = np.asarray(mesh.vertices[mesh.faces])
    [(spheres, _)] = fit.fit_covers([triangles], 4, [0.001])
    for _ in range(4):
        spheres, _ = fit.finer(triangles, spheres, range(len(spheres)))
        assert worst_gap(on_triangles(triangles), spheres) <= 0.0


@pytest.mark.parametrize("what", ["open", "bent", "split"])
def test_other_shapes_are_covered(what: str) -> None:
    """A tube without ends, an L, two parts apart."""
    if what == "open":
        mesh = trimesh.creation.cylinder(radius=0.05, height=0.2)
        mesh.update_faces(np.abs(mesh.face_normals[:, 2]) < 0.5)
    else:
        parts = [trimesh.creation.box((0.06, 0.06, 0.3)), trimesh.creation.box((0.3, 0.06, 0.06))]
        parts[1].apply_translation((0.12, 0.0, 0.15) if what == "bent" else (0.4, 0.0, 0.0))
        mesh = trimesh.util.concatenate(parts)
    mesh.apply_transform(TURN)
    triangles = np.asarray(mesh.vertices[mesh.faces])
    [(spheres, excess)] = fit.fit_covers([triangles], 12, [0.03])
    assert len(spheres) <= fit.MOST_SPHERES
    assert worst_gap(on_triangles(triangles), spheres) <= 0.0
    assert excess <= 0.035
    beyond = -trimesh.proximity.signed_distance(mesh, around(spheres)) if what != "open" else [0.0]
    assert np.max(beyond) <= excess + 2.0 * fit.VOXEL


def test_spheres_go_where_they_are_needed() -> None:
    """A small ball takes few, so that what is long gets more than its share."""
    ball = trimesh.creation.icosphere(3, 0.03)
    [(one, _), (two, excess)] = fit.fit_covers(
        [ball.vertices[ball.faces], capsule()], 5, [0.03, 0.03]
    )
    assert len(one) + len(two) <= 10
    assert len(two) > len(one)
    assert excess < 0.015


def test_halves_cover_what_the_whole_did() -> None:
    """Three spheres of a capsule; the middle one is halved, and reaches less far beyond it."""
    triangles = capsule()
    [(three, _)] = fit.fit_covers([triangles], 3, [1.0])
    middle = int(np.abs(three[:, 2]).argmin())
    four, excess = fit.finer(triangles, three, [middle])
    assert len(four) == len(three) + 1
    assert worst_gap(on_triangles(triangles), four) <= 0.0
    assert beyond_capsule(around(four)).max() <= excess + fit.VOXEL
    near = np.argsort(np.abs(four[:, 2]))[:2]
    assert four[near, 3].max() < three[middle, 3] - 0.005


# -- loading -----------------------------------------------------------------------------------


@pytest.fixture
def armed(urdf: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A robot whose link b is a capsule's mesh; the cache is the test's own."""
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "cache"))
    write_stl(tmp_path / "b.stl", capsule())
    geometry = '<collision><geometry><mesh filename="b.stl"/></geometry></collision>'
    return urdf(links=f'<link name="a"/><link name="b">{geometry}</link><link name="c"/>')


def write_stl(path: Path, triangles: np.ndarray) -> None:
    mesh = trimesh.Trimesh(triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3))
    mesh.export(str(path))


def moved(path: Path) -> Path:
    """The same file under another name, so that the process has not read it."""
    copy = path.with_name(f"{path.stem}-again.urdf")
    copy.write_bytes(path.read_bytes())
    return copy


def test_a_robot_is_kept_on_disk_by_content(armed: Path, tmp_path: Path) -> None:
    first = load_robot(armed)
    [kept] = (tmp_path / "cache" / "robots").iterdir()
    written = kept.stat().st_mtime_ns
    again = load_robot(moved(armed))
    assert again is not first
    for one, other in zip(first.spheres, again.spheres, strict=True):
        np.testing.assert_array_equal(one, other)
    assert again.excess == first.excess
    assert kept.stat().st_mtime_ns == written
    write_stl(tmp_path / "b.stl", 0.9 * capsule())
    assert load_robot(armed).spheres.radius.max() < first.spheres.radius.max()
    assert len(list(kept.parent.iterdir())) == 2


@pytest.mark.parametrize("damage", ["empty", "half", "no archive", "version", "index", "nan"])
def test_a_damaged_cache_is_written_again(armed: Path, tmp_path: Path, damage: str) -> None:
    first = load_robot(armed)
    [kept] = (tmp_path / "cache" / "robots").iterdir()
    whole = kept.read_bytes()
    arrays = dict(np.load(kept))
    if damage == "version":
        arrays["robot"] = np.array(str(arrays["robot"]).replace('"version": 1', '"version": 2'))
    elif damage == "index":
        arrays["spheres link"] = arrays["spheres link"] + 1000
    elif damage == "nan":
        arrays["spheres center"] = arrays["spheres center"] * np.nan
    kept.write_bytes(npz(arrays))
    if damage in ("empty", "half", "no archive"):
        content = {"empty": b"", "half": whole[: len(whole) // 2], "no archive": b"PK\x03\x04 no"}
        kept.write_bytes(content[damage])
    again = load_robot(moved(armed))
    np.testing.assert_array_equal(again.spheres.radius, first.spheres.radius)
    np.testing.assert_array_equal(read_resolved(kept).spheres.radius, first.spheres.radius)


def test_no_cache_folder_is_no_error(armed, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("OPTIPROMP_CACHE", str(tmp_path / "file"))
    assert len(load_robot(armed).spheres.radius) <= 8


def test_what_has_not_changed_is_not_read_again(armed: Path) -> None:
    first = load_robot(armed)
    assert load_robot(armed.name, base_dir=armed.parent) is first
    armed.write_text(armed.read_text().replace('name="c"', 'name="d"').replace('"c"', '"d"'))
    assert "d" in load_robot(armed).link_names
