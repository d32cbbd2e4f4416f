"""Mutated input for the doors of cameras, detectors, calibrations, meshes and the benchmark."""

import csv
import io
import json
import socket
import struct
import threading
import zipfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tests.fuzzing import networks
from tests.fuzzing.changes import NUMBERS, WORDS, arrays_changed, changed, damaged, text_of, value
from tests.fuzzing.originals import CUBE, FACES
from tests.fuzzing.outcomes import Mutant

WIDE, HIGH = 96, 72  # [pixel]


@cache
def picture() -> Any:
    """A red ball before a green wall, as a small camera sees them: near, that it may be ripe."""
    from optipromp.core.scenes.pose import Pose
    from optipromp_eyes import CameraModel, DepthPicture

    camera = CameraModel(WIDE, HIGH, 150.0, 150.0, 47.5, 35.5, Pose([0.1, 0.0, 0.5]))
    off = np.hypot(*(camera.rays[:, :, k] for k in range(2)))
    ball = 0.25 - np.sqrt(np.maximum(0.02**2 - (0.25 * off) ** 2, 0.0))
    depth = np.where(off < 0.08, ball, 0.6)
    rgb = np.where((off < 0.08)[:, :, None], (200, 30, 30), (90, 140, 80)).astype(np.uint8)
    return DepthPicture(rgb, depth, camera)


def image(pixels: Any, kind: str, mode: str | None = None) -> bytes:
    from PIL import Image

    made, stream = Image.fromarray(pixels), io.BytesIO()
    (made if mode is None else made.convert(mode)).save(stream, kind)
    return stream.getvalue()


def chunks_changed(random: Random, content: bytes) -> bytes:
    """A PNG with one chunk changed, whose checksum is right."""
    parts, at = [], 8
    while at < len(content):
        (size,) = struct.unpack(">I", content[at : at + 4])
        parts.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    k = random.randrange(len(parts))
    kind, data = parts[k]
    match random.randrange(5):
        case 0 if kind == b"IHDR":
            size = random.choice([0, 1, 95, 30_000, 100_000, 2**31 - 1, 2**32 - 1])
            data = struct.pack(">I", size) + data[4:]
        case 1:
            data = damaged(random, data)
        case 2:
            parts.insert(k, (random.choice([b"zTXt", b"iCCP", b"PLTE", b"tRNS", b"acTL", b"fdAT"]),
                             b"a\0\0" + zlib.compress(bytes(10**random.randrange(8)))))  # fmt: skip
        case 3 if kind == b"IDAT":
            data = zlib.compress(bytes(random.choice([0, 100, 10**7])))
        case _:
            data = bytes(random.randrange(256) if random.random() < 0.1 else b for b in data)
    parts[k] = (kind, data) if parts[k][0] == kind else parts[k]
    return content[:8] + b"".join(
        struct.pack(">I", len(d)) + t + d + struct.pack(">I", zlib.crc32(t + d)) for t, d in parts
    )


@cache
def camera_files() -> dict[str, bytes]:
    from optipromp_eyes.pictures import picture_files

    return picture_files("a", picture())


def looked(folder: Path, depth: str = "a.depth.png", camera: str = "a.camera.json") -> str:
    """See the picture of a folder, as ``see`` does."""
    from optipromp.core.scenes.io import load_scene
    from optipromp_eyes import load_picture, look_at, seen_scene

    known = load_scene("scenario-3")
    shown = load_picture(folder / "a.rgb.png", folder / depth, folder / camera)
    sight = look_at(shown, up=known.up)
    assert all(np.isfinite(each.item.position).all() for each in sight.detections)
    seen_scene(sight, known)
    return "success"


def picture_file(random: Random) -> Mutant:
    files, name, shown = dict(camera_files()), "a.depth.png", picture()
    if random.random() < 0.5:
        name = "a.rgb.png"
        kind = random.choice(["PNG", "PNG", "TIFF", "JPEG", "BMP", "PPM", "GIF", "WEBP"])
        mode = random.choice(["RGB", "L"] if kind in ("JPEG", "PPM", "WEBP") else
                             ["RGB", "L", "P", "1"])  # fmt: skip
        content = image(shown.rgb, kind, mode)
    else:
        kind = random.choice(["PNG", "TIFF"])
        steps = np.round(shown.depth * 1e4)
        type_ = random.choice(["u2", "u2", "u1", "f4", "i4"] if kind == "TIFF" else ["u2", "u1"])
        content = image(steps.astype(type_), kind)
    draw = random.random()
    if draw < 0.4 and kind == "PNG":
        content = chunks_changed(random, content)
    elif draw < 0.9:
        content = damaged(random, content)
    files[name] = content
    return Mutant("picture", files, looked)


