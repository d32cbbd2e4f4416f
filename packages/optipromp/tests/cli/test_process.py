"""The command as a process: imports, exit codes, signals."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest
from tests.cli.fixtures import RUN, ran


@pytest.mark.parametrize("arguments", [["--help"], ["plan", "--help"], ["--version"]])
def test_help_imports_nothing_heavy(arguments: list[str]) -> None:
    code = (
        "import sys\n"
        "from optipromp.cli.main import main\n"
        f"sys.argv[1:] = {arguments!r}\n"
        "try:\n    main()\n"
        "except SystemExit as end:\n    assert not end.code, end.code\n"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'yaml'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    done = ran([sys.executable, "-c", code])
    assert done.returncode == 0, done.stderr


def test_wrong_input_has_no_traceback() -> None:
    done = ran([*RUN, "plan", "nowhere"])
    assert done.returncode == 2
    assert done.stderr.startswith("error INVALID_SCENE: ")
    assert done.stderr.count("\n") == 1


def test_a_closed_pipe_is_no_crash() -> None:
    done = ran(f"{sys.executable} -m optipromp list --json | true")
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_an_interrupted_run_leaves_nothing_half_written(tmp_path: Path) -> None:
    out = tmp_path / "out"
    process = subprocess.Popen(
        [*RUN, "scenarios", "--out", str(out)], stderr=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60
    while not out.exists() and time.monotonic() < deadline:  # its first sign of life
        time.sleep(0.05)
    time.sleep(0.2)
    process.send_signal(signal.SIGTERM)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 143
    assert "Traceback" not in stderr
    assert not [path for path in out.rglob("*") if path.name.startswith(".")]


IN_A_CALLBACK = """
import ctypes, os, signal, time
from optipromp.cli import main as cli

@ctypes.CFUNCTYPE(None)
def callback():
    os.kill(os.getpid(), signal.{name})
    time.sleep(0.1)  # the exception is raised here, and C passes it on to nobody

def command():
    callback()
    time.sleep(30.0)

cli.app = command
cli.main()
"""


@pytest.mark.parametrize(("name", "code"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_lost_in_a_callback_from_c_still_ends_the_process(name: str, code: int) -> None:
    program = IN_A_CALLBACK.format(name=name)
    done = ran([sys.executable, "-c", program], timeout=20)
    assert done.returncode == code
    assert "Traceback" not in done.stderr


INTERRUPTED = """
import os, signal, sys, time
from optipromp.cli import main as cli

def command():
    sys.path.insert(0, {folder!r})
    {act}
    time.sleep(30.0)

cli.app = command
cli.main()
"""


@pytest.mark.parametrize(
    "act",
    [
        "import half",  # packages from C fail or crash of an exception on their way
        "exec('os.kill(os.getpid(), signal.SIGINT)')",  # CPython takes such a one for unhandled
    ],
)
def test_ctrl_c_ends_with_130_wherever_it_comes(act: str, tmp_path: Path) -> None:
    module = """
        import os, signal, sys
        try:
            os.kill(os.getpid(), signal.SIGINT)
            print("whole")
        except KeyboardInterrupt:
            raise ImportError("initialization failed")
    """
    (tmp_path / "half.py").write_text(textwrap.dedent(module))
    program = INTERRUPTED.format(folder=str(tmp_path), act=act)
    done = ran([sys.executable, "-c", program], timeout=20)
    assert done.returncode == 130
    assert done.stderr == "interrupted; nothing half-written was left\n"
    assert done.stdout == ("whole\n" if "half" in act else "")


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX")
def test_a_signal_that_is_ignored_stays_ignored(tmp_path: Path) -> None:
    act = "os.kill(os.getpid(), signal.SIGINT); raise SystemExit(0)"
    (tmp_path / "ignored.py").write_text(INTERRUPTED.format(folder=str(tmp_path), act=act))
    command = f"trap '' INT; {sys.executable} {tmp_path / 'ignored.py'}"
    done = ran(command, timeout=20)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_full_disk_behind_standard_output_is_told_in_a_line() -> None:
    with Path("/dev/full").open("w") as full:
        done = subprocess.run([*RUN, "list"], stdout=full, stderr=subprocess.PIPE, text=True)
    assert done.returncode == 2
    assert done.stderr == (
        "error INVALID_REQUEST: cannot write standard output: No space left on device\n"
    )


@pytest.mark.skipif(sys.platform == "win32", reason="a shell of POSIX")
def test_a_closed_standard_output_is_no_crash() -> None:
    command = f"{sys.executable} -m optipromp list >&-"
    done = ran(command)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_terminal_without_utf_8_gets_letters_it_has() -> None:
    environment = os.environ | {"PYTHONIOENCODING": "latin-1"}
    for arguments in (["list"], ["list", "--json"]):
        done = subprocess.run([*RUN, *arguments], env=environment, capture_output=True)
        assert done.returncode == 0, done.stderr
        text = done.stdout.decode("latin-1")
    assert json.loads(text)["robots"]


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits of Linux")
def test_too_little_memory_is_told_and_not_waited_in() -> None:
    limited = f"ulimit -v 400000; {sys.executable} -m optipromp list"
    done = ran(["bash", "-c", limited], timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("error INVALID_REQUEST: memory is limited to 410 MB")
    planned = "from optipromp import load_scene, plan; plan(load_scene('scenario-3'))"
    limited = f'ulimit -v 400000; {sys.executable} -c "{planned}"'
    done = ran(["bash", "-c", limited], timeout=60)
    assert done.returncode == 1
    last = done.stderr.splitlines()[-1]
    assert last.startswith("optipromp.core.errors.InvalidRequestError: memory is limited to 410 MB")
