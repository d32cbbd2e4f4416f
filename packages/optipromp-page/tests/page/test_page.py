"""The page in a real browser: what it shows, what its files say, and that windows are apart."""

import functools
import gc
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.page.opened import SMALL, TALL, Opened, idle

from optipromp.core.output import load_pick, load_plan, write_plan
from optipromp.core.planning import Picked, plan
from optipromp.core.promp import load_demonstrations
from optipromp.core.scenes.io import load_scene
from optipromp.looks.viewer.words import head
from optipromp_page import content
from optipromp_page.stage import Source, look, open_source
from optipromp_page.window import Window


@pytest.fixture(scope="module")
def shared(opener) -> Opened:
    """One window on scenario 3."""
    return opener(Source(load_scene("scenario-3"), reach=True))


@pytest.fixture
def opened(shared: Opened) -> Iterator[Opened]:
    """The shared window; what a test that failed left of it does not reach the next one."""
    yield shared
    if shared.window.scene.name != "scenario-3" or shared.window.asked.planner == "i-promp":
        shared.window.asked = replace(shared.window.asked, planner="opti-promp")
        shared.window.worker.post("restore", lambda: shared.window.open(load_scene("scenario-3")))
    shared.window.worker.post("last", shared.window.reset)
    idle(shared.window.worker)


def node(opened: Opened, name: str):
    return opened.window.client.scene.get_handle_by_name(f"/a/{name}")


def on_screen(opened: Opened, point) -> tuple[float, float]:
    """Where a point (3,) of the world is in the tab [pixel]."""
    import viser.transforms as turns

    camera, size = opened.window.client.camera, opened.tab.viewport_size
    x, y, z = turns.SO3(np.array(camera.wxyz)).as_matrix().T @ (point - camera.position)
    scale = 0.5 * size["height"] / np.tan(0.5 * camera.fov)
    return 0.5 * size["width"] + scale * x / z, 0.5 * size["height"] + scale * y / z


def test_page_shows_the_plan_that_the_library_makes(opened: Opened) -> None:
    assert is_the_librarys(opened.window)
    made = opened.window.shown.plan
    opened.told("This plan works")
    opened.told("Planned in")
    opened.listed("clearance, arm to avoid", f"{1e3 * made.metrics.clearance_avoid:.1f} mm")
    opened.listed("duration", f"{made.metrics.duration:.2f} s with")
    for name in ("initial bundle/tube", "candidate paths/all", "trajectories/optimised",
                 "passing sides/all"):  # fmt: skip
        assert node(opened, name).visible, name
    assert [chart.title.split(" [")[0] for chart, _ in opened.panel.plots.charts] == [
        "joints", "joint speeds", "tool speed", "clearances", "costs, joint",
    ]  # fmt: skip
    assert opened.errors == []


def is_the_librarys(window: Window) -> bool:
    """Whether the plan that is shown is that which the library makes of the scene."""
    made = plan(window.scene)
    return np.array_equal(window.shown.plan.trajectory.positions, made.trajectory.positions)


def by_hand(opened: Opened, point, path, done) -> None:
    """Press the mouse at a point (3,), move it by ``path`` (3,) [m], let go; until ``done``. A
    browser on a machine that does other work misses quick movements: each try is slower."""
    opened.do(lambda: look(opened.window.client.camera, opened.window.original))
    for k in range(6):
        pause = 150.0 * 2**k
        opened.tab.wait_for_timeout(pause)
        for note in opened.tab.locator(".mantine-Notification-closeButton").all():
            note.dispatch_event("click")  # that WebGL has no graphics card covers the scene
        x, y = on_screen(opened, point)
        opened.tab.mouse.move(x, y)
        opened.tab.wait_for_timeout(pause)
        opened.tab.mouse.down()
        for step in range(5 if np.any(path) else 0):
            opened.tab.mouse.move(*on_screen(opened, point + path * (step + 1) / 5))
            opened.tab.wait_for_timeout(0.5 * pause)
        opened.tab.mouse.up()
        opened.tab.wait_for_timeout(2.0 * pause)
        opened.settle()
        if done():
            return
    pytest.fail("the mouse does nothing")


def test_a_fruit_is_clicked_and_dragged_with_the_mouse(opened: Opened) -> None:
    window = opened.window
    opened.tab.set_viewport_size(TALL)  # the panel is below the picture
    by_hand(opened, window.scene.target.position, np.zeros(3), lambda: window.selected is not None)
    assert window.selected.ids == ("ripe",)
    opened.do(lambda: window.select("n1"))
    was = window.scene.pushables[0].position
    arrow = was + [0.0, 0.05, 0.0]  # on the handle's level arrow: a stem covers the upright one
    aside = np.array([0.0, 0.02, 0.0])
    by_hand(opened, arrow, aside, lambda: window.scene.pushables[0].position[1] > was[1] + 0.005)
    now = window.scene.pushables[0].position
    assert np.allclose(now[[0, 2]], was[[0, 2]], atol=1e-6)
    opened.told("after the drag")
    assert window.shown.around is not None
    assert is_the_librarys(window)
    opened.tab.set_viewport_size(SMALL)
    opened.do(window.reset)


