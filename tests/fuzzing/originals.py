"""Files that are right, which the mutants begin with."""

import copy
from functools import cache
from importlib import resources
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from tests.scenes.documents import MINIMAL

CUBE = [
    (x, y, z) for x in (-0.02, 0.02) for y in (-0.02, 0.02) for z in (-0.02, 0.02)
]  # fmt: skip
FACES = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6),
         (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]  # fmt: skip


def builtin_scenes() -> list[Any]:
    from optipromp.core.scenes.io import load_scene, scene_names, scene_to_dict

    return [scene_to_dict(load_scene(name)) for name in scene_names()]


def generated_scenes() -> list[Any]:
    from optipromp.core.scenes.io import scene_to_dict
    from optipromp_sim.generate import generate

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
        "target": "ripe",
        "options": {"camera_point": True, "drift_offset": {"n1": 0.01}},
        "scale": 1.0, "frame": "world",
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


def obj() -> bytes:
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE]
    lines += ["f " + " ".join(str(i + 1) for i in face) for face in FACES]
    return "\n".join(lines).encode()


def bystanders() -> dict[str, bytes]:
    return {"cube.obj": obj(), "leaves.csv": b"x,y,z\n0,0,0\n0,0.1,0\n"}


@cache
def scene_documents() -> list[Any]:
    return [*builtin_scenes(), *generated_scenes(), shapes_scene()]


@cache
def recorded() -> dict[str, Any]:
    with (
        resources.as_file(resources.files("optipromp.core.promp") / "data" / "panda.npz") as path,
        np.load(path) as found,
    ):
        return {key: found[key] for key in found.files}


@cache
def learnt_primitive() -> dict[str, Any]:
    from optipromp import fit, load_demonstrations

    with resources.as_file(resources.files("optipromp.core.promp") / "data" / "panda.npz") as path:
        learnt = fit(load_demonstrations(path))
    with TemporaryDirectory() as folder:
        learnt.save(Path(folder) / "learnt.npz")
        with np.load(Path(folder) / "learnt.npz") as found:
            return {key: found[key] for key in found.files}


@cache
def plan_files() -> dict[str, bytes]:
    from optipromp import plan, write_plan

    with TemporaryDirectory() as folder:
        write_plan(plan("scenario-3"), Path(folder))
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}
