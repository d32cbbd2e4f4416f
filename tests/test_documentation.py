"""What the documentation shows runs, and the reference shows what the packages export."""

import importlib
import json
import re
import runpy
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import pytest

import optipromp
from optipromp.core.errors import Code
from optipromp.core.planning import PlanOptions
from optipromp.core.pushing.parameters import DETECTED, KNOWN, PACKS
from optipromp.core.scenes import load_scene
from optipromp_sim.simulation import SimulationParameters
from optipromp_sim.simulation.outcome import Cause

ROOT = Path(__file__).resolve().parents[1]
PUBLIC = (
    "optipromp", "optipromp.core.geometry", "optipromp.core.scenes", "optipromp.core.robots",
    "optipromp.core.promp", "optipromp.core.pushing", "optipromp.core.optimization.costs",
    "optipromp.core.planning", "optipromp_ros", "optipromp.core.execution",
    "optipromp_loop.control",
    "optipromp_sim.simulation", "optipromp_eyes", "optipromp.timing",
)  # fmt: skip
UNSHOWN = {  # aliases and constants, and kernels that no user calls
    "DriftRule", "Message", "PLANNERS", "Role", "Shape",
    "__version__", "near", "signed_distance",
}  # fmt: skip


@pytest.mark.parametrize(
    "page",
    ["README.md", "docs/index.md", "docs/add-a-robot.md", "docs/closed-loop.md", "docs/extend.md",
     "docs/new-user.md", "docs/real-robot.md", "docs/ros.md", "docs/scene-format.md"],
)  # fmt: skip
def test_the_python_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / page).read_text(), re.DOTALL)
    names: dict[str, object] = {}
    for block in blocks:
        if "FloatArray" not in block:  # a part of a file of the library
            exec(compile(block, page, "exec"), names)
    if "result" in names:
        assert names["result"].success  # type: ignore[attr-defined]


def test_the_scenes_that_are_shown_are_scenes(tmp_path: Path) -> None:
    texts = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs/scene-format.md").read_text(), re.S)
    names = []
    for text in texts:
        (tmp_path / "shown.yaml").write_text(text)
        names.append(load_scene(tmp_path / "shown.yaml").name)
    assert names == [
        "table-top",
        "row-7",
        "free-space",
        "full-cup",
        "seam",
        "punnet-in-hand",
        "conveyor",
    ]


@pytest.mark.parametrize("package", PUBLIC)
def test_the_reference_shows_what_a_package_exports(package: str) -> None:
    pages = "\n".join(page.read_text() for page in (ROOT / "docs/reference").glob("*.md"))
    shown = {path.rpartition(".")[2] for path in re.findall(r"^::: (\S+)$", pages, re.M)}
    module = importlib.import_module(package)
    exported = set(getattr(module, "__all__", ())) or {
        name for name in dir(module)
        if not (name.startswith("_") or isinstance(getattr(module, name), ModuleType))
    }  # fmt: skip
    assert all(hasattr(module, name) for name in exported)
    assert exported - UNSHOWN <= shown


def test_importing_the_package_loads_nothing_heavy() -> None:
    code = "import sys, optipromp; print({'numpy', 'numba', 'scipy', 'yaml'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"
    assert {"plan", "plan_many", "plan_sequence", "judge", "simulate"} <= set(dir(optipromp))


def test_the_page_on_the_closed_loop_lists_every_number() -> None:
    page = runpy.run_path(str(ROOT / "scripts/parameters.py"))["loop_page"]
    text = (ROOT / "docs/closed-loop.md").read_text(encoding="utf-8")
    assert text.count("| `loop.period` | 0.02 | s |") == 1
    assert page(text) == text, "run scripts/parameters.py"


def test_every_test_that_the_page_on_robustness_names_is_there() -> None:
    page = (ROOT / "docs/robustness.md").read_text(encoding="utf-8")
    named = re.findall(r"`(optipromp-\w+/tests/)?([\w/]+\.py)::(\w+)`", page)
    assert len(named) > 60
    for at, file, test in named:
        assert f"\ndef {test}(" in (ROOT / f"packages/{at or 'optipromp/tests/'}{file}").read_text()


def test_what_the_page_on_reading_says_to_start_at_is_defined_there() -> None:
    page = (ROOT / "docs/reading.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \d+ \| `(core/[\w/]+\.py)` \|.*\| (`.*`) \|$", page, re.MULTILINE)
    assert len(rows) > 15
    for file, names in rows:
        text = (ROOT / "packages/optipromp/src/optipromp" / file).read_text("utf-8")
        for name in re.findall(r"\w+", names):
            assert re.search(rf"^ *(?:class|def) {name}\b", text, re.MULTILINE), (file, name)


def test_the_page_on_concepts_has_the_largest_harm_of_each_risk() -> None:
    text = (ROOT / "docs/concepts.md").read_text("utf-8")
    tables = KNOWN, DETECTED, PACKS
    for k, risk in enumerate(KNOWN.risk):
        shown = " | ".join(f"{table.threshold[k]:g}" for table in tables)
        assert f"| {risk:g} | {shown} |" in text
    glossary = (ROOT / "docs/glossary.md").read_text("utf-8")
    known, detected, packs = (table.allowed(PlanOptions.risk) for table in tables)
    told = (
        f"{known:g} past known fruits, {detected:g} past detected fruits, and {packs:g} among packs"
    )
    assert told in " ".join(glossary.split())


