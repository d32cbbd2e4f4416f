"""``optipromp view``: a page in the browser to look at a plan, change its scene and plan again."""

import threading
from pathlib import Path
from typing import Annotated

import typer

from optipromp.cli.command import command
from optipromp.cli.console import say_if_compiling, stdout, waiting


@command(reports=False)
def view(
    item: Annotated[
        str,
        typer.Argument(
            metavar="SCENE|PLAN_DIR|ROLLOUT_DIR",
            help="A scene to plan for, or a folder that plan or simulate left.",
        ),
    ],
    beside: Annotated[
        str | None,
        typer.Argument(metavar="ROLLOUT_DIR", help="A second rollout, replayed beside the first."),
    ] = None,
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Of the page; 0: any that is free.")
    ] = 8080,
    host: Annotated[
        str, typer.Option(help="Address to listen at; 0.0.0.0 lets other machines in.")
    ] = "localhost",
    browser: Annotated[
        bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")
    ] = True,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder that the page saves into.")
    ] = Path("out"),
) -> None:
    """Open a page that shows a plan in 3-D and lets you move things and plan again.

    It listens on this machine only, unless --host says otherwise, and runs
    until Ctrl-C. Needs the extra 'view': pip install -e '.\\[view]'.

    [bold]Examples[/bold]

    \b
    optipromp view scenario-3
    optipromp view reach --port 0 --no-browser
    optipromp view reach-i-promp reach-opti-promp
    """
    import webbrowser

    from optipromp.core.planning import warm_up
    from optipromp.looks.page.panel import Page
    from optipromp.looks.page.replay import open_source

    source = open_source(item, beside)
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
