"""Demonstrations from a bag: the cuts, the joints, the times, the refusals."""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tests.cli.fixtures import invoke, told
from tests.ros.camera_messages import states

from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.promp import ProMP
from optipromp_ros import CutParameters, Recorded, load_recording, message, write_bag

JOINTS = tuple(f"joint{k}" for k in range(1, 8))
STILL, MOVE = 1.0, 2.0  # [s] a phase of either
NANO = 10**9


def guided(
    count: int = 5, noise: float = 5e-4, rate: float = 100.0, seed: int = 3
) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) [s] and positions (m, 7): still, then motions with a still phase after each."""
    random = np.random.default_rng(seed)
    ends = random.uniform(-1.0, 1.0, (count + 1, 7))
    times = np.arange(0.0, STILL + count * (MOVE + STILL), 1.0 / rate)
    times[1:-1] += random.uniform(-0.2, 0.2, len(times) - 2) / rate
    q = np.tile(ends[0], (len(times), 1))
    for k, (start, end) in enumerate(itertools.pairwise(ends)):
        s = np.clip((times - STILL - k * (MOVE + STILL)) / MOVE, 0.0, 1.0)
        q += np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, end - start)
    return times, q + noise * random.standard_normal(q.shape)


def joint_states(
    times: np.ndarray,
    positions: np.ndarray,
    *,
    topic: str = "/joint_states",
    names: Sequence[str] = JOINTS,
    stamped: bool = True,
) -> list[Recorded]:
    """Messages whose names stand in another order each time, with a finger among them."""
    random = np.random.default_rng(0)
    names, out = [*names, "finger"], []
    for time, q in zip(times, positions, strict=True):
        order = random.permutation(len(names))
        stamp = 1_700_000_000 * NANO + round(time * NANO)
        named = [names[k] for k in order]
        item = states(named, np.append(q, 0.04)[order], stamp * stamped)
        out.append(Recorded(topic, item, stamp + (0 if not stamped else 3_000_000)))
    return out


def bag(tmp_path: Path, items: list[Recorded], name: str = "demos.mcap") -> Path:
    write_bag(tmp_path / name, items)
    return tmp_path / name


@pytest.mark.parametrize("name", ["demos.mcap", "demos"])
@pytest.mark.parametrize("stamped", [True, False])
def test_five_demonstrations_are_found_where_they_are(tmp_path, name, stamped):
    times, q = guided()
    path = bag(tmp_path, joint_states(times, q, stamped=stamped), name)
    found = load_recording(path, JOINTS)
    assert len(found.demonstrations) == 5
    assert found.demonstrations.joint_names == JOINTS
    assert (found.topic, found.messages) == ("/joint_states", len(times))
    for k, (cut, item) in enumerate(zip(found.cuts, found.demonstrations, strict=True)):
        begin = STILL + k * (MOVE + STILL)
        # the first 0.2 s of a minimum-jerk motion of 2 s are slower than the threshold
        assert abs(cut.start - begin) < 0.3
        assert abs(cut.end - begin - MOVE) < 0.3
        assert cut.whole
        assert item.times[0] == 0.0
        np.testing.assert_allclose(np.diff(item.times), np.diff(item.times)[0], rtol=1e-6)
        for end, row in ((begin, 0), (begin + MOVE, -1)):
            # at rest: within 2 % of the motion, and the noise
            there = q[np.argmin(np.abs(times - end))]
            assert np.abs(item.positions[row] - there).max() < 0.02 * cut.motion + 3e-3
        middle = item.positions[len(item.times) // 2]
        there = q[np.argmin(np.abs(times - 0.5 * (cut.start + cut.end)))]
        assert np.abs(middle - there).max() < 0.03


def test_positions_are_those_of_their_names(tmp_path: Path) -> None:
    """Without noise every sample is on the line between the two messages around it."""
    times, q = guided(noise=0.0)
    path = bag(tmp_path, joint_states(times, q, names=[f"fr3_{joint}" for joint in JOINTS]))
    found = load_recording(path, JOINTS)
    for cut, item in zip(found.cuts, found.demonstrations, strict=True):
        at = cut.start + item.times
        wanted = np.stack([np.interp(at, times, column) for column in q.T], axis=1)
        np.testing.assert_allclose(item.positions, wanted, atol=1e-7)


def test_without_joints_all_of_the_message_are_learnt(tmp_path: Path) -> None:
    found = load_recording(bag(tmp_path, joint_states(*guided(2))))
    assert set(found.demonstrations.joint_names) == {*JOINTS, "finger"}


def test_messages_of_a_gripper_are_left_out(tmp_path: Path) -> None:
    arm = joint_states(*guided(2))
    grip = states(["finger"], [0.0])
    items = [x for s in arm for x in (s, Recorded("/joint_states", grip, s.stamp + 1))]
    path = bag(tmp_path, items)
    with pytest.warns(UserWarning, match=f"{len(arm)} of {len(items)} messages are left out"):
        found = load_recording(path, JOINTS)
    assert len(found.demonstrations) == 2


def test_a_gap_cuts_and_the_parts_are_said_to_be_parts(tmp_path: Path) -> None:
    times, q = guided(2, noise=0.0)
    kept = (times < STILL + 0.4 * MOVE) | (times > STILL + 0.8 * MOVE)
    found = load_recording(bag(tmp_path, joint_states(times[kept], q[kept])), JOINTS)
    assert [cut.whole for cut in found.cuts] == [False, False, True]
    assert found.cuts[0].end < found.cuts[1].start


def test_a_small_motion_is_no_demonstration(tmp_path: Path) -> None:
    times, q = guided(2, noise=0.0)
    q[times > STILL + MOVE + 0.5 * STILL] = q[times <= STILL + MOVE + 0.5 * STILL][-1]
    nudge = np.clip((times - 5.0) / 0.5, 0.0, 1.0)
    q[:, 0] += 0.03 * nudge
    path = bag(tmp_path, joint_states(times, q))
    found = load_recording(path, JOINTS)
    assert [cut.demonstration for cut in found.cuts] == [True, False]
    assert len(found.demonstrations) == 1
    every = load_recording(path, JOINTS, parameters=CutParameters(motion=0.01))
    assert len(every.demonstrations) == 2


@pytest.mark.parametrize("name", ["back.mcap", "back"])
@pytest.mark.parametrize("logged", [True, False], ids=["both clocks", "the header's clock"])
def test_a_clock_that_is_set_back_cuts_and_both_parts_stay(tmp_path, name, logged):
    """Sorted by time, the parts were mixed to motions of 3 rad/s that never were."""
    times, q = guided(3, noise=0.0)
    middle = STILL + 1.5 * MOVE + STILL  # of the second motion
    items = joint_states(times, q)
    for k, item in enumerate(items):
        if times[k] > middle:
            item.message.header.stamp.sec -= 3
            items[k] = item._replace(stamp=item.stamp - 3 * 10**9) if logged else item
    with pytest.warns(UserWarning, match=r"the time runs back by 2\.9.* at row \d+: cut there"):
        found = load_recording(bag(tmp_path, items, name), JOINTS)
    assert [cut.whole for cut in found.cuts] == [True, False, False, True]
    true = np.abs(np.diff(q, axis=0) / np.diff(times)[:, None]).max()
    for item in found.demonstrations:
        speeds = np.diff(item.positions, axis=0) / np.diff(item.times)[:, None]
        assert np.abs(speeds).max() < 1.05 * true


@pytest.mark.parametrize("topics", [("/joint_states",) * 2, ("/arm/joint_states", "/wrist")])
def test_the_joints_of_an_arm_may_be_in_two_messages(tmp_path: Path, topics) -> None:
    """Also of two topics, where none of them is on both."""
    times, q = guided(2, noise=0.0)
    items = []
    for topic, part, late in zip(topics, (slice(4), slice(4, 7)), (0.0, 0.003), strict=True):
        names = [f"left_{joint}" for joint in JOINTS[part]]
        items += joint_states(times + late, q[:, part], topic=topic, names=names)
    found = load_recording(bag(tmp_path, items), JOINTS)
    whole_arm = load_recording(bag(tmp_path, joint_states(times, q), "whole.mcap"), JOINTS)
    assert (found.demonstrations.joint_names, found.messages) == (JOINTS, 2 * len(times))
    for a, b in zip(found.demonstrations, whole_arm.demonstrations, strict=True):
        assert abs(a.times[-1] - b.times[-1]) < 0.03
        np.testing.assert_allclose(a.positions[[0, -1]], b.positions[[0, -1]], atol=0.02)


def test_what_holds_no_demonstration_is_refused(tmp_path: Path) -> None:
    times, q = guided(1)
    still = bag(tmp_path, joint_states(times[:80], q[:80]), "still.mcap")
    with pytest.raises(InvalidDemonstrationError, match=r"no demonstration in 80 joint states"):
        load_recording(still, JOINTS)
    other = bag(tmp_path, [Recorded("/x", message("std_msgs/msg/String"))], "other.mcap")
    with pytest.raises(InvalidDemonstrationError, match="has no messages of type sensor_msgs"):
        load_recording(other, JOINTS)
    with pytest.raises(InvalidRequestError, match="joint shoulder is missing; it names"):
        load_recording(still, ["shoulder"])


def test_of_two_topics_one_must_be_named(tmp_path: Path) -> None:
    items = [x for t in ("/left", "/right") for x in joint_states(*guided(1), topic=t)]
    path = bag(tmp_path, items)
    with pytest.raises(InvalidRequestError, match="joint states on /left, /right"):
        load_recording(path, JOINTS)
    assert load_recording(path, JOINTS, topic="/left").topic == "/left"
    with pytest.raises(InvalidRequestError, match="has no topic '/top': it has /left, /right"):
        load_recording(path, JOINTS, topic="/top")


def test_of_two_arms_one_is_named_by_its_prefix(tmp_path: Path) -> None:
    """Each arm's messages were read as the same arm's, one after another."""
    times, q = guided(2, noise=0.0)
    left, right = (
        joint_states(times, way, names=[side + name for name in JOINTS])
        for side, way in (("left_", q), ("right_", q[::-1]))
    )
    path = bag(tmp_path, [item for pair in zip(left, right, strict=True) for item in pair])
    with pytest.raises(InvalidRequestError, match="each of the prefixes left_, right_: must be"):
        load_recording(path, JOINTS)
    with pytest.warns(UserWarning, match=f"{len(times)} of {2 * len(times)} messages are left out"):
        found = load_recording(path, JOINTS, prefix="right_")
    first = found.demonstrations[0].positions[0]
    assert np.abs(first - q[-1]).max() < 0.01


MIDDLE = np.array([0.0, 0.0, 0.0, -1.5, 0.0, 1.5, 0.0])  # [rad] from which ±1 is within the limits


def panda(count: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Times and positions of a Panda that is guided by hand."""
    times, q = guided(count)
    return times, q + MIDDLE


