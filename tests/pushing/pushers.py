"""A square, and what pushes it."""

import numpy as np

SQUARE = np.array([[-0.02, -0.02], [0.02, -0.02], [0.02, 0.02], [-0.02, 0.02]])


PUSHER = np.array([[-0.02, -0.05], [0.0, -0.05], [0.0, 0.05], [-0.02, 0.05]])


def line(start, end, step=0.002):
    start, end = np.array([*start, 0.0]), np.array([*end, 0.0])
    count = int(np.ceil(np.linalg.norm(end - start) / step)) + 1
    return start + np.linspace(0.0, 1.0, count)[:, None] * (end - start)
