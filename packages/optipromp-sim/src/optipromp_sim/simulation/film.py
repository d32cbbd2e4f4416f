"""Films of runs and of picks in closed loop: where the camera stands, what it draws.

Tool and fruits fill the picture, seen from the side that hides them least. A film of a closed loop
shows tracks and paths, too, and what the camera at the tool sees.
"""

import functools
import io
import itertools
import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.core.errors import InvalidRequestError, check_one_of, installed_by
from optipromp.core.scenes.look import Look
from optipromp.looks.appearance import ground_of
from optipromp_eyes.pictures import CameraModel, Image8
from optipromp_sim.simulation.engine import engine
from optipromp_sim.simulation.execute import Loop, Run
from optipromp_sim.simulation.files import LoopRecord, ellipsoids, record_of
from optipromp_sim.simulation.studio import EYE, HIDDEN, SHOWN, Studio
from optipromp_sim.simulation.world import World, build

# choices for the eye
AROUND = (150.0, 210.0, 125.0, 235.0, 100.0, 260.0, 60.0, 300.0, 30.0, 330.0)  # [deg], in turn
LEVELS = (-10.0, 15.0, -35.0, 40.0)  # [deg] of elevation, in turn: low, fruits hide less
FILLED = 1.25  # height of the picture over that of tool and fruits
CAPTION = 0.12  # share of the height that is left free for the caption
NARROWEST = 0.40  # [m] height of the picture, at least
CALM = 0.6  # [s] standard deviation of the filter that smooths the camera's motion
FALLEN = 0.2  # [m] a fruit that has fallen by more is no longer kept in the picture
INSIDE = 0.95  # share of the picture that holds tool and fruits
LOOKS = 24  # moments at which an azimuth is tried
WEIGHT = 4.0  # of a moment at which tool or target are hidden, over that of another fruit
WITHIN = 0.6  # of half the box around a part, from its middle to the points that rays go to


class View(NamedTuple):
    """The size of pictures [pixel]."""

    width: int = 1280
    height: int = 720


@dataclass(frozen=True, eq=False)
class Shot:
    """The camera over time, at N moments."""

    azimuth: float  # [deg]
    elevation: float  # [deg]
    lookat: FloatArray  # (N, 3) [m]
    distance: FloatArray  # (N,) [m]

    def at(self, index: int) -> Any:
        """MuJoCo's camera."""
        mujoco = engine()
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance = self.lookat[index], self.distance[index]
        camera.azimuth, camera.elevation = self.azimuth, self.elevation
        return camera


def shot(world: World, model: Any, run: Run, times: FloatArray, view: View) -> Shot:
    """The camera of a run at ``times`` (N,) [s]; its motion is smooth, and it stands where tool and
    fruits are hidden least.

    The picture holds the tool from flange to tip, and targets and pushables with the lower ends of
    their stems, at all times. A fruit that falls is not followed. The floor, which nobody placed,
    is hidden where the tool goes below it.
    """
    rows, up = _rows(run, times), np.asarray(world.scene.up)
    floor = engine().mj_name2id(model, engine().mjtObj.mjOBJ_GEOM, "look:-1:floor")  # -1: none
    if floor >= 0 and (run.rollout.tool_point @ up).min() < (ground_of(world.scene) or 0.0):
        model.geom_group[floor] = HIDDEN
    seen, tan = _seen(world, run, rows), float(np.tan(0.5 * np.deg2rad(model.vis.global_.fovy)))
    focus = run.rollout.fruit_positions[0] if world.shown else run.rollout.tool_point[-1:]
    x, y, _ = focus.mean(axis=0)
    heading = float(np.rad2deg(np.arctan2(y, x)))
    around = [(heading + turn, over) for over in LEVELS for turn in AROUND]
    shots = [_shot(gaze, seen, times, view, tan) for gaze in around]
    return shots[_clearest(world, model, run, rows, shots)]


