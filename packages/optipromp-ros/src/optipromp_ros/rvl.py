"""Depths as RVL codes them: runs of zeros and of differences, in groups of four bits.

A. D. Wilson, Fast Lossless Depth Image Compression, ISS 2017; as compressed_depth_image_transport
sends it, after the counts of columns and rows.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from optipromp.core.errors import InvalidRequestError
from optipromp_eyes.pictures import MOST_PIXELS


def decoded_rvl(data: bytes) -> NDArray[np.uint16]:
    """Steps of depth (height, width); 0 where nothing was measured.

    Raises:
        InvalidRequestError: the bytes end before the pixels, or there are too many pixels.
    """
    width, height = struct.unpack("<ii", data[:8]) if len(data) >= 8 else (0, 0)
    if min(width, height) < 1 or width * height > MOST_PIXELS:
        raise InvalidRequestError(
            f"an RVL depth has {width} x {height} pixels; must be 1 to {MOST_PIXELS:,}"
        )
    words = np.frombuffer(data, "<u4", (len(data) - 8) // 4, 8)
    groups = (words[:, None] >> np.arange(28, -4, -4, dtype=np.uint32) & 15).ravel()
    last = np.flatnonzero(groups < 8)  # of each number, the three lowest bits first
    first = np.concatenate([[0], last[:-1] + 1])
    place = np.arange(len(groups)) - np.repeat(first, np.diff(np.append(first, len(groups))))
    parts = (groups & 7).astype(np.int64) << 3 * np.minimum(place, 10)
    numbers = np.add.reduceat(parts, first) if len(last) else parts[:0]
    left, at, runs, coded = width * height, 0, list[int](), [numbers[:0]]
    while left > 0 and at + 2 <= len(numbers) and numbers[at : at + 2].any():
        zeros, count = numbers[at : at + 2].tolist()
        runs += [zeros, count]
        coded.append(numbers[at + 2 : at + 2 + count])
        at, left = at + 2 + count, left - zeros - count
    if left or at > len(numbers):
        raise InvalidRequestError(
            f"an RVL depth of {width} x {height} pixels is damaged or too short"
        )
    out = np.zeros(width * height, dtype=np.int64)
    steps = np.concatenate(coded)
    out[np.repeat(np.arange(len(runs)) % 2 == 1, runs)] = np.cumsum(steps >> 1 ^ -(steps & 1))
    return out.astype(np.uint16).reshape(height, width)
