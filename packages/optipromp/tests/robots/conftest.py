"""URDF files written for one test."""

from pathlib import Path

import pytest
from tests.robots.links import BALL, Writer, joint


@pytest.fixture
def write(tmp_path: Path) -> Writer:
    """write(text, name="robot.urdf") -> path."""

    def _write(text: str | bytes, name: str = "robot.urdf") -> Path:
        path = tmp_path / name
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return _write


@pytest.fixture
def urdf(write: Writer) -> Writer:
    """urdf(joints, links) -> path of a robot; by default links a, b, c and joints ab, bc."""

    def _urdf(
        joints: str | None = None,
        links: str = f'<link name="a"/><link name="b">{BALL}</link><link name="c"/>',
    ) -> Path:
        if joints is None:
            joints = joint("ab", "a", "b") + joint("bc", "b", "c")
        return write(f'<robot name="r">{links}{joints}</robot>')

    return _urdf
