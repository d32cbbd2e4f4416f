"""What the whole suite needs set before its modules are imported.

A worker among others computes in one thread: further threads would wait for theirs. Hypothesis
draws anew at every local run; CI draws the same, so that a run can be repeated. MuJoCo decides how
it renders when it is first imported, by whichever test: off screen. Typer reads TERMINAL_WIDTH when
it first prints, by whichever test, and keeps it: a test that wants a width sets COLUMNS alone. A
background job ignores Ctrl-C, and so would the programs that tests start and interrupt.
"""

import functools
import os
import re
import shutil
import signal
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

settings.register_profile("ci", derandomize=True)
if os.environ.get("CI"):
    settings.load_profile("ci")
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
if sys.platform.startswith("linux"):
    os.environ.setdefault("MUJOCO_GL", "egl")
os.environ.pop("TERMINAL_WIDTH", None)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

LONG = {
    "bench": "apart benchmark entries env episodes inspection learnt rounds",
    "control": "controller driver many_detections servo tracker tracks",
    "cli": (
        "commands crops folder generate_study markup plan process refused scenarios "
        "simulate simulate_closed_loop"
    ),
    "execution": "executor franka streaming streaming_trouble trouble",
    "experiments": "baselines cluster eyes loops own_scenes study tables variations",
    "fuzzing": "doors",
    "geometry": "grids",
    "judging": "against_coal_and_mujoco crowds planted",
    "looks": "looks",
    "perception": "bounds calibration doubts network other_crops seeing spheroids teaching watcher",
    "page": "first_sight loop_replay page sources teaching words",
    "planning": (
        "approaches cutting follow goals legs many moving moving_neighbours options paper "
        "paper_in_two_dimensions paper_settings prediction regions requests risk static_margin "
        "underway verdict ways"
    ),
    "promp": "tasks",
    "pushing": "cup hanging long_fruits quasi_static",
    "reports": "reports",
    "robots": (
        "arm arm_named fit kinematics_against_pinocchio mjcf pairs panda_cover "
        "refusals spheres untrusted xacro"
    ),
    "ros": "bags loop pictures recordings",
    "ros/real": "real_nodes",
    "scenes": "generate placing trusses wild",
    "simulation": (
        "covers crops disturbances export grasps hand live_camera loop loop_film physics "
        "pictures rich runs second_engine tools trusses"
    ),
    ".": "benchmarks_suite coco fit_eyes kernel_cache page_commands plan_folders",
    "viewer": "figures",
}
"""Test files that take more than 3 s, by folder; ``pytest -m quick`` leaves them out."""

FLAGS = (
    "--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
)  # fmt: skip


IMPORTED = re.compile(
    r"^ *(?:from|import) (optipromp_\w+|tests\.[\w.]+)(?:\.\w+)*(?: import (\w+))?", re.M
)


@functools.cache
def lacking(file: Path) -> frozenset[str]:
    """Absent packages of the project that a file needs, by modules of ``tests`` too."""
    out = set[str]()
    for name, member in IMPORTED.findall(file.read_text("utf-8")):
        if name.startswith("tests."):
            path = Path(__file__).parent / name.replace(".", "/")
            shared = (path.with_suffix(".py"), path / f"{member}.py")
            out |= {one for each in shared if each.is_file() for one in lacking(each)}
        elif find_spec(name) is None:
            out.add(name.replace("_", "-"))
    return frozenset(out)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Which packages of the project are absent."""
    names = (path.name for path in (Path(__file__).parent / "packages").iterdir())
    if absent := sorted(name for name in names if find_spec(name.replace("-", "_")) is None):
        told = f"LEFT OUT: test files that need {', '.join(absent)}, which are not installed"
        terminalreporter.write_line(told)


def pytest_sessionstart(session: pytest.Session) -> None:
    """With ``-n``, kernels that no cache has are compiled once, before the workers begin."""
    if session.config.getoption("numprocesses", None):
        from optipromp.cli.console import say_if_compiling

        say_if_compiling()


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With ``-n``, a file's tests run in one worker, which makes what they share once."""
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # the order of pytest_collection_modifyitems
    return LoadFileScheduling(config, log) if config.getvalue("dist") == "load" else None


def is_long(file: Path) -> bool:
    """Whether a test file is among those of ``LONG``."""
    room = file.parent.as_posix().rpartition("/tests")[2].strip("/") or "."
    return file.stem.removeprefix("test_") in LONG.get(room, "").split()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """With ``-m quick`` the long files are not even imported.

    A package can be tested alone: files that need another one, which is absent, are left out.
    """
    if config.option.markexpr == "quick" and is_long(collection_path):
        return True
    if re.fullmatch(r"test_\w+\.py", collection_path.name) and lacking(collection_path):
        return True
    return None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of all files but the long ones as quick; workers begin with the long ones."""
    for item in items:
        if not is_long(item.path) and not item.get_closest_marker("slow"):
            item.add_marker(pytest.mark.quick)
    if "PYTEST_XDIST_WORKER" in os.environ:  # so that none is left to one worker at the end
        items.sort(key=lambda item: item.get_closest_marker("quick") is not None)


@pytest.fixture(scope="module", autouse=True)
def _no_entry_stays() -> Iterator[None]:
    """While a process of an entry is there, orphans of other processes are children of this one."""
    yield
    if (serve := sys.modules.get("optipromp_bench.serve")) is not None:
        serve.dismissed()


@pytest.fixture(scope="session")
def chromium() -> Iterator[Any]:
    """A browser that draws without a graphics card."""
    path = shutil.which("chromium") or shutil.which("chromium-browser")
    if path is None:
        pytest.skip("no chromium: apt-get install chromium")
    api = pytest.importorskip("playwright.sync_api")
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=path, args=list(FLAGS))
        yield browser
        browser.close()
