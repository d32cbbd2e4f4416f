"""Objects of every role but the target may have a motion; nonsense is refused with what to do."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import optipromp
from optipromp.core.errors import InvalidSceneError
from optipromp.core.scenes import Scene, save_scene, scene_from_dict
from optipromp.core.scenes.objects import ObjectMotion

BALL = {"sphere": {"radius": 0.02}}
STEM = {"root": [0.5, 0.1, 0.7]}
TIMES = {"times": [0, 2], "positions": [[0.5, 0.1, 0.5], [0.5, 0.13, 0.5]]}


def scene(**changes: Any) -> Scene:
    item = {"id": "a", "role": "pushable", "shape": BALL, "position": [0.5, 0.1, 0.5]} | changes
    goal = {"position": [0.5, 0.0, 0.5], "axis": "free"}
    if item["role"] != "target":
        return scene_from_dict({"name": "x", "robot": "panda", "goal": goal, "objects": [item]})
    return scene_from_dict({"name": "x", "robot": "panda", "objects": [item]})


@pytest.mark.parametrize("role", ["static", "avoid", "pushable"])
@pytest.mark.parametrize("how", [{"velocity": [0.0, 0.02, 0.0]}, {"motion": TIMES}])
def test_a_motion_of_each_role_is_read_and_written(tmp_path: Path, role: str, how: Any) -> None:
    made = scene(role=role, stem=STEM, **how)
    save_scene(made, tmp_path / "s.yaml")
    (item,), (again,) = made.objects, optipromp.load_scene(tmp_path / "s.yaml").objects
    np.testing.assert_array_equal(again.motion.times, item.motion.times)
    np.testing.assert_array_equal(again.motion.positions, item.motion.positions)
    np.testing.assert_allclose(item.motion.at(np.array([1.0]))[0][1], 0.12 if "velocity" in how
                               else 0.115)  # fmt: skip
    there = item.standing(1.0)
    assert there.motion is None
    np.testing.assert_allclose(there.stem.root - there.position, [0.0, 0.0, 0.2], atol=1e-12)
    aside = item.at(item.position + [0.1, 0.0, 0.0])
    np.testing.assert_allclose(aside.motion.positions - item.motion.positions, [[0.1, 0, 0]] * 2)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"role": "target", "stem": STEM, "motion": TIMES}, "simulate --closed-loop"),
        ({"motion": TIMES}, "no stem of its own"),
        ({"stem": STEM, "velocity": [0, 0.2, 0]}, r"0.2 m/s: must be at most 0.1, or role avoid"),
        ({"role": "avoid", "velocity": [0, 20, 0]}, r"motion reaches 20 m/s.*scale: 0.001"),
        ({"stem": STEM, "motion": TIMES | {"times": [2, 0]}}, "must increase"),
        ({"stem": STEM, "motion": TIMES | {"positions": [[0, 0, 0], [0, 0, 1e-3]]}}, "at time 0"),
        ({"role": "static", "motion": TIMES | {"times": [0, 1, 2]}}, "positions"),
        ({"role": "static", "motion": TIMES, "velocity": [0, 0, 1]}, "one"),
    ],
)
def test_a_motion_that_cannot_be_is_refused(changes: Any, words: str) -> None:
    with pytest.raises(InvalidSceneError, match=words):
        scene(**changes)


def test_a_stem_that_carries_another_stands() -> None:
    grown = {"id": "b", "role": "pushable", "shape": BALL, "position": [0.5, 0.2, 0.5],
             "stem": {"root": [0.5, 0.1, 0.6], "parent": "a"}}  # fmt: skip
    main = {"id": "a", "role": "pushable", "shape": BALL, "position": [0.5, 0.1, 0.5],
            "stem": STEM}  # fmt: skip
    document = {"name": "x", "robot": "panda", "goal": {"joints": [0.0] * 7}}
    scene_from_dict(document | {"objects": [main, grown]})
    with pytest.raises(InvalidSceneError, match="fruits of a truss must stand"):
        scene_from_dict(document | {"objects": [main | {"velocity": [0, 0.01, 0]}, grown]})
    with pytest.raises(InvalidSceneError, match="state a stem without parent"):
        scene_from_dict(document | {"objects": [main, grown | {"velocity": [0, 0.01, 0]}]})


def test_a_motion_may_not_be_nan_in_python() -> None:
    with pytest.raises(InvalidSceneError, match=r"motion.positions\[1, 2\] is nan"):
        ObjectMotion(np.array([0.0, 1.0]), np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.nan]]))
