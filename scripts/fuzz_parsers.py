"""Feed the file parsers what Atheris makes of real files, guided by what of them it has reached.

    pip install atheris
    python scripts/fuzz_parsers.py --minutes 60 --out /tmp/parsers

Each parser gets its share of the time in a process of its own, and begins from what ``--out``
already holds. An error of another type than the library's, or more than 10 s of processor time, is
a finding: it is written there with its input, and the search goes on. The death of the process
ends that parser's share. Members of an archive are altered before they are packed, so that their
checksums are right.
"""

import argparse
import io
import json
import os
import re
import subprocess
import sys
import time
import traceback
import warnings
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from random import Random
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

SECONDS = 10.0  # [s] of processor time
DATA = ROOT / "packages/optipromp/src/optipromp"
READERS = [
    "yaml", "defusedxml", "optipromp.core.documents", "optipromp.core.files",
    "optipromp.core.geometry.loading", "optipromp.core.errors", "optipromp.core.output",
    "optipromp.core.trajectory", "optipromp.core.promp.demonstrations",
    "optipromp.core.promp.checks", "optipromp.core.promp.model", "optipromp.core.scenes.io",
    "optipromp.core.scenes.schema", "optipromp.core.scenes.objects", "optipromp.core.scenes.values",
    "optipromp.core.scenes.pose", "optipromp.readers.urdf", "optipromp.readers.robot_file",
    "optipromp.readers.arm", "optipromp.core.robots.resolved",
]  # fmt: skip
CUT = b"\n--\xff--\n"  # between the members of an archive
SRDF = b"""<robot name="r"><group name="arm"><chain base_link="l0" tip_link="l7"/><joint name="j"/>
</group><group_state name="ready" group="arm"><joint name="j1" value="0 1"/></group_state>
<disable_collisions link1="l0" link2="l1" reason="Adjacent"/></robot>"""


def seeds(target: str) -> Iterator[bytes]:
    """What a parser's search begins with: files that are right."""
    import numpy as np
    import yaml
    from tests.fuzzing import originals
    from tests.fuzzing.changes import packed

    def members(archive: bytes) -> bytes:
        with zipfile.ZipFile(io.BytesIO(archive)) as found:
            return CUT.join(name.encode() + CUT + found.read(name) for name in found.namelist())

    plan = {} if target not in ("plan.json", "given.csv", "given.npz") else originals.plan_files()
    match target:
        case "robot.urdf":
            yield from (path.read_bytes() for path in (DATA / "core/robots/data").glob("*.urdf"))
            yield from (originals.chain(Random(k)).encode() for k in range(3))
        case "robot.yaml":
            yield from (path.read_bytes() for path in (DATA / "core/robots/data").glob("*.yaml"))
        case "robot.srdf":
            yield SRDF
        case "arm.robot":
            with np.load(DATA / "core/robots/data/scara.robot") as found:
                arrays = {key: found[key] for key in found.files if key != "robot"}
                yield members(packed(arrays)) + CUT.join(
                    [b"", b"robot", str(found["robot"]).encode()]
                )
        case "scene.yaml":
            yield from (path.read_bytes() for path in (DATA / "core/scenes/data").glob("*.yaml"))
            yield yaml.safe_dump(originals.shapes_scene()).encode()
        case "scene.json":
            yield json.dumps(originals.shapes_scene()).encode()
        case "demos.csv":
            yield b"time,joint1,joint2\n0,0,1\n0.5,1e-1,2\n1,0.2,3\n"
        case "demos.npz":
            arrays = {"positions": np.zeros((2, 4, 3)), "times": np.arange(4.0)}
            yield members(packed(arrays | {"joint_names": np.array(["a", "b", "c"])}))
        case "learnt.npz":
            yield members(packed(originals.learnt_primitive()))
        case "cube.obj":
            yield originals.obj()
        case "leaves.npy":
            np.save(stream := io.BytesIO(), np.zeros((3, 3)))
            yield stream.getvalue()
        case "leaves.csv":
            yield b"x,y,z\n0,0,0\n0,0.1,1e-2 # leaf\n"
        case "given.csv":
            yield b"".join(plan["trajectory.csv"].splitlines(keepends=True)[:5])
        case "given.npz":
            with np.load(io.BytesIO(plan["trajectory.npz"])) as found:
                few = {k: found[k][:4] if k != "joint_names" else found[k] for k in found.files}
            yield members(packed(few))
        case "plan.json":
            yield plan["plan.json"]


def parser(target: str, folder: Path) -> Callable[[Path], Any]:
    """What reads a file, as the library does. Imports it."""
    from optipromp import ProMP, load_demonstrations, load_plan, load_robot, load_scene
    from optipromp.core.geometry.loading import load_cloud, load_mesh
    from optipromp.core.trajectory import read_trajectory
    from optipromp.readers.arm import read_srdf
    from optipromp.readers.robot_file import read_robot_file
    from optipromp.readers.urdf import read_urdf

    if target == "plan.json":
        from tests.fuzzing import originals

        for name, content in originals.plan_files().items():
            (folder / name).write_bytes(content)

    def read_robot(path: Path) -> None:
        robot = load_robot(path)
        robot.self_gaps(robot.home)
        robot.tool_map(robot.home)

    joints = [f"joint{k}" for k in range(1, 8)]
    readers: dict[str, Callable[[Path], Any]] = {
        "robot.urdf": read_urdf, "robot.yaml": read_robot_file, "robot.srdf": read_srdf,
        "arm.robot": read_robot,
        "scene.yaml": load_scene, "scene.json": load_scene, "demos.csv": load_demonstrations,
        "demos.npz": load_demonstrations, "learnt.npz": ProMP.load,
        "cube.obj": load_mesh, "leaves.npy": lambda path: load_cloud(path, 0.01),
        "leaves.csv": lambda path: load_cloud(path, 0.01),
        "given.csv": lambda path: read_trajectory(path, joints),
        "given.npz": lambda path: read_trajectory(path, joints),
        "plan.json": lambda path: load_plan(path.parent),
    }  # fmt: skip
    return readers[target]


