"""Each command of a page is one of the command line's, and runs as it is written.

The shell reads a page's blocks with a function in the place of each program, so the words are those
that a reader's shell makes of them. All are parsed, with their options. The commands of a page run
in order, in one folder: in every suite those of ``QUICK`` pages, in a night the others, of many
scenes one.
"""

import re
import subprocess
from pathlib import Path

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
QUICK = "docs/commands.md", "docs/export.md"
PARSED = {  # what does not run here, by its words
    r"^view|--teach page": "a page is served until somebody ends it",
    r"^ros-node": "packages/optipromp-ros/tests/ros/real runs it, among nodes of ROS 2",
    r"--ray": "it needs further machines",
    r"\bmine\b|my-arm|\bours\b": "it needs what a reader writes, or a long run",
    r"fruits\.csv|^learn|guided|recorded|mine\.npz|shots|seen\.yaml|row\.mcap|marks\.json|others|shift"
    r"|trajectory\.csv": "it needs what a reader measured or recorded",
    r"conditions=all|seen pictures --crop": "it takes long",
}
SHELL = r"""
for name in python python3 pip pytest ray source lerobot-eval inspect-robots
do eval "$name() { :; }"; done
optipromp() { printf '%s\0' "$@" >> words; printf '\0' >> words; }
set -euo pipefail
"""


def commands(page: str) -> list[list[str]]:
    """The words of our commands in a page's blocks; what its shell writes is in this folder."""
    blocks = re.findall(r"^ *```(\w*)[^\n]*\n(.*?)^ *```$", PAGES[page], re.MULTILINE | re.DOTALL)
    ours = [text.replace(".venv/bin/", "") for kind, text in blocks if kind in ("", "bash")]
    ours = [text for text in ours if re.search("(^|&& )optipromp ", text, re.MULTILINE)]
    Path("words").touch()
    done = subprocess.run(["bash", "-c", SHELL + "\n".join(ours)], capture_output=True, text=True)
    assert done.returncode == 0, (page, done.stderr)
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
    "page", [pytest.param(p, marks=() if p in QUICK else pytest.mark.slow) for p in PAGES]
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
        harms = "--planner paper" in " ".join(words)  # as docs/paper.md says: exit code 1
        assert code == int(harms), (" ".join(words), err)
