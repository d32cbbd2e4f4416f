"""Mutated input for every door of the library, from any source of random choices.

``mutant(random)`` makes the files and the request; ``Mutant.run`` gives them to the library and
says what came of it. A source is ``random.Random(seed)``, or Hypothesis' own, which shrinks.
"""

import copy
import io
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any
from xml.etree import ElementTree

import numpy as np
import yaml
from tests.scenes.documents import MINIMAL

TIMEOUT = 1.0  # [s] of a plan
CUBE = [
    (x, y, z) for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (-0.02, 0.02)
]  # fmt: skip
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
         (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip

NUMBERS = [
    0, -0.0, 1, -1, 2, 3, 0.5, 1e-3, 1e-9, 1e-160, 5e-324, 1e-17, 10, 180, 800, 1e3, 1e6, 1e9,
    1e150, 1e160, 1e300, 1.7e308, -1e300, math.nan, math.inf, -math.inf, 2**31, 2**63, 10**30,
    10**400, True, False,
]  # fmt: skip
WORDS = [
    "", " ", "x", "no", "1e-3", "1,5", "NaN", "target", "static", "pushable", "panda", "scara",
    "cup", "mesh", "franka_hand", "world", "camera", "../../etc/passwd", "/dev/zero", "/dev/null",
    "a[/bold]", "$\\frac{$", "\x1b[31m", "\x00", "\ud800", "ü", "\u202e", "a" * 5000, "${x}", "%s",
]  # fmt: skip
OTHERS: list[Any] = [None, [], {}, [[]], [{}], {"": None}, [0, 0, 0], [1, 0, 0, 0], ["x"], {"x": 1}]
TAGS = [
    b"!!timestamp x", b"!!bool x", b"!!int x", b"!!binary '#'", b"!!set {a}", b"!!omap [a: 1]",
    b"&a [*a]", b"*a", b"<<: 3", b"!!python/name:os.system", b"? [1]: 2", b"|", b">-", b"- " * 50,
    b"[" * 3000, b"{a: " * 3000, b"\t", b"\xff\xfe", b"\x00", b"%YAML 9.9\n---", b"...\n---\n",
    b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&#0;", b"<![CDATA[", b"<xacro:if value='1'>", b"${x}",
    b"1" * 5000, b",", b'"', b"'", b"\r", b"\x1a", b"nan", b"1e999", b"-", b"\xed\xa0\x80",
]  # fmt: skip


def value(random: Random) -> Any:
    pool: Sequence[Any] = random.choice([NUMBERS, NUMBERS, WORDS, OTHERS])
    return copy.deepcopy(random.choice(pool))


def spots(document: Any) -> list[tuple[Any, Any]]:
    """Every place in a document as (holder, key or index)."""
    found: list[tuple[Any, Any]] = []
    open_ = [document]
    while open_:
        holder = open_.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        for key in keys:
            found.append((holder, key))
            if isinstance(holder[key], dict | list):
                open_.append(holder[key])
    return found


def changed(random: Random, document: Any) -> Any:
    """A copy of a document of plain values with one to four places changed."""
    document = copy.deepcopy(document)
    for _ in range(random.choice([1, 1, 1, 2, 2, 3, 4])):
        places = spots(document)
        if not places:
            return document
        holder, key = random.choice(places)
        old = holder[key]
        match random.randrange(8):
            case 0:
                del holder[key]
            case 1 | 2:
                holder[key] = value(random)
            case 3 | 4 if isinstance(old, int | float) and not isinstance(old, bool):
                holder[key] = old * random.choice([-1, 0, 0.5, 0.99, 1.01, 2, 10, 1e-3, 1e3, 1e12])
            case 3 | 4 | 5 if isinstance(old, int | float) and not isinstance(old, bool):
                holder[key] = old + random.gauss(0.0, random.choice([1e-9, 1e-2, 0.1, 1.0]))
            case 5 if isinstance(holder, list):
                holder.insert(random.randrange(len(holder) + 1), copy.deepcopy(old))
            case 6:
                other, place = random.choice(places)
                holder[key] = copy.deepcopy(other[place]) if place in keys_of(other) else None
            case _ if isinstance(holder, dict):
                holder[random.choice(["x", "scale", "frame", str(key) + "s", "goal"])] = old
    return document


def keys_of(holder: Any) -> Any:
    return holder.keys() if isinstance(holder, dict) else range(len(holder))


def damaged(random: Random, content: bytes) -> bytes:
    """Bytes with one to four places damaged."""
    for _ in range(random.choice([1, 1, 2, 4])):
        at = random.randrange(len(content) + 1)
        to = min(len(content), at + random.choice([1, 1, 2, 8, 64]))
        match random.randrange(7):
            case 0:
                content = content[:at]
            case 1:
                content = content[:at] + content[to:]
            case 2:
                content = content[:at] + bytes([random.randrange(256)]) + content[at + 1 :]
            case 3:
                content = content[:at] + random.choice(TAGS) + content[to:]
            case 4:
                content = content[:at] + random.choice(TAGS) + content[at:]
            case 5:
                content = content[:to] + content[at:]
            case 6:
                text = str(random.choice(NUMBERS[:-3])).encode()
                content = content[:at] + text + content[to:]
    return content


# -- documents to begin with ------------------------------------------------------------------


def builtin_scenes() -> list[Any]:
    from optipromp.scenes.io import load_scene, scene_names, scene_to_dict

    return [scene_to_dict(load_scene(name)) for name in scene_names()]


def generated_scenes() -> list[Any]:
    from optipromp.scenes.generate import generate
    from optipromp.scenes.io import scene_to_dict

    presets = ("cluster", "mixed", "shelf", "elongated")
    return [scene_to_dict(generate(preset, seed=1)) for preset in presets]


def shapes_scene() -> Any:
    """A scene of every shape, and of most keys that there are."""
    shapes = [
        {"box": {"size": [0.2, 0.06, 0.16]}}, {"cylinder": {"radius": 0.05, "length": 0.3}},
        {"capsule": {"radius": 0.05, "length": 0.3}}, {"half_space": {}},
        {"mesh": {"file": "cube.obj", "scale": 1.0}},
        {"point_cloud": {"file": "leaves.csv", "radius": 0.01}},
    ]  # fmt: skip
    scene = copy.deepcopy(MINIMAL)
    scene["objects"][0] |= {"stem": {"root": [0.45, 0.0, 1.02], "radius": 0.002}, "sigma": 0.004}
    scene["objects"] += [
        {"id": "n1", "role": "pushable", "shape": {"sphere": {"radius": 0.015}},
         "position": [0.45, 0.02, 0.82], "orientation": [0.8, 0, 0.6, 0], "frame": "base",
         "stem": {"points": [[0.45, 0.02, 0.835], [0.45, 0.03, 0.95], [0.45, 0.02, 1]]},
         "covariance": [[1e-4, 0, 0], [0, 2e-4, 1e-5], [0, 1e-5, 1e-4]],
         "physical": {"mass": 0.02, "stem_stiffness": 1e-3}},
        *({"id": f"s{i}", "role": "static" if i % 2 else "avoid", "shape": shape,
           "position": [0.3 * (i - 2), 0.7, 0.0 if i == 3 else 0.4], "orientation": [1, 0, 0, 0]}
          for i, shape in enumerate(shapes)),
    ]  # fmt: skip
    scene["objects"][5]["position"] = [0, 0, -0.2]
    return scene | {
        "tool": {"kind": "cup", "radius": 0.04}, "start": [0, 0, 0, -0.1, 0, 0, 0.8],
        "target": "ripe", "options": {"camera_point": True}, "scale": 1.0, "frame": "world",
        "approach": {"direction": [0, 0, 1], "lateral": [0, 1, 0], "camera_distance": 0.1},
        "base": {"position": [0, 0, 0], "orientation": [1, 0, 0, 0]},
        "camera": {"position": [0, 0, 1], "orientation": [1, 0, 0, 0]},
    }  # fmt: skip


def chain(random: Random) -> str:
    """A URDF of 1 to 12 joints in a row, with links of simple shapes."""
    count = random.randint(1, 12)
    parts = ['<link name="l0"><collision><geometry><sphere radius="0.05"/></geometry></collision>'
             "</link>"]  # fmt: skip
    for k in range(count):
        length = random.choice([0.05, 0.1, 0.2, 0.3])
        shape = random.choice([
            f'<cylinder radius="0.03" length="{length}"/>', f'<box size="0.05 0.05 {length}"/>',
            f'<capsule radius="0.03" length="{length}"/>', '<sphere radius="0.05"/>',
            '<mesh filename="cube.obj" scale="1 1 1"/>',
        ])  # fmt: skip
        kind = random.choice(["revolute"] * 6 + ["continuous", "prismatic", "fixed"])
        axis = random.choice(["0 0 1", "0 1 0", "1 0 0", "0 3 4"])
        limits = '<limit lower="-2.5" upper="2.5" velocity="2" effort="50"/>'
        if kind == "prismatic":
            limits = '<limit lower="0" upper="0.4" velocity="0.5" effort="50"/>'
        mimic = f'<mimic joint="j{k - 1}" multiplier="0.5"/>' if random.random() < 0.03 else ""
        parts.append(
            f'<link name="l{k + 1}"><inertial><mass value="1"/></inertial><collision>'
            f'<origin xyz="0 0 {length / 2}"/><geometry>{shape}</geometry></collision></link>'
            f'<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{k + 1}"/>'
            f'<origin xyz="0 0 {length}" rpy="0 {random.choice([0, 0, 1.57])} 0"/>'
            f'<axis xyz="{axis}"/>{limits}{mimic}</joint>'
        )
    return f'<robot name="chain">{"".join(parts)}</robot>'


def xml_changed(random: Random, text: str) -> bytes:
    """An XML document with one to three elements or attributes changed."""
    root = ElementTree.fromstring(text)
    for _ in range(random.choice([1, 1, 2, 3])):
        holders = [node for node in root.iter() if len(node)]
        node = random.choice(list(root.iter()))
        holder = random.choice(holders) if holders else root
        match random.randrange(7):
            case 0 if len(holder):
                holder.remove(random.choice(list(holder)))
            case 1 if len(holder):
                holder.append(copy.deepcopy(random.choice(list(holder))))
            case 2 | 3 | 4 | 5 if node.attrib:
                key = random.choice(list(node.attrib))
                words = node.attrib[key].split() or [""]
                at = random.randrange(len(words))
                words[at] = str(random.choice([*NUMBERS[:-3], *WORDS[:12], "fixed", "floating",
                                               "prismatic", "l1", "j1", "link2"]))  # fmt: skip
                node.attrib[key] = " ".join(words)
            case _:
                node.tag = random.choice(["link", "joint", "origin", "axis", "x", "mimic", "limit"])
    return ElementTree.tostring(root)


def obj() -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in FACES]
    return "\n".join(lines).encode()


