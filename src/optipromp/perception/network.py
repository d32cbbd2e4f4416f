"""Finding by a small network: the class of each pixel, and the way to the middle of its fruit.

The network sees a picture of 320 x 240 pixels: colours, inverse depth, and where depth is missing.
Pixels of fruits vote for a middle; votes that lie together are one fruit. The weights are ours,
trained by ``scripts/train_eyes.py`` on rendered pictures.
"""

import math
import subprocess
import sys
from importlib import resources
from pathlib import Path
from threading import Timer
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import center_of_mass, find_objects, gaussian_filter, label, maximum_filter

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.files import read_bytes
from optipromp.perception.boards import opencv
from optipromp.perception.finder import Class, Found, Region, largest
from optipromp.perception.pictures import DepthPicture

CLASSES = "none", "ripe", "unripe", "calyx", "stem", "leaf", "static"
FRUITS, STEMS = [CLASSES.index("ripe"), CLASSES.index("unripe")], [CLASSES.index("stem")]
SIZE = 240, 320  # [pixel] height and width of what the network sees
FAR = 10.0  # [pixel] to which an offset of the network's answer is scaled
SPREAD = 1.5  # [pixel] standard deviation that smooths the votes: a choice
APART = 7  # [pixel] side of the square in which one peak of votes stands: a choice
LEAST_VOTES = 1.2  # votes at a peak, smoothed: a choice
MOST_PAIRS = 4_000_000  # of votes and peaks that are compared at once, which bounds memory
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
    session.run(None, {{name: numpy.zeros((1, 5, {SIZE[0]}, {SIZE[1]}), numpy.float32)}})
except Exception as error:
    sys.exit(" ".join(str(error).split()) or type(error).__name__)
