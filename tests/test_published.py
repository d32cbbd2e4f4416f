"""The page of figures is what the result files give; a result is stale where behaviour differs."""

import re
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest
from scripts import plan_hashes, publish

from optipromp_bench.experiments.rows import source_version

ROOT = Path(__file__).resolve().parents[1]
BOOK = publish.book_of(ROOT)
PAGE = "docs/figures.md"


def test_the_page_its_pictures_and_the_readme_are_what_the_results_give() -> None:
    assert publish.differences(ROOT, BOOK) == []
    made = publish.made(ROOT, BOOK)
    assert max(map(len, made.values())) < 60_000
    for row in (row for row in BOOK["result"] if publish.kept(ROOT, row["name"])):
        assert f"\n## {row['title']}\n" in made[PAGE]
        assert f"Version `{publish.kept(ROOT, row['name'])['version']}`" in made[PAGE]


def test_other_pages_link_to_figures_and_repeat_none() -> None:
    sections = re.findall(r"^## (.+)$", (ROOT / PAGE).read_text("utf-8"), re.MULTILINE)
    rows = set(re.findall(r"^\|.*\d.*\|$", (ROOT / PAGE).read_text("utf-8"), re.MULTILINE))
    anchors = {name.lower().replace(" ", "-") for name in sections}
    for page in {*(ROOT / "docs").glob("**/*.md"), ROOT / "README.md"} - {ROOT / PAGE}:
        text = page.read_text("utf-8")
        assert set(re.findall(r"figures\.md#([\w-]+)", text)) <= anchors, page
        assert not rows & set(text.splitlines()), page


def test_each_result_has_a_row_and_seeds_that_no_number_was_set_on() -> None:
    names = [row["name"] for row in BOOK["result"]]
    assert {path.stem for path in (ROOT / "docs/results").glob("*.json")} <= set(names)
    assert len(names) == len(set(names)) <= 15
    for row in BOOK["result"]:
        if "frozen" not in row:
            assert set(row["kinds"]) <= plan_hashes.KINDS.keys()
            words = " ".join(row["commands"])
            files = re.findall(r"scripts/studies/\S+", words)
            words += "".join((ROOT / file).read_text("utf-8") for file in files)
            for first in re.findall(r"(?:--(?:seeds|first|seed) |seeds = \[)(\d+)", words):
                assert 600_000 <= int(first) < 620_000, row["name"]


HOUSE = """
[[result]]
name = "first"
title = "Counts"
about = "What was counted."
kinds = ["plans"]
commands = ['''python -c 'open("a.txt")' ''', '''WORD=7 python {out}/../../../../words.py''']
scenes = "one"
minutes = 60
draw = {label = ["preset"], by = "loop", ratios = {time = "by ours"}}
readme = {open = "Counted"}
"""
WORDS = """
import os, pathlib, time
try:
    pathlib.Path("began").touch()
    time.sleep(float(open("a.txt").read()))
except KeyboardInterrupt:
    pathlib.Path("ended").touch()
    raise
print("### Counts")
print("| preset | loop | clean % (95 %) | harmed % (95 %) | time |\\n|---|---|---|---|---|")
print("| `a` | open | 60 (50–70) | 0 (0–4) | 0.5 × |")
print(f"| `b` | open | 2{os.environ['WORD']} (9–40) | 5 (1–9) | |")
"""


@pytest.fixture
def house(tmp_path: Path) -> Path:
    for folder in ("scripts", "docs", f"build/publish/{source_version()}"):
        (tmp_path / folder).mkdir(parents=True)
    (tmp_path / "scripts/publish.toml").write_text(HOUSE)
    (tmp_path / "words.py").write_text(WORDS)
    (tmp_path / "README.md").write_text("<!-- promised -->\n<!-- end -->\n")
    (tmp_path / f"build/publish/{source_version()}/digest.json").write_text('{"plans": "now"}')
    return tmp_path


