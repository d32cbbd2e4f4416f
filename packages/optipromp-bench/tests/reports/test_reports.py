"""Reports, read as a browser would: nothing outside the file, and the figures of what it tells."""

import io
import json
import re
import time
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.cli.fixtures import completed, refused

from optipromp.core.errors import InvalidRequestError
from optipromp.core.output import write_plan
from optipromp.core.planning import plan
from optipromp.core.robots.library import NOTHING, Choice
from optipromp.core.scenes import load_scene, save_scene
from optipromp.looks.reports import LARGEST_FILE, plan_report
from optipromp_bench.experiments.reports import study_report, worst_of
from optipromp_bench.experiments.rows import Row
from optipromp_bench.experiments.study import Study, run_study
from optipromp_sim.simulation import simulate
from optipromp_sim.simulation.files import write_run


class Read(HTMLParser):
    """Texts, addresses and tags of a page; what stands in frames is not entered."""

    def __init__(self, content: bytes) -> None:
        super().__init__()
        self.texts: list[str] = []
        self.addresses: list[str] = []
        self.frames: list[str] = []
        self.open: list[str] = []
        self.feed(content.decode("utf-8"))

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.addresses += [values[name] for name in ("src", "href", "data") if name in values]
        if tag == "iframe":
            assert values["sandbox"] == "allow-scripts"
            self.frames.append(values["srcdoc"])
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(self.texts)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("plan")
    made = plan("scenario-4")
    write_plan(made, out)
    write_run(simulate(made), out, {"run.webm": b"film" * 1000})
    return out


def test_the_report_of_a_plan_holds_all_that_it_tells(folder: Path) -> None:
    content = plan_report(folder)
    assert len(content) < LARGEST_FILE
    found = Read(content)
    assert not found.open
    assert found.addresses
    assert all(address.startswith("data:") for address in found.addresses)
    assert not re.search(r"""(?:src|href)=["']https?:""", "".join(found.frames))
    for words in (
        "scenario-4: opti-promp", "success", "clearance, static", "Beside the paper", "+35.2 mm",
        "optipromp plan scenario-4 --planner opti-promp --reach --seed 0 --out",
        "numpy", "picked, nothing harmed", "gauss_newton",
    ):  # fmt: skip
        assert words in found.text.replace("gauss-newton", "gauss_newton"), words
    kinds = [address.split(";")[0] for address in found.addresses]
    assert kinds.count("data:image/png") == 2
    assert kinds.count("data:video/webm") == 1


def test_a_film_that_is_too_large_is_left_out(folder: Path, tmp_path: Path) -> None:
    for path in folder.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / "run.mp4").write_bytes(bytes(4_000_000))  # newer than the other
    content = plan_report(tmp_path)
    assert len(content) < LARGEST_FILE
    assert "data:video/" not in content.decode("utf-8")


def test_a_failed_plan_has_a_report_that_says_why(tmp_path: Path) -> None:
    made = plan("scenario-1")
    assert not made.success
    write_plan(made, tmp_path)
    found = Read(plan_report(tmp_path / "plan.json"))
    assert str(made.status) in found.text
    assert made.message in found.text
    assert "Beside the paper" not in found.text


def test_names_are_text_not_markup(tmp_path: Path) -> None:
    scene = replace(load_scene("scenario-4"), name="<b>row & 1</b>")
    write_plan(plan(scene, planner="promp"), tmp_path)
    content = plan_report(tmp_path)
    assert "<b>row & 1</b>: promp" in Read(content).text
    assert b"<b>" not in content


@pytest.fixture(scope="module")
def studied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("study")
    run_study(Study(("cluster",), ("promp", "opti-promp"), (7, 9)), out, workers=1)
    return out


def test_the_report_of_a_study_has_rates_causes_and_worst_cases(studied: Path) -> None:
    said: list[str] = []
    content = study_report(studied, worst=1, progress=said.append)
    found = Read(content)
    assert len(content) < LARGEST_FILE
    assert all(address.startswith("data:image/") for address in found.addresses)
    for words in ("Study of 4 runs", "promised and picked", "Worst cases", "seeds=7:9", "promp"):
        assert words in found.text
    assert "risk=" not in found.text
    assert len(said) == 1
    assert said[0].startswith("drawing cluster, seed ")