def test_every_message_of_the_page_on_troubleshooting_is_one_of_ours() -> None:
    source = "\n".join(path.read_text("utf-8") for path in (ROOT / "packages").rglob("src/**/*.py"))
    page = (ROOT / "docs/troubleshooting.md").read_text("utf-8")
    named = re.findall(r"^\| `([^`]+)` \|", page, re.MULTILINE)
    causes = {str(cause).replace("_", " ") for cause in Cause}
    assert len(named) > 35
    assert [words for words in named if words not in source and words not in causes] == []
    assert {str(code) for code in Code if "PLAN" in code or "COLLISION" in code} <= set(named)
    most = SimulationParameters().thresholds
    assert f"more than {most.stem_force:g} N for longer than {most.stem_time:g} s" in page
    assert f"A fruit was pressed by more than {most.fruit_force:g} N" in page
    assert f"Something solid was pressed by more than {most.static_force:g} N" in page
    assert f"more than {1e3 * most.tracking_error:g} mm off its path" in page


@pytest.mark.parametrize("name", ["my_crop", "my_loop", "my_policy", "my_recording", "my_robot"])
def test_a_notebook_and_its_page_are_those_of_its_script(name: str) -> None:
    script = runpy.run_path(str(ROOT / "scripts/notebooks.py"))
    found = script["cells"]((ROOT / f"examples/notebooks/{name}.py").read_text("utf-8"))
    notebook = json.loads((ROOT / f"examples/notebooks/{name}.ipynb").read_text("utf-8"))
    assert [cell["source"] for cell in notebook["cells"]] == [cell.text for cell in found]
    page = (ROOT / f"docs/notebooks/{name}.md").read_text("utf-8")
    for cell, kept in zip(found, notebook["cells"], strict=True):
        assert cell.text in page, "run scripts/notebooks.py"
        said = "".join(out.get("text", "") for out in kept.get("outputs", ()))
        assert said.rstrip() in page


def test_a_cell_shows_its_last_expression_and_what_it_prints() -> None:
    script = runpy.run_path(str(ROOT / "scripts/notebooks.py"))
    first, second = script["cells"]('"""No cell."""\n# %% [markdown]\n# Text\n#\n# more\n'
                                    "# %%\nprint(1)\n2 + a\n# %%\nassert a\n")  # fmt: skip
    assert (first.text, first.code) == ("Text\n\nmore", False)
    assert script["run"](second, {"a": 3}).said == "1\n5\n"


def test_the_page_on_commands_lists_every_command() -> None:
    page = (ROOT / "docs/commands.md").read_text("utf-8")
    shown = subprocess.run(
        [sys.executable, "-m", "optipromp", "--help"], capture_output=True, text=True, check=True
    ).stdout
    names = re.findall(r"^│ ([a-z]+(?:-[a-z]+)*) +[A-Z]", shown, re.MULTILINE)
    assert {"plan", "ros-node", "bench"} <= set(names)
    assert [name for name in names if f"`optipromp {name}" not in page] == []


def test_a_short_navigation_leads_to_every_page_and_a_picture_has_its_command() -> None:
    entries = re.findall(r"[\w/-]+\.md", (ROOT / "mkdocs.yml").read_text("utf-8"))
    assert 10 < len(entries) <= 25
    ahead = [ROOT / "docs" / page for page in entries]
    for page in ahead:  # the pages that it links come after it
        text = page.read_text("utf-8")
        links = re.findall(r"\]\(([\w./-]+\.md)", text)
        ahead += {(page.parent / link).resolve() for link in links} - set(ahead)
        assert "![" not in text or re.search(r"`(?:optipromp|python) [^`]+`", text), page
    assert set(ahead) == set((ROOT / "docs").rglob("*.md"))


def test_the_gallery_has_a_command_under_each_of_a_dozen_pictures() -> None:
    found = runpy.run_path(str(ROOT / "scripts/gallery.py"))["entries"]()
    assert len(found) >= 12
    pictures = re.findall(r"!\[[^\]]*\]\((images/[^)]+)\)", (ROOT / "docs/gallery.md").read_text())
    assert [f"images/{shown.name}" for shown, _, _ in found] == pictures
    for shown, made, commands in found:
        assert shown.is_file()
        folder = made.partition("/")[0]
        assert folder in commands or made.startswith("http"), shown


def test_nothing_tells_to_install_this_package_from_an_index() -> None:
    """It is on none, so such a command would install a stranger, or nothing."""
    wrong = re.compile(r"pip install [^\n]*?(?<![\w/.-])optipromp\b(?!\.)")
    assert wrong.search("run pip install -q 'optipromp[sim]'")
    pages = ["README.md", "CONTRIBUTING.md", "pyproject.toml"]
    for folder, kind in (("packages", "py"), ("docs", "md"), ("examples", "py"), ("scripts", "py")):
        pages += [str(path.relative_to(ROOT)) for path in (ROOT / folder).rglob(f"*.{kind}")]
    assert len(pages) > 250
    texts = {page: (ROOT / page).read_text(encoding="utf-8") for page in pages}
    assert [page for page, text in texts.items() if wrong.search(text)] == []
