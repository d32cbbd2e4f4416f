"""What values show in a notebook."""

import base64
import re
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import Plan, plan
from optipromp.core.promp import Basis, ProMP
from optipromp.looks.viewer.serving import plan_page


@pytest.fixture(scope="module")
def made() -> Plan:
    return plan("scenario-4")


@pytest.fixture(scope="module")
def promp() -> ProMP:
    return ProMP(Basis(5), np.zeros((2, 5)), np.eye(10), joint_names=("lift", "turn"))


def test_a_value_prints_one_short_line(made: Plan, promp: ProMP) -> None:
    for value, words in (
        (made, ("scenario-4", "opti-promp", "success")),
        (made.scene, ("scenario-4", "panda", "2 pushable")),
        (made.robot, ("panda", "7 joints", "Cup")),
        (made.trajectory, ("7 joints", f"{made.trajectory.duration:.2f} s")),
        (promp, ("2 joints (lift, turn)", "5 bases")),
    ):
        line = repr(value)
        assert line.startswith(f"<{type(value).__name__} ")
        assert len(line) < 120
        assert "\n" not in line
        for word in words:
            assert word in line


def test_a_notebook_gets_tables(made: Plan, promp: ProMP) -> None:
    html = made._repr_html_()
    assert made.message in html
    assert "clearance, static" in html
    rows = made.scene._repr_html_().count("<tr")
    assert rows == 1 + len(made.scene.objects)
    for value in (made.robot, made.trajectory, promp):
        assert value._repr_html_().count("<tr") == 1 + len(value.joint_names)


def test_pictures_are_shown_and_saved(made: Plan, promp: ProMP, tmp_path: Path) -> None:
    for value in (made, made.trajectory, made.robot, promp):
        picture = value.plot()
        assert picture._repr_png_().startswith(b"\x89PNG")
        assert picture.figure.axes
    picture.save(tmp_path / "promp.png")
    assert (tmp_path / "promp.png").read_bytes() == picture._repr_png_()
    with pytest.raises(InvalidRequestError, match="no picture of a Scene"):
        made.scene.plot()


def test_views_need_no_network(made: Plan, tmp_path: Path) -> None:
    for value in (made, made.scene, made.robot):
        view = value.show()
        assert view._repr_html_().startswith('<iframe sandbox="allow-scripts" srcdoc=')
        assert not re.search(r"""(?:src|href)=["']https?:""", view.html)
    view.save(tmp_path / "arm.html")
    assert (tmp_path / "arm.html").stat().st_size < 4e6
    with pytest.raises(InvalidRequestError, match="no 3-D view of a Trajectory"):
        made.trajectory.show()


def recorded(page: str) -> list[tuple[float, dict]]:
    """Messages of a page, with their times [s]."""
    import msgspec
    import zstandard

    content = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]+)"', page).group(1))
    raw = zstandard.ZstdDecompressor().decompressobj().decompress(content[8:])
    size = int.from_bytes(raw[:8], "little")
    return msgspec.msgpack.decode(raw[8 : 8 + size])["messages"]


def test_the_view_of_a_plan_moves_arm_and_fruits_as_planned(made: Plan) -> None:
    messages = recorded(plan_page(made))
    last = made.robot.n_segments - 1
    at = {"arm": [], "fruit": []}
    names = {f"/base/arm/{last}": "arm", "/base/things/pushable:n1": "fruit"}
    for time, message in messages:
        if message["type"] == "SetPositionMessage" and message["name"] in names:
            at[names[message["name"]]].append((time, message["position"]))
    for time, position in at["arm"][:: len(at["arm"]) // 4]:
        q = made.trajectory.sample(min(time, made.trajectory.duration))[0][0]
        np.testing.assert_allclose(position, made.robot.segment_frames(q)[0][last], atol=5e-3)
    fruit = next(item for item in made.scene.objects if item.id == "n1")
    moved = [np.linalg.norm(np.subtract(position, fruit.position)) for _, position in at["fruit"]]
    assert max(moved) > 0.01
    assert max(time for time, _ in at["arm"]) >= made.trajectory.duration - 0.1
