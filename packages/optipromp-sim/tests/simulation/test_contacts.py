"""What is counted of contacts, against sums written out."""

from types import SimpleNamespace

import numpy as np
import pytest

from optipromp_sim.simulation.contacts import ContactLog, contact_forces

OWNERS = np.array([2, 0, 1, 1])


def test_forces_of_a_pair_add_up_whichever_comes_first():
    rng = np.random.default_rng(0)
    frames = np.linalg.qr(rng.normal(size=(5, 3, 3)))[0]
    geoms = np.array([[0, 1], [1, 0], [2, 1], [3, 3], [0, 2]])
    addresses = np.array([0, 3, 6, -1, 9])
    forces = rng.normal(size=12)
    pairs, strengths = contact_forces(geoms, addresses, frames.reshape(5, 9), forces, OWNERS)
    in_world = [frames[c].T @ forces[addresses[c] :][:3] for c in (0, 1, 2, 4)]
    assert pairs.tolist() == [[0, 2], [0, 1], [1, 2]]
    expected = [in_world[0] - in_world[1], in_world[2], in_world[3]]
    np.testing.assert_allclose(strengths, np.linalg.norm(expected, axis=1))


def test_nobodys_contacts_are_not_counted():
    geoms, addresses = np.array([[0, 1], [1, 2], [0, 3]]), np.array([0, 3, 6])
    frames = np.tile(np.eye(3).reshape(9), (3, 1))
    pairs, strengths = contact_forces(geoms, addresses, frames, np.ones(9), np.array([0, -1, 2, 1]))
    assert pairs.tolist() == [[0, 1]]
    np.testing.assert_allclose(strengths, np.sqrt(3.0))


def test_spells_peaks_and_what_is_recent():
    world = SimpleNamespace(
        entities=range(3), geom_entity=OWNERS,
        model=SimpleNamespace(opt=SimpleNamespace(timestep=0.5)),
    )  # fmt: skip
    log = ContactLog(world, threshold=2.0)
    for k, force in enumerate([0.0, 3.0, 4.0, 1.0, 5.0, None, 3.0]):
        count = 0 if force is None else 1
        contact = SimpleNamespace(
            geom=np.array([[0, 1]])[:count], efc_address=np.zeros(count, np.int64),
            frame=np.eye(3).reshape(1, 9)[:count],
        )  # fmt: skip
        log.add(
            SimpleNamespace(
                ncon=count, contact=contact, efc_force=np.array([force or 0.0, 0.0, 0.0]),
                time=0.5 * k,
            )
        )  # fmt: skip
        if k == 4:
            assert log.take_recent()[0, 2] == 5.0
    for values, expected in (
        (log.peak, 5.0), (log.time, 2.5), (log.hard, 1.0), (log.first, 0.5),
        (log.take_recent(), 3.0),
    ):  # fmt: skip
        assert values[0, 2] == values[2, 0] == pytest.approx(expected)
    assert np.isnan(log.first[0, 1])
    assert log.take_recent().max() == 0.0
