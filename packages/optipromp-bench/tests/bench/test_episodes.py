"""Episodes in files: written once, read back by the libraries that they are for."""

import io
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import refused, told

from optipromp.core.errors import InvalidRequestError
from optipromp_bench.episodes import (
    EpisodeAsk,
    EpisodeData,
    collected,
    environment,
    write_lerobot,
    write_minari,
)

NAME = "optipromp/pick/test-v0"


@pytest.fixture(scope="module")
def made() -> list[EpisodeData]:
    asks = [EpisodeAsk("limp", seed) for seed in range(300_000, 300_006)]
    return collected(asks, 2, workers=1)


def test_episodes_are_clean_picks(made: list[EpisodeData]) -> None:
    for each in made:
        assert each.success
        assert each.acted is None  # no guard
        assert each.terminated
        count = len(each.rewards)
        assert each.seen["arm"].shape[0] == each.seen["objects"].shape[0] == count + 1
        assert each.actions.shape == (count, 3)
        assert np.abs(each.actions).max() <= 1.0
        assert 0.8 < each.rewards.sum() < 1.0  # that of a clean pick, less the time


def test_minari_reads_and_replays_what_was_written(
    made: list[EpisodeData], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("pyarrow")
    write_minari(made, tmp_path, NAME)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    data = minari.load_dataset(NAME)
    assert data.total_episodes == 2
    assert data.total_steps == sum(len(each.rewards) for each in made)
    for each, own in zip(data.iterate_episodes(), made, strict=True):
        assert np.array_equal(each.observations["arm"], own.seen["arm"])
        assert bool(each.infos["is_success"][-1, 0])
    first = next(iter(data.iterate_episodes()))
    env = environment(("limp",), "none", pictures=False)
    env.reset(seed=0, options={"preset": "limp", "scene": made[0].ask.seed})
    for action, reward in zip(first.actions[:50], first.rewards[:50], strict=True):
        assert env.step(action)[1] == pytest.approx(reward, abs=1e-6)
    with pytest.raises(InvalidRequestError):
        write_minari(made, tmp_path, NAME)


def test_a_full_disk_leaves_no_dataset(made: list[EpisodeData], tmp_path: Path) -> None:
    """Files may have 16 kB, so an episode is cut short while it is written."""
    pytest.importorskip("minari")
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 14, before[1]))
    try:
        with pytest.raises(InvalidRequestError, match="cannot write"):
            write_minari(made, tmp_path, NAME)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert list(tmp_path.iterdir()) == []
    assert "MINARI_DATASETS_PATH" not in os.environ
    write_minari(made, tmp_path, NAME)
    assert {path.name for path in tmp_path.iterdir()} == {"optipromp"}


@pytest.mark.parametrize(
    "name", ["../../../x-v0", "/x-v0", "a/../x-v0", "x", "optipromp/x", "", "x-v0\n", "é/x-v0"]
)
def test_a_name_that_is_no_id_is_refused_before_any_episode(name: str, tmp_path: Path) -> None:
    out = tmp_path / "one" / "two" / "three" / "out"
    words = "episodes", "--count", 1, "--out", out, "--name", name, "--workers", 1
    assert "name is" in refused(*words)
    assert list(tmp_path.iterdir()) == []


def test_lerobot_files_are_of_version_three(made: list[EpisodeData], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    write_lerobot(made, tmp_path)
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    table = parquet.read_table(tmp_path / "data/chunk-000/file-000.parquet")
    assert table.num_rows == info["total_frames"] == sum(len(each.rewards) for each in made)
    assert set(table.column_names) == set(info["features"])
    state = np.array(table["observation.state"].to_pylist(), dtype=np.float32)
    assert np.array_equal(state[: len(made[0].rewards)], made[0].seen["arm"][:-1])
    rows = parquet.read_table(tmp_path / "meta/episodes/chunk-000/file-000.parquet").to_pylist()
    assert [row["length"] for row in rows] == [len(each.rewards) for each in made]
    assert rows[1]["dataset_from_index"] == rows[0]["dataset_to_index"]
    stats = json.loads((tmp_path / "meta/stats.json").read_text())
    assert np.allclose(stats["observation.state"]["mean"], state.mean(axis=0), atol=1e-4)
    with pytest.raises(InvalidRequestError, match="another folder"):
        write_lerobot(made, tmp_path)


def test_lerobot_reads_them(made: list[EpisodeData], tmp_path: Path) -> None:
    datasets = pytest.importorskip("lerobot.datasets.lerobot_dataset")
    write_lerobot(made, tmp_path)
    data = datasets.LeRobotDataset("optipromp/test", root=tmp_path)
    assert data.num_episodes == 2
    frame = data[len(made[0].rewards)]  # the first of the second episode
    assert np.allclose(frame["observation.state"].numpy(), made[1].seen["arm"][0])
    assert frame["task"] == "pick the ripe fruit of a limp"


def test_where_a_guard_acted_is_a_column(made: list[EpisodeData], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    acted = [np.arange(len(each.rewards)) % 3 == k for k, each in enumerate(made)]
    guarded = [replace(each, acted=where) for each, where in zip(made, acted, strict=True)]
    write_lerobot(guarded, tmp_path / "guarded")
    write_lerobot(made, tmp_path / "alone")
    one, other = (tmp_path / name for name in ("guarded", "alone"))
    table = parquet.read_table(one / "data/chunk-000/file-000.parquet")
    assert np.array_equal(np.ravel(table["guarded"].to_pylist()), np.concatenate(acted))
    info = json.loads((one / "meta/info.json").read_text())
    assert set(table.column_names) == set(info["features"])
    alone = parquet.read_table(other / "data/chunk-000/file-000.parquet")
    assert "guarded" not in alone.column_names


def test_minari_tells_where_a_guard_acted(
    made: list[EpisodeData], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    minari = pytest.importorskip("minari")
    pytest.importorskip("pyarrow")
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    acted = np.arange(len(made[0].rewards)) % 2 == 0
    write_minari([replace(made[0], acted=acted)], tmp_path, NAME)
    (episode,) = minari.load_dataset(NAME).iterate_episodes()
    assert np.array_equal(np.ravel(episode.infos["guarded"]), [*acted, False])


def test_pictures_are_columns(made: list[EpisodeData], tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    image = pytest.importorskip("PIL.Image")
    rng = np.random.default_rng(0)
    rgb = rng.integers(0, 256, (len(made[0].rewards) + 1, 6, 8, 3), dtype=np.uint8)
    write_lerobot([replace(made[0], seen={**made[0].seen, "rgb": rgb})], tmp_path)
    table = parquet.read_table(tmp_path / "data/chunk-000/file-000.parquet")
    stored = table["observation.images.palm"][3].as_py()["bytes"]
    assert np.array_equal(np.asarray(image.open(io.BytesIO(stored))), rgb[3])
    feature = json.loads((tmp_path / "meta/info.json").read_text())["features"]
    assert feature["observation.images.palm"]["shape"] == [6, 8, 3]


def test_the_command_says_what_it_wrote(tmp_path: Path) -> None:
    pytest.importorskip("pyarrow")
    words = "episodes --count 1 --preset limp --format lerobot --workers 1 --out"
    assert told(*words.split(), tmp_path / "data")["clean"] == 1
    assert "minari" in refused("episodes", "--format", "zarr", "--out", tmp_path / "x")
