"""A second renderer: plants that no scene file describes, drawn by Mitsuba, with their truth.

    python scripts/garden.py --seeds 0:1000 --out DATA

Shapes, materials, leaves, light, lens and sensor are its own: nothing is shared with the renders of
``optipromp render`` but the model of a stereo camera's errors. A picture holds fruits on bowed
stems before gutters, walls, film or foliage, and things that are no fruit: hands, tape, flowers,
pipes. Cameras are 0.08 to 0.8 m away with focal lengths of 380 to 950 pixels; a picture is drawn at
the scale at which the network sees it. Every number here is a choice. Needs Mitsuba (extra
``train``) and LLVM's library (Debian: libllvm15).
"""

import argparse
import json
import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from garden_meshes import bowed, frame, fruit_mesh, green, leaf_mesh, slab, smooth, spin, tube, unit
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial import ConvexHull

from optipromp_sim.simulation.photograph import StereoParameters, sensed

KINDS = "none", "ripe", "unripe", "calyx", "stem", "leaf", "static"
SCALE = 1200.0  # [pixel/m] at which the network sees a fruit of 17 mm
WIDE, HIGH = 640, 480  # [pixel] of the camera
MOST = 1.6  # largest factor by which a picture grows
DYES = np.array([
    [0.5, 0.02, 0.02], [0.55, 0.15, 0.02], [0.05, 0.1, 0.5], [0.1, 0.4, 0.1], [0.6, 0.5, 0.05]
])  # fmt: skip
ATTRIBUTES = "rough", "color"  # of the mesh's corners


class Item(NamedTuple):
    """A mesh with colours of its corners: its kind, the fruit it is or belongs to."""

    kind: str
    fruit: int  # from 1; 0: none
    points: np.ndarray  # (N, 3) [m], z up
    faces: np.ndarray  # (M, 3)
    colours: np.ndarray  # (N, 3) linear, 0 to 1
    rough: float


class Fruit(NamedTuple):
    """The truth of a fruit."""

    kind: str
    center: np.ndarray  # (3,) [m], z up
    axis: np.ndarray  # (3,) to its stem
    radius: float
    half: float
    stem: np.ndarray  # (K, 3) from the fruit on
    thick: float  # radius of the stem [m]