"""


def encoded(rgb: NDArray[Any], depth: NDArray[Any]) -> NDArray[np.float32]:
    """What the network sees (5, height, width) of colours 0 to 255 and depths [m]."""
    known = depth > 0.0
    inverse = np.where(known, 0.3 / np.maximum(depth, 0.1), 0.0)
    parts = (*(np.moveaxis(rgb, 2, 0) / 255.0 - 0.5), inverse, 1.0 - known)
    return np.stack(parts).astype(np.float32)


class ByNetwork:
    """A finder by a network in an ONNX file.

    The network has one input, float of (1, 5, 240, 320), see :func:`encoded`; its first output,
    float of (1, 9, 240, 320), has a number for each of :data:`CLASSES`, and the offset across and
    down to the middle of the fruit, over :data:`FAR`. A file of your own is first tried in a
    process of its own, whose time and memory are limited.

    Args:
        model: the file; None: the weights that come with the package.
        seconds: the longest that a network of your own may take, in the trial (of processor time)
            and for a picture.

    Raises:
        InvalidRequestError: onnxruntime is not installed, the file cannot be read, its network has
            other inputs or outputs, or its trial failed or took too long.
    """

    def __init__(self, model: Path | str | None = None, seconds: float = SECONDS) -> None:
        try:
            import onnxruntime  # type: ignore[import-untyped]
        except ImportError:
            raise InvalidRequestError(f"the network needs {installed_by('vision')}") from None
        self._file, self._seconds = str(model or "the network"), seconds
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
            f"{self._file}: no network of the eyes: {text}; must have one input, float (1, 5, "
            f"{SIZE[0]}, {SIZE[1]}), and one output, float (1, 9, {SIZE[0]}, {SIZE[1]})"
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
        """What the network says (9, H, W) of what it sees (5, H, W); ended when time is over."""
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
        if told.shape != (1, len(CLASSES) + 2, *SIZE) or told.dtype.kind != "f":
            raise self._no_network(f"its output is {told.dtype} {told.shape}")
        if not np.isfinite(told).all():
            raise self._no_network("its output is not finite")
        return np.asarray(told[0])

    def find(self, picture: DepthPicture) -> Found:
        """See :class:`optipromp.perception.finder.Finder`; refuses what the network of a file of
        your own says if it is no answer (InvalidRequestError)."""
        shape = picture.depth.shape
        steps = shape[0] / SIZE[0], shape[1] / SIZE[1]
        rows = ((np.arange(SIZE[0]) + 0.5) * steps[0]).astype(int)
        columns = ((np.arange(SIZE[1]) + 0.5) * steps[1]).astype(int)
        part = np.ix_(rows, columns)
        told = self._told(encoded(picture.rgb[part], picture.depth[part]))
        kinds, offsets = told[: len(CLASSES)], FAR * told[len(CLASSES) :]
        sure = np.exp(kinds - kinds.max(axis=0))
        sure /= sure.sum(axis=0)
        fruit = _wide(_lead(sure, FRUITS), shape) > 0.0
        rows = np.clip(np.arange(shape[0]) / steps[0], 0, SIZE[0] - 1).astype(int)
        columns = np.clip(np.arange(shape[1]) / steps[1], 0, SIZE[1] - 1).astype(int)
        owner = grouped(sure, offsets)
        # the smooth edge of a fruit may lie next to it
        spread = np.where(owner > 0, owner, maximum_filter(owner, size=3))
        full = np.where(fruit, spread[np.ix_(rows, columns)], 0)
        regions = []
        boxes, sizes = find_objects(full), np.bincount(full.ravel())[1:]
        chosen = largest(sizes)
        for k in chosen[sizes[chosen] > 0] + 1:
            box = boxes[k - 1]
            ripe, unripe = (float(sure[kind][owner == k].mean()) for kind in FRUITS)
            name: Class = "ripe" if ripe > unripe else "unripe"
            regions.append(Region(name, full[box] == k, max(ripe, unripe), box, shape))
        regions.sort(key=lambda region: -region.score)
        stem = (_wide(_lead(sure, STEMS), shape) > 0.0) & ~fruit
        if stem.any():
            regions.append(Region("stem", stem, 1.0))
        return Found(tuple(regions), int(np.sum(np.delete(sizes, chosen) > 0)))


def _lead(sure: FloatArray, kinds: list[int]) -> FloatArray:
    """How much likelier (H, W) some classes together are than the likeliest other one."""
    return np.asarray(sure[kinds].sum(axis=0) - np.delete(sure, kinds, axis=0).max(axis=0))


def _wide(values: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Values (h, w) at the pixels of a larger picture, linear between the middles of the small."""
    return np.asarray(opencv().resize(values, shape[::-1]))


def grouped(sure: FloatArray, offsets: FloatArray) -> IntArray:
    """Number of the fruit (H, W) that a pixel shows, from 1; 0: none.

    Each pixel of a fruit votes for the middle that its offset points to. The peaks of the smoothed
    votes are the fruits; a vote counts for the nearest peak, if that is near.

    ``sure``: (7, H, W) of :data:`CLASSES`. ``offsets``: (2, H, W) across and down [pixel].
    """
    height, width = sure.shape[1:]
    out = np.zeros((height, width), dtype=np.int64)
    rows, columns = np.nonzero(_lead(sure, FRUITS) > 0.0)
    across = np.clip(np.rint(columns + offsets[0, rows, columns]), 0, width - 1).astype(int)
    down = np.clip(np.rint(rows + offsets[1, rows, columns]), 0, height - 1).astype(int)
    votes = np.bincount(down * width + across, minlength=out.size).reshape(out.shape)
    smooth = gaussian_filter(votes.astype(float), SPREAD)
    peaks = (smooth == maximum_filter(smooth, size=APART)) & (smooth >= LEAST_VOTES)
    marks, count = label(peaks, np.ones((3, 3)))
    if not count:
        return out
    places = np.array(center_of_mass(peaks, marks, range(1, count + 1)))
    for part in np.array_split(np.arange(len(rows)), 1 + len(rows) * count // MOST_PAIRS):
        away = np.hypot(down[part, None] - places[:, 0], across[part, None] - places[:, 1])
        mine = away.argmin(axis=1)
        near = away[np.arange(len(mine)), mine] < REACH
        out[rows[part[near]], columns[part[near]]] = mine[near] + 1
    return out