def test_the_report_of_a_study_tells_its_risk(studied: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_bytes((studied / "rows.csv").read_bytes())
    settings = json.loads((studied / "study.json").read_text())
    (tmp_path / "study.json").write_text(json.dumps({**settings, "risk": 0.01}))
    assert "risk=0.01" in Read(study_report(tmp_path, worst=0)).text
    (tmp_path / "study.json").write_text(json.dumps({**settings, "risk": "little"}))
    with pytest.raises(InvalidRequestError, match="risk is 'little'"):
        study_report(tmp_path, worst=0)


def test_the_report_of_own_scenes_has_pictures_and_words(tmp_path: Path) -> None:
    """It had no picture of the worst, and printed Python's words of its settings."""
    for name in ("scenario-3", "scenario-4"):
        save_scene(load_scene(name), tmp_path / "crop" / f"{name}.yaml")
    chosen = Study.of_files(sorted((tmp_path / "crop").iterdir()), planners=("promp",))
    rows = run_study(chosen, tmp_path / "out", workers=1)
    assert not all(row.success for row in rows)

    def pictures() -> int:
        found = Read(study_report(tmp_path / "out", worst=2))
        for words in ("{", "None", "False", "Choice", "()"):
            assert words not in found.text.rpartition("Settings")[2]
        assert "scenario-3.yaml, scenario-4.yaml" in found.text
        return len(found.addresses) - 1

    assert pictures() == len(worst_of(rows, 2))
    (tmp_path / "crop" / "scenario-3.yaml").write_text("format: 1\n")  # another scene by now
    (tmp_path / "crop" / "scenario-4.yaml").unlink()
    assert pictures() == 0


def test_the_report_of_a_rollout_alone(folder: Path, tmp_path: Path) -> None:
    """``view`` took the folder of ``simulate --out``, ``report`` refused it."""
    for name in ("rollout.npz", "outcome.json", "run.webm"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    completed("report", tmp_path)
    found = Read((tmp_path / "report.html").read_bytes())
    for words in ("scenario-4: executed", "picked, nothing harmed", "tracking error", "--seed 0"):
        assert words in found.text
    kinds = [address.split(";")[0] for address in found.addresses]
    assert kinds == ["data:video/webm"]
    assert len(found.frames) == 1
    (tmp_path / "outcome.json").write_text("{}")
    assert "scene_file" in refused("report", tmp_path)


def test_worst_cases_take_causes_in_turn_and_broken_promises_first() -> None:
    row = Row("cluster", 1, planner="opti-promp", plan_status="success")
    rows = [
        replace(row, seed=1, success=True),
        replace(row, seed=2, cause="crushed", unripe_force=11.0, plan_status="HARM_PREDICTED"),
        replace(row, seed=3, cause="crushed", unripe_force=12.0),
        replace(row, seed=4, cause="crushed", unripe_force=20.0),
        replace(row, seed=5, cause="torn", unripe_force=1.0),
        replace(row, seed=6, cause="no_plan"),
    ]
    assert [found.seed for found in worst_of(rows, 10)] == [4, 5, 3, 2]
    assert [found.seed for found in worst_of(rows, 2)] == [4, 5]


def test_the_command_writes_the_file_and_refuses_other_folders(
    folder: Path, studied: Path, tmp_path: Path
) -> None:
    for item, name in ((folder, "plan.html"), (studied, "study.html")):
        completed("report", item, "--out", tmp_path / name)
        assert (tmp_path / name).read_bytes().startswith(b"<!doctype html>")
    assert refused("report", tmp_path)
    assert refused("report", folder, "--out", tmp_path / "a.pdf")
    (tmp_path / "rows.csv").write_text("preset\n")
    with pytest.raises(InvalidRequestError, match="no rows"):
        study_report(tmp_path)
    np.testing.assert_array_equal(sorted(p.suffix for p in tmp_path.iterdir()),
                                  [".csv", ".html", ".html"])  # fmt: skip


def test_a_study_of_another_robot_is_told_of_with_that_robot(studied: Path, tmp_path: Path) -> None:
    (tmp_path / "rows.csv").write_bytes((studied / "rows.csv").read_bytes())
    for robot, words in (
        (f"gone.urdf {NOTHING}", "--robot gone.urdf"),
        (f"gone.urdf {Choice(tip='hand')}", "--robot ROBOT"),
    ):
        (tmp_path / "study.json").write_text(json.dumps({"robot": robot}))
        found = Read(study_report(tmp_path, worst=1))
        assert words in found.text
        assert len(found.addresses) == 1  # no picture of a run with another robot


PATIENCE = 90.0  # [s] without a graphics card


def test_a_report_opens_offline_and_its_view_moves(chromium: Any, tmp_path: Path) -> None:
    image = pytest.importorskip("PIL.Image")
    write_plan(plan("scenario-1", planner="i-promp"), tmp_path)
    (tmp_path / "report.html").write_bytes(plan_report(tmp_path))
    context = chromium.new_context(viewport={"width": 400, "height": 800}, offline=True)
    page = context.new_page()
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    wrong: list[str] = []
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto((tmp_path / "report.html").as_uri())
    canvas = page.frame_locator("iframe").locator("canvas").first

    def shot() -> np.ndarray:
        content = image.open(io.BytesIO(canvas.screenshot(timeout=1e3 * PATIENCE)))
        return np.asarray(content.convert("RGB"), dtype=int)

    first, end = shot(), time.monotonic() + PATIENCE
    while np.abs(shot() - first).max(axis=2).mean() < 1.0:
        assert time.monotonic() < end, "nothing moves in the 3-D view"
        time.sleep(0.5)
    colours = shot().reshape(-1, 3)
    assert ((colours[:, 0] > 2 * colours[:, 1]) & (colours[:, 0] > 90)).sum() > 5  # ripe
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    assert all(url.startswith(("file:", "data:", "blob:", "about:")) for url in asked)
    assert not wrong
    context.close()