def packed(arrays: dict[str, Any]) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, allow_pickle=True, **arrays)
    return stream.getvalue()


def arrays_changed(random: Random, arrays: dict[str, Any]) -> bytes:
    """Arrays as an NPZ file: with values, shapes, types or names changed, or bytes damaged."""
    arrays = {key: np.array(array) for key, array in arrays.items()}
    for _ in range(random.choice([1, 1, 2, 3])):
        key = random.choice(list(arrays) or ["x"])
        array = arrays.get(key, np.zeros(3))
        match random.randrange(9):
            case 0:
                arrays.pop(key, None)
            case 1 | 2 if array.size and array.dtype.kind == "f":
                array.flat[random.randrange(array.size)] = float(random.choice(NUMBERS[:-3]))
            case 3 if array.dtype.kind == "f":
                arrays[key] = array * random.choice([-1, 0, 10, 1e-3, 1e150, 1e300, 57.3])
            case 4 if array.ndim:
                arrays[key] = array[: random.randrange(array.shape[0] + 1)]
            case 5:
                kind = random.choice(["f4", "i4", "c16", "U8", "bool", "O", "S4", "M8[s]"])
                arrays[key] = np.resize(np.array([1, 0], dtype=object), array.shape) \
                    if kind == "O" else np.zeros(array.shape, dtype=kind)  # fmt: skip
            case 6:
                arrays[key] = array[..., None] if random.random() < 0.5 else array.ravel()
            case 7:
                arrays[random.choice(["x", "time", "times", "positions", key + "s"])] = array
            case 8 if array.ndim > 1:
                arrays[key] = array[..., : random.randrange(array.shape[-1] + 1)]
    content = packed(arrays)
    if random.random() < 0.25:
        content = damaged(random, content)
    return content


