import json
import warnings
from pathlib import Path

import numpy as np
import pytest

from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.promp import (
    Demonstration,
    Demonstrations,
    UnitsWarning,
    fit,
    load_demonstrations,
    save_demonstrations,
)
from optipromp.core.promp.units import Units, units_of
from optipromp.core.robots.turns import Turns

TIMES = np.array([0.0, 1.0, 3.0])
Q = np.array([[0.0, 1.0], [0.5, 0.5], [1.0, 0.0]])


def test_phases() -> None:
    np.testing.assert_allclose(Demonstration(TIMES, Q).phases, [0, 1 / 3, 1])
    partial = Demonstration(TIMES, Q, span=(-1.0, 4.0))
    np.testing.assert_allclose(partial.phases, [0.2, 0.4, 0.8])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((TIMES, np.where(Q == 0.5, np.nan, Q)), r"positions\[1, 0\] is nan"),
        (([0.0, np.inf, 3.0], Q), r"times\[1\] is inf"),
        (([0.0, 1.0, 1.0], Q), r"times\[2\] = 1.0 after 1.0"),
        (([0.0], Q[:1]), "at least 2"),
        ((TIMES, Q[:, :0]), "positions"),
        ((TIMES, Q, (1.0, 4.0)), "enclose"),
        ((TIMES, Q, (0.0, 1.0, 2.0)), "span"),
    ],
)
def test_refuses(arguments: tuple[object, ...], message: str) -> None:
    with pytest.raises(InvalidDemonstrationError, match=message):
        Demonstration(*arguments)  # type: ignore[arg-type]


def test_is_a_sequence() -> None:
    demos = Demonstrations((Demonstration(TIMES, Q),) * 3)
    assert len(demos) == len(list(demos)) == len(demos[:]) == 3
    assert demos[0].n_joints == demos.n_joints == 2
    with pytest.raises(ValueError, match="read-only"):
        demos[0].positions[0] = 1.0
    with pytest.raises(InvalidDemonstrationError, match="no demonstrations"):
        Demonstrations(())
    with pytest.raises(InvalidDemonstrationError, match="demonstration 1 has 1 joints"):
        Demonstrations((demos[0], Demonstration(TIMES, Q[:, :1])))


def test_npz_concatenated(tmp_path: Path) -> None:
    demos = Demonstrations(
        (Demonstration(TIMES, Q), Demonstration(2 * TIMES[:2], Q[:2] + 1)), ("a", "b")
    )
    save_demonstrations(demos, tmp_path / "d.npz")
    loaded = load_demonstrations(tmp_path / "d.npz")
    assert loaded.joint_names == ("a", "b")
    for one, other in zip(demos, loaded, strict=True):
        np.testing.assert_array_equal(one.times, other.times)
        np.testing.assert_array_equal(one.positions, other.positions)
    partial = Demonstrations((Demonstration(TIMES, Q, span=(0.0, 9.0)),))
    with pytest.raises(InvalidDemonstrationError, match="partial"):
        save_demonstrations(partial, tmp_path / "p.npz")
    assert not (tmp_path / "p.npz").exists()


def test_npz_stacked(tmp_path: Path) -> None:
    positions = np.random.default_rng(0).normal(size=(4, 9, 2))
    for extra in ({}, {"time": np.arange(9.0)}, {"time": np.tile(np.arange(9.0), (4, 1))}):
        np.savez(tmp_path / "d.npz", positions=positions, **extra)
        loaded = load_demonstrations(tmp_path / "d.npz")
        np.testing.assert_array_equal([d.positions for d in loaded], positions)
        np.testing.assert_allclose(loaded[2].phases, np.linspace(0, 1, 9))


