"""Tables that compare with the paper: a command makes them, a page holds what it makes."""

import re
from pathlib import Path

from optipromp.cli.scenarios import BEGIN, END, _shown, markdown, renew
from optipromp.laboratory.experiments.scenarios import CASES, ScenarioRow

Rows = tuple[ScenarioRow, ...]
PAGE = Path(__file__).resolve().parents[2] / "docs" / "paper.md"
NUMBER = re.compile(r"[-+]?\d+(\.\d+)?(e[-+]\d+)?(?![\w-])")


def tables(page: str) -> str:
    return page.split(BEGIN)[1].split(END)[0].strip()


def structure(text: str) -> list[str]:
    """The tables with a sign in place of each number of ours; how many are swallowed may differ."""
    lines = [NUMBER.sub("#", line) for line in text.strip().splitlines()]
    return [line.replace("n# and n# are swallowed", "n# is swallowed") for line in lines]


def test_the_page_holds_the_tables_that_the_command_makes(
    scenario_rows: Rows,
) -> None:
    """Header, cases, statuses, which tests of the paper hold, causes; the numbers may differ."""
    kept, made = tables(PAGE.read_text(encoding="utf-8")), markdown(scenario_rows)
    assert structure(kept) == structure(made)
    firsts = [line.split(" | ")[0].strip("| ") for line in kept.splitlines()[2:]]
    assert firsts[: len(CASES)] == [case.key for case in CASES]


def test_the_paper_s_figures_are_those_of_the_cases(scenario_rows: Rows) -> None:
    """The first number of a cell is the paper's, in millimetres."""
    lines = {
        line.split(" | ")[0].strip("| "): line
        for line in markdown(scenario_rows).splitlines()[2:14]
    }
    for case in CASES:
        cells = lines[case.key].split(" | ")
        told = [cells[column].split(" / ")[0] for column in (2, 4, 5)]
        paper = case.published
        wanted = ["–"] * 3
        if paper is not None:
            wanted = [str(round(1e3 * x)) for x in (paper.M_c, paper.M_p["n1"], paper.M_p["n2"])]
        assert told == wanted


def test_the_command_says_why_our_falls_are_not_the_paper_s(
    scenario_rows: Rows,
) -> None:
    """The note stands under the falls, and what it names is there."""
    note = str(list(_shown(scenario_rows, None))[2])
    assert note.startswith("why our falls are not the paper's")
    root = PAGE.parents[1]
    named = re.findall(r"(?:scripts|docs)/\w+\.\w+", note)
    assert len(named) == 2
    assert all((root / name).is_file() for name in named)
    assert "paper_falls.py" in PAGE.read_text(encoding="utf-8")


def test_a_page_keeps_what_is_beside_its_marks(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(f"before\n{BEGIN}\nold\n{END}\nafter\n", encoding="utf-8")
    renew(page, "new")
    assert page.read_text(encoding="utf-8") == f"before\n{BEGIN}\n\nnew\n{END}\nafter\n"
    plain = tmp_path / "plain.md"
    renew(plain, "new")
    assert plain.read_text(encoding="utf-8") == "new"
