"""Cameras whose pose is told by a board, or by the arm's own tool; the truth is known."""

import json
import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial.transform import Rotation
from tests.cli.fixtures import invoke
from tests.perception.drawn_boards import CAMERA, drawn, seen_as, views_from

from optipromp import load_scene
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning.task import posed
from optipromp.core.scenes.hand import flange_of
from optipromp.core.scenes.pose import Pose
from optipromp_eyes.calibration import Board, BoardView, SeenTool, by_tool, hand_eye
from optipromp_eyes.calibration.fitting import ANGLE, PLACE
from optipromp_eyes.pictures import Mount, load_camera

BOARD = Board("charuco", 7, 5, 0.03, 0.022)
BOARDS = (
    BOARD,
    Board("charuco", 7, 6, 0.03, 0.022),
    Board("chessboard", 7, 6, 0.025),
    Board("apriltag", 1, 1, 0.10, dictionary="APRILTAG_36h11"),
    Board("apriltag", 3, 2, 0.04, 0.01, "APRILTAG_36h11"),
)


def turned(pose: Pose) -> float:
    return math.degrees(Rotation.from_matrix(pose.rotation).magnitude())


def pixels_of(board: Board, view: Pose, rng: np.random.Generator) -> NDArray[np.uint8]:
    noisy = drawn(board, view) + rng.normal(0.0, 4.0, (CAMERA.height, CAMERA.width))
    return np.asarray(np.clip(noisy, 0, 255), dtype=np.uint8)


def shaken(hand: Pose, rng: np.random.Generator, share: float) -> Pose:
    turn = Rotation.from_rotvec(share * rng.normal(0.0, ANGLE, 3), degrees=True)
    return hand @ Pose(share * rng.normal(0.0, PLACE, 3), turn.as_matrix())


@pytest.mark.parametrize("board", BOARDS, ids=lambda b: f"{b.pattern}-{b.columns}x{b.rows}")
def test_a_board_is_found_where_it_is_however_it_is_turned(board: Board) -> None:
    for turn in ([0, 0, 0], [0.2, 0.3, 0], [0.1, -0.3, 3.0], [0.3, 0, 1.6]):
        r = Rotation.from_rotvec(turn).as_matrix()
        pose = Pose(np.array([0, 0, 0.45]) - r @ [0.06, 0.05, 0], r)
        found = board.find(drawn(board, pose))
        assert found is not None
        places, pixels = found
        off = pixels - CAMERA.pixels(pose @ places)
        assert np.sqrt((off**2).sum(axis=1).mean()) < 0.35  # [pixel]
    assert board.find(np.full((480, 640), 120, np.uint8)) is None


@pytest.mark.parametrize("mount", ["hand", "base"])
@pytest.mark.parametrize("share", [0.0, 1.0], ids=["exact arm", "noisy arm"])
def test_the_error_of_a_camera_is_within_what_is_told(mount: Mount, share: float) -> None:
    truth, seen, hands = views_from(10, 61001, mount)
    rng = np.random.default_rng(61002)
    views = []
    for k, (view, hand) in enumerate(zip(seen, hands, strict=True)):
        found = BOARD.find(pixels_of(BOARD, view, rng))
        assert found is not None
        views.append(BoardView(str(k), shaken(hand, rng, share), *found))
    told = hand_eye(views, CAMERA, mount)
    error = truth.inverse() @ told.camera.pose
    away = float(np.linalg.norm(error.position))
    assert told.camera.mount == mount
    assert away < (2.5e-3 if share else 0.4e-3)
    assert away < 3.0 * np.linalg.norm(told.sigma) < 0.012
    assert turned(error) < 3.0 * told.sigma_degree < 2.0
    assert told.total("pixel") < (4.0 if share else 0.3)
    assert (told.total("metre") > 0.5e-3) == bool(share)


def test_the_told_deviations_are_those_of_the_errors() -> None:
    ratios = []
    for seed in range(61100, 61114):
        truth, seen, hands = views_from(12, seed, "hand")
        rng = np.random.default_rng([seed, 1])
        moved = [shaken(hand, rng, 1.0) for hand in hands]
        told = hand_eye(seen_as(seen, moved, noise=0.15, seed=seed), CAMERA, "hand")
        ratios.append((told.camera.pose.position - truth.position) / told.sigma)
    assert 0.6 < np.sqrt(np.mean(np.square(ratios))) < 1.5
    assert np.mean(np.abs(ratios) > 3.0) < 0.05


