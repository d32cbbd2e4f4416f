"""The page docs/new-user.md does what it says: its commands run in order, in one folder."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/new-user.md"

pytest.importorskip("mujoco")
pytest.importorskip("viser")


def test_the_walk_of_a_new_user(tmp_path: Path) -> None:
    commands = re.findall(r"```bash\n(.*?)```", PAGE.read_text("utf-8"), re.DOTALL)
    assert len(commands) > 6
    names = f'optipromp() {{ "{sys.executable}" -m optipromp "$@"; }}\n'
    names += f'python() {{ "{sys.executable}" "$@"; }}\n'
    script = "set -euo pipefail\n" + names + "\n".join(commands)
    done = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert (tmp_path / "pick/reach.png").stat().st_size > 10_000
    for folder in ("pick", "my-pick"):
        assert json.loads((tmp_path / folder / "plan.json").read_text())["status"] == "success"
        assert (tmp_path / folder / "retreat.csv").exists()
    assert json.loads((tmp_path / "seen.json").read_text())["status"] == "success"
    assert json.loads((tmp_path / "run.json").read_text())["success"]
    assert (tmp_path / "look/cover.png").exists()
    assert len(list((tmp_path / "scenes").glob("*.yaml"))) == 2
    told = " ".join(done.stderr.split())
    assert "my-arm.urdf states no limits of acceleration: 10 rad/s²" in told
    for plan in (tmp_path / "plans").glob("*/plan.json"):
        assert json.loads(plan.read_text())["status"] == "success"
        assert np.abs(np.load(plan.parent / "trajectory.npz")["accelerations"]).max() <= 10.0
    assert json.loads((tmp_path / "tool.json").read_text())["status"] == "success"
    assert json.loads((tmp_path / "loop.json").read_text())["result"] == "clean"
    assert "<html" in (tmp_path / "my-pick.html").read_text()[:200].lower()
