"""``optipromp list``: robots, scenes, planners; ``--set key=value``: settings from text."""

import dataclasses
import inspect
from collections.abc import Sequence
from typing import Any

import optipromp
from optipromp.cli.command import Report, command, entries
from optipromp.core.errors import InvalidRequestError, unknown


@command()
def catalogue() -> Report:
    """List the built-in robots and scenes, the kinds of tool, the planners, and their settings."""
    from optipromp.core.planning.planners import planners
    from optipromp.core.robots.library import robot_names
    from optipromp.core.robots.tools import TOOLS
    from optipromp.core.scenes.io import scene_names

    robots, scenes = robot_names(), scene_names()
    known = documented(optipromp.PlanOptions)
    kinds = planners()
    own = {name: documented(kind) for name, kind in kinds.items()}
    lines = [
        f"robots    {', '.join(robots)}; or a URDF or robot file",
        f"tools     {', '.join(TOOLS)}",
        f"scenes    {', '.join(scenes)}; or a scene file",
    ]
    for index, (name, kind) in enumerate(kinds.items()):
        usual = " (default)" if name == "opti-promp" else ""
        first = inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0]  # paragraph
        told = " ".join(first.split()).rstrip(".")
        lines.append(f"{'planners' if index == 0 else '':<9} {name}: {told}{usual}")
    lines += _lines("settings, for plan --set KEY=VALUE:", known)
    for planner, found in own.items():
        others = {name: item for name, item in found.items() if item != known.get(name)}
        lines += _lines(f"settings of {planner}, beside those of the same name above:", others)
    document = {
        "robots": robots,
        "tools": list(TOOLS),
        "scenes": scenes,
        "planners": list(kinds),
        "settings": _told(known),
        "planner_settings": {name: _told(found) for name, found in own.items()},
    }
    return Report(document, lines)


def _lines(title: str, found: dict[str, tuple[Any, str]]) -> list[str]:
    told = [f"  {name} (default {default}): {text}" for name, (default, text) in found.items()]
    return [f"\n{title}", *told] if found else []


def _told(found: dict[str, tuple[Any, str]]) -> dict[str, dict[str, Any]]:
    return {name: {"default": value, "meaning": text} for name, (value, text) in found.items()}


def asked(planner: str, pairs: Sequence[str], stated: dict[str, Any]) -> dict[str, Any]:
    """Planner and options of a plan, from texts: the planner's own settings, and time, effort and
    risk of the plan. ``stated`` are settings that have their own command-line option; None: not
    stated."""
    from optipromp.core.planning import planners
    from optipromp.core.planning.planners import OF_A_PLAN

    found = {name: value for name, value in stated.items() if value is not None}
    found |= _values(pairs, [*documented(planners.factory(planner)), *OF_A_PLAN])
    options = optipromp.PlanOptions(**{k: v for k, v in found.items() if k in OF_A_PLAN})
    own = {k: v for k, v in found.items() if k not in OF_A_PLAN}
    return {"planner": planners.make(planner, **own), "options": options}


def _values(pairs: Sequence[str], names: list[str]) -> dict[str, Any]:
    """Values of ``key=value`` texts."""
    import yaml

    from optipromp.core.documents import read_yaml

    known: dict[str, Any] = {}
    for pair in pairs:
        key, found, text = pair.partition("=")
        if not found:
            raise InvalidRequestError(f"--set {pair}: write key=value, as in --set max_step=0.03")
        if key not in names:
            raise InvalidRequestError(f"--set {key}: no such setting; {unknown(key, names)}")
        try:
            value = {"yes": True, "no": False}.get(text, read_yaml(text))
        except (yaml.YAMLError, ValueError) as error:
            raise InvalidRequestError(f"--set {pair}: cannot read {text!r} ({error})") from None
        known[key] = tuple(value) if isinstance(value, list) else value
    return known


def documented(options: Any) -> dict[str, tuple[Any, str]]:
    """Default and documentation of the settings that can be written as text, by name."""
    if not dataclasses.is_dataclass(options):
        return {}
    said: dict[str, str] = {}
    for kind in inspect.getmro(options)[::-1]:  # type: ignore[arg-type]
        said |= {name: text for name, (_, text) in entries(kind, "Attributes").items()}
    return {
        item.name: (item.default, said.get(item.name, ""))
        for item in dataclasses.fields(options)
        if item.name != "costs"
    }
