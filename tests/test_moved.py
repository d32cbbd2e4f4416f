"""Names that stood in optipromp until 0.3.0 are refused, and the new names are told."""

import importlib.util
import re
import subprocess
import sys

import pytest

from optipromp.moved import NOW


@pytest.mark.parametrize("old", NOW)
def test_an_old_name_is_refused_with_the_new_one(old: str) -> None:
    new = NOW[old].replace("%", "optipromp")
    with pytest.raises(ImportError, match=f"^optipromp.{old} is now {new}$"):
        importlib.import_module(f"optipromp.{old}")
    assert all(importlib.util.find_spec(each) for each in re.split(", | or ", new))


def test_what_was_inside_an_old_name_is_refused() -> None:
    with pytest.raises(ImportError, match=r"^optipromp\.control is now optipromp_loop\.control$"):
        importlib.import_module("optipromp.control.controller")
    with pytest.raises(ImportError, match=r"^optipromp\.ros is now optipromp_ros$"):
        exec("from optipromp import ros")


def test_what_never_was_there_is_refused_as_ever() -> None:
    with pytest.raises(ModuleNotFoundError, match=r"No module named 'optipromp\.never'"):
        importlib.import_module("optipromp.never")


def test_without_a_package_its_commands_and_names_say_what_to_install() -> None:
    code = """
import sys
from importlib import metadata
metadata.entry_points = lambda **given: metadata.EntryPoints()  # nothing but optipromp is installed
try:
    from optipromp import simulate
except ImportError as error:
    print(error)
sys.argv = ["optipromp", "simulate", "scenario-3"]
from optipromp.cli.main import main
main()
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    words = "is of the package optipromp-sim: pip install "
    assert done.stdout.startswith(f"optipromp.simulate {words}")
    (line,) = done.stderr.splitlines()
    assert line.startswith(f"error INVALID_REQUEST: simulate {words}")
    assert "packages/optipromp-sim" in line
