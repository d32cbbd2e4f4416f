"""``optipromp calibrate``: where a camera is."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import optipromp
from optipromp.cli.command import FAILED, OK, Report, command, show_warning
from optipromp.cli.console import grid, waiting
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import json_text, write_atomically

if TYPE_CHECKING:
    from optipromp_eyes.calibration import Board, HandEye


MOST_PIXEL = 3.0  # root mean square over the views, above which --force writes: a choice


@dataclass(frozen=True)
class BoardOptions:
    """The options that tell what is printed on the board.

    Attributes:
        board: What is printed on it.
        size (CxR): Of a chessboard its inner corners, of a charuco board its squares, of apriltags
            the tags: along a row, and rows.
        side (METRES): Of a square; of an apriltag's black border.
        marker (METRES): Side of a charuco board's markers; gap between apriltags.
        dictionary: Of the markers, as OpenCV names it; by default the usual one.
    """

    board: Literal["chessboard", "charuco", "apriltag"] = "charuco"
    size: str = "7x5"
    side: float | None = None
    marker: float = 0.0
    dictionary: str = ""

    def made(self) -> "Board":
        """The board."""
        from optipromp_eyes.calibration import Board

        columns, cross, rows = self.size.lower().partition("x")
        if not (cross and columns.isdigit() and rows.isdigit()):
            raise InvalidRequestError(f"--size is {self.size!r}: write it as 7x5")
        if self.side is None:
            raise InvalidRequestError("give --side, measured on the print [m]")
        usual = "APRILTAG_36h11" if self.board == "apriltag" else "5X5_100"
        size = int(columns), int(rows)
        return Board(self.board, *size, self.side, self.marker, self.dictionary or usual)


@command()
def calibrate(
    folder: Path | None = None,
    /,
    *,
    camera: Path,
    out: Path,
    poses: Path | None = None,
    tool: Path | None = None,
    mount: Literal["hand", "base"] = "base",
    board: BoardOptions,
    known: str | None = None,
    force: bool = False,
) -> Report:
    """Find where a camera is, from pictures of a board or from the arm's own tool.

    A camera on the hand looks at a board that stands; a camera that stands looks at a board fixed
    on the hand, or at the tool itself. Take 10 to 20 pictures, tilt the hand by 15 to 30 degrees to
    all sides between them, and turn it. Reported: what each view leaves, the standard deviation of
    the camera's place, and how far it moves when one view is left out. Views that leave 5 times the
    pixels that the board leaves by itself are named.

    Examples:
        optipromp calibrate shots --poses shots/poses.yaml --known row.yaml --camera d435.json \\
            --mount hand --size 7x5 --side 0.03 --marker 0.022 --out camera.json
        optipromp calibrate --tool seen.yaml --known row.yaml --camera d435.json --out camera.json
        optipromp see --rgb a.png --depth a.png --camera camera.json --known row.yaml --out a.yaml

    Args:
        folder (DIR): Of pictures of a board; else --tool.
        camera: Its pictures: JSON or YAML with width, height, fx, fy, cx, cy. Pictures are without
            distortion, as most cameras give them.
        out (FILE.json): The camera, for 'see'.
        poses: YAML or JSON: a picture's name to joints, or to position and orientation (w, x, y, z)
            of the flange in the base.
        tool: In place of pictures, YAML or JSON: a name to camera, the tool's centre in m as the
            camera sees it, and joints, or the centre's position in the base.
        mount: hand: the camera is on it, the board stands; base: the other way.
        known (SCENE): Whose robot has these joints, and tool.
        force: Write a camera whose views leave over 3 pixels, too.
    """
    from optipromp.core.planning.task import posed
    from optipromp_eyes.calibration import by_tool, hand_eye, read_seen_tool, read_views
    from optipromp_eyes.pictures import load_camera

    if (folder is None) == (tool is None):
        raise InvalidRequestError("give a folder of pictures or --tool, one of them")
    if tool is not None and mount == "hand":
        raise InvalidRequestError("a camera on the hand sees the tool stand still: show it a board")
    robot = None if known is None else posed(optipromp.load_scene(known))[0]
    model, without = load_camera(camera)[0], tuple[str, ...]()
    if tool is not None:
        found = by_tool(read_seen_tool(tool, robot), model)
    else:
        assert folder is not None
        if poses is None:
            raise InvalidRequestError("give --poses: where the hand was in each picture")
        with waiting("look for the board"):
            views, without = read_views(folder, poses, board.made(), model, robot)
            if not views:
                raise InvalidRequestError(
                    f"the board is in none of {len(without)} pictures: compare --board, --size and "
                    "--dictionary with the print; it must be whole (chessboard), sharp and flat"
                )
            found = hand_eye(views, model, mount)
    for name in without:
        show_warning(f"{name}: the board was not found")
    for words in found.doubts:
        show_warning(f"{words}: the standard deviation counts what that moves")
    if found.apart:
        show_warning(_apart(found))
    rough = found.total("pixel") > MOST_PIXEL and not force
    if rough:
        ends = (
            f"not written: the views leave {found.total('pixel'):.1f} pixels, must be "
            f"{MOST_PIXEL:g} at most: "
        )
        ends += "mend the poses or leave out the worst views, or write it by --force"
    else:
        write_atomically(out, json_text(found.camera.document()).encode())
        ends = f"wrote {out}"
    document = _document(found, None if rough else out, without)
    return Report(document, _shown(found, ends), FAILED if rough else OK)


def _apart(found: "HandEye") -> str:
    """What is said of views that leave much more than the board by itself."""
    worst, *others = found.apart
    pixel = next(each.pixel for each in found.residuals if each.name == worst)
    also = f"; over 5 times also {', '.join(others)}" if others else ""
    return (
        f"{worst} leaves {pixel:.1f} pixels, {pixel / found.own:.0f} times what the board leaves "
        f"by itself: a wrong pose, or an arm that errs{also}"
    )


def _document(found: "HandEye", out: Path | None, without: tuple[str, ...]) -> dict[str, Any]:
    board = found.board
    return {
        "file": out and str(out),
        "camera": found.camera.document(),
        "sigma": found.sigma.tolist(),
        "sigma_deg": found.sigma_degree,
        "doubts": list(found.doubts),
        "apart": list(found.apart),
        "left_out_moves": found.spread,
        "left_out_turns_deg": found.spread_degree,
        "residual": {name: found.total(name) for name in ("pixel", "metre", "degree")},
        "views": [each._asdict() for each in found.residuals],
        "without_board": list(without),
        "board": board and {
            "position": board.position.tolist(), "orientation": board.orientation.tolist(),
        },
    }  # fmt: skip


def _shown(found: "HandEye", ends: str) -> Iterator[Any]:
    from rich.table import Table

    table: Table = grid(("view",), ("pixel", "mm", "degree"))
    for each in found.residuals:
        table.add_row(each.name, *_figures(each.pixel, each.metre, each.degree))
    table.add_section()
    total = (found.total(name) for name in ("pixel", "metre", "degree"))
    table.add_row("root mean square", *_figures(*total))
    yield table
    pose, sigma = found.camera.pose, 1e3 * found.sigma
    at = ", ".join(f"{1e3 * value:.1f}" for value in pose.position)
    within = ", ".join(f"{value:.1f}" for value in sigma)
    yield f"camera in the frame of the {found.camera.mount}: at {at} mm"
    yield f"  standard deviation {within} mm, {found.sigma_degree:.2f} degrees"
    yield (
        f"  leaving one view out moves it by {1e3 * found.spread:.1f} mm and "
        f"{found.spread_degree:.2f} degrees at most"
    )
    yield ends


def _figures(pixel: float, metre: float, degree: float) -> tuple[str, ...]:
    values = (f"{pixel:.2f}", f"{1e3 * metre:.2f}", f"{degree:.2f}")
    return tuple("" if text == "nan" else text for text in values)
