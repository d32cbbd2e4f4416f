"""Colour pictures with depth, and the camera that took them; to and from files."""

import io
import json
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import FloatArray, IntArray, read_only
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidRequestError, OptiPrompError, suggest
from optipromp.core.files import read_bytes, read_npz
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.needed import needed, opencv

Image8 = NDArray[np.uint8]  # (height, width, 3)
DEPTH_SCALE = 1e-4  # [m] of a step in a 16-bit picture of depth, as ours are written: a choice
FARTHEST = 6.5  # [m] depth that 16 bits hold at this scale
ENDS = ".rgb.png", ".depth.png", ".camera.json"
"""Ends of the names of a picture's files: colour, depth, camera."""
MOST_PIXELS = 16_000_000  # of a picture: a choice
MOST_SEEN = 921_600  # pixels that are looked at, 1280 x 720: a choice; bounds time and memory
FARTHEST_PIXEL = 1e6  # [pixel] largest size, focal length and place of an axis: a choice
WORKSPACE, CLOSEST = 10.0, 0.1  # [m] beyond which, below which all depths are in wrong units
FORMATS = "PNG", "JPEG", "TIFF", "BMP", "PPM"
"""What Pillow may read; other formats run programs or take memory before their size is known."""
DEPTHS = "I;16", "I;16B", "I;16L", "I;16N", "I", "F"
"""Pillow's modes of a picture of depth: one channel of 16 or 32 bits."""
_REQUIRED = "width", "height", "fx", "fy", "cx", "cy"
_KEYS = (*_REQUIRED, "position", "orientation", "depth_scale", "mount", "distortion")
_BENT = 4, 5, 8, 12, 14  # numbers of a lens's distortion, as OpenCV has them
Mount = Literal["base", "hand"]


