"""How many joints? The same bunches, tool and judge for arms of equal reach with 3 to 7 joints.

    python scripts/joints_study.py --out joints --count 200 --set 2026-11
    python scripts/joints_study.py --out joints --count 200 --set 2026-11 --neck 0.45
    python scripts/joints_study.py --out joints --figure docs/images/joints.png
    python scripts/joints_study.py --out joints --count 50 --further UR5=ur5_robot.urdf

Every arm of the family is made of one set of links: a column of 0.30 m, an upper arm of 0.42 m, a
forearm of 0.33 m and a wrist of 0.105 m, so the flange reaches 0.855 m from the shoulder, as a
Panda's. Names tell the joints from the base on: y turns about the vertical, p pitches, r rolls
about the link, s slides along the vertical. ``scara`` and ``panda`` stand beside them, and the
Panda with joints fixed at 0: ``panda -7`` is without its last. Further arms are given by name and
file. The base is placed for each scene (:mod:`optipromp_sim.generate.placing`).
Cells: ``open`` (preset cluster), ``table`` (table-top), ``between`` (side-clusters), and ``tilted``
(cluster, the approach up to 25 degrees off the vertical). The cup's neck is 0.10 m long, or longer
where links would reach fruits (``yys``: 0.4 m); with ``--neck`` all have one of that length. Rows
are kept in OUT/rows.csv, and a run goes on where it ended. The table is printed at the end.
"""

import argparse
import csv
import hashlib
import itertools
import math
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import plan
from optipromp.core.processes import cores, run_each
from optipromp.core.robots.library import NOTHING, load_robot
from optipromp.core.scenes.scene import Scene
from optipromp_bench.experiments.statistics import wilson
from optipromp_bench.table import paired, told_p
from optipromp_sim.generate import generate
from optipromp_sim.generate.placing import ROUNDS, UnfitError, fitted

COLUMN, UPPER, FORE, WRIST = 0.30, 0.42, 0.33, 0.105  # [m] of the links
RADIUS, LIMIT, SPEED = 0.045, 2.9, 2.2  # [m], [rad], [rad/s] of every link and joint
SLIDE = 0.40  # [m] of a joint that slides
TILT = 25.0  # [deg] off the vertical, at most
CELLS = {"open": "cluster", "table": "table-top", "between": "side-clusters", "tilted": "cluster"}
FAMILY: Mapping[str, str] = {
    "3 yys": "yys", "4 yppp": "yppp", "5 ypprp": "ypprp", "6 ypprpr": "ypprpr",
    "6 yprprp": "yprprp", "7 yprprpr": "yprprpr",
}  # fmt: skip
STOCK = ("scara", "panda")
PANDAS: Mapping[str, tuple[int, ...]] = {
    "panda -7": (7,), "panda -5": (5,), "panda -3": (3,), "panda -3 -7": (3, 7),
    "panda -3 -5 -7": (3, 5, 7),
}  # fmt: skip
"""Joints of the Panda that are fixed at 0."""


def urdf(joints: str) -> str:
    """An arm of the family as URDF text.

    The letters are joints from the base on. Pitching joints stand at the shoulder, the elbow and
    the wrist; rolling ones lie in the link before the next pitch; of ``yys`` both turn about the
    vertical, and the hand hangs on a slide.
    """
    lengths = {0: UPPER, 1: FORE, 2: WRIST}
    parts, index, at, pitches = [_link("base", COLUMN, "0 0 1")], 0, f"0 0 {COLUMN}", 0
    parent = "base"
    if joints == "yys":
        ahead = (UPPER, FORE)
        for k, long in enumerate(ahead):
            parts += [_joint(k, "revolute", parent, at, "0 0 1"), _link(f"l{k}", long, "1 0 0")]
            parent, at = f"l{k}", f"{long} 0 0"
        parts += [_joint(2, "prismatic", parent, at, "0 0 1"), _link("l2", WRIST, "0 0 1")]
        return _robot([*parts, _flange("l2", f"0 0 {WRIST}")])
    for letter in joints:
        axis = {"y": "0 0 1", "p": "0 1 0", "r": "0 0 1"}[letter]
        name = f"l{index}"
        parts.append(_joint(index, "revolute", parent, at, axis))
        if letter == "p":
            parts.append(_link(name, lengths[pitches], "0 0 1"))
            at, pitches = f"0 0 {lengths[pitches]}", pitches + 1
        else:
            parts.append(_link(name, 0.0, "0 0 1"))
            at = "0 0 0"
        parent, index = name, index + 1
    return _robot([*parts, _flange(parent, at)])


