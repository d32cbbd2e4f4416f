"""The page as it opens on a desk and on a phone, in a real browser."""

from collections.abc import Callable

import numpy as np
import pytest
from tests.page.opened import PATIENCE, Opened

from optipromp.core.scenes.io import load_scene
from optipromp_page import stage, window
from optipromp_page.stage import Source

DESK = {"viewport": {"width": 1280, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
PICTURE = np.full((480, 640, 3), (10, 200, 30), np.uint8)
TABS = ("Plan", "Move", "Show", "Plots", "Record", "Replay")
TOUCHED = """
() => [...document.querySelectorAll(
    'button, [role=tab], input:not([type=hidden]), .mantine-Slider-root')]
  .filter(e => !e.closest('.mantine-Notification-root'))
  .map(e => [e.className + ' ' + (e.innerText || e.value || ''), e.getBoundingClientRect()])
  .filter(([, box]) => box.width > 0 && box.height > 0)
  .map(([name, box]) => [name, box.left, box.right, box.height])
"""
BUTTONS = """
() => [...document.querySelectorAll('button.mantine-Button-root')]
  .filter(e => e.checkVisibility()).map(e => [e.innerText, !e.disabled])
"""
OVERFLOW = """
() => [document.documentElement.scrollWidth, document.body.scrollWidth,
       ...[...document.querySelectorAll('.mantine-Paper-root *')]
         .filter(e => e.getBoundingClientRect().width > 0 && !e.closest('.mantine-Tabs-list'))
         .map(e => e.getBoundingClientRect().right)]
"""


@pytest.fixture(scope="module")
def desk(opener: Callable[..., Opened]) -> Opened:
    return opener(Source(load_scene("scenario-3"), reach=True), **DESK)


@pytest.fixture(scope="module")
def phone(opener: Callable[..., Opened]) -> Opened:
    return opener(Source(load_scene("scenario-3"), seen=PICTURE, reach=True), **PHONE)


def framed(opened: Opened, width: int, height: int) -> bool:
    """Whether the view is that of a tab of a size; ``test_words.py`` proves what each size sees."""
    camera, shown = opened.window.client.camera, opened.window.shown.plan
    if (camera.image_width, camera.image_height) != (width, height):
        return False
    was, tool = np.array(camera.position), shown.robot.tool_pose(shown.task.start)[0]
    opened.do(lambda: opened.window.view.look(shown.scene, tool))
    return np.allclose(camera.position, was)


def test_the_view_leaves_the_panel_its_place_and_follows_the_size_of_the_tab(desk, phone):
    for opened, screen in ((desk, DESK), (phone, PHONE)):
        width, height = screen["viewport"].values()
        panel = opened.tab.locator(".mantine-Paper-root").filter(has=opened.tab.locator(".status"))
        box = panel.first.bounding_box()
        sheet = box["y"] >= (1.0 - stage.SHEET) * height - 1.0
        assert sheet if width <= stage.NARROW else box["x"] >= width - stage.PANEL
        opened.until(
            lambda o=opened, w=width, h=height: framed(o, w, h), "the cluster is not framed"
        )
    desk.tab.set_viewport_size({"width": 400, "height": 900})
    desk.until(lambda: framed(desk, 400, 900), "the cluster is not framed again")
    desk.tab.set_viewport_size(DESK["viewport"])


def buttons(opened: Opened) -> dict[str, bool]:
    """Whether each button of ours that is seen is enabled, by its words.

    What a tab in the back holds is brought up to date when it comes to the front.
    """
    own = {button.label for button in opened.panel.buttons}
    return {name: on for name, on in opened.tab.evaluate(BUTTONS) if name in own}


def test_while_it_plans_it_says_so_and_no_button_can_be_pressed(phone: Opened) -> None:
    idle = {"accept", "discard", "save demonstrations", "learn and show the band",
            "forget what was learnt"}  # fmt: skip
    in_tabs = {"Move": {"save scene"}, "Replay": {"execute this plan"},
               "Record": {"start recording", *idle}, "Plan": {"plan again"}}  # fmt: skip

    def seen(able: bool) -> None:
        for name, some in in_tabs.items():
            phone.show(name)
            wanted = dict.fromkeys(some, able) | dict.fromkeys(idle & some, False)
            phone.until(lambda wanted=wanted: wanted.items() <= buttons(phone).items(), name)

    phone.told("This plan works")
    seen(able=True)
    with window._planning:  # as if another window planned
        phone.tab.get_by_role("button", name="plan again").dispatch_event("click")
        phone.told("planning …")
        seen(able=False)
    phone.told("This plan works")
    phone.settle()
    seen(able=True)


def test_a_new_scene_is_seen_before_it_is_planned(phone: Opened) -> None:
    with window._planning:
        phone.window.worker.post("other", lambda: phone.window.open(load_scene("scenario-1")))
        phone.told("planning …")
        phone.until(
            lambda: "fixed, not to be touched" in phone.tab.locator(".legend").first.inner_text(),
            "legend",
        )
        nodes = phone.window.client.scene
        assert nodes.get_handle_by_name("/a/things/target:ripe") is not None
    phone.settle()
    phone.told("At the goal the arm would touch what it must not")
    unseen = phone.tab.locator(".status").evaluate("e => e.scrollHeight - e.clientHeight")
    assert unseen == 0  # all of it can be read
    phone.do(lambda: phone.window.open(load_scene("scenario-3")))


@pytest.mark.parametrize("tab", TABS)
def test_a_phone_needs_no_sideways_scrolling_and_fingers_hit(phone: Opened, tab: str) -> None:
    phone.show(tab)
    phone.tab.wait_for_timeout(300)
    width = phone.tab.viewport_size["width"]
    assert max(phone.tab.evaluate(OVERFLOW)) <= width + 0.5
    found = phone.tab.evaluate(TOUCHED)
    assert len(found) > 10
    for name, left, right, height in found:
        assert height >= 40.0, name
        assert left >= -0.5, name
        assert right <= width + 0.5, name


def test_the_picture_of_a_scene_that_was_seen_stands_in_the_panel(phone: Opened) -> None:
    mine = "[...document.images].filter(i => i.naturalWidth == 640 && i.naturalHeight == 480)"
    phone.tab.wait_for_function(
        f"() => {mine}.some(i => i.clientWidth > 100)", timeout=1e3 * PATIENCE
    )
    assert phone.tab.get_by_text("as the camera saw it").is_visible()
