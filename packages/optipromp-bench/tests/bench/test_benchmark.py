"""The benchmark: frozen scenes, two engines, submissions that can be executed once more."""

import io
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from hypothesis import given
from hypothesis import strategies as st
from scripts import publish
from tests.bench.entrants import Broken, Follower, Hasty, Ours, Seer, entry
from tests.cli.fixtures import refused, told

from optipromp import plan
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp_bench.results import BenchRun, run_bench, submission, verify
from optipromp_bench.running import Exercise, attempted, executed_rows, situated
from optipromp_bench.sets import FIRST, PRESETS, SceneSet, frozen_digests, scene_of
from optipromp_bench.table import leaderboard, markdown, paired
from optipromp_bench.tracks import against


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("ours")
    scenes = SceneSet("a third word", ("field",), 1)
    rows = run_bench(BenchRun.of(entry(Ours), "plan", scenes), folder, workers=1)
    assert [row.engine for row in rows] == ["arm", "flight"]
    assert "clean" in {row.result for row in rows}
    return folder


@pytest.mark.parametrize("preset", PRESETS)
def test_the_development_set_is_frozen(preset: str) -> None:
    assert len(frozen_digests()[preset]) == 200
    for seed in range(FIRST, FIRST + 5):
        _, told = scene_of(preset, seed)
        assert told == frozen_digests()[preset][str(seed)]


@given(st.text("abcdef", min_size=1), st.text("abcdef", min_size=1))
def test_words_draw_scenes_beyond_all_studies(one: str, other: str) -> None:
    a, b = (list(SceneSet(word, ("field", "wild"), 3).scenes()) for word in (one, other))
    assert a == list(SceneSet(one, ("field", "wild"), 3).scenes())
    assert a == b or not set(a) & set(b)
    assert min(seed for _, seed in a) >= 10_000_000
    assert len({seed for _, seed in a}) == 6


def test_a_submission_is_verified_bit_for_bit(ours: Path) -> None:
    told = verify(ours / "submission.zip", workers=1)
    assert told.changed == ()


def test_what_was_touched_up_is_found(ours: Path, tmp_path: Path) -> None:
    forged = tmp_path / "forged.zip"
    with zipfile.ZipFile(ours / "submission.zip") as file:
        content = {name: file.read(name) for name in file.namelist()}
    name = next(k for k in content if k.endswith(".npz"))
    with np.load(io.BytesIO(content[name])) as arrays:
        values = dict(arrays)
    for name_, power in (("times", -1), ("velocities", 1), ("accelerations", 2)):
        values[name_] *= 0.9**power  # slower
    stream = io.BytesIO()
    np.savez(stream, **values)
    content[name] = stream.getvalue()
    with zipfile.ZipFile(forged, "w") as file:
        for key, value in content.items():
            file.writestr(key, value)
    assert len(verify(forged, workers=1).changed) >= 1


def test_a_run_goes_on_where_it_ended(ours: Path, tmp_path: Path) -> None:
    run, rows, *_ = submission(ours / "submission.zip")
    for file in ours.rglob("*"):
        if file.is_file() and file.name != "submission.zip":
            place = tmp_path / file.relative_to(ours)
            place.parent.mkdir(exist_ok=True)
            place.write_bytes(file.read_bytes())
    path = tmp_path / "rows.csv"
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:2]) + lines[2][:20])  # cut short within a row
    again = run_bench(run, tmp_path, workers=1)
    assert [row.judged() for row in again] == [row.judged() for row in rows]
    with pytest.raises(InvalidRequestError, match="choose another folder"):
        run_bench(BenchRun.of(entry(Hasty), "plan", run.scenes), tmp_path, workers=1)
    larger = replace(run, scenes=replace(run.scenes, count=2))
    more = run_bench(larger, tmp_path, workers=1)
    assert more[:2] == again  # times of thinking, too: these scenes were not run again
    assert [row.engine for row in more[2:]] == ["arm", "flight"]
    assert submission(tmp_path / "submission.zip")[:2] == (larger, more)
    with pytest.raises(InvalidRequestError, match="choose another folder"):  # fewer scenes
        run_bench(run, tmp_path, workers=1)


