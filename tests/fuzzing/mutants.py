"""Mutated input for every door of the library, from any source of random choices.

``mutant(random)`` makes the files and the request.
"""

import copy
import io
import json
import math
from collections.abc import Callable
from hashlib import sha256
from importlib import resources
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import yaml
from tests.fuzzing.changes import arrays_changed, changed, damaged, text_of, value, xml_changed
from tests.fuzzing.originals import (
    bystanders,
    chain,
    learnt_primitive,
    plan_files,
    recorded,
    scene_documents,
    shapes_scene,
)
from tests.fuzzing.outcomes import TIMEOUT, Mutant, check_plan, planned
from tests.scenes.documents import MINIMAL


def scene(random: Random) -> Mutant:
    begin = random.choice(scene_documents())
    name, content = text_of(random, changed(random, begin))
    if random.random() < 0.25:
        content = damaged(random, content)
    return _of_scene(random, "scene", {f"scene.{name}": content})


def _of_scene(random: Random, kind: str, files: dict[str, bytes]) -> Mutant:
    planner = random.choice(["opti-promp"] * 4 + ["promp", "i-promp", "paper"])
    (name,) = (name for name in files if name.startswith("scene"))

    def act(folder: Path) -> str:
        from optipromp import load_scene

        loaded = load_scene(folder / name)
        return planned(random, loaded, planner=planner)

    return Mutant(kind, bystanders() | files, act)


def shape_file(random: Random) -> Mutant:
    files = bystanders()
    name = random.choice(list(files))
    files[name] = damaged(random, files[name])
    return _of_scene(
        random, "shape file", files | {"scene.json": json.dumps(shapes_scene()).encode()}
    )


def robot(random: Random) -> Mutant:
    folder = resources.files("optipromp.core.robots") / "data"
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
    arrays = recorded()
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
    content = arrays_changed(random, learnt_primitive())

    def act(folder: Path) -> str:
        return planned(random, "scenario-3", demonstrations=folder / "learnt.npz")

    return Mutant("primitive", {"learnt.npz": content}, act)


def plan_folder(random: Random) -> Mutant:
    files = dict(plan_files())
    if random.random() < 0.5:
        document = changed(random, json.loads(files["plan.json"]))
        files["plan.json"] = json.dumps(document).encode("utf-8", "surrogatepass")
    else:
        with np.load(io.BytesIO(files["waypoints.npz"])) as found:
            arrays = {key: found[key] for key in found.files}
        files["waypoints.npz"] = arrays_changed(random, arrays)
        if random.random() < 0.8:  # as if it were the plan's own
            document = json.loads(files["plan.json"])
            document["sha256"]["waypoints.npz"] = sha256(files["waypoints.npz"]).hexdigest()
            files["plan.json"] = json.dumps(document).encode()
    if random.random() < 0.2:
        name = random.choice(list(files))
        files[name] = damaged(random, files[name])

    def act(folder: Path) -> str:
        from optipromp import load_plan

        loaded = load_plan(folder)
        repr(loaded), loaded.to_dict()
        return check_plan(loaded)

    return Mutant("plan", files, act)


def trajectory(random: Random) -> Mutant:
    files = plan_files()
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

    from optipromp import PlanOptions
    from optipromp_paper.paper import Paper

    classes: list[Any] = [PlanOptions, PlanOptions, Paper]
    chosen = random.choice(classes)
    names = [item.name for item in dataclasses.fields(chosen)]
    given = {random.choice(names): _setting(random) for _ in range(random.choice([1, 1, 2]))}
    arguments = {}
    if random.random() < 0.3:
        key = random.choice(["seed", "planner", "demonstrations", "at", "start_state"])
        arguments[key] = value(random)
    scene: Any = "scenario-3" if random.random() < 0.95 else value(random)

    def act(folder: Path) -> str:
        options = chosen(**given)
        if chosen is Paper:
            asked = {"planner": options, "timeout": TIMEOUT} | arguments
            return planned(random, scene, **asked)
        if "timeout" not in given:
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


def mutant(random: Random, kinds: list[tuple[int, Callable[[Random], Mutant]]] = KINDS) -> Mutant:
    """A mutant of any of some kinds."""
    weights, makers = zip(*kinds, strict=True)
    return random.choices(makers, weights)[0](random)


def warm() -> None:
    """Make beforehand what is made once, and compile what plans of every kind need."""
    from optipromp.core.planning.warming import compile_kernels

    compile_kernels()
    learnt_primitive(), plan_files()
    random = Random(0)
    for document in scene_documents():
        for planner in ("opti-promp", "paper", "i-promp"):
            with TemporaryDirectory() as name:
                files = bystanders() | {"scene.json": json.dumps(document).encode()}
                for file, content in files.items():
                    (Path(name) / file).write_bytes(content)
                planned(random, Path(name) / "scene.json", planner=planner)
