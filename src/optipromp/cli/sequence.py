"""``optipromp plan --targets``: several ripe fruits of one scene, one after the other."""

import math
from pathlib import Path
from typing import Any

from optipromp.cli.console import FAILED, OK, grid, print_json, stdout, waiting
from optipromp.cli.plan import write
from optipromp.files import file_name, json_text, write_atomically
from optipromp.scenes.scene import Scene

ORDER = "sequence.json"


def plan_targets(
    scene: Scene,
    targets: str,
    out: Path | None,
    rate: float,
    figures: bool,
    as_json: bool,
    request: dict[str, Any],
) -> int:
    """Plan the picks of ``targets`` (ids, separated by commas); ``request`` is of ``plan``."""
    from optipromp.planning.sequence import plan_sequence

    ids = [part.strip() for part in targets.split(",") if part.strip()]
    with waiting(f"planning {scene.name} ...") as say:
        found = plan_sequence(scene, ids, progress=say, **request)
    document = found.to_dict()
    homes = [file_name(f"{i + 1}-{id_}") for i, id_ in enumerate(found.order)]
    if out is not None:
        for home, pick, told in zip(homes, found.picks, document["picks"], strict=True):
            write(pick, out / home, figures, rate)
            told["out"] = str(out / home)
        write_atomically(out / ORDER, json_text(document).encode("utf-8"))
    if as_json:
        print_json(document)
    else:
        console = stdout()
        table = grid(("pick", "status"), ("not clean", "motion, s"))
        for id_, pick in zip(found.order, found.picks, strict=True):
            told = math.nan if pick.prediction is None else pick.prediction.probability
            failure = "–" if math.isnan(told) else f"{100.0 * told:.0f} %"
            table.add_row(id_, str(pick.status), failure, f"{pick.trajectory.duration:.2f}")
        for left in found.left:
            table.add_row(left.id, str(left.status), "–", "–")
        console.print(table)
        for left in found.left:
            console.print(f"{left.id} stays: {left.message}", markup=False)
        console.print(f"{len(found.picks)} of {len(ids)} planned")
        if out is not None:
            console.print(f"wrote {', '.join([*homes, ORDER])} to {out}", markup=False)
    return OK if found.success else FAILED