class Garden:
    """A scene that grows by its seed."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = np.random.default_rng([seed, 61])
        self.items: list[Item] = []
        self.fruits: list[Fruit] = []
        self.crop = "tomato" if rng.random() < 0.2 else "strawberry"
        self.layout = rng.choice(["gutter", "lab", "truss", "bed"], p=[0.45, 0.2, 0.25, 0.1])
        self.gutter_y = rng.uniform(0.0, 0.05)
        self._ground()
        self._plants()
        self._leaves()
        self._things()

    def add(self, kind, mesh, colours, at=None, turn=None, fruit=0, rough=None) -> None:
        """Add a mesh, turned and placed."""
        points, faces = mesh
        points = points if turn is None else points @ np.asarray(turn).T
        points = points if at is None else points + at
        colours = np.broadcast_to(np.clip(colours, 0.003, 0.95), points.shape)
        rough = self.rng.uniform(0.15, 0.6) if rough is None else rough
        self.items.append(Item(kind, fruit, points, faces, colours, rough))

    def turned(self) -> np.ndarray:
        """Any rotation."""
        q, _ = np.linalg.qr(self.rng.standard_normal((3, 3)))
        return q * np.sign(np.linalg.det(q))

    def _textured(self, points: np.ndarray, base: np.ndarray) -> np.ndarray:
        rng = self.rng
        wave = sum(
            np.sin(points @ rng.normal(0, f, 3) + rng.uniform(0, 6.3)) / (k + 1)
            for k, f in enumerate((30.0, 80.0, 200.0))
        )
        return np.clip(base * (1.0 + rng.uniform(0.0, 0.25) * wave[:, None]), 0.003, 0.95)

    def _ground(self) -> None:
        """What is behind and above the fruits: y points away from the camera."""
        rng = self.rng
        whites = [np.full(3, rng.uniform(0.5, 0.9)), np.full(3, rng.uniform(0.02, 0.1)),
                  rng.uniform(0.1, 0.8, 3), np.array([0.3, 0.2, 0.12]) * rng.uniform(0.3, 1.5),
                  green(rng)]  # fmt: skip
        if rng.random() < 0.75 or self.layout == "lab":  # a wall
            colour = whites[rng.choice(5, p=[0.4, 0.15, 0.2, 0.15, 0.1])]
            away = rng.uniform(0.04, 0.25) if self.layout == "lab" else rng.uniform(0.15, 1.0)
            mesh = slab(np.array([3.0, 0.01, 3.0]), 40)
            self.add("static", mesh, self._textured(mesh[0], colour), at=[0, away, 0])
        if self.layout == "gutter":
            colour = whites[rng.choice(5, p=[0.55, 0.15, 0.1, 0.15, 0.05])]
            size = np.array([2.0, rng.uniform(0.08, 0.25), rng.uniform(0.06, 0.2)])
            mesh = slab(size, 20)
            self.top = rng.uniform(0.02, 0.12)
            back = 0.5 * size[1] + self.gutter_y
            place = [0, back, self.top - 0.5 * size[2] + 0.02]
            self.add("static", mesh, self._textured(mesh[0], colour), at=place)
        else:
            self.top = rng.uniform(0.03, 0.2)
        if self.layout == "bed":
            colour = whites[rng.choice(5, p=[0.35, 0.35, 0.1, 0.2, 0.0])]
            mesh = slab(np.array([3.0, 3.0, 0.01]), 40)
            self.add("static", mesh, self._textured(mesh[0], colour), at=[0, 0, -0.03])

    def _fruit(self, at: np.ndarray, root: np.ndarray, radius: float) -> None:
        rng = self.rng
        ripeness = rng.uniform(0.68, 1.0) if rng.random() < 0.42 else rng.uniform(0.0, 0.42)
        kind = "ripe" if ripeness > 0.5 else "unripe"
        radius = radius * math.exp(0.12 * rng.standard_normal())
        radius = radius * (1.0 if ripeness > 0.5 else rng.uniform(0.6, 1.0))
        if self.crop == "strawberry":
            half = radius * rng.choice([1.05, 1.15, 1.25, 1.4, 1.7])
        else:
            half = radius * rng.uniform(0.85, 1.1)
        thick = rng.uniform(0.0007, 0.0028)
        bow = rng.uniform(-0.25, 0.25) if rng.random() < 0.7 else rng.uniform(-0.6, 0.6)
        lean = unit(root - at + 0.15 * np.linalg.norm(root - at) * rng.standard_normal(3))
        axis = unit(lean + 0.2 * rng.standard_normal(3))
        number = len(self.fruits) + 1
        turn = frame(axis)
        *mesh, colours = fruit_mesh(rng, ripeness, self.crop, radius, half)
        rough = rng.uniform(0.08, 0.45)
        self.add(kind, mesh, colours, at=at, turn=turn, fruit=number, rough=rough)
        neck = at + axis * half * 0.97
        line = bowed(neck, root, rng, bow)
        brown = rng.random() >= 0.8
        colour = np.array([0.35, 0.15, 0.06]) * rng.uniform(0.5, 1.4) if brown else green(rng)
        mesh = tube(line, thick * np.linspace(1.0, 1.15, len(line)))
        self.add("stem", mesh, self._textured(mesh[0], colour), fruit=number)
        self._calyx(neck, turn, radius)
        self.fruits.append(Fruit(kind, at, axis, radius, half, line, thick))

    def _calyx(self, neck: np.ndarray, turn: np.ndarray, radius: float) -> None:
        rng = self.rng
        count, long = int(rng.integers(5, 11)), rng.uniform(0.4, 1.0) * radius
        drop = rng.uniform(-0.6, 0.7)
        for k in range(count):
            points, faces, colours = leaf_mesh(rng, long * rng.uniform(0.7, 1.2))
            points = points * [1.0, 0.55, 1.0]
            a = 2 * np.pi * (k + 0.3 * rng.standard_normal()) / count
            c, s = math.cos(drop), math.sin(drop)
            tip = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
            self.add("calyx", (points, faces), colours, at=neck, turn=turn @ spin(a) @ tip)

    def _plants(self) -> None:
        rng = self.rng
        radius = rng.uniform(0.012, 0.022 if self.crop == "strawberry" else 0.034)
        clusters = int(rng.integers(1, 4))
        for c in range(clusters):
            x = 0.0 if c == 0 else rng.uniform(-0.25, 0.25)
            deep = rng.uniform(-0.03, 0.03) if c == 0 else rng.uniform(-0.05, 0.2)
            joint = np.array([x, deep + self.gutter_y, self.top])
            count = 1 if self.layout == "lab" and rng.random() < 0.5 else int(rng.integers(1, 8))
            taken: list[np.ndarray] = [f.center for f in self.fruits]
            for _ in range(count):
                for _try in range(20):
                    spread = radius * np.array([3.0, 1.6, 2.8])
                    at = np.array([x, deep, 0.0]) + rng.standard_normal(3) * spread
                    if self.layout == "bed":
                        at[2] = -0.03 + radius
                    apart = all(np.linalg.norm(at - t) > radius * 2.05 for t in taken)
                    if apart and at[2] < self.top - 0.01:
                        break
                else:
                    continue
                taken.append(at)
                root = joint + rng.standard_normal(3) * [0.02, 0.01, 0.008]
                if self.layout == "truss" and rng.random() < 0.7:
                    root = np.array([x, deep, at[2] + rng.uniform(0.02, 0.05)])
                if self.layout == "lab":
                    root = at + [*rng.normal(0, [0.02, 0.01]), rng.uniform(0.06, 0.25)]
                if self.layout == "bed":
                    root = at + [*rng.normal(0, 0.06, 2), rng.uniform(0.0, 0.05)]
                self._fruit(at, root, radius)
            if self.layout == "truss":  # the rachis
                low = np.array([x, deep, -3 * radius])
                line = bowed(joint + [0, 0, 0.1], low, rng, rng.uniform(-0.1, 0.1))
                mesh = tube(line, rng.uniform(0.0015, 0.004))
                self.add("stem", mesh, self._textured(mesh[0], green(rng)))

    def _leaves(self) -> None:
        rng = self.rng
        lush = rng.random() ** 1.5
        for _ in range(int(lush * 60)):  # behind and about
            at = rng.uniform([-0.5, 0.05, -0.3], [0.5, 0.5, 0.35])
            self._leaf(at, rng.uniform(0.03, 0.12))
        for _ in range(int(rng.integers(0, 4))):  # before
            at = rng.uniform([-0.12, -0.12, -0.08], [0.12, 0.0, 0.12])
            self._leaf(at, rng.uniform(0.015, 0.06))
        for _ in range(int(rng.integers(0, 7))):  # petioles, runners
            begin = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.06, 0.2), self.top + 0.05])
            end = begin + [rng.normal(0, 0.1), rng.normal(0, 0.05), -rng.uniform(0.05, 0.3)]
            mesh = tube(bowed(begin, end, rng, rng.uniform(-0.3, 0.3)), rng.uniform(0.0007, 0.003))
            self.add("stem", mesh, self._textured(mesh[0], green(rng)))

    def _leaf(self, at: np.ndarray, size: float) -> None:
        rng = self.rng
        turn = self.turned()
        for a in (-1.2, 0.0, 1.2) if rng.random() < 0.6 else (0.0,):
            points, faces, colours = leaf_mesh(rng, size)
            self.add("leaf", (points, faces), colours, at=at, turn=turn @ spin(a), rough=0.4)

    def _near(self) -> np.ndarray:
        """A place among the fruits."""
        return self.rng.uniform([-0.15, -0.06, -0.12], [0.15, 0.12, 0.12])

    def _things(self) -> None:
        """What is no fruit: hands, tape, flowers, pipes, balls of other colours."""
        rng = self.rng
        if rng.random() < 0.18:
            self._hand()
        for _ in range(int(rng.integers(0, 3)) if rng.random() < 0.3 else 0):  # tape, labels
            colour = DYES[rng.integers(5)] * rng.uniform(0.5, 1.4)
            mesh = slab(np.array([rng.uniform(0.02, 0.15), 0.001, rng.uniform(0.01, 0.05)]), 4)
            at = self._near() + [0, 0.04, 0]
            turn = frame(rng.standard_normal(3) * 0.3 + [0, 0, 1.0])
            self.add("none", mesh, colour, at=at, turn=turn)
        for _ in range(int(rng.integers(0, 5)) if rng.random() < 0.35 else 0):
            self._flower()
        if rng.random() < 0.25:  # pipes, posts, cables, red ones among them
            begin = self._near() + [0, 0.08, 0]
            way = unit(rng.standard_normal(3)) * 0.6
            colour = DYES[0] if rng.random() < 0.3 else rng.uniform(0.02, 0.8, 3)
            mesh = tube(np.linspace(begin - way, begin + way, 4), rng.uniform(0.002, 0.02), 14)
            self.add("none", mesh, colour)
        if rng.random() < 0.12:  # a cup or finger of a gripper
            line = np.linspace([0, -0.2, -0.12], self._near() - [0, 0.03, 0.05], 4)
            mesh = tube(line, rng.uniform(0.01, 0.03), 16)
            self.add("static", mesh, rng.uniform(0.02, 0.8, 3))

    def _hand(self) -> None:
        rng = self.rng
        tone = np.array([0.55, 0.28, 0.18]) * rng.uniform(0.12, 1.3)
        tone = tone * [1.0, rng.uniform(0.85, 1.15), rng.uniform(0.8, 1.2)]
        palm = self._near() + [0, 0.03, -0.02]
        arm = palm + unit(rng.standard_normal(3) + [0, -0.5, -1.0]) * 0.4
        parts = [(np.linspace(palm, arm, 6), np.linspace(0.035, 0.045, 6))]
        ahead = unit(palm - arm)
        aside = unit(np.cross(ahead, rng.standard_normal(3)))
        for k in range(5):
            root = palm + aside * 0.018 * (k - 2)
            mid = root + 0.04 * unit(ahead + 0.3 * rng.standard_normal(3))
            tip = mid + 0.04 * unit(ahead + 0.8 * rng.standard_normal(3))
            line = np.array([root, mid, 0.5 * (mid + tip), tip])
            parts.append((line, np.array([0.0095, 0.009, 0.008, 0.005])))
        for line, radius in parts:
            mesh = tube(line, radius, 16)
            colours = self._textured(mesh[0], tone)
            self.add("none", mesh, colours, rough=rng.uniform(0.3, 0.6))

    def _flower(self) -> None:
        rng = self.rng
        at, turn = self._near(), self.turned()
        for k in range(5):
            points, faces, _ = leaf_mesh(rng, rng.uniform(0.007, 0.013))
            a = 2 * np.pi * k / 5
            petal, white = (points * [1.0, 1.8, 1.0], faces), np.full(3, rng.uniform(0.7, 0.9))
            self.add("none", petal, white, at=at, turn=turn @ spin(a))
        points, faces, _ = fruit_mesh(rng, 0.0, "tomato", 0.004, 0.002)
        self.add("none", (points, faces), np.array([0.6, 0.45, 0.05]), at=at, turn=turn)


def lens(rng: np.random.Generator, garden: Garden) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Place and axes (3, 3; right, down, forward) of the camera, its focal length at 640 pixels,
    and the median depth of the fruits."""
    focal = math.exp(rng.uniform(math.log(380.0), math.log(950.0)))
    away = math.exp(rng.uniform(math.log(0.09), math.log(0.75)))
    low, high = (0.3, 1.2) if garden.layout == "bed" else (-0.5, 0.45)
    pitch, yaw = rng.uniform(low, high), rng.uniform(-0.6, 0.6)
    back = np.array(
        [math.sin(yaw) * math.cos(pitch), -math.cos(yaw) * math.cos(pitch), math.sin(pitch)]
    )
    some = rng.random() < 0.8
    chosen = garden.fruits[rng.integers(len(garden.fruits))].center if some else np.zeros(3)
    aim = chosen + rng.standard_normal(3) * 0.25 * away * np.array([320 / focal, 0.1, 240 / focal])
    place = aim + away * back
    forward = unit(aim - place)
    right = unit(np.cross(forward, [0.0, 0.0, 1.0]))
    roll = rng.normal(0.0, 0.12)
    c, s, down = math.cos(roll), math.sin(roll), np.cross(forward, right)
    right, down = c * right + s * down, c * down - s * right
    depths = [(f.center - place) @ forward for f in garden.fruits]
    depths = [d for d in depths if d > 0.05] or [away]
    return place, np.column_stack([right, down, forward]), focal, float(np.percentile(depths, 35))


