"""What the camera of a closed loop saw, as an inset beside the replay."""

import math

from optipromp.laboratory.simulation.loop_files import LoopRecord
from optipromp.looks.viewer.drawn import GREEN, RED

RECENT = 0.5  # [s] age of a look above which nothing is drawn: the camera is blocked, a choice
_SIDE = 200  # [pixel] of the inset


def sight(record: LoopRecord, now: float) -> str:
    """The last look until ``now`` [s] as HTML: its cone of view with the detections in it.

    The picture is the camera's, its x axis to the right. Targets are red, other fruits green.
    """
    found = record.sight(now)
    if found is None:
        return ""
    age, view, discs = found
    wide = math.tan(0.5 * view)
    circles = "".join(
        f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{r:.4f}" fill="none" stroke-width="{0.015 * wide}" '
        f'stroke="{RED if target else GREEN}"/>'
        for x, y, r, target in (discs.tolist() if age <= RECENT else ())
    )
    words = f"the camera, {1e3 * age:.0f} ms ago" if age <= RECENT else "the camera sees nothing"
    return (
        f'<figure class="sight" style="margin:0.5em 1em;font-size:0.8em"><svg width="{_SIDE}" '
        f'height="{_SIDE}" viewBox="{-wide} {-wide} {2 * wide} {2 * wide}">'
        f'<circle r="{wide}" fill="#f1f3f5"/>{circles}</svg>'
        f"<figcaption>{words}</figcaption></figure>"
    )
