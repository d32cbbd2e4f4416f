"""Train the learnt entries of the benchmark, and write each as ONNX with its learning curve.

    python scripts/train_policies.py plans DATA --seeds 200000:204000       # our plans as weights
    python scripts/train_policies.py set DATA --out set.onnx --minutes 10   # proposals from a scene
    python scripts/train_policies.py steps DATA --seeds 210000:210300       # our plans, driven
    python scripts/train_policies.py clone DATA --out clone.onnx --minutes 10
    python scripts/train_policies.py act DATA --out act.onnx --minutes 120  # chunks of velocities

``plans`` keeps objects of scenes, and the weights of a primitive whose path is that of our plan.
``set`` learns several proposals of weights from objects, as a set: the nearest one learns (winner
takes all), and a score learns which one that is. ``steps`` drives our plans in the simulation with
disturbed velocities, and keeps what a policy saw and should have done. ``clone`` learns that.
``act`` learns the velocities of the next half second at once, by a transformer over hand and
objects (ACT, Zhao et al. 2023, without its latent style: of one scene our planner has one plan). A
core gives it some 20,000 samples a minute. It is meant for an hour of ``steps`` on one core and two
hours of training on the other; the shipped weights had less (docs/learners.md).

Every FILE.onnx gets FILE.csv beside it: minutes, samples, and figures on scenes that are not
trained on. Seeds fix weights and order; the time that training may take fixes how far it gets.
Needs torch. One core.
"""

import argparse
import csv
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))  # for the benchmarks

import numpy as np

from benchmarks.entries.learnt import hand_of
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import plan
from optipromp_bench.env import MOST, WIDTH, objects_of
from optipromp_bench.episodes import EpisodeAsk, driven_episode
from optipromp_bench.primitive import COUNT, weights_of
from optipromp_bench.sets import PRESETS
from optipromp_sim.generate import generate
from optipromp_sim.generate.plants import untold

SCALE = 10.0  # of metres before the network: objects are decimetres away
PROPOSALS = 6
HELD_OUT = 20  # every so many scenes are for figures, not for training
EPISODE_NOISE = 0.3  # standard deviation of disturbed actions in ``steps``
CHUNK = 25  # velocities that ``act`` tells at once: half a second, a choice


Presets = Sequence[str]


def preset_of(seed: int, presets: Presets) -> str:
    """The preset of a training scene: all in turn."""
    return presets[seed % len(presets)]


def shards(out: Path, kind: str, seeds: range, count: int) -> Iterator[tuple[Path, range]]:
    """The files of a kind that a folder lacks, each with its ``count`` seeds."""
    out.mkdir(parents=True, exist_ok=True)
    for own in (seeds[k : k + count] for k in range(0, len(seeds), count)):
        if not (file := out / f"{kind}-{own.start}.npz").exists():
            yield file, own


def plans(out: Path, seeds: range, presets: Presets) -> None:
    """Keep objects (MOST, WIDTH) and weights (2, COUNT) of scenes that we solve."""
    for file, own in shards(out, "plans", seeds, 200):
        rows: list[tuple[np.ndarray, np.ndarray]] = []
        for seed in own:
            scene = untold(generate(preset_of(seed, presets), seed))  # type: ignore[arg-type]
            try:
                made = plan(scene, seed=seed)
            except OptiPrompError:
                continue
            if made.success and scene.target is not None:
                objects = objects_of(scene.objects, scene, scene.target.position)
                rows.append((objects, weights_of(made)))
        np.savez_compressed(
            file, objects=np.array([a for a, _ in rows], dtype=np.float32),
            weights=np.array([b for _, b in rows], dtype=np.float32),
        )  # fmt: skip
        print(file.name, len(rows), flush=True)


def steps(out: Path, seeds: range, presets: Presets) -> None:
    """Drive plans with disturbed velocities; keep what was seen and what should have been done."""
    for file, own in shards(out, "steps", seeds, 20):
        asks = (
            EpisodeAsk(preset_of(seed, presets), seed, "zero-mean", noise=EPISODE_NOISE)
            for seed in own
        )
        made = [each for each in map(driven_episode, asks) if each is not None]
        np.savez_compressed(
            file, arm=np.concatenate([each.seen["arm"][:-1] for each in made]),
            objects=np.concatenate([each.seen["objects"][:-1] for each in made], dtype=np.float16,
                                   casting="same_kind"),
            action=np.concatenate([each.actions for each in made]),
        )  # fmt: skip
        print(file.name, sum(len(each.actions) for each in made),
              f"{sum(each.success for each in made)} picked", flush=True)  # fmt: skip


