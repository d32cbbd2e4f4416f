"""Finding by a small network: the class of each pixel, and the way to the middle of its fruit.

The network sees a picture at the scale at which a usual fruit has a radius of 20 pixels, whatever
camera took the picture from wherever: colours, the scale of each pixel, and where depth is missing.
Pixels of fruits vote for a middle; votes that lie together are one fruit. The weights are ours,
trained by ``scripts/train_eyes.py`` on pictures of two renderers.
"""

import math
import subprocess
import sys
from collections.abc import Iterable, Iterator
from importlib import resources
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import find_objects, gaussian_filter, label

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import read_bytes
from optipromp_eyes.finder import Class, Found, Region, box_of, largest, most_about
from optipromp_eyes.needed import needed, opencv
from optipromp_eyes.parameters import EyeParameters
from optipromp_eyes.pictures import MOST_SEEN, DepthPicture

CLASSES = "none", "ripe", "unripe", "calyx", "stem", "leaf", "static"
FRUITS, STEMS, LEAVES = ([CLASSES.index(name) for name in names] for names in (
    ("ripe", "unripe"), ("stem",), ("leaf",)
))  # fmt: skip
SEEN = 20.0  # [pixel] radius of a usual fruit in what the network sees: a choice
USUAL = EyeParameters().radius  # [m] that radius in the pictures of training
SCALE = SEEN / USUAL  # [pixel/m]
BLOCK = 32  # [pixel] sides of what the network sees are multiples: it halves them five times
FINE = 2  # pixels that the network sees, for each row and column of its answer
BLANK = 110  # colour beyond a picture, in training, too
FAR = 20.0  # [pixel] of the answer, to which an offset is scaled
LARGEST = 1.3  # by which a picture grows, and its pixels count: a choice that bounds time
NEAREST_FRUIT, FARTHEST_FRUIT = 0.05, 0.9  # [m] depths of fruits: a choice
DYED = 0.2  # saturation of what may be a plant, whose depths choose the scale: a choice
SPAN = 2.0  # farthest over nearest depth of plants beyond which two scales are seen: a choice
SPREAD = 1.5  # [pixel] standard deviation that smooths the votes: a choice
APART = 7  # [pixel] side of the square in which one peak of votes stands: a choice
LEAST_VOTES = 1.2  # votes at a peak, smoothed: a choice
REACH = 9.0  # [pixel] farthest vote from its peak: a choice
SECONDS, MEMORY = 10.0, 4 << 30  # [s], [bytes] that a network of your own may take: a choice
PATIENCE = 6  # [s] of the clock for a second of processor time in a trial: a choice
_OVER = 24  # SIGXCPU, the signal of a process that has used up its processor time
_TRIAL = f"""
import sys
import numpy
import onnxruntime
if sys.platform != "win32":
    import resource
    for kind, soft in (
        (resource.RLIMIT_AS, {MEMORY}), (resource.RLIMIT_CPU, int(sys.argv[1])),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(kind)[1]
        resource.setrlimit(kind, (soft if hard < 0 else min(soft, hard), hard))
options = onnxruntime.SessionOptions()
options.intra_op_num_threads, options.log_severity_level = 1, 4
try:
    session = onnxruntime.InferenceSession(sys.stdin.buffer.read(), options)
    name = session.get_inputs()[0].name
    session.run(None, {{name: numpy.zeros((1, 5, {4 * BLOCK}, {5 * BLOCK}), numpy.float32)}})
except Exception as error:
    sys.exit(" ".join(str(error).split()) or type(error).__name__)
"""


def encoded(rgb: NDArray[Any], depth: NDArray[Any], focal: float) -> NDArray[np.float32]:
    """What the network sees (5, height, width) of colours 0 to 255 and depths [m], by a camera of
    a focal length [pixel]: colours, the scale of each pixel over :data:`SCALE`, missing depths."""
    out = np.empty((5, *depth.shape), dtype=np.float32)
    np.multiply(np.moveaxis(rgb, 2, 0), np.float32(1.0 / 255.0), out=out[:3], dtype=np.float32)
    out[:3] -= 0.5
    far = np.maximum(depth, np.float32(0.02), dtype=np.float32)
    np.minimum(np.float32(focal / SCALE) / far, 4.0, out=out[3])
    np.less_equal(depth, 0.0, out=out[4])
    out[3] *= 1.0 - out[4]
    return out


