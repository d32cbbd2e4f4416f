"""What a submission proves: rounds, verification by the entry, records, publications, bad files."""

import csv
import io
import json
import shutil
import struct
import sys
import tracemalloc
import zipfile
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
from tests.bench import entrants as entries
from tests.bench.entrants import entry
from typer.testing import CliRunner

from optipromp.cli.main import app
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import npz
from optipromp_bench.experiments.rows import BENCH, locked, rows_of
from optipromp_bench.results import BenchRun, run_bench, submission, verify
from optipromp_bench.running import Exercise, again
from optipromp_bench.sets import Round, SceneSet, draw_round, entry_digest, read_round
from optipromp_bench.table import leaderboard, markdown
from optipromp_bench.tracks import ROW_FILE

MINE = """
import numpy as np
from optipromp import Trajectory
from optipromp.core.scenes import bare_robot
class Mine:
    def plan(self, scene, seed):
        if len(scene.pushables) > {many}:
            return None
        q = np.tile(scene.start, (2, 1))
        names = bare_robot(scene).joint_names
        return Trajectory(np.array([0.0, {seconds}]), q, 0 * q, 0 * q, names)
"""


def bench(*arguments: str, given: str = "") -> tuple[int, str]:
    told = CliRunner().invoke(app, ["bench", *arguments], input=given)
    return told.exit_code, " ".join(told.output.split())


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an entry in a file of its own."""
    folder = tmp_path_factory.mktemp("place")
    (folder / "mine.py").write_text(MINE.format(many=99, seconds=0.5))
    return folder


@pytest.fixture
def here(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, a copy of the place."""
    shutil.copytree(place, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def done(place: Path) -> Path:
    """A submission of a round, from the command line."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        assert bench("draw", "--entry", "mine:Mine", "--out", "round.json")[0] == 0
        options = "run --entry mine:Mine --round - --preset limp --count 2 --workers 1"
        given = Path("round.json").read_text()
        code, told = bench(*options.split(), "--out", "results", given=given)
        assert code == 0, told
    return place / "results"


def changed(path: Path, to: Path, **files: bytes) -> Path:
    """A submission some of whose files are others."""
    with zipfile.ZipFile(path) as file:
        content = {name: file.read(name) for name in file.namelist()} | files
    with zipfile.ZipFile(to, "w", zipfile.ZIP_DEFLATED) as file:
        for name, each in content.items():
            file.writestr(name, each)
    return to


def motions(path: Path) -> list[str]:
    with zipfile.ZipFile(path) as file:
        return [name for name in file.namelist() if name.startswith("motions/")]


def test_a_round_has_the_digests_before_the_word(done: Path, here: Path) -> None:
    made = read_round(Path("round.json"))
    assert made.entries == {"mine:Mine": entry_digest("mine:Mine")}
    run, rows, *_ = submission(done / "submission.zip")
    assert (run.round, run.digest) == (made, made.entries["mine:Mine"])
    assert run.scenes.word == made.word
    assert len(made.word) == 32
    assert draw_round(["mine:Mine"]).word != made.word
    Path("mine.py").write_text(MINE.format(many=99, seconds=0.6))
    code, told = bench("run", "--entry", "mine:Mine", "--round", "round.json", "--out", "other")
    assert code == 2
    assert "before it was drawn" in told
    assert bench("draw", "--entry", "mine:Mine", "--out", "round.json")[0] == 2  # not over it
    assert [row.result for row in rows] == ["missed"] * 4


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"word": "another"}, "drew"),
        ({"entries": {"mine:Mine": "0"}}, "before it was drawn"),
        ({"version": "9"}, "version"),
    ],
)
def test_a_run_is_of_its_round(change: Mapping[str, object], word: str, done: Path) -> None:
    run = submission(done / "submission.zip").run
    assert run.round is not None
    other = Round(**{**asdict(run.round), **change})  # type: ignore[arg-type]
    with pytest.raises(InvalidRequestError, match=word):
        replace(run, round=other)


def test_digests_are_of_source_class_and_package(here: Path) -> None:
    Path("pack/part").mkdir(parents=True)
    for name in ("pack/__init__.py", "pack/part/__init__.py", "pack/part/one.py", "pack/two.py"):
        Path(name).write_text("")
    before = entry_digest("pack.part.one:A"), entry_digest("mine:Mine")
    assert len({*before, entry_digest("mine:Other"), entry_digest("opti-promp")}) == 4
    Path("pack/two.py").write_text("# changed")
    assert entry_digest("pack.part.one:A") != before[0]
    Path("pack/linked").symlink_to(Path("pack/part").absolute())
    with pytest.raises(InvalidRequestError, match="link to a folder"):
        entry_digest("pack.part.one:A")
    Path("pack/linked").unlink()
    assert entry_digest("tcp:127.0.0.1:1") == ""
    for wrong, word in (
        ([], "no entries"), (["tcp:a:1"], "no source"), (["mine:Mine"] * 2, "twice"),
        (["nowhere:A"], "no module"), (["pack.none:A"], "no module"),
        (["opti-pormp"], "opti-promp"),
    ):  # fmt: skip
        with pytest.raises(InvalidRequestError, match=word):
            draw_round(wrong)


def test_an_entry_is_asked_again(done: Path, here: Path) -> None:
    """A good submission is verified; one whose rows, refusals or entry changed is not."""
    path, record = Path("results/submission.zip"), Path("results/submission.verified.json")
    shutil.copytree(done, "results", dirs_exist_ok=True)
    record.unlink(missing_ok=True)
    assert leaderboard([path]).verified == {"mine:Mine": "no"}
    assert bench("verify", str(path), "--workers", "1")[0] == 0
    assert leaderboard([path]).verified == {"mine:Mine": "motions"}
    code, told = bench("verify", str(path), "--entry", "mine:Mine", "--workers", "1")
    assert (code, "0 of which differ" in told) == (0, True)
    assert json.loads(record.read_text())["by"] == "entry"
    assert bench("verify", str(path), "--workers", "1")[0] == 0  # weaker: the record stays
    assert leaderboard([path]).verified == {"mine:Mine": "entry"}
    assert "| entry |" in markdown(leaderboard([path]))
    assert bench("table", str(path), "--plot", "board.svg")[0] == 0
    assert ">mine:Mine</text>" in Path("board.svg").read_text()
    assert json.loads(CliRunner().invoke(app, ["bench", "table", "results", "--json"]).output)[
        "verified"
    ] == {"mine:Mine": "entry"}

    forged = posthoc(path, Path("forged.zip"))
    shutil.copy(record, "forged.verified.json")  # of another file
    assert leaderboard([forged]).verified == {"mine:Mine": "no"}
    code, told = bench("verify", "forged.zip", "--workers", "1")
    assert (code, "not verified: 2 rows" in told) == (1, True)
    assert "--entry mine:Mine" in told
    told_now = verify(forged, entry="mine:Mine", workers=1)
    assert [(a.result, b.result) for a, b in told_now.changed] == [("refused", "missed")] * 2
    assert "another motion" in told_now.changed[0][1].cause
    assert leaderboard([forged]).verified == {"mine:Mine": "no"}

    Path("mine.py").write_text(MINE.format(many=0, seconds=0.5))
    code, told = bench("verify", str(path), "--entry", "mine:Mine")
    assert (code, "as it was submitted" in told) == (2, True)


def posthoc(path: Path, to: Path) -> Path:
    """Blank the motion of the first scene and call it refused."""
    run, rows, *_ = submission(path)
    table = list(csv.DictReader(io.StringIO(zipfile.ZipFile(path).read("rows.csv").decode())))
    for each in table[: len(run.engines)]:
        each.update(result="refused", picked="False", cause="refused", force="", duration="")
    out = io.StringIO()
    writer = csv.DictWriter(out, list(table[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    name = f"motions/{rows[0].preset}-{rows[0].seed}.npz"
    return changed(path, to, **{"rows.csv": out.getvalue().encode(), name: npz({})})


def array(shape: str) -> bytes:
    """An npz whose array's header tells another shape than it has."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as file:
        head = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text))
        file.writestr("times.npy", head + text.encode() + bytes(64))
    return out.getvalue()


