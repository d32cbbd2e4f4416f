"""The page of a shadowed recording: what a manager reads first, then pick by pick."""

import math
from collections.abc import Sequence
from dataclasses import replace
from html import escape
from statistics import median
from typing import TYPE_CHECKING, Any

import numpy as np

from optipromp.core.files import plain
from optipromp.core.planning import Picked
from optipromp.core.trajectory import Trajectory
from optipromp.looks import reports
from optipromp.looks.viewer.figures import png
from optipromp.looks.viewer.reach import reach_figure
from optipromp.looks.viewer.sentences import complaint, sentences
from optipromp.looks.viewer.words import seconds
from optipromp_loop.shadow.compared import Shadowed, push_of
from optipromp_loop.shadow.recording import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

CAPTION = "The recorded tool path, and our planner's reach"
DPI = 70  # of a picture: some 80 kB each
MOST = 50  # picks that have a picture: the page has some 4 MB


def summary(picks: Sequence[Shadowed]) -> dict[str, Any]:
    """The figures that a manager reads; medians of times [s] are of the picks that both try.

    ``avoided``: picks of which harm is predicted as they were done, and none as ours would be.
    ``unclean``: the sum of the probabilities that a pick is not clean, of those that both try.
    """
    judged = [one for one in picks if one.theirs is not None]
    both = [(one, one.theirs, one.tried) for one in judged if one.theirs and one.tried]
    chances = np.array([(a.failure, b.failure) for _, a, b in both]).reshape(-1, 2)
    times = [[*one.seconds.ravel(), b.reach.time["total"]] for one, _, b in both]
    known = [[t for t in row if not math.isnan(t)] for row in zip(*times, strict=True)]
    middle = [median(row) if row else math.nan for row in known or [[]] * 5]
    return dict(plain({
        "picks": len(picks), "judged": len(judged), "refused": len(judged) - len(both),
        "harmful": sum(one.harmful for one in judged),
        "avoided": sum(one.harmful for one, *_ in both),
        "unclean": dict(zip(("recorded", "ours"), np.nansum(chances, axis=0), strict=True)),
        "seconds": {"recorded": middle[:2], "ours": middle[2:4], "planning": middle[4]},
    }))  # fmt: skip


def told_in_words(told: dict[str, Any]) -> list[str]:
    """The summary in sentences."""
    harmed, avoided = told["harmful"], told["avoided"]
    return [
        f"Picks that were recorded: {told['picks']}; that are judged: {told['judged']}.",
        f"Picks with predicted harm, as they were done: {harmed}. Of these our planner would have "
        f"done {avoided} without predicted harm, and not have tried {harmed - avoided}.",
        f"All picks that our planner would not have tried: {told['refused']}.",
    ]


def shadow_page(name: str, recording: Recording, picks: Sequence[Shadowed], command: str) -> bytes:
    """The HTML file of a recording of a ``name`` and its picks, as a ``command`` made it.

    Of more than ``MOST`` picks those have a picture that harm, then those that we refuse.
    """
    told, title = summary(picks), f"{name}: what our planner would have done"
    times = told["seconds"]
    rows = [
        ("picks with predicted harm", f"{told['harmful']}", "0"),
        ("picks not tried", "0", f"{told['refused']}"),
        ("picks expected not to be clean, of those that both try",
         *(f"{chance:.1f}" for chance in told["unclean"].values())),
        ("reach + way out, median", _times(times["recorded"]), _times(times["ours"])),
        ("planning, median", "", seconds(t) if (t := times["planning"]) else "–"),
    ]  # fmt: skip
    lacks = [("not recorded", words) for words in recording.lacks]
    read = [("picks were cut", recording.cut), ("looks", str(len(recording.looks))), *lacks]
    order = sorted(picks, key=lambda one: (not one.harmful, one.tried is not None))
    pictured = [one.number for one in order[:MOST]]
    parts = [
        f"<h1>{escape(title)}</h1>",
        *(reports.paragraph(words, "status") for words in told_in_words(told)),
        reports.table(rows, ("", "recorded", "our planner")),
        reports.paragraph(
            "Nothing was moved. Harm is predicted on what was seen before each pick began, by one "
            "push model for both motions, to the end of the way out.", "faint"),
        reports.section("Picks", reports.table(map(_row, picks), HEAD)),
        reports.section("What was read", reports.table(read)),
        *(_section(one, one.number in pictured) for one in picks),
        reports.made_with(command, {}),
    ]  # fmt: skip
    return reports.page(title, parts)


HEAD = "pick, at", "recorded; reach + way out", "our planner", "paths apart"


def _times(values: Sequence[float | None]) -> str:
    """Times [s] one after the other, on one line; – for one that is not known."""
    known = ("–" if t is None or math.isnan(t) else f"{t:.1f} s" for t in values)
    return " + ".join(known).replace(" ", "\N{NO-BREAK SPACE}")


def _row(one: Shadowed) -> tuple[str, ...]:
    first = f"{one.number}, {_times([one.closed])}"
    if one.theirs is None:
        return first, f"not judged: {one.why}"
    recorded, ours = map(_times, one.seconds.tolist())
    tried = "would not try" if one.tried is None else f"{_harm(one.tried)}; {ours}"
    apart = "–" if math.isnan(one.apart) else f"{1e3 * one.apart:.0f} mm"
    return first, f"{_harm(one.theirs)}; {recorded}", tried, apart


def _harm(made: Picked) -> str:
    push = push_of(made)
    if push is None:
        return "nothing is pushed"
    what = f"{push.object} {push.cause}" if push.harmful else "no harm"
    return f"{what}, {100 * made.failure:.0f} % not clean"


def _section(one: Shadowed, pictured: bool) -> str:
    """The reasons and the picture of a pick; of one that is not judged nothing."""
    if one.theirs is None or one.ours is None:
        return ""
    ours = "our planner would not try it", complaint(one.ours)
    if one.tried is not None:
        ours = "our planner", " ".join(sentences(one.tried, {}))
    rows = [("recorded", complaint(one.theirs) or "No harm is predicted."), ours]
    rows += [("not recorded", words) for words in one.notes]
    drawn = reports.picture(png(paths_figure(one), DPI), CAPTION) if pictured else ""
    return reports.section(f"Pick {one.number}", reports.table(rows), drawn)


def paths_figure(one: Shadowed) -> "Figure":
    """Our planner's reach of a pick, and the tool path of the recorded one; that one alone, where
    we have none."""
    assert one.theirs is not None
    made = one.ours if isinstance(one.ours, Picked) else one.theirs
    curve = one.theirs.reach.trajectory
    times = np.linspace(0.0, curve.duration, made.reach.trajectory.n_waypoints)
    beside = Trajectory(times, *curve.sample(times), curve.joint_names)
    both = replace(made.reach, initial=beside, followed=beside, via=())
    return reach_figure(both, {"conditioned ProMP": "recorded", "optimised": "our planner"})