def depth_array(random: Random) -> Mutant:
    content = arrays_changed(random, {"depth": picture().depth})
    suffix = random.choice(["npz"] * 5 + ["npy"])
    if suffix == "npy":
        np.save(stream := io.BytesIO(), picture().depth)
        content = damaged(random, stream.getvalue())
    files = camera_files() | {f"d.{suffix}": content}
    return Mutant("depth array", files, lambda folder: looked(folder, f"d.{suffix}"))


def camera(random: Random) -> Mutant:
    document = changed(random, json.loads(camera_files()["a.camera.json"]))
    name, content = text_of(random, document)
    if random.random() < 0.2:
        content = damaged(random, content)
    files = camera_files() | {f"c.{name}": content}
    return Mutant("camera", files, lambda folder: looked(folder, camera=f"c.{name}"))


def network(random: Random) -> Mutant:
    sizes = [0, 1, 5, 9, 240, 320, 40_000, -1, 2**40]
    made = [
        networks.right, lambda: networks.cast(random.randrange(25)),
        lambda: networks.right(name=random.choice(["x", "", "ü"])),
        lambda: networks.right((1, random.choice([3, 5]), 240, 320), (1, 9, 120, 160)),
        lambda: networks.right(told=(1, random.choice([1, 7, 9, 10]), -3, -4)),
        lambda: networks.right(most=random.choice([1.0, 1e30, float("nan")])),
        lambda: networks.filled(random.choice([0.0, 1e30, float("nan")]),
                                *(random.choice(sizes) for _ in range(4))),
        lambda: networks.loop(always=random.random() < 0.5),
    ]  # fmt: skip
    content = random.choice(made)()
    if random.random() < 0.5:
        content = damaged(random, content)

    def act(folder: Path) -> str:
        from optipromp_eyes import ByNetwork, look_at

        look_at(picture(), finder=ByNetwork(folder / "n.onnx", seconds=3.0))
        return "success"

    return Mutant("network", {"n.onnx": content}, act)


def calibration(random: Random) -> Mutant:
    """Poses of pictures of a board, or where a tool was seen."""
    rows = [[0.1 * k, 0.2, 0.4 + 0.05 * (k % 3)] for k in range(6)]
    if random.random() < 0.5:
        entries = [{"camera": row, "position": [row[0], row[2], row[1]]} for row in rows]
    else:
        home = [0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.7]
        entries = [{"camera": row, "joints": [q + 0.1 * row[0] for q in home]} for row in rows]
    boards = random.random() < 0.3
    name, content = text_of(
        random, changed(random, {f"{k}.png": each for k, each in enumerate(entries)})
    )
    if random.random() < 0.2:
        content = damaged(random, content)

    def act(folder: Path) -> str:
        from optipromp import load_robot
        from optipromp_eyes import Board, by_tool, load_camera
        from optipromp_eyes.calibration import read_seen_tool, read_views

        model, robot = load_camera(folder / "a.camera.json")[0], load_robot("panda")
        if boards:
            board = Board("chessboard", 7, 5, 0.03)
            read_views(folder, folder / f"p.{name}", board, model, robot)
            return "success"
        found = by_tool(read_seen_tool(folder / f"p.{name}", robot), model)
        assert np.isfinite(found.sigma).all()
        return "success"

    views = {f"{k}.png": camera_files()["a.rgb.png"] for k in range(6)} if boards else {}
    return Mutant("calibration", camera_files() | views | {f"p.{name}": content}, act)


def message_changed(random: Random, item: Any) -> Any:
    """A copy of a message of ROS with one to three values changed."""
    for _ in range(random.choice([1, 1, 2, 3])):
        item = _one_changed(random, item)
    return item


