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
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))  # as a module, too

from shapes import shapes

from optipromp.core.scenes.scene import Scene
from optipromp_eyes.network import BLANK, CLASSES, FAR, FINE, encoded
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import PhotoParameters, photograph

RECIPE = (  # preset, looks, mount, share
    ("wild", "rich", "beside", 0.40), ("wild", "rich", "palm", 0.12),
    ("mixed", "rich", "beside", 0.14), ("mixed", "plain", "beside", 0.06),
    ("field", "rich", "beside", 0.10), ("field", "plain", "palm", 0.10),
    ("cluster", "plain", "beside", 0.08),
)  # fmt: skip
FOCALS = 380.0, 640.0  # [pixel] of the cameras of rendered pictures
RADII = 0.0008, 0.003  # [m] of their stems
PART = 256  # [pixel] sides of the parts of pictures that training sees
LARGER = 0.55, 1.7  # by which parts are smaller and larger
MIXED = 0.15  # share of abstract shapes among the rendered pictures of training: a choice
CODE = {name: k for k, name in enumerate(CLASSES)}


def pictures(out: Path, seeds: range) -> None:
    """Render and keep what training needs."""
    out.mkdir(parents=True, exist_ok=True)
    for seed in seeds:
        file = out / f"{seed}.npz"
        if file.exists():
            continue
        rng = np.random.default_rng([seed, 38])
        at = rng.choice(len(RECIPE), p=[row[3] for row in RECIPE])
        preset, looks, mount, _ = RECIPE[at]
        camera = PhotoParameters(focal=float(rng.uniform(*FOCALS)), exposure=0.3, tint=0.12)
        radii = rng.uniform(*RADII, 64)
        scene = thinned(generate(preset, seed), radii)
        shot = photograph(scene, mount, seed, camera, looks=looks)  # type: ignore[arg-type]
        kinds, instances = truth(shot.masks, shot.marked)
        np.savez_compressed(
            file, rgb=shot.picture.rgb, depth=shot.picture.depth.astype(np.float16),
            kinds=kinds, instances=instances, focal=np.array(camera.focal),
        )  # fmt: skip
        print(seed, preset, looks, mount, flush=True)


def thinned(scene: Scene, radii: np.ndarray) -> Scene:
    """The scene with stems of other radii (K,) [m], each for the next fruit."""
    wide = iter(radii)
    return scene.each(
        lambda item: (
            item
            if item.stem is None
            else replace(item, stem=replace(item.stem, radius=float(next(wide))))
        )
    )


def truth(masks: np.ndarray, marked: tuple) -> tuple[np.ndarray, np.ndarray]:
    """Class and fruit (0: none) of every pixel."""
    kinds = np.zeros(256, dtype=np.uint8)
    instances = np.zeros(256, dtype=np.uint8)
    for row, each in enumerate(marked, start=1):
        kinds[row] = CODE.get(each.kind, 0)
        instances[row] = row if each.kind in ("ripe", "unripe") else 0
    return kinds[masks], instances[masks]


def samples(data: Path | None, seed: int) -> Iterator[tuple[np.ndarray, ...]]:
    """Parts of pictures without end: inputs (5, S, S), classes and weights (S/2, S/2) of fruits,
    offsets to the fruit's middle (2, S/2, S/2)."""
    rng = np.random.default_rng([seed, 39])
    files: list[Path] = []
    kept: dict[Path, tuple] = {}
    for k in itertools.count():
        if data is not None and k % 500 == 0:
            files = sorted(
                f for f in data.glob("*.npz") if f.stat().st_mtime < time.time() - 5
            )  # more may have come
        if data is None or rng.random() < MIXED:
            drawn = shapes(1_000_000 + k, 320, 240)
            kinds, instances = truth(drawn.masks, drawn.marked)
            picture = drawn.picture
            held = picture.rgb, picture.depth, kinds, instances, picture.camera.fx
        else:
            file = files[int(rng.integers(len(files)))]
            if file not in kept:
                with np.load(file) as arrays:
                    names = "rgb", "depth", "kinds", "instances", "focal"
                    kept[file] = tuple(arrays[name] for name in names)
            held = kept[file]
        yield changed(*held, rng)


