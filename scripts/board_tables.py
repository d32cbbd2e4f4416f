"""The tables of submissions of one set, of what ``optipromp bench run`` left in folders.

    python scripts/board_tables.py FOLDER ENTRY ...

Each entry has its submission in a folder of ``FOLDER``. A table stands under its heading.
"""

import sys
from collections.abc import Sequence
from pathlib import Path

from optipromp_bench import table as board_of
from optipromp_bench.experiments.statistics import tabled
from optipromp_bench.results import submission, zip_of


def board(folder: Path, entries: Sequence[str]) -> str:
    """Of the submission of each entry."""
    lost = {entry: torn(folder / entry) for entry in entries}
    heads = ["entry", *(f"{engine}: torn" for engine in lost[entries[0]])]
    rows = [[f"`{entry}`", *counts.values()] for entry, counts in lost.items()]
    told = board_told(board_of.leaderboard(folder / entry for entry in entries))
    return told + tabled(
        f"Torn or pulled too hard: `{entries[0]}` and those beside it", heads, rows
    )


def board_told(found: board_of.Leaderboard) -> str:
    """The tables of ``optipromp bench table`` under headings."""
    run = found.run
    where = f"Track `{run.track}`, condition `{run.condition}`"
    _, whole, _, presets = board_of.markdown(found).strip().split("\n\n")
    first = f"### {where}: {run.scenes.count} scenes of each preset\n\n{whole}\n"
    return f"{first}\n### {where}: clean, harmed by preset, %\n\n{presets}\n\n"


def torn(folder: Path) -> dict[str, int]:
    """How many runs of an entry tore a fruit or pulled it too hard, by engine."""
    run, rows, *_ = submission(zip_of(folder))
    causes = [(r.engine, r.cause) for r in rows if r.result == "harmed"]
    return {
        engine: sum(of == engine and ("torn" in why or "pulled" in why) for of, why in causes)
        for engine in run.engines
    }


def main() -> None:
    """See the module."""
    match sys.argv[1:]:
        case [folder, *entries] if entries:
            print(board(Path(folder), entries))
        case _:
            sys.exit(str(__doc__))


if __name__ == "__main__":
    main()
