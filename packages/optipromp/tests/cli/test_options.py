"""Options of a command are described in its docstring."""

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from optipromp.cli.command import Report, command, entries
from optipromp.cli.main import app as optipromp
from optipromp.cli.robot import ArmOptions

OTHERS = {  # of every command, then of git, Ray, ROS, rosbags and inspect-robots
    "--help", "--no-", "--abbrev", "--always", "--dirty", "--exclude", "--head", "--address",
    "--ros-args", "--src", "--dst", "--task", "--embodiment",
}  # fmt: skip


@dataclass(frozen=True)
class Group:
    """Options in a group.

    Attributes:
        words (--word WORD): Said once or
            several times.
        share (SHARE ..1): At most 1.
    """

    words: list[str] | None = None
    share: float = 0.5


@command()
def pick(fruit: str, /, group: Group, *, count: int = 3, twice: bool = False) -> Report:
    """Pick FRUIT.

    Twice where asked.

    Args:
        fruit (FRUIT): Which.
        count (2..5): How many: 2 to 5.
        twice: Pick again.
    """
    told = {"fruit": fruit, "words": group.words, "share": group.share}
    return Report({**told, "count": count, "twice": twice}, [f"{told} {count} {twice}"])


app = typer.Typer(rich_markup_mode="rich")
app.command("pick")(pick)


def call(*words: str) -> Any:
    return CliRunner().invoke(app, [*words], env={"COLUMNS": "100"})


def test_a_parameter_is_an_option_and_one_by_position_alone_an_argument() -> None:
    done = call("plum", "--word", "a", "--word", "b", "--share", "1", "--count", "5", "--twice")
    assert done.exit_code == 0
    expected = {"fruit": "plum", "words": ["a", "b"], "share": 1.0}
    assert done.stdout.split("\n")[0] == f"{expected} 5 True"
    assert call("plum").stdout.startswith(f"{expected | {'words': None, 'share': 0.5}} 3 False")


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["plum", "--count", "6"], "Input should be less than or equal to 5"),
        (["plum", "--count", "1"], "Input should be greater than or equal to 2"),
        (["plum", "--share", "1.5"], "Input should be less than or equal to 1"),
        (["plum", "--no-twice"], "No such option: --no-twice"),
        ([], "Missing argument 'FRUIT'"),
    ],
)
def test_a_value_out_of_bounds_is_refused(words: list[str], told: str) -> None:
    done = call(*words)
    assert done.exit_code == 2
    assert told in done.stderr


def test_the_help_says_of_each_option_what_the_docstring_says_and_no_more() -> None:
    text = " ".join(call("--help").stdout.split())
    for said in ("Pick FRUIT.", "Twice where asked.", "Which.", "How many: 2 to 5.", "WORD",
                 "Said once or several times.", "[default: 3]", "[2<=x<=5]"):  # fmt: skip
        assert said in text
    assert "Args" not in text
    assert "[default: no-twice]" not in text


def ours() -> dict[str, Any]:
    """The parameters of our commands, by command and name."""
    pytest.importorskip("optipromp_bench", reason="it has commands of its own: all packages")
    group: Any = typer.main.get_command(optipromp)
    shown = {name: group.get_command(None, name) for name in group.list_commands(None)}
    shown |= {f"bench {name}": made for name, made in shown.pop("bench").commands.items()}
    shown[""] = group
    assert len(shown) > 20
    return {f"{name} {each.name}": each for name, made in shown.items() for each in made.params}


def test_every_parameter_of_ours_has_help() -> None:
    lacking = [name for name, each in ours().items() if not getattr(each, "help", None)]
    assert [name for name in lacking if not name.endswith(" help")] == []


def test_the_command_line_reads_what_messages_offer() -> None:
    """Every option in the sources is one of a command, and takes a value where it is shown one."""
    known = {flag: each for each in ours().values() for flag in (*each.opts, *each.secondary_opts)}
    found, offer = set[str](), re.compile(r"(?<![\w-])(--[a-z][\w-]*)(?: ([^\s,;)'\"`]+))?")
    for path in (Path(__file__).parents[4] / "packages").rglob("src/**/*.py"):
        for flag, value in offer.findall(path.read_text("utf-8")):
            assert flag in known or flag in OTHERS, (path, flag)
            found.add(flag)
            if re.match(r"[A-Z\d]|\S*:?=", value) and flag in known:
                assert not known[flag].is_flag, (path, flag, value)
            if flag == "--robot-arg" and "=" in value:
                assert ArmOptions(robot_arg=[value]).of(None).choice.args
    assert len(found) > 90


def test_a_docstring_describes_parameters_only() -> None:
    """A name that is misspelt in a docstring would leave its option without help."""

    def wrong(count: int = 1) -> Report:
        """Count.

        Args:
            counts: How many.
        """
        return Report(count, [])

    assert entries(wrong, "Args") == {"counts": ("", "How many.")}
    with pytest.raises(TypeError, match="wrong: no parameter counts"):
        command()(wrong)


def test_an_example_of_the_documentation_works(tmp_path: Path) -> None:
    page = Path(__file__).parents[4] / "docs/extend.md"
    text = page.read_text().split("## A command")[1].split("```python\n")[1].split("```")[0]
    names: dict[str, Any] = {}
    exec(compile(text, "example", "exec"), names)
    mine = typer.Typer()
    mine.command("ripe")(names["ripe"])
    assert CliRunner().invoke(mine, ["scenario-3"]).stdout == "ripe: ripe\n"
