"""The node of ROS 2 where there is no ROS 2. With it, it runs in ``tests/ros/real``."""

import sys

import pytest
from tests.cli.fixtures import refused


def test_without_rclpy_it_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "rclpy", None)
    said = refused("ros-node", "scenario-3")
    assert "error INVALID_REQUEST: ros-node needs ROS 2 and finds no rclpy" in said
