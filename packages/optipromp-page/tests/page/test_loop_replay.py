"""The page's replay of a pick in closed loop, in a real browser."""

from pathlib import Path

import numpy as np
import pytest
from tests.page.opened import PATIENCE
from tests.simulation.loops import swaying

from optipromp_page.stage import load_replay, open_source
from optipromp_sim.simulation import simulate
from optipromp_sim.simulation.files import record_of, write_loop, write_run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("pick")
    write_run(swaying().run, folder)
    write_loop(swaying(), folder)
    return folder


def test_tracks_path_and_stage_are_replayed_where_the_fruits_sway(opener, folder: Path) -> None:
    loop, opened = swaying(), opener(open_source(str(folder)))
    window, record, rollout = opened.window, record_of(loop), loop.run.rollout
    assert window.duration == pytest.approx(float(rollout.times[-1]))

    def node(name: str):
        return window.client.scene.get_handle_by_name(f"/a/{name}")

    def look_at(now: float):
        return max((each for each in loop.trace.looks if each.time <= now), key=lambda e: e.time)

    def shows_target(row: int) -> bool:
        look = look_at(float(record.times[row]))
        return any(item.role == "target" for item in look.detections)

    going = [k for k, s in enumerate(record.stages) if s == "push" and len(record.path(k))]
    going = [k for k in going if shows_target(k)]
    for row in (going[5], going[-5]):
        now = float(record.times[row])
        opened.do(lambda now=now: window.go(now))
        places, covariance, _ = record.tracks(row)
        tracks = node("tracks/all")
        np.testing.assert_allclose(tracks.batched_positions, places, atol=1e-6)
        volume = np.prod(tracks.batched_scales, axis=1)
        np.testing.assert_allclose(volume, 8.0 * np.sqrt(np.linalg.det(covariance)), rtol=0.05)
        assert node("path ahead") is not None
        assert f"push, plan {record.plans[row]}" in window.runs.forces
        assert record.why(now) in window.runs.forces
        look = look_at(now)
        inset = opened.panel.replaying.sight.content
        assert inset.count("<circle") == 1 + len(look.detections)
        target = next(item for item in look.detections if item.role == "target")
        x, y, z = target.position
        assert f'cx="{x / z:.4f}" cy="{y / z:.4f}" r="{target.radius / z:.4f}"' in inset
        index = int(np.abs(rollout.times - now).argmin())
        for k, name in enumerate(rollout.fruit_ids):
            part = next(p for p in (f"target:{name}", f"pushable:{name}") if node(f"things/{p}"))
            np.testing.assert_allclose(
                node(f"things/{part}").position, rollout.fruit_positions[index, k], atol=1e-6
            )
            assert node(f"things/{part}").opacity < 0.6
    opened.show("Replay")
    opened.tab.locator("figure.sight svg").wait_for(timeout=1e3 * PATIENCE)
    opened.do(lambda: window.replay(()))
    assert opened.panel.replaying.sight.content == ""
    assert node("tracks/all") is None
    assert node("path ahead") is None
    assert node(f"things/target:{loop.run.outcome.target}").opacity is None
    assert not opened.errors
    opened.tab.close()


def test_the_record_of_an_earlier_pick_is_not_shown(folder: Path, tmp_path: Path) -> None:
    assert load_replay(folder).record is not None
    still = simulate(swaying().controller.plans[0])
    write_run(still, tmp_path)
    write_loop(swaying(), tmp_path)
    assert load_replay(tmp_path).record is None