def turned(objects: np.ndarray, rng: np.random.Generator, *others: np.ndarray) -> list[np.ndarray]:
    """A batch turned about the approach, and mirrored: the push knows no direction of the arm.

    ``others`` (b, m, 2) are further vectors across the approach.
    """
    count = len(objects)
    angle, flip = rng.uniform(0.0, 2.0 * np.pi, count), rng.choice([-1.0, 1.0], count)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], 1)
    turn[:, :, 0] *= flip[:, None]

    def round_it(vectors: np.ndarray) -> np.ndarray:
        return np.einsum("bij,bkj->bki", turn, vectors).astype(np.float32)

    out = objects.astype(np.float32)
    for first in (0, 3, 9):  # place, axis, stem
        out[:, :, first : first + 2] = round_it(objects[:, :, first : first + 2])
    return [out, *(round_it(each) for each in others)]


def network(outputs: int, arm: int = 0) -> Any:
    """Objects (b, MOST, WIDTH) as a set, and ``arm`` further numbers, to ``outputs`` numbers."""
    import torch
    from torch import nn

    class SetNetwork(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            wide = 96
            self.each = nn.Sequential(nn.Linear(WIDTH, wide), nn.ReLU(), nn.Linear(wide, wide))
            self.ask, self.key, self.value = (nn.Linear(wide, wide) for _ in range(3))
            self.after = nn.Sequential(nn.ReLU(), nn.Linear(2 * wide, wide), nn.ReLU())
            self.rest = nn.Sequential(
                nn.Linear(2 * wide + arm, 192), nn.ReLU(), nn.Linear(192, 192), nn.ReLU(),
                nn.Linear(192, outputs),
            )  # fmt: skip

        def forward(self, objects: Any, more: Any = None) -> Any:
            there = objects[:, :, 13:].sum(-1, keepdim=True) > 0.5
            scale = torch.ones(WIDTH)
            scale[:3] = scale[6:9] = scale[12] = SCALE
            x = self.each(objects * scale)
            score = self.ask(x) @ self.key(x).transpose(1, 2) / x.shape[-1] ** 0.5
            score = score.masked_fill(~there.transpose(1, 2), -1e4)
            y = self.after(torch.cat([x, score.softmax(-1) @ self.value(x)], -1))
            mean = (y * there).sum(1) / there.sum(1).clamp(min=1)
            most = y.masked_fill(~there, -1e4).amax(1)
            pooled = [mean, most] if more is None else [mean, most, more]
            return self.rest(torch.cat(pooled, -1))

    return SetNetwork()


def loaded(folder: Path, kind: str) -> list[dict[str, np.ndarray]]:
    """The shards of a folder, in the order of their seeds."""
    files = sorted(folder.glob(f"{kind}-*.npz"), key=lambda f: int(f.stem.split("-")[1]))
    return [dict(np.load(file)) for file in files]


def train_set(data: Path, out: Path, minutes: float) -> None:
    """Proposals of weights, the nearest of which learns, and scores of which one that is."""
    import torch
    from torch.nn import functional

    held = loaded(data, "plans")
    objects = np.concatenate([s["objects"] for s in held])
    weights = np.clip(np.concatenate([s["weights"] for s in held]), -1.5, 1.5)
    test = np.arange(len(objects)) % HELD_OUT == 0
    torch.manual_seed(0)
    torch.set_num_threads(1)
    rng, net = np.random.default_rng(0), network(PROPOSALS * (2 * COUNT + 1))
    train = objects[~test], weights[~test]

    def loss(x: np.ndarray, w: np.ndarray) -> tuple[Any, Any, Any]:
        told = net(torch.from_numpy(x)).reshape(len(x), PROPOSALS, 2 * COUNT + 1)
        right = torch.from_numpy(w.reshape(len(w), 1, 2 * COUNT))
        off = functional.smooth_l1_loss(
            told[:, :, : 2 * COUNT], right.expand(-1, PROPOSALS, -1), reduction="none", beta=0.1
        ).mean(-1)
        near, which = off.min(1)
        soft = near + 0.05 * off.mean(1)  # so that no proposal is forgotten
        return soft.mean(), functional.cross_entropy(told[:, :, -1], which), near.mean()

    def figures() -> dict[str, float]:
        with torch.no_grad():
            near, score, best = loss(objects[test].astype(np.float32), weights[test])
        return {"near": float(best), "score": float(score), "loss": float(near)}

    def batches() -> Iterator[Any]:
        while True:
            rows = rng.integers(len(train[0]), size=256)
            seen, paths = turned(train[0][rows], rng, np.swapaxes(train[1][rows], 1, 2))
            near, score, _ = loss(seen, np.swapaxes(paths, 1, 2))
            yield near + 0.1 * score

    fit(net, batches(), figures, out, minutes, 256)
    write(net, out, (torch.zeros(1, MOST, WIDTH),), ["objects"])


def train_steps(data: Path, out: Path, minutes: float, chunk: int = 1) -> None:
    """What to do now, and in the next ``chunk`` periods, from what is seen now."""
    import torch
    from torch.nn import functional

    parts = loaded(data, "steps")
    arm, objects, action = (
        np.concatenate([s[k].astype(np.float32) for s in parts])
        for k in ("arm", "objects", "action")
    )
    held = np.zeros(len(arm), dtype=bool)
    held[: len(parts[0]["arm"])] = True
    ends = np.append(np.flatnonzero(np.diff(arm[:, -1]) <= 0.0), len(arm) - 1)  # time begins anew
    last = ends[np.searchsorted(ends, np.arange(len(arm)))]
    torch.manual_seed(0)
    torch.set_num_threads(1)
    hand = hand_of(arm).astype(np.float32)
    rng = np.random.default_rng(0)
    net = network(3, hand.shape[1]) if chunk == 1 else transformer(chunk, hand.shape[1])
    rows_of = np.flatnonzero(~held)

    def ahead(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The next actions (b, chunk, 3), and which of them are of the episode (b, chunk)."""
        then = rows[:, None] + np.arange(chunk)
        return action[np.minimum(then, last[rows][:, None])], then <= last[rows][:, None]

    def loss(seen: np.ndarray, own: np.ndarray, right: np.ndarray, there: np.ndarray) -> Any:
        told = net(torch.from_numpy(seen), torch.from_numpy(own)).reshape(right.shape)
        off = functional.smooth_l1_loss(told, torch.from_numpy(right), beta=0.1, reduction="none")
        return off[torch.from_numpy(there)].mean()

    def figures() -> dict[str, float]:
        rows = np.flatnonzero(held)[::5]
        with torch.no_grad():
            return {"loss": float(loss(objects[rows], hand[rows], *ahead(rows)))}

    def batches() -> Iterator[Any]:
        while True:
            rows = rng.choice(rows_of, 256)
            own, (right, there) = hand[rows].copy(), ahead(rows)
            across = own.reshape(-1, 3, 3)[:, :, :2]
            seen, across, wanted = turned(objects[rows], rng, across, right[:, :, :2])
            own.reshape(-1, 3, 3)[:, :, :2] = across
            right[:, :, :2] = wanted
            yield loss(seen, own, right, there)

    fit(net, batches(), figures, out, minutes, 256)
    empty = torch.zeros(1, MOST, WIDTH), torch.zeros(1, hand.shape[1])
    write(net, out, empty, ["objects", "arm"])


def transformer(chunk: int, arm: int) -> Any:
    """Objects (b, MOST, WIDTH) and ``arm`` further numbers to ``chunk`` velocities (b, 3 chunk)."""
    import torch
    from torch import nn

    torch.backends.mha.set_fastpath_enabled(False)  # it has no ONNX

    class Transformer(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            wide = 96
            self.each = nn.Sequential(nn.Linear(WIDTH, wide), nn.ReLU(), nn.Linear(wide, wide))
            self.own = nn.Sequential(nn.Linear(arm, wide), nn.ReLU(), nn.Linear(wide, wide))
            kind = {"dim_feedforward": 2 * wide, "dropout": 0.0, "batch_first": True}
            see = nn.TransformerEncoderLayer(wide, 4, **kind)
            self.see = nn.TransformerEncoder(see, 2, enable_nested_tensor=False)
            self.do = nn.TransformerDecoder(nn.TransformerDecoderLayer(wide, 4, **kind), 1)
            self.asks = nn.Parameter(torch.randn(chunk, wide))
            self.tell = nn.Linear(wide, 3)

        def forward(self, objects: Any, own: Any) -> Any:
            none = objects[:, :, 13:].sum(-1) < 0.5
            none = torch.cat([torch.zeros_like(none[:, :1]), none], 1)
            scale = torch.ones(WIDTH)
            scale[:3] = scale[6:9] = scale[12] = SCALE
            tokens = torch.cat([self.own(own)[:, None], self.each(objects * scale)], 1)
            seen = self.see(tokens, src_key_padding_mask=none)
            asks = self.asks + torch.zeros_like(tokens[:, :1])  # for each of the batch
            return self.tell(self.do(asks, seen, memory_key_padding_mask=none)).flatten(1)

    return Transformer()


def fit(
    net: Any, batches: Iterator[Any], figures: Callable[[], dict[str, float]], out: Path,
    minutes: float, size: int,
) -> None:  # fmt: skip
    """Descend for some minutes; the curve goes to a CSV file, the best held-out loss is kept."""
    import copy

    import torch

    best = torch.optim.AdamW(net.parameters(), lr=1e-3, weight_decay=1e-4)
    began, step, rows = time.time(), 0, []
    told, kept = 0.0, net.state_dict()
    while (gone := (time.time() - began) / 60.0) < minutes:
        for group in best.param_groups:
            group["lr"] = 1e-3 * (1.0 - gone / minutes) + 1e-6
        best.zero_grad()
        next(batches).backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        best.step()
        step += 1
        if gone - told > minutes / 40.0 or step == 1:
            told = gone
            rows.append({"minutes": round(gone, 2), "samples": step * size, **figures()})
            print(rows[-1], flush=True)
            if rows[-1]["loss"] <= min(row["loss"] for row in rows):
                kept = copy.deepcopy(net.state_dict())
    net.load_state_dict(kept)
    curve(out, rows)


def curve(out: Path, rows: list[dict[str, Any]]) -> None:
    """The learning curve beside the weights."""
    out.parent.mkdir(parents=True, exist_ok=True)
    with out.with_suffix(".csv").open("w", newline="") as stream:
        table = csv.DictWriter(stream, list(rows[-1]))
        table.writeheader()
        table.writerows({k: round(v, 5) for k, v in row.items()} for row in rows)


def write(net: Any, out: Path, empty: tuple[Any, ...], names: list[str]) -> None:
    """A network as ONNX, for batches of any size."""
    import torch

    net.eval()
    with warnings.catch_warnings():  # the new exporter needs one package more
        warnings.simplefilter("ignore", DeprecationWarning)
        warnings.simplefilter("ignore", torch.jit.TracerWarning)  # of checks of shapes
        torch.onnx.export(
            net, empty, str(out), input_names=names, output_names=["told"], dynamo=False,
            dynamic_axes={name: {0: "batch"} for name in (*names, "told")}, opset_version=17,
        )  # fmt: skip
    print(f"wrote {out}, {out.stat().st_size / 1e6:.2f} MB", flush=True)


def main() -> None:
    """See the module."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("what", choices=("plans", "set", "steps", "clone", "act"))
    ask.add_argument("data", nargs="?", type=Path)
    ask.add_argument("--seeds", default="200000:204000", metavar="A:B")
    ask.add_argument("--out", type=Path)
    ask.add_argument("--minutes", type=float, default=10.0)
    ask.add_argument("--presets", default=",".join(PRESETS), help="of scenes to learn from")
    told = ask.parse_args()
    presets = told.presets.split(",")
    seeds = range(*map(int, told.seeds.split(":")))
    if told.data is None:
        ask.error(f"{told.what} needs a folder of DATA")
    if told.what in ("plans", "steps"):
        {"plans": plans, "steps": steps}[told.what](told.data, seeds, presets)
        return
    out = told.out or ask.error(f"{told.what} needs --out FILE.onnx")
    if told.what == "set":
        train_set(told.data, out, told.minutes)
    else:
        train_steps(told.data, out, told.minutes, CHUNK if told.what == "act" else 1)


if __name__ == "__main__":
    main()
