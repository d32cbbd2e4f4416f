"""A picker's recording in a bag says the same as the file that it was made of."""

from pathlib import Path

import numpy as np
import pytest
from scripts.shadow_picks import Done, record
from tests.cli.fixtures import invoke, told
from tests.ros.camera_messages import FRAME, compressed, frames, image, info, states
from tests.ros.looks import EPOCH, array, array_of, seen

from optipromp import plan, save_scene
from optipromp_loop.control import without_fruits
from optipromp_loop.shadow.recording import load_recorded
from optipromp_ros import Recorded, write_bag
from optipromp_ros.shadow import load_picks
from optipromp_ros.trajectories import NANO
from optipromp_sim.generate import generate
from optipromp_sim.simulation.photograph import photograph

SCENE = generate("cluster", 110_000)


def test_a_bag_is_read_as_the_file(tmp_path: Path) -> None:
    file, bag = tmp_path / "shift.json", tmp_path / "shift.mcap"
    record([Done(SCENE, plan(SCENE, planner="promp").trajectory, "harmed")], file, "perfect")
    read = load_recorded(file, SCENE)
    items = [Recorded("/tf_static", frames(EPOCH, ("left_link0", "eye", read.looks[0].camera)))]
    names = [f"left_{name}" for name in (*read.arm.joints, "finger")]
    for time, *q in np.loadtxt(file.with_suffix(".csv"), delimiter=",", skiprows=1).tolist():
        items.append(Recorded("/joint_states", states(names, q, EPOCH + round(time * NANO))))
    for look in read.looks:
        items.append(Recorded("/seen", array_of(look, EPOCH + round(look.time * NANO), "eye")))
    write_bag(bag, items)
    roles = ["ripe=target:stem", "unripe=pushable:stem"]
    found = load_picks(bag, SCENE, gripper="left_finger", marks=None, roles=roles)
    assert [m.closed for m in found.marks] == pytest.approx([m.closed for m in read.marks])
    assert not found.lacks
    np.testing.assert_allclose(found.arm.at(3.0), read.arm.at(3.0), atol=1e-9)
    for one, other in zip(found.looks, read.looks, strict=True):
        assert one.time == pytest.approx(other.time)
        for here, there in zip(one.in_base(), other.in_base(), strict=True):
            assert here.role == there.role
            np.testing.assert_allclose(here.position, there.position, atol=1e-6)
    save_scene(without_fruits(SCENE), tmp_path / "cell.yaml")
    asked = "shadow", bag, "--known", tmp_path / "cell.yaml", "--gripper"
    (pick,) = told(*asked, "left_finger")["picks"]
    assert (pick["harmful"], pick["ours"]["status"]) == (True, "success")
    assert "'jaw'" in invoke(*asked, "jaw").output
    shot = photograph(SCENE)
    at = EPOCH + round(0.2 * NANO)
    shown = [
        compressed(shot.picture.rgb, at, "png"),
        image(shot.picture.depth.astype(np.float32), "32FC1", at), info(shot.picture.camera),
    ]  # fmt: skip
    taken = [Recorded(f"/c/{k}", item) for k, item in enumerate(shown)]
    place = Recorded("/tf_static", frames(EPOCH, ("left_link0", FRAME, shot.picture.camera.pose)))
    heard = [item for item in items if item.topic == "/joint_states"]
    write_bag(tmp_path / "pictures", [place, *heard, *taken])
    looked = load_picks(tmp_path / "pictures", SCENE, gripper="left_finger", marks=None)
    (look,) = looked.looks
    assert look.time == pytest.approx(0.2)
    (ripe,) = (item for item in look.in_base() if item.role == "target")
    assert np.linalg.norm(ripe.position - SCENE.target.position) < 0.01
    placed = Recorded("/seen", array(seen("ripe", (0.3, 0.6, 0.5)), frame="world"))
    write_bag(tmp_path / "world", [item for item in items if item.topic != "/seen"] + [placed])
    blind = load_picks(tmp_path / "world", SCENE, gripper="left_finger", marks=None)
    assert [words.partition(":")[0] for words in blind.lacks] == [
        "stems", "where the camera was, in 1 of 1 looks"
    ]  # fmt: skip