def test_a_run_goes_on_after_a_failure_and_its_result_is_shown(house, capsys):
    assert publish.main(["--run", "--minutes", "0"], house) == 0
    assert "first: command 1 of 2 was not begun" in capsys.readouterr().out
    assert publish.main(["--run"], house) == 1  # there is no a.txt
    assert re.search("first: command 1 ended with 1: FileNotFound", capsys.readouterr().out)
    (house / "a.txt").write_text("0")
    assert publish.main(["--run"], house) == 0
    assert publish.main(["--check"], house) == 1  # it is shown nowhere
    assert publish.main(["--page"], house) == 0
    assert publish.main(["--check"], house) == 0
    assert "| `b` | open | 27 (9–40) | 5 (1–9) | |" in (house / PAGE).read_text()
    assert (
        "| `a` 60 (50–70) | `b` 27 (9–40) | 0 (0–4); 5 (1–9) |" in (house / "README.md").read_text()
    )
    svg = (house / "docs/images/figures-first.svg").read_text()
    assert ElementTree.fromstring(svg).get("width") == "356"  # as a phone of 390 shows it
    shares = re.findall(r'M(\S+) \S+H(\S+)" .*\n?.*cx="(\S+)"', svg)
    assert [(float(at) - float(low)) / (float(high) - float(low)) for low, high, at in shares] == (
        pytest.approx([10 / 20, 18 / 31, 0, 4 / 8], abs=0.01)
    )
    ticks = re.findall(r'd="M(\S+) \S+V', svg)[-5:]
    ((x, wide),) = re.findall(r'<rect x="(\S+)" .* width="(\S+)" height="8"', svg)
    assert (x, f"{float(x) + float(wide):.1f}") == (ticks[0], ticks[2])  # from 0.5 to 1
    then = (house / "docs/results/first.json").read_text().replace("60 (50", "75 (70")
    (house / "docs/results/before").mkdir()
    (house / "docs/results/before/first.json").write_text(then)
    publish.main(["--page"], house)
    assert "| Counts: clean, % | a, open | 75 (70–70) | 60 (50–70) |" in (house / PAGE).read_text()
    assert ">a, open<" in (house / "docs/images/figures-before.svg").read_text()
    (house / PAGE).write_text((house / PAGE).read_text().replace("27 (9", "28 (9"))
    capsys.readouterr()
    assert publish.main(["--check"], house) == 1
    assert capsys.readouterr().out.startswith("docs/figures.md has other figures")


def test_a_result_is_stale_where_its_kind_behaves_otherwise(house, capsys):
    (row,) = publish.book_of(house)["result"]

    def why(found: dict[str, object], **more: str) -> str:
        found = found and {key: row[key] for key in ("commands", "scenes")} | found
        return publish.why_stale(row | more, found, "new", lambda: {"plans": "now", "loops": "x"})

    assert why({}) == "no result"
    assert why({"version": "old"}) == "of old, without a digest"
    assert why({"version": "new"}) == ""
    assert why({"version": "new"}, scenes="two") == "of new, with other scenes"
    assert why({"version": "old", "digest": {"plans": "now", "loops": "y"}}) == ""
    assert why({"version": "old", "digest": {"plans": "then"}}) == "of old, other plans"
    assert why({"version": "old"}, frozen="it is known") == ""
    assert publish.main(["--check"], house) == 1
    assert "first: no result" in capsys.readouterr().out
    publish.main([], house)
    assert "stale: 1.0 hours of one core" in capsys.readouterr().out
    with pytest.raises(SystemExit, match="third is no result: choose from first"):
        publish.main(["--run", "third"], house)


def test_an_interrupted_run_ends_what_runs(house: Path) -> None:
    (house / "a.txt").write_text("600")
    code = "import pathlib, sys; from scripts import publish; "
    code += "sys.exit(publish.main(['--run'], pathlib.Path(sys.argv[1])))"
    run = subprocess.Popen([sys.executable, "-c", code, house], cwd=ROOT)
    late = time.monotonic() + 120.0
    while not (house / "began").exists() and time.monotonic() < late and run.poll() is None:
        time.sleep(0.05)
    run.send_signal(signal.SIGTERM)
    assert run.wait(60.0) == 130
    assert (house / "ended").exists()
    assert not (house / "docs/results").exists()
