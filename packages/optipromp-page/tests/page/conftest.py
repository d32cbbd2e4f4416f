"""A headless Chromium, and pages opened in it."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from tests.page.opened import PATIENCE, SMALL, Opened

UNDRAWN = """
for (const kind of [WebGLRenderingContext, WebGL2RenderingContext])
  for (const name of ['drawArrays', 'drawElements', 'drawArraysInstanced', 'drawElementsInstanced'])
    kind.prototype[name] = () => {};
"""
"""Solids are not drawn, which takes the processor a second a picture; all else is there."""


@pytest.fixture(scope="module")
def opener(
    chromium: Any, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[Callable[..., Opened]]:
    """Opens pages of a source; they are closed after the module's tests."""
    from optipromp_page.panel import Page, Panel

    pages: list[Any] = []
    tabs: list[Any] = []

    def open_page(
        source: Any = None,
        page: Any = None,
        out: Path | None = None,
        **screen: Any,
    ) -> Opened:
        if page is None:
            page = Page(source, out=out or tmp_path_factory.mktemp("saved"))
            pages.append(page)
        before, errors = {*page.windows.values()}, []
        tab = chromium.new_page(**({"viewport": SMALL} | screen))
        tabs.append(tab)
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
    for tab in tabs:
        tab.close()
    for page in pages:
        page.stop()
