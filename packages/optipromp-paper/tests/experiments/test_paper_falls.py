"""The falls of the paper's costs, from the starts that the paper must have had."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.loaded import script

from optipromp.core.planning.task import posed

pytestmark = pytest.mark.slow  # the paper's costs of two scenes, begun five times
falls = script("paper_falls")
PAGE = Path(__file__).resolve().parents[4] / "docs" / "paper.md"


def test_the_body_is_joint_origins_and_tool_point() -> None:
    robot = posed(falls.scene_of("paper-4"))[0]
    thin, q = falls.as_points(robot), np.linspace(0.1, 0.7, 7)
    points = thin.sphere_centers(q)
    origins, _ = robot.segment_frames(q)
    tool, _ = robot.tool_pose(q)
    for point in points:
        assert (
            np.linalg.norm(np.vstack([origins.reshape(-1, 3), tool]) - point, axis=1).min() < 1e-9
        )
    np.testing.assert_allclose(points[-1], tool)
    assert len(points) >= 7
    assert len(thin.self_pairs) == 0
    assert (thin.spheres.radius == falls.THIN).all()


@pytest.fixture(scope="module")
def found() -> dict[tuple[str, str], Any]:
    return {(fall.scene, fall.term): fall for fall in falls.falls(0)}


def test_f_s_of_iv_begins_where_the_paper_s_does(found: dict[tuple[str, str], Any]) -> None:
    """And falls at least as far in as many iterations."""
    before, after, iterations = falls.PUBLISHED["paper-4"]["static"]
    fall = found["paper-4", "static"]
    assert before / 2.0 < fall.before < 2.0 * before
    assert fall.after <= after
    assert fall.iterations <= iterations


def test_the_fall_of_the_push_hangs_on_the_waypoints(found: dict[tuple[str, str], Any]) -> None:
    """The same two trajectories: the largest factor is more than twice the least."""
    for scene in ("paper-3", "paper-4"):
        least, median, most = found[scene, "push"].factors
        assert 0.0 < least <= median <= most
        assert most > 2.0 * least


def test_the_sum_is_that_of_the_authors() -> None:
    """Of a tool that stands still at y, 100 waypoints are worth 100 / |y|."""
    one = falls.begun("paper-4", 0)
    y = (one.points - one.task.goal.position) @ one.task.scene.frame[1]
    row = int(np.argmin(np.abs(np.abs(y) - 0.03)))
    still = np.tile(one.initial[row], (len(one.initial), 1))
    assert falls.reciprocal(one, still, 100) == pytest.approx(100.0 / abs(y[row]), rel=1e-9)


def test_the_page_holds_the_table_that_the_script_makes(found: dict[tuple[str, str], Any]) -> None:
    page = PAGE.read_text(encoding="utf-8").split(falls.BEGIN)[1].split(falls.END)[0].strip()
    made = falls.table((0, fall) for fall in found.values()).splitlines()
    number = re.compile(r"[\d.]+(e[-+]?\d+)?")
    kept = page.splitlines()
    assert kept[:2] == made[:2]
    assert len(kept) == 2 + 5 * (len(made) - 2)
    for line, other in zip(kept[2:6], made[2:], strict=True):
        assert number.sub("#", line) == number.sub("#", other)