def check_near(position: FloatArray, what: str) -> None:
    """Refuse a place (3,) [m] of a camera or hand that looks like millimetres."""
    if (away := float(np.linalg.norm(position))) > WORKSPACE:
        raise InvalidRequestError(
            f"{what} is {away:.4g} m from the robot's base or hand, beyond {WORKSPACE:g} m: "
            "millimetres? must be metres"
        )


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A pinhole camera; its z axis points forward, x right and y down.

    Attributes:
        width, height: of its pictures [pixel].
        fx, fy: focal lengths [pixel].
        cx, cy: column and row of the optical axis [pixel]; the middle of the first pixel is 0, 0.
        pose: of the camera in the frame of ``mount``.
        mount: ``base`` of the robot; or ``hand``, the flange: see :meth:`on`.
        distortion: of its lens, in OpenCV's order k1, k2, p1, p2, k3, ...; empty: none. Only
            :func:`taken` uses it: rays and pictures are without.

    Raises:
        InvalidRequestError: an unknown mount, a distortion of another length, a size or focal
            length that is not 1 to 1e6 pixels, an axis farther than 1e6 pixels, or too many pixels.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    pose: Pose = field(default_factory=Pose)
    mount: Mount = "base"
    distortion: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        bent = self.distortion
        if bent and (len(bent) not in _BENT or not all(map(math.isfinite, bent))):
            raise InvalidRequestError(
                f"camera.distortion has {len(bent)} numbers; must be 4, 5, 8, 12 or 14 finite ones"
            )
        if self.mount not in get_args(Mount):
            raise InvalidRequestError(f"camera.mount is {self.mount!r}; must be base or hand")
        for name in _REQUIRED:
            value, least = getattr(self, name), -FARTHEST_PIXEL if name in ("cx", "cy") else 1.0
            number = isinstance(value, int | float) and not isinstance(value, bool)
            if not number or not least <= value <= FARTHEST_PIXEL:
                limits = f"{least:g} to {FARTHEST_PIXEL:g} [pixel]"
                raise InvalidRequestError(f"camera.{name} is {value!r:.40}; must be {limits}")
        for name in ("width", "height"):
            if getattr(self, name) != int(getattr(self, name)):
                raise InvalidRequestError(f"camera.{name} is no whole number of pixels")
        if self.width * self.height > MOST_PIXELS:
            raise InvalidRequestError(
                f"camera has {self.width} x {self.height} pixels; must be at most {MOST_PIXELS:,}"
            )

    @property
    def view(self) -> float:
        """Full angle of the widest cone about the optical axis inside the picture [rad]."""
        wide = min(self.cx + 0.5, self.width - 0.5 - self.cx) / self.fx
        high = min(self.cy + 0.5, self.height - 0.5 - self.cy) / self.fy
        return 2.0 * math.atan(max(min(wide, high), 1e-6))

    @property
    def focal(self) -> float:
        """The mean focal length [pixel]."""
        return 0.5 * (self.fx + self.fy)

    @property
    def matrix(self) -> FloatArray:
        """(3, 3) from directions (x, y, 1) to columns and rows (column, row, 1)."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @cached_property
    def rays(self) -> FloatArray:
        """(height, width, 3) directions through the pixels, of depth 1."""
        columns, rows = np.meshgrid(np.arange(self.width), np.arange(self.height))
        return read_only(self.through(np.dstack([columns, rows])))

    def through(self, pixels: FloatArray | IntArray) -> FloatArray:
        """Directions (..., 3), of depth 1, through columns and rows (..., 2)."""
        out = np.ones((*pixels.shape[:-1], 3))
        out[..., 0] = (pixels[..., 0] - self.cx) / self.fx
        out[..., 1] = (pixels[..., 1] - self.cy) / self.fy
        return out

    def pixels(self, points: FloatArray) -> FloatArray:
        """Columns and rows (..., 2) of points (..., 3) in the frame of the camera."""
        flat = points[..., :2] / points[..., 2:]
        return np.asarray(flat * [self.fx, self.fy] + [self.cx, self.cy])

    def on(self, hand: Pose | None) -> "CameraModel":
        """The camera in the base frame, with the hand at a pose there (``flange_of``).

        Raises:
            InvalidRequestError: the camera is on the hand, and where that is is not given.
        """
        if self.mount == "base":
            return self
        if hand is None:
            raise InvalidRequestError("the camera is on the hand: tell where the hand was")
        return replace(self, pose=hand @ self.pose, mount="base")

    @classmethod
    def from_document(cls, document: object, source: str = "camera") -> tuple["CameraModel", float]:
        """The camera of a document, and the depth of a step of a 16-bit picture [m].

        Keys are width, height, fx, fy, cx, cy; position and orientation (quaternion ``w, x, y, z``)
        in the frame of mount, by default at its origin; mount, by default base; depth_scale, by
        default 0.001 m; and distortion, by default none.

        Raises:
            InvalidRequestError: an unknown or missing key, or a value that cannot be used.
        """
        if not isinstance(document, dict):
            raise InvalidRequestError(f"{source}: must be a mapping with {', '.join(_REQUIRED)}")
        for key in document:
            if key not in _KEYS:
                raise InvalidRequestError(f"{source}: key {key!r}: {suggest(str(key), _KEYS)}")
        missing = [key for key in _REQUIRED if key not in document]
        if missing:
            raise InvalidRequestError(f"{source}: {', '.join(missing)} missing")
        scale = document.get("depth_scale", 1e-3)
        number = isinstance(scale, int | float) and not isinstance(scale, bool)
        if not number or not 1e-6 <= scale <= 1.0:
            raise InvalidRequestError(
                f"{source}: depth_scale is {scale!r:.40}; must be the metres of a step, as 0.001"
            )
        try:
            pose = Pose(
                document.get("position", [0.0, 0.0, 0.0]),
                document.get("orientation", [1.0, 0.0, 0.0, 0.0]),
            )
            check_near(pose.position, "position")
            numbers = {key: document[key] for key in _REQUIRED}
            bent = tuple(float(value) for value in document.get("distortion", ()))
            mount = document.get("mount", "base")
            made = cls(**numbers, pose=pose, mount=mount, distortion=bent if any(bent) else ())
            return made, float(scale)
        except (TypeError, ValueError):
            raise InvalidRequestError(f"{source}: distortion must be a list of numbers") from None
        except OptiPrompError as error:
            raise InvalidRequestError(f"{source}: {error.message}") from None

    def document(self) -> dict[str, Any]:
        """The camera as plain values; :meth:`from_document` reads it."""
        return {
            **{key: getattr(self, key) for key in _REQUIRED},
            "position": self.pose.position.tolist(),
            "orientation": self.pose.orientation.tolist(),
            "depth_scale": DEPTH_SCALE,
            **({} if self.mount == "base" else {"mount": self.mount}),
            **({"distortion": list(self.distortion)} if self.distortion else {}),
        }


@dataclass(frozen=True, eq=False)
class DepthPicture:
    """A colour picture with a depth for each of its pixels.

    Attributes:
        rgb: (height, width, 3) sRGB, 0 to 255.
        depth: (height, width) along the camera's z axis [m]; 0 where nothing was measured.
        camera: that took both.

    Raises:
        InvalidRequestError: colour, depth and camera differ in size, or a depth is negative or not
            finite.
    """

    rgb: Image8
    depth: FloatArray
    camera: CameraModel

    def __post_init__(self) -> None:
        if self.camera.distortion:
            raise InvalidRequestError("the camera has a distortion: 'taken' makes pictures without")
        size = self.camera.height, self.camera.width
        for name, value in (("rgb", self.rgb), ("depth", self.depth)):
            if value.shape != (size if name == "depth" else (*size, 3)):
                raise InvalidRequestError(
                    f"{name} has shape {value.shape}; the camera has {size[0]} rows and "
                    f"{size[1]} columns"
                )
        wrong = ~(np.isfinite(self.depth) & (self.depth >= 0.0))
        if wrong.any():
            row, column = np.argwhere(wrong)[0]
            raise InvalidRequestError(
                f"depth is {self.depth[row, column]:g} at row {row}, column {column} and wrong at "
                f"{int(wrong.sum())} pixels; must be finite and not negative [m]; 0: not measured"
            )

    def thinned(self) -> "DepthPicture":
        """The picture with every second (third, ...) row and column of one that has more than
        :data:`MOST_SEEN` pixels, and its camera."""
        k = math.ceil(math.sqrt(self.depth.size / MOST_SEEN))
        if k <= 1:
            return self
        first, lens = (k - 1) // 2, self.camera
        rgb, depth = self.rgb[first::k, first::k].copy(), self.depth[first::k, first::k].copy()
        camera = replace(
            lens, width=depth.shape[1], height=depth.shape[0], fx=lens.fx / k, fy=lens.fy / k,
            cx=(lens.cx - first) / k, cy=(lens.cy - first) / k,
        )  # fmt: skip
        return DepthPicture(rgb, depth, camera)

    @cached_property
    def points(self) -> FloatArray:
        """(height, width, 3) in the frame of the camera [m]; the origin where none was measured."""
        return read_only(self.camera.rays * self.depth[:, :, None])


def taken(rgb: Image8, depth: FloatArray, camera: CameraModel) -> DepthPicture:
    """A picture without the distortion of its lens; NaN and infinite depths are not measured.

    ``rgb`` (height, width, 3) and ``depth`` (height, width) [m]: as the camera gives them.
    """
    depth = np.where(np.isfinite(depth), depth, 0.0)
    lens = replace(camera, distortion=())
    picture = DepthPicture(rgb, depth, lens)
    if not camera.distortion:
        return picture
    cv = opencv()
    matrix, bent, size = lens.matrix, np.array(camera.distortion), (lens.width, lens.height)
    across, down = cv.initUndistortRectifyMap(matrix, bent, None, matrix, size, cv.CV_32FC1)
    colours = cv.remap(picture.rgb, across, down, cv.INTER_LINEAR)
    return DepthPicture(
        np.asarray(colours), np.asarray(cv.remap(depth, across, down, cv.INTER_NEAREST)), lens
    )


def placed(camera: CameraModel, source: str, hand: Callable[[], Pose]) -> CameraModel:
    """A camera of a document, in the robot's base.

    ``hand``: tells where the flange was (``flange_of``); asked for a camera on it.

    Raises:
        InvalidRequestError: the document has no place of a camera in the base.
    """
    if camera.mount == "base" and camera.pose.is_identity:
        raise InvalidRequestError(
            f"{source}: must have position and orientation, of the camera in the robot's base; or "
            "mount: hand, and both in the hand"
        )
    return camera.on(hand() if camera.mount == "hand" else None)


def load_camera(path: Path) -> tuple[CameraModel, float]:
    """The camera of a JSON or YAML file, and a step of its depth [m]; see ``from_document``."""
    held = "a camera (width, height, fx, fy, cx, cy)"
    document = read_document(path, InvalidRequestError, held)
    return CameraModel.from_document(document, str(path))


def load_picture(
    rgb: Path, depth: Path, camera: Path | tuple[CameraModel, float], hand: Pose | None = None
) -> DepthPicture:
    """A picture of three files, :meth:`DepthPicture.thinned` if it is large.

    Args:
        rgb: one of :data:`FORMATS`.
        depth: 16-bit PNG or TIFF, or NPY of integers, whose steps are the camera's ``depth_scale``;
            or TIFF or NPY of floats [m], or NPZ with an array ``depth`` (height, width) [m]. NaN
            and infinite ones are not measured.
        camera: JSON or YAML, see :meth:`CameraModel.from_document`; or what that gives.
        hand: in the base frame; for a camera on it.

    Raises:
        InvalidRequestError: a file that is missing or cannot be read, or sizes that differ.
    """
    model, scale = load_camera(camera) if isinstance(camera, Path) else camera
    if depth.suffix.lower() == ".npz":
        arrays = read_npz(depth)
        if "depth" not in arrays:
            raise InvalidRequestError(f"{depth}: no array 'depth'; has {', '.join(arrays)}")
        far = arrays["depth"]
        if far.dtype.kind not in "fiu":
            raise InvalidRequestError(f"{depth}: 'depth' is of {far.dtype}; must be numbers [m]")
        far = far.astype(np.float64)
    else:
        raw = read_npy(depth) if depth.suffix.lower() == ".npy" else read_pixels(depth)
        far = raw.astype(np.float64) * (1.0 if raw.dtype.kind == "f" else scale)
    colours = read_pixels(rgb, "RGB").astype(np.uint8)
    try:
        picture = taken(colours, far, model.on(hand))
    except InvalidRequestError as error:
        raise InvalidRequestError(f"{rgb}, {depth}: {error.message}") from None
    known = picture.depth[picture.depth > 0.0]
    if known.size and not (known.min() < WORKSPACE and known.max() > CLOSEST):
        low, high = float(known.min()), float(known.max())
        units = {1e-3: "millimetres", 1e-4: "steps of 0.1 mm", 0.01: "centimetres", 1e3: "km"}
        fits = [name for f, name in units.items() if f * low < 2.0 and f * high > CLOSEST]
        raise InvalidRequestError(
            f"{depth}: measured depths are {low:.3g} to {high:.3g} m: are they in "
            f"{fits[0] if fits else 'metres'}? must be metres, or steps of the camera's "
            "depth_scale"
        )
    return picture.thinned()


def read_npy(path: Path) -> NDArray[Any]:
    """The numbers of an NPY file. Never unpickles, and reserves no more than the file holds."""
    content = read_bytes(path, InvalidRequestError)
    stream = io.BytesIO(content)
    try:
        head = np.lib.format
        version = head.read_magic(stream)
        read = head.read_array_header_1_0 if version == (1, 0) else head.read_array_header_2_0
        shape, turned, kind = read(stream)
        if kind.kind in "fiu":
            flat = np.frombuffer(content, kind, math.prod(shape), stream.tell())
            return flat.reshape(shape, order="F" if turned else "C")
        wrong = f"is of {kind}; must be numbers"
    except Exception as error:  # of NumPy's readers, which raise whatever goes wrong in them
        wrong = f"no NPY file of plain numbers ({str(error).partition(chr(10))[0][:120]})"
    raise InvalidRequestError(f"{path}: {wrong}")


def read_pixels(path: Path, mode: str | None = None) -> NDArray[Any]:
    """The pixels of a picture file; ``mode`` is Pillow's, as ``RGB``, None: one of depth."""
    return decoded(read_bytes(path, InvalidRequestError), str(path), mode)


