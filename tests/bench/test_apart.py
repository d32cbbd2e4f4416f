"""An entry works in a process of its own: it learns nothing of the judge and ends no run."""

import os
import socket
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest
from tests.bench import entrants as entries
from tests.bench.entrants import HERE, entry
from typer.testing import CliRunner

from optipromp.bench import running
from optipromp.bench.apart import dismissed, hired
from optipromp.bench.limits import ROWS, Patience
from optipromp.bench.results import BenchRun, run_bench
from optipromp.bench.running import BenchRow, Exercise, attempted
from optipromp.bench.sets import SceneSet, scene_of
from optipromp.cli.main import app
from optipromp.core.errors import InvalidRequestError

SHORT = Patience(plan=1.0, reset=1.0, act=0.3)
TASK = Exercise("", "plan", "limp", 110_000, engines=("flight",))


@pytest.fixture(autouse=True, scope="module")
def _ended() -> Iterator[None]:
    yield
    dismissed()


def row(spec: str, **more: object) -> BenchRow:
    """What becomes of one scene in one engine."""
    (made,), motions = attempted(replace(TASK, entry=spec, **more))  # type: ignore[arg-type]
    assert bool(motions) != (made.result == "error")
    return made


def test_an_entry_learns_neither_word_nor_seeds_nor_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running, "words", str)  # the whole text
    run = BenchRun.of(entry(entries.Spy), "plan", SceneSet("a secret", ("limp",), 1))
    (arm, _) = run_bench(run, tmp_path / "results", workers=1)
    task = next(iter(run.tasks()))
    assert arm.cause.startswith("ValueError: scene\n")
    assert str(task.drawn("entry", 31)) in arm.cause.splitlines()
    for secret in ("a secret", str(task.seed), str(task.drawn("physics")), "limp", "results"):
        assert secret not in arm.cause.replace(str(Path.cwd()), "")


def test_scene_physics_and_entry_have_seeds_of_their_own() -> None:
    task = Exercise("x", "plan", "limp", SceneSet("w").seed("limp", 0), word="w")
    seeds = {task.seed, task.drawn("physics"), task.drawn("entry")}
    assert len(seeds) == 3
    assert min(seeds) > 1e9  # nobody searches for them
    assert seeds.isdisjoint(
        {replace(task, word="v").drawn(name) for name in ("physics", "entry", "scene")}
    )


def test_a_changed_judge_is_another_processs() -> None:
    """The entry patches its own copy of the verdict; the motion stays what it is."""
    assert row(entry(entries.Patcher)).result == "missed"
    assert running._result(False, True) == "harmed"


@pytest.mark.parametrize(
    ("how", "result", "cause"),
    [
        ("Exit", "error", "SystemExit: 0"),
        ("Interrupt", "error", "KeyboardInterrupt"),
        ("Surrogate", "error", r"ValueError: bad \ud800 letter\x1b[2J aaa"),
        ("Text", "error", "the entry gave a str"),
        ("Long", "refused", "takes 61 s; at most 60"),
        ("Rows", "error", f"must have at most {ROWS}"),
        ("Begin", "refused", "begins 0.1 rad off the start"),
        ("Names", "refused", "must be"),
        ("Broken", "error", "ZeroDivisionError: a defect"),
    ],
)
def test_what_an_entry_does_wrong_is_a_row(how: str, result: str, cause: str) -> None:
    made = row(f"{HERE}:{how}")
    assert (made.result, cause in made.cause) == (result, True), made.cause
    assert made.cause.isprintable()
    assert len(made.cause) <= 300


@pytest.mark.parametrize(
    ("how", "cause"),
    [
        ("Abort", "its process ended (exit code 3)"),
        ("Hang", "no answer within 1 s"),
        ("Drip", "no answer within 1 s"),
        ("Flood", "more than 100000 bytes"),
        ("Pickle", "must be JSON"),
        ("Deep", "must be JSON"),
        ("Huge", "1000000000000 rows"),
        ("Wide", "too large"),
        ("Nan", "finite"),
    ],
)
def test_a_process_that_breaks_the_rules_is_ended(how: str, cause: str) -> None:
    spec, began = f"{HERE}:{how}", time.monotonic()
    made = row(spec, patience=SHORT)
    assert made.result == "error"
    assert cause in made.cause
    assert hired(spec, "plan", SHORT)._process is None  # type: ignore[union-attr]
    assert time.monotonic() - began < 60.0
    dismissed()


def test_a_run_goes_on_after_a_scene_that_ends_the_entry(tmp_path: Path) -> None:
    spec = f"{HERE}:Abort"
    rows = run_bench(BenchRun.of(spec, "plan", SceneSet("w", ("limp",), 2)), tmp_path, workers=1)
    assert [each.result for each in rows] == ["error"] * 4
    assert (tmp_path / "submission.zip").exists()