class ByNetwork:
    """A finder by a network in an ONNX file.

    The network has one input, float of (1, 5, H, W), see :func:`encoded`, whose sides are multiples
    of :data:`BLOCK`; its first output, float of (1, 9, H/2, W/2), has a number for each of
    :data:`CLASSES`, and the offset across and down to the middle of the fruit, over :data:`FAR`. A
    file of your own is first tried in a process of its own, whose time and memory are limited.

    Args:
        model: the file; None: the weights that come with the package.
        seconds: the longest that a network of your own may take, in the trial (of processor time)
            and for a picture.
        radius: of a usual fruit [m], which chooses the scale at which a picture is seen.

    Raises:
        InvalidRequestError: onnxruntime is not installed, the file cannot be read, its network has
            other inputs or outputs, or its trial failed or took too long.
    """

    def __init__(
        self, model: Path | str | None = None, seconds: float = SECONDS, radius: float = USUAL
    ) -> None:
        onnxruntime = needed("onnxruntime", "the network needs", "optipromp-eyes[network]")
        self._file, self._seconds = str(model or "the network"), seconds
        self._scale = SEEN / radius  # [pixel/m]
        if model is None:
            content = (resources.files(__package__) / "data" / "eyes.onnx").read_bytes()
        else:
            content = read_bytes(Path(model), InvalidRequestError)
            self._try(content)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 4  # what fails is raised
        self._run_options = onnxruntime.RunOptions
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # of the runtime, which has no class of its own
            raise self._no_network(error) from None
        self._input = self._session.get_inputs()[0].name

    def _no_network(self, why: object) -> InvalidRequestError:
        text = " ".join(str(why).split())
        return InvalidRequestError(
            f"{self._file}: no network of the eyes: {text}; must have one input, float "
            f"(1, 5, H, W), and one output, float (1, {len(CLASSES) + 2}, H/{FINE}, W/{FINE}), of "
            f"sides that are multiples of {BLOCK}"
        )

    def _try(self, content: bytes) -> None:
        """Load and run a foreign network in a process of its own, which may crash or hang."""
        limit = math.ceil(self._seconds)
        trial = [sys.executable, "-c", _TRIAL, str(limit)]
        try:
            done = subprocess.run(
                trial, input=content, capture_output=True, timeout=PATIENCE * limit, check=False
            )
        except subprocess.TimeoutExpired:
            raise self._no_network(f"it runs for more than {PATIENCE * limit} s") from None
        if code := done.returncode:
            told = done.stderr.decode(errors="replace").strip() or "?"
            ends = {-_OVER: f"it runs for more than {limit} s", 1: told.splitlines()[-1]}
            raise self._no_network(ends.get(code, f"it ends its process ({code})"))

    def _told(self, seen: NDArray[np.float32]) -> FloatArray:
        """What the network says (9, H/2, W/2) of (5, H, W); ended when time is over."""
        options = self._run_options()
        options.log_severity_level = 4
        bell = Timer(self._seconds, setattr, (options, "terminate", True))
        bell.start()
        try:
            told = np.asarray(self._session.run(None, {self._input: seen[None]}, options)[0])
        except Exception as error:  # of the runtime
            late = f"a picture takes more than {self._seconds:g} s" if options.terminate else error
            raise self._no_network(late) from None
        finally:
            bell.cancel()
        half = tuple(side // FINE for side in seen.shape[1:])
        if told.shape != (1, len(CLASSES) + 2, *half) or told.dtype.kind != "f":
            raise self._no_network(f"its output is {told.dtype} {told.shape}")
        if not np.isfinite(told).all():
            raise self._no_network("its output is not finite")
        return np.asarray(told[0])

    def find(self, picture: DepthPicture) -> Found:
        """See :class:`optipromp_eyes.finder.Finder`; refuses what the network of a file of
        your own says if it is no answer (InvalidRequestError)."""
        most = min(LARGEST, math.sqrt(LARGEST * MOST_SEEN / picture.depth.size))
        depths = depths_seen(picture)
        factors, first = np.unique(
            np.minimum(self._scale * depths / picture.camera.focal, most), return_index=True
        )
        depths = depths[first]  # depths of one scale are seen once
        ends = np.array([0.0, *np.sqrt(depths[1:] * depths[:-1]), np.inf])  # of each scale
        shown: list[Region] = []
        stems, leaves = np.zeros((2, *picture.depth.shape), dtype=bool)
        left_out = 0
        for row, factor in enumerate(factors):
            regions, (stem, leaf), left = self._seen_at(picture, float(factor))
            here = (ends[row] <= picture.depth) & (picture.depth < ends[row + 1])
            here |= picture.depth == 0.0
            stems |= stem & here
            leaves |= leaf & here
            left_out += left
            for region in regions:  # a fruit is of the scale of most of its pixels
                far = picture.depth[region.box][region.part]
                middle = float(np.median(far[far > 0.0])) if (far > 0.0).any() else depths[0]
                if ends[row] <= middle < ends[row + 1]:
                    shown.append(region)
        stems &= ~Region.mask(shown, stems.shape)
        shown.sort(key=lambda region: -region.score)
        kinds: tuple[tuple[Class, BoolArray], ...] = (("stem", stems), ("leaf", leaves & ~stems))
        rest = (Region(kind, mask, 1.0) for kind, mask in kinds if mask.any())
        return Found((*shown, *rest), left_out)

    def _seen_at(
        self, picture: DepthPicture, factor: float
    ) -> tuple[list[Region], tuple[BoolArray, BoolArray], int]:
        """Fruits, and stems and leaves, of the picture drawn larger or smaller by a factor, at the
        picture's own pixels, and how many fruits are left out."""
        shape = picture.depth.shape
        size = tuple(max(round(side * factor), 8) for side in shape)
        rows, columns = (each.astype(int) for each in _middles(size, shape))
        area = opencv().INTER_AREA if factor < 1.0 else opencv().INTER_LINEAR
        whole = tuple(-(-side // BLOCK) * BLOCK for side in size)
        rgb = np.full((*whole, 3), BLANK, dtype=np.uint8)
        depth = np.zeros(whole, dtype=np.float32)
        rgb[: size[0], : size[1]] = opencv().resize(picture.rgb, size[::-1], interpolation=area)
        far = picture.depth.astype(np.float32)
        depth[: size[0], : size[1]] = far.take(rows, 0).take(columns, 1)
        focal = picture.camera.focal * factor
        told = self._told(encoded(rgb, depth, focal * SCALE / self._scale))
        half = tuple(-(-side // FINE) for side in size)
        told = told[:, : half[0], : half[1]]
        kinds, offsets = told[: len(CLASSES)], FAR * told[len(CLASSES) :]
        sure = np.exp(kinds - kinds.max(axis=0))
        sure /= sure.sum(axis=0)
        leads = (_lead(sure, kinds) for kinds in (FRUITS, STEMS, LEAVES))
        fruit, stem, leaf = (wide > 0.0 for wide in _wide(leads, size, shape))
        owner = grouped(sure, offsets)
        # the smooth edge of a fruit may lie next to it
        spread = np.where(owner > 0, owner, most_about(owner, 3))
        rows, columns = ((each / FINE).astype(int) for each in _middles(shape, size))
        full = np.where(fruit, spread.take(rows, 0).take(columns, 1), 0)
        regions = []
        boxes, sizes = find_objects(full), np.bincount(full.ravel())[1:]
        cells = find_objects(owner)
        chosen = largest(sizes)
        for k in chosen[sizes[chosen] > 0] + 1:
            box = boxes[k - 1]
            cell = cells[k - 1]
            ripe, unripe = (float(sure[kind][cell][owner[cell] == k].mean()) for kind in FRUITS)
            name: Class = "ripe" if ripe > unripe else "unripe"
            sure_of = ripe / max(ripe + unripe, 1e-6)
            mask = full[box] == k
            regions.append(Region(name, mask, max(ripe, unripe), box, shape, sure_of))
        return regions, (stem & ~fruit, leaf & ~fruit), int(np.sum(np.delete(sizes, chosen) > 0))


def depths_seen(picture: DepthPicture) -> FloatArray:
    """The depths [m] of one or two scales at which a picture is seen, the nearest first.

    What is dyed tells where plants are; if that is little, all that is near. Depths that differ by
    more than :data:`SPAN` are seen at two scales.
    """
    near = (picture.depth > NEAREST_FRUIT) & (picture.depth < FARTHEST_FRUIT)
    few = np.ascontiguousarray(np.moveaxis(picture.rgb[::4, ::4], 2, 0)).astype(np.int64)
    most = few.max(axis=0)
    dyed = near[::4, ::4] & (most - few.min(axis=0) > DYED * most)
    depth = picture.depth[::4, ::4]
    far = depth[dyed] if dyed.mean() > 2e-3 else depth[near[::4, ::4]]
    if not far.size:
        return np.array([0.4])  # any: nothing is measured where fruits may be
    far = np.sort(far)
    weights = np.cumsum(far**2)  # a pixel stands for an area that grows with the depth
    low, high = far[np.searchsorted(weights, np.array([0.1, 0.9]) * weights[-1])]
    if high < SPAN * low:
        return np.array([math.sqrt(low * high)])
    return np.array([low * SPAN**0.5, max(high / SPAN**0.5, low * SPAN)])


def _lead(sure: FloatArray, kinds: list[int]) -> FloatArray:
    """How much likelier (H, W) some classes together are than the likeliest other one."""
    others = np.delete(sure, kinds, axis=0)
    return np.asarray(sum(sure[k] for k in kinds) - others.max(axis=0))


def _middles(counts: tuple[int, ...], lengths: tuple[int, ...]) -> Iterator[FloatArray]:
    """The middles of the equal parts, so many, of each of some lengths."""
    for count, length in zip(counts, lengths, strict=True):
        yield (np.arange(count) + 0.5) * length / count


def _wide(
    answers: Iterable[FloatArray], size: tuple[int, ...], shape: tuple[int, ...]
) -> Iterator[FloatArray]:
    """Answers (h, w) at the pixels of the picture, linear between their middles."""
    rows, columns = ((each / FINE - 0.5).astype(np.float32) for each in _middles(shape, size))
    across, down = np.meshgrid(columns, rows)
    cv = opencv()
    for values in answers:
        yield cv.remap(
            np.ascontiguousarray(values, dtype=np.float32), across, down, cv.INTER_LINEAR,
            borderMode=cv.BORDER_REPLICATE,
        )  # fmt: skip


def grouped(sure: FloatArray, offsets: FloatArray) -> NDArray[np.int32]:
    """Number of the fruit (H, W) that a pixel shows, from 1; 0: none.

    Each pixel of a fruit votes for the middle that its offset points to. The peaks of the smoothed
    votes are the fruits; a vote counts for the nearest peak, if that is near.

    ``sure``: (7, H, W) of :data:`CLASSES`. ``offsets``: (2, H, W) across and down [pixel].
    """
    height, width = sure.shape[1:]
    out = np.zeros((height, width), dtype=np.int32)
    rows, columns = np.nonzero(_lead(sure, FRUITS) > 0.0)
    across = np.clip(np.rint(columns + offsets[0, rows, columns]), 0, width - 1).astype(int)
    down = np.clip(np.rint(rows + offsets[1, rows, columns]), 0, height - 1).astype(int)
    votes = np.bincount(down * width + across, minlength=out.size).reshape(out.shape)
    peaks = np.zeros(out.shape, dtype=bool)
    box = box_of(votes > 0, math.ceil(4.0 * SPREAD) + APART)  # beyond, all is as if it were empty
    smooth = gaussian_filter(votes[box].astype(float), SPREAD)
    peaks[box] = (smooth == most_about(smooth, APART)) & (smooth >= LEAST_VOTES)
    marks, count = label(peaks, np.ones((3, 3)))
    if not count:
        return out
    at = np.nonzero(marks)
    kinds = marks[at] - 1
    places = np.stack([np.bincount(kinds, each) / np.bincount(kinds) for each in at], axis=1)
    owner, least = np.zeros(out.shape, dtype=np.int32), np.full(out.shape, REACH)  # of votes
    for k, (row, column) in enumerate(places, 1):
        high, wide = (
            slice(max(math.ceil(at - REACH), 0), math.floor(at + REACH) + 1) for at in (row, column)
        )
        rest = np.ogrid[high.start : min(high.stop, height), wide.start : min(wide.stop, width)]
        away = np.hypot(rest[0] - row, rest[1] - column)
        nearer = away < least[high, wide]
        least[high, wide][nearer], owner[high, wide][nearer] = away[nearer], k
    out[rows, columns] = owner[down, across]
    return out
