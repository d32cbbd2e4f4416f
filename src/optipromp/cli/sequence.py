"""``optipromp plan --targets``: several ripe fruits of one scene, one after the other."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

from optipromp.cli.command import FAILED, OK, Report, Shown
from optipromp.cli.console import grid, waiting
from optipromp.cli.plan import Output, Request
from optipromp.core.files import file_name, json_text, write_atomically
from optipromp.core.scenes.scene import Scene

if TYPE_CHECKING:
    from optipromp.core.planning.sequence import PickSequence

ORDER = "sequence.json"


def plan_targets(
    scene: Scene, targets: str, request: Request, output: Output, progress: bool | None = None
) -> Report:
    """Plan the picks of ``targets`` (ids, separated by commas), and write each plan."""
    from optipromp.core.planning.legs import Picked
    from optipromp.core.planning.sequence import plan_sequence

    ids = [part.strip() for part in targets.split(",") if part.strip()]
    with waiting(f"planning {scene.name}", progress) as say:
        found = plan_sequence(scene, ids, progress=say, **vars(request))
    document, out = found.to_dict(), output.out
    written = []
    if out is not None:
        homes = [file_name(f"{i + 1}-{id_}") for i, id_ in enumerate(found.order)]
        homes += [file_name(f"left-{left.id}") for left in found.left]
        made = [*found.whole, *(left.made for left in found.left)]
        tolds = [*document["picks"], *document["left"]]
        for home, pick, told in zip(homes, made, tolds, strict=True):
            if isinstance(pick, Picked):
                output.write_legs(pick, out / home, figures=False)
            else:
                output.write(pick, out / home)
            told["out"] = str(out / home)
        write_atomically(out / ORDER, json_text(document).encode("utf-8"))
        written = [f"wrote {', '.join([*homes, ORDER])} to {out}"]
    lines = [
        *(f"{left.id} stays: {left.message}" for left in found.left),
        f"{len(found.picks)} of {len(ids)} planned",
        *written,
    ]
    return Report(document, _shown(found, lines), OK if found.success else FAILED)


def _shown(found: "PickSequence", lines: Sequence[str]) -> Shown:
    table = grid(("pick", "status"), ("not clean", "motion, s"))
    durations = [one.duration for one in found.placed]
    durations = durations or [one.trajectory.duration for one in found.picks]
    for id_, pick, seconds in zip(found.order, found.picks, durations, strict=True):
        told = math.nan if pick.prediction is None else pick.prediction.probability
        failure = "–" if math.isnan(told) else f"{100.0 * told:.0f} %"
        table.add_row(id_, str(pick.status), failure, f"{seconds:.2f}")
    for left in found.left:
        table.add_row(left.id, str(left.status), "–", "–")
    yield table
    yield from lines
