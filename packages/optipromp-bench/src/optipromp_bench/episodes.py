"""Episodes in files that Minari and LeRobot read.

An episode is a plan of ours, or a policy, driven step by step in ``optipromp/Pick-v0``. ``minari``
files are written by Minari itself (0.5, format Arrow). ``lerobot`` files are written here, in
version 3.0 of LeRobot's layout (https://huggingface.co/docs/lerobot/lerobot-dataset-v3): all
episodes in one Parquet file, without a dependency on LeRobot, whose package wants a PyTorch of its
own.
"""

import io
import json
import os
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import FloatArray, lengths
from optipromp.core.errors import InvalidRequestError, OptiPrompError, installed_by
from optipromp.core.files import check_folder, json_text, moved_when_whole, write_atomically
from optipromp.core.planning import Plan, plan
from optipromp.core.planning.task import tool_motion
from optipromp.core.processes import cores
from optipromp_bench.env import SPEED, Guarded, PickEnv
from optipromp_bench.episode import RATE, Episode
from optipromp_bench.experiments.cluster import over
from optipromp_bench.experiments.rows import source_version
from optipromp_bench.serve import Apart, hired
from optipromp_eyes.pictures import png_file

AnyArray = NDArray[Any]
Format = Literal["minari", "lerobot"]
FORMATS: tuple[Format, ...] = ("minari", "lerobot")
TASK = "pick the ripe fruit of a {}"
VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
FIRST = 300_000
"""First seed by default: above those of training (200,000 and on) of the learnt entries."""

STEP = 0.02  # [s] of a plan between two points of its path
SEARCH = 15  # points ahead among which the nearest is taken: a choice
AHEAD = 5  # points by which the tool aims ahead: a choice


@dataclass(frozen=True)
class EpisodeAsk:
    """What an episode is of, and who acts."""

    preset: str
    seed: int
    condition: str = "none"
    pictures: bool = False
    policy: str = ""  # entry of the track policy that acts; empty: our planner
    guarded: bool = False  # whether its actions pass a guard, and the guard's are the labels
    noise: float = 0.0  # deviation of what disturbs each action, of which the labels know nothing


@dataclass(frozen=True, eq=False)
class EpisodeData:
    """One episode of k steps."""

    ask: EpisodeAsk  # what it is of
    seen: Mapping[str, AnyArray]  # observations by name, (k + 1, ...) each
    actions: AnyArray  # (k, 3); with a guard those that were executed
    rewards: AnyArray  # (k,)
    success: bool  # whether it was clean
    terminated: bool  # whether it ended by itself, and not by time
    acted: AnyArray | None = None  # (k,) whether the guard acted; None: there is none


def environment(presets: Sequence[str], condition: str, pictures: bool) -> PickEnv:
    """The environment that episodes are of."""
    return PickEnv(presets, condition, observation="picture" if pictures else "state")


def follower(made: Plan) -> Callable[[FloatArray], FloatArray]:
    """The actions (3,) at tool points (3,) that bring the tool to a plan's path and along it.

    The place on the path is that of the nearest point ahead, so a disturbed tool is not late.
    """
    times = np.arange(0.0, made.trajectory.duration, STEP)
    points, _ = tool_motion(made.robot, made.trajectory.sample(times)[0])
    frame, at = made.scene.frame, 0

    def action(point: FloatArray) -> FloatArray:
        nonlocal at
        at += int(np.argmin(lengths(points[at : at + SEARCH] - point)))
        then = min(at + AHEAD, len(points) - 1)
        velocity = (points[then] - point) / (AHEAD * STEP)
        return np.asarray(np.clip(frame @ velocity / SPEED, -1.0, 1.0))

    return action


