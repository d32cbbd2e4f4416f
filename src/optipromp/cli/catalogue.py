"""``optipromp list``: what is built in."""

from optipromp.cli.console import OK, command, print_json, stdout
from optipromp.cli.options import AsJson

PLANNERS = {
    "promp": "the learnt primitive, conditioned on start, camera point and target",
    "i-promp": "conditioned on the fruits too, each pushed aside by its geometry",
    "opti-promp": "the conditioned primitive, optimised (default)",
}


@command()
def catalogue(
    as_json: AsJson = False,
) -> int:
    """List the built-in robots and scenes, the kinds of tool, the planners, and their settings."""
    from optipromp.cli.settings import documented
    from optipromp.planning.options import PaperOptions, PlanOptions
    from optipromp.robots.library import robot_names
    from optipromp.robots.tools import TOOLS
    from optipromp.scenes.io import scene_names

    robots, scenes = robot_names(), scene_names()
    known = documented(PlanOptions)
    known |= {f"paper.{name}": item for name, item in documented(PaperOptions).items()}
    if as_json:
        print_json(
            {
                "robots": robots, "tools": list(TOOLS), "scenes": scenes,
                "planners": list(PLANNERS),
                "settings": {k: {"default": d, "meaning": text} for k, (d, text) in known.items()},
            }
        )  # fmt: skip
        return OK
    console = stdout()
    console.print(f"robots    {', '.join(robots)}; or a URDF or robot file")
    console.print(f"tools     {', '.join(TOOLS)}")
    console.print(f"scenes    {', '.join(scenes)}; or a scene file")
    for index, (name, text) in enumerate(PLANNERS.items()):
        console.print(f"{'planners' if index == 0 else '':<9} {name}: {text}")
    console.print("\nsettings, for plan --set KEY=VALUE:")
    for name, (default, text) in known.items():
        console.print(f"  {name} (default {default}): {text}", highlight=False, markup=False)
    return OK