def text_of(random: Random, document: Any) -> tuple[str, bytes]:
    """A document as YAML or JSON; sometimes its bytes are damaged."""
    if random.random() < 0.3:
        name, content = "json", json.dumps(document).encode("utf-8", "surrogatepass")
    else:
        text = yaml.safe_dump(
            document, sort_keys=False, default_flow_style=random.choice([None, False])
        )
        name, content = "yaml", text.encode("utf-8", "surrogatepass")
    return name, content


# -- mutants ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Mutant:
    """Files by name, and what is done with them in their folder."""

    kind: str
    files: dict[str, bytes]
    act: Callable[[Path], str]

    def run(self, folder: Path) -> str:
        """What came of it: a code, or ``success``; raises what is not typed.

        AssertionError: a result that is not valid.
        """
        from optipromp.errors import OptiPrompError

        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        try:
            return self.act(folder)
        except OptiPrompError as error:
            code, words = error.code, error.message
        assert words, "a refusal without words"
        return f"error {code}"


def bystanders() -> dict[str, bytes]:
    return {"cube.obj": obj(), "leaves.csv": b"x,y,z\n0,0,0\n0,0.1,0\n"}


def check_plan(result: Any, *, anywhere: bool = False) -> str:
    """The status of a plan; a success is judged again, and its numbers are finite.

    A plan from a file may begin ``anywhere``, as one that goes on from another.
    """
    from optipromp import judge
    from optipromp.trajectory import Trajectory

    assert isinstance(result.trajectory, Trajectory)  # refuses what is not finite
    assert result.message, "a plan without words"
    if not result.success:
        return f"no plan {result.status}"
    again = judge(result.scene, result.trajectory, robot=result.robot)
    wrong = [v for v in again.judgement.violations if v.kind != "start" or not anywhere]
    assert not wrong, f"a false success: {again.message}"
    assert all(math.isfinite(v) for v in result.metrics.to_dict().values() if type(v) is float)
    return "success"


