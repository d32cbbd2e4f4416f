"""Train the small network of the eyes, and write it as ONNX.

    python scripts/train_eyes.py pictures --out DATA --seeds 65000:66000
    python scripts/train_eyes.py train DATA --out eyes.onnx [--shapes] [--minutes 45]

``pictures`` renders the training pictures: scenes of :data:`RECIPE` with leaves, light, colours and
errors of depth of their seeds. ``train`` trains on them, or, with ``--shapes``, on abstract shapes
made on the fly alone. The seed fixes weights and order; the time that training may take fixes how
far it gets. Needs the extra ``train``. One core.
"""

import argparse
import itertools
import math
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))  # as a module, too

from shapes import shapes

from optipromp.laboratory.generate import generate
from optipromp.laboratory.simulation.photograph import PhotoParameters, photograph
from optipromp.perception.network import CLASSES, FAR, encoded

RECIPE = (  # preset, looks, mount, share
    ("wild", "rich", "beside", 0.40), ("wild", "rich", "palm", 0.12),
    ("mixed", "rich", "beside", 0.14), ("mixed", "plain", "beside", 0.06),
    ("field", "rich", "beside", 0.10), ("field", "plain", "palm", 0.10),
    ("cluster", "plain", "beside", 0.08),
)  # fmt: skip
WIDTH, HEIGHT, FOCAL = 320, 240, 240.0
MIXED = 0.25  # share of abstract shapes among the rendered pictures of training: a choice
CODE = {name: k for k, name in enumerate(CLASSES)}


def pictures(out: Path, seeds: range) -> None:
    """Render and keep what training needs."""
    out.mkdir(parents=True, exist_ok=True)
    small = PhotoParameters(width=WIDTH, height=HEIGHT, focal=FOCAL)
    for seed in seeds:
        file = out / f"{seed}.npz"
        if file.exists():
            continue
        at = np.random.default_rng([seed, 38]).choice(len(RECIPE), p=[row[3] for row in RECIPE])
        preset, looks, mount, _ = RECIPE[at]
        shot = photograph(generate(preset, seed), mount, seed, small, looks=looks)  # type: ignore[arg-type]
        kinds, instances = truth(shot.masks, shot.marked)
        np.savez_compressed(
            file, rgb=shot.picture.rgb, depth=shot.picture.depth.astype(np.float16),
            kinds=kinds, instances=instances,
        )  # fmt: skip
        print(seed, preset, looks, mount, flush=True)