def test_while_dragging_the_plan_follows(opened: Opened) -> None:
    window = opened.window
    to = window.scene.pushables[0].position + [0.0, 0.01, 0.0]
    opened.drag("n1", to, "update")
    live = window.shown.plan
    assert np.allclose(live.scene.pushables[0].position, to)
    assert window.shown.around is None  # what surrounds a plan waits for the release
    opened.do(window.reset)


def test_an_impossible_arrangement_says_why(opened: Opened) -> None:
    window = opened.window
    fruit = window.scene.pushables[0]
    opened.drag("n1: stem root", fruit.position)
    opened.told("The scene cannot be used")
    opened.told("Stem piece 0 has no length")
    assert np.allclose(node(opened, "message/text").position, fruit.stem.root)
    opened.do(window.reset)
    assert node(opened, "message/text") is None


def test_a_plan_that_fails_is_red_at_what_it_touches(opened: Opened) -> None:
    window = opened.window
    opened.do(lambda: window.open(load_scene("scenario-1")))
    table = window.scene.objects[[o.id for o in window.scene.objects].index("table-top")]
    assert np.allclose(node(opened, "message/text").position, table.position)
    opened.listed("target", "10.9 mm off", red=True)
    inside = 1e3 * window.shown.plan.metrics.clearance_static
    assert inside < 0.0
    opened.listed("clearance, static", f"{inside:.1f} mm", red=True)
    opened.listed("joint limits", "kept", red=False)
    opened.do(lambda: window.open(load_scene("scenario-3")))


def test_controls_change_the_plan(opened: Opened) -> None:
    window, panel = opened.window, opened.panel
    opened.do(lambda: window.ask(scene=content.with_radius(window.scene, 0.04)))
    assert window.shown.plan.robot.tool.radius == 0.04
    assert panel.planning.radius.value == 40.0
    opened.do(lambda: window.ask(scene=content.with_sigma(window.scene, 0.005)))
    assert np.allclose(window.shown.plan.scene.target.covariance, 25e-6 * np.eye(3))
    opened.do(lambda: window.ask(planner="i-promp"))
    assert window.shown.plan.planner == "i-promp"
    opened.told(head(window.shown.plan.status))
    opened.do(lambda: panel.safely(lambda v: panel.planning.option(max_step=v), -1.0))
    opened.told("max_step")
    opened.do(lambda: window.ask(planner="opti-promp"))
    opened.do(window.reset)
    opened.press("plan again")
    assert window.shown.plan.success


def test_play_runs_to_the_end_and_a_step_is_a_step(opened: Opened) -> None:
    window = opened.window
    opened.do(lambda: window.go(window.duration - 0.6))
    before = window.now
    opened.press("play")
    opened.until(lambda: window.now > before, "the clock stands")
    opened.until(lambda: not window.worker.running, "the clock does not end")
    assert window.now == pytest.approx(window.duration)
    q = window.shown.plan.trajectory.positions[-1]
    at = node(opened, f"arm/{len(q) - 1}").position
    assert np.allclose(at, window.shown.plan.robot.segment_frames(q)[0][-1], atol=1e-6)
    opened.press("◀ step")
    assert window.now == pytest.approx(window.duration - 0.02)
    needle = opened.panel.plots.charts[0][1].data
    at = needle[0][np.argmax(needle[-1])]
    assert at == pytest.approx(window.now)


def test_saved_files_hold_what_the_page_shows(opened: Opened) -> None:
    window, out = opened.window, opened.page.out
    to = window.scene.pushables[1].position + [0.0, -0.01, 0.004]
    opened.drag("n2", to)
    opened.show("Move")
    opened.press("save scene")
    opened.press("save plan")
    scene, kept = load_scene(out / "scenario-3.yaml"), load_plan(out / "scenario-3")
    assert np.allclose(scene.pushables[1].position, to)
    assert np.array_equal(kept.trajectory.positions, window.shown.plan.trajectory.positions)
    assert np.array_equal(plan(scene).trajectory.positions, kept.trajectory.positions)
    opened.do(window.reset)


