"""A headless Chromium, and pages opened in it."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from tests.page.opened import PATIENCE, SMALL, Opened

from optipromp.core.planning import Plan, plan
from optipromp.core.scenes.io import load_scene
from optipromp_page.panel import Page, Panel

UNDRAWN = """
for (const kind of [WebGLRenderingContext, WebGL2RenderingContext])
  for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced'])
    kind.prototype[name] = () => {};
"""
"""Solids are not drawn, which takes the processor a second a picture; all else is there."""


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan(load_scene("scenario-3"))


@pytest.fixture(scope="module")
def opener(
    chromium: Any, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., Opened]]:
    """Opens pages of a source; they are closed after the module's tests."""
    ends = ExitStack()

    def open_page(
        source: Any = None, page: Any = None, out: Path | None = None, **screen: Any
    ) -> Opened:
        if page is None:
            page = Page(source, out=out or tmp_path_factory.mktemp("saved"))
            ends.callback(page.stop)
        before, errors = {*page.windows.values()}, []
        tab = chromium.new_page(**({"viewport": SMALL} | screen))
        ends.callback(tab.close)
        tab.add_init_script(UNDRAWN)
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.goto(page.url)
        end = time.monotonic() + PATIENCE
        while not (
            new := {w for w in page.windows.values() if isinstance(w.panel, Panel)} - before
        ):
            assert time.monotonic() < end, "the page does not connect"
            tab.wait_for_timeout(50)
        opened = Opened(page, tab, new.pop(), errors)
        opened.settle()
        return opened

    yield open_page
    ends.close()