def test_npz_refuses(tmp_path: Path) -> None:
    bad = Q.copy()
    bad[1, 1] = np.nan
    flat = {"Q": Q, "time": TIMES, "lengths": np.array([3])}
    cases: list[tuple[dict[str, np.ndarray], str]] = [
        ({"x": Q}, "holds x; expected Q, time, lengths"),
        (flat | {"lengths": np.array([2])}, "sum to 3"),
        (flat | {"lengths": np.array([1.5, 1.5])}, "whole"),
        (flat | {"time": TIMES[:2]}, "expected Q"),
        (flat | {"Q": bad}, r"demonstration 0: positions\[1, 1\] is nan"),
        (flat | {"lengths": np.array([2, 1])}, "demonstration 1.*at least 2"),
        (flat | {"Q": Q.astype(str)}, "expected numbers"),
        ({"positions": Q}, r"expected shape \(N, T, n\)"),
        ({"positions": np.zeros((0, 4, 2))}, "no demonstrations"),
        ({"positions": Q[None], "time": np.zeros(7)}, "time: expected shape"),
        ({"positions": Q[None], "time": np.zeros(3)}, "increase"),
        ({"positions": Q[None], "joint_names": np.array(["a"])}, "joint_names"),
        ({"positions": np.array([object()])}, "plain arrays"),
    ]
    for arrays, message in cases:
        np.savez(tmp_path / "d.npz", **arrays)
        with pytest.raises(InvalidDemonstrationError, match=f"d.npz.*{message}"):
            load_demonstrations(tmp_path / "d.npz")
    (tmp_path / "d.npz").write_bytes(b"PK\x03\x04 cut off")
    with pytest.raises(InvalidDemonstrationError, match=r"d\.npz"):
        load_demonstrations(tmp_path / "d.npz")


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_text("time,shoulder,elbow\n0,0,1\n1,0.5,0.5\n\n3,1,0\n", encoding="utf-8-sig")
    (demo,) = (loaded := load_demonstrations(path))
    assert loaded.joint_names == ("shoulder", "elbow")
    np.testing.assert_array_equal(demo.times, TIMES)
    np.testing.assert_array_equal(demo.positions, Q)


