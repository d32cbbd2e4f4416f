"""Any picture, camera and network: an answer or a refusal, soon and in little memory."""

import io
import json
import os
import re
import resource
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from tests.cli.fixtures import refused
from tests.fuzzing import networks
from tests.fuzzing.doors import camera_files, image, picture
from tests.perception.shots import written

from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import npz
from optipromp_eyes import (
    ByDetector,
    ByGeometry,
    ByNetwork,
    CameraModel,
    DepthPicture,
    Detected,
    EyeParameters,
    Region,
    load_picture,
    look_at,
)
from optipromp_eyes.finder import MOST_FITS, MOST_REGIONS, largest
from optipromp_eyes.geometry import is_large
from optipromp_eyes.network import LARGEST
from optipromp_eyes.pictures import ENDS, MOST_SEEN, taken


def wall(height: int, width: int, far: float) -> DepthPicture:
    """A green wall of twice a small stereo camera's noise, which parts it; once does not."""
    rng, size = np.random.default_rng(0), (height, width)
    smooth = 0.0162 * gaussian_filter(rng.standard_normal(size), 2.0) / 0.141
    depth = far + far**2 * (smooth + 0.007 * rng.standard_normal(size))
    rgb = np.broadcast_to(np.array([85, 120, 75], np.uint8), (*size, 3))
    lens = CameraModel(width, height, 0.75 * width, 0.75 * width, width / 2, height / 2)
    return DepthPicture(rgb, depth, lens)


def test_a_wall_has_no_more_regions_than_a_picture_may_have() -> None:
    found = ByGeometry().find(wall(240, 320, 0.8))
    assert len(found.fruits) == MOST_REGIONS
    assert found.left_out > 100
    sizes = sorted(int(region.pixels.sum()) for region in found.fruits)
    assert sizes[0] >= 60
    kept = sum(region.part.nbytes for region in found.fruits)
    assert kept < 2 * 240 * 320  # bytes: boxes, and no picture a region


GREEN, RED = (85, 140, 60), (200, 30, 30)


