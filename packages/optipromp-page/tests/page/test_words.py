"""What the page says and how it looks at a scene, without a browser."""

import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from optipromp.core.errors import Code, InvalidSceneError
from optipromp.core.judging import Violation
from optipromp.core.planning.result import Plan, Said
from optipromp.core.scenes.io import load_scene
from optipromp.looks.appearance import hex_colour, object_parts
from optipromp.looks.viewer.sentences import complaint, sentences
from optipromp.looks.viewer.words import WORDS, head, without_codes
from optipromp_page import content, stage, tabs
from optipromp_page.tabs import legend, planned, replayed, things
from optipromp_sim.generate import generate

FOV = 0.87  # [rad]


def test_a_success_is_told_in_sentences(made: Plan) -> None:
    shifts = content.pushed(made).shifts()
    told = sentences(made, shifts)
    assert told[0] == f"Reaches the target in {made.metrics.duration:.1f} s."
    for name in ("n1", "n2"):
        far = 1e3 * np.hypot(*made.metrics.passage[name])
        moved = f", pushes it {1e3 * shifts[name]:.0f} mm aside"
        assert shifts[name] > 0.01
        assert f"Passes {name} at {far:.0f} mm{moved}, no harm." in told
    room = min(made.metrics.clearance_avoid, made.metrics.clearance_avoid_tool)
    assert told[-1] == f"Stays {1e3 * room:.0f} mm from what it should keep away from."
    assert "Passes n1 at 62 mm, no harm." in sentences(made, {})


def test_no_harm_is_claimed_without_a_prediction_and_long_lists_end(made: Plan) -> None:
    assert "Passes n1 at 62 mm." in sentences(replace(made, prediction=None), {})
    passage = {f"n{k}": (0.0, 0.05 + 0.01 * k) for k in range(9)}
    metrics = replace(made.metrics, passage=passage)
    crowd = replace(made, judgement=replace(made.judgement, metrics=metrics))
    passed = [words for words in sentences(crowd, {"n7": 0.02}) if words.startswith("Passes")]
    assert passed == [
        "Passes n7 at 120 mm, pushes it 20 mm aside, no harm.", "Passes n0 at 50 mm, no harm.",
        "Passes n1 at 60 mm, no harm.", "Passes 6 more, no harm.",
    ]  # fmt: skip


def test_the_table_does_not_judge_again(made: Plan) -> None:
    """It judged every plan that it showed a second time."""
    wrong = Violation("goal", "the goal is missed")
    judgement = replace(made.judgement, violations=(wrong,))
    shown = tabs.table(replace(made, judgement=judgement))
    assert "<li>the goal is missed</li>" in shown
    assert "<li>" not in tabs.table(made)


def test_every_code_has_words_and_none_is_shown(made: Plan) -> None:
    assert set(WORDS) == set(Code)
    for code in Code:
        assert not re.search("[A-Z_]{2,}", head(code)), code
        failed = replace(made, status=code, said=Said(f"after {code}: the arm <stops>"))
        told = tabs.of_plan(failed, "planned in 3 ms", {})
        shown = re.sub("<[^>]*>", " ", told.html())
        assert not re.search("[A-Z]{2,}", shown), shown
        assert f'title="{code}"' in told.html()  # for a bug report
        assert "Planned in 3 ms." in shown
        if code is not Code.SUCCESS:
            assert head(code) in shown
            assert "the arm &lt;stops&gt;" in shown
            assert told.tone is tabs.Tone.BAD
    assert without_codes("GOAL_UNREACHABLE, 2.0 of it") == "the goal is out of reach, 2.0 of it"
    assert complaint(InvalidSceneError("no\n target")) == "The scene cannot be used: no target"
    assert complaint(made) == ""


def test_the_legend_has_the_colours_of_the_picture(made: Plan) -> None:
    scene = made.scene
    found = {words: sign for sign, words in things(scene)}
    assert set(found) == {"target", "may be pushed aside", "the arm keeps away"}
    for item in scene.objects:
        colour = hex_colour(object_parts(scene, item)[0].colour)
        words = {"target": "target", "pushable": "may be pushed aside",
                 "avoid": "the arm keeps away"}[item.role]  # fmt: skip
        assert colour in found[words], item.id
    assert "fixed, not to be touched" in {w for _, w in things(load_scene("scenario-1"))}
    layers = {"trajectories": "tool path", "pushed objects": "predicted push"}
    assert [words for _, words in planned(made, [])] == []
    for layer, words in layers.items():
        assert words in [w for _, w in planned(made, [layer])]
    assert "force of a touch" in legend(replayed(looks=False))
    assert len(replayed(looks=True)) > len(replayed(looks=False))


@pytest.mark.parametrize("size", [(1280, 800), (800, 560), (390, 844), (400, 300)])
@pytest.mark.parametrize("name", ["scenario-1", "scenario-3", "scenario-4", "truss"])
def test_the_first_view_frames_target_neighbours_and_tool(name: str, size: tuple[int, int]) -> None:
    scene = generate("truss", 100) if name == "truss" else load_scene(name)
    tool = scene.target.position - [0.1, 0.05, 0.3]
    centres, radii = stage.balls(scene, tool)
    branches = [o for o in scene.objects if o.stem is not None and o.stem.parent is not None]
    assert len(branches) == (2 if name == "truss" else 0)
    assert len(centres) == 2 + len(scene.pushables) + len(branches)
    camera = _Camera(*size)
    stage.look(camera, scene, tool)
    forward = camera.look_at - camera.position
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, camera.up_direction)
    right = right / np.linalg.norm(right)
    axes = np.stack([right, np.cross(right, forward), forward])
    points = (scene.base @ centres - camera.position) @ axes.T
    spread = np.linspace(0.0, 2.0 * np.pi, 40)
    ring = np.stack([np.cos(spread), np.sin(spread), 0.0 * spread], axis=1)
    outline = (points[:, None] + radii[:, None, None] * ring).reshape(-1, 3)
    assert (outline[:, 2] > 0.05).all()
    u, v = 0.5 * np.array(size)[:, None] / np.tan(0.5 * FOV) * outline[:, :2].T / outline[:, 2]
    u, v = 0.5 * size[0] + u * size[1] / size[0], 0.5 * size[1] - v
    narrow = size[0] <= stage.NARROW
    wide, high = (size[0], 0.5 * size[1]) if narrow else (size[0] - stage.PANEL, size[1])
    assert u.min() >= 0.0 and u.max() <= wide  # noqa: PT018
    assert v.min() >= 0.0 and v.max() <= high  # noqa: PT018
    assert max(np.ptp(u) / wide, np.ptp(v) / high) > 0.6  # near, not the whole room
    assert (scene.base.inverse() @ camera.position) @ scene.up >= stage.CAMERA_LOWEST - 1e-9


class _Camera:
    """The values that viser's camera has, and takes."""

    fov = FOV

    def __init__(self, width: int, height: int) -> None:
        self.image_width, self.image_height = width, height
        self.position = self.look_at = self.up_direction = np.zeros(3)

    def on_update(self, act: Callable[["_Camera"], None]) -> None:
        self.heard = act

    def report(self, **values: Any) -> None:
        vars(self).update(values)
        self.heard(self)
