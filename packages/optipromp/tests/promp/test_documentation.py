"""The example of docs/demonstrations.md runs and does what it says."""

import re
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.promp import load_demonstrations

PAGE = Path(__file__).resolve().parents[4] / "docs" / "demonstrations.md"


def test_the_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)
    names: dict[str, object] = {}
    exec(compile(example, str(PAGE), "exec"), names)
    promp, robot, result = names["promp"], names["robot"], names["result"]
    joints = ("lift_joint", "shoulder_joint", "elbow_joint")
    assert promp.joint_names == ("elbow_joint", "lift_joint", "shoulder_joint")  # type: ignore[attr-defined]
    assert robot.joint_names == joints == result.trajectory.joint_names  # type: ignore[attr-defined]
    start = promp.for_joints(joints).mean_trajectory(2)[0]  # type: ignore[attr-defined]
    np.testing.assert_allclose(start, [0.02, 0.8, 0.9], atol=0.02)


def test_the_csv_it_shows_is_read(tmp_path: Path) -> None:
    (text,) = re.findall(r"```\n(demo,.*?)```", PAGE.read_text(), re.DOTALL)
    (tmp_path / "shown.csv").write_text(text)
    recorded = load_demonstrations(tmp_path / "shown.csv")
    assert recorded.joint_names == ("lift_joint", "shoulder_joint", "elbow_joint")
    assert [item.positions[-1, 0] for item in recorded] == [0.25, 0.27]
