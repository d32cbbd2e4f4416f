"""A run in words, and as one web page to turn and play."""

from typing import TYPE_CHECKING

import numpy as np

from optipromp.laboratory.simulation.moving import Moving
from optipromp.laboratory.simulation.world import build
from optipromp.looks.viewer.embed import FRAME_RATE, FRAMES, REST, recording

if TYPE_CHECKING:
    from optipromp.laboratory.simulation.execute import Run


def run_rows(run: "Run") -> list[tuple[str, str]]:
    """Names and values of what happened in a run, for tables."""
    rows, outcome = [], run.outcome
    if outcome.picked is not None:
        at = "" if outcome.swallowed_at is None else f" since {outcome.swallowed_at:.2f} s"
        rows.append(("target taken in", ("yes" if outcome.picked else "no") + at))
    if outcome.target_displacement is not None:
        rows.append(("target moved before", f"{1e3 * outcome.target_displacement:.1f} mm"))
    if outcome.placed is not None:
        at = "" if outcome.placed_off is None else f", {1e3 * outcome.placed_off:.1f} mm off"
        rows.append(("target placed", ("yes" if outcome.placed else "no") + at))
    for id_, force in outcome.peak_force.items():
        words = [f"at most {force:.2f} N"]
        if id_ in outcome.stem_tension:
            words.append(f"stem pulled {outcome.stem_tension[id_]:.2f} N")
        if outcome.stem_force.get(id_, 0.0) > 0.0:
            words.append(f"stem pressed {outcome.stem_force[id_]:.2f} N")
        words.append(f"moved {1e3 * outcome.displacement[id_]:.0f} mm")
        rows.append((id_, ", ".join(words)))
    for what, contacts in (
        ("static", outcome.static_contacts),
        ("cluster", outcome.avoid_contacts + outcome.tool_avoid_contacts),
    ):
        for c in contacts:
            spell = f"{c.peak_force:.2f} N for {c.duration:.2f} s from {c.first:.2f} s"
            rows.append((f"{c.link} on {c.other}", f"{spell} ({what})"))
    rows.append(("tracking error", f"{1e3 * outcome.tracking_error:.2f} mm"))
    speed = f"{run.real_time_factor:.1f} times as fast as it was"
    rows.append(("motion", f"{outcome.duration:.2f} s, simulated {speed}"))
    return rows


def run_page(run: "Run") -> str:
    """The HTML of a run: arm, fruits and stems as they moved."""
    moving = Moving(build(run.scene, run.robot, run.parameters, run.seed))
    times = run.rollout.times
    count = min(max(round(FRAME_RATE * float(times[-1])), 1), FRAMES)
    shown = np.unique(np.linspace(0, len(times) - 1, count + 1).round().astype(int))
    with recording(run.scene, run.robot) as (nodes, record):
        for row, after in zip(shown, [*shown[1:], shown[-1]], strict=True):
            nodes.pose(run.rollout.q[row])
            for moved in moving.at(run.rollout.states[row]):
                nodes.put(*moved)
            record.insert_sleep(float(times[after] - times[row]))
        record.insert_sleep(REST)
        return str(record.as_html())