def acting(ask: EpisodeAsk, episode: Episode) -> Callable[[], FloatArray] | None:
    """What gives the actions (3,) of an episode; None: there is no plan for the scene."""
    robot, frame = episode.robot, episode.scene.frame
    if ask.policy:
        entry = hired(ask.policy, "policy")
        if isinstance(entry, Apart):
            entry.begin()
        entry.reset(episode.scene, ask.seed)

        def wished() -> FloatArray:
            along, _ = robot.tool_jacobian(episode.state.q)
            velocity = entry.act(episode.observe())
            return np.asarray(np.clip(frame @ (along @ velocity) / SPEED, -1.0, 1.0))

        return wished
    try:
        made = plan(episode.scene, seed=ask.seed)
    except OptiPrompError:
        return None
    expert = follower(made)
    return (lambda: expert(robot.tool_pose(episode.state.q)[0])) if made.success else None


def driven_episode(ask: EpisodeAsk) -> EpisodeData | None:
    """An episode; None: there is no plan for the scene as first seen."""
    env = environment((ask.preset,), ask.condition, ask.pictures)
    behind: Any = Guarded(env) if ask.guarded else env
    seen, _ = behind.reset(seed=ask.seed, options={"preset": ask.preset, "scene": ask.seed})
    assert env.episode is not None
    act = acting(ask, env.episode)
    if act is None:
        return None
    info: dict[str, Any] = {}
    told, actions, rewards, acted = [seen], [], [], []
    terminated = truncated = False
    rng, push = np.random.default_rng([ask.seed, 3]), np.zeros(3)
    while not (terminated or truncated):
        action = act().astype(np.float32)  # as in the file
        push = 0.9 * push + 0.3 * ask.noise * rng.standard_normal(3)
        moved = np.clip(action.astype(np.float64) + push, -1.0, 1.0)
        seen, reward, terminated, truncated, info = behind.step(moved)
        told.append(seen)
        actions.append(info.get("action", action))
        acted.append(ask.guarded and info["guard"].acted)
        rewards.append(reward)
    behind.close()
    return EpisodeData(
        ask, {name: np.stack([each[name] for each in told]) for name in told[0]},
        np.array(actions), np.array(rewards, dtype=np.float32), bool(info["is_success"]),
        terminated, np.array(acted) if ask.guarded else None,
    )  # fmt: skip


def collected(
    asks: Sequence[EpisodeAsk],
    count: int,
    *,
    keep: Literal["clean", "all"] = "clean",
    workers: int | None = None,
    ray: str | None = None,
    progress: Callable[[int, int, str], None] | None = None,
) -> list[EpisodeData]:
    """The first ``count`` episodes, in the order of what is asked; the same on any number of cores.

    ``asks``: more than ``count``: some scenes have no plan, and some episodes are not clean.
    ``keep``: ``clean`` leaves out episodes that picked nothing or harmed something. ``workers``,
    ``ray``: see :func:`optipromp_bench.experiments.cluster.over`. ``progress``: called with
    the number of episodes kept, of all, and words.
    """
    kept: dict[int, EpisodeData] = {}
    low = 0
    while len(kept) < count and low < len(asks):
        batch = range(low, min(low + max(count - len(kept), 2 * cores()), len(asks)))
        low = batch.stop

        def hear(index: int, made: Any, first: int = batch.start) -> None:
            if isinstance(made, Exception):
                raise InvalidRequestError(str(made))
            if made is not None and (keep == "all" or made.success):
                kept[first + index] = made
            if progress is not None:
                done = min(len(kept), count)
                progress(done, count, f"{done} of {count} episodes")

        over(driven_episode, [(asks[k],) for k in batch], hear, workers=workers, ray=ray)
    if len(kept) < count:
        raise InvalidRequestError(f"{len(asks)} scenes gave {len(kept)} episodes, not {count}")
    return [kept[k] for k in sorted(kept)[:count]]


def check_place(form: Format, folder: Path, name: str = "") -> None:
    """Test, before episodes are made, that they can be written."""
    if form == "minari" and not re.fullmatch(r"([\w-]{2,}/)*[\w-]+-v\d+", name, re.ASCII):
        raise InvalidRequestError(f"name is {name!r}; must be like optipromp/pick/expert-v0")
    try:
        import_module("pyarrow" if form == "lerobot" else "minari")
    except ImportError as error:
        raise InvalidRequestError(
            f"{form} files need {error.name}: {installed_by('optipromp-bench[episodes]')}"
        ) from None
    check_folder(folder)
    if (folder / (name if form == "minari" else "meta/info.json")).exists():
        raise InvalidRequestError(f"{folder} holds a dataset {name} already: choose another folder")


