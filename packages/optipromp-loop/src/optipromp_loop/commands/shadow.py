"""``optipromp shadow``: a picker's recording, and what our planner would have done."""

import shlex
import sys
from pathlib import Path

import optipromp
from optipromp.cli.command import FAILED, OK, Report, command
from optipromp.cli.console import progress_bar, say_if_compiling, waiting
from optipromp.core.files import check_folder, write_atomically


@command()
def shadow(
    recording: Path,
    /,
    known: str,
    *,
    out: Path | None = None,
    gripper: str | None = None,
    marks: Path | None = None,
    role: list[str] | None = None,
    prefix: str = "",
    risk: float = 0.03,
) -> Report:
    """Read a recording of another picker, and say what our planner would have done, pick by pick.

    Nothing is moved. Of each pick: the harm that is predicted of the recorded motion and of ours to
    the end of the way out, where the tool paths differ, what we would have refused and why, and the
    times side by side. What was not recorded is said, and not assumed (docs/shadow.md).

    Examples:
        optipromp shadow shift.json --known cell.yaml --out shift.html
        optipromp shadow shift.mcap --known cell.yaml --gripper finger_joint

    Args:
        recording (RECORDING): A JSON or YAML file, or a bag of ROS 2 (needs optipromp-ros).
        known (SCENE): Robot, tool, approach and what stands still; its fruits are not used.
        out (FILE.html): Leave the page here.
        gripper (JOINT): Whose motion away from its first value closes the gripper.
        marks (FILE): In place of the gripper: {picks: [{closed: 4.2}]}, with start and end where
            they are known, in seconds of the recording.
        role (CLASS=ROLE[:stem]): Of a bag's detections, several times: target, pushable or avoid;
            by default ripe=target and unripe=pushable.
        prefix (PREFIX): Of a bag's joints and links, of one of several arms.
        risk: Share of promised successes that may be broken.
    """
    from optipromp_loop.shadow.compared import shadowed
    from optipromp_loop.shadow.page import shadow_page, summary, told_in_words
    from optipromp_loop.shadow.recording import load_recorded

    scene = optipromp.load_scene(known)
    if out is not None:
        check_folder(out.parent)
    bag = {"roles": role or [], "prefix": prefix}
    with waiting("reading the recording"):
        read = load_recorded(recording, scene, gripper=gripper, marks=marks, **bag)
    say_if_compiling()
    with progress_bar(20) as say:
        picks = shadowed(read, scene, risk=risk, progress=say)
    told = summary(picks)
    lines = [*told_in_words(told), f"Picks were cut {read.cut}."]
    lines += [f"Pick {one.number} is not judged: {one.why}." for one in picks if one.why]
    lines += [f"Not recorded: {words}." for words in read.lacks]
    if out is not None:
        asked = shlex.join(["optipromp", *sys.argv[1:]])
        write_atomically(out, shadow_page(recording.name, read, picks, asked))
        lines.append(f"wrote {out}")
    document = {
        "recording": str(recording), "cut": read.cut, "lacks": read.lacks, "risk": risk,
        "summary": told, "picks": [one.to_dict() for one in picks],
    }  # fmt: skip
    return Report(document, lines, OK if told["judged"] else FAILED)