def test_a_board_seen_in_its_mirrored_pose_does_not_bend_the_answer() -> None:
    """A small tag nearly head on has two poses; the views together tell which is right."""
    truth, seen, hands = views_from(14, 61003, "hand")
    tag = 0.02 * np.array([[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]])
    told = hand_eye(seen_as(seen, hands, tag, 0.3, 61004), CAMERA, "hand")
    error = truth.inverse() @ told.camera.pose
    assert np.linalg.norm(error.position) < 0.006
    assert turned(error) < 1.0


def test_a_standing_camera_by_the_tool_it_sees() -> None:
    truth = Pose([0.9, 0.2, 0.5], Rotation.from_rotvec([0.2, -1.9, 0.3]).as_matrix())
    rng = np.random.default_rng(61005)
    base = rng.uniform([0.3, -0.2, 0.1], [0.7, 0.3, 0.6], (15, 3))
    seen = truth.inverse() @ base + rng.normal(0.0, 0.002, base.shape)
    tools = [SeenTool(str(k), *pair) for k, pair in enumerate(zip(seen, base, strict=True))]
    told = by_tool(tools, CAMERA)
    error = truth.inverse() @ told.camera.pose
    away = float(np.linalg.norm(error.position))
    assert away < 3.0 * np.linalg.norm(told.sigma) < 0.02
    assert turned(error) < 3.0 * told.sigma_degree < 2.0
    assert 0.002 < told.total("metre") < 0.005
    line = [one._replace(base=np.array([0.1 * k, 0.2, 0.3])) for k, one in enumerate(tools)]
    with pytest.raises(InvalidRequestError, match="lie along a line"):
        by_tool(line, CAMERA)
    with pytest.raises(InvalidRequestError, match="in 3 places; must be 4"):
        by_tool(tools[:3], CAMERA)
    others = [a._replace(base=b.base) for a, b in zip(tools, tools[::-1], strict=True)]
    with pytest.raises(InvalidRequestError, match="no pose of the camera fits"):
        by_tool(others, CAMERA)


def test_views_that_cannot_tell_are_refused() -> None:
    _, seen, hands = views_from(8, 61006, "hand")
    with pytest.raises(InvalidRequestError, match="in 3 pictures; must be in 4"):
        hand_eye(seen_as(seen[:3], hands[:3]), CAMERA, "hand")
    for axis in (np.zeros(3), np.array([0.0, 0.0, 1.0])):  # shifts alone; turns about one axis
        held = [
            Pose(hand.position, Rotation.from_rotvec(0.3 * k * axis).as_matrix())
            for k, hand in enumerate(hands)
        ]
        with pytest.raises(InvalidRequestError, match="hardly turns between the pictures"):
            hand_eye(seen_as(seen, held), CAMERA, "hand")


def computed_views(seed: int) -> tuple[Pose, list[BoardView]]:
    """The camera's true pose on the hand of an exact arm; its views, with 0.15 pixel of noise."""
    truth, seen, hands = views_from(12, seed, "hand")
    return truth, seen_as(seen, hands, noise=0.15, seed=[seed, 2])