def _one_changed(random: Random, item: Any) -> Any:
    if is_dataclass(item) and not isinstance(item, type):
        chosen = random.choice([f.name for f in fields(item) if f.name != "__msgtype__"])
        return replace(item, **{chosen: _one_changed(random, getattr(item, chosen))})
    if isinstance(item, list):
        k = random.randrange(len(item) + 1)
        if k == len(item):
            return item[:-1] if random.random() < 0.5 else item * 2
        return [*item[:k], _one_changed(random, item[k]), *item[k + 1 :]]
    if isinstance(item, np.ndarray):
        array = item.copy()
        if array.size and random.random() < 0.7:
            numbers = [float(n) for n in NUMBERS[:-3]] if array.dtype.kind == "f" else [0, 1, 200]
            array.flat[random.randrange(array.size)] = random.choice(numbers)
            return array
        return array[: random.randrange(array.size + 1)]
    if isinstance(item, float):
        return float(random.choice(NUMBERS[:-3]))
    if isinstance(item, str):
        return random.choice([*WORDS[:15], "rgb8", "bgra8", "16UC1", "32FC1", "mono16", "png",
                              "16UC1; compressedDepth png"])  # fmt: skip
    return random.choice([0, 1, 2, 7, 8, 71, 96, 255, 2**16, 2**31 - 1, max(int(item) - 1, 0)])


@cache
def heard() -> tuple[Any, ...]:
    """What nodes hear of frames, an arm, a scene and fruits, and a request."""
    from tests.ros import looks
    from tests.ros.camera_messages import frames, header, sent

    from optipromp import load_scene
    from optipromp.core.scenes.pose import Pose
    from optipromp_ros import collision_object, message, planning_scene

    scene, names = load_scene("scenario-3"), [f"joint{k}" for k in range(1, 8)]
    state = {"name": names, "position": scene.start, "velocity": np.zeros(7)}
    kinds = "joint", "position", "orientation"
    goals = {f"{k}_constraints": [message(f"moveit_msgs/msg/{k.title()}Constraint")] for k in kinds}
    three = [message("moveit_msgs/msg/Constraints", **{k: v}) for k, v in goals.items()]
    items = (
        frames(looks.EPOCH, ("link7", "camera", Pose()), ("link0", "link7", Pose())),
        message("sensor_msgs/msg/JointState", header=header(looks.EPOCH), **state),
        planning_scene(scene), collision_object(scene.objects[1]),
        looks.array(looks.seen("ripe", (0, 0, 0.5)), looks.seen("unripe", (0.05, 0, 0.5))),
        message("std_msgs/msg/Float64MultiArray", data=[0.1] * 7),
        message("moveit_msgs/msg/MotionPlanRequest", goal_constraints=three,
                allowed_planning_time=1e-6, max_velocity_scaling_factor=0.5),
    )  # fmt: skip
    return tuple(map(sent, items))


def messages(random: Random) -> Mutant:
    """To the planning service, the guard and the loop."""
    items = [message_changed(random, item) if random.random() < 0.4 else item for item in heard()]
    items += random.sample(items, 3)

    def act(folder: Path) -> str:
        from tests.ros.looks import EPOCH

        from optipromp import load_scene
        from optipromp.core.errors import OptiPrompError
        from optipromp_ros import GuardFilter, LiveScene, PickLoop, answer

        scene = load_scene("scenario-3")
        world, guard, loop = LiveScene.of(scene), GuardFilter(scene), PickLoop(scene)
        for item in items:
            for listen in (world.heard, guard.heard, lambda one, _: loop.heard(one)):
                with suppress(OptiPrompError):
                    world = listen(item, EPOCH) or world
        loop.tick(EPOCH), loop.status(), guard.tick(EPOCH), guard.status()
        answer(world, items[6], now=EPOCH)
        return "success"

    return Mutant("messages", {}, act)