def _shot(
    gaze: tuple[float, float], seen: FloatArray, times: FloatArray, view: View, tan: float
) -> Shot:
    """The camera of azimuth and elevation ``gaze`` [deg] that holds points (N, k, 3) in view.

    ``tan``: of half the opening angle of the picture's height.
    """
    right, up, back = axes(*gaze)
    across, along = seen @ right, seen @ up
    low = np.stack([across.min(axis=1), along.min(axis=1)])
    high = np.stack([across.max(axis=1), along.max(axis=1)])
    low[1] -= CAPTION * (high[1] - low[1])
    wide = (high[0] - low[0]) * view.height / view.width
    distance = 0.5 * np.maximum(np.maximum(high[1] - low[1], wide) * FILLED, NARROWEST) / tan
    middle = 0.5 * (low + high)
    depth = (seen @ back).mean(axis=1)
    lookat = middle[0][:, None] * right + middle[1][:, None] * up + depth[:, None] * back
    spread = 0.0
    if len(times) > 1 and times[-1] > times[0]:
        spread = CALM / float(np.median(np.diff(times)))
        lookat = gaussian_filter1d(lookat, spread, axis=0, mode="nearest")
        distance = gaussian_filter1d(distance, spread, mode="nearest")
    off = seen - lookat[:, None]  # a calm camera comes late: it stands back until all is inside
    aside, over = np.abs(off @ right) * view.height / view.width, off @ up
    over = np.where(over < 0.0, -over / (1.0 - 2.0 * CAPTION), over)
    lack = (np.maximum(aside, over) / (INSIDE * tan) + off @ back).max(axis=1) - distance
    lack = maximum_filter1d(np.maximum(lack, 0.0), 2 * int(4.0 * spread + 0.5) + 1, mode="nearest")
    if lack.any() and spread:
        lack = gaussian_filter1d(lack, spread, mode="nearest")  # nowhere below what lacks there
    return Shot(*gaze, lookat, distance + lack)


def axes(azimuth: float, elevation: float) -> FloatArray:
    """Rows right, up and back (3, 3) of MuJoCo's camera at these angles [deg]."""
    a, e = np.deg2rad(azimuth), np.deg2rad(elevation)
    gaze = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    up = np.array([-np.sin(e) * np.cos(a), -np.sin(e) * np.sin(a), np.cos(e)])
    return np.stack([np.cross(gaze, up), up, -gaze])


def _seen(world: World, run: Run, rows: IntArray) -> FloatArray:
    """Points (N, k, 3) that must be in the picture at ``rows`` (N,) of the rollout [m]."""
    robot, rollout = world.robot, run.rollout
    origins, rotations = robot.segment_frames(rollout.q[rows])
    flange = origins[:, -1] + rotations[:, -1] @ robot.flange_translation
    tip = rollout.tool_point[rows] + 0.03 * rollout.tool_axis[rows]
    fruits = rollout.fruit_positions[rows]
    first = np.broadcast_to(rollout.fruit_positions[0], fruits.shape)
    up = np.asarray(world.scene.up)
    fruits = np.where(((first - fruits) @ up > FALLEN)[..., None], first, fruits)
    lift = 0.05 * up
    return np.concatenate([flange[:, None], tip[:, None], fruits, first, first + lift], axis=1)


