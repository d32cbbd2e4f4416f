"""``optipromp report``: one HTML file about a plan or a study, to be sent."""

from pathlib import Path

from optipromp.cli.command import Report, command
from optipromp.cli.console import waiting
from optipromp.core.errors import Code, InvalidRequestError


@command()
def report(
    item: Path,
    /,
    out: Path | None = None,
) -> Report:
    """Write one HTML file about a plan, a run or a study: no network, at most 5 MB.

    Of a plan: 3-D, pictures, metrics beside the paper's, settings, versions,
    the command; with outcome and film where 'simulate' left them there. Of a
    run: scene, outcome, film. Of a study: rates with intervals, causes, and
    the worst cases with pictures.
    3-D needs the extra 'view', pictures of worst cases the extra 'sim'.

    [bold]Examples[/bold]

    \b
    optipromp plan scenario-3 --out reach
    optipromp simulate reach --video
    optipromp report reach --out reach.html

    Args:
        item (PLAN_DIR|ROLLOUT_DIR|STUDY_DIR): What 'plan', 'simulate' or 'study' left at --out.
        out (FILE.html): Where the report goes; else beside what it tells.
    """
    from optipromp.core.files import is_file, is_folder, write_atomically
    from optipromp.laboratory.experiments.row_files import ROWS
    from optipromp.looks.reports import plan_report, run_report, study_report

    folder = item if is_folder(item) else item.parent
    path = out or folder / "report.html"
    if path.suffix.lower() != ".html":
        raise InvalidRequestError(f"--out is {str(path)!r}: its name must end in .html")
    with waiting("writing the report") as say:
        if is_file(folder / "plan.json"):
            content = plan_report(folder)
        elif is_file(folder / ROWS):
            content = study_report(folder, progress=say)
        elif is_file(folder / "rollout.npz"):
            content = run_report(folder)
        else:
            raise InvalidRequestError(
                f"{item} holds no plan (plan.json), no run (rollout.npz) and no study ({ROWS})"
            )
        write_atomically(path, content)
    size = len(content)
    document = {"status": Code.SUCCESS, "message": "", "file": str(path), "bytes": size}
    return Report(document, [f"wrote {path} ({size / 1e6:.1f} MB)"])