def write_minari(episodes: Sequence[EpisodeData], folder: Path, name: str) -> str:
    """Write episodes as a Minari dataset under ``folder``, whole or not at all; returns its id.

    Read it with ``MINARI_DATASETS_PATH`` set to the folder: ``minari.load_dataset(id)``.
    """
    check_place("minari", folder, name)
    import minari
    from minari.data_collector import EpisodeBuffer

    first = episodes[0].ask
    presets = tuple(dict.fromkeys(each.ask.preset for each in episodes))
    env = environment(presets, first.condition, first.pictures)
    buffers = []
    for k, each in enumerate(episodes):
        count, told = len(each.rewards), np.zeros((len(each.rewards) + 1, 1), dtype=np.bool_)
        told[-1] = each.success
        ends = np.arange(count) == count - 1
        buffers.append(
            EpisodeBuffer(
                id=k, seed=each.ask.seed,
                options={"preset": each.ask.preset, "scene": each.ask.seed},
                observations=dict(each.seen), actions=each.actions, rewards=each.rewards.tolist(),
                terminations=(ends & each.terminated).tolist(),
                truncations=(ends & (not each.terminated)).tolist(),
                infos={"is_success": told} | _guarded(each),
            )
        )  # fmt: skip
    before = os.environ.get("MINARI_DATASETS_PATH")
    try:
        with moved_when_whole(folder, name) as root, warnings.catch_warnings():
            os.environ["MINARI_DATASETS_PATH"] = str(root.resolve())
            warnings.simplefilter("ignore", UserWarning)  # addresses and environments left out
            minari.create_dataset_from_buffers(
                name, buffers, observation_space=env.observation_space,
                action_space=env.action_space, algorithm_name="opti-promp", data_format="arrow",
                author="OptI-ProMP", code_permalink=f"optipromp {source_version()}",
                description="A cup picks a ripe fruit among unripe ones: the planner of optipromp.",
            )  # fmt: skip
            for file in root.rglob("namespace_metadata.json"):
                if not (there := folder / file.relative_to(root)).exists():
                    write_atomically(there, file.read_bytes())
    finally:
        os.environ.pop("MINARI_DATASETS_PATH", None)
        if before is not None:
            os.environ["MINARI_DATASETS_PATH"] = before
    return name


def _guarded(each: EpisodeData) -> dict[str, AnyArray]:
    """Whether the guard acted, as an information of Minari: one row more than actions."""
    return {} if each.acted is None else {"guarded": np.append(each.acted, False)[:, None]}