def test_csv_with_a_demo_column(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_text("demo,time,q1\nb,0,1\nb,1,2\na,0,3\na,2,4\n")
    loaded = load_demonstrations(path)
    assert [d.positions[:, 0].tolist() for d in loaded] == [[1, 2], [3, 4]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("0,1,2\n1,2,3\n", "line 1: expected a header"),
        ("time\n0\n1\n", "header"),
        ("time;q1\n0;1\n", "line 1: its columns are separated by semicolons: must be by commas"),
        ("time,q1\n", "no demonstrations"),
        ("time,q1\n0,1\n", "at least 2"),
        ("time,q1\n0,1\n1,x\n", "line 3: q1 is 'x'"),
        ("time,q1\n0,1,5\n1,2,5\n", "line 2: 3 values"),
        ("time,q1,q1\n0,1,1\n1,2,2\n", "'q1' appears twice"),
        ("demo,time,q1\na,0,1\na,1,1\nb,0,1\n", "demo b: .*at least 2"),
    ],
)
def test_csv_refuses(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "d.csv"
    path.write_text(text)
    with pytest.raises(InvalidDemonstrationError, match=f"d.csv.*{message}"):
        load_demonstrations(path)


@pytest.mark.parametrize(
    "content",
    [
        "time,a,b\n0,1,2\n1,3,4\n".encode("utf-16"),
        b"sep=;\r\ntime;a;b\r\n0;1;2\r\n1;3;4\r\n",
        b"sep=\t\n# of today\ntime\ta\tb\n0\t1\t2\n# paused\n1\t3\t4\n",
        b"# of today\n# time,a,b\n0,1,2\n1,3,4\n",
        "\ufeffsep=|\ntime|a|b\n0|1|2\n1|3|4\n".encode("utf-16-be"),
    ],
)
def test_csv_of_other_programs(tmp_path: Path, content: bytes) -> None:
    """With a stated separator, with comments, as numpy.savetxt writes it, in UTF-16."""
    path = tmp_path / "d.csv"
    path.write_bytes(content)
    (one,) = found = load_demonstrations(path)
    assert found.joint_names == ("a", "b")
    assert one.positions.tolist() == [[1.0, 2.0], [3.0, 4.0]]


def test_csv_that_is_no_text(tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_bytes(b"time,q1\n0,\xff\n1,2\n")
    with pytest.raises(InvalidDemonstrationError, match="in UTF-8 or UTF-16"):
        load_demonstrations(path)


def test_units_and_names_of_others(tmp_path: Path) -> None:
    """Degrees of what turns; LeRobot's range of -100 to 100 by its calibration; steps over pi."""
    path = recorded(tmp_path / "d.csv", np.array([[10.0, 0.9], [20.0, 1.0], [10.0, 0.0]]))
    (one,) = load_demonstrations(path, Units("degrees", slides=("b",)))
    np.testing.assert_allclose(np.degrees(one.positions[:, 0]), [10.0, 20.0, 10.0])
    assert one.positions[:, 1].tolist() == [0.9, 1.0, 0.0]
    file = tmp_path / "follower.json"
    servo = {"range_min": 1024, "range_max": 3071.5, "homing_offset": 7}
    file.write_text(json.dumps({"a": servo, "b": servo | {"drive_mode": 1}}))
    units = units_of("range", file, ["b=lift", "a="], ())
    found = load_demonstrations(path, units)
    assert found.joint_names == ("lift",)
    np.testing.assert_allclose(found[0].positions[:, 0], [-0.0045 * np.pi, -0.005 * np.pi, 0.0])
    file.write_text(json.dumps({"a": servo}))
    with pytest.raises(InvalidDemonstrationError, match="no calibrated joint 'b': valid are a"):
        load_demonstrations(path, units_of("range", file, (), ()))
    with pytest.raises(InvalidDemonstrationError, match="no column 'c': valid are a, b"):
        load_demonstrations(path, units_of(None, None, ["c=d"], ()))
    file.write_text('{"a": {"range_min": 1}}')
    for given, told in (
        (("range", None, ()), "go together"), ((None, file, ()), "go together"),
        (("range", file, ()), "follower.json: no calibration of LeRobot: .*range_max"),
        ((None, None, ["a"]), "--rename a: must be OLD=NEW"),
    ):  # fmt: skip
        with pytest.raises(InvalidRequestError, match=told):
            units_of(*given, ())


def test_folder(tmp_path: Path) -> None:
    with pytest.raises(InvalidDemonstrationError, match=r"no \.csv"):
        load_demonstrations(tmp_path)
    for i in (2, 1):
        (tmp_path / f"{i}.csv").write_text(f"time,q1\n0,{i}\n1,{i}\n")
    (tmp_path / "notes.txt").write_text("not read")
    loaded = load_demonstrations(tmp_path)
    assert [d.positions[0, 0] for d in loaded] == [1, 2]
    (tmp_path / "3.csv").write_text("time,q2\n0,1\n1,1\n")
    with pytest.raises(InvalidDemonstrationError, match=r"3\.csv: joints q2; 1\.csv has q1"):
        load_demonstrations(tmp_path)


def test_joints_are_told_by_name() -> None:
    y = np.random.default_rng(0).normal(size=(4, 30, 3))
    demos = Demonstrations(
        tuple(Demonstration(np.arange(30.0), p) for p in y), ("elbow", "base", "wrist")
    )
    joints = ("base", "elbow", "wrist")
    ordered = demos.for_joints(joints, "here")
    assert ordered.joint_names == joints
    np.testing.assert_array_equal(ordered[2].positions, y[2][:, [1, 0, 2]])
    promp, same = fit(demos).for_joints(joints), fit(ordered)
    assert promp.joint_names == joints
    for name in ("mean", "covariance", "noise"):
        np.testing.assert_allclose(getattr(promp, name), getattr(same, name), atol=1e-12)
    assert promp.for_joints(joints) is promp


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("a", "b"), "here: joint c is missing. Name each joint of the robot once: a, b, c"),
        (("a", "b", "c", "d"), "here: the robot has no joint d. Name"),
        (("x", "b", "y"), "here: the robot has no joint x, y; joint a, c is missing. Name"),
        ((), "here: its joints are called joint_1 to joint_3, as columns without names are. Name"),
    ],
)
def test_other_joints_are_refused(names: tuple[str, ...], message: str) -> None:
    y = np.random.default_rng(0).normal(size=(3, 9, len(names) or 3))
    demos = Demonstrations(tuple(Demonstration(np.arange(9.0), p) for p in y), names)
    with pytest.raises(InvalidDemonstrationError, match=message):
        demos.for_joints(("a", "b", "c"), "here")
    with pytest.raises(InvalidDemonstrationError, match=message):
        fit(demos).for_joints(("a", "b", "c"), "here")


def test_other_paths(tmp_path: Path) -> None:
    with pytest.raises(InvalidDemonstrationError, match="does not exist"):
        load_demonstrations(tmp_path / "none.npz")
    (tmp_path / "d.txt").write_text("")
    with pytest.raises(InvalidDemonstrationError, match=r"expected \.npz, \.csv"):
        load_demonstrations(tmp_path / "d.txt")


