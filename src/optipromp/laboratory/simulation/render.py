"""Pictures and films of a run, off screen."""

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.shown import suggest
from optipromp.laboratory.simulation.camera import AROUND, LEVELS, View, shot
from optipromp.laboratory.simulation.dress import dressed
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.execute import Run
from optipromp.laboratory.simulation.world import World, build

__all__ = ["View", "animation", "film", "frames", "moments", "png"]

SMALL = 640, 360  # [pixel] of an animation
ASIDE = 1.2  # [m] of an onlooker from what it looks at: a choice
VIVID = 45  # of 255, least spread of a vivid pixel's red, green and blue
VIVID_WEIGHT = 40  # times that a vivid pixel is repeated in the choice of the palette, at most
CODECS = {  # by the suffix of a film: encoder and its settings
    "webm": ("libvpx-vp9", {"crf": "37", "b": "0", "deadline": "realtime", "cpu-used": "6"}),
    "mp4": ("libx264", {"crf": "22", "preset": "veryfast"}),
}
LINGER = 1.5  # [s] that the last picture of a film stays, with the outcome
DARK, PALE, GOOD, BAD = (18, 22, 26), (240, 243, 245), (120, 214, 130), (255, 138, 122)

Picture = NDArray[np.uint8]  # (height, width, 3)


def frames(
    run: Run,
    times: FloatArray,
    view: View | None = None,
    *,
    caption: bool = False,
    fine: bool = True,
) -> Iterator[Picture]:
    """Pictures of a run at ``times``, each of the last record until then.

    ``run``: to be shown. ``times``: (N,) [s]. ``view``: place of the camera. ``caption``: whether
    time, largest force so far and, from the motion's end, the outcome are written at the lower
    edge. ``fine``: whether edges are smoothed, which takes twice as long without a graphics card.
    """
    view = view or View()
    world = build(run.scene, run.robot, run.parameters, run.seed)
    model = dressed(world)
    model.vis.quality.offsamples = 4 if fine else 0
    data = engine().MjData(model)
    renderer = canvas(model, view.width, view.height)
    camera = shot(world, model, run, times, view)
    with renderer:
        for k, time in enumerate(times):
            index = max(int(np.searchsorted(run.rollout.times, time + 1e-9) - 1), 0)
            picture = _drawn(renderer, model, data, run.rollout.states[index], camera.at(k))
            yield captioned(picture, run, index) if caption else picture


def _drawn(renderer: Any, model: Any, data: Any, state: FloatArray, camera: Any) -> Picture:
    data.qpos[:] = state
    engine().mj_kinematics(model, data)
    engine().mj_camlight(model, data)
    renderer.update_scene(data, camera)
    return np.array(renderer.render())


class Onlooker:
    """A camera that stands aside of a ``world``, for pictures of ``width`` x ``height`` pixels."""

    def __init__(self, world: World, width: int, height: int) -> None:
        model = dressed(replace(world, spec=world.spec.copy()))
        self._renderer, self._camera = canvas(model, width, height), engine().MjvCamera()
        self._drawn = model, engine().MjData(model)
        scene = world.scene
        point, _ = world.robot.tool_pose(world.robot.home if scene.start is None else scene.start)
        middle = 0.5 * (point + (point if scene.aim is None else scene.aim))
        self._camera.lookat[:], self._camera.distance = middle, ASIDE
        self._camera.azimuth = np.rad2deg(np.arctan2(middle[1], middle[0])) + AROUND[0]
        self._camera.elevation = LEVELS[0]

    def picture(self, state: FloatArray) -> Picture:
        """The picture (height, width, 3) of a ``state`` of the world, its ``qpos``."""
        return _drawn(self._renderer, *self._drawn, state, self._camera)

    def close(self) -> None:
        """Give the renderer back."""
        self._renderer.close()


def canvas(model: Any, width: int, height: int) -> Any:
    """MuJoCo's renderer of pictures of ``width`` x ``height`` pixels."""
    try:
        return engine().Renderer(model, height=height, width=width)
    except Exception as error:  # whatever the platform's OpenGL raises
        raise InvalidRequestError(
            f"MuJoCo cannot draw off screen ({error}); on Linux it needs libEGL (Debian: "
            "apt-get install libegl1), or set MUJOCO_GL"
        ) from None


def film(
    run: Run, view: View | None = None, *, fps: int = 25, slow: float = 1.0, kind: str = "webm"
) -> bytes:
    """A film of the whole run, ``slow`` times slower, with a caption."""
    view, times = view or View(), moments(run, fps, slow)
    return encoded(frames(run, times, view, caption=True, fine=False), view, fps, kind)


def encoded(pictures: Iterable[Picture], view: View, fps: int, kind: str = "webm") -> bytes:
    """Pictures as a film, the last of which stays for :data:`LINGER`.

    A ``webm`` is VP9, of the encoder libvpx (BSD). An ``mp4`` is H.264, of x264 (GPL).
    """
    if kind not in CODECS:
        raise InvalidRequestError(f"kind of film is {kind!r}: {suggest(kind, CODECS)}")
    try:
        import av
    except ImportError:
        raise InvalidRequestError(f"a film needs PyAV: {installed_by('sim')}") from None
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


def _lingering(pictures: Iterable[Picture], more: int) -> Iterator[Picture]:
    """The pictures, and the last one so many times more."""
    last: list[Picture] = []
    for picture in pictures:
        last = [picture]
        yield picture
    yield from last * more


def animation(
    run: Run, view: View | None = None, *, fps: int = 10, slow: float = 1.0, colours: int = 224
) -> bytes:
    """A GIF of the whole run, by default half as wide as a film: a GIF keeps every pixel."""
    view = view or View(width=SMALL[0], height=SMALL[1])
    return gif(list(frames(run, moments(run, fps, slow), view, caption=True)), fps, colours)


def gif(pictures: Sequence[Picture], fps: int, colours: int = 224) -> bytes:
    """Pictures as a GIF, the last of which stays for :data:`LINGER`."""
    from PIL import Image

    palette = Image.fromarray(_palette(pictures)).quantize(colours)
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


def _palette(pictures: Sequence[Picture]) -> Picture:
    """Pixels (k, 1, 3) to choose colours from; vivid ones (small fruits) are repeated."""
    pixels = np.concatenate([picture[::2, ::2].reshape(-1, 3) for picture in pictures[::-6]])
    vivid = pixels[np.ptp(pixels, axis=1) > VIVID]
    times = len(pixels) // max(len(vivid), 1)
    return np.concatenate([pixels, *[vivid] * min(times, VIVID_WEIGHT)])[:, None]


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


def captioned(picture: Picture, run: Run, index: int, said: str = "") -> Picture:
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
    others = [k for k, name in enumerate(rollout.fruit_ids) if name != run.outcome.target]
    if not others:
        return ""
    peaks = rollout.fruit_force[: index + 1, others].max(axis=0)
    most = int(np.argmax(peaks))
    on = f" on {rollout.fruit_ids[others[most]]}" if peaks[most] > 0.0 else ""
    return f"largest force {peaks[most]:.2f} N{on}"
