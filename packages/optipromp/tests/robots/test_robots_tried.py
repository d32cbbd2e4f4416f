"""The arms of stock robot files (package example-robot-data, extra `models`), without meshes."""

from pathlib import Path

import pytest
from tests.robots.stock import installed
from tests.robots.tried import EXPECTED, Expected, verdict

from optipromp.readers.arm import choose_arm, read_srdf, srdf_beside
from optipromp.readers.urdf import read_urdf


@pytest.fixture(scope="module")
def robots() -> Path:
    return installed("robots/panda_description/urdf/panda.urdf").parents[2]


@pytest.mark.parametrize("expected", EXPECTED, ids=lambda expected: Path(expected.path).stem)
@pytest.mark.parametrize("groups", [True, False], ids=["SRDF", "rule"])
def test_stock_files(robots: Path, expected: Expected, groups: bool) -> None:
    def choose() -> object:
        model = read_urdf(robots / expected.path)
        srdf = srdf_beside(model) if groups else None
        return choose_arm(model, srdf=None if srdf is None else read_srdf(srdf))

    said, told = verdict(expected, choose)
    assert said == ("asks" if expected.arms > 1 else "right"), told


def test_the_page_is_of_these_files() -> None:
    page = (Path(__file__).parents[4] / "docs/robots-tried.md").read_text("utf-8")
    assert f"All {len(EXPECTED)} are right or asked about" in page