def test_demonstrations_are_recorded_saved_and_learnt(opened: Opened) -> None:
    window, out = opened.window, opened.page.out
    opened.show("Record")
    further = {"accept", "discard", "save demonstrations", "learn and show the band",
               "forget what was learnt"}  # fmt: skip

    def enabled() -> set[str]:
        return {one.label for one in opened.panel.buttons if not one.disabled} & further

    assert enabled() == set()  # nothing is recorded
    opened.press("start recording")
    assert enabled() == {"discard"}
    for shift in (0.0, 0.01, 0.02):
        opened.press("start recording")
        begin = np.array(window.handle.gizmo.position)
        for k in range(12):
            at = begin + [0.0, shift * k / 11, 0.10 * k / 11]
            window.handle.drag(at, "update", 1.0 + 0.1 * k)
            opened.settle()
        recorder = opened.panel.recording.recorder
        assert np.allclose(recorder.robot.tool_pose(recorder.q)[0], at)
        assert {"accept", "discard"} <= enabled()
        opened.press("accept")
    assert enabled() == {"save demonstrations", "learn and show the band"}
    opened.press("start recording")
    opened.press("discard")
    opened.press("save demonstrations")
    saved = load_demonstrations(out / "scenario-3-demonstrations.npz")
    assert len(saved) == 3
    assert saved.joint_names == window.shown.plan.robot.joint_names
    assert np.allclose(saved[0].positions[0], load_scene("scenario-3").start)
    assert np.allclose(np.diff(saved[0].times)[1:], 0.1)
    opened.press("learn and show the band")
    assert window.asked.demonstrations is not None
    assert node(opened, "learnt band/tube").visible
    opened.press("forget what was learnt")
    assert "forget what was learnt" not in enabled()
    assert node(opened, "learnt band/tube") is None


def test_an_executed_plan_is_replayed_with_its_forces(opened: Opened) -> None:
    window = opened.window
    opened.show("Replay")
    opened.press("execute this plan")
    replay = window.runs.known[-1]
    assert replay.success
    opened.told(replay.message)
    layers = opened.panel.layers  # a replay has none of a plan's
    assert {name for name, box in layers.items() if not box.disabled} == {"body spheres"}
    felt = replay.arrays["contacts"]
    row = int(felt[np.linalg.norm(felt[:, 6:], axis=1).argmax(), 0])
    opened.do(lambda: window.go(float(replay.arrays["times"][row])))
    strongest = replay.arrays["fruit_force"][row].max()
    assert "fruit:" in window.runs.forces
    assert f"{strongest:.2f} N" in window.runs.forces or strongest > 0.0
    assert node(opened, "forces/all") is not None
    opened.do(lambda: window.replay([replay, replace(replay, name="again")]))
    assert window.client.scene.get_handle_by_name("/b/arm/0") is not None
    opened.do(lambda: window.replay(()))
    assert not any(box.disabled for box in layers.values())
    assert window.client.scene.get_handle_by_name("/b/arm/0") is None
    assert node(opened, "forces/all") is None


def test_two_windows_do_not_disturb_one_another(opened: Opened, opener) -> None:
    other = opener(page=opened.page)
    mine, theirs = opened.window, other.window
    before, said = mine.scene, opened.panel.status.content
    other.drag("n1", np.array([0.45, 0.03, 0.76]))
    other.do(lambda: theirs.go(1.0))
    other.told("after the drag")
    assert mine.scene is before
    assert opened.panel.status.content == said
    assert node(opened, "handle") is None
    other.tab.close()
    opened.until(lambda: theirs not in opened.page.windows.values(), "the window stays")
    opened.until(lambda: not theirs.worker._thread.is_alive(), "its thread stays")


def test_what_is_shown_no_more_is_forgotten(opened: Opened) -> None:
    scene, old = opened.window.client.scene, weakref.ref(opened.window.shown)
    nodes = set(scene._handle_from_node_name)
    opened.do(opened.window.replan)
    gc.collect()
    assert old() is None
    assert set(scene._handle_from_node_name) == nodes


def test_a_plan_folder_and_two_rollouts_open(tmp_path: Path) -> None:
    from optipromp_sim.simulation import simulate
    from optipromp_sim.simulation.files import write_run

    made = plan(load_scene("scenario-4"), planner="i-promp")
    write_plan(made, tmp_path / "reach")
    found = open_source(str(tmp_path / "reach"))
    assert np.array_equal(found.plan.trajectory.positions, made.trajectory.positions)
    run = simulate(made)
    for name in ("one", "two"):
        write_run(run, tmp_path / name)
    source = open_source(str(tmp_path / "one"), str(tmp_path / "two"))
    assert [replay.message for replay in source.replays] == [run.outcome.message] * 2


def test_a_pick_is_shown_until_the_fruit_is_out_of_the_plant(opener, tmp_path: Path) -> None:
    opened = opener(Source(load_scene("scenario-4")), out=tmp_path)
    window, target = opened.window, load_scene("scenario-4").target
    opened.told("Then leaves the plant with it, in ")
    opened.listed("retreat", "success")
    reach = window.shown.plan.trajectory.duration
    assert window.duration == pytest.approx(reach + window.shown.made.legs["retreat"].duration)
    (fruit,) = (
        mesh for part, mesh in window.stage._meshes.values() if part.name == "target:ripe"
    )  # fmt: skip
    for time_, away in ((window.duration, 0.1), (reach, 0.0), (window.duration, 0.1), (0.0, 0.0)):
        opened.do(functools.partial(window.go, time_))
        assert np.linalg.norm(fruit.position - target.position) == pytest.approx(away, abs=0.03)
    opened.show("Move")
    opened.press("save plan")
    assert isinstance(load_pick(tmp_path / "scenario-4"), Picked)
    opened.tab.close()