def write_lerobot(episodes: Sequence[EpisodeData], folder: Path) -> None:
    """Write episodes as a LeRobot dataset, version 3.0, whose root is ``folder``.

    Frames are the k observations before the k actions. Pictures are PNG in the Parquet file.
    """
    check_place("lerobot", folder)
    import pyarrow as pa

    tasks = list(dict.fromkeys(TASK.format(each.ask.preset) for each in episodes))
    columns: dict[str, list[Any]] = {}
    rows: list[dict[str, Any]] = []
    begin = 0
    for k, each in enumerate(episodes):
        count = len(each.rewards)
        task = TASK.format(each.ask.preset)
        last = np.arange(count) == count - 1
        values: dict[str, Any] = {
            "observation.state": each.seen["arm"][:count],
            "observation.environment_state": each.seen["objects"][:count].reshape(count, -1),
            "action": each.actions, "next.reward": each.rewards, "next.done": last,
            "next.success": last & each.success,
            "timestamp": (np.arange(count) / RATE).astype(np.float32),
            "frame_index": np.arange(count), "episode_index": np.full(count, k),
            "index": begin + np.arange(count), "task_index": np.full(count, tasks.index(task)),
        }  # fmt: skip
        if each.acted is not None:
            values["guarded"] = each.acted
        if "rgb" in each.seen:
            values["observation.images.palm"] = each.seen["rgb"][:count]
        for name, value in values.items():
            columns.setdefault(name, []).append(value)
        rows.append(
            {
                "episode_index": k, "tasks": [task], "length": count, "data/chunk_index": 0,
                "data/file_index": 0, "dataset_from_index": begin,
                "dataset_to_index": begin + count, "meta/episodes/chunk_index": 0,
                "meta/episodes/file_index": 0,
            }
        )  # fmt: skip
        begin += count
    whole = {name: np.concatenate(parts) for name, parts in columns.items()}
    table = {name: _column(name, value, pa) for name, value in whole.items()}
    _parquet(folder / DATA.format(chunk_index=0, file_index=0), pa.table(table))
    _parquet(folder / "meta/episodes/chunk-000/file-000.parquet", pa.Table.from_pylist(rows))
    named = pa.table({"task_index": list(range(len(tasks))), "task": tasks})
    index = {  # LeRobot reads the file by pandas, and looks tasks up by the index
        "index_columns": ["task"], "column_indexes": [], "pandas_version": "2.0.0",
        "columns": [
            {"name": n, "field_name": n, "pandas_type": kind, "numpy_type": own, "metadata": None}
            for n, kind, own in (("task_index", "int64", "int64"), ("task", "unicode", "object"))
        ],
    }  # fmt: skip
    named = named.replace_schema_metadata({"pandas": json.dumps(index)})
    _parquet(folder / "meta/tasks.parquet", named)
    features = {name: _feature(name, value) for name, value in whole.items()}
    stats = {name: _stats(value) for name, value in whole.items()}
    write_atomically(folder / "meta/stats.json", json_text(stats).encode())
    info = {
        "codebase_version": VERSION, "robot_type": "panda", "total_episodes": len(episodes),
        "total_frames": begin, "total_tasks": len(tasks), "chunks_size": 1000,
        "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": round(RATE),
        "splits": {"train": f"0:{len(episodes)}"}, "data_path": DATA, "video_path": None,
        "features": features,
    }  # fmt: skip
    write_atomically(folder / "meta/info.json", json_text(info).encode())


def _parquet(path: Path, table: Any) -> None:
    import pyarrow.parquet

    stream = io.BytesIO()
    pyarrow.parquet.write_table(table, stream)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, stream.getvalue())


def _is_picture(name: str) -> bool:
    return name.startswith("observation.images.")


def _column(name: str, value: AnyArray, pa: Any) -> Any:
    if _is_picture(name):
        return pa.array([{"bytes": png_file(each), "path": None} for each in value])
    if value.ndim == 1:
        return pa.array(value)
    flat = pa.array(np.ascontiguousarray(value, dtype=np.float32).ravel())
    return pa.FixedSizeListArray.from_arrays(flat, value.shape[1])


def _feature(name: str, value: AnyArray) -> dict[str, Any]:
    """What ``info.json`` tells of a column."""
    if _is_picture(name):
        names = ["height", "width", "channels"]
        return {"dtype": "image", "shape": list(value.shape[1:]), "names": names}
    kind = "float32" if value.ndim > 1 else str(value.dtype)
    return {"dtype": kind, "shape": list(value.shape[1:]) or [1], "names": None}


def _stats(value: AnyArray) -> dict[str, Any]:
    """Least, largest, mean, deviation and count; of pictures by channel, as shares of 255."""
    rows, picture = value.astype(np.float64).reshape(len(value), -1), value.ndim == 4
    if picture:
        rows = rows.reshape(-1, value.shape[-1]) / 255.0
    moments = {
        "min": rows.min(axis=0), "max": rows.max(axis=0), "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
    }  # fmt: skip
    told = {k: (v.reshape(-1, 1, 1) if picture else v).tolist() for k, v in moments.items()}
    return {**told, "count": [len(value)]}