@pytest.fixture(scope="module")
def guided_panda(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("bags") / "guided"
    write_bag(path, joint_states(*panda()))
    return path


def test_learn_takes_a_bag_and_says_where_it_was_cut(guided_panda: Path, tmp_path: Path) -> None:
    out = tmp_path / "reach.npz"
    learn = ["learn", str(guided_panda), "--out", str(out), "--robot", "panda", "--bases", "7"]
    document = told(*learn)
    assert document["demonstrations"] == 5
    assert document["recording"]["topic"] == "/joint_states"
    assert [cut["demonstration"] for cut in document["recording"]["cuts"]] == [True] * 5
    promp = ProMP.load(out)
    assert promp.joint_names == JOINTS
    words = invoke(*learn, "--no-figure")
    assert "5 demonstrations in 1600 messages of /joint_states" in words.stdout
    first = document["recording"]["cuts"][0]
    assert f"{first['start']:.2f} to {first['end']:.2f} s" in words.stdout


def test_check_knows_a_bag(guided_panda: Path, tmp_path: Path) -> None:
    single = bag(tmp_path, joint_states(*panda(2)))
    for path, count in ((guided_panda, 5), (single, 2)):
        document = told("check", path)
        assert (document["kind"], document["demonstrations"]) == ("demonstrations", count)
        highest = dict(zip(document["joints"], document["highest"], strict=True))
        assert np.abs(np.array([highest[joint] for joint in JOINTS]) - MIDDLE).max() < 1.1