def planned(random: Random, scene: Any, **request: Any) -> str:
    from optipromp import PlanOptions, plan

    request = {"options": PlanOptions(timeout=TIMEOUT), "seed": 0} | request
    return check_plan(plan(scene, **request))


def scene(random: Random) -> Mutant:
    begin = random.choice(_documents())
    name, content = text_of(random, changed(random, begin))
    if random.random() < 0.25:
        content = damaged(random, content)
    return _of_scene(random, "scene", {f"scene.{name}": content})


def _of_scene(random: Random, kind: str, files: dict[str, bytes]) -> Mutant:
    planner = random.choice(["opti-promp"] * 4 + ["promp", "i-promp"])
    strategy = random.choice(["joint"] * 5 + ["sequential"])
    (name,) = (name for name in files if name.startswith("scene"))

    def act(folder: Path) -> str:
        from optipromp import load_scene

        loaded = load_scene(folder / name)
        return planned(random, loaded, planner=planner, strategy=strategy)

    return Mutant(kind, bystanders() | files, act)


def shape_file(random: Random) -> Mutant:
    files = bystanders()
    name = random.choice(list(files))
    files[name] = damaged(random, files[name])
    return _of_scene(
        random, "shape file", files | {"scene.json": json.dumps(shapes_scene()).encode()}
    )


def robot(random: Random) -> Mutant:
    folder = resources.files("optipromp.robots") / "data"
    base = random.choice(["panda", "scara", "chain", "chain", "chain"])
    urdf = chain(random) if base == "chain" else (folder / f"{base}.urdf").read_text("utf-8")
    files = bystanders() | {"robot.urdf": urdf.encode()}
    if base != "chain":
        stated = yaml.safe_load((folder / f"{base}.yaml").read_text("utf-8")) | {
            "urdf": "robot.urdf"
        }
        if random.random() < 0.3:
            stated = changed(random, stated)
        files["robot.yaml"] = yaml.safe_dump(stated).encode("utf-8", "surrogatepass")
    if random.random() < 0.75:
        files["robot.urdf"] = xml_changed(random, urdf)
    if random.random() < 0.2:
        name = random.choice([name for name in files if name.startswith("robot")])
        files[name] = damaged(random, files[name])
    document = copy.deepcopy(MINIMAL) | {"tool": {"kind": "cup", "radius": 0.03}}
    document["objects"][0]["position"] = [random.uniform(-0.6, 0.6), 0.2, random.uniform(0.2, 0.9)]
    name = "robot.yaml" if "robot.yaml" in files else "robot.urdf"
    files["scene.json"] = json.dumps(document | {"robot": name}).encode()
    return _of_scene(random, "robot", files)