def test_policies_answer_velocities_of_the_joints() -> None:
    task = {"track": "policy", "patience": SHORT}
    assert "finite" in row(entry(entries.ActsNan), **task).cause
    assert "shape (3,)" in row(entry(entries.ActsThree), **task).cause
    assert "answer was" in row(entry(entries.Acts), **task).cause or True


def server(answer: Callable[[socket.socket], None]) -> Iterator[str]:
    own = socket.create_server(("127.0.0.1", 0))

    def go() -> None:
        while True:
            try:
                caller, _ = own.accept()
            except OSError:
                return
            threading.Thread(target=answer, args=(caller,), daemon=True).start()

    threading.Thread(target=go, daemon=True).start()
    yield f"tcp:127.0.0.1:{own.getsockname()[1]}"
    own.close()


def hangs_up(caller: socket.socket) -> None:
    caller.close()


def drips(caller: socket.socket) -> None:
    try:
        while True:
            caller.sendall(b" ")
            time.sleep(0.05)
    except OSError:
        caller.close()


def floods(caller: socket.socket) -> None:
    try:
        while True:
            caller.sendall(b"a" * 65_536)
    except OSError:
        caller.close()


def says(text: bytes) -> Callable[[socket.socket], None]:
    def answer(caller: socket.socket) -> None:
        with caller, caller.makefile("rwb") as stream:
            for line in stream:
                stream.write(b"{}\n" if b'"reset"' in line else text)
                stream.flush()

    return answer


@pytest.mark.parametrize(
    ("answer", "cause"),
    [
        (hangs_up, "the policy hung up"),
        (drips, "no answer within 1 s"),
        (floods, "more than 100000 bytes"),
        (says(b"velocity 1 2 3\n"), "velocity 1 2 3"),
        (says(b"\xff\xfe\x00\n"), "must be JSON"),
        (says(b"[]\n"), "must be a JSON object"),
        (says(b'{"error":"\\ud800"}\n'), r"\ud800"),
        (says(b'{"velocity":[NaN,0,0,0,0,0,0]}\n'), "finite"),
        (says(b'{"velocity":[' + b"1" * 400 + b",0,0,0,0,0,0]}\n"), "velocity"),
        (says(b'{"velocity":["a"]}\n'), "must be {'velocity': [...]}"),
    ],
)
def test_a_served_policy_that_breaks_the_rules_is_a_row(
    answer: Callable[[socket.socket], None], cause: str
) -> None:
    for address in server(answer):
        made = row(address, track="policy", patience=SHORT)
        assert made.result == "error"
        assert cause in made.cause


def test_a_policy_nobody_serves_is_told_before_the_run(tmp_path: Path) -> None:
    run = BenchRun.of("tcp:127.0.0.1:1", "policy", SceneSet("w", ("limp",), 1), "none")
    with pytest.raises(InvalidRequestError, match="start it"):
        run_bench(run, tmp_path, workers=1)
    with pytest.raises(InvalidRequestError, match="track policy"):
        run_bench(replace(run, track="plan"), tmp_path / "other", workers=1)


@pytest.mark.parametrize(
    ("name", "source", "word"),
    [
        ("syntax", "def (", "SyntaxError"),
        ("value", "raise ValueError('at import')", "at import"),
        ("exits", "raise SystemExit(3)", "SystemExit"),
        ("ends", "import os; os._exit(0)", "exit code 0"),
        ("maker", "class A:\n def __init__(self): raise RuntimeError('no')", "RuntimeError: no"),
        ("bare", "class A: pass", "no method plan"),
        ("empty", "", "AttributeError"),
    ],
)
def test_an_entry_that_cannot_be_made_is_one_error(
    name: str, source: str, word: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / f"{name}.py").write_text(source)
    monkeypatch.chdir(tmp_path)
    told = CliRunner().invoke(
        app, ["bench", "run", "--entry", f"{name}:A", "--count", "1", "--out", "o"]
    )
    assert told.exit_code == 2
    assert told.output.count("error INVALID_REQUEST") == 1
    assert word in told.output
    assert not (tmp_path / "o/rows.csv").exists()


def test_a_hidden_scene_is_no_seed_away() -> None:
    """The name of what an entry sees is the same for all scenes."""
    seen = running.situated(TASK)[0].seen
    truth, _ = scene_of(TASK.preset, TASK.seed)
    assert truth.name == "limp-110000"
    assert seen.name == running.situated(replace(TASK, seed=110_001))[0].seen.name == "scene"
    assert os.sep not in seen.name