MISTAKES: dict[str, tuple[Any, str]] = {
    "inverse": (lambda h: [one.inverse() for one in h], "wrong way round"),
    "xyzw": (lambda h: [Pose(o.position, np.roll(o.orientation, -1)) for o in h], "x, y, z, w;"),
    "late": (lambda h: [h[0], *h[:-1]], "late by one picture"),
    "early": (lambda h: [*h[1:], h[-1]], "early by one picture"),
    "inverse in mm": (
        lambda h: [Pose(1e3 * o.inverse().position, o.inverse().orientation) for o in h],
        "beyond 10 m: millimetres",
    ),
    "both": (
        lambda h: [
            Pose(o.inverse().position, np.roll(o.inverse().orientation, -1)) for o in h
        ],
        "wrong way round.*, and the orientations are told as x, y, z, w",
    ),
    "no order": (
        lambda h: [h[k] for k in np.random.default_rng(61202).permutation(len(h))],
        "no pose of the camera fits.*Compare --poses",
    ),
}  # fmt: skip


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_fit_that_failed_is_refused_with_what_is_probably_wrong(mistake: str) -> None:
    mount: Mount = "base" if mistake in ("late", "both") else "hand"
    _, seen, hands = views_from(12, 61200, mount)
    wrong, said = MISTAKES[mistake]
    with pytest.raises(InvalidRequestError, match=said):
        hand_eye(seen_as(seen, wrong(hands), noise=0.15), CAMERA, mount)


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_the_told_deviation_counts_wrong_intrinsics(share: float) -> None:
    truth, views = computed_views(61203)
    wrong = replace(CAMERA, fx=share * CAMERA.fx, fy=share * CAMERA.fy)
    told = hand_eye(views, wrong, "hand")
    away = float(np.linalg.norm(told.camera.pose.position - truth.position))
    assert away > 0.009
    assert 0.5 < away / np.linalg.norm(told.sigma) < 2.0
    assert len(told.doubts) == 1
    assert "intrinsics are wrong" in told.doubts[0]


def test_the_told_deviation_counts_a_board_that_is_printed_too_small() -> None:
    truth, views = computed_views(61204)
    told = hand_eye([v._replace(places=1.03 * v.places) for v in views], CAMERA, "hand")
    away = float(np.linalg.norm(told.camera.pose.position - truth.position))
    assert 0.5 < away / np.linalg.norm(told.sigma) < 2.0
    assert "sides are 0.97 times as long" in told.doubts[0]
    with pytest.raises(InvalidRequestError, match=r"sides are 0\.001 times as long as told"):
        hand_eye([v._replace(places=1e3 * v.places) for v in views], CAMERA, "hand")


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("chessboard", 7, 7, 0.02), "looks the same turned by a half"),
        (("charuco", 7, 5, 0.03, 0.03), "smaller than its squares"),
        (("charuco", 7, 5, 0.0), "side is 0"),
        (("apriltag", 2, 2, 0.03), "gap between two"),
        (("dots", 7, 5, 0.03), "valid are chessboard"),
    ],
)
def test_a_board_that_cannot_be_is_refused(given: Any, said: str) -> None:
    with pytest.raises(InvalidRequestError, match=said):
        Board(*given)


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Pose]:
    """Pictures of a board by a camera on a Panda's hand, with the joints at each."""
    folder = tmp_path_factory.mktemp("shots")
    robot, state = posed(load_scene("scenario-3"))
    rng = np.random.default_rng(61007)
    camera = Pose([0.06, 0.0, 0.02], Rotation.from_rotvec([0.0, 0.1, 1.57]).as_matrix())
    middle = flange_of(robot, state.q) @ camera @ Pose([-0.105, -0.075, 0.40])
    poses = {}
    while len(poses) < 9:
        q = state.q + rng.normal(0.0, 0.12, robot.n_joints)
        view = (flange_of(robot, q) @ camera).inverse() @ middle
        picture = drawn(BOARD, view)
        if BOARD.find(picture) is not None:
            name = f"{len(poses)}.png"
            Image.fromarray(picture).save(folder / name)
            poses[name] = {"joints": q.round(6).tolist()}
    (folder / "poses.json").write_text(json.dumps(poses))
    (folder / "d435.json").write_text(json.dumps(CAMERA.document()))
    return folder, camera


def shown(folder: Path, out: Path, *more: object) -> Any:
    return invoke(
        "calibrate", folder, "--poses", folder / "poses.json", "--camera", folder / "d435.json",
        "--known", "scenario-3", "--mount", "hand", "--side", "0.03", "--marker", "0.022",
        "--out", out, *more,
    )  # fmt: skip


def test_the_command_writes_a_camera_that_see_takes(
    shots: tuple[Path, Pose], tmp_path: Path
) -> None:
    folder, truth = shots
    done = shown(folder, tmp_path / "camera.json", "--json")
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    camera, _ = load_camera(tmp_path / "camera.json")
    assert camera.mount == "hand"
    assert np.abs(camera.pose.position - truth.position).max() < 0.001
    assert len(told["views"]) == 9
    assert told["residual"]["pixel"] < 0.5
    people = shown(folder, tmp_path / "camera.json").stdout
    assert "camera in the frame of the hand" in people
    rgb, depth = tmp_path / "a.png", tmp_path / "depth.npz"
    Image.fromarray(np.zeros((480, 640, 3), np.uint8)).save(rgb)
    np.savez(depth, depth=np.zeros((480, 640)))
    words = ("see", "--rgb", rgb, "--depth", depth, "--camera", tmp_path / "camera.json")
    seen = invoke(*words, "--out", tmp_path / "a.yaml")
    assert "no ripe fruit is seen" in seen.stdout  # the picture is black; the camera was taken


