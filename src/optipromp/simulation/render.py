"""Pictures and films of a run, off screen."""

import io
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optipromp.arrays import FloatArray
from optipromp.errors import InvalidRequestError
from optipromp.simulation.engine import engine
from optipromp.simulation.execute import Run
from optipromp.simulation.world import World, build

SMALL = (480, 360)  # [pixel] of an animation

Picture = NDArray[np.uint8]  # (height, width, 3)


@dataclass(frozen=True)
class View:
    """Where to look from.

    Attributes:
        azimuth: of the camera's gaze about the vertical [deg].
        elevation: below the horizon negative [deg].
        distance: from the middle of the picture [m]; None: so that fruits and tool fill it.
        width, height: [pixel].
    """

    azimuth: float = 150.0
    elevation: float = -8.0
    distance: float | None = None
    width: int = 960
    height: int = 720


def frames(run: Run, times: FloatArray, view: View | None = None) -> Iterator[Picture]:
    """Pictures of a run at ``times`` [s], each the record before it.

    Raises:
        InvalidRequestError: MuJoCo is not installed, or cannot draw off screen.
    """
    view = view or View()
    mujoco = engine()
    world = build(run.scene, run.robot, run.parameters, run.seed)
    model = world.model
    data = mujoco.MjData(model)
    _dress(model, mujoco)
    camera = _camera(mujoco, world, run, view)
    try:
        renderer = mujoco.Renderer(model, height=view.height, width=view.width)
    except Exception as error:  # whatever the platform's OpenGL raises
        raise InvalidRequestError(
            f"MuJoCo cannot draw off screen ({error}); on Linux it needs libEGL (Debian: "
            "apt-get install libegl1), or set MUJOCO_GL"
        ) from None
    with renderer:
        for time in times:
            index = int(np.searchsorted(run.rollout.times, time + 1e-9) - 1)
            data.qpos[:] = run.rollout.states[max(index, 0)]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera)
            yield renderer.render().copy()


def film(run: Run, view: View | None = None, *, fps: int = 30, slow: float = 1.0) -> bytes:
    """An MP4 (H.264) of the whole run, ``slow`` times slower.

    Raises:
        InvalidRequestError: MuJoCo or PyAV is not installed, or nothing can be drawn.
    """
    try:
        import av
    except ImportError:
        raise InvalidRequestError("a film needs PyAV: pip install 'optipromp[sim]'") from None
    view = view or View()
    buffer = io.BytesIO()
    with av.open(buffer, mode="w", format="mp4") as container:
        stream: Any = container.add_stream("libx264", rate=fps)
        stream.width, stream.height, stream.pix_fmt = view.width, view.height, "yuv420p"
        stream.options = {"crf": "22", "preset": "veryfast", "threads": "1"}
        for picture in frames(run, moments(run, fps, slow), view):
            for packet in stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return buffer.getvalue()


def animation(
    run: Run, view: View | None = None, *, fps: int = 10, slow: float = 1.0, colours: int = 96
) -> bytes:
    """A GIF of the whole run, by default half as wide as a film: a GIF keeps every pixel."""
    from PIL import Image

    view = view or View(width=SMALL[0], height=SMALL[1])
    pictures = [Image.fromarray(picture) for picture in frames(run, moments(run, fps, slow), view)]
    palette = pictures[len(pictures) // 2].quantize(colours)
    few = [picture.quantize(colours, palette=palette) for picture in pictures]
    buffer = io.BytesIO()
    few[0].save(
        buffer, format="GIF", save_all=True, append_images=few[1:], duration=round(1000 / fps),
        loop=0, optimize=True,
    )  # fmt: skip
    return buffer.getvalue()


def png(picture: Picture) -> bytes:
    """A picture as a PNG file."""
    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(picture).save(buffer, format="PNG")
    return buffer.getvalue()


def moments(run: Run, fps: int, slow: float = 1.0) -> FloatArray:
    """Times of the pictures of a film (N,) [s]."""
    end = float(run.rollout.times[-1])
    return np.arange(0.0, end + 1e-9, 1.0 / (fps * slow))


def _dress(model: Any, mujoco: Any) -> None:
    """Soft light, fine edges."""
    model.vis.headlight.ambient[:] = 0.45
    model.vis.headlight.diffuse[:] = 0.25
    model.vis.map.znear = 0.01
    model.vis.quality.offsamples = 4
    model.vis.quality.shadowsize = 1024


def _camera(mujoco: Any, world: World, run: Run, view: View) -> Any:
    """A camera that looks across the approach direction at the fruits and where the tool comes."""
    camera = mujoco.MjvCamera()
    mujoco.mjv_defaultFreeCamera(world.model, camera)
    start = run.rollout.fruit_positions[0].reshape(-1, 3)
    roots = [fruit.built.nodes[0] for fruit in world.shown if fruit.built.has_stem]
    seen = np.vstack([run.rollout.tool_point[[-1]], *([start] if len(start) else []), *roots])
    low, high = seen.min(axis=0), seen.max(axis=0)
    camera.lookat[:] = 0.5 * (low + high) - np.array([0.0, 0.0, 0.05])
    camera.distance = view.distance or 1.3 * float(np.linalg.norm(high - low)) + 0.45
    camera.azimuth, camera.elevation = view.azimuth, view.elevation
    return camera