def decoded(content: bytes, path: str, mode: str | None = None) -> NDArray[Any]:
    """The pixels of a picture's bytes; ``path`` tells in messages where they are from."""
    image, most = _pillow(), f"must have at most {MOST_PIXELS:,}"
    try:
        with image.open(io.BytesIO(content), formats=FORMATS) as opened:
            if opened.width * opened.height > MOST_PIXELS:
                wrong = f"has {opened.width} x {opened.height} pixels; {most}"
            elif mode is None and opened.mode not in DEPTHS:
                wrong = f"is of mode {opened.mode}; a picture of depth must have one channel of "
                wrong += f"16 or 32 bits ({', '.join(DEPTHS)})"
            else:
                return np.asarray(opened if mode is None else opened.convert(mode))
    except image.DecompressionBombError as error:
        (count,) = re.findall(r"\((\d+) pixels", str(error)) or ["too many"]
        wrong = f"has {count} pixels; {most}"
    except Exception as error:  # of the decoders, which raise whatever goes wrong in them
        reason = str(error).partition(" <_io")[0] or type(error).__name__
        wrong = f"no picture that can be read ({reason}); must be {', '.join(FORMATS)}"
    raise InvalidRequestError(f"{path}: {wrong}")


def picture_files(name: str, picture: DepthPicture) -> dict[str, bytes]:
    """The content of a picture's files, by their names; see :data:`ENDS`."""
    steps = np.round(np.minimum(picture.depth, FARTHEST) / DEPTH_SCALE).astype(np.uint16)
    camera = json.dumps(picture.camera.document(), indent=1)
    content = png_file(picture.rgb), png_file(steps), camera.encode()
    return {name + end: each for end, each in zip(ENDS, content, strict=True)}


def png_file(pixels: NDArray[Any]) -> bytes:
    """Pixels, of 8 bits in three channels or of 8 or 16 bits in one, as a PNG file."""
    buffer = io.BytesIO()
    _pillow().fromarray(np.ascontiguousarray(pixels)).save(buffer, format="PNG")
    return buffer.getvalue()


def _pillow() -> Any:
    return needed("PIL.Image", "pictures need Pillow:", "optipromp-eyes")
