"""A page on which somebody clicks fruits and stems in pictures, to teach the eyes a crop."""

import html
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from contextlib import redirect_stdout
from io import StringIO
from typing import Any, Generic, TypeVar

import numpy as np

from optipromp.core.errors import OptiPrompError
from optipromp.looks.viewer.serving import listening
from optipromp_eyes.eyes import RIPE, STEM, UNRIPE
from optipromp_eyes.pictures import Image8
from optipromp_eyes.teaching import Mark
from optipromp_page.panel import usable

COLOURS = {"ripe": RIPE, "unripe": UNRIPE, "stem": STEM}
DOT = 0.006  # radius of the sign of a mark, in heights of the picture: a choice
AWAY = 1.1  # heights of the picture from it to the camera: a choice
HELP = "Choose a kind, then click: some ten ripe fruits, ten unripe ones, five stems."
Made = TypeVar("Made")


class TeachingPage(Generic[Made]):
    """A server of one picture at a time, in whose windows clicks are marks.

    The picture stands in the plane of x and y, one high, with y downwards. All windows are the
    same. *Write* learns from the marks; what is wrong with them is told, and more can be made.

    Args:
        pictures: colours (height, width, 3) by name.
        learn: what is made of the marks; it raises an error of OptI-ProMP where they do not do.
        host, port: where it listens; 0: any free port.
    """

    def __init__(
        self, pictures: Mapping[str, Image8], learn: Callable[[list[Mark]], Made],
        *, host: str = "localhost", port: int = 0,
    ) -> None:  # fmt: skip
        self.pictures, self.learn, self.marks = pictures, learn, list[Mark]()
        self._made: Future[Made] = Future()
        self._dots: list[Any] = []
        server = self.server = listening(host, usable(host, port))
        self.url = f"http://{host}:{server.get_port()}"
        server.initial_camera.position = 0.0, 0.0, -AWAY
        server.initial_camera.look_at = 0.0, 0.0, 0.0
        server.initial_camera.up = 0.0, -1.0, 0.0
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label("OptI-ProMP: teach a crop")
        self.status = server.gui.add_html("")
        self.picture = server.gui.add_dropdown("picture", tuple(pictures))
        self.kind = server.gui.add_dropdown("kind", tuple(COLOURS))
        self.picture.on_update(lambda _: self.show())
        server.gui.add_button("Undo").on_click(lambda _: self.undo())
        server.gui.add_button("Write").on_click(lambda _: self.write())
        self.show()

    def show(self) -> None:
        """Show the chosen picture and its marks."""
        rgb = self.pictures[self.picture.value]
        high, wide = rgb.shape[:2]
        node = self.server.scene.add_image("/picture", rgb, wide / high, 1.0, format="jpeg")
        node.on_click(lambda event: self.click(event.ray_origin, event.ray_direction))
        for dot in self._dots:
            dot.remove()
        self._dots = []
        for k, mark in enumerate(self.marks):
            if mark.picture == self.picture.value:
                place = (mark.box[0] - 0.5 * (wide - 1)) / high, (mark.box[1] + 0.5) / high - 0.5
                colour = COLOURS[mark.kind]
                self._dots.append(
                    self.server.scene.add_icosphere(
                        f"/mark{k}", DOT, color=colour, position=(*place, -DOT)
                    )
                )
        count = (f"{sum(m.kind == kind for m in self.marks)} {kind}" for kind in COLOURS)
        self.say(f"{HELP} Marked: {', '.join(count)}.")

    def click(self, origin: tuple[float, ...], way: tuple[float, ...]) -> None:
        """Mark what a ray hits in the picture."""
        high, wide = self.pictures[self.picture.value].shape[:2]
        x, y, _ = np.asarray(origin) - origin[2] / way[2] * np.asarray(way)
        at = high * float(x) + 0.5 * (wide - 1), high * (float(y) + 0.5) - 0.5
        self.marks.append(Mark(self.picture.value, self.kind.value, (*at, *at)))
        self.show()

    def undo(self) -> None:
        """Take the last mark back."""
        del self.marks[-1:]
        self.show()

    def write(self) -> None:
        """Learn from the marks; say what is wrong with them, or end."""
        try:
            made = self.learn(list(self.marks))
        except OptiPrompError as error:
            self.say(error.message)
            return
        self.say("Learnt; this page can be closed.")
        if not self._made.done():
            self._made.set_result(made)

    def say(self, words: str) -> None:
        """Show words above the controls."""
        self.status.content = f'<div class="status" role="status">{html.escape(words)}</div>'

    def result(self) -> Made:
        """What was made of the marks, once it is; then the page ends."""
        try:
            return self._made.result()
        finally:
            with redirect_stdout(StringIO()):
                self.server.stop()
