"""An entry works in a process of its own: it learns nothing of the judge and ends no run."""

import importlib.util
import json
import os
import py_compile
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.bench import entrants as entries
from tests.bench.entrants import HOWS, entry

from optipromp import Scene
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.scene import SceneObject
from optipromp_bench import running
from optipromp_bench.entrant import IS_DUMPABLE, prctl
from optipromp_bench.episode import Episode
from optipromp_bench.experiments.eyes import aimed_at, drawn_camera
from optipromp_bench.results import BenchRun, run_bench
from optipromp_bench.running import Exercise, attempted
from optipromp_bench.serve import Apart, Served, dismissed
from optipromp_bench.sets import SceneSet, scene_of
from optipromp_bench.tracks import ROWS, EntryError, Patience, asked, words

SHORT = Patience(plan=2.0, reset=2.0, act=0.5)
TASK = Exercise("", "plan", "limp", 110_000, engines=("flight",))


@pytest.fixture(scope="module")
def apart() -> Iterator[Apart]:
    own = Apart(entry(entries.Wrong), "plan", SHORT)
    yield own
    own.close()


@pytest.fixture(scope="module")
def seen() -> Scene:
    return running.situated(TASK)[0].seen


def test_an_entry_learns_neither_word_nor_seeds_nor_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(running.tracks, "words", str)  # the whole text
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


def test_a_changed_judge_is_another_ones() -> None:
    """The entry patches its own copy of the verdict; the motion stays what it is."""
    (made,), _ = attempted(replace(TASK, entry=entry(entries.Patcher)))
    dismissed()
    assert made.result == "missed"
    assert running._row.__name__ == "_row"


@pytest.mark.skipif(sys.platform != "linux", reason="Linux has prctl")
def test_an_entry_reads_no_memory_and_leaves_no_process_behind(tmp_path: Path) -> None:
    arguments = Path("/proc/self/cmdline").read_bytes()
    run = BenchRun.of(entry(entries.Thief), "plan", SceneSet("w", ("limp",), 1))
    (made, _) = run_bench(run, tmp_path, workers=1)
    left, told = made.cause.removeprefix("ValueError: ").split(" ", 1)
    assert "Permission denied" in told
    first, *rest = arguments.decode().rstrip("\0").split("\0")
    assert rest
    assert told.endswith(f" {first}")  # no argument of ours
    with pytest.raises(ProcessLookupError):
        os.kill(int(left), 0)
    assert prctl(IS_DUMPABLE) == 1  # a user's own process is as it was
    assert Path("/proc/self/cmdline").read_bytes() == arguments


def test_no_camera_tells_which_fruit_is_the_target() -> None:
    for preset in ("cluster", "wild"):
        scene, _ = scene_of(preset, 110_003)
        ripe = next(item.id for item in scene.objects if item.role == "pushable")
        other = aimed_at(scene, [ripe], np.zeros(3))
        assert other.target != scene.target
        one, same, new = (drawn_camera(*of) for of in ((scene, 5), (other, 5), (scene, 6)))
        assert np.abs(one.position - same.position).max() < 1e-12
        assert np.abs(one.rotation - same.rotation).max() < 1e-12
        assert np.linalg.norm(one.position - new.position) > 0.01


def test_detections_tell_neither_the_fruit_nor_whether_there_is_one() -> None:
    """What a look says of a fruit, and of none, comes in no other and in no next look."""
    setting = running.situated(replace(TASK, preset="wild", condition="detector"))[0]
    setting = setting._replace(detector=replace(setting.detector, false=3.0))
    episode, seen = Episode(setting, 1), dict[float, tuple[SceneObject, ...]]()
    for _ in range(40):
        episode.act(np.zeros(7))
        if (look := episode.observe().look) is not None:
            seen[look.time] = look.detections
    every = [item for items in seen.values() for item in items]
    assert len(seen) > 5
    assert len(every) > len(seen) * len(setting.scene.pushables)  # some are false
    for items in seen.values():
        assert {item.id for item in items} == {f"seen{k}" for k in range(len(items))}
    assert len({item.radius for item in every}) == len(every)
    assert len({tuple(item.orientation) for item in every}) == len(every)


