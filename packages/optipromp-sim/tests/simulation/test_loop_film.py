"""Films and files of picks in closed loop."""

import io
import json
from dataclasses import fields, replace

import numpy as np
import pytest
from tests.simulation.loops import SWAY, swaying

from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import npz, read_npz
from optipromp_sim.simulation import SimulationParameters
from optipromp_sim.simulation.files import (
    POINTS,
    ellipsoids,
    read_loop,
    read_parameters,
    record_of,
    write_loop,
    write_run,
)
from optipromp_sim.simulation.film import (
    INSET,
    LINGER,
    PLANS,
    View,
    _corner,
    animation,
    film,
    frames,
    loop_frames,
    shot,
)
from optipromp_sim.simulation.studio import dressed
from optipromp_sim.simulation.world import build

SMALL = View(width=240, height=160)


@pytest.fixture(scope="module")
def loop():
    return swaying()


@pytest.fixture(scope="module")
def record(loop):
    return record_of(loop)


def test_a_record_is_what_the_trace_tells(loop, record):
    trace = loop.trace
    assert len(record.times) == len(trace.times) == len(record.stages)
    assert record.plans[0] == 0
    assert record.plans[-1] == len(loop.controller.plans) > 0
    assert (np.diff(record.plans) >= 0).all()
    for row in (0, len(trace.times) // 2, -1):
        tracked = trace.tracks[row]
        places, covariance, confirmed = record.tracks(row)
        at = np.argsort([record.ids.index(name) for name in tracked.ids])
        np.testing.assert_array_equal(places, tracked.positions[at])
        np.testing.assert_array_equal(covariance, tracked.covariance[at])
        np.testing.assert_array_equal(confirmed, tracked.confirmed[at])
    assert record.why(loop.controller.events[0].time) == loop.controller.events[0].why
    assert record.why(0.0) == ""


def test_the_path_ahead_begins_at_the_tool_and_ends_where_the_running_curve_does(loop, record):
    rollout, trace = loop.run.rollout, loop.trace
    going = [k for k, stage in enumerate(record.stages) if stage == "push"][5::20]
    shown = [row for row in going if len(record.path(row))]
    assert len(shown) > 2
    for row in shown:
        time, path = record.times[row], record.path(row)
        assert path.shape == (POINTS, 3)
        tool = rollout.tool_point[np.searchsorted(rollout.times, time + 1e-9) - 1]
        assert np.linalg.norm(path[0] - tool) < 0.005  # [m] the arm lags behind its reference
        runs = [each for each in trace.stretches if each.begins <= time + 1e-9][-1]
        end = loop.run.robot.tool_pose(runs.curve.positions[-1])[0]
        np.testing.assert_allclose(path[-1], end, atol=1e-9)
    assert len(record.path(0)) == 0  # nothing runs before the first look


def test_a_record_is_read_as_it_was_written(loop, record, tmp_path):
    assert write_loop(loop, tmp_path) == "loop.npz"
    found = read_loop(tmp_path / "loop.npz")
    for item in fields(record):
        np.testing.assert_array_equal(getattr(found, item.name), getattr(record, item.name))
    assert found.stages == record.stages
    assert found.belongs(loop.run.rollout.arrays())
    other = {"q": loop.run.rollout.q[:-1] + 1e-3}
    assert not found.belongs(other)
    assert (tmp_path / "loop.npz").stat().st_size < 3e6


@pytest.mark.parametrize("name", ["times", "covariance", "reasons", "ahead", "discs"])
def test_a_damaged_record_is_refused(loop, tmp_path, name):
    path = tmp_path / "loop.npz"
    write_loop(loop, tmp_path)
    whole = read_npz(path)
    less = whole[name][..., :-1] if name == "discs" else whole[name][:-1]
    lacking = {key: value for key, value in whole.items() if key != name}
    if name == "discs":  # records of an earlier version have no looks
        path.write_bytes(npz({key: lacking[key] for key in lacking if key != "looked"}))
        assert read_loop(path).sight(1e3) is None
        lacking = {**whole, "looked": whole["looked"][:, 0]}
    for arrays in (lacking, {**whole, name: less}):
        path.write_bytes(npz(arrays))
        with pytest.raises(InvalidRequestError, match="not a record of a closed loop"):
            read_loop(path)


def test_the_outcome_rebuilds_the_world_that_swayed(loop, tmp_path):
    write_run(loop.run, tmp_path)
    document = json.loads((tmp_path / "outcome.json").read_text())
    given = read_parameters(document)
    assert given == loop.run.parameters
    assert given.disturbance.sway == SWAY
    run = loop.run
    world = build(run.scene, run.robot, given, run.seed)
    assert world.model.nq == run.rollout.states.shape[1]
    assert build(run.scene, run.robot, seed=run.seed).model.nq != world.model.nq
    assert read_parameters({}) == SimulationParameters()
    for wrong in (
        [1.0],
        {"colour": {}},
        {"fruit": [1.0]},
        {"fruit": {"colour": 1.0}},
        {"disturbance": {"sway": "wide"}},
        {"disturbance": {"sway_of": 1.0}},
    ):
        with pytest.raises(InvalidRequestError, match="this version"):
            read_parameters({"parameters": wrong})
    with pytest.raises(InvalidRequestError, match="sway_of is 'sky'"):
        read_parameters({"parameters": {"disturbance": {"sway_of": "sky"}}})


def test_ellipsoids_span_the_covariance():
    rng = np.random.default_rng(3)
    root = rng.standard_normal((5, 3, 3)) * 0.01
    spread = root @ root.transpose(0, 2, 1)
    half, turns = ellipsoids(spread)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0)
    again = turns @ (half[:, :, None] ** 2 * turns.transpose(0, 2, 1))
    np.testing.assert_allclose(again, spread, atol=2e-8)