def changed(
    rgb: np.ndarray, depth: np.ndarray, kinds: np.ndarray, instances: np.ndarray, focal: float,
    rng: np.random.Generator,
) -> tuple[np.ndarray, ...]:  # fmt: skip
    """A part of a picture, larger or smaller, mirrored, in other light, with holes in its depth."""
    import cv2

    factor = math.exp(rng.uniform(*np.log(LARGER)))
    side = round(PART / factor)
    height, width = depth.shape
    fruits = np.argwhere(instances > 0)
    if len(fruits) and rng.random() < 0.75:  # most parts show a fruit
        row, column = fruits[int(rng.integers(len(fruits)))] - rng.uniform(0.1, 0.9, 2) * side
    else:
        row, column = rng.uniform(-0.1, 1.0, 2) * [height - 0.8 * side, width - 0.8 * side]
    row, column = int(row), int(column)
    to = np.s_[max(row, 0) : row + side, max(column, 0) : column + side]
    about = (
        (max(-row, 0), max(row + side - height, 0)),
        (max(-column, 0), max(column + side - width, 0)),
    )
    cut = [
        np.pad(a[to], (*about, *((0, 0),) * (a.ndim - 2)), constant_values=fill)
        for a, fill in ((rgb, BLANK), (depth, 0), (kinds, 0), (instances, 0))
    ]
    if rng.random() < 0.5:
        cut = [a[:, ::-1] for a in cut]
    size = PART, PART
    small = cv2.INTER_AREA if factor < 1.0 else cv2.INTER_LINEAR
    rgb = cv2.resize(np.ascontiguousarray(cut[0]), size, interpolation=small).astype(np.float32)
    at = np.minimum(((np.arange(PART) + 0.5) / factor).astype(int), side - 1)
    depth, kinds, instances = (a[np.ix_(at, at)] for a in cut[1:])
    depth = depth.astype(np.float32)
    tint = np.exp(rng.choice([0.06, 0.25], p=[0.8, 0.2]) * rng.standard_normal(3))
    bent = 255.0 * (np.maximum(rgb, 0.0) / 255.0) ** rng.uniform(0.65, 1.5)
    rgb = bent * (rng.uniform(0.5, 1.5) * tint).astype(np.float32)
    if rng.random() < 0.3:
        rgb = cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.4, 1.4))
    grain = rng.uniform(0.5, 6.0) * rng.standard_normal(rgb.shape, dtype=np.float32)
    rgb = np.clip(rgb + grain, 0, 255)
    if rng.random() < 0.3:  # a hole
        r, c = rng.integers([PART, PART])
        depth[r : r + int(rng.integers(8, 80)), c : c + int(rng.integers(8, 80))] = 0.0
    if rng.random() < 0.05:  # no depth at all
        depth[:] = 0.0
    if rng.random() < 0.1:  # a surface whose light returns nothing
        depth[np.isin(kinds, [CODE["static"], CODE["none"]])] = 0.0
    seen = encoded(rgb, depth, float(focal) * factor)
    half = PART // FINE
    fine = instances[FINE // 2 :: FINE, FINE // 2 :: FINE]
    told = kinds[FINE // 2 :: FINE, FINE // 2 :: FINE].astype(np.int64)
    thin = (kinds == CODE["stem"]).reshape(half, FINE, half, FINE).any(axis=(1, 3))
    told[thin] = CODE["stem"]  # a thin stem is of every cell that it crosses
    fine = np.where(thin, 0, fine)
    offsets = np.zeros((2, half, half), dtype=np.float32)
    for each in np.unique(fine[fine > 0]):
        r, c = np.nonzero(fine == each)
        offsets[0][r, c], offsets[1][r, c] = (
            0.5 * (c.min() + c.max()) - c,
            0.5 * (r.min() + r.max()) - r,
        )
    return seen, told, offsets, fine > 0


def network():
    """A U-net of 0.5 million weights whose answer has half the rows and columns."""
    import torch
    from torch import nn

    def block(inputs: int, outputs: int, stride: int = 1) -> nn.Sequential:
        whole = stride > 1  # the way up is of separable convolutions
        first = (
            nn.Conv2d(inputs, outputs, 3, stride, padding=1, bias=False)
            if whole
            else nn.Conv2d(inputs, outputs, 1, bias=False)
        )
        return nn.Sequential(
            first, nn.BatchNorm2d(outputs), nn.ReLU(inplace=True),
            nn.Conv2d(outputs, outputs, 3, padding=1, groups=outputs, bias=False),
            nn.Conv2d(outputs, outputs, 1, bias=False), nn.BatchNorm2d(outputs),
            nn.ReLU(inplace=True),
        )  # fmt: skip

    class Net(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            sizes = 20, 40, 80, 128, 160
            self.stem = nn.Sequential(
                nn.Conv2d(5, sizes[0], 3, stride=2, padding=1, bias=False),
                nn.BatchNorm2d(sizes[0]), nn.ReLU(inplace=True),
            )  # fmt: skip
            self.down = nn.ModuleList(block(a, b, 2) for a, b in itertools.pairwise(sizes))
            self.deep = block(sizes[-1], sizes[-1])
            self.up = nn.ModuleList(block(a + b, b) for a, b in itertools.pairwise(sizes[::-1]))
            self.head = nn.Conv2d(sizes[0], len(CLASSES) + 2, 3, padding=1)

        def forward(self, x):
            def joined(block, x, kept):
                x = nn.functional.interpolate(x, scale_factor=2.0, mode="nearest")
                return block(torch.cat([x, kept], dim=1))

            return through(self, x, joined)

    return Net()


def through(net, x, joined):
    """What a network says of ``x``: down, then up by ``joined(block, x, kept)``."""
    x = net.stem(x)
    kept = [x]
    for each in net.down:
        x = each(x)
        kept.append(x)
    kept.pop()
    x = x + net.deep(x)
    for each in net.up:
        x = joined(each, x, kept.pop())
    return net.head(x)


def quick(net):
    """The trained network as another that says the same in three quarters of the time.

    On the way up, a convolution of one pixel is taken before its input is doubled, not after, and
    joins nothing: it is the sum of one of what comes up and one of what was kept.
    """
    import torch
    from torch import nn

    class Joined(nn.Module):
        def __init__(self, block: nn.Sequential, kept: int) -> None:
            super().__init__()
            whole, norm, *rest = block
            gain = norm.weight / torch.sqrt(norm.running_var + norm.eps)
            weight = (whole.weight * gain[:, None, None, None]).detach()
            outputs, inputs = weight.shape[:2]
            self.coarse = nn.Conv2d(inputs - kept, outputs, 1, bias=False)
            self.fine = nn.Conv2d(kept, outputs, 1)
            self.coarse.weight.data = weight[:, :-kept].clone()
            self.fine.weight.data = weight[:, -kept:].clone()
            self.fine.bias.data = (norm.bias - norm.running_mean * gain).detach()
            self.rest = nn.Sequential(*rest)

        def forward(self, x, kept):
            coarse = nn.functional.interpolate(self.coarse(x), scale_factor=2.0, mode="nearest")
            return self.rest(coarse + self.fine(kept))

    class Quick(nn.Module):
        def __init__(self) -> None:
            super().__init__()
            self.stem, self.down, self.deep, self.head = net.stem, net.down, net.deep, net.head
            self.up = nn.ModuleList(Joined(block, block[-2].num_features) for block in net.up)

        def forward(self, x):
            return through(self, x, lambda block, x, kept: block(x, kept))

    return Quick().eval()


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
    data: Path | None, out: Path, minutes: float, seed: int, start: Path | None, batch: int = 12
) -> None:
    """Train for so many minutes, from weights or from none, and write the network."""
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    net = network()
    if start is not None:
        net.load_state_dict(torch.load(start))
    print(sum(p.numel() for p in net.parameters()), "weights", flush=True)
    weights = torch.tensor([0.4, 2.0, 1.5, 1.2, 2.0, 0.8, 0.4])
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
        if step % 500 == 0:
            torch.save(net.state_dict(), out.with_suffix(".pt"))
        if step % 50 == 0:
            kind, place = np.mean(lost[-50:], axis=0)
            print(f"{step} {(now - began) / 60:.1f} min {kind:.4f} {place:.4f}", flush=True)
    torch.save(net.state_dict(), out.with_suffix(".pt"))
    write(net.eval(), out)
    print(f"wrote {out}, {out.stat().st_size / 1e6:.2f} MB, {step} steps of {batch}")


def write(net, out: Path) -> None:
    """Write a trained network as an ONNX file."""
    import torch

    torch.onnx.export(
        quick(net), (torch.zeros(1, 5, PART, PART),), str(out), input_names=["picture"],
        output_names=["told"], opset_version=17, dynamo=False,
        dynamic_axes={name: {2: "rows", 3: "columns"} for name in ("picture", "told")},
    )  # fmt: skip


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