def balls(
    height: int, width: int, pitch: int, far: float, other: tuple[int, int, int] = GREEN
) -> DepthPicture:
    """As many fruits side by side as there is place for, green and of another colour in turn."""
    rows, columns = np.indices((height, width))
    radius = 0.48 * pitch
    off = np.hypot(rows % pitch - 0.5 * pitch, columns % pitch - 0.5 * pitch) / radius
    front = np.sqrt(np.maximum(1.0 - off**2, 0.0)) * radius * far / (0.75 * width)
    even = (rows // pitch + columns // pitch) % 2 == 0
    colours = np.where(even[..., None], other, GREEN)
    rgb = np.where((off < 1.0)[..., None], colours, [120, 120, 120]).astype(np.uint8)
    lens = CameraModel(width, height, 0.75 * width, 0.75 * width, width / 2, height / 2)
    return DepthPicture(rgb, far - front + 0.05 * (off >= 1.0), lens)


def test_no_more_fruits_are_fitted_than_may_be() -> None:
    sight = look_at(balls(480, 640, 34, 0.5))
    assert 50 < len(sight.detections) <= MOST_FITS
    assert len(sight.found.fruits) + sight.found.left_out == 266 + 256 - MOST_FITS


class Counting(ByNetwork):
    """The network, and how many pixels it was shown."""

    shown = 0

    def _told(self, seen: np.ndarray) -> np.ndarray:
        self.shown += seen[0].size
        return super()._told(seen)


def test_the_worst_mess_is_bounded_in_all_that_is_counted() -> None:
    """Of 19 messes of 1280 x 720 this one took the network longest: 1,700 fruits of 24 pixels."""
    finder = Counting()
    small = EyeParameters(radius=0.01)  # fruits of 8 mm
    sight = look_at(balls(720, 1280, 24, 0.7, RED), finder=finder, parameters=small)
    assert len(sight.found.fruits) == MOST_REGIONS
    assert sight.found.left_out > 1000
    assert 50 < len(sight.detections) <= MOST_FITS
    assert finder.shown < 1.1 * LARGEST * MOST_SEEN  # one scale, but for blocks


def ball_and_wall(bulge: float) -> tuple[DepthPicture, np.ndarray]:
    """A disc of 20 mm, 0.4 m away, whose middle is ``bulge`` nearer than its rim [m]."""
    rows, columns = np.indices((240, 320))
    off = np.hypot(rows - 120, columns - 160)
    front = np.sqrt(np.maximum(1.0 - (off / 12.0) ** 2, 0.0))
    depth = np.where(off < 12.0, 0.4 - bulge * front, 0.6)
    lens = CameraModel(320, 240, 240.0, 240.0, 159.5, 119.5)
    return DepthPicture(np.zeros((240, 320, 3), np.uint8), depth, lens), off < 12.0


def test_what_is_flat_is_no_fruit_and_what_is_large_is_not_fitted() -> None:
    precise = EyeParameters(depth_noise=0.002)
    for bulge, fruits in ((0.0, 0), (0.001, 0), (0.018, 1)):
        shown, disc = ball_and_wall(bulge)
        finder = ByDetector.of([Detected("ripe", 0.9, mask=disc)])
        assert len(look_at(shown, finder=finder, parameters=precise).detections) == fruits
    assert not is_large(shown, Region("unripe", disc, 1.0), precise)
    assert is_large(shown, Region("unripe", np.ones(disc.shape, dtype=bool), 1.0), precise)


def test_a_region_keeps_its_box_and_gives_its_pixels() -> None:
    pixels = np.zeros((30, 40), dtype=bool)
    pixels[3:7, 5:9] = pixels[4, 12] = True
    region = Region("ripe", pixels, 0.5)
    assert region.part.shape == (4, 8)
    assert (region.pixels == pixels).all()
    box = (slice(2, 8), slice(4, 20))
    assert (Region("ripe", pixels[box], 0.5, box, pixels.shape).pixels == pixels).all()
    (rows, columns), grown = region.grown(5)
    assert (rows, columns) == (slice(0, 12), slice(0, 18))
    assert (grown == pixels[rows, columns]).all()


@pytest.mark.parametrize(
    ("shown", "finder"),
    [
        (wall(480, 640, 0.8), ByGeometry),
        (wall(720, 1280, 0.8), ByGeometry),
        (balls(720, 1280, 24, 0.7, RED), ByGeometry),
        (balls(720, 1280, 24, 0.7, RED), ByNetwork),
    ],
    ids=["wall", "large wall", "balls", "balls by the network"],
)
def test_a_large_mess_takes_little_memory(
    shown: DepthPicture, finder: type[ByGeometry | ByNetwork]
) -> None:
    look_at(wall(240, 320, 0.7), finder=finder())  # loads what is loaded once
    child = os.fork()
    if child == 0:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        limit = pages * resource.getpagesize() + 500_000_000
        resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
        resource.setrlimit(resource.RLIMIT_CPU, (10, 10))
        code = 1
        try:
            code = 0 if look_at(shown, finder=finder()).found.left_out else 2
        finally:
            os._exit(code)
    assert os.waitpid(child, 0)[1] == 0


def test_the_largest_are_chosen_in_order() -> None:
    sizes = np.arange(1000)[::-1].copy()
    assert (largest(sizes) == np.arange(MOST_REGIONS)).all()
    assert (largest(np.array([3, 9, 3]), 2) == [0, 1]).all()


def test_a_large_picture_is_thinned_with_its_camera() -> None:
    lens = CameraModel(2001, 1501, 1500.0, 1500.0, 1000.0, 750.0)
    depth = np.full((1501, 2001), 0.5)
    depth[750, 1000] = 0.4
    thin = DepthPicture(np.zeros((1501, 2001, 3), np.uint8), depth, lens).thinned()
    assert thin.depth.shape == (751, 1001)
    assert np.argwhere(thin.depth == 0.4).tolist() == [[375, 500]]
    assert thin.points[375, 500] == pytest.approx([0.0, 0.0, 0.4])
    far = lens.rays[0, 2000]
    assert thin.camera.rays[0, 1000] == pytest.approx(far)
    assert picture().thinned() is picture()


def png(width: int, height: int, bits: int = 8, colours: int = 2) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        return (
            struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        )

    head = struct.pack(">IIBBBBB", width, height, bits, colours, 0, 0, 0)
    parts = chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + parts


BLACK = np.zeros((72, 96), np.uint8)


def npy(array: np.ndarray) -> bytes:
    np.save(stream := io.BytesIO(), array)
    return stream.getvalue()


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("a.rgb.png", png(30_000, 30_000), "has 900000000 pixels; must have at most 16,000,000"),
        ("a.depth.png", png(30_000, 30_000, 16, 0), "at most 16,000,000"),
        ("a.rgb.png", png(4100, 4100), "has 4100 x 4100 pixels; must have at most 16,000,000"),
        ("a.rgb.png", image(BLACK[1:], "PNG"), "rgb has shape (71, 96, 3); the camera has 72 rows"),
        ("a.depth.png", image(BLACK, "PNG", "P"), "mode P; a picture of depth must have"),
        ("a.depth.png", image(BLACK, "PNG"), "mode L; a picture of depth"),
        ("a.rgb.png", image(BLACK, "GIF", "P"), "must be PNG, JPEG"),
        ("d.npy", npy(np.full((72, 96), "x")), "is of <U1; must be numbers"),
        ("d.npy", npy(np.ones((72, 96)))[:200], "no NPY file of plain numbers"),
        ("d.npy", npy(np.array([{}])), "is of object; must be numbers"),
        ("d.npy", npy(np.ones((7, 9))), "depth has shape"),
        ("d.npz", npz({"depth": np.full((72, 96), "x")}), "is of <U1; must be numbers"),
        ("d.npz", npz({"depth": 0.0 * BLACK - 1.0}), "-1 at row 0, column 0 and wrong at 6912"),
        ("d.npz", npz({"depth": BLACK + 500.0}), "500 to 500 m: are they in millimetres"),
    ],
)  # fmt: skip
def test_pictures_are_refused_with_their_cause(
    name: str, content: bytes, told: str, tmp_path: Path
) -> None:
    (written(tmp_path, a=picture()) / name).write_bytes(content)
    depth = tmp_path / (name if name.startswith("d.") else "a.depth.png")
    with pytest.raises(InvalidRequestError, match=re.escape(told)) as refusal:
        load_picture(tmp_path / "a.rgb.png", depth, tmp_path / "a.camera.json")
    assert name in refusal.value.message
    assert "_io" not in refusal.value.message