def bomb() -> bytes:
    """An npz of 100 MB of zeros."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_DEFLATED) as file:
        file.writestr("times.npy", bytes(100_000_000))
    return out.getvalue()


def motion(seconds: float, rows: int = 2, **more: object) -> bytes:
    q = np.tile([1.42, 1.1, -1.26, -2.42, -1.69, 1.02, 0.8], (rows, 1))
    told = {"times": np.linspace(0.0, seconds, rows), "positions": q}
    return npz({**told, "velocities": 0 * q, "accelerations": 0 * q, **more}, compressed=True)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (motion(61.0), "takes 61 s; at most 60"),
        (motion(1e9), "takes 1e\\+09 s"),
        (motion(50.0, 100_001), "100001 rows"),
        (motion(1.0, times=np.array([0.0, np.nan])), "finite"),
        (motion(1.0, times=np.array(["0", "1"])), "float64"),
        (motion(1.0, evil=np.zeros(3)), "evil"),
        (npz({"times": np.arange(2.0)}), "must have"),
        (motion(1.0)[:300], "NPZ"),
        (b"\x80\x04K\x01.", "NPZ"),
        (array("(10**12,)"), "NPZ"),
        (array("(1000000000000,)"), "NPZ"),
        (array("(-5,)"), "NPZ"),
        (bomb(), "100 MB"),
    ],
)
def test_a_motion_that_is_none_is_refused(content: bytes, word: str) -> None:
    task = Exercise("", "plan", "limp", 110_000, engines=("flight",))
    with pytest.raises(InvalidRequestError, match=word):
        again(task, content, "motions/x.npz")


@pytest.mark.parametrize(
    ("actions", "word"),
    [
        (np.zeros((26, 7)), "over after 25, and lasts"),
        (np.zeros((10, 7)), "goes on"),
        (np.zeros((10, 6)), "7 joints"),
        (np.full((10, 7), np.inf), "finite"),
    ],
)
def test_an_episode_lasts_as_long_as_it_lasts(
    actions: np.ndarray, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optipromp_bench.episode.LONGEST", 0.5)  # [s], in place of 20
    task = Exercise("", "policy", "limp", 110_000, engines=("flight",))
    with pytest.raises(InvalidRequestError, match=word):
        again(task, npz({"flight": actions}, compressed=True), "motions/x.npz")


@pytest.mark.parametrize(
    ("name", "content", "word"),
    [
        ("run.json", b"hello", "no run"),
        ("run.json", b"[" * 100_000, "no run"),
        ("run.json", b'{"entry": "\\ud800"}', "no run"),
        ("run.json", b'{"entry": "' + b"a" * 2_000_000 + b'"}', "at most 1000000"),
        ("rows.csv", b"\0\xff", "no row"),
        ("rows.csv", b"preset,seed\n" + b"a" * 200_000, "no row"),
    ],
)
def test_a_submission_that_is_none_is_refused(
    name: str, content: bytes, word: str, done: Path, tmp_path: Path
) -> None:
    made = changed(done / "submission.zip", tmp_path / "x.zip", **{name: content})
    with pytest.raises(InvalidRequestError, match=word):
        submission(made)


@pytest.mark.parametrize(
    "change",
    [
        {"engines": []}, {"engines": ["arm", "arm"]}, {"engines": ["arm"]}, {"condition": "sway"},
        {"scenes": {"word": "w", "presets": ["limp", "limp"], "count": 1}},
        {"scenes": {"word": "w", "presets": ["../x"], "count": 1}},
        {"scenes": {"word": "w", "presets": ["limp"], "count": 10**9}},
        {"entry": "\x1b[2J"}, {"round": {}},
    ],
)  # fmt: skip
def test_a_run_that_is_none_is_refused(
    change: Mapping[str, object], done: Path, tmp_path: Path
) -> None:
    document = json.loads((done / "run.json").read_text()) | {"round": None} | change
    content = json.dumps(document).encode()
    made = changed(done / "submission.zip", tmp_path / "x.zip", **{"run.json": content})
    with pytest.raises(InvalidRequestError, match="no run of the benchmark"):
        submission(made)


def test_files_that_are_no_zip_are_refused(done: Path, tmp_path: Path) -> None:
    many, packed = tmp_path / "many.zip", tmp_path / "packed.zip"
    with zipfile.ZipFile(many, "w") as file:
        for k in range(20_001):
            file.writestr(zipfile.ZipInfo(str(k)), b"")
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("run.json", b"{}")
    for path, word in (
        (many, "more than 20000 files"), (packed, "must be deflated"),
        (Path("/dev/zero"), "device"),
        (tmp_path, "directory"), (tmp_path / "none.zip", "No such"),
    ):  # fmt: skip
        with pytest.raises(InvalidRequestError, match=word):
            submission(path)


def test_a_broken_folder_is_told(tmp_path: Path) -> None:
    run = BenchRun.of(entry(entries.Still), "plan", SceneSet("w", ("limp",), 1))
    for name, content in (("text", b"hello"), ("list", b"[]"), ("scenes", b'{"scenes":[]}')):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.json").write_bytes(content)
        with pytest.raises(InvalidRequestError, match="no run of the benchmark"):
            run_bench(run, tmp_path / name, workers=1)
    (tmp_path / "rows/rows.csv").mkdir(parents=True)
    with pytest.raises(InvalidRequestError, match="directory"):
        rows_of(tmp_path / "rows", BENCH, ROW_FILE)
    (tmp_path / "file").mkdir()
    (tmp_path / "file/motions").write_text("x")
    with pytest.raises(InvalidRequestError, match="cannot write"):
        run_bench(run, tmp_path / "file", workers=1)


def test_no_file_of_a_run_tells_the_word_before_the_end_or_takes_another_row(
    tmp_path: Path,
) -> None:
    made = draw_round([entry(entries.Still)])
    scenes = SceneSet(made.word, ("limp",), 2)
    run = BenchRun.of(entry(entries.Still), "plan", scenes, round=made)
    told = list[bool]()

    def say(done: int, total: int, row: object) -> None:
        told.append(any(made.word in path.read_text() for path in tmp_path.glob("*.*")))
        if done == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_bench(run, tmp_path, workers=1, progress=say)
    assert told == [False] * 3
    assert read_round(tmp_path / "round.json") == made
    rows = (tmp_path / "rows.csv").read_text()
    (tmp_path / "rows.csv").write_text(rows.replace("missed", "clean"))
    with pytest.raises(InvalidRequestError, match="this run did not write"):
        run_bench(run, tmp_path, workers=1)
    (tmp_path / "rows.csv").write_text(rows)
    options = f"run --draw --entry {run.entry} --preset limp --count 2 --workers 1 --out {tmp_path}"
    assert bench(*options.split())[0] == 0  # it goes on
    assert [row.result for row in submission(tmp_path / "submission.zip").rows] == ["missed"] * 4
    assert made.word in (tmp_path / "run.json").read_text()
    assert not (tmp_path / "round.json").exists()


def test_a_submission_is_not_unpacked_to_be_read(
    done: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("optipromp_bench.tracks.SUBMISSION", 1_000_000)  # is what a read reserves
    path = done / "submission.zip"
    many = changed(path, tmp_path / "x.zip", **dict.fromkeys(motions(path), bytes(20_000_000)))
    tracemalloc.start()
    leaderboard([many])
    assert tracemalloc.get_traced_memory()[1] < 5_000_000
    tracemalloc.stop()
    lines = zipfile.ZipFile(path).read("rows.csv")
    with pytest.raises(InvalidRequestError, match="more lines than"):
        submission(changed(path, tmp_path / "y.zip", **{"rows.csv": lines + 1000 * b"\n"}))


def test_one_run_writes_into_a_folder(tmp_path: Path) -> None:
    run = BenchRun.of(entry(entries.Still), "plan", SceneSet("w", ("limp",), 1))
    with locked(tmp_path), pytest.raises(InvalidRequestError, match="writes into"):
        run_bench(run, tmp_path, workers=1)
    assert not (tmp_path / "rows.csv").exists()


def test_names_are_whole_in_a_narrow_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "50")
    code, told = bench("list")
    assert code == 0
    for name in ("i-promp-guard", "push-aside", "receding", "opti-promp"):
        assert name in told
    assert "in the clone" not in told
    monkeypatch.chdir("/")
    monkeypatch.setattr("sys.path", [p for p in sys.path if not Path(p, "benchmarks").is_dir()])
    assert bench("list")[1].count("in the clone") == 7