def image_messages(random: Random) -> Mutant:
    from tests.ros import camera_messages as made

    shown = picture()
    steps = np.round(shown.depth * 1e3).astype(np.uint16)
    if random.random() < 0.3:
        items = [made.cloud(shown, 1)]
    else:
        bent = (0.1, 0.0, 0.0, 0.0, 0.0) if random.random() < 0.3 else ()
        items = [made.info(shown.camera, 1, bent)]
        if random.random() < 0.5:
            items += [made.image(shown.rgb, "rgb8", 1),
                      made.image(steps, "16UC1", 1) if random.random() < 0.5 else
                      made.image(shown.depth.astype(np.float32), "32FC1", 1)]  # fmt: skip
        else:
            kinds = ["16UC1", "32FC1", "16UC1 rvl", "32FC1 rvl", "16UC1 plain"]
            items += [made.compressed(shown.rgb, 1, "png"),
                      made.compressed(steps, 1, random.choice(kinds))]  # fmt: skip
            if random.random() < 0.5:
                items[-1].data = np.frombuffer(damaged(random, bytes(items[-1].data)), np.uint8)
    k = random.randrange(len(items))
    items[k] = message_changed(random, items[k])

    def act(folder: Path) -> str:
        from optipromp_eyes import look_at
        from optipromp_ros.images import Pictures

        taken = Pictures()
        names = "/c/camera_info", random.choice(["/c/image_raw", "/c/image_rect"]), "/c/depth"
        found = [taken.heard(name, item) for name, item in zip(names, items, strict=False)]
        for each in filter(None, found):
            look_at(each.picture())
        return "success"

    return Mutant("image messages", {}, act)


def bag(random: Random) -> Mutant:
    """A bag that is damaged, or one of messages that are changed."""
    name, content = random.choice(list(bags().items()))
    items = [message_changed(random, item) if random.random() < 0.2 else item for item in filmed()]
    which, chosen = random.randrange(4), random.choice(["c.mcap", name])

    def act(folder: Path) -> str:
        from optipromp.core.scenes.io import load_scene
        from optipromp_ros import Recorded, bag_pictures, load_recording, read_trajectory, write_bag
        from optipromp_ros.shadow import load_picks

        topics = "/info", "/colour", "/depth", "/tf", "/joint_states"
        told = [Recorded(t, item, 10**9) for t, item in zip(topics, items, strict=True)]
        write_bag(folder / "c.mcap", told)
        reads = (
            load_recording, read_trajectory, lambda of: list(bag_pictures(of, scene)),
            lambda of: load_picks(of, scene, gripper=None, marks=[]),
        )  # fmt: skip
        scene = load_scene("scenario-3")
        reads[which](folder / chosen)
        return "success"

    return Mutant("bag", {name: damaged(random, content)}, act)


@cache
def filmed() -> tuple[Any, ...]:
    """A picture, where the camera was, and the arm."""
    from tests.ros import camera_messages as made

    from optipromp.core.scenes.pose import Pose

    shown, state = picture(), heard()[1]
    steps = np.round(shown.depth * 1e3).astype(np.uint16)
    state = replace(state, header=made.header(10**9))
    return (
        made.info(shown.camera, 10**9), made.compressed(shown.rgb, 10**9, "png"),
        made.compressed(steps, 10**9, "16UC1"), made.frames(10**9, ("link7", made.FRAME, Pose())),
        state,
    )  # fmt: skip


@cache
def bags() -> dict[str, bytes]:
    from optipromp_ros import Recorded, write_bag

    items = [Recorded(f"/{k}", item, 10**9) for k, item in enumerate(filmed())]
    with TemporaryDirectory() as folder:
        write_bag(Path(folder) / "b.mcap", items)
        write_bag(Path(folder) / "b", items)
        (db3,) = (Path(folder) / "b").glob("*.db3") if (Path(folder) / "b").is_dir() else (None,)
        mcap = (Path(folder) / "b.mcap").read_bytes()
        return {"b.mcap": mcap, "b.db3": mcap if db3 is None else db3.read_bytes()}


def mesh(random: Random) -> Mutant:
    from trimesh import Trimesh
    from trimesh.exchange import obj, ply, stl

    cube = Trimesh(CUBE, FACES, process=False)
    name, content = random.choice([
        ("m.obj", obj.export_obj(cube).encode()), ("m.stl", stl.export_stl(cube)),
        ("m.ply", ply.export_ply(cube)), ("m.ply", ply.export_ply(cube, encoding="ascii")),
    ])  # fmt: skip
    if name == "m.stl" and random.random() < 0.3:
        content = stl.export_stl_ascii(cube).encode()
    content, cloud = damaged(random, content), name == "m.ply" and random.random() < 0.3

    def act(folder: Path) -> str:
        from optipromp.core.geometry.loading import load_cloud, load_mesh

        made: Any = load_cloud(folder / name, 0.01) if cloud else load_mesh(folder / name)
        assert np.isfinite(made.points if cloud else made.vertices).all()
        return "success"

    return Mutant("mesh", {name: content}, act)


