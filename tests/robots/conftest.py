"""URDF files written for one test."""

from collections.abc import Callable
from pathlib import Path

import pytest

BALL = '<collision><geometry><sphere radius="0.02"/></geometry></collision>'


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """write(text, name="robot.urdf") -> path."""

    def _write(text: str | bytes, name: str = "robot.urdf") -> Path:
        path = tmp_path / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return _write


@pytest.fixture
def urdf(write: Callable[..., Path]) -> Callable[..., Path]:
    """urdf(joints, links) -> path of a robot; by default links a, b, c and joints ab, bc."""

    def _urdf(
        joints: str | None = None,
        links: str = f'<link name="a"/><link name="b">{BALL}</link><link name="c"/>',
    ) -> Path:
        if joints is None:
            joints = joint("ab", "a", "b") + joint("bc", "b", "c")
        return write(f'<robot name="r">{links}{joints}</robot>')

    return _urdf


def joint(
    name: str,
    parent: str,
    child: str,
    kind: str = "revolute",
    limit: str = '<limit lower="-1" upper="1" velocity="2"/>',
    axis: str = '<axis xyz="0 0 1"/>',
    origin: str = '<origin xyz="0.1 0 0.2" rpy="0.1 0.2 0.3"/>',
    more: str = "",
) -> str:
    """A <joint> element."""
    ends = f'<parent link="{parent}"/><child link="{child}"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{origin}{axis}{limit}{more}</joint>'


@pytest.fixture(name="joint")
def joint_fixture() -> Callable[..., str]:
    """The function ``joint``: a <joint> element as text."""
    return joint
