"""A picture with what was found drawn over it."""

import numpy as np
from scipy.ndimage import binary_dilation

from optipromp.core.arrays import FloatArray
from optipromp.perception.eyes import Sighting
from optipromp.perception.geometry import edge_of
from optipromp.perception.pictures import DepthPicture, Image8

RIPE, UNRIPE, STEM, CENTER = (255, 60, 200), (60, 160, 255), (255, 220, 0), (255, 255, 255)
HALF = 3  # [pixel] half the size of a cross


def overlay(picture: DepthPicture, sight: Sighting) -> Image8:
    """The picture (height, width, 3) with outlines of fruits, their centres, and lines of stems."""
    out = np.array(picture.rgb)
    for each in sight.detections:
        edge = binary_dilation(edge_of(each.region.pixels))
        out[edge] = RIPE if each.region.kind == "ripe" else UNRIPE
        center = each.item.position
        if each.item.stem is not None:
            _line(out, picture, center, each.item.stem.root)
        column, row = np.rint(picture.camera.pixels(center)).astype(int)
        out[max(row - HALF, 0) : row + HALF + 1, max(column, 0) : column + 1] = CENTER
        out[max(row, 0) : row + 1, max(column - HALF, 0) : column + HALF + 1] = CENTER
    return out


def _line(out: Image8, picture: DepthPicture, begin: FloatArray, end: FloatArray) -> None:
    """Draw a line between two points in the frame of the camera."""
    share = np.linspace(0.0, 1.0, 300)[:, None]
    points = begin + share * (end - begin)
    ahead = points[points[:, 2] > 1e-3]  # [m] before the camera
    places = np.rint(picture.camera.pixels(ahead)).astype(int)
    inside = (places >= 0).all(axis=1)
    inside &= (places[:, 0] < out.shape[1]) & (places[:, 1] < out.shape[0])
    places = places[inside]
    out[places[:, 1], places[:, 0]] = STEM