def _robot(parts: Iterable[str]) -> str:
    return f'<robot name="family">{"".join(parts)}</robot>'


def _link(name: str, long: float, along: str) -> str:
    x, _, z = (float(value) for value in along.split())
    middle = f"{0.5 * long * x} 0 {0.5 * long * z}"
    turn = "0 1.5707963 0" if x else "0 0 0"
    mass = 1.0 + 4.0 * long
    body = ""
    if long > 0.05:
        size = f'<cylinder radius="{RADIUS}" length="{long}"/>'
        origin = f'<origin xyz="{middle}" rpy="{turn}"/>'
        body = f"<collision>{origin}<geometry>{size}</geometry></collision>"
    inertia = 'ixx="0.02" iyy="0.02" izz="0.01" ixy="0" ixz="0" iyz="0"'
    return (
        f'<link name="{name}"><inertial><origin xyz="{middle}"/><mass value="{mass}"/>'
        f"<inertia {inertia}/></inertial>{body}</link>"
    )


def _joint(index: int, kind: str, parent: str, at: str, axis: str) -> str:
    low, high = (-SLIDE, 0.0) if kind == "prismatic" else (-LIMIT, LIMIT)
    return (
        f'<joint name="j{index}" type="{kind}"><parent link="{parent}"/><child link="l{index}"/>'
        f'<origin xyz="{at}"/><axis xyz="{axis}"/>'
        f'<limit lower="{low}" upper="{high}" velocity="{SPEED}" effort="200"/></joint>'
    )


def _flange(parent: str, at: str) -> str:
    return (
        f'<link name="flange"/><joint name="f" type="fixed"><parent link="{parent}"/>'
        f'<child link="flange"/><origin xyz="{at}"/></joint>'
    )


def panda_without(joints: Iterable[int], folder: Path) -> Path:
    """The built-in Panda with joints fixed at 0, as a robot file; its body is the same."""
    data = files("optipromp.core.robots").joinpath("data")
    text, robot = (
        data.joinpath("panda.urdf").read_text(),
        yaml.safe_load(data.joinpath("panda.yaml").read_text()),
    )
    for joint in joints:
        text = text.replace(f'"joint{joint}" type="revolute"', f'"joint{joint}" type="fixed"')
    name = "panda-without-" + "-".join(str(joint) for joint in joints)
    for key in ("acceleration", "jerk", "home"):
        robot[key] = [value for k, value in enumerate(robot[key], 1) if k not in joints]
    robot.update(name=name, urdf=f"{name}.urdf")
    (folder / f"{name}.urdf").write_text(text)
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(robot))
    return path


@dataclass(frozen=True)
class JointsRow:
    """One arm before one scene; ``neck`` is the least length of the cup's neck [m]."""

    arm: str
    cell: str
    seed: int
    neck: float = 0.0
    reachable: bool = False
    planned: bool = False
    picked: bool = False
    harmed: bool = False
    told: str = ""