@pytest.mark.parametrize(
    ("how", "cause"),
    [
        ("long", "takes 61 s; at most 60"),
        ("begin", "joint1 begins at 1.52; the start is 1.42"),
        ("names", "must be "),
    ],
)
def test_a_motion_that_no_controller_takes_is_refused(
    apart: Apart, seen: Scene, how: str, cause: str
) -> None:
    apart.begin()
    made = asked(lambda: apart.plan(seen, HOWS.index(how)), seen)
    assert made.refused
    assert cause in made.why


@pytest.mark.parametrize(
    ("how", "cause"),
    [
        ("exit", "SystemExit: 0"),
        ("interrupt", "KeyboardInterrupt"),
        ("surrogate", r"ValueError: bad \ud800 letter\x1b[2J aaa"),
        ("text", "the entry gave a str"),
        ("rows", f"must have 2 to {ROWS}"),
        ("abort", "its process ended (exit code 3)"),
        ("hang", "no answer within 2 s"),
    ],
)
def test_what_an_entry_does_wrong_is_its_error(
    apart: Apart, seen: Scene, how: str, cause: str
) -> None:
    apart.begin()
    with pytest.raises(EntryError) as told:
        apart.plan(seen, HOWS.index(how))
    line = words(told.value.message)
    assert cause in line
    assert line.isprintable()
    assert len(line) <= 300


@pytest.mark.parametrize(
    ("pieces", "cause"),
    [
        ([b" "] * 10_000, "no answer within 2 s"),
        ([b"a" * 65_536] * 100, "more than 100000 bytes"),
        ([b"\x80\x04K\x01.\n"], "must be a JSON object"),
        ([b"[" * 50_000 + b"\n"], "must be a JSON object"),
        ([b'{"rows": [1000000000000], "names": ["a"]}\n'], "1000000000000 rows"),
        ([b'{"rows": [100000], "names": [' + b'"a",' * 1000 + b'"a"]}\n'], "too large"),
        ([b'{"rows": [60000, 60000], "names": [' + b'"a",' * 12 + b'"a"]}\n'], "too large"),
        ([b'{"rows": [2], "names": ["a"]}\n' + b"\xff" * 64], "finite"),
        ([b'{"rows": [true], "names": [[]]}\n' + b"\xff" * 64], "True rows"),
        ([b'{"rows": [2, -1], "names": ["a"]}\n'], "-1 rows"),
        ([b'{"rows": 2, "names": ["a"]}\n'], "one count or two"),
        ([b'{"rows": [2, 2, 2], "names": ["a"]}\n'], "one count or two"),
    ],
)
def test_an_entry_that_writes_to_the_judge_is_cut_off(
    seen: Scene, pieces: list[bytes], cause: str
) -> None:
    ours, theirs = socket.socketpair()
    own = Apart("x:X", "plan", SHORT)
    own._socket = ours
    own._process = subprocess.Popen(["sleep", "100"], start_new_session=True)
    enemy = threading.Thread(target=written, args=(theirs, pieces), daemon=True)
    enemy.start()
    with pytest.raises(EntryError) as told:
        own.plan(seen, 0)
    assert cause in told.value.message
    assert own._process is None
    enemy.join(5.0)


def written(own: socket.socket, pieces: list[bytes]) -> None:
    """Write pieces, single bytes slowly."""
    with own, suppress(OSError):
        for piece in pieces:
            own.sendall(piece)
            time.sleep(0.01 if len(piece) == 1 else 0.0)
        while own.recv(65_536):  # until the other side has enough
            pass


def test_a_run_goes_on_after_a_scene_that_ends_the_entry(tmp_path: Path) -> None:
    spec = entry(entries.Aborts)
    rows = run_bench(BenchRun.of(spec, "plan", SceneSet("w", ("limp",), 2)), tmp_path, workers=1)
    assert [each.result for each in rows] == ["error"] * 4
    assert (tmp_path / "submission.zip").exists()


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
    written(caller, [b" "] * 1000)


def says(text: bytes) -> Callable[[socket.socket], None]:
    def answer(caller: socket.socket) -> None:
        with suppress(OSError), caller, caller.makefile("rwb") as stream:
            for line in stream:
                stream.write(b"{}\n" if b'"reset"' in line else text)
                stream.flush()

    return answer


