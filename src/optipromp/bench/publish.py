"""The files of a release of results: submissions, what verified them, the table, their digests."""

import hashlib
import subprocess
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import optipromp
from optipromp.bench.results import RECORD, recorded, submission, zip_of
from optipromp.bench.table import leaderboard, markdown
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import check_folder, file_name, is_there, json_text, write_atomically
from optipromp.laboratory.experiments.runs import source_version

DIGESTS = "results.json"
"""Name of the small file of digests, which a repository can hold while the rest is a release's."""
SLOW = 10.0  # [s] for git to answer: a choice


def published(results: Iterable[Path], out: Path, unverified: bool = False) -> dict[str, Any]:
    """Gather submissions in a folder, each with its record of verification, and the table.

    ``results``: folders of runs, or submissions, of one set. ``out``: the folder, which is made;
    must be empty or new. ``unverified``: also take those that nobody verified.

    Returns: The content of ``results.json``: set, round, version, commit, and of each entry its
    files with their SHA-256.
    """
    paths = [zip_of(path) for path in results]
    board = leaderboard(paths)
    check_folder(out)
    if is_there(out) and any(out.iterdir()):
        raise InvalidRequestError(f"{out} holds something: name a new folder")
    files: dict[str, bytes] = {}
    entries: dict[str, Any] = {}
    for path in paths:
        run, _, _, sha256 = submission(path)
        by, name = recorded(path, sha256, run), file_name(run.entry)
        if by == "no" and not unverified:
            raise InvalidRequestError(
                f"{path} is not verified: run 'optipromp bench verify {path} --entry {run.entry}', "
                "or give --unverified"
            )
        if f"{name}.zip" in files:
            raise InvalidRequestError(f"two entries have the file name {name}.zip: rename one")
        files[f"{name}.zip"] = path.read_bytes()
        if by != "no":
            files[f"{name}{RECORD}"] = path.with_suffix(RECORD).read_bytes()
        entries[run.entry] = {"file": f"{name}.zip", "digest": run.digest, "verified": by}
    files["leaderboard.md"] = markdown(board).encode()
    files["leaderboard.json"] = json_text(board.to_dict()).encode()
    run = board.run
    common = {k: v for k, v in asdict(run).items() if k not in ("entry", "digest")}
    document = {
        **common, "commit": commit() if run.version == source_version() else "",
        "order": board.order, "entries": entries,
        "sha256": {name: hashlib.sha256(content).hexdigest() for name, content in files.items()},
    }  # fmt: skip
    out.mkdir(parents=True, exist_ok=True)
    for name, content in {**files, DIGESTS: json_text(document).encode()}.items():
        write_atomically(out / name, content)
    return document


def commit() -> str:
    """The commit of the library's source, with ``+`` where it was changed since; empty outside of a
    clone."""
    root = Path(optipromp.__file__).resolve().parents[2]
    if not is_there(root / ".git"):
        return ""
    try:
        told = subprocess.run(
            ["git", "-C", root, "describe", "--always", "--abbrev=40", "--dirty=+", "--exclude=*"],
            capture_output=True, text=True, timeout=SLOW, check=True,
        )  # fmt: skip
    except (OSError, subprocess.SubprocessError):
        return ""
    return told.stdout.strip()