def test_pictures_show_tracks_path_and_the_cameras_view(loop, record):
    moving = next(k for k, stage in enumerate(record.stages) if stage == "push") + 10
    times = np.array([0.0, record.times[moving]])
    told = list(loop_frames(loop, times, SMALL))
    bare = list(frames(loop.run, times, SMALL, caption=True))
    assert all(picture.shape == (160, 240, 3) for picture in told)
    run = loop.run
    model = dressed(build(run.scene, run.robot, run.parameters, run.seed))
    camera = shot(build(run.scene, run.robot, run.parameters, run.seed), model, run, times, SMALL)
    top, left = _corner(loop, camera, times, SMALL, model)
    side = round(INSET * SMALL.height)
    inset = told[1][top : top + side, left : left + side].astype(int)
    yellow = (inset[..., 0] > 150) & (inset[..., 1] > 150) & (inset[..., 2] < 150)
    assert yellow.sum() > 10  # circles around the neighbours
    outside = np.ones((160, 240), dtype=bool)
    outside[top : top + side, left : left + side] = False
    outside[-13:] = False
    changed = (np.abs(told[1].astype(int) - bare[1]).max(axis=2) > 30) & outside
    assert changed.sum() > 30  # path and tracks
    colour = np.array(PLANS[record.plans[moving] % len(PLANS)][:3])
    away = told[1] / 255.0 - told[1].mean(axis=2, keepdims=True) / 255.0
    alike = away @ (colour - colour.mean()) > 0.1
    assert (alike & changed).sum() > 5  # the path ahead in the colour of its plan


def test_a_film_and_an_animation_can_be_played(loop):
    import av
    from PIL import Image

    end = loop.run.rollout.times[-1]
    with av.open(io.BytesIO(film(loop, SMALL, fps=2))) as container:
        assert "vp9" in container.streams.video[0].codec_context.name
        shown = sum(1 for _ in container.decode(container.streams.video[0]))
    assert shown == pytest.approx(2 * (end + LINGER), abs=2)
    with Image.open(io.BytesIO(animation(loop, SMALL, fps=1))) as image:
        assert image.format == "GIF"
        assert image.n_frames == int(end) + 1


def test_a_pick_without_looks_is_drawn(loop):
    blind = replace(loop, trace=replace(loop.trace, looks=()))
    (picture,) = loop_frames(blind, np.array([1.0]), SMALL)
    assert picture.shape == (160, 240, 3)