def test_motions_that_no_controller_takes_are_refused() -> None:
    rows, _ = attempted(Exercise(entry(Hasty), "plan", "cluster", 110_000))
    assert {row.result for row in rows} == {"refused"}
    assert "limit" in rows[0].cause
    scene, _ = scene_of("cluster", 110_000)
    other, _ = scene_of("wild", 110_003)
    motion = plan(scene).trajectory
    assert against(motion, scene) == ""
    if np.abs(posed(other)[1].q - posed(scene)[1].q).max() > 1e-3:
        assert "start" in against(motion, other)


def test_policies_act_in_both_engines(tmp_path: Path) -> None:
    run = BenchRun.of(entry(Follower), "policy", SceneSet("w", ("cluster",), 1), "none")
    rows = run_bench(run, tmp_path, workers=1)
    assert {row.engine for row in rows} == {"arm", "flight"}
    assert all(row.picked for row in rows)
    assert verify(tmp_path / "submission.zip", workers=1).changed == ()
    assert BenchRun.of(entry(Follower), "policy", run.scenes).engines == ("arm",)  # sway


def test_pictures_come_in() -> None:
    rows, _ = attempted(Exercise(entry(Seer), "picture", "field", 110_000))
    assert {row.result for row in rows} <= {"clean", "harmed", "missed"}
    assert rows[0].picked


def test_an_entry_leaves_as_it_says_or_as_it_came() -> None:
    """The same reach: by its own way out it is clean, back the way it came it tears a fruit."""
    setting = {"preset": "cluster", "seed": 173109, "word": "development"}
    ours = Exercise("opti-promp", "plan", engines=("arm",), **setting)
    (row,), deeds = attempted(ours)
    assert row.result == "clean", row
    motion = deeds["arm"]
    assert motion.back is not None
    situation, digest = situated(ours)
    (again,) = executed_rows(ours, situation, digest, {"arm": motion})
    assert replace(again, thought=row.thought) == row
    came = {"arm": replace(motion, back=None)}
    (torn,) = executed_rows(ours, situation, digest, came)
    assert (torn.result, torn.cause) == ("harmed", "torn")


def test_a_table_orders_entries(ours: Path, tmp_path: Path) -> None:
    run, *_ = submission(ours / "submission.zip")
    run_bench(BenchRun.of(entry(Broken), "plan", run.scenes), tmp_path, workers=1)
    board = leaderboard([tmp_path, ours])
    assert board.order == (entry(Ours), entry(Broken))
    assert board.of(entry(Broken), "arm").errors == 1
    assert board.of(entry(Ours), "arm").p is None
    assert markdown(board).count(f"| `{entry(Ours)}` |") == 3
    assert told("bench", "table", ours, tmp_path)["order"] == list(board.order)


def test_the_published_board_is_that_of_bench_table(ours: Path, tmp_path: Path) -> None:
    told("bench", "table", ours, "--markdown", tmp_path / "board.md")
    board, presets, torn = publish.tables_in(tmp_path).values()
    found = leaderboard([ours])
    assert board["rows"][0][1] == f"`{entry(Ours)}`"
    assert f"({found.standings[0].interval})" in board["rows"][0][2]
    assert presets["columns"] == ["entry", "field: arm", "field: flight"]
    assert torn["rows"] == [[f"`{entry(Ours)}`", *(str(s.torn) for s in found.standings[:2])]]


@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=40))
def test_the_paired_test_is_that_of_scipy(pairs: list[tuple[bool, bool]]) -> None:
    b, c = (sum(x and not y for x, y in pairs), sum(y and not x for x, y in pairs))
    tail = scipy.stats.binom.cdf(min(b, c), b + c, 0.5) if b + c else 0.5
    assert paired(pairs) == pytest.approx(min(2.0 * tail, 1.0))


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--entry", "opti-promp", "--track", "plane"], "plan"),
        (["--entry", "opti-promp", "--condition", "storm"], "condition"),
    ],
)
def test_wrong_requests_say_what_is_wrong(arguments: list[str], word: str, tmp_path: Path) -> None:
    assert word in refused("bench", "run", "--out", tmp_path / "x", "--count", 1, *arguments)