def test_degrees_are_noticed(tmp_path: Path) -> None:
    np.savez(tmp_path / "d.npz", positions=90.0 * np.random.default_rng(0).normal(size=(3, 9, 2)))
    with pytest.warns(UnitsWarning, match="read as radians or metres"):
        loaded = load_demonstrations(tmp_path / "d.npz")
    assert fit(loaded).n_joints == 2


def recorded(path: Path, *positions: np.ndarray) -> Path:
    """A CSV of demonstrations (T, 2) at 100 Hz."""
    lines = ["demo,time,a,b"]
    for k, rows in enumerate(positions):
        lines += [f"{k},{0.01 * i:.2f},{a:.6f},{b:.6f}" for i, (a, b) in enumerate(rows)]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_what_runs_backwards_or_stands_still_is_told(tmp_path: Path) -> None:
    """A demonstration recorded on the way back, or with a still head, was learnt without a word."""
    s = np.linspace(0.0, 1.0, 201)
    noise = np.random.default_rng(0).normal(size=(5, 201, 2))
    rows = (10 * s**3 - 15 * s**4 + 6 * s**5)[:, None] * [0.5, -0.3] + [0.2, 1.0] + 1e-4 * noise
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        load_demonstrations(recorded(tmp_path / "good.csv", *rows))
    back = [*rows[:3], rows[3, ::-1], rows[4]]
    with pytest.warns(UserWarning, match="demonstration 3 runs from where the others end"):
        load_demonstrations(recorded(tmp_path / "back.csv", *back))
    for which, late in (
        ("first", np.concatenate([np.repeat(rows[1, :1], 300, axis=0), rows[1]])),
        ("last", np.concatenate([rows[1], np.repeat(rows[1, -1:], 300, axis=0)])),
    ):
        with pytest.warns(UserWarning, match=f"demonstration 1 stands still for the {which} 6"):
            load_demonstrations(recorded(tmp_path / "still.csv", rows[0], late, rows[2]))


def test_time_that_runs_back_cuts_a_file_and_rows_of_one_time_are_left_out(tmp_path: Path) -> None:
    """By the rule of bags: both parts stay, and what is left out is told."""
    rows = [(0.01 * k, 0.1 * k) for k in range(40)] + [(0.01 * k, 9.0 - 0.1 * k) for k in range(30)]
    rows[5], rows[6] = rows[6], rows[5]  # which overtook each other
    rows.insert(10, rows[10])
    path = tmp_path / "d.csv"
    path.write_text("time,q1\n" + "".join(f"{t:.3f},{q:.3f}\n" for t, q in rows))
    with pytest.warns(UserWarning, match="the time") as told:
        first, second = load_demonstrations(path)
    np.testing.assert_allclose(first.positions[:, 0], 0.1 * np.arange(40), atol=1e-12)
    np.testing.assert_allclose(second.positions[:, 0], 9.0 - 0.1 * np.arange(30), atol=1e-12)
    words = " ".join(str(each.message) for each in told)
    assert "the time runs back by 0.39 at row 41: cut there, and both parts are read" in words
    assert "1 of 71 rows have the time of another: left out" in words


def wrapped(angles: np.ndarray, full: bool) -> np.ndarray:
    """As an encoder reports them: from 0 to a full turn, or within half a turn of zero."""
    turn = 2.0 * np.pi
    return angles % turn if full else (angles + np.pi) % turn - np.pi


def test_a_wrist_that_passes_half_a_turn_is_one_motion(tmp_path: Path) -> None:
    """A joint without limits has the mean of its motions, not of its numbers."""
    s = np.linspace(0.0, 1.0, 101)[:, None]
    noise = np.random.default_rng(0).normal(0.0, 0.02, (6, 2))
    motions = [np.array([2.9, 0.1]) + s * [0.7, 0.5] + n for n in noise]
    path = recorded(
        tmp_path / "d.csv",
        *(np.column_stack([wrapped(m[:, 0], k % 2), m[:, 1]]) for k, m in enumerate(motions)),
    )
    wanted = np.mean([m - motions[0][0] for m in motions], axis=0)
    limits = np.array([-np.inf, -3.0]), np.array([np.inf, 3.0])
    found = load_demonstrations(path).for_robot(("a", "b"), *limits, "here")
    learnt = fit(found).mean_trajectory(101)
    np.testing.assert_allclose(learnt - learnt[0], wanted - wanted[0], atol=0.02)