def test_a_view_with_a_wrong_pose_is_named_and_a_rough_fit_is_written_by_force_alone(
    shots: tuple[Path, Pose], tmp_path: Path
) -> None:
    folder, _ = shots
    poses = json.loads((folder / "poses.json").read_text())
    out = tmp_path / "camera.json"
    for step, written in ((0.004, True), (0.03, False)):
        poses["4.png"]["joints"][0] += step  # [rad], of an arm that reaches half a metre
        (tmp_path / "poses.json").write_text(json.dumps(poses))
        done = shown(folder, out, "--json", "--poses", tmp_path / "poses.json")
        assert "warning: 4.png leaves" in done.stderr
        told = json.loads(done.stdout)
        assert told["apart"][0] == "4.png"
        assert (done.exit_code, bool(told["file"]), out.exists()) == (not written, written, written)
        out.unlink(missing_ok=True)
    said = shown(folder, out, "--poses", tmp_path / "poses.json").stdout
    assert "pixels, must be 3 at most" in said
    assert shown(folder, out, "--poses", tmp_path / "poses.json", "--force").exit_code == 0
    assert out.exists()


def test_the_command_says_what_to_do(shots: tuple[Path, Pose], tmp_path: Path) -> None:
    folder, _ = shots
    out = tmp_path / "camera.json"
    wrong = shown(folder, out, "--size", "9x8", "--dictionary", "APRILTAG_36h11")
    assert wrong.exit_code == 2
    assert "the board is in none of 9 pictures: compare --board" in wrong.stderr
    assert "write it as 7x5" in shown(folder, out, "--size", "seven").stderr
    assert "5X5_100" in shown(folder, out, "--dictionary", "5X5_10").stderr
    blank = Path(shutil.copytree(folder, tmp_path / "blank"))
    Image.fromarray(np.full((480, 640), 99, np.uint8)).save(blank / "3.png")
    some = shown(blank, out)
    assert some.exit_code == 0
    assert "warning: 3.png: the board was not found" in some.stderr
    (blank / "5.png").unlink()
    assert "5.png: there is no such picture" in shown(blank, out).stderr
    (blank / "poses.json").write_text('{"0.png": {"joints": [0, 1]}}')
    assert "joints must be 7 numbers" in shown(blank, out).stderr
    assert "the tool stand still" in asked_tool(blank, out, "--mount", "hand").stderr


def asked_tool(folder: Path, out: Path, *more: object) -> Any:
    words = ("calibrate", "--tool", folder / "seen.json", "--camera", folder / "d435.json")
    return invoke(*words, "--out", out, *more)


def test_the_command_takes_the_tool_that_was_seen(tmp_path: Path) -> None:
    robot, state = posed(load_scene("scenario-3"))
    rng = np.random.default_rng(61008)
    truth = Pose([1.0, 0.1, 0.4], Rotation.from_rotvec([0.2, -1.9, 0.3]).as_matrix())
    seen = {}
    for k in range(8):
        q = state.q + rng.normal(0.0, 0.2, robot.n_joints)
        point = truth.inverse() @ robot.tool_pose(q)[0] + rng.normal(0.0, 0.001, 3)
        seen[f"at{k}"] = {"joints": q.tolist(), "camera": point.tolist()}
    (tmp_path / "seen.json").write_text(json.dumps(seen))
    (tmp_path / "d435.json").write_text(json.dumps(CAMERA.document()))
    done = asked_tool(tmp_path, tmp_path / "camera.json", "--known", "scenario-3")
    assert done.exit_code == 0, done.output
    place = load_camera(tmp_path / "camera.json")[0].pose.position
    assert np.linalg.norm(place - truth.position) < 0.01
    assert "give --known" in asked_tool(tmp_path, tmp_path / "b.json").stderr
