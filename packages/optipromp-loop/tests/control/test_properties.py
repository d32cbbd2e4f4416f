"""What holds for any looks: covariances are covariances, and the same looks give the same bits."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.control.plants import camera, detection, empty

from optipromp_loop.control import Look, Tracker, TrackerParameters

steps = st.floats(-0.15, 2.0)
place = st.tuples(*[st.floats(-0.12, 0.12)] * 3)
found = st.tuples(
    place, st.sampled_from(["target", "pushable", "avoid"]), st.floats(0.0, 0.03), st.booleans()
)
story = st.lists(st.tuples(steps, st.lists(found, max_size=6)), min_size=1, max_size=12)
shares = st.floats(0.0, 1.0)


def told(story: list, given: TrackerParameters) -> Tracker:
    """A tracker that was given the looks; each sees every third track pushed."""
    tracker, pose, now = Tracker(empty(), given), camera(), 0.0
    for step, items in story:
        now += step
        look = Look(
            now,
            pose,
            tuple(
                detection(f"d{k}", np.array([0.5, 0.0, 0.5]) + at, pose, role, sigma=sigma)
                for k, (at, role, sigma, _) in enumerate(items)
            ),
        )
        ids = tracker.at(now).ids[::3]
        push = np.array([0.01, 0.0, 0.0])
        tracker.add(look, {name: push for name in ids if items and items[0][3]})
    return tracker


@settings(max_examples=60, deadline=None)
@given(story, shares, st.floats(0.0, 0.02))
def test_covariances_are_symmetric_and_positive(story: list, steady: float, sway: float) -> None:
    tracker = told(story, TrackerParameters(steady=steady, sway=sway))
    for ahead in (0.0, 0.06, 3.0):
        tracked = tracker.at(tracker.time + ahead)
        spread = np.concatenate([tracked.covariance, tracked.rest_covariance])
        assert (spread == spread.transpose(0, 2, 1)).all()
        assert (np.linalg.eigvalsh(spread) > 0.0).all()
        assert np.isfinite(tracked.positions).all()
        assert len(set(tracked.ids)) == len(tracked.ids)
        assert tracked.roles.count("target") <= 1
        assert ((tracked.existence > 0.0) & (tracked.existence < 1.0)).all()
        objects = tracked.objects()
        assert len(objects) == tracked.confirmed.sum()
        assert all(np.isfinite(item.stem.points).all() for item in objects)
