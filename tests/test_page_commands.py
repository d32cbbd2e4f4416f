"""Each command of a page is one of the command line's, and runs as it is written.

The shell reads a page's blocks with a function in the place of each program, so the words are those
that a reader's shell makes of them. All are parsed. The commands of a page run in order, in one
folder: in every suite those of ``QUICK`` pages, in a night the others, of many scenes one.
"""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import typer.main
from tests.cli.fixtures import call

from optipromp.cli.main import app
from optipromp.core.scenes import load_scene, save_scene
from optipromp_bench.experiments.tables import studies_of

ROOT = Path(__file__).resolve().parents[1]
PAGES = {str(path.relative_to(ROOT)): path.read_text("utf-8")
         for path in (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))}  # fmt: skip
del PAGES["docs/figures.md"]  # its commands run in the commits that it names
QUICK = ("docs/commands.md",)
APART = "docs/new-user.md", "docs/gallery.md"  # below; scripts/gallery.py makes its pictures
PARSED = {  # what does not run here, by its words
    r"^view|--teach page": "a page is served until somebody ends it",
    r"^ros-node": "packages/optipromp-ros/tests/ros/real runs it, among nodes of ROS 2",
    r"--ray|\bmine\b|my-arm|\bours\b": "it needs further machines, or what a reader writes",
    r"fruits\.csv|^learn|guided|recorded|mine\.npz|shots|seen\.yaml|row\.mcap|marks\.json|others|shift"
    r"|trajectory\.csv": "it needs what a reader measured or recorded",
    r"conditions=all|scripts/|^episodes": "it takes long: publish.py and .ci/real-lerobot run it",
    r"^see pictures --crop": "pictures of tomatoes are a reader's",
}
LISTED = """
for name in python python3 pip pytest ray source lerobot-eval inspect-robots
do eval "$name() { :; }"; done
optipromp() { printf '%s\\0' "$@" >> words; printf '\\0' >> words; }
"""
RUN = f"""
optipromp() {{ [ "$1" = view ] || "{sys.executable}" -m optipromp "$@"; }}
python() {{ "{sys.executable}" "$@"; }}
"""


def shell(page: str, functions: str) -> str:
    """Let a shell read the blocks of a page that have commands of ours; what it was warned of."""
    blocks = re.findall(r"^ *```(\w*)[^\n]*\n(.*?)^ *```$", PAGES[page], re.MULTILINE | re.DOTALL)
    ours = [text.replace(".venv/bin/", "") for kind, text in blocks if kind in ("", "bash")]
    ours = [text for text in ours if re.search("(^|&& )optipromp ", text, re.MULTILINE)]
    script = "\n".join([functions, "set -euo pipefail", *ours])
    done = subprocess.run(["bash", "-c", script], capture_output=True, text=True, timeout=900)
    assert done.returncode == 0, (page, done.stdout + done.stderr)
    return done.stderr


def commands(page: str) -> list[list[str]]:
    """The words of our commands in a page's blocks; what its shell writes is in this folder."""
    Path("words").touch()
    shell(page, LISTED)
    told = Path("words").read_text("utf-8")
    return [words.split("\0") for words in told.split("\0\0")[:-1]]


def check(words: list[str]) -> None:
    """Raise where the command line does not know a command, an option, or a field of a study."""
    command, name, context = typer.main.get_command(app), "optipromp", None
    while hasattr(command, "resolve_command"):
        context = command.make_context(name, words, parent=context)
        left = [*context._protected_args, *context.args]
        name, command, words = command.resolve_command(context, left)
    context = command.make_context(name, words, parent=context)
    if name == "study":
        crop = context.params["crop"]
        studies_of(context.params["what"], **({"crop": crop} if crop else {}))


def test_every_command_of_every_page_is_known(tmp_path, monkeypatch) -> None:
    found = 0
    for k, page in enumerate(PAGES):
        (tmp_path / str(k)).mkdir()
        monkeypatch.chdir(tmp_path / str(k))
        each = commands(page)
        monkeypatch.chdir(ROOT)  # which has the studies
        for words in each:
            try:
                check(words)
            except Exception as error:
                pytest.fail(f"{page}: optipromp {' '.join(words)}: {error}")
        found += len(each)
    assert found > 120


@pytest.mark.parametrize(
    "page",
    [pytest.param(p, marks=[pytest.mark.slow][p in QUICK :]) for p in PAGES if p not in APART],
)
def test_the_commands_of_a_page_run(page, tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    save_scene(load_scene("scenario-4"), Path("my-scene.yaml"))
    before = ["plan", "scenario-4", "--out", "pick", "--no-figures"]  # the README's first command
    for words in (before, *commands(page)):
        line = "\0".join(words)
        if any(re.search(told, " ".join(words)) for told in PARSED):
            continue
        line = re.sub(r"(?<=--count\0)\d+", "1", line)
        line = re.sub(r"(?<=seeds.)(\d+):\d+", lambda m: f"{m[1]}:{int(m[1]) + 1}", line)
        code, _, err = call(*line.split("\0"))
        drawn = words[0] in ("plan", "simulate") and "scenario" not in line
        refused = drawn or "--planner paper" in " ".join(words)  # "no" is an answer: exit code 1
        assert code <= int(refused), (" ".join(words), err)


def test_the_walk_of_a_new_user(tmp_path, monkeypatch) -> None:
    pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    told = shell("docs/new-user.md", RUN)
    assert (tmp_path / "pick/reach.png").stat().st_size > 10_000
    for folder in ("pick", "my-pick"):
        assert json.loads((tmp_path / folder / "plan.json").read_text())["status"] == "success"
        assert (tmp_path / folder / "retreat.csv").exists()
    assert json.loads((tmp_path / "seen.json").read_text())["status"] == "success"
    assert json.loads((tmp_path / "run.json").read_text())["success"]
    assert (tmp_path / "look/cover.png").exists()
    assert len(list((tmp_path / "scenes").glob("*.yaml"))) == 2
    told = " ".join(told.split())
    assert "my-arm.urdf states no limits of acceleration: 10 rad/s²" in told
    for plan in (tmp_path / "plans").glob("*/plan.json"):
        assert json.loads(plan.read_text())["status"] == "success"
        assert np.abs(np.load(plan.parent / "trajectory.npz")["accelerations"]).max() <= 10.0
    assert json.loads((tmp_path / "tool.json").read_text())["status"] == "success"
    assert json.loads((tmp_path / "loop.json").read_text())["result"] == "clean"
    assert "<html" in (tmp_path / "my-pick.html").read_text()[:200].lower()