def _clearest(world: World, model: Any, run: Run, rows: IntArray, shots: list[Shot]) -> int:
    """The index of the shot in which tool and target, and then fruits, are hidden least: by rays to
    eight points in the box around each of their parts. Glass of the tool hides no fruit."""
    mujoco = engine()
    data, last = mujoco.MjData(model), world.robot.n_segments - 1
    groups, drawn = (np.arange(6) == SHOWN).astype(np.uint8), model.geom_group == SHOWN
    names = [model.geom(k).name for k in range(model.ngeom)]
    tool = np.array([name.startswith(f"look:{last}:tool/") for name in names])
    if not tool.any():
        tool = drawn & (model.geom_bodyid == model.body(f"segment:{last}").id)
    glass = tool & (model.mat_rgba[model.geom_matid, 3] < 1.0)
    things = [drawn & (model.geom_bodyid == fruit.body) for fruit in world.shown]
    clear = np.array([tool, *(own | glass for own in things)])  # geoms that hide not these
    what, part = np.nonzero(np.array([tool, *things]))
    weight = np.array([WEIGHT, *(WEIGHT if f.role == "target" else 1.0 for f in world.shown)])
    weight = (weight / np.maximum(np.bincount(what, minlength=len(clear)), 1))[what].repeat(8)
    what, part = what.repeat(8), part.repeat(8)
    corners = np.array([*itertools.product((-WITHIN, WITHIN), repeat=3)] * (len(part) // 8))
    local = model.geom_aabb[part, :3] + model.geom_aabb[part, 3:] * corners
    hidden, geom, share = np.zeros(len(shots)), np.zeros(len(part), np.int32), np.zeros(len(part))
    for k in np.linspace(0, len(rows) - 1, LOOKS).astype(int):
        data.qpos[:] = run.rollout.states[rows[k]]
        mujoco.mj_kinematics(model, data)
        turned = np.einsum("pij,pj->pi", data.geom_xmat[part].reshape(-1, 3, 3), local)
        points = data.geom_xpos[part] + turned
        for one, each in enumerate(shots):
            eye = each.lookat[k] + each.distance[k] * axes(each.azimuth, each.elevation)[2]
            rays = (points - eye).ravel()
            mujoco.mj_multiRay(
                model, data, eye, rays, groups, True, -1, geom, share, None, len(part), np.inf
            )
            hit = (share >= 0.0) & (share < 1.0) & ~clear[what, geom]
            hidden[one] += weight[hit].sum()
    return int(np.argmin(hidden))


SMALL, COLOURS = (640, 360), 224  # [pixel] of an animation; its palette
ASIDE = 1.2  # [m] of an onlooker from what it looks at: a choice
VIVID = 45  # of 255, least spread of a vivid pixel's red, green and blue
VIVID_WEIGHT = 40  # times that a vivid pixel is repeated in the choice of the palette, at most
CODECS = {  # by the suffix of a film: encoder and its settings
    "webm": ("libvpx-vp9", {"crf": "37", "b": "0", "deadline": "realtime", "cpu-used": "6"}),
    "mp4": ("libx264", {"crf": "22", "preset": "veryfast"}),
}
LINGER = 1.5  # [s] that the last picture of a film stays, with the outcome
DARK, PALE, GOOD, BAD = (18, 22, 26), (240, 243, 245), (120, 214, 130), (255, 138, 122)


def frames(
    run: Run,
    times: FloatArray,
    view: View | None = None,
    *,
    caption: bool = False,
    fine: bool = True,
) -> Iterator[Image8]:
    """Pictures of a run at ``times``, each of the last record until then.

    ``times``: (N,) [s]. ``caption``: whether time, largest force so far and, from the motion's end,
    the outcome are written at the lower edge. ``fine``: whether edges are smoothed, which takes
    twice as long without a graphics card.
    """
    view = view or View()
    world = build(run.scene, run.robot, run.parameters, run.seed)
    with Studio(world, fine=fine) as studio:
        camera = shot(world, studio.model, run, times, view)
        for k, index in enumerate(_rows(run, times).tolist()):
            studio.stand(run.rollout.states[index])
            picture = studio.colours(camera.at(k), view.width, view.height)
            yield captioned(picture, run, index) if caption else picture


def _rows(run: Run, times: FloatArray) -> IntArray:
    """The last records (N,) of the rollout until ``times`` (N,) [s]; before all, the first."""
    return np.maximum(np.searchsorted(run.rollout.times, times + 1e-9) - 1, 0)


class Onlooker(Studio):
    """A camera that stands aside of a ``world``, for pictures of ``width`` x ``height`` pixels."""

    def __init__(self, world: World, width: int, height: int) -> None:
        super().__init__(world, fine=True)
        self._size = width, height
        scene = world.scene
        point, _ = world.robot.tool_pose(world.robot.home if scene.start is None else scene.start)
        middle = 0.5 * (point + (point if scene.aim is None else scene.aim))
        around = float(np.rad2deg(np.arctan2(middle[1], middle[0]))) + AROUND[0]
        self._camera = Shot(around, LEVELS[0], middle[None], np.array([ASIDE])).at(0)

    def picture(self, state: FloatArray) -> Image8:
        """The picture (height, width, 3) of a ``state`` of the world, its ``qpos``."""
        self.stand(state)
        return self.colours(self._camera, *self._size)


def encoded(pictures: Iterable[Image8], view: View, fps: int, kind: str = "webm") -> bytes:
    """Pictures as a film, the last of which stays for :data:`LINGER`.

    A ``webm`` is VP9, of the encoder libvpx (BSD). An ``mp4`` is H.264, of x264 (GPL).
    """
    check_one_of("kind of film", kind, CODECS)
    try:
        import av
    except ImportError:
        raise InvalidRequestError(
            f"a film needs PyAV: {installed_by('optipromp-sim[film]')}"
        ) from None
    buffer, last = io.BytesIO(), round(LINGER * fps)
    codec, settings = CODECS[kind]
    with av.open(buffer, mode="w", format=kind, options={"fflags": "+bitexact"}) as container:
        try:
            stream: Any = container.add_stream(codec, rate=fps)
        except ValueError:
            raise InvalidRequestError(
                f"the FFmpeg of PyAV has no encoder {codec}, of which a film .{kind} is made"
            ) from None
        stream.width, stream.height, stream.pix_fmt = view.width, view.height, "yuv420p"
        stream.options = {**settings, "threads": "1"}
        for picture in _lingering(pictures, last):
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return buffer.getvalue()


def _lingering(pictures: Iterable[Image8], more: int) -> Iterator[Image8]:
    """The pictures, and the last one so many times more."""
    last: list[Image8] = []
    for picture in pictures:
        last = [picture]
        yield picture
    yield from last * more


def gif(pictures: Sequence[Image8], fps: int) -> bytes:
    """Pictures as a GIF, the last of which stays for :data:`LINGER`."""
    from PIL import Image

    palette = Image.fromarray(_palette(pictures)).quantize(COLOURS)
    few = [
        Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
        for picture in pictures
    ]
    buffer = io.BytesIO()
    lasts = [round(1000 / fps)] * (len(few) - 1) + [round(1000 * LINGER)]
    few[0].save(
        buffer, format="GIF", save_all=True, append_images=few[1:], duration=lasts, loop=0,
        optimize=True,
    )  # fmt: skip
    return buffer.getvalue()


def _palette(pictures: Sequence[Image8]) -> Image8:
    """Pixels (k, 1, 3) to choose colours from; vivid ones (small fruits) are repeated."""
    pixels = np.concatenate([picture[::2, ::2].reshape(-1, 3) for picture in pictures[::-6]])
    vivid = pixels[np.ptp(pixels, axis=1) > VIVID]
    times = len(pixels) // max(len(vivid), 1)
    return np.concatenate([pixels, *[vivid] * min(times, VIVID_WEIGHT)])[:, None]


def moments(run: Run, fps: int, slow: float = 1.0) -> FloatArray:
    """Times of the pictures of a film (N,) [s]."""
    end = float(run.rollout.times[-1])
    return np.arange(0.0, end + 1e-9, 1.0 / (fps * slow))


def captioned(picture: Image8, run: Run, index: int, said: str = "") -> Image8:
    """The picture with a line of text at its lower edge; ``said`` is written after the force."""
    from PIL import Image, ImageDraw, ImageFont

    height, width, _ = picture.shape
    size = max(height // 26, 10)
    bar = 2 * size
    strip = np.asarray(picture[-bar:] * 0.25 + np.array(DARK) * 0.75, dtype=np.uint8)
    image = Image.fromarray(strip)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(size)
    at = 0.5 * bar
    pen.text((size, at), f"{run.rollout.times[index]:.1f} s", PALE, font, anchor="lm")
    pen.text((5 * size, at), _force_words(run, index) + said, PALE, font, anchor="lm")
    if run.rollout.times[index] >= run.rollout.motion:
        pen.text(
            (width - size, at), run.outcome.told, GOOD if run.success else BAD, font, anchor="rm"
        )
    picture[-bar:] = np.asarray(image)
    return picture


def _force_words(run: Run, index: int) -> str:
    """The largest force so far on any object but the target, and that object, in words."""
    rollout = run.rollout
    forces = rollout.fruit_force[: index + 1].max(axis=0).tolist()
    told: Iterable[tuple[str, float]] = zip(rollout.fruit_ids, forces, strict=True)
    if rollout.times[index] >= rollout.motion:  # the outcome's, which every report tells
        told = run.outcome.peak_force.items()
    peaks = [(force, name) for name, force in told if name != run.outcome.target]
    most, name = max(peaks, default=(0.0, ""))
    on = f" on {name}" if most > 0.0 else ""
    return f"largest force {most:.2f} N{on}" if name else ""


# choices for the eye
GLASS = {"target": 0.55, "pushable": 0.45}  # opacity of fruits: ellipsoids inside are seen
DEVIATIONS = 2.0  # standard deviations that an ellipsoid spans
SURE, UNSURE = (0.10, 0.35, 1.0, 0.45), (0.35, 0.35, 0.35, 0.30)  # confirmed tracks, others
PLANS = (  # of the path ahead, in turn
    (0.05, 0.45, 0.95, 1.0), (0.85, 0.10, 0.75, 1.0), (0.0, 0.62, 0.45, 1.0), (0.45, 0.25, 0.9, 1.0)
)  # fmt: skip
BACK, PASSED = (0.95, 0.50, 0.0, 1.0), (0.25, 0.25, 0.25, 0.8)
THICK, THIN = 0.0025, 0.0015  # [m] radius of the path ahead, and of that behind
SMOOTH = 80  # points of the path ahead
BEHIND = 300  # points of the path behind, at most
INSET, MARGIN = 0.40, 0.02  # side of the inset and its distance from the edge, of the height
BAR = 2.0 / 26.0  # of the height, the caption's
RECENT = 0.25  # [s] for which the detections of a look are shown
FRUIT, TARGET = (255, 240, 120), (255, 70, 70)
NEAR = 0.01  # [m] from the camera, within which no detection is drawn


def loop_frames(
    loop: Loop, times: FloatArray, view: View | None = None, *, fine: bool = True
) -> Iterator[Image8]:
    """Pictures of a pick in closed loop at ``times`` (N,) [s], each of the last record until then.

    Blue ellipsoids span two standard deviations of the positions of the confirmed tracks, grey
    ones those of the others. The line from the tool is its path ahead: its colour changes with
    every plan and is orange on a retreat; a dark line is the path behind. The inset is the view of
    the detector's camera at its last picture, with a circle around each detection in it.
    """
    view, run, record = view or View(), loop.run, record_of(loop, SMOOTH)
    world = build(run.scene, run.robot, run.parameters, run.seed)
    side = round(INSET * view.height)
    focal = 0.5 * side / math.tan(0.5 * loop.detector.view)
    lens = CameraModel(side, side, focal, focal, 0.5 * side, 0.5 * side)
    with Studio(world, fine=fine, lens=lens) as studio:
        model = studio.model
        camera = shot(world, model, run, times, view)
        top, left = _corner(loop, camera, times, view, model)
        solid, glass = model.mat_rgba.copy(), _glass(model)
        for k, (time, index) in enumerate(zip(times.tolist(), _rows(run, times), strict=True)):
            studio.stand(run.rollout.states[index])
            model.mat_rgba[:] = glass
            tracks = functools.partial(_draw, loop=loop, record=record, index=index)
            picture = studio.colours(camera.at(k), view.width, view.height, tracks)
            recent = [e for e in loop.trace.looks if time - RECENT < e.time <= time + 1e-9]
            look = recent[-1] if recent else None
            seen = index if look is None else _rows(run, np.array(look.time))
            studio.stand(run.rollout.states[seen])
            model.mat_rgba[:] = solid
            studio.aim(loop.detector.camera(run.rollout.q[seen]))
            inset = studio.colours(EYE, side, side)
            picture[top : top + side, left : left + side] = _circled(inset, lens, look)
            said = f"     {record.words(record.row(time))}"
            yield captioned(picture, run, index, said)


def _glass(model: Any) -> FloatArray:
    """Colours (M, 4) of the model's materials with fruits of glass."""
    colours: FloatArray = model.mat_rgba.copy()
    for k in range(model.nmat):  # look:SEGMENT:ROLE:ID
        for role, opacity in GLASS.items():
            if model.mat(k).name.startswith(f"look:-1:{role}:"):
                colours[k, 3] = opacity
    return colours


def _draw(scene: Any, loop: Loop, record: LoopRecord, index: int) -> None:
    """Add tracks and paths to MuJoCo's scene, at a record of the rollout."""
    mujoco, rollout = engine(), loop.run.rollout
    row = record.row(float(rollout.times[index]))
    places, covariance, confirmed = record.tracks(row)
    half, turns = ellipsoids(covariance)
    for place, size, turn, sure in zip(places, half, turns, confirmed.tolist(), strict=True):
        geom = _next(scene)
        if geom is not None:
            mujoco.mjv_initGeom(
                geom, mujoco.mjtGeom.mjGEOM_ELLIPSOID, DEVIATIONS * size, place, turn.ravel(),
                np.array(SURE if sure else UNSURE, dtype=np.float32),
            )  # fmt: skip
    rows = np.unique(np.linspace(0, index, min(index + 1, BEHIND)).astype(int))
    _line(scene, rollout.tool_point[rows], PASSED, THIN)
    colour = BACK if record.stages[row] == "leave" else PLANS[record.plans[row] % len(PLANS)]
    _line(scene, record.path(row), colour, THICK)


def _line(scene: Any, points: FloatArray, colour: tuple[float, ...], radius: float) -> None:
    mujoco = engine()
    kind, rgba = mujoco.mjtGeom.mjGEOM_CAPSULE, np.array(colour, dtype=np.float32)
    for begin, end in itertools.pairwise(points):
        if np.linalg.norm(end - begin) < 1e-5:  # [m]
            continue
        geom = _next(scene)
        if geom is None:
            return
        mujoco.mjv_initGeom(geom, kind, np.zeros(3), np.zeros(3), np.eye(3).ravel(), rgba)
        mujoco.mjv_connector(geom, kind, radius, begin, end)


def _next(scene: Any) -> Any:
    """The next free geom of MuJoCo's scene; None if it is full."""
    if scene.ngeom >= scene.maxgeom:
        return None
    scene.ngeom += 1
    geom = scene.geoms[scene.ngeom - 1]
    # mjv_initGeom leaves these as they were in memory, and pixels with them
    geom.transparent = geom.category = geom.objtype = geom.objid = geom.segid = 0
    geom.camdist = 0.0
    return geom


def _circled(picture: Image8, lens: CameraModel, look: Look | None) -> Image8:
    """The picture of a camera with a circle around each detection of a look."""
    from PIL import Image, ImageDraw, ImageFont

    side = len(picture)
    wide = max(side // 130, 1)
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    for item in () if look is None else look.detections:
        if item.position[2] <= NEAR:
            continue
        (u, v), r = lens.pixels(item.position), lens.fx * item.radius / item.position[2]
        colour = TARGET if item.role == "target" else FRUIT
        pen.ellipse((u - r, v - r, u + r, v + r), outline=colour, width=2 * wide)
    font = ImageFont.load_default(max(side // 18, 9))
    pen.text((0.03 * side, 0.97 * side), "camera", PALE, font, anchor="ld", stroke_width=wide,
             stroke_fill=DARK)  # fmt: skip
    pen.rectangle((0, 0, side - 1, side - 1), outline=PALE, width=wide)
    return np.asarray(image)


def _corner(loop: Loop, camera: Shot, times: FloatArray, view: View, model: Any) -> tuple[int, int]:
    """Row and column of the inset: of four corners that which hides tool and fruits least."""
    rollout, rows = loop.run.rollout, _rows(loop.run, times)
    points = np.concatenate([rollout.tool_point[rows][:, None], rollout.fruit_positions[rows]], 1)
    right, up, back = axes(camera.azimuth, camera.elevation)
    away = points - camera.lookat[:, None]
    depth = camera.distance[:, None] - away @ back
    scale = 0.5 * view.height / math.tan(0.5 * math.radians(model.vis.global_.fovy))
    u = 0.5 * view.width + scale * (away @ right) / depth
    v = 0.5 * view.height - scale * (away @ up) / depth
    side, edge = round(INSET * view.height), round(MARGIN * view.height)
    low = view.height - math.ceil(BAR * view.height) - edge - side
    corners = [(t, e) for t in (edge, low) for e in (edge, view.width - edge - side)]

    def hidden(corner: tuple[int, int]) -> float:
        """Pixels by which points are inside of the inset widened by a third, in sum."""
        grow = side / 3.0
        top, left = corner
        inside = np.minimum(
            0.5 * side + grow - np.abs(v - top - 0.5 * side),
            0.5 * side + grow - np.abs(u - left - 0.5 * side),
        )
        return float(np.maximum(inside, 0.0).sum())

    return min(corners, key=hidden)


def film(
    shown: Run | Loop, view: View | None = None, *, fps: int = 25, slow: float = 1.0,
    kind: str = "webm",
) -> bytes:  # fmt: skip
    """A film of a whole run or pick in closed loop, ``slow`` times slower, with a caption."""
    view = view or View()
    return encoded(_pictures(shown, view, fps, slow, fine=False), view, fps, kind)


def animation(
    shown: Run | Loop, view: View | None = None, *, fps: int = 10, slow: float = 1.0
) -> bytes:
    """A GIF of the whole, by default half as wide as a film: a GIF keeps every pixel."""
    view = view or View(*SMALL)
    return gif(list(_pictures(shown, view, fps, slow)), fps)


def _pictures(
    shown: Run | Loop, view: View, fps: int, slow: float, fine: bool = True
) -> Iterator[Image8]:
    if isinstance(shown, Loop):
        return loop_frames(shown, moments(shown.run, fps, slow), view, fine=fine)
    return frames(shown, moments(shown, fps, slow), view, caption=True, fine=fine)
