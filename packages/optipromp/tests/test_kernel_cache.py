"""The cache of compiled kernels: whole or made again, private or not used."""

import os
import sys
from pathlib import Path

import pytest
from tests.cli.fixtures import ran

import optipromp
from optipromp.core.compiled import is_private

PROGRAM = """
import sys, warnings
warnings.simplefilter("always")
from optipromp.core.compiled import CACHED, in_cache, kernel

@kernel
def twice(x):
    return 2.0 * x

print(CACHED, in_cache(twice), twice(3.0), sum(twice.stats.cache_hits.values()))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return path


def run(program: Path, cache: Path, **limits: str) -> tuple[list[str], str]:
    source = str(Path(optipromp.__file__).parents[1])
    environment = os.environ | {"NUMBA_CACHE_DIR": str(cache), "PYTHONPATH": source} | limits
    done = ran([sys.executable, str(program)], env=environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.split(), done.stderr


def test_a_damaged_cache_is_noticed_and_made_again(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    assert run(program, cache)[0] == ["True", "False", "6.0", "0"]
    assert run(program, cache)[0] == ["True", "True", "6.0", "1"]
    (data,) = cache.rglob("program.twice*.nbc")
    good = data.read_bytes()
    for content in (good[:900] + b"\xff" + good[901:], b""):
        data.write_bytes(content)
        assert run(program, cache)[0][2:] == ["6.0", "0"]
    (index,) = cache.rglob("program.twice*.nbi")
    index.write_bytes(index.read_bytes()[:-20])
    assert run(program, cache)[0][1:] == ["False", "6.0", "0"]


def test_a_cache_is_of_what_a_kernel_is_made_of(program: Path, tmp_path: Path) -> None:
    """Not of its file's time: what the kernel calls and reads stands in another file."""
    other, cache = tmp_path / "other.py", tmp_path / "cache"
    calls = PROGRAM.replace("2.0 * x", "other.scaled(x)")
    scaled = "from optipromp.core.compiled import inner\n\n@inner\ndef scaled(x):\n"

    def ran(before: str, size: float, body: str) -> list[str]:
        program.write_text(f"import other\n{before}{calls}")
        other.write_text(f"{scaled}    return {body}\n\nSIZE = {size}\n")
        moved = {"NUMBA_CACHE_DIR": "", "OPTIPROMP_CACHE": str(cache)}
        return run(program, cache, PYTHONDONTWRITEBYTECODE="1", **moved)[0]

    assert ran("", 2.0, "SIZE * x") == ["True", "False", "6.0", "0"]
    assert ran("# further down\n", 2.0, "SIZE * x") == ["True", "True", "6.0", "1"]
    assert ran("", 4.0, "SIZE * x") == ["True", "False", "12.0", "0"]
    assert ran("", 4.0, "SIZE + x") == ["True", "False", "7.0", "0"]
    assert list((cache / "kernels").rglob("program.twice*.nbi"))


def test_a_cache_that_names_a_module_of_another_version_is_made_again(program, tmp_path):
    kinds = tmp_path / "kinds"
    kinds.mkdir()
    (kinds / "__init__.py").write_text("from kinds.before import Pair")
    before = kinds / "before.py"
    before.write_text("from typing import NamedTuple\n\nclass Pair(NamedTuple):\n    x: float\n")
    text = "from kinds import Pair\n" + PROGRAM.replace("2.0 * x", "2.0 * x.x")
    program.write_text(text.replace("twice(3.0)", "twice(Pair(3.0))"))
    cache = tmp_path / "cache"
    assert run(program, cache)[0] == ["True", "False", "6.0", "0"]
    before.rename(kinds / "after.py")
    (kinds / "__init__.py").write_text("from kinds.after import Pair")
    assert run(program, cache)[0] == ["True", "False", "6.0", "0"]
    assert run(program, cache)[0] == ["True", "True", "6.0", "1"]


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="owners of POSIX")
def test_a_folder_that_others_can_write_in_is_not_used(program: Path, tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    cache.mkdir()
    assert is_private(cache)
    assert is_private(cache / "none")
    cache.chmod(0o777)
    assert not is_private(cache)
    assert not is_private(cache / "below")
    said, warned = run(program, cache)
    assert said == ["False", "False", "6.0", "0"]
    assert "others can write in" in warned
    assert not list(cache.rglob("*.nb?"))


@pytest.mark.skipif(not Path("/proc/none").parent.exists(), reason="a place nobody can write in")
def test_without_a_folder_kernels_are_compiled_in_memory(program: Path) -> None:
    said, warned = run(program, Path("/proc/none"), HOME="/proc/none", XDG_CACHE_HOME="/proc/none")
    assert said[2:] == ["6.0", "0"]
    assert said[0] == "True" or "compiled in memory" in warned
