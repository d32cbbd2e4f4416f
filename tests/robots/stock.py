"""Arms from stock."""

from pathlib import Path

import pytest

STOCK = {  # of 300 configurations; docs/add-a-robot.md has more
    "ur5": ("ur_description/urdf/ur5_robot.urdf", 0.97),
    "ur10": ("ur_description/urdf/ur10_robot.urdf", 0.97),
    "panda": ("panda_description/urdf/panda.urdf", 0.98),
    "xarm7": ("xarm_description/urdf/xarm7.urdf", 0.97),
    "kinova": ("kinova_description/robots/kinova.urdf", 0.97),
}


def installed(end: str) -> Path:
    """The file of the package example-robot-data whose path ends so; without it the test skips."""
    from importlib.metadata import PackageNotFoundError, files

    try:
        listed = files("example-robot-data") or []
    except PackageNotFoundError:
        pytest.skip("example-robot-data is not installed: pip install 'packages/optipromp[models]'")
    found = [p for p in listed if str(p).endswith(end)]
    return Path(str(found[0].locate())).resolve()


def stock(name: str) -> Path:
    return installed(STOCK[name][0])
