"""The page on which fruits are clicked to teach the eyes, in a real browser."""

import numpy as np
import pytest
from tests.page.opened import Opened

from optipromp.core.errors import InvalidRequestError
from optipromp_eyes.teaching import Mark
from optipromp_page.teaching import TeachingPage


def test_clicks_are_marks_where_they_hit_the_picture_and_write_tells_what_is_wrong(chromium):
    def learn(marks: list[Mark]) -> int:
        if marks[-1].kind == "ripe":
            raise InvalidRequestError("0 stems are marked")
        return len(marks)

    rgb = np.zeros((240, 320, 3), dtype=np.uint8)
    page = TeachingPage({"a": rgb, "b": rgb}, learn)
    try:
        tab = chromium.new_page(viewport={"width": 640, "height": 480})
        tab.goto(page.url)
        until = Opened(page, tab, None, []).until

        def clicked() -> bool:  # a browser that still draws misses a click
            if not page.marks:
                tab.mouse.click(220, 300)
            return bool(page.marks)

        until(clicked, "no click arrives")
        scale = 0.5 * 480 / np.tan(np.deg2rad(37.5)) / 1.1 / 240  # [pixel] of a pixel; 75 degrees
        expected = 159.5 + (220 - 320) / scale, 119.5 + (300 - 240) / scale
        assert page.marks[0].picture == "a"
        assert page.marks[0].box == pytest.approx(2 * expected, abs=2.0)
        tab.get_by_role("button", name="Write").dispatch_event("click")
        until(lambda: "0 stems are marked" in tab.content(), "it does not answer")
        page.kind.value = "stem"
        page.picture.value = "b"
        page.click((0.0, 0.0, -1.1), (0.0, 0.0, 1.0))
        assert page.marks[-1] == Mark("b", "stem", (159.5, 119.5, 159.5, 119.5))
        page.click((0.0, 0.0, -1.1), (0.3, 0.0, 1.0))
        tab.get_by_role("button", name="Undo").dispatch_event("click")
        until(lambda: page.marks[-1].box[0] == 159.5, "it does not answer")
        tab.get_by_role("button", name="Write").dispatch_event("click")
        assert page.result() == len(page.marks)
        tab.close()
    finally:
        page.server.stop()
