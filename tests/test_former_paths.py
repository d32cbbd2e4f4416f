"""Modules are found by the paths that they had before the rings, and say where they are now."""

import importlib
import subprocess
import sys
import warnings

import pytest

import optipromp
from optipromp._moved import MOVED


def imported(name: str) -> tuple[object, list[str]]:
    """A module, and what its import warns of."""
    sys.modules.pop(name, None)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        module = importlib.import_module(name)
    return module, [str(one.message) for one in told if one.category is DeprecationWarning]


@pytest.mark.parametrize(("former", "present"), MOVED.items())
def test_a_former_path_gives_the_module_and_a_warning(former: str, present: str) -> None:
    module, told = imported(former)
    wanted = importlib.import_module(present)
    assert module is wanted
    assert wanted.__spec__ is not None
    assert wanted.__spec__.name == present
    assert told[-1] == f"{former} is {present} now; the former path goes with the next release"


def test_what_is_in_a_room_is_the_same_by_both_paths() -> None:
    former, _ = imported("optipromp.planning.options")
    assert former.PlanOptions is optipromp.PlanOptions  # type: ignore[attr-defined]


def test_a_module_that_never_was_is_not_found() -> None:
    for name in ("optipromp.planning.nothing", "optipromp.nothing"):
        with pytest.raises(ModuleNotFoundError, match="nothing"):
            imported(name)


def test_the_warning_names_the_line_that_imports() -> None:
    code = "import optipromp\n\nfrom optipromp.trajectory import Trajectory"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stderr.startswith("<string>:3: DeprecationWarning: optipromp.trajectory is ")