def demonstrations(random: Random) -> Mutant:
    arrays = _recorded()
    if random.random() < 0.4:
        name = "demos.csv"
        rows = ["time," + ",".join(f"joint{k}" for k in range(1, 8))]
        count = random.choice([1, 2, 3, 20])
        rows += [",".join(str(round(math.sin(k + j), 6)) if j else str(0.1 * k) for j in range(8))
                 for k in range(count)]  # fmt: skip
        content = damaged(random, "\n".join(rows).encode())
    else:
        name, content = "demos.npz", arrays_changed(random, arrays)
    bases = random.choice([1, 2, 3, 5, 8, 30])
    em = random.random() < 0.2 and bases <= 8  # thousands of inversions: minutes with more
    plan_too = random.random() < 0.3

    def act(folder: Path) -> str:
        from optipromp import Basis, fit, fit_em, load_demonstrations

        recorded = load_demonstrations(folder / name)
        learnt = (fit_em if em else fit)(recorded, Basis(bases))
        for values in (learnt.mean, learnt.covariance, learnt.noise, learnt.mean_trajectory(5)):
            assert np.isfinite(values).all(), "a primitive that is not finite"
        if plan_too:
            return planned(random, "scenario-3", demonstrations=folder / name)
        return "success"

    return Mutant("demonstrations", {name: content}, act)


def primitive(random: Random) -> Mutant:
    content = arrays_changed(random, _primitive())

    def act(folder: Path) -> str:
        return planned(random, "scenario-3", demonstrations=folder / "learnt.npz")

    return Mutant("primitive", {"learnt.npz": content}, act)


def plan_folder(random: Random) -> Mutant:
    files = dict(_plan_files())
    if random.random() < 0.5:
        document = changed(random, json.loads(files["plan.json"]))
        files["plan.json"] = json.dumps(document).encode("utf-8", "surrogatepass")
    else:
        with np.load(io.BytesIO(files["waypoints.npz"])) as found:
            arrays = {key: found[key] for key in found.files}
        files["waypoints.npz"] = arrays_changed(random, arrays)
    if random.random() < 0.2:
        name = random.choice(list(files))
        files[name] = damaged(random, files[name])

    def act(folder: Path) -> str:
        from optipromp import load_plan

        loaded = load_plan(folder)
        repr(loaded), loaded.to_dict()
        return check_plan(loaded, anywhere=True)

    return Mutant("plan", files, act)


def trajectory(random: Random) -> Mutant:
    files = _plan_files()
    if random.random() < 0.5:
        name, content = "given.csv", damaged(random, files["trajectory.csv"][:6000])
    else:
        with np.load(io.BytesIO(files["trajectory.npz"])) as found:
            arrays = {key: found[key][::100] if key != "joint_names" else found[key]
                      for key in found.files}  # fmt: skip
        name, content = "given.npz", arrays_changed(random, arrays)

    def act(folder: Path) -> str:
        from optipromp import judge

        found = judge("scenario-3", folder / name)
        assert found.message
        values = found.judgement.metrics.to_dict().values()
        assert found.status != "success" or all(
            math.isfinite(v) for v in values if type(v) is float
        )
        return "success" if found.status == "success" else f"no plan {found.status}"

    return Mutant("trajectory", {name: content}, act)


