"""``optipromp generate``: random scenes that an arm could solve."""

import os
import shlex
from collections import Counter
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optipromp.cli.command import Report, Shown, command
from optipromp.cli.console import Preset
from optipromp.cli.robot import ArmOptions, Named, Whose
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import ALLOW_XACRO, FOLDERS, check_folder, check_inside, is_folder

if TYPE_CHECKING:
    from optipromp.core.scenes.scene import Scene

SEEN = "seen"


@command()
def generate(
    preset: Annotated[
        Preset,
        typer.Option(
            help="cluster: 1-4 fruits before the ripe one; side-clusters: and neighbours; "
            "table-top: and a gutter; mixed: all of these; tight: fruits that nearly touch; limp: "
            "plumb stems; elongated: long fruits; truss: fruits on one truss; field: fruits, stems "
            "and trusses of all kinds; shelf: cans and boxes; wild: as in pictures of plantations."
        ),
    ],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the scene files go.")],
    seed: Annotated[
        int, typer.Option(min=0, help="Of the first scene; each next has one more.")
    ] = 0,
    count: Annotated[int, typer.Option(min=1, help="How many scenes.")] = 1,
    noise: Annotated[
        str,
        typer.Option(
            metavar="NAME",
            help="Write the scenes as a detector sees them, too, into DIR/seen: zero-mean, low, "
            "high, missed or detector, as of 'study'.",
        ),
    ] = "",
    *,
    robot: Whose = None,
    arm: ArmOptions,
) -> Report:
    """Sample random scenes and write them as scene files.

    The same seed gives the same scene. Another robot than the Panda has its base placed so that it
    reaches the scenes, and a cup with a neck as long as its wrist asks for. Scenes that are
    impossible (objects inside one another) or that no arm could solve (target out of reach or
    inside the gutter, every goal configuration in collision) are sampled again; how many, and why,
    is printed.

    [bold]Examples[/bold]

    \b
    optipromp generate --preset mixed --seed 100 --count 20 --out scenes
    optipromp generate --preset cluster --robot ur5.urdf --tip tool0 --count 20 --out ur5-scenes
    optipromp plan scenes --out plans
    optipromp simulate plans/mixed-100
    optipromp generate --preset tight --noise detector --out tight
    optipromp plan tight/seen --out plans
    optipromp simulate plans/tight-0 --in tight/tight-0.yaml
    """
    from optipromp.core.scenes.io import save_scene
    from optipromp.core.scenes.values import suggest
    from optipromp.laboratory.generate import NOISES, PANDA, generate_with_report

    if noise and noise not in NOISES:
        raise InvalidRequestError(f"noise is {noise!r}: {suggest(noise, NOISES)}")
    check_folder(out / SEEN if noise else out)
    named = arm.of(robot)
    documents: list[dict[str, Any]] = []
    reasons: Counter[str] = Counter()
    for number in range(seed, seed + count):
        scene, report = generate_with_report(preset, number, named.name or PANDA, named.choice)
        if named.name is not None:
            _judge_start(scene)
        save_scene(scene, path := out / f"{scene.name}.yaml")
        reasons.update(report.reasons)
        documents.append({
            "file": str(path), "seed": number, "pushables": len(scene.pushables),
            "redraws": report.redraws, "reasons": report.reasons,
            **(_seen(scene, number, noise, out) if noise else {}),
        })  # fmt: skip
    redraws = reasons.total()
    unread = _unread(named, out)
    why = "".join(f", {number} {reason}" for reason, number in reasons.most_common())
    lines = [f"wrote {count} scene{'s' * (count != 1)} to {out}", f"sampled again: {redraws}{why}"]
    if noise:
        missed = sum(len(document["missed"]) for document in documents)
        lines.append(f"wrote as seen to {out / SEEN}; fruits missed: {missed}")
    document = {"preset": preset, "redraws": redraws, "scenes": documents, "folders": unread}
    return Report(document, chain(lines, _to_allow(unread, robot)))


def _to_allow(folders: list[str], robot: str | None) -> Shown:
    """The environment variables that let the scenes read their robot, as lines to be copied."""
    from rich.text import Text

    from optipromp.readers.packages import is_xacro

    because = {
        FOLDERS: "the robot lies elsewhere, where scenes may read nothing unless you allow it",
        ALLOW_XACRO: "the robot is a xacro, which scenes may not run unless you allow it",
    }
    allowed = {FOLDERS: os.pathsep.join(folders)} if folders else {}
    if robot is not None and Path(robot).suffix and is_xacro(Path(robot)):
        allowed[ALLOW_XACRO] = "1"
    for name, value in allowed.items():
        line = f"{because[name]}: export {name}={shlex.quote(value)}"
        yield Text(line, no_wrap=True)


def _judge_start(scene: "Scene") -> None:
    """Refuse a scene whose start is in collision, by the judge of plans.

    A start that the arm cannot hold against gravity gives a warning.
    """
    from optipromp.core import judging
    from optipromp.core.planning.task import posed
    from optipromp.core.robots.model import warn_of_gravity

    robot, state = posed(scene)
    touching = judging.touching(scene, robot, state.q)
    if touching:
        told = "; ".join(map(str, touching))
        raise InvalidRequestError(f"{scene.name}: the robot has no free start: {told}")
    warn_of_gravity(robot, state.q[None], scene.up, f"at the start of {scene.name}")


def _unread(named: Named, out: Path) -> list[str]:
    """The folders of the robot's files that scenes in ``out`` may not read."""
    if named.name is None or not Path(named.name).suffix:
        return []
    from optipromp.core.robots.library import files_of

    lacking = set[Path]()
    for file in files_of(named.name, named.choice):
        try:
            check_inside(file, out, InvalidRequestError)
        except InvalidRequestError:
            lacking.add(file.resolve() if is_folder(file) else file.resolve().parent)
    return [str(each) for each in sorted(lacking) if not lacking & set(each.parents)]


def _seen(scene: "Scene", seed: int, noise: str, out: Path) -> dict[str, Any]:
    """Write the scene as detected; returns its path and the ids of the fruits not seen."""
    from optipromp.core.scenes.io import save_scene
    from optipromp.laboratory.generate import NOISES, noisy

    seen, file = noisy(scene, seed, NOISES[noise]), out / SEEN / f"{scene.name}.yaml"
    save_scene(seen, file)
    ids = {item.id for item in seen.objects}
    return {"seen": str(file), "missed": [i.id for i in scene.objects if i.id not in ids]}