def cloud(random: Random) -> Mutant:
    """A point cloud as an array or a text."""
    name = random.choice(["c.npy", "c.npz", "c.csv", "c.xyz"])
    points = np.random.default_rng(random.randrange(99)).normal(size=(random.randrange(9), 3))
    if random.random() < 0.4:
        points = points.T if random.random() < 0.3 else np.hstack([points, points])
    stream = io.BytesIO()
    if name[-3:-1] == "np":
        kind = [(axis, "f4") for axis in random.choice(["xyz", "zyx", "xy", "uvw"])]
        if random.random() < 0.3:
            points = np.zeros(5, dtype=kind)
        np.save(stream, points) if name == "c.npy" else np.savez(stream, points=points)
    else:
        mark = random.choice(",; ")
        head = random.choice(["", "x,y,z", "# z y x", "i;x;y;z", "9", "//X Y Z R"])
        np.savetxt(stream, points, delimiter=mark, header=head, comments="")
    content = stream.getvalue() if random.random() < 0.4 else damaged(random, stream.getvalue())
    scale = 1.0 if random.random() < 0.8 else float(random.choice(NUMBERS[:-3]))

    def act(folder: Path) -> str:
        from optipromp.core.geometry.loading import load_cloud

        made = load_cloud(folder / name, 0.01, scale)
        assert np.isfinite(made.points).all()
        assert made.points.shape[1] == 3
        return "success"

    return Mutant("cloud", {name: content}, act)


@cache
def bench_files() -> dict[str, bytes]:
    """A folder of a run of one scene, with its zip."""
    from optipromp_bench.results import BenchRun, run_bench
    from optipromp_bench.sets import SceneSet

    run = BenchRun.of("tests.bench.entrants:Still", "plan", SceneSet("word", ("cluster",), 1))
    with TemporaryDirectory() as name:
        run_bench(run, Path(name), workers=1)
        return {str(p.relative_to(name)): p.read_bytes() for p in Path(name).rglob("*")
                if p.is_file() and p.name != ".lock"}  # fmt: skip


def rows_changed(random: Random, content: bytes) -> bytes:
    """A table with cells, columns or lines changed."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    k = random.randrange(len(rows))
    match random.randrange(4):
        case 0:
            rows.insert(k, list(random.choice(rows)))
        case 1:
            rows[k] = rows[k][: random.randrange(len(rows[k]) + 1)]
        case _:
            rows[k][random.randrange(len(rows[k]))] = str(value(random)).replace("\0", "")
    csv.writer(text := io.StringIO(), lineterminator="\n").writerows(rows)
    return text.getvalue().encode("utf-8", "surrogatepass")


def bench_changed(random: Random) -> dict[str, bytes]:
    """The members of a run's folder, one of them changed by its content."""
    files = dict(bench_files())
    files.pop("submission.zip")
    name = random.choice([*files, "run.json", "rows.csv"])
    match name:
        case "run.json":
            document = changed(random, json.loads(files[name]))
            files[name] = json.dumps(document).encode("utf-8", "surrogatepass")
        case "rows.csv":
            files[name] = rows_changed(random, files[name])
        case _:
            with np.load(io.BytesIO(files[name])) as found:
                files[name] = arrays_changed(random, {key: found[key] for key in found.files})
    if random.random() < 0.2:
        files[name] = damaged(random, files[name])
    return files


def bench_zip(random: Random) -> Mutant:
    if random.random() < 0.4:
        content = damaged(random, bench_files()["submission.zip"])
    else:
        stream, kinds = io.BytesIO(), [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA]
        with zipfile.ZipFile(stream, "w", random.choice(kinds)) as file:
            for name, each in bench_changed(random).items():
                draw = random.random()
                if draw < 0.03:
                    continue
                file.writestr(random.choice(WORDS[1:10]) if draw < 0.06 else name, each)
                if draw > 0.97:
                    file.writestr(name, bytes(10**8))
        content = stream.getvalue()
    verified = random.random() < 0.04

    def act(folder: Path) -> str:
        from optipromp_bench.results import submission, verify
        from optipromp_bench.table import leaderboard, markdown

        path = folder / "s.zip"
        submission(path)
        markdown(leaderboard([path]))
        if verified:
            verify(path, workers=1)
        return "success"

    return Mutant("bench zip", {"s.zip": content}, act)