def drawn(seed: int, native: bool = False) -> dict[str, np.ndarray]:
    """A picture of the garden of a seed: rgb, depth, kinds, instances, and the truth as JSON;
    ``native``: of 640 x 480 pixels, as the camera takes it."""
    import mitsuba as mi

    rng = np.random.default_rng([seed, 62])
    garden = Garden(seed)
    while not garden.fruits:
        seed += 1_000_003
        garden = Garden(seed)
    place, axes, focal, near = lens(rng, garden)
    k = min(max(SCALE * near / focal, 1 / 4.0), MOST)  # how much larger than the camera's picture
    k = 1.0 if native else k
    drawing = min(k, 1.0)
    width, height = (max(round(side * drawing / 16) * 16, 96) for side in (WIDE, HIGH))
    f = focal * drawing
    owner = np.repeat(np.arange(len(garden.items)), [len(item.faces) for item in garden.items])
    scene: dict[str, Any] = {
        "type": "scene", "integrator": {"type": "path", "max_depth": 3},
        "all": _mesh(mi, garden.items),
    }  # fmt: skip
    scene.update(_lights(mi, rng))
    to_world = np.eye(4)
    to_world[:3, 0], to_world[:3, 1], to_world[:3, 2] = -axes[:, 0], -axes[:, 1], axes[:, 2]
    to_world[:3, 3] = place
    scene["sensor"] = {
        "type": "perspective", "fov": 2 * math.degrees(math.atan(0.5 * width / f)), "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(to_world), "near_clip": 0.01, "far_clip": 100.0,
        "film": {"type": "hdrfilm", "width": width, "height": height, "rfilter": {"type": "box"},
                 "pixel_format": "rgb"},
        "sampler": {"type": "independent", "sample_count": 16, "seed": seed % 2**31},
    }  # fmt: skip
    world = mi.load_dict(scene)
    light = np.array(mi.render(world, seed=seed % 2**31))
    columns, rows = np.meshgrid(np.arange(width), np.arange(height))
    ways = np.stack(
        [(columns - 0.5 * (width - 1)) / f, (rows - 0.5 * (height - 1)) / f, np.ones_like(rows)],
        axis=-1,
    )
    ways = ways.reshape(-1, 3)
    long = np.linalg.norm(ways, axis=1)
    out = (ways / long[:, None]) @ axes.T
    ray = mi.Ray3f(
        o=mi.Point3f(*[float(v) for v in place]),
        d=mi.Vector3f(*[np.ascontiguousarray(out[:, a], dtype=np.float32) for a in range(3)]),
    )
    hit = world.ray_intersect_preliminary(ray)
    reach = np.array(hit.t)
    depth = np.where(np.isfinite(reach), reach / long, 20.0).reshape(height, width)
    rows_hit = np.where(np.array(hit.is_valid()), np.array(hit.prim_index), 0)
    which = np.where(np.array(hit.is_valid()), owner[rows_hit], len(garden.items))
    which = which.reshape(height, width)
    kinds = np.array([KINDS.index(item.kind) for item in garden.items] + [0], dtype=np.uint8)[which]
    fruit, stems = (
        np.array([i.fruit * (i.kind in of) for i in garden.items] + [0], dtype=np.uint8)[which]
        for of in (KINDS[1:3], ("stem",))
    )
    balls = (i for i in garden.items if i.fruit and i.kind in KINDS[1:3])
    whole = {i.fruit: outline((i.points - place) @ axes, f) for i in balls}
    rgb = developed(light, rng)
    stereo = StereoParameters(
        baseline=0.018 * math.exp(rng.uniform(0.0, 1.2)), subpixel=rng.uniform(0.04, 0.12),
        window=rng.uniform(0.7, 1.6), scale=rng.uniform(0.0, 0.01), ragged=rng.uniform(0.3, 1.2),
        holes=rng.choice([0.005, 0.02, 0.1]),
    )  # fmt: skip
    measured = sensed(np.minimum(depth, 8.0), f, stereo, rng)
    if rng.random() < 0.15:  # registered from another camera: shadows at the edges
        shift = int(rng.integers(1, 3))
        measured = np.roll(measured, shift, axis=1)
    if rng.random() < 0.1:  # sparse
        kept = rng.random(measured.shape) < rng.uniform(0.2, 0.7)
        measured = np.where(kept, measured, 0.0)
    truth = {
        "focal": f, "seed": seed, "layout": str(garden.layout), "crop": garden.crop,
        "up": (axes.T @ [0.0, 0.0, 1.0]).tolist(),
        "fruits": [
            {
                "kind": each.kind, "center": (axes.T @ (each.center - place)).tolist(),
                "radius": each.radius, "half": each.half, "thick": each.thick,
                "stem": ((each.stem - place) @ axes).tolist(),
                "share": min(float((fruit == number).sum()) / whole[number], 1.0),
                "pixels": int((fruit == number).sum()), "stem_pixels": int((stems == number).sum()),
            }
            for number, each in enumerate(garden.fruits, start=1)
        ],
    }  # fmt: skip
    return {
        "rgb": rgb, "depth": measured.astype(np.float16), "kinds": kinds, "instances": fruit,
        "stems": stems, "truth": np.array(json.dumps(truth)), "grow": np.array(k / drawing),
        "focal": np.array(f),
    }  # fmt: skip