def arms(folder: Path) -> dict[str, str]:
    """Names and files of all arms; files of the family are written to ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    out = {}
    for name, joints in FAMILY.items():
        file = folder / f"{joints}.yaml"
        (folder / f"{joints}.urdf").write_text(urdf(joints))
        acceleration = ", ".join(["10.0"] * len(joints))
        file.write_text(
            f"format: 1\nname: {joints}\nurdf: {joints}.urdf\nflange: flange\n"
            f"acceleration: [{acceleration}]\n"
        )
        out[name] = str(file.resolve())
    fixed = {name: str(panda_without(each, folder).resolve()) for name, each in PANDAS.items()}
    return {**out, **{name: name for name in STOCK}, **fixed}


def scene_of(cell: str, seed: int) -> Scene:
    """The bunch of a cell before a Panda."""
    scene = generate(CELLS[cell], seed)  # type: ignore[arg-type]
    if cell != "tilted":
        return scene
    rng = np.random.default_rng([zlib.crc32(b"tilted"), seed])
    angle, way = math.radians(TILT) * math.sqrt(rng.random()), 2.0 * math.pi * rng.random()
    axis = np.array(
        [math.sin(angle) * math.cos(way), math.sin(angle) * math.sin(way), math.cos(angle)]
    )
    return replace(scene, approach=replace(scene.approach, direction=axis))


def one(arm: str, file: str, cell: str, seed: int, neck: float = 0.0) -> JointsRow:
    """Place the base, plan, and execute what is promised."""
    from optipromp_sim.generate.plants import untold
    from optipromp_sim.simulation import simulate

    row = JointsRow(arm, cell, seed, neck)
    try:
        scene = fitted(
            scene_of(cell, seed), load_robot(file), file, NOTHING, turned=False, rounds=ROUNDS,
            neck=neck,
        )  # fmt: skip
    except UnfitError as unfit:
        return replace(row, told=unfit.requirement)
    row = replace(row, reachable=True)
    try:
        made = plan(untold(scene), seed=seed)
        if not made.success:
            return replace(row, told=str(made.status))
        outcome = simulate(made.trajectory, scene, robot=made.robot, seed=seed).outcome
    except OptiPrompError as error:
        return replace(row, told=str(error.code))
    harm = [str(cause) for cause in outcome.causes if cause != "not_picked"]
    return replace(
        row, planned=True, picked=bool(outcome.success), harmed=bool(harm),
        told=" ".join(outcome.causes),
    )  # fmt: skip


def run(
    out: Path, count: int, word: str, neck: float, names: list[str], further: Mapping[str, str],
    workers: int,
) -> None:  # fmt: skip
    """Run what OUT/rows.csv lacks."""
    known = {**arms(out / "arms"), **further}
    done = {(row.arm, row.cell, row.seed, row.neck) for row in rows_of(out)}
    first = 10_000_000 + 1000 * (
        int.from_bytes(hashlib.sha256(word.encode()).digest()[:8], "big") % 1_000_000
    )
    tasks = [
        (arm, known[arm], cell, seed, neck)
        for seed in range(first, first + count)
        for cell in CELLS
        for arm in names or further or known
        if (arm, cell, seed, neck) not in done
    ]
    path = out / "rows.csv"

    def hear(index: int, row: Any) -> None:
        if isinstance(row, Exception):
            raise SystemExit(f"{tasks[index]}: {row}")
        with path.open("a", newline="") as stream:
            table = csv.DictWriter(stream, list(asdict(row)))
            if stream.tell() == 0:
                table.writeheader()
            table.writerow(asdict(row))
        if index % 50 == 0:
            print(f"{index} of {len(tasks)}", flush=True)

    run_each(one, tasks, hear, workers=workers)


def rows_of(out: Path) -> list[JointsRow]:
    """The rows so far."""
    path = out / "rows.csv"
    if not path.exists():
        return []
    with path.open() as stream:
        return [
            JointsRow(
                r["arm"], r["cell"], int(r["seed"]), float(r["neck"]), told=r["told"],
                **{k: r[k] == "True" for k in ("reachable", "planned", "picked", "harmed")},
            )
            for r in csv.DictReader(stream)
        ]  # fmt: skip


def _order(rows: list[JointsRow]) -> list[str]:
    known, found = (*FAMILY, *STOCK, *PANDAS), dict.fromkeys(row.arm for row in rows)
    return [*(name for name in known if name in found), *(n for n in found if n not in known)]


def necks(rows: list[JointsRow]) -> list[float]:
    """The least lengths of necks in rows [m]."""
    return sorted({row.neck for row in rows})


def told_neck(neck: float) -> str:
    """A neck in words."""
    return f"neck {neck:g} m" if neck else "neck as short as may be"


def table(rows: list[JointsRow]) -> str:
    """Shares by neck, arm and cell, and paired tests of the family, one joint more each."""
    lines, order = list[str](), _order(rows)
    head = ["| arm | cell | n | reachable | planned | picked (95 %) | harmed |", "|---" * 7 + "|"]
    for neck, cell in itertools.product(necks(rows), CELLS):
        if cell == next(iter(CELLS)):
            lines += ["", f"{told_neck(neck)}:", "", *head]
        for arm in order:
            own = [row for row in rows if (row.arm, row.cell, row.neck) == (arm, cell, neck)]
            if not own:
                continue
            n = len(own)
            sums = [sum(getattr(r, k) for r in own) for k in ("reachable", "planned", "picked")]
            low, high = wilson(sums[2], n)
            told = " | ".join(f"{100 * s / n:.0f}" for s in sums)
            harmed = sum(r.harmed for r in own)
            lines.append(
                f"| {arm} | {cell} | {n} | {told} ({100 * low:.0f}–{100 * high:.0f}) | {harmed} |"
            )
    lines += [
        "",
        "| neck | cell | arms | picked by the first alone, the second alone | p |",
        "|---" * 5 + "|",
    ]
    picked = {(r.neck, r.arm, r.cell, r.seed): r.picked for r in rows}
    for neck, cell in itertools.product(necks(rows), CELLS):
        family = [name for name in order if name in FAMILY]
        others = [(name, "panda") for name in order if name not in (*FAMILY, "panda")]
        for a, b in [*itertools.pairwise(family), *others]:
            pairs = [
                (got, picked[neck, b, cell, seed])
                for (k, arm, c, seed), got in picked.items()
                if (k, arm, c) == (neck, a, cell) and (neck, b, cell, seed) in picked
            ]
            if not pairs:
                continue
            alone = sum(x and not y for x, y in pairs), sum(y and not x for x, y in pairs)
            p = told_p(paired(pairs))
            lines.append(
                f"| {neck or 'short'} | {cell} | {a}, {b} | {alone[0]}, {alone[1]} | {p} |"
            )
    return "\n".join(lines)


def told_arm(name: str) -> str:
    """The name of an arm in a figure."""
    arm, _, rest = name.partition(" ")
    if name in FAMILY:
        return f"{arm} joints: {rest}"
    return f"{arm} without joint {rest.removeprefix('-')}" if rest else arm


def figure(rows: list[JointsRow], path: Path) -> None:
    """Shares picked by arm with intervals, a panel a cell, a row a neck; grey: reachable."""
    import matplotlib.pyplot as plt
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    held, size = necks(rows), len(CELLS)
    drawn, grid = plt.subplots(
        len(held), size, figsize=(15, 3.8 * len(held)), sharey=True, squeeze=False
    )
    for panel, (neck, cell) in zip(grid.flat, itertools.product(held, CELLS), strict=True):
        own = [row for row in rows if (row.neck, row.cell) == (neck, cell)]
        order = _order(own)
        for k, arm in enumerate(order):
            mine = [row for row in own if row.arm == arm]
            n, got = len(mine), sum(row.picked for row in mine)
            low, high = wilson(got, n)
            panel.bar(k, sum(row.reachable for row in mine) / n, color="0.85")
            panel.bar(k, got / n, color="tab:blue" if arm in FAMILY else "tab:orange", width=0.6)
            panel.plot([k, k], [low, high], color="black", lw=1)
        panel.set_title(f"{cell}, {told_neck(neck)}", fontsize=10)
        names = [told_arm(name) for name in order]
        panel.set_xticks(range(len(order)), names, rotation=60, ha="right", fontsize=8)
    for panel in grid[:, 0]:
        panel.set_ylabel("share of scenes")
    signs = [
        Patch(
            color="tab:blue",
            label="picked, by arms of one set of links (y yaws, p pitches, r rolls, s slides)",
        ),
        Patch(color="tab:orange", label="picked, by arms that are made"),
        Patch(color="0.85", label="within reach"),
        Line2D([], [], color="black", lw=1, label="95 %"),
    ]
    drawn.tight_layout(rect=(0.0, 0.04, 1.0, 1.0))
    drawn.legend(handles=signs, loc="lower center", ncols=len(signs), frameon=False)
    drawn.savefig(path, dpi=90)


def main() -> None:
    """See the module."""
    ask = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    ask.add_argument("--out", type=Path, required=True)
    ask.add_argument("--count", type=int, default=0, help="scenes a cell")
    ask.add_argument("--set", default="development", metavar="WORD", help="as of bench run")
    ask.add_argument("--neck", type=float, default=0.0, help="least length of the cup's neck [m]")
    ask.add_argument("--arms", default="", help="separated by semicolons; all if left out")
    ask.add_argument("--further", nargs="*", default=[], metavar="NAME=FILE", help="more arms")
    ask.add_argument("--workers", type=int, default=cores())
    ask.add_argument("--figure", type=Path)
    told = ask.parse_args()
    if told.count:
        names = [name for name in told.arms.split(";") if name]
        further = dict(each.split("=", 1) for each in told.further)
        run(told.out, told.count, told.set, told.neck, names, further, told.workers)
    rows = rows_of(told.out)
    print(table(rows))
    if told.figure:
        figure(rows, told.figure)


if __name__ == "__main__":
    main()
