"""Fruits that swing on their stems, driven by the sway of their roots."""

from dataclasses import replace

import numpy as np
import pytest
from tests.control.plants import RADIUS, UP, Eye, empty, look, nearest, swaying

from optipromp.core.arrays import frame_along
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.scenes.objects import SceneObject, Stem
from optipromp_loop.control import Tracker
from optipromp_loop.control.tracks import Frame, Track, TrackerParameters, new_track
from optipromp_sim.generate.generator import generate
from optipromp_sim.simulation import Simulation, SimulationParameters


def hung() -> Track:
    """The track of a fruit on an upright stem of 0.15 m."""
    seen = SceneObject("a", "target", Sphere(RADIUS), np.zeros(3), sigma=0.005)
    tall = Stem.along(np.zeros(3), UP, 0.15)
    frame = Frame(UP, np.eye(3)[:2])
    return new_track("a", replace(seen, stem=tall), None, frame)


def test_the_sway_ahead_is_smooth_and_that_of_the_plant() -> None:
    """Roots sway by 20 mm, and fruits swing on their stems as pendulums do."""
    rng = np.random.default_rng(6)
    plant, tracker = swaying(rng, 8, 0.020, np.array([0.8])), Tracker(empty())
    omega, zeta = hung().swing(tracker.parameters)
    for k in range(120):
        tracker.add(look(0.05 * k, plant.hung_at(0.05 * k, omega, zeta), rng, Eye()))
    tracked = tracker.at(6.0)
    times = 6.0 + 0.001 * np.arange(401)
    later = tracker.at(6.3)
    moves = tracked.moves(times)
    assert tracked.rest + moves[0] == pytest.approx(tracked.positions, abs=1e-12)
    assert later.moves(np.array([6.3]))[0] == pytest.approx(moves[300], abs=1e-9)
    order = nearest(tracked, plant.hung_at(6.0, omega, zeta))[0]
    truth = np.array([plant.hung_at(each, omega, zeta) for each in times])
    off = np.linalg.norm((tracked.rest + moves)[:, order] - truth, axis=2)
    assert np.ptp(truth, axis=0).max() > 0.020
    assert off[:200].max() < 0.008
    with pytest.raises(InvalidRequestError, match="not before"):
        tracked.moves(np.array([5.9]))


def test_a_fruit_swings_as_a_pendulum_on_an_elastic_stem() -> None:
    """A stem that is short, or holds its fruit aside, is stiff against it."""
    track, given = hung(), TrackerParameters()
    omega, zeta = track.swing(given)
    assert omega > np.sqrt(9.81 / 0.15)
    assert given.swing_damping < zeta < 0.9
    short, _ = replace(track, lengths=0.08).swing(given)
    assert short > 1.3 * omega
    aside, loss = replace(track, tilts=np.array([0.3, 0.4])).swing(given)
    assert aside > 1.1 * omega
    assert loss > zeta
    limp = replace(given, stem_damping=0.0)
    assert track.swing(limp) == (omega, given.swing_damping)


def test_fruits_swing_in_the_simulation_as_their_tracks_say() -> None:
    """Two fruits, after their roots were moved at once; periods between rises through the mean."""
    scene, places = generate("cluster", 200), []
    jump = SimulationParameters().changed(disturbance={"jump": 0.01, "jump_at": 0.05})
    run = Simulation(scene, 200, jump)
    while run.time < 3.0:
        run.step(run.reference)
        places.append(run.fruits().positions[:2])
    moved, fruits = np.array(places)[400:], run.fruits()
    frame, objects = Frame(scene.up, frame_along(scene.up).T[:2]), {o.id: o for o in scene.objects}
    for row, name in enumerate(fruits.ids[:2]):
        off = moved[:, row] - moved[-1000:, row].mean(axis=0)
        along = off @ np.linalg.svd(off, full_matrices=False)[2][0]
        rises = np.flatnonzero((along[:-1] < 0.0) & (along[1:] >= 0.0))
        assert len(rises) > 2
        measured = 1.0 / (np.diff(rises).mean() * run.tick)  # [Hz]
        seen = replace(objects[name], covariance=1e-6 * np.eye(3))
        omega, _ = new_track(name, seen, None, frame).swing(TrackerParameters())
        assert omega / (2.0 * np.pi) == pytest.approx(measured, rel=0.15)
