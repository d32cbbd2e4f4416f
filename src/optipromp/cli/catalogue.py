"""``optipromp list``: what is built in."""

from typing import Annotated

import typer

from optipromp.cli.console import OK, command, print_json, stdout

PLANNERS = {
    "promp": "the learnt primitive, conditioned on start, camera point and target",
    "i-promp": "conditioned on the fruits too, each pushed aside by its geometry",
    "opti-promp": "the conditioned primitive, optimised (default)",
}


@command()
def catalogue(
    as_json: Annotated[
        bool, typer.Option("--json", help="Print one JSON document and nothing else.")
    ] = False,
) -> int:
    """List the built-in robots and scenes, and the planners."""
    from optipromp.robots.library import robot_names
    from optipromp.scenes.io import scene_names

    robots, scenes = robot_names(), scene_names()
    if as_json:
        print_json({"robots": robots, "scenes": scenes, "planners": list(PLANNERS)})
        return OK
    console = stdout()
    console.print(f"robots    {', '.join(robots)}; or a URDF or robot file")
    console.print(f"scenes    {', '.join(scenes)}; or a scene file")
    for index, (name, text) in enumerate(PLANNERS.items()):
        console.print(f"{'planners' if index == 0 else '':<9} {name}: {text}")
    return OK
