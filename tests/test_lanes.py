"""What the gate runs and holds: the reach of a change, and walls that only fall."""

import subprocess
import sys
from pathlib import Path

import pytest
from scripts import walls
from scripts.reach import ROOT, reach


def written(root: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text)


@pytest.fixture
def estate(tmp_path: Path) -> Path:
    """Three packages: eyes need the core, and the page needs the eyes by an import alone."""
    written(tmp_path, {
        "packages/core/pyproject.toml": '[project]\nname = "core"\n',
        "packages/core/src/core/__init__.py": "",
        "packages/core/tests/test_core.py": "from page import pages\n",
        "packages/eyes/pyproject.toml": '[project]\nname = "eyes"\ndependencies = ["core>=1"]\n',
        "packages/eyes/src/eyes/__init__.py": "",
        "packages/eyes/tests/test_eyes.py": "",
        "packages/page/pyproject.toml": '[project]\nname = "page"\n',
        "packages/page/src/page/__init__.py": "def f() -> None:\n    from eyes import look\n",
        "packages/page/tests/test_page.py": "",
        "tests/test_all.py": "",
        "conftest.py": "",
        "pyproject.toml": "",
    })  # fmt: skip
    return tmp_path


def test_a_change_reaches_what_imports_it_and_the_tests_that_use_that(estate: Path) -> None:
    told = reach(estate, ["packages/eyes/src/eyes/__init__.py"])
    assert (told.changed, told.reached) == ({"eyes"}, {"page"})
    assert told.full == {"packages/eyes/tests"}
    assert told.quick == {
        "packages/core/tests/test_core.py", "packages/page/tests", "tests/test_all.py"
    }  # fmt: skip


def test_a_package_that_takes_a_part_of_what_changed_is_reached_alone(estate: Path) -> None:
    gives = '[project]\nname = "page"\n[project.entry-points."optipromp.parts"]\nfilm = "page:f"\n'
    takes = 'from optipromp.parts import part\nf = part("film")\n'
    written(estate, {"packages/page/pyproject.toml": gives})
    written(estate, {"packages/core/src/core/__init__.py": takes})
    told = reach(estate, ["packages/page/src/page/__init__.py"])
    assert (told.changed, told.reached) == ({"page"}, {"core"})


def test_a_test_reaches_its_folder_and_what_is_shared_reaches_everything(estate: Path) -> None:
    assert reach(estate, ["packages/page/tests/test_page.py"]).full == {"packages/page/tests"}
    for file in ("constraints.txt", ".ci/run", "pyproject.toml", "conftest.py"):
        told = reach(estate, [file])
        assert told.why == file
        assert len(told.full) == 4
        assert not told.quick
        assert {"extras", "pythons", "real-ros"} <= told.steps
    assert reach(estate, [".ci/landed", "README.md"]).full == {"tests/test_all.py"}


def test_a_helper_reaches_the_tests_that_import_it() -> None:
    told = reach(ROOT, ["tests/ros/camera_messages.py", "scripts/walls.toml"])
    assert "packages/optipromp-ros/tests" in told.full
    assert "packages/optipromp-loop/tests" not in told.full
    loop = reach(ROOT, ["packages/optipromp-loop/src/optipromp_loop/lerobot.py"])
    assert loop.steps == {"real-franka", "real-lerobot"}
    assert "packages/optipromp-bench/tests" in loop.quick


def test_a_number_above_its_wall_is_red_and_one_below_is_told(estate, monkeypatch, capsys):
    names = " = ".join(f"self.a{k}" for k in range(16))
    text = f"class Large:\n    def set(self) -> None:\n        {names} = 0\n"
    needs = '[project]\nname = "page"\ndependencies = ["eyes"]\n'
    files = {"packages/core/src/core/__init__.py": text, "packages/page/pyproject.toml": needs}
    written(estate, files | {"docs/reading.md": ""})
    monkeypatch.setattr(walls, "ROOT", estate)
    monkeypatch.setattr(walls, "READING", estate / "docs/reading.md")
    monkeypatch.setattr(walls, "WALLS", estate / "walls.toml")
    monkeypatch.setattr(sys, "argv", ["walls.py"])

    def told(core: int, large: str) -> tuple[int, str]:
        walls.WALLS.write_text(
            f"[lines]\ncore = {core}\neyes = 0\npage = 2\nworkspace = 0\n"
            f'[closure.large]\nstart = "core:Large"\nlines = 3\nfiles = 1\n[attributes]\n{large}',
            "utf-8",
        )
        return walls.main(), capsys.readouterr().out

    assert told(4, "Large = 16")[0] == 0
    assert "lower it by 5" in told(9, "Large = 16")[1]
    code, words = told(3, "")
    assert code == 1
    assert "lines core is 4, 1 above its wall of 3\n" in words
    assert "attributes Large is 16: at most 15\n" in words


def test_a_wall_that_rises_or_goes_is_red(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def git(*words: str) -> str:
        author = "-c", "user.name=a", "-c", "user.email=a@b"
        return subprocess.run(
            ("git", "-C", str(tmp_path), *author, *words),
            check=True,
            capture_output=True,
            text=True,
        ).stdout

    monkeypatch.setattr(walls, "ROOT", tmp_path)
    monkeypatch.setattr(walls, "WALLS", tmp_path / "walls.toml")
    plan = {"start": "a:b", "lines": 9, "files": 2}
    lines, guard = {"core": 10, "loop": 10}, {"Guard": 20}
    landed = {"lines": lines, "closure": {"plan": plan}, "attributes": guard}
    walls.WALLS.write_text(walls.written(landed), "utf-8")
    for words in (("init", "-q"), ("add", "."), ("commit", "-qm", "walls")):
        git(*words)
    written(tmp_path, {".ci/landed": f"# the commit\n{git('rev-parse', 'HEAD')}"})
    assert not walls.raised(landed, str(tmp_path))
    assert not walls.raised({**landed, "lines": {"core": 9, "loop": 10, "eyes": 5}}, str(tmp_path))
    assert not walls.raised({**landed, "lines": {"core": 8, "loop": 12}}, str(tmp_path))  # moved
    (line,) = walls.raised({**landed, "lines": {"core": 11, "loop": 10}}, str(tmp_path))
    assert "lines core is 11" in line
    (line,) = walls.raised({**landed, "attributes": {"Guard": 20, "Eyes": 16}}, str(tmp_path))
    assert "attributes Eyes is 16" in line
    assert len(walls.raised({**landed, "closure": {}}, str(tmp_path))) == 2
