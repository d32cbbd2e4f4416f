"""Values in notebooks: rich text, pictures and 3-D views; see ``core/shown.py``."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import write_atomically
from optipromp.core.planning.result import Plan
from optipromp.core.promp.model import ProMP
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import JointGoal, Scene
from optipromp.core.trajectory import Trajectory
from optipromp.looks.viewer.html import DPI, View3D, table
from optipromp.looks.viewer.words import plan_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Plot:
    """A picture: matplotlib's ``figure``, and its PNG."""

    figure: "Figure"

    @cached_property
    def _png(self) -> bytes:
        from optipromp.looks.viewer.figures import png

        return png(self.figure, DPI)

    def _repr_png_(self) -> bytes:
        return self._png

    def save(self, path: Path | str) -> None:
        """Write the PNG. Raises InvalidRequestError where it cannot be written."""
        write_atomically(Path(path), self._png)


def show(thing: Any) -> View3D:
    """The 3-D view of a plan, a scene or a robot. Raises InvalidRequestError: it is none."""
    from optipromp.looks.viewer.serving import plan_page, scene_page

    if isinstance(thing, Plan):
        return View3D(plan_page(thing))
    if isinstance(thing, Scene):
        return View3D(scene_page(thing))
    if isinstance(thing, Robot):
        scene = Scene(thing.name, thing.name, (), goal=JointGoal(thing.home))
        return View3D(scene_page(scene, thing))
    raise InvalidRequestError(f"there is no 3-D view of a {type(thing).__name__}")


def plot(thing: Any, *args: Any) -> Plot:
    """The picture of a plan, primitive, trajectory or robot. Raises InvalidRequestError: none."""
    from optipromp.looks.viewer import figures, reach

    if isinstance(thing, Plan):
        return Plot(reach.reach_figure(thing))
    if isinstance(thing, ProMP):
        return Plot(figures.primitive_figure(thing, *args))
    if isinstance(thing, Trajectory):
        return Plot(figures.trajectory_figure(thing))
    if isinstance(thing, Robot):
        return Plot(figures.cover_figure(thing))
    raise InvalidRequestError(f"there is no picture of a {type(thing).__name__}; try show()")


def rich(thing: Any) -> str:
    """A heading and a table, as HTML."""
    rows: Sequence[tuple[str, ...]] = []
    head: tuple[str, ...] = ()
    if isinstance(thing, Plan):
        rows = [("message", thing.message), *plan_rows(thing)]
    elif isinstance(thing, Scene):
        head = ("object", "role", "shape", "position [m]", "stem")
        rows = [
            (item.id, item.role, type(item.shape).__name__, _numbers(item.position),
             "" if item.stem is None else f"root {_numbers(item.stem.root)}")
            for item in thing.objects
        ]  # fmt: skip
    elif isinstance(thing, Robot | ProMP | Trajectory):
        head, rows = _joints(thing)
    else:
        rows = thing._table()
    return f"<p><b>{escape(repr(thing)[1:-1])}</b></p>{table(rows, head)}"


def _joints(thing: Robot | ProMP | Trajectory) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    if isinstance(thing, Robot):
        head: tuple[str, ...] = ("joint", "from", "to", "velocity", "home")
        columns: Sequence[Any] = (thing.lower, thing.upper, thing.velocity, thing.home)
    elif isinstance(thing, ProMP):
        head = ("joint", "mean at the start", "at the end", "standard deviation at the end")
        mean, spread = (
            f(np.array([0.0, 1.0])) for f in (thing.mean_trajectory, thing.standard_deviation)
        )
        columns = (mean[0], mean[1], spread[1])
    else:
        head = ("joint", "from", "to", "least", "largest")
        q = thing.positions
        columns = (q[0], q[-1], q.min(axis=0), q.max(axis=0))
    values = np.stack([np.asarray(column, dtype=float) for column in columns], axis=1)
    return head, [
        (name, *(f"{value:.4g}" for value in row))
        for name, row in zip(thing.joint_names, values, strict=True)
    ]


def _numbers(values: Iterable[float]) -> str:
    return ", ".join(f"{value:.3f}" for value in values)