@pytest.mark.parametrize(
    ("answer", "cause"),
    [
        (hangs_up, "the policy hung up"),
        (drips, "no answer within 2 s"),
        (says(b"velocity 1 2 3\n"), "velocity 1 2 3"),
        (says(b"[]\n"), "must be a JSON object"),
        (says(b'{"error":"\\ud800"}\n'), r"\ud800"),
        (says(b'{"velocity":[NaN,0,0,0,0,0,0]}\n'), "finite"),
        (says(b'{"velocity":[0]}\n'), "shape (1,)"),
        (says(b'{"velocity":[' + b"1" * 400 + b",0,0,0,0,0,0]}\n"), "velocity"),
        (says(b'{"velocity":["a"]}\n'), "must be {'velocity': [...]}"),
    ],
)
def test_a_served_policy_that_breaks_the_rules_is_a_row(
    answer: Callable[[socket.socket], None], cause: str
) -> None:
    for address in server(answer):
        task = replace(TASK, entry=address, track="policy", patience=SHORT)
        (made,), motions = attempted(task)
        assert (made.result, motions) == ("error", {})
        assert cause in made.cause


def test_a_policy_nobody_serves_is_told_before_the_run(tmp_path: Path) -> None:
    run = BenchRun.of("tcp:127.0.0.1:1", "policy", SceneSet("w", ("limp",), 1), "none")
    with pytest.raises(InvalidRequestError, match="start it"):
        run_bench(run, tmp_path, workers=1)
    with pytest.raises(InvalidRequestError, match="track policy"):
        run_bench(replace(run, track="plan"), tmp_path / "other", workers=1)


def test_an_entry_that_cannot_be_made_is_told(
    apart: Apart, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    apart.close()
    Path("made").mkdir()
    Path("beside.py").write_text("A = 1")
    told = (
        ("syntax", "def (", "SyntaxError"),
        ("value", "raise ValueError('at import')", "at import"),
        ("exits", "raise SystemExit(3)", "SystemExit: 3"),
        ("maker", "class A:\n def __init__(self): raise RuntimeError('no')", "RuntimeError: no"),
        ("bare", "class A: pass", "no method plan"),
        ("void", "", "AttributeError"),
        ("helped", "from beside import A", "No module named 'beside'"),
        ("stale", "raise ValueError('the source')", "the source"),
        ("ends", "import os; os._exit(0)", "exit code 0"),
    )
    for name, source, _ in (*told, ("evil", "raise ValueError('bytecode')", "")):
        Path(f"made/{name}.py").write_text(source)
    cached, never = importlib.util.cache_from_source("made/stale.py"), "UNCHECKED_HASH"
    py_compile.compile(
        "made/evil.py", cached, invalidation_mode=py_compile.PycInvalidationMode[never]
    )
    Path("made/__init__.py").touch()
    for name, _, word in told:
        monkeypatch.setattr(apart, "spec", f"made.{name}:A")
        with pytest.raises(EntryError, match=word):
            apart.begin()


def test_a_hidden_scene_is_no_seed_away() -> None:
    """The name of what an entry sees is the same for all scenes."""
    seen = running.situated(TASK)[0].seen
    truth, _ = scene_of(TASK.preset, TASK.seed)
    assert truth.name == "limp-110000"
    assert seen.name == running.situated(replace(TASK, seed=110_001))[0].seen.name == "scene"


PROGRAM = """
from optipromp_bench.entries.own import Blind
from optipromp_bench.serve import serve
serve(Blind(), calls=2)
"""


def started(program: str) -> Iterator[str]:
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        yield process.stdout.readline().decode().strip()
        process.kill()


@pytest.fixture
def address() -> Iterator[str]:
    yield from started(PROGRAM)


def test_a_served_policy_acts_as_at_home(address: str) -> None:
    place = "127.0.0.1", int(address.rpartition(":")[2])
    with socket.create_connection(place) as own, own.makefile("rwb") as stream:
        for line in (b"hello\n", b"\xff\n", b"[]\n", b'{"call": "act"}\n'):
            stream.write(line)
            stream.flush()
            assert "error" in json.loads(stream.readline())
    away, _ = attempted(Exercise(address, "policy", "limp", 110_000, engines=("arm",)))
    home, _ = attempted(Exercise("blind", "policy", "limp", 110_000, engines=("arm",)))
    assert away[0].result == home[0].result == "clean"
    assert away[0].judged() == home[0].judged()


@pytest.mark.parametrize("address", ["127.0.0.1:1", "127.0.0.1:x", ":99999", "", "a" * 300 + ":80"])
def test_nobody_there_is_told(address: str) -> None:
    with pytest.raises(InvalidRequestError, match="start it"):
        Served(address).begin()