def request(random: Random) -> Mutant:
    import dataclasses

    from optipromp import PaperOptions, PlanOptions

    classes: list[Any] = [PlanOptions, PlanOptions, PaperOptions]
    chosen = random.choice(classes)
    names = [item.name for item in dataclasses.fields(chosen)]
    given = {random.choice(names): _setting(random) for _ in range(random.choice([1, 1, 2]))}
    arguments = {}
    if random.random() < 0.3:
        key = random.choice(["seed", "planner", "strategy", "demonstrations", "at", "start_state"])
        arguments[key] = value(random)
    scene: Any = "scenario-3" if random.random() < 0.95 else value(random)

    def act(folder: Path) -> str:
        options = chosen(**given)
        if chosen is PaperOptions:
            options = PlanOptions(paper=options, timeout=TIMEOUT, constraints="paper")
        elif "timeout" not in given:
            options = dataclasses.replace(options, timeout=TIMEOUT)
        return planned(random, scene, options=options, **arguments)

    return Mutant("request", {}, act)


def _setting(random: Random) -> Any:
    return random.choice([value(random), value(random), (1, 2), (0.0, 1.0, 2.0, 3.0), "3", 4, 1e-4])


def command(random: Random) -> Mutant:
    """A file given to ``check``, as the command line takes it."""
    inner = random.choice([scene, robot, demonstrations, plan_folder])(random)
    name = next(n for n in ("scene.json", "scene.yaml", "demos.csv", "demos.npz", "plan.json",
                            "robot.urdf") if n in inner.files)  # fmt: skip

    def act(folder: Path) -> str:
        from typer.testing import CliRunner

        from optipromp.cli.main import app

        done = CliRunner().invoke(app, ["check", str(folder / name), "--json"])
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        json.loads(done.stdout)
        assert done.exit_code in (0, 1, 2)
        return "success" if done.exit_code == 0 else "error by the command"

    return Mutant("command", inner.files, act)


KINDS: list[tuple[int, Callable[[Random], Mutant]]] = [
    (30, scene), (24, robot), (12, demonstrations), (4, primitive), (9, plan_folder),
    (7, trajectory), (8, request), (3, shape_file), (3, command),
]  # fmt: skip


def mutant(random: Random) -> Mutant:
    """A mutant of any kind."""
    weights, makers = zip(*KINDS, strict=True)
    return random.choices(makers, weights)[0](random)


# -- what is made once ------------------------------------------------------------------------

_kept: dict[str, Any] = {}


def _once(name: str, make: Callable[[], Any]) -> Any:
    if name not in _kept:
        _kept[name] = make()
    return _kept[name]


def _documents() -> list[Any]:
    return list(_once("scenes", lambda: [*builtin_scenes(), *generated_scenes(), shapes_scene()]))


def _recorded() -> dict[str, Any]:
    with (
        resources.as_file(resources.files("optipromp.promp") / "data" / "panda.npz") as path,
        np.load(path) as found,
    ):
        return {key: found[key] for key in found.files}


def _primitive() -> dict[str, Any]:
    def make() -> dict[str, Any]:
        from optipromp import fit, load_demonstrations

        with resources.as_file(resources.files("optipromp.promp") / "data" / "panda.npz") as path:
            learnt = fit(load_demonstrations(path))
        with TemporaryDirectory() as folder:
            learnt.save(Path(folder) / "learnt.npz")
            with np.load(Path(folder) / "learnt.npz") as found:
                return {key: found[key] for key in found.files}

    return dict(_once("primitive", make))


def _plan_files() -> dict[str, bytes]:
    def make() -> dict[str, bytes]:
        from optipromp import plan, write_plan

        with TemporaryDirectory() as folder:
            write_plan(plan("scenario-3"), Path(folder))
            return {path.name: path.read_bytes() for path in Path(folder).iterdir()}

    return dict(_once("plan", make))


def warm() -> None:
    """Make beforehand what is made once, and compile what plans of every kind need."""
    from optipromp.planning.plan import compile_kernels

    compile_kernels()
    _primitive(), _plan_files()
    random = Random(0)
    for document in _documents():
        for planner, strategy in (("opti-promp", "joint"), ("opti-promp", "sequential"),
                                  ("i-promp", "joint")):  # fmt: skip
            with TemporaryDirectory() as name:
                files = bystanders() | {"scene.json": json.dumps(document).encode()}
                for file, content in files.items():
                    (Path(name) / file).write_bytes(content)
                planned(random, Path(name) / "scene.json", planner=planner, strategy=strategy)