def test_depths_that_are_next_to_nothing_show_no_fruit() -> None:
    shown = picture()
    near = DepthPicture(shown.rgb, np.full_like(shown.depth, 1e-300), shown.camera)
    assert look_at(near).detections == ()


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [("width", 10**400, "must be"), ("fx", 10**400, "must be"), ("fx", 1e300, "must be"),
     ("fx", 1e-320, "must be"), ("fx", 0.0, "must be"), ("cx", -(10**400), "must be"),
     ("cx", float("nan"), "must be"), ("cy", 1e300, "must be"), ("width", "wide", "must be"),
     ("width", 640.5, "no whole number of pixels"), ("focal", 3.0, "valid are width, height"),
     ("depth_scale", 10**400, "must be"), ("depth_scale", True, "must be"),
     ("depth_scale", 1000, "must be"), ("position", "abc", "must be"),
     ("position", [10**400, 0, 0], "must be"), ("position", [{}, 0, 0], "must be"),
     ("position", [30.0, -530.0, 600.0], "801.1 m from .* beyond 10 m: millimetres?"),
     ("orientation", [1, 0, 0, [0]], "must be"), ("orientation", [10**400, 0, 0, 0], "must be"),
     ("orientation", [1.0, 1.0, 0.0, 0.0], "must be"), ("distortion", [1.0, 2.0], "2 numbers"),
     ("distortion", "bent", "must be a list"), ("distortion", 3, "must be")],
)  # fmt: skip
def test_numbers_of_a_camera_that_no_camera_has(key: str, value: Any, told: str) -> None:
    right = json.loads(camera_files()["a.camera.json"])
    with pytest.raises(InvalidRequestError, match=f"{key}.*{told}") as refusal:
        CameraModel.from_document(right | {key: value})
    assert len(refusal.value.message) < 300


def test_see_wants_the_place_of_the_camera(tmp_path: Path) -> None:
    document = json.loads(camera_files()["a.camera.json"])
    del document["position"], document["orientation"]
    (written(tmp_path, a=picture()) / "a.camera.json").write_text(json.dumps(document))
    assert "must have position and orientation" in refused("see", tmp_path)


