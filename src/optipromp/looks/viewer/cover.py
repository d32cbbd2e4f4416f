"""The picture of a robot's body spheres over what they cover."""

from typing import TYPE_CHECKING

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.robots.description import rotation_of
from optipromp.core.robots.model import Robot
from optipromp.readers.meshes import triangles

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SOLID = "#9aa0a8"
_VIEWS = ((0, 2), (1, 2), (0, 1))
_SIZE, _TICKS = 5.0, 6  # [inch] of a view; ticks where it is as wide as high
_COLOURS = ("#2f6db3", "#c8662b", "#3f8f4f")  # of neighbouring links


def cover_figure(robot: Robot) -> "Figure":
    """Three views of the arm at home: its meshes grey, its body spheres as circles."""
    from matplotlib.collections import EllipseCollection, PolyCollection
    from matplotlib.figure import Figure

    centers, radius = robot.sphere_centers(robot.home), np.asarray(robot.spheres.radius)
    surface = surfaces(robot)
    colours = [_COLOURS[link % len(_COLOURS)] for link in robot.spheres.link]
    figure = Figure(figsize=(len(_VIEWS) * _SIZE, _SIZE), layout="constrained", facecolor="white")
    for axes, view in zip(figure.subplots(1, len(_VIEWS)), _VIEWS, strict=True):
        axes.add_collection(
            PolyCollection(list(surface[:, :, view]), facecolors=SOLID, linewidths=0.0)
        )
        axes.add_collection(
            EllipseCollection(
                2.0 * radius, 2.0 * radius, np.zeros(len(radius)), units="xy",
                offsets=centers[:, view], offset_transform=axes.transData,
                facecolors="none", edgecolors=colours, linewidths=0.8,
            )
        )  # fmt: skip
        low = (centers[:, view] - radius[:, None]).min(axis=0)
        high = (centers[:, view] + radius[:, None]).max(axis=0)
        axes.set(
            aspect="equal",
            xlim=(low[0], high[0]),
            ylim=(low[1], high[1]),
            xlabel=f"{'xyz'[view[0]]} [m]",
            ylabel=f"{'xyz'[view[1]]} [m]",
        )
        axes.locator_params("x", nbins=int(np.clip(_TICKS * np.divide(*(high - low)), 1, _TICKS)))
    count, most = len(radius), max(robot.excess.values(), default=0.0)
    reach = f", at most {1000.0 * most:.0f} mm beyond the links" if robot.excess else ""
    figure.suptitle(f"{robot.name}: {count} body spheres{reach}")
    return figure


def surfaces(robot: Robot) -> FloatArray:
    """The triangles (f, 3, 3) of the meshes of all links at home, in the base's frame [m].

    Raises InvalidRobotError for a mesh that cannot be read.
    """
    origins, rotations = robot.segment_frames(robot.home)
    out = [np.zeros((0, 3, 3))]
    for link in robot.geometry:
        for shape in link.shapes:
            if shape.kind != "mesh":
                continue
            local = triangles(link.urdf, link.link, shape) @ rotation_of(shape.rpy).T + shape.xyz
            placed = local @ link.rotation.T + link.translation
            if link.segment >= 0:
                placed = placed @ rotations[link.segment].T + origins[link.segment]
            out.append(placed)
    return np.concatenate(out)
