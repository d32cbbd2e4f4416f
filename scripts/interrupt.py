"""End commands by a signal at random moments, and look at what they leave.

    python scripts/interrupt.py --runs 100 --seed 0

Every run is one of plan, plan FOLDER, learn, study and report, ended by SIGINT, SIGTERM or SIGKILL.
Afterwards every file has to be whole or absent, no process may be left after ten seconds, and the
two signals that can be heard leave no temporary file and no traceback. A study goes on after each
signal; in the end its rows must be those of one that nothing disturbed.
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import zipfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from optipromp_bench.experiments.rows import Row, rows_of

RUN = [sys.executable, "-m", "optipromp"]
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
PATIENCE = 10.0  # [s] in which the helpers of a process that was killed must end
UNLIKE = {"plan_time": 0.0, "simulation_time": 0.0}  # which no two runs share


def session(leader: int) -> list[int]:
    """The living processes of the session that a process began."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, _, group = path.read_text().rpartition(") ")[2].split()[:4]
        except OSError:
            continue
        if int(group) == leader and state != "Z":
            found.append(int(path.parent.name))
    return found


def faults(folder: Path, heard: bool) -> list[str]:
    """Files that are not whole; temporary ones, where the signal could be heard."""
    found = []
    for path in (path for path in folder.rglob("*") if path.is_file()):
        content = path.read_bytes()
        if path.name.startswith(".") and path.name != ".lock":
            if heard:
                found.append(f"temporary {path.name}")
            continue
        try:
            match path.suffix:
                case ".json":
                    json.loads(content)
                case ".npz":
                    with np.load(path) as archive:
                        assert all(archive[key] is not None for key in archive.files)
                case ".png":
                    assert content.endswith(b"IEND\xaeB`\x82"), "cut"
                case ".html":
                    assert content.rstrip().endswith(b"</html>"), "cut"
                case ".csv" if path.name != "rows.csv":  # which is read up to its last whole row
                    assert content.endswith(b"\n"), "cut"
        except (ValueError, AssertionError, EOFError, zipfile.BadZipFile) as error:
            found.append(f"{path.relative_to(folder)}: {error}")
    return found


def disturbed(arguments: list[str], number: int, after: float, folder: Path) -> tuple[str, bool]:
    """What is wrong once a command was sent a signal, or "", and whether it ended before."""
    with tempfile.TemporaryFile() as told:
        process = subprocess.Popen(
            [*RUN, *arguments], stdout=told, stderr=told, start_new_session=True
        )
        try:
            process.wait(after)
        except subprocess.TimeoutExpired:
            process.send_signal(number)
        early = process.poll() is not None
        process.wait(120)
        deadline = time.monotonic() + PATIENCE
        while (left := session(process.pid)) and time.monotonic() < deadline:
            time.sleep(0.1)
        told.seek(0)
        words = told.read().decode(errors="replace")
    for orphan in left:
        os.kill(orphan, signal.SIGKILL)
    wrong = [f"{len(left)} processes are left"] if left else []
    wrong += faults(folder, number != signal.SIGKILL)
    if "Traceback" in words:
        wrong.append(words[-1500:])
    expected = {0, 1, 130, 143, -signal.SIGKILL, -signal.SIGINT, -signal.SIGTERM}
    if process.returncode not in expected:
        wrong.append(f"exit code {process.returncode}: {words[-300:]}")
    return "; ".join(wrong), early


def rows(folder: Path) -> list[Row]:
    """The rows of a study without their times, in an order of their own."""
    return sorted((replace(row, **UNLIKE) for row in rows_of(folder)), key=lambda row: row.key)


def main() -> None:
    """Run, and print a table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--runs", type=int, default=30)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, work = random.Random(options.seed), Path(tempfile.mkdtemp(prefix="interrupt-"))
    study = ["bench", "study", "presets=cluster", "planners=opti-promp,straight", "seeds=0:4",
             "--workers", "2", "--out"]  # fmt: skip
    demos = work / "demos.npz"
    shape = (8, 40, 7)
    motion = np.linspace(0, 1, 40)[None, :, None] + np.random.default_rng(0).normal(0, 0.01, shape)
    np.savez(demos, positions=motion, joint_names=[f"joint{k}" for k in range(1, 8)])
    for made in (["generate", "--preset", "cluster", "--count", "4", "--out", str(work / "scenes")],
                 ["plan", "scenario-3", "--reach", "--out", str(work / "plan")],
                 [*study, str(work / "undisturbed")]):  # fmt: skip
        subprocess.run([*RUN, *made], check=True, capture_output=True)
    commands = {
        "plan": (["plan", "scenario-3", "--reach", "--out"], "out", 6.0),
        "folder": (
            ["plan", str(work / "scenes"), "--workers", "2", "--figures", "--out"],
            "out",
            12,
        ),
        "learn": (["learn", str(demos), "--out"], "out/learnt.npz", 6.0),
        "report": (["report", str(work / "plan"), "--out"], "out/report.html", 8.0),
        "study": (study, "resumed", 12.0),
    }
    count: Counter[str] = Counter()
    for index in range(options.runs):
        name, number = rng.choice(list(commands)), rng.choice(SIGNALS)
        arguments, target, longest = commands[name]
        shutil.rmtree(work / "out", ignore_errors=True)
        after = rng.uniform(0.0, longest)
        wrong, early = disturbed(
            [*arguments, str(work / target)], number, after, work / target.partition("/")[0]
        )
        count[name] += 1
        count["ended before its signal"] += early
        if wrong:
            count["faults"] += 1
            print(f"{index} {name}, {number.name} after {after:.2f} s: {wrong}", flush=True)
    subprocess.run([*RUN, *study, str(work / "resumed")], check=True, capture_output=True)
    same = rows(work / "resumed") == rows(work / "undisturbed")
    print(dict(count), "the study's rows are", "the same" if same else "OTHERS", f"({work})")
    sys.exit(bool(count["faults"]) or not same)


if __name__ == "__main__":
    main()