def outline(points: np.ndarray, focal: float) -> float:
    """Area [pixel] of the outline of points (N, 3) in the frame of the camera."""
    if points[:, 2].min() < 0.01:
        return math.inf
    return max(float(ConvexHull(focal * points[:, :2] / points[:, 2:]).volume), 1.0)


def _mesh(mi: Any, items: list[Item]) -> Any:
    """All as one mesh of one material, so that every picture runs the same kernel."""
    rough = np.concatenate([np.full(len(item.points), item.rough) for item in items])
    starts = np.cumsum([0, *(len(item.points) for item in items)])
    arrays = {
        "vertex_positions": np.concatenate([item.points for item in items]),
        "faces": np.concatenate([i.faces + at for i, at in zip(items, starts, strict=False)]),
        "color": np.concatenate([item.colours for item in items]),
    }
    props = mi.Properties()
    rougher, coloured = ({"type": "mesh_attribute", "name": f"vertex_{k}"} for k in ATTRIBUTES)
    skin = {
        "type": "principled", "specular": 0.45, "roughness": rougher, "base_color": coloured
    }  # fmt: skip
    props["mesh_bsdf"] = mi.load_dict({"type": "twosided", "nested": skin})
    mesh = mi.Mesh("all", len(rough), len(arrays["faces"]), props=props)
    flat = np.ascontiguousarray(arrays["color"], dtype=np.float32).ravel()
    mesh.add_attribute("vertex_color", 3, flat)
    mesh.add_attribute("vertex_rough", 1, np.ascontiguousarray(rough, dtype=np.float32))
    params = mi.traverse(mesh)
    points = np.ascontiguousarray(arrays["vertex_positions"], dtype=np.float32)
    params["vertex_positions"] = points.ravel()
    params["faces"] = np.ascontiguousarray(arrays["faces"], dtype=np.uint32).ravel()
    params.update()
    return mesh


