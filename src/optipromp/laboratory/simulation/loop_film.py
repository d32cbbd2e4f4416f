"""Films of picks in closed loop: tracks, paths, and what the camera at the tool sees."""

import itertools
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from optipromp.control.look import Look
from optipromp.core.arrays import FloatArray
from optipromp.core.scenes.pose import Pose
from optipromp.laboratory.simulation.camera import Shot, View, axes, shot
from optipromp.laboratory.simulation.dress import dressed
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.files import LoopRecord, ellipsoids, record_of
from optipromp.laboratory.simulation.loop import Loop
from optipromp.laboratory.simulation.render import (
    SMALL,
    Picture,
    canvas,
    captioned,
    encoded,
    gif,
    moments,
)
from optipromp.laboratory.simulation.world import build

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
FRUIT, TARGET, RING = (255, 240, 120), (255, 70, 70), (240, 243, 245)
NEAR = 0.01  # [m] from the camera, within which nothing is drawn


def loop_frames(
    loop: Loop, times: FloatArray, view: View | None = None, *, fine: bool = True
) -> Iterator[Picture]:
    """Pictures of a pick in closed loop at ``times`` (N,) [s], each of the last record until then.

    Blue ellipsoids span two standard deviations of the positions of the confirmed tracks, grey
    ones those of the others. The line from the tool is its path ahead: its colour changes with
    every plan and is orange on a retreat; a dark line is the path behind. The inset is the view of
    the detector's camera at its last picture, with a circle around each detection in it.
    """
    view, run, record = view or View(), loop.run, record_of(loop, SMOOTH)
    mujoco = engine()
    world = build(run.scene, run.robot, run.parameters, run.seed)
    model = dressed(world)
    model.vis.quality.offsamples = 4 if fine else 0
    data = mujoco.MjData(model)
    camera = shot(world, model, run, times, view)
    top, left = _corner(loop, camera, times, view, model)
    solid, glass = model.mat_rgba.copy(), _glass(model)
    side = round(INSET * view.height)
    with (
        canvas(model, view.width, view.height) as main,
        canvas(model, side, side) as small,
    ):
        for k, time in enumerate(times.tolist()):
            index = _index(loop, time)
            _stand(model, data, loop, index)
            model.mat_rgba[:] = glass
            main.update_scene(data, camera.at(k))
            _draw(main.scene, loop, record, index)
            picture = main.render().copy()
            look = _last(loop, time)
            seen = index if look is None else _index(loop, look.time)
            _stand(model, data, loop, seen)
            model.mat_rgba[:] = solid
            small.update_scene(data)
            pose = loop.detector.camera(run.rollout.q[seen])
            _look_from(small.scene, pose, loop.detector.view)
            picture[top : top + side, left : left + side] = _circled(small.render(), loop, look)
            said = f"     {record.words(record.row(time))}"
            yield captioned(picture, run, index, said)


def loop_film(
    loop: Loop, view: View | None = None, *, fps: int = 25, slow: float = 1.0, kind: str = "webm"
) -> bytes:
    """A film of a pick in closed loop, ``slow`` times slower; see :func:`loop_frames`."""
    view, times = view or View(), moments(loop.run, fps, slow)
    return encoded(loop_frames(loop, times, view, fine=False), view, fps, kind)


def loop_animation(
    loop: Loop, view: View | None = None, *, fps: int = 10, slow: float = 1.0, colours: int = 224
) -> bytes:
    """A GIF of a pick in closed loop, by default half as wide as a film."""
    view = view or View(width=SMALL[0], height=SMALL[1])
    return gif(list(loop_frames(loop, moments(loop.run, fps, slow), view)), fps, colours)


def _glass(model: Any) -> FloatArray:
    """Colours (M, 4) of the model's materials with fruits of glass."""
    colours: FloatArray = model.mat_rgba.copy()
    for k in range(model.nmat):  # look:SEGMENT:ROLE:ID
        for role, opacity in GLASS.items():
            if model.mat(k).name.startswith(f"look:-1:{role}:"):
                colours[k, 3] = opacity
    return colours


def _index(loop: Loop, time: float) -> int:
    """The last record of the rollout until a time [s]; the first before."""
    return max(int(np.searchsorted(loop.run.rollout.times, time + 1e-9) - 1), 0)


def _stand(model: Any, data: Any, loop: Loop, index: int) -> None:
    """Bring everything to its place in a record of the rollout."""
    data.qpos[:] = loop.run.rollout.states[index]
    engine().mj_kinematics(model, data)
    engine().mj_camlight(model, data)


def _last(loop: Loop, time: float) -> Look | None:
    """The last look whose picture was taken until a time [s]; None if that was long ago."""
    recent = [each for each in loop.trace.looks if time - RECENT < each.time <= time + 1e-9]
    return recent[-1] if recent else None


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
    colour = BACK if record.stages[row] == "retreat" else PLANS[record.plans[row] % len(PLANS)]
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
    return scene.geoms[scene.ngeom - 1]


def _look_from(scene: Any, pose: Pose, view: float) -> None:
    """Move the cameras of MuJoCo's scene to a pose, whose z points forward and y down."""
    high = NEAR * math.tan(0.5 * view)
    for camera in scene.camera:
        camera.pos[:] = pose.position
        camera.forward[:], camera.up[:] = pose.rotation[:, 2], -pose.rotation[:, 1]
        camera.frustum_center = camera.frustum_width = 0.0
        camera.frustum_bottom, camera.frustum_top = -high, high
        camera.frustum_near = NEAR
    for light in scene.lights[: scene.nlight]:
        if light.headlight:
            light.pos[:], light.dir[:] = pose.position, pose.rotation[:, 2]


def _circled(picture: Picture, loop: Loop, look: Look | None) -> Picture:
    """The camera's picture with a circle around each detection of a look."""
    from PIL import Image, ImageDraw, ImageFont

    side = len(picture)
    wide = max(side // 130, 1)
    image = Image.fromarray(picture)
    pen = ImageDraw.Draw(image)
    scale = 0.5 * side / math.tan(0.5 * loop.detector.view)
    for item in () if look is None else look.detections:
        x, y, z = item.position
        if z <= NEAR:
            continue
        u, v, r = (0.5 * side + scale * x / z, 0.5 * side + scale * y / z, scale * item.radius / z)
        colour = TARGET if item.role == "target" else FRUIT
        pen.ellipse((u - r, v - r, u + r, v + r), outline=colour, width=2 * wide)
    font = ImageFont.load_default(max(side // 18, 9))
    pen.text((0.03 * side, 0.97 * side), "camera", RING, font, anchor="ld", stroke_width=wide,
             stroke_fill=(18, 22, 26))  # fmt: skip
    pen.rectangle((0, 0, side - 1, side - 1), outline=RING, width=wide)
    return np.asarray(image)


def _corner(loop: Loop, camera: Shot, times: FloatArray, view: View, model: Any) -> tuple[int, int]:
    """Row and column of the inset: of four corners that which hides tool and fruits least."""
    rollout = loop.run.rollout
    rows = np.maximum(np.searchsorted(rollout.times, times + 1e-9) - 1, 0)
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