TARGETS = (
    "robot.urdf", "robot.yaml", "robot.srdf", "arm.robot", "scene.yaml", "scene.json", "demos.csv",
    "demos.npz", "learnt.npz", "cube.obj", "leaves.npy", "leaves.csv", "given.csv", "given.npz",
    "plan.json",
)  # fmt: skip


def archive(content: bytes) -> bytes:
    """Members as an archive whose checksums are right; UTF-8 named ``robot`` becomes an array."""
    import numpy as np

    stream, parts = io.BytesIO(), content.split(CUT)
    with zipfile.ZipFile(stream, "w") as packed:
        for name, member in zip(parts[::2], parts[1::2], strict=False):
            if name == b"robot":
                np.save(text := io.BytesIO(), np.array(member.decode("utf-8", "replace")))
                name, member = b"robot.npy", text.getvalue()
            packed.writestr(name.decode("utf-8", "replace")[:99].replace("\0", "") or "x", member)
    return stream.getvalue()


def search(target: str, seconds: int, out: Path) -> None:
    """In a process of its own: search one parser until time is over."""
    import atheris

    modules = [
        ".".join(p.relative_to(DATA.parent).with_suffix("").parts) for p in DATA.rglob("*.py")
    ]
    others = sorted(
        set(modules) - set(READERS)
    )  # compiled ones among them: Numba knows no counters
    folder = out / "work" / target
    folder.mkdir(parents=True, exist_ok=True)
    with atheris.instrument_imports(include=READERS, exclude=others):
        from optipromp.core.errors import OptiPrompError

        read = parser(target, folder)
    path, corpus, found = folder / target, out / target, set[str]()
    corpus.mkdir(parents=True, exist_ok=True)
    words = set[bytes]()
    for number, seed in enumerate(seeds(target)):
        (corpus / f"seed-{number}").write_bytes(seed)
        words |= set(re.findall(rb"[A-Za-z_]{3,30}", seed)) if target[-3:] != "npz" else set()
    known = b"".join(b'"%s"\n' % word for word in sorted(words))
    (out / f"{target}.dict").write_bytes(known or b'"PK"\n')
    os.chdir(folder)
    warnings.simplefilter("ignore")

    def once(content: bytes) -> None:
        path.write_bytes(archive(content) if target.endswith(("npz", "robot")) else content)
        began, what = time.process_time(), ""
        try:
            read(path)
        except OptiPrompError as error:
            what = "" if error.message else "a refusal without words"
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            what = f"{type(error).__name__} {Path(where.filename).name}:{where.lineno} {error}"
        if time.process_time() - began > SECONDS:
            what = "over 10 s"
        if what and (key := re.sub(r"[0-9]+ .*", "", what)) not in found:
            found.add(key)
            (out / f"found-{target}-{len(found)}").write_bytes(content)
            print(f"FOUND {what[:300]!r}", file=sys.stderr, flush=True)

    limits = [f"-max_total_time={seconds}", "-timeout=300", "-rss_limit_mb=2048", "-max_len=20000"]
    asked = [sys.argv[0], *limits, f"-dict={out / target}.dict", str(corpus)]
    atheris.Setup(asked, once)
    atheris.Fuzz()


def main() -> None:
    """Search each parser in turn; print a table."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--minutes", type=float, default=11.0)
    options.add_argument("--out", type=Path, default=Path("parsers"))
    options.add_argument("--only", nargs="+", choices=TARGETS, default=TARGETS)
    options.add_argument("--here", action="store_true", help=argparse.SUPPRESS)
    asked = options.parse_args()
    out, share = asked.out.absolute(), int(60 * asked.minutes / len(asked.only))
    if asked.here:
        search(asked.only[0], int(60 * asked.minutes), out)
    out.mkdir(parents=True, exist_ok=True)
    print(
        "| parser | inputs | edges at the beginning | at the end | findings |",
        "|---" * 5 + "|",
        sep="\n",
    )
    for target in asked.only:
        again = [sys.executable, __file__, "--here", "--minutes", str(share / 60), "--only", target]
        done = subprocess.run([*again, "--out", str(out)], capture_output=True, text=True)
        (out / f"{target}.log").write_text(done.stderr)
        steps = re.findall(r"#(\d+)\s+(\w+)\s+cov: (\d+)", done.stderr)
        first = next((cov for _, what, cov in steps if what == "INITED"), "?")
        inputs, _, last = steps[-1] if steps else ("?", "", "?")
        told = re.findall(r"FOUND (.*)", done.stderr)
        told += [] if done.returncode == 0 else [f"ended with {done.returncode}"]
        print(f"| {target} | {inputs} | {first} | {last} | {len(told)} |", flush=True)
        for line in told:
            print(f"  {line}", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
