"""The node of ROS 2 where there is no ROS 2: what it refuses, and that its shell is whole.

rclpy is on no package index, so the shell is not run here. What it calls is:
``tests/ros/test_service.py``.
"""

import ast
import inspect

from typer.testing import CliRunner

from optipromp import ros
from optipromp.cli import ros_node
from optipromp.cli.main import app
from optipromp.ros import typestore

runner = CliRunner()
TREE = ast.parse(inspect.getsource(ros_node))


def test_without_rclpy_it_says_what_is_missing() -> None:
    result = runner.invoke(app, ["ros-node", "scenario-3"])
    assert result.exit_code == 2
    assert result.stderr.startswith(
        "error INVALID_REQUEST: ros-node needs ROS 2 and finds no rclpy"
    )
    assert len(result.stderr.splitlines()) == 1


def test_help_shows_how_to_start_it() -> None:
    result = runner.invoke(app, ["ros-node", "--help"], env={"COLUMNS": "200"})
    assert "optipromp ros-node my-scene.yaml --prefix fr3_" in result.stdout


def test_the_shell_compiles_and_names_what_there_is() -> None:
    """Its types are ours by name, and what it takes from us exists."""
    compile(TREE, "ros_node.py", "exec")
    names = {n.value for n in ast.walk(TREE) if isinstance(n, ast.Constant)}
    types = {n for n in names if isinstance(n, str) and "/msg/" in n}
    assert len(types) == 4
    assert types <= set(typestore().fielddefs)
    taken = [
        alias.name
        for node in ast.walk(TREE)
        if isinstance(node, ast.ImportFrom) and node.module == "optipromp.ros"
        for alias in node.names
    ]
    assert {"LiveScene", "answer", "from_bytes", "to_bytes"} == set(taken)
    assert all(hasattr(ros, name) for name in taken)


def test_rclpy_is_imported_in_functions_only() -> None:
    top = [n for n in TREE.body if isinstance(n, ast.Import | ast.ImportFrom)]
    assert not any("rclpy" in ast.unparse(node) for node in top)
    (shell,) = (n for n in TREE.body if getattr(n, "name", "") == "_serve")
    assert shell.end_lineno - shell.lineno < 60
