"""The camera of a film: tool and fruits fill the picture, from the side that hides them least."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from optipromp.core.arrays import FloatArray, IntArray
from optipromp.laboratory.simulation.dress import SHOWN
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.execute import Run
from optipromp.laboratory.simulation.world import World

# choices for the eye
AROUND = (150.0, 210.0, 125.0, 235.0, 100.0, 260.0, 60.0, 300.0, 30.0, 330.0)  # [deg], in turn
LEVELS = (-10.0, 15.0)  # [deg] of elevation, in turn: from below, hanging fruits hide the tool less
FILLED = 1.25  # height of the picture over that of tool and fruits
CAPTION = 0.12  # share of the height that is left free for the caption
NARROWEST = 0.40  # [m] height of the picture, at least
CALM = 0.6  # [s] standard deviation of the filter that smooths the camera's motion
FALLEN = 0.2  # [m] a fruit that has fallen by more is no longer kept in the picture
INSIDE = 0.95  # share of the picture that holds tool and fruits
LOOKS = 24  # moments at which an azimuth is tried
WEIGHT = 4.0  # of a moment at which tool or target are hidden, over that of another fruit


@dataclass(frozen=True)
class View:
    """The place of the camera.

    Attributes:
        azimuth: of the camera's gaze about the vertical [deg]; None: that of several around the
            fruits at which tool and fruits are hidden least.
        elevation: of the camera's gaze, negative downwards [deg]; None: chosen in the same way.
        distance: from the middle of the picture [m]; None: so that fruits and tool fill it.
        width, height: [pixel].
    """

    azimuth: float | None = None
    elevation: float | None = None
    distance: float | None = None
    width: int = 1280
    height: int = 720


@dataclass(frozen=True, eq=False)
class Shot:
    """The camera over time, at N moments.

    Attributes:
        azimuth, elevation: [deg].
        lookat: (N, 3) [m].
        distance: (N,) [m].
    """

    azimuth: float
    elevation: float
    lookat: FloatArray
    distance: FloatArray

    def at(self, index: int) -> Any:
        """MuJoCo's camera."""
        mujoco = engine()
        camera = mujoco.MjvCamera()
        camera.lookat[:], camera.distance = self.lookat[index], self.distance[index]
        camera.azimuth, camera.elevation = self.azimuth, self.elevation
        return camera


def shot(world: World, model: Any, run: Run, times: FloatArray, view: View) -> Shot:
    """The camera of a run at ``times`` (N,) [s]; its motion is smooth.

    The picture holds the tool from flange to tip, and targets and pushables with the lower ends of
    their stems, at all times. A fruit that falls is not followed.
    """
    rows = np.maximum(np.searchsorted(run.rollout.times, times + 1e-9) - 1, 0)
    seen, tan = _seen(world, run, rows), float(np.tan(0.5 * np.deg2rad(model.vis.global_.fovy)))
    focus = run.rollout.fruit_positions[0] if world.shown else run.rollout.tool_point[-1:]
    x, y, _ = focus.mean(axis=0)
    heading = float(np.rad2deg(np.arctan2(y, x)))
    around = [heading + turn for turn in AROUND] if view.azimuth is None else [view.azimuth]
    heights = LEVELS if view.elevation is None else (view.elevation,)
    shots = [_shot((turn, over), seen, times, view, tan) for over in heights for turn in around]
    return shots[_clearest(world, model, run, rows, shots)] if len(shots) > 1 else shots[0]


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
    if view.distance is not None:
        return Shot(*gaze, lookat, np.full(len(times), view.distance))
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
    """The index of the shot in which tool and target, and then fruits, are hidden least."""
    mujoco = engine()
    data, rollout = mujoco.MjData(model), run.rollout
    groups = np.zeros(6, dtype=np.uint8)
    groups[SHOWN] = 1
    tool = {model.body(f"segment:{world.robot.n_segments - 1}").id}
    if world.robot.tool is not None:
        tool.add(model.body("tool").id)
    hidden = np.zeros(len(shots))
    geom = np.zeros(1, dtype=np.int32)
    for k in np.linspace(0, len(rows) - 1, LOOKS).astype(int):
        row = rows[k]
        data.qpos[:] = rollout.states[row]
        mujoco.mj_kinematics(model, data)
        points = [(rollout.tool_point[row], tool, WEIGHT)]
        for index, fruit in enumerate(world.shown):
            weight = WEIGHT if fruit.role == "target" else 1.0
            points.append((rollout.fruit_positions[row, index], {fruit.body, *tool}, weight))
        for one, each in enumerate(shots):
            back = axes(each.azimuth, each.elevation)[2]
            eye = each.lookat[k] + each.distance[k] * back
            for point, mine, weight in points:
                share = mujoco.mj_ray(model, data, eye, point - eye, groups, 1, -1, geom)
                if 0.0 <= share < 1.0 and int(model.geom_bodyid[geom[0]]) not in mine:
                    hidden[one] += weight
    return int(np.argmin(hidden))