@pytest.mark.parametrize("version", [2, 3])
def test_episodes_of_lerobot_are_demonstrations(tmp_path: Path, version: int) -> None:
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    rng, tables, wanted = np.random.default_rng(0), [], []
    for k in range(3):
        q = np.cumsum(rng.normal(0.0, 0.01, (20 + k, 3)), axis=0).astype(np.float32)
        wanted.append(q[:, :2])
        tables.append(
            pa.table({
                "observation.state": pa.FixedSizeListArray.from_arrays(pa.array(q.ravel()), 3),
                "timestamp": pa.array(np.arange(len(q)) / 30.0, pa.float32()),
                "episode_index": pa.array(np.full(len(q), k)),
            })
        )  # fmt: skip
    folder = tmp_path / "set"
    (folder / "data" / "chunk-000").mkdir(parents=True)
    (folder / "meta").mkdir()
    whole = {"file-000": pa.concat_tables(tables)}
    apart = {f"episode_{k:06d}": table for k, table in enumerate(tables)}
    for name, table in (whole if version == 3 else apart).items():
        parquet.write_table(table, folder / "data" / "chunk-000" / f"{name}.parquet")
    names = ["elbow.pos", "lift.pos", "gripper.pos"]
    state = {"names": names if version == 3 else {"motors": names}}
    info = {"features": {"observation.state": state}}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    with (
        pytest.warns(UnitsWarning, match="states no unit"),
        pytest.warns(match="gripper: left out"),
    ):
        found = load_demonstrations(folder)
    assert found.joint_names == ("elbow", "lift")
    for one, q in zip(found, wanted, strict=True):
        np.testing.assert_allclose(one.positions, q, atol=1e-6)
        assert one.times[-1] == pytest.approx((len(q) - 1) / 30.0, abs=1e-5)
    with pytest.warns(match="gripper: left out"):
        one = load_demonstrations(folder, Units("degrees", names={"lift": "b"}))[0]
    np.testing.assert_allclose(one.positions, np.radians(wanted[0]), atol=1e-8)
    (folder / "meta" / "info.json").write_text("{}")
    with pytest.raises(InvalidDemonstrationError, match="no LeRobot dataset with"):
        load_demonstrations(folder)


def test_a_minari_dataset_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "metadata.json").write_text("{}")
    with pytest.raises(InvalidDemonstrationError, match="is a Minari dataset"):
        load_demonstrations(tmp_path)


@pytest.mark.parametrize("apart", [[2], [0], [0, 2], [1, 3, 5]])
def test_demonstrations_a_turn_apart_come_onto_one_turn_if_the_limits_have_room(tmp_path, apart):
    """Their mean is a motion, not one between two turns; also where half of them are apart."""
    turn, s = 2.0 * np.pi, np.linspace(0.0, 1.0, 51)[:, None]
    motions = [np.array([2.9, 0.1]) + s * [0.7, 0.5] + 0.01 * k for k in range(6)]
    told = [m - turn * (k in apart) * np.array([1.0, 0.0]) for k, m in enumerate(motions)]
    path = recorded(tmp_path / "d.csv", *told)
    with pytest.warns(UserWarning, match="begins a turn apart from others in a"):
        found = load_demonstrations(path)
    for low, high in ((-turn, turn), (-np.inf, np.inf), (-4.0, 6.0)):
        limits = np.array([low, -3.0]), np.array([high, 3.0])
        turns = Turns(np.array([True, False]), *limits)
        here = found.for_robot(("a", "b"), *limits, "here", turns)
        mean = fit(here).mean_trajectory(51)
        away = np.round((mean[0, 0] - 2.9) / turn) * turn
        np.testing.assert_allclose(mean[:, 0] - away, np.mean(motions, axis=0)[:, 0], atol=0.02)


def test_demonstrations_a_turn_apart_that_no_turn_has_room_for_are_refused(tmp_path: Path) -> None:
    s, q = np.linspace(0.0, 1.0, 51)[:, None], np.array([2.9, 0.1])
    path = recorded(tmp_path / "d.csv", q - s * [5.9, 0.0], q - [2.0 * np.pi, 0.0] + s * [6.0, 0.0])
    limits = np.array([-6.3, -3.0]), np.array([6.3, 3.0])
    with pytest.warns(UserWarning, match="begins a turn apart from others in a"):
        found = load_demonstrations(path)
    with pytest.raises(InvalidDemonstrationError, match=r"apart from others in a, .* have no room"):
        found.for_robot(("a", "b"), *limits, "here", Turns(np.array([True, False]), *limits))
