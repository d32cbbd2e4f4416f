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
    parts = (groups & 7).astype(np.int64) << 3 * np.minimum(place, 20)
    numbers = np.add.reduceat(parts, first) if len(last) else parts[:0]
    steps = (numbers >> 1) ^ -(numbers & 1)
    known = np.zeros(width * height, dtype=bool)
    taken = np.zeros(len(numbers), dtype=bool)  # numbers that are differences
    pixel = at = 0
    while pixel < known.size:
        zeros, count = numbers[at : at + 2].tolist() if at + 2 <= len(numbers) else (0, 0)
        begin, at = pixel + zeros, at + 2
        pixel = begin + count
        if not (zeros or count) or pixel > known.size or at + count > len(numbers):
            raise InvalidRequestError(
                f"an RVL depth of {width} x {height} pixels is damaged or too short"
            )
        known[begin:pixel], taken[at : at + count] = True, True
        at += count
    out = np.zeros(known.size, dtype=np.int64)
    out[known] = np.cumsum(steps[taken])
    return out.astype(np.uint16).reshape(height, width)
