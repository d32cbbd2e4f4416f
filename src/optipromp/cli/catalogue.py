"""``optipromp list``: what is built in; ``--set key=value``: a planner's settings from text."""

import dataclasses
import inspect
import re
from collections.abc import Sequence
from typing import Any

from optipromp.cli.command import Report, command
from optipromp.errors import InvalidRequestError

PLANNERS = {
    "promp": "the learnt primitive, conditioned on start, camera point and target",
    "i-promp": "conditioned on the fruits too, each pushed aside by its geometry",
    "opti-promp": "the conditioned primitive, optimised (default)",
}


@command()
def catalogue() -> Report:
    """List the built-in robots and scenes, the kinds of tool, the planners, and their settings."""
    from optipromp.planning.options import PaperOptions, PlanOptions
    from optipromp.robots.library import robot_names
    from optipromp.robots.tools import TOOLS
    from optipromp.scenes.io import scene_names

    robots, scenes = robot_names(), scene_names()
    known = documented(PlanOptions)
    known |= {f"paper.{name}": item for name, item in documented(PaperOptions).items()}
    planners = (f"{name}: {text}" for name, text in PLANNERS.items())
    lines = [
        f"robots    {', '.join(robots)}; or a URDF or robot file",
        f"tools     {', '.join(TOOLS)}",
        f"scenes    {', '.join(scenes)}; or a scene file",
        "planners  " + "\n          ".join(planners),
        "\nsettings, for plan --set KEY=VALUE:",
        *(f"  {name} (default {default}): {text}" for name, (default, text) in known.items()),
    ]
    document = {
        "robots": robots, "tools": list(TOOLS), "scenes": scenes, "planners": list(PLANNERS),
        "settings": {k: {"default": d, "meaning": text} for k, (d, text) in known.items()},
    }  # fmt: skip
    return Report(document, lines)


def settings(pairs: Sequence[str], **given: Any) -> Any:
    """:class:`optipromp.planning.PlanOptions` of ``key=value`` texts; values are read as YAML.

    A setting of the paper's planners is ``paper.key``. ``given`` are settings that have an option
    of their own; None stands for none.

    Raises:
        InvalidRequestError: no such key, a text that is no pair, a value that may not be; the
            message names the keys there are.
    """
    import yaml

    from optipromp.documents import read_yaml
    from optipromp.planning import PaperOptions, PlanOptions
    from optipromp.scenes.values import suggest

    known = {name: value for name, value in given.items() if value is not None}
    paper: dict[str, Any] = {}
    for pair in pairs:
        key, found, text = pair.partition("=")
        if not found:
            raise InvalidRequestError(f"--set {pair}: write key=value, as in --set max_step=0.03")
        names = [*documented(PlanOptions), *(f"paper.{name}" for name in documented(PaperOptions))]
        if key not in names:
            raise InvalidRequestError(f"--set {key}: no such setting; {suggest(key, names)}")
        try:
            value = {"yes": True, "no": False}.get(text, read_yaml(text))
        except (yaml.YAMLError, ValueError) as error:
            raise InvalidRequestError(f"--set {pair}: cannot read {text!r} ({error})") from None
        value = tuple(value) if isinstance(value, list) else value
        wanted = paper if key.startswith("paper.") else known
        wanted[key.removeprefix("paper.")] = value
    if paper:
        known["paper"] = PaperOptions(**paper)
    return PlanOptions(**known)


def documented(options: type) -> dict[str, tuple[Any, str]]:
    """Settings that can be written as text: name, default and what its docstring says of it."""
    text = inspect.cleandoc(options.__doc__ or "")
    lines = re.split(r"\n    (?=\w+: )", text.partition("Attributes:")[2])
    said = {name: " ".join(rest.split()) for name, _, rest in (x.partition(": ") for x in lines)}
    return {
        item.name: (item.default, said.get(item.name.strip(), ""))
        for item in dataclasses.fields(options)
        if item.name not in ("costs", "paper")
    }