def bench_run(random: Random) -> Mutant:
    files = bench_changed(random)

    def act(folder: Path) -> str:
        from optipromp_bench.results import BenchRun, run_bench
        from optipromp_bench.sets import SceneSet

        (folder / "motions").mkdir()
        for name, content in files.items():
            (folder / name).write_bytes(content)
        run = BenchRun.of("tests.bench.entrants:Still", "plan", SceneSet("word", ("cluster",), 1))
        run_bench(run, folder, workers=1)
        return "success"

    return Mutant("bench run", {}, act)


def answers(random: Random) -> Mutant:
    """What a policy at an address answers."""
    velocity = [0.0] * 7
    lines = [json.dumps(changed(random, {"velocity": velocity})).encode("utf-8", "surrogatepass")
             for _ in range(3)]  # fmt: skip
    if random.random() < 0.4:
        k = random.randrange(3)
        lines[k] = damaged(random, lines[k])
    if random.random() < 0.1:
        lines[random.randrange(3)] = random.choice(
            [b"[" * 10**5, b"1" * 10**5, b'"' + b"x" * 10**7]
        )
    ends = random.choice([b"\n"] * 8 + [b"", b"\r\n", b"\0\n"])

    def act(folder: Path) -> str:
        from optipromp.core.scenes.io import load_scene
        from optipromp_bench.episode import Observation
        from optipromp_bench.serve import Served

        with socket.create_server(("127.0.0.1", 0)) as listening:
            listening.settimeout(5.0)

            def answer() -> None:
                with (
                    suppress(OSError), listening.accept()[0] as caller,
                    caller.makefile("rwb") as stream,
                ):  # fmt: skip
                    for line in (b"{}", *lines):
                        if not stream.readline():
                            return
                        stream.write(line + (b"\n" if line == b"{}" else ends))
                        stream.flush()

            thread = threading.Thread(target=answer, daemon=True)
            thread.start()
            policy = Served(f"127.0.0.1:{listening.getsockname()[1]}")
            try:
                scene, zero = load_scene("scenario-3"), np.zeros(7)
                policy.begin()
                policy.reset(scene, 0)
                fruits = tuple(o for o in scene.objects if o.role != "static")
                seen = Observation(0.0, zero, zero, zero[:3], zero[:3], fruits, 0.0)
                for _ in lines:
                    np.asarray(policy.act(seen), dtype=np.float64)
            finally:
                policy.close()
                thread.join(5.0)
        return "success"

    return Mutant("tcp answers", {}, act)


def episode_options(random: Random) -> Mutant:
    """Options of ``episodes`` that must be refused, or ask for too much; none runs an episode."""
    options = {
        "--count": ["0", "-1", "1e9", "x", "", "9" * 400], "--format": ["x", "", "MINARI"],
        "--preset": ["x", "", ",", "cluster,x", "a" * 5000], "--condition": ["x", "", "\ud800"],
        "--keep": ["x", "", "all "], "--workers": ["0", "-1", "x", "1e3"], "--seed": ["x", "1.5"],
    }  # fmt: skip
    chosen = random.sample(list(options), random.choice([1, 2, 3]))
    words = [word for name in chosen for word in (name, random.choice(options[name]))]

    def act(folder: Path) -> str:
        from typer.testing import CliRunner

        from optipromp.cli.main import app

        done = CliRunner().invoke(app, ["episodes", "--out", str(folder / "o"), *words, "--json"])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        assert done.exit_code in (1, 2), f"not refused: {words}"
        return "error by the command"

    return Mutant("episode options", {}, act)


DOORS: list[tuple[int, Callable[[Random], Mutant]]] = [
    (20, picture_file), (10, depth_array), (12, camera), (1, network), (10, calibration),
    (20, messages), (12, image_messages), (10, bag), (20, mesh), (12, bench_zip), (8, bench_run),
    (8, cloud), (6, answers), (3, episode_options),
]  # fmt: skip


def warm_doors(kinds: list[str]) -> None:
    """Make beforehand what is made once; load what the doors of some kinds need."""
    for _, make in DOORS:
        if make.__name__ in kinds:
            with TemporaryDirectory() as name, suppress(Exception):  # the hunt tells of it
                make(Random(0)).run(Path(name))
