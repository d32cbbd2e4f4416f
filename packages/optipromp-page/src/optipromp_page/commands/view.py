"""``optipromp view``: a page that shows a plan."""

import threading
from dataclasses import replace
from pathlib import Path

from optipromp.cli.command import command
from optipromp.cli.console import say_if_compiling, stdout, waiting


@command(reports=False)
def view(
    item: str,
    beside: str | None = None,
    /,
    port: int = 8080,
    host: str = "localhost",
    browser: bool = True,
    out: Path = Path("out"),
    reach: bool = False,
) -> None:
    """Open a page that shows a plan in 3-D and lets you move things and plan again.

    It listens on this machine only, unless --host says otherwise, and runs
    until Ctrl-C.

    Examples:
        optipromp view scenario-4
        optipromp view pick --port 0 --no-browser
        optipromp view reach-i-promp reach-opti-promp

    Args:
        item (SCENE|PLAN_DIR|ROLLOUT_DIR): A scene to plan for, or a folder that plan or simulate
            left.
        beside (ROLLOUT_DIR): A second rollout, replayed beside the first.
        port (0..65535): Of the page; 0: any that is free.
        host: Address to listen at; 0.0.0.0 lets other machines in.
        browser: Open the page in the browser.
        out (DIR): Folder that the page saves into.
        reach: Plan the reach alone, without the way out.
    """
    import webbrowser

    from optipromp.core.planning import warm_up
    from optipromp_page.panel import Page
    from optipromp_page.stage import open_source

    source = replace(open_source(item, beside), reach=reach)
    say_if_compiling()
    with waiting("loading"):
        warm_up()  # so that the first plan does not wait for it
    page = Page(source, host=host, port=port, out=out)
    try:
        stdout().print(f"{page.url}  (Ctrl-C ends it)")
        if browser:
            webbrowser.open(page.url)
        threading.Event().wait()
    except KeyboardInterrupt:
        stdout().print("closed")
    finally:
        page.stop()
