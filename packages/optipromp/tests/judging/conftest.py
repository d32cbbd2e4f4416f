"""Robots that the tests of the judge share."""

from pathlib import Path

import pytest
from tests.judging.balls import ball, joint

from optipromp.core.robots.library import load_robot
from optipromp.core.robots.model import Robot
from optipromp.core.robots.tools import Cup, with_tool


@pytest.fixture(scope="module")
def panda() -> Robot:
    return with_tool(load_robot("panda"), Cup(0.05))


@pytest.fixture(scope="module")
def scara() -> Robot:
    return with_tool(load_robot("scara"), Cup(0.03))


@pytest.fixture(scope="module")
def gantry(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """Three prismatic joints along x, y, z: the tool is where the joints say, 0.13 above them.

    The carriage of y is a ball of radius 0.02, proximal; that of z one of 0.01, distal.
    """
    limit = '<limit lower="-2" upper="2" effort="1" velocity="1"/>'
    text = (
        '<robot name="gantry"><link name="base"/>'
        + '<link name="x"/>' + ball("y", 0.02, "0 0 -0.5") + ball("z", 0.01)
        + joint("jx", "prismatic", "base", "x", "1 0 0", limit)
        + joint("jy", "prismatic", "x", "y", "0 1 0", limit)
        + joint("jz", "prismatic", "y", "z", "0 0 1", limit)
        + "</robot>"
    )  # fmt: skip
    path: Path = tmp_path_factory.mktemp("gantry") / "gantry.urdf"
    path.write_text(text, encoding="utf-8")
    head = "format: 1\nname: gantry\nurdf: gantry.urdf\n"
    file = path.with_suffix(".yaml")
    file.write_text(head + "acceleration: none\njerk: none\n", encoding="utf-8")
    return with_tool(load_robot(file), Cup(0.05))


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Robot:
    """One continuous joint about z with a ball of radius 0.02, half a metre out."""
    text = (
        '<robot name="wheel"><link name="base"/>' + ball("rim", 0.02, "0.5 0 0")
        + joint("turn", "continuous", "base", "rim", "0 0 1", "") + "</robot>"
    )  # fmt: skip
    path: Path = tmp_path_factory.mktemp("wheel") / "wheel.urdf"
    path.write_text(text, encoding="utf-8")
    return load_robot(str(path))