def _lights(mi: Any, rng: np.random.Generator) -> dict[str, Any]:
    """A sky of any colours, and a sun or lamps."""
    sky = np.clip(1.0 + rng.uniform(0.1, 0.6) * smooth(rng, (16, 32), 2.0), 0.05, None)[..., None]
    tint = np.exp(0.12 * rng.standard_normal(3))
    chance = rng.random()
    if chance < 0.06:  # grow light
        tint = np.array([1.0, rng.uniform(0.1, 0.5), rng.uniform(0.5, 1.0)])
    elif chance < 0.12:  # warm or red
        tint = np.array([1.0, rng.uniform(0.3, 0.8), rng.uniform(0.15, 0.6)])
    sky = sky * tint * np.exp(0.1 * smooth(rng, (16, 32, 3), 3.0))
    bitmap, scale = mi.Bitmap(sky.astype(np.float32)), float(rng.uniform(0.2, 1.0))
    out: dict[str, Any] = {"sky": {"type": "envmap", "bitmap": bitmap, "scale": scale}}
    way = rng.standard_normal(3)
    way[1], way[2] = abs(way[1]) * rng.choice([1, 1, -1]), -abs(way[2]) - 0.2
    bright = rng.uniform(0.5, 4.0) if rng.random() < 0.6 else 1e-3
    power = bright * tint * np.exp(0.05 * rng.standard_normal(3))
    out["sun"] = {
        "type": "directional", "direction": mi.ScalarVector3f(*unit(way).tolist()),
        "irradiance": {"type": "rgb", "value": power.tolist()},
    }  # fmt: skip
    return out


