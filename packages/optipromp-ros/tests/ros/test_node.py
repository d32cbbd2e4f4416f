"""The node of ROS 2 where there is no ROS 2. With it, it runs in ``tests/ros/real``."""

import sys

import pytest
from tests.cli.fixtures import invoke


def test_without_rclpy_it_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    result = invoke("ros-node", "scenario-3")
    assert result.exit_code == 2
    assert "error INVALID_REQUEST: ros-node needs ROS 2 and finds no rclpy" in result.stderr
    assert len(result.stderr.splitlines()) == 1