def truth(masks: np.ndarray, marked: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Class and fruit (0: none) of every pixel."""
    kinds = np.zeros(256, dtype=np.uint8)
    instances = np.zeros(256, dtype=np.uint8)
    for row, each in enumerate(marked, start=1):
        kinds[row] = CODE.get(each.kind, 0)
        instances[row] = row if each.kind in ("ripe", "unripe") else 0
    return kinds[masks], instances[masks]


def samples(data: Path | None, seed: int) -> Iterator[tuple[np.ndarray, ...]]:
    """Pictures without end: inputs (5, H, W), classes, offsets to the fruit's middle, weights."""
    rng = np.random.default_rng([seed, 39])
    files: list[Path] = []
    for k in itertools.count():
        if data is not None and k % 200 == 0:
            files = sorted(data.glob("*.npz"))  # more may have come
        if data is None or rng.random() < MIXED:
            drawn = shapes(1_000_000 + k, WIDTH, HEIGHT)
            kinds, instances = truth(drawn.masks, drawn.marked)
            rgb, depth = drawn.picture.rgb, drawn.picture.depth
        else:
            held = np.load(files[int(rng.integers(len(files)))])
            rgb, depth, kinds, instances = (held[n] for n in ("rgb", "depth", "kinds", "instances"))
        yield changed(rgb, depth.astype(np.float32), kinds, instances, rng)


def changed(
    rgb: np.ndarray, depth: np.ndarray, kinds: np.ndarray, instances: np.ndarray,
    rng: np.random.Generator,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """A sample, mirrored, with other light, and holes in its depth."""
    if rng.random() < 0.5:
        rgb, depth, kinds, instances = (a[:, ::-1] for a in (rgb, depth, kinds, instances))
    light = rng.uniform(0.6, 1.5) * np.exp(0.08 * rng.standard_normal(3))
    bent = 255.0 * (rgb / 255.0) ** rng.uniform(0.7, 1.4)
    rgb = np.clip(bent * light + 3.0 * rng.standard_normal(rgb.shape), 0, 255)
    depth = depth.copy()
    if rng.random() < 0.3:  # a hole
        r, c = rng.integers([HEIGHT, WIDTH])
        depth[r : r + int(rng.integers(4, 40)), c : c + int(rng.integers(4, 40))] = 0.0
    offsets = np.zeros((2, HEIGHT, WIDTH), dtype=np.float32)
    rows, columns = np.indices(kinds.shape)
    for each in np.unique(instances[instances > 0]):
        mine = instances == each
        r, c = rows[mine], columns[mine]
        middle = 0.5 * (c.min() + c.max()), 0.5 * (r.min() + r.max())
        offsets[0][mine], offsets[1][mine] = middle[0] - c, middle[1] - r
    return encoded(rgb, depth), kinds.astype(np.int64), offsets, instances > 0


def network():
    """A U-net of 0.3 million weights with separable convolutions at a half of the picture."""
    import torch
    from torch import nn

    def block(inputs: int, outputs: int) -> nn.Sequential:
        return nn.Sequential(
            nn.Conv2d(inputs, outputs, 3, padding=1, bias=False), nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
            nn.Conv2d(outputs, outputs, 3, padding=1, groups=outputs, bias=False),
            nn.Conv2d(outputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )  # fmt: skip

    class Net(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            sizes = 16, 28, 56, 112
            self.stem = nn.Sequential(
                nn.Conv2d(5, sizes[0], 3, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(sizes[0]), nn.ReLU(inplace=True),
            )  # fmt: skip
            self.down = nn.ModuleList(
                block(a, b) for a, b in itertools.pairwise((sizes[0], *sizes[1:]))
            )
            self.up = nn.ModuleList(block(a + b, b) for a, b in itertools.pairwise(sizes[::-1]))
            self.head = nn.Conv2d(sizes[0], (len(CLASSES) + 2) * 4, 1)
            self.fine = nn.PixelShuffle(2)
            self.pool = nn.MaxPool2d(2)

        def forward(self, x):
            x = self.stem(x)
            kept = [x]
            for each in self.down:
                x = each(self.pool(x))
                kept.append(x)
            kept.pop()
            for each in self.up:
                x = nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")
                x = each(torch.cat([x, kept.pop()], dim=1))
            return self.fine(self.head(x))

    return Net()


def ripeness(told, kinds, fruit):
    """Cross entropy of ripe against unripe in fruits, each counting one half.

    Ripe pixels are one in a hundred: in the loss of all classes they weigh too little to be learnt.
    """
    import torch

    right = kinds[fruit] - CODE["ripe"]
    counts = torch.bincount(right, minlength=2).clamp(min=1)
    each = torch.nn.functional.cross_entropy(
        told.permute(0, 2, 3, 1)[fruit], right, reduction="none"
    )
    return (each / counts[right]).sum() / 2.0


def train(
    data: Path | None, out: Path, minutes: float, seed: int, start: Path | None, batch: int = 8
) -> None:
    """Train for so many minutes, from weights or from none, and write the network."""
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    net = network()
    if start is not None:
        net.load_state_dict(torch.load(start))
    print(sum(p.numel() for p in net.parameters()), "weights", flush=True)
    weights = torch.tensor([0.3, 2.0, 1.5, 1.5, 2.0, 1.0, 0.5])
    optimiser = torch.optim.AdamW(net.parameters(), lr=2e-3, weight_decay=1e-4)
    feed, began, lost, step = samples(data, seed), time.process_time(), [], 0
    end = began + 60.0 * minutes
    while (now := time.process_time()) < end:
        share = (now - began) / (60.0 * minutes)
        for group in optimiser.param_groups:
            group["lr"] = (
                2e-3 * min(1.0, step / 100) * 0.5 * (1.0 + math.cos(math.pi * share)) + 1e-5
            )
        parts = [np.stack(part) for part in zip(*(next(feed) for _ in range(batch)), strict=True)]
        inputs, kinds, offsets, fruit = (torch.from_numpy(part) for part in parts)
        told = net(inputs)
        of_kind = torch.nn.functional.cross_entropy(told[:, : len(CLASSES)], kinds, weights)
        off = (told[:, len(CLASSES) :] - offsets / FAR).abs().sum(dim=1)
        of_place = (off * fruit).sum() / fruit.sum().clamp(min=1)
        loss = of_kind + of_place + ripeness(told[:, 1:3], kinds, fruit)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
        lost.append((float(of_kind.detach()), float(of_place.detach())))
        step += 1
        if step % 50 == 0:
            kind, place = np.mean(lost[-50:], axis=0)
            print(f"{step} {(now - began) / 60:.1f} min {kind:.4f} {place:.4f}", flush=True)
    torch.save(net.state_dict(), out.with_suffix(".pt"))
    net.eval()
    torch.onnx.export(
        net, (torch.zeros(1, 5, HEIGHT, WIDTH),), str(out), input_names=["picture"],
        output_names=["told"], opset_version=17, dynamo=False,
    )  # fmt: skip
    print(f"wrote {out}, {out.stat().st_size / 1e6:.2f} MB, {step} steps of {batch}")


def main() -> None:
    """Render or train."""
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    draw = commands.add_parser("pictures")
    draw.add_argument("--out", type=Path, required=True)
    draw.add_argument("--seeds", default="65000:66000", metavar="A:B")
    learn = commands.add_parser("train")
    learn.add_argument("data", type=Path, nargs="?")
    learn.add_argument("--out", type=Path, required=True)
    learn.add_argument("--shapes", action="store_true")
    learn.add_argument("--minutes", type=float, default=45.0)
    learn.add_argument("--seed", type=int, default=0)
    learn.add_argument("--start", type=Path, metavar="FILE.pt", help="weights to go on from")
    given = parser.parse_args()
    if given.command == "pictures":
        pictures(given.out, range(*map(int, given.seeds.split(":"))))
    else:
        data = None if given.shapes else given.data
        train(data, given.out, given.minutes, given.seed, given.start)


if __name__ == "__main__":
    main()