WRONG_NETWORKS = {
    "it runs for more than": networks.loop(always=True),
    "INVALID_ARGUMENT": networks.right(seen=(1, 3, 64, 64), told=(1, 9, 64, 64)),
    r"its output is float32 \(1, 7, \d+, \d+\)": networks.right(told=(1, 7, -3, -4)),
    r"Expected: 240": networks.right(seen=(1, 5, 240, 320), told=(1, 9, 120, 160)),
    r"its output is float32 \(1, 9, 8, 8\)": networks.filled(1.0, 1, 9, 8, 8),
    r"its output is float32 \(\)": networks.filled(1.0),
    "its output is object": networks.cast(networks.STRING),
    "its output is not finite": networks.right(most=float("nan")),
    "ConstantOfShape": networks.filled(1.0, 1, 9, 40_000, 40_000),
    "ends its process|runs for more|PROTOBUF|no network": b"\x08\x09" + bytes(range(256)),
}


@pytest.mark.parametrize("told", WRONG_NETWORKS)
def test_other_networks_are_refused(told: str, tmp_path: Path) -> None:
    (tmp_path / "n.onnx").write_bytes(WRONG_NETWORKS[told])
    with pytest.raises(InvalidRequestError, match=told) as refusal:
        ByNetwork(tmp_path / "n.onnx", seconds=2.0).find(picture())
    assert "n.onnx" in refusal.value.message
    assert "must have one input" in refusal.value.message


def test_a_network_that_never_ends_on_this_picture_is_ended(tmp_path: Path) -> None:
    (tmp_path / "n.onnx").write_bytes(networks.loop(always=False))
    finder = ByNetwork(tmp_path / "n.onnx", seconds=1.0)
    with pytest.raises(InvalidRequestError, match="a picture takes more than 1 s"):
        finder.find(picture())


def test_a_network_of_ones_own_is_taken_whatever_its_input_is_called(tmp_path: Path) -> None:
    (tmp_path / "n.onnx").write_bytes(networks.right(name="x"))
    found = ByNetwork(tmp_path / "n.onnx").find(picture())
    assert all(region.pixels.shape == picture().depth.shape for region in found.regions)


@pytest.mark.parametrize("kind", ["d.npy", "d.npz", "d.tiff", "steps.npy"])
def test_depths_of_floats_are_metres_and_nan_is_not_measured(kind: str, tmp_path: Path) -> None:
    right = load_picture(*(written(tmp_path, a=picture()) / f"a{end}" for end in ENDS))
    depth = np.where(right.depth > 0.0, right.depth, np.nan).astype(np.float32)
    depth[:3] = np.array([np.inf, np.nan, -np.inf])[:, None]
    steps = np.rint(1e4 * right.depth).astype(np.uint16)
    steps[:3] = 0
    made = {
        "d.npy": npy(depth), "d.npz": npz({"depth": depth}), "d.tiff": image(depth, "TIFF"),
        "steps.npy": npy(steps),
    }  # fmt: skip
    (tmp_path / kind).write_bytes(made[kind])
    read = load_picture(tmp_path / "a.rgb.png", tmp_path / kind, tmp_path / "a.camera.json")
    assert (read.depth[:3] == 0.0).all()
    assert read.depth[3:] == pytest.approx(right.depth[3:], abs=1e-6)


def test_the_distortion_of_a_camera_file_is_undone(tmp_path: Path) -> None:
    """A point that the lens shows nearer to the middle comes back to where a pinhole shows it."""
    lens = CameraModel(320, 240, 300.0, 300.0, 159.5, 119.5, distortion=(-0.3, 0.1, 0.0, 0.0, 0.0))
    x, y = 0.4, -0.3
    square = x**2 + y**2
    bent = 1.0 - 0.3 * square + 0.1 * square**2
    row, column = round(300.0 * y * bent + 119.5), round(300.0 * x * bent + 159.5)
    rgb, depth = np.zeros((240, 320, 3), np.uint8), np.full((240, 320), 0.5)
    rgb[row - 1 : row + 2, column - 1 : column + 2] = 255
    depth[row - 1 : row + 2, column - 1 : column + 2] = 0.4
    for shown in (rgb[:, :, 0] > 128, depth < 0.45):
        assert np.argwhere(shown).mean(axis=0) == pytest.approx([row, column])
    read = taken(rgb, depth, lens)
    for shown in (read.rgb[:, :, 0] > 128, read.depth == 0.4):
        assert np.argwhere(shown).mean(axis=0) == pytest.approx([29.5, 279.5], abs=0.8)
    assert read.camera.distortion == ()
    again, _ = CameraModel.from_document(lens.document())
    assert again.distortion == lens.distortion
    with pytest.raises(InvalidRequestError, match="has a distortion"):
        DepthPicture(rgb, depth, lens)
