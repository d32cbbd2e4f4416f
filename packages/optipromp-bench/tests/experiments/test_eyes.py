"""The circle from picture to pick: rows, targets, the fit of the camera, the worst pictures."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import invoke, refused, told

from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp_bench.experiments import eyes
from optipromp_bench.experiments.eyes import NOT_SEEN, STILL, RenderedDetector, aimed_at, situation
from optipromp_bench.experiments.rows import rows_of
from optipromp_bench.experiments.study import Study
from optipromp_bench.experiments.trials import run_trials
from optipromp_sim.generate import generate
from optipromp_sim.simulation.detector import Truth
from optipromp_sim.simulation.detector_parameters import EYES, DetectorParameters
from optipromp_sim.situations import Situation

ROOT = Path(__file__).parents[4]
SEED = 60011


def test_a_study_sees_plans_executes_and_goes_on(tmp_path: Path) -> None:
    words = ["bench", "study", "presets=cluster", "eyes=rendered", "--workers", "1", "--out",
             str(tmp_path), "risk=0.1"]  # fmt: skip
    first = invoke(*words, f"seeds={SEED}:{SEED + 1}")
    assert "recall" in first.stdout
    (row,) = rows_of(tmp_path)
    (cell,) = told(*words, f"seeds={SEED}:{SEED + 2}")["cells"]
    rows = rows_of(tmp_path)
    assert rows[0] == row
    assert len(rows) == 2
    assert cell["runs"] == 2
    assert cell["picked"] == sum(bool(each.picked) for each in rows) >= 1
    for each in rows:
        assert (each.loop, each.condition, each.finder) == ("open", "rendered", "geometry")
        assert each.visible is not None
        assert each.found is not None
        assert each.pictures is not None
        assert 1 <= each.found <= each.visible <= each.pictures * (each.pushables + 1)
    assert "finder" in refused(*words, f"seeds={SEED}:{SEED + 1}", "finder=network")


def test_a_scene_without_a_ripe_fruit_in_view_gives_up(monkeypatch: pytest.MonkeyPatch) -> None:
    blind = replace(EYES["beside"], missed=1.0, hidden=1.0)
    monkeypatch.setitem(eyes.EYES, "beside", blind)
    setting = situation("fitted", generate("cluster", SEED), SEED, "geometry")
    assert setting.seen.target is None
    assert setting.figures == {"pictures": 2}
    study = Study(("cluster",), ("opti-promp",), loops=("open",), eyes=("fitted",))
    (row,) = run_trials(study, "cluster", SEED, "fitted", ("open",), "x")
    assert (row.cause, row.result, row.pictures) == (NOT_SEEN, "gave_up", 2)


def test_the_pick_of_any_ripe_fruit_counts() -> None:
    scene = generate("cluster", SEED)
    other = scene.pushables[0]
    seen = other.position + 0.003
    assert aimed_at(scene, {scene.target.id}, seen) is scene
    aimed = aimed_at(scene, {scene.target.id, other.id}, seen)
    assert aimed.target.id == other.id
    assert scene.target.id in {item.id for item in aimed.pushables}


def test_a_rendered_look_shows_the_moment() -> None:
    scene = generate("cluster", SEED)
    robot, state = posed(scene)
    detector = RenderedDetector(scene, robot, DetectorParameters(mount="beside"), SEED)
    target = scene.target
    aside = target.position + [0.0, 0.0, -0.03]
    moved = Truth(
        (target.id,), aside[None], target.rotation[None],
        (target.stem.points[::-1] + [0.0, 0.0, -0.03],),
    )  # fmt: skip
    for truth, place in ((STILL, target.position), (moved, aside)):
        look = detector.expose(0.5, state.q, truth)
        (seen,) = (item for item in look.in_base() if item.role == "target")
        assert np.linalg.norm(seen.position - place) < 0.012
        assert look.time == 0.5
    again = RenderedDetector(scene, robot, DetectorParameters(mount="beside"), SEED)
    first = again.expose(0.5, state.q, STILL).in_base()
    second = detector.expose(0.5, state.q, STILL).in_base()
    assert all((a.position != b.position).any() for a, b in zip(first, second, strict=False))


def test_two_views_are_fused(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = generate("cluster", SEED)
    sure = replace(EYES["beside"], false=0.0, missed=0.0, hidden=0.0)
    monkeypatch.setitem(eyes.EYES, "beside", sure)
    one, two = (situation("fitted", scene, SEED, views=n) for n in (1, 2))
    assert (one.figures["pictures"], two.figures["pictures"]) == (1, 2)
    assert one.further is not None
    assert two.further is None
    more = one.further()
    assert more.figures["pictures"] == 2

    def spread(setting: Situation) -> float:
        return max(
            float(np.linalg.eigvalsh(item.covariance)[-1])
            for item in setting.seen.objects
            if item.covariance is not None
        )

    assert spread(two) < 0.7 * spread(one)
    assert spread(more) == spread(two)
    assert len(two.seen.pushables) == len(scene.pushables)
    assert np.linalg.norm(two.seen.target.position - scene.target.position) < 0.006


def test_what_no_study_of_eyes_is_is_refused() -> None:
    given = {"presets": ("cluster",), "planners": ("opti-promp",), "loops": ("open",)}
    for wrong, words in (
        ({"eyes": ("render",)}, "rendered"), ({"eyes": ("rendered",), "finder": "net"}, "network"),
        ({"eyes": ("fitted",), "conditions": ("sway",)}, "the place"),
        ({"eyes": ("fitted",), "loops": ()}, "of loops"), ({"eyes": ("fitted",), "views": 3}, "2"),
    ):  # fmt: skip
        with pytest.raises(InvalidRequestError, match=words):
            Study(**{**given, **wrong})
