"""Finding by a small network: the class of each pixel, and the way to the middle of its fruit.

The network sees a picture of 320 x 240 pixels: colours, inverse depth, and where depth is missing.
Pixels of fruits vote for a middle; votes that lie together are one fruit. The weights are ours,
trained by ``scripts/train_eyes.py`` on rendered pictures.
"""

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, label, maximum_filter

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.perception.finder import Class, Found, Region
from optipromp.perception.pictures import DepthPicture

CLASSES = "none", "ripe", "unripe", "calyx", "stem", "leaf", "static"
SIZE = 240, 320  # [pixel] height and width of what the network sees
FAR = 10.0  # [pixel] to which an offset of the network's answer is scaled
SPREAD = 1.5  # [pixel] standard deviation that smooths the votes: a choice
APART = 7  # [pixel] side of the square in which one peak of votes stands: a choice
LEAST_VOTES = 1.2  # votes at a peak, smoothed: a choice
REACH = 9.0  # [pixel] farthest vote from its peak: a choice


def encoded(rgb: NDArray[Any], depth: NDArray[Any]) -> NDArray[np.float32]:
    """What the network sees (5, height, width) of colours 0 to 255 and depths [m]."""
    known = depth > 0.0
    inverse = np.where(known, 0.3 / np.maximum(depth, 0.1), 0.0)
    parts = (*(np.moveaxis(rgb, 2, 0) / 255.0 - 0.5), inverse, 1.0 - known)
    return np.stack(parts).astype(np.float32)


class ByNetwork:
    """A finder by a network in an ONNX file.

    Args:
        model: the file; None: the weights that come with the package.

    Raises:
        InvalidRequestError: onnxruntime is not installed, or the file cannot be read.
    """

    def __init__(self, model: Path | str | None = None) -> None:
        try:
            import onnxruntime  # type: ignore[import-untyped]
        except ImportError:
            raise InvalidRequestError(f"the network needs {installed_by('vision')}") from None
        own = resources.files("optipromp.perception") / "data" / "eyes.onnx"
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        options.log_severity_level = 3
        try:
            content = own.read_bytes() if model is None else Path(model).read_bytes()
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as error:  # of the runtime, which has no class of its own
            raise InvalidRequestError(f"{model or own}: no network: {error}") from None

    def find(self, picture: DepthPicture) -> Found:
        """See :class:`optipromp.perception.finder.Finder`."""
        shape = picture.depth.shape
        steps = shape[0] / SIZE[0], shape[1] / SIZE[1]
        rows = ((np.arange(SIZE[0]) + 0.5) * steps[0]).astype(int)
        columns = ((np.arange(SIZE[1]) + 0.5) * steps[1]).astype(int)
        part = np.ix_(rows, columns)
        seen = encoded(picture.rgb[part], picture.depth[part])
        told = self._session.run(None, {"picture": seen[None]})[0][0]
        kinds, offsets = told[: len(CLASSES)], FAR * told[len(CLASSES) :]
        masks = grouped(kinds, offsets)

        def full(mask: BoolArray) -> BoolArray:
            at = np.minimum((np.arange(shape[0]) / steps[0]).astype(int), SIZE[0] - 1)
            across = np.minimum((np.arange(shape[1]) / steps[1]).astype(int), SIZE[1] - 1)
            return np.asarray(mask[np.ix_(at, across)])

        regions = [Region(kind, full(mask), score) for kind, mask, score in masks]
        regions.sort(key=lambda region: -region.score)
        best = kinds.argmax(axis=0)
        stem = best == CLASSES.index("stem")
        if stem.any():
            regions.append(Region("stem", full(stem), 1.0))
        return Found(tuple(regions))


def grouped(kinds: FloatArray, offsets: FloatArray) -> list[tuple[Class, BoolArray, float]]:
    """Fruits of the network's answer: class, pixels (H, W), and how sure it is.

    Args:
        kinds: (7, H, W) logits of :data:`CLASSES`.
        offsets: (2, H, W) from each pixel to the middle of its fruit: across, down [pixel].
    """
    best = kinds.argmax(axis=0)
    fruit = (best == 1) | (best == 2)
    rows, columns = np.nonzero(fruit)
    if not len(rows):
        return []
    height, width = best.shape
    across = np.clip(np.rint(columns + offsets[0, rows, columns]), 0, width - 1).astype(int)
    down = np.clip(np.rint(rows + offsets[1, rows, columns]), 0, height - 1).astype(int)
    votes = np.zeros(best.shape)
    np.add.at(votes, (down, across), 1.0)
    smooth = gaussian_filter(votes, SPREAD)
    peaks = (smooth == maximum_filter(smooth, size=APART)) & (smooth >= LEAST_VOTES)
    marks, count = label(peaks)
    if not count:
        return []
    places = np.array([np.argwhere(marks == k + 1).mean(axis=0) for k in range(count)])
    away = np.hypot(down[:, None] - places[:, 0], across[:, None] - places[:, 1])
    mine = away.argmin(axis=1)
    near = away[np.arange(len(mine)), mine] < REACH
    sure = np.exp(kinds - kinds.max(axis=0))
    sure /= sure.sum(axis=0)
    out: list[tuple[Class, BoolArray, float]] = []
    for k in range(count):
        chosen = near & (mine == k)
        if not chosen.any():
            continue
        mask = np.zeros(best.shape, dtype=bool)
        mask[rows[chosen], columns[chosen]] = True
        ripe, unripe = sure[1][mask].sum(), sure[2][mask].sum()
        name: Class = "ripe" if ripe > unripe else "unripe"
        out.append((name, mask, float(max(ripe, unripe) / mask.sum())))
    return out
