"""The page as it opens on a desk and on a phone, in a real browser."""

import re
from collections.abc import Callable

import numpy as np
import pytest

pytest.importorskip("viser")

from tests.page.opened import PATIENCE, Opened

from optipromp.core.scenes.io import load_scene
from optipromp_page import stage, window
from optipromp_page.stage import Source

SLOW = pytest.mark.slow  # the processor draws pictures for minutes
DESK = {"viewport": {"width": 1280, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
TINY = {"viewport": {"width": 160, "height": 120}}  # little to draw
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
  .map(e => [e.innerText, !e.disabled])
"""
OVERFLOW = """
() => [document.documentElement.scrollWidth, document.body.scrollWidth,
       ...[...document.querySelectorAll('.mantine-Paper-root *')]
         .filter(e => e.getBoundingClientRect().width > 0 && !e.closest('.mantine-Tabs-list'))
         .map(e => e.getBoundingClientRect().right)]
"""


@pytest.fixture(scope="module")
def desk(opener: Callable[..., Opened]) -> Opened:
    return opener(Source(load_scene("scenario-3"), reach=True), draws=True, **DESK)


@pytest.fixture(scope="module")
def phone(opener: Callable[..., Opened]) -> Opened:
    return opener(Source(load_scene("scenario-3"), reach=True), draws=True, **PHONE)


def outlines(opened: Opened) -> np.ndarray:
    """Where the outlines of target, pushables and tool at the start are in the tab (N, 2)."""
    import viser.transforms as turns

    shown, camera = opened.window, opened.window.client.camera
    size = opened.tab.viewport_size
    tool = shown.plan.robot.tool_pose(shown.plan.trajectory.positions[0])[0]
    centres = [*(o.position for o in shown.scene.objects if o.role in ("target", "pushable")), tool]
    radii = [o.radius for o in shown.scene.objects if o.role in ("target", "pushable")]
    axes = turns.SO3(np.array(camera.wxyz)).as_matrix()
    points = (shown.scene.base @ np.array(centres) - camera.position) @ axes
    angle = np.linspace(0.0, 2.0 * np.pi, 24)
    ring = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    points = (points[:, None] + np.array([*radii, 0.0])[:, None, None] * ring).reshape(-1, 3)
    scale = 0.5 * size["height"] / np.tan(0.5 * camera.fov)
    middle = 0.5 * np.array([size["width"], size["height"]])
    return middle + scale * points[:, :2] / points[:, 2:]


@SLOW
def test_the_desk_sees_the_cluster_beside_the_panel(desk: Opened) -> None:
    panel = desk.tab.locator(".status").bounding_box()
    seen = outlines(desk)
    assert (seen > 0.0).all()
    assert seen[:, 0].max() < panel["x"]
    assert seen[:, 1].max() < desk.tab.viewport_size["height"]
    assert np.ptp(seen[:, 1]) > 0.6 * desk.tab.viewport_size["height"]


def test_the_phone_sees_the_cluster_above_the_panel(phone: Opened) -> None:
    panel = phone.tab.locator(".mantine-Paper-root").filter(has=phone.tab.locator(".status"))
    size, told = phone.tab.viewport_size, list[str]()

    def framed() -> bool:
        top, seen = panel.first.bounding_box()["y"], outlines(phone)
        camera = phone.window.client.camera
        told[:] = [f"panel from {top}, seen {seen.min(axis=0)} to {seen.max(axis=0)}, "
                   f"size {camera.image_width} x {camera.image_height} of {size}"]  # fmt: skip
        inside = (seen > 0.0).all() and seen[:, 0].max() < size["width"]
        wide = np.ptp(seen[:, 1]) > 0.6 * top > 0.6 * 0.45 * size["height"]
        return bool(inside and wide and seen[:, 1].max() < top)

    phone.until(framed, told)  # the page tells its size, and lays itself out, after it opens


@SLOW
def test_a_page_that_changes_its_size_frames_the_cluster_again(
    opener: Callable[..., Opened],
) -> None:
    opened = opener(Source(load_scene("scenario-3"), reach=True), draws=True, **DESK)
    tall = {"width": 400, "height": 900}
    opened.tab.set_viewport_size(tall)

    def framed() -> bool:
        seen = outlines(opened)
        inside = (seen > 0.0).all() and seen[:, 0].max() < tall["width"]
        return bool(inside and np.ptp(seen[:, 1]) > 0.25 * tall["height"])

    opened.until(framed, "the cluster is not framed")


@pytest.mark.parametrize("screen", [pytest.param("desk", marks=SLOW), "phone"])
def test_words_and_legend_stand_before_the_numbers(
    screen: str, request: pytest.FixtureRequest
) -> None:
    opened = request.getfixturevalue(screen)
    opened.told("Passes n1 at 62 mm, pushes it")
    opened.told("no harm")
    words, legend, numbers = (
        opened.tab.locator(name).bounding_box() for name in (".status", ".legend", "table")
    )
    assert words["y"] < legend["y"] < numbers["y"]
    shown = opened.tab.locator(".legend").inner_text()
    for entry in ("target", "may be pushed aside", "the arm keeps away", "tool path",
                  "predicted push"):  # fmt: skip
        assert entry in shown, entry
    opened.panel._layer("trajectories", False)
    opened.until(lambda: "tool path" not in opened.tab.locator(".legend").inner_text(), "it stays")
    opened.panel._layer("trajectories", True)


def buttons(opened: Opened) -> dict[str, bool]:
    """Whether each button of ours is enabled, by its words."""
    own = {button.label for button in opened.panel.buttons}
    return {name: on for name, on in opened.tab.evaluate(BUTTONS) if name in own}


@SLOW
def test_while_it_plans_it_says_so_and_no_button_can_be_pressed(
    opener: Callable[..., Opened],
) -> None:
    tab = opener(Source(load_scene("scenario-3"), reach=True), **TINY)
    tab.told("This plan works")
    idle = {"accept", "discard", "save demonstrations", "learn and show the band",
            "forget what was learnt"}  # fmt: skip

    def ready() -> bool:
        return all(on is not (name in idle) for name, on in buttons(tab).items())

    tab.until(ready, "buttons stay disabled, or have nothing to do and are enabled")
    with window._planning:  # as if another window planned
        tab.tab.get_by_role("button", name="plan again").dispatch_event("click")
        tab.told("planning …")
        tab.until(lambda: not any(buttons(tab).values()), "buttons stay enabled")
        for name, label in (("Plan", "plan again"), ("Record", "start recording"),
                           ("Replay", "execute this plan")):  # fmt: skip
            tab.show(name)
            tab.until(lambda label=label: buttons(tab).get(label) is False, label)
    tab.told("This plan works")
    tab.settle()
    tab.show("Plan")
    tab.until(ready, "buttons stay disabled")


def test_a_new_scene_is_seen_before_it_is_planned(phone: Opened) -> None:
    def fruit() -> bool:
        return phone.window.client.scene.get_handle_by_name("/a/things/target:ripe") is not None

    with window._planning:
        phone.window.post("other", lambda: phone.window.open(load_scene("scenario-1")))
        phone.told("planning …")
        phone.until(
            lambda: "fixed, not to be touched" in phone.tab.locator(".legend").inner_text(),
            "legend",
        )
        assert fruit()
    phone.settle()


def test_a_failure_has_words_in_the_place_of_its_code(phone: Opened) -> None:
    phone.do(lambda: phone.window.open(load_scene("scenario-1")))
    assert phone.window.plan.status == "GOAL_IN_COLLISION"
    phone.told("At the goal the arm would touch what it must not")
    seen = phone.tab.locator("body").inner_text()
    assert not re.findall(r"[A-Z]{3,}_[A-Z_]+|SUCCESS|TIMEOUT", seen)
    assert phone.tab.locator(".status").get_attribute("title") == "GOAL_IN_COLLISION"
    assert (
        phone.tab.locator(".status").evaluate("e => e.scrollHeight - e.clientHeight") == 0
    )  # all of it can be read
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


def test_a_phone_reaches_the_last_control(phone: Opened) -> None:
    phone.show("Plan")
    phone.settle()
    button = phone.tab.get_by_role("button", name="plan again")
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    assert box["y"] + box["height"] <= phone.tab.viewport_size["height"]
    before = phone.window.plan
    button.tap()
    phone.until(lambda: phone.window.plan is not before, "the tap does nothing")
    phone.settle()
    assert phone.errors == []


def test_the_view_of_a_phone_is_the_same_as_the_sheets(phone: Opened) -> None:
    assert phone.tab.viewport_size["width"] <= stage.NARROW
    assert phone.window.client.camera.image_width == phone.tab.viewport_size["width"]


def test_the_picture_of_a_scene_that_was_seen_stands_in_the_panel(
    opener: Callable[..., Opened],
) -> None:
    picture = np.full((480, 640, 3), (10, 200, 30), np.uint8)
    opened = opener(Source(load_scene("scenario-3"), seen=picture, reach=True), **PHONE)
    mine = "[...document.images].filter(i => i.naturalWidth == 640 && i.naturalHeight == 480)"
    opened.tab.wait_for_function(
        f"() => {mine}.some(i => i.clientWidth > 100)", timeout=1e3 * PATIENCE
    )
    assert opened.tab.get_by_text("as the camera saw it").is_visible()
    assert max(opened.tab.evaluate(OVERFLOW)) <= PHONE["viewport"]["width"] + 1
    opened.tab.close()