def developed(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """The sensor's picture: exposure, curve, focus, grain."""
    light = np.clip(np.nan_to_num(light, posinf=20.0), 0.0, 20.0)
    light = gaussian_filter(light, (*[rng.uniform(0.2, 0.9)] * 2, 0.0))
    level = np.percentile(light.mean(axis=2), 60)
    light = light * (rng.uniform(0.12, 0.4) / max(level, 1e-3))
    if rng.random() < 0.5:  # white balance of the camera
        light = light / (light.mean(axis=(0, 1)) ** rng.uniform(0.2, 0.8))
        light = light * (rng.uniform(0.12, 0.4) / max(np.percentile(light.mean(axis=2), 60), 1e-3))
    out = np.where(
        light < 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-6) ** (1 / 2.4) - 0.055
    )
    grey = out.mean(axis=2, keepdims=True)
    out = grey + rng.uniform(0.75, 1.3) * (out - grey)
    out = 255.0 * out + rng.uniform(0.5, 5.0) * rng.standard_normal(out.shape)
    return np.clip(np.rint(out), 0, 255).astype(np.uint8)


def grown(held: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays of a picture, enlarged where its camera saw it smaller than the network does."""
    factor = float(held["grow"])
    if factor <= 1.01:
        return held
    height, width = (round(side * factor / 16) * 16 for side in held["depth"].shape)
    rows = (np.arange(height) + 0.5) * held["depth"].shape[0] / height - 0.5
    columns = (np.arange(width) + 0.5) * held["depth"].shape[1] / width - 0.5
    at = np.meshgrid(rows, columns, indexing="ij")
    near = tuple(np.rint(a).astype(int) for a in at)
    out = dict(held)
    out["focal"] = held["focal"] * height / held["depth"].shape[0]
    planes = np.moveaxis(held["rgb"].astype(float), -1, 0)
    drawn = [map_coordinates(plane, at, order=1, mode="nearest") for plane in planes]
    out["rgb"] = np.stack(drawn, axis=-1).astype(np.uint8)
    for name in ("depth", "kinds", "instances", "stems"):
        out[name] = held[name][near]
    return out


def main() -> None:
    """Draw and keep pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", default="0:10", metavar="A:B")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    import mitsuba as mi

    mi.set_variant("llvm_ad_rgb")
    given.out.mkdir(parents=True, exist_ok=True)
    for seed in range(*map(int, given.seeds.split(":"))):
        file = given.out / f"g{seed}.npz"
        if not file.exists():
            np.savez_compressed(file, **grown(drawn(seed)))
            print(seed, flush=True)


if __name__ == "__main__":
    main()
