"""Films and pictures; skipped where nothing can be drawn off screen."""

import io

import numpy as np
import pytest

from optipromp.errors import InvalidRequestError
from optipromp.simulation import simulate
from optipromp.simulation.render import View, animation, film, frames, png

SMALL = View(width=160, height=120)


@pytest.fixture
def run(bench):
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    made = simulate(bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5), 1.0), scene)
    try:
        next(frames(made, np.array([0.0]), SMALL))
    except InvalidRequestError as error:
        pytest.skip(error.message)
    return made


def test_a_picture_shows_the_ripe_fruit(run):
    (picture,) = frames(run, np.array([0.0]), SMALL)
    assert picture.shape == (120, 160, 3)
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    assert ((red > 2 * green) & (red > 2 * blue)).sum() > 10
    assert png(picture).startswith(b"\x89PNG")


def test_a_film_can_be_played(run):
    import av

    content = film(run, SMALL, fps=10)
    with av.open(io.BytesIO(content)) as container:
        stream = container.streams.video[0]
        assert stream.codec_context.name == "h264"
        shown = sum(1 for _ in container.decode(stream))
    assert shown == pytest.approx(10 * run.rollout.times[-1], abs=2)


def test_an_animation_is_a_gif(run):
    from PIL import Image

    with Image.open(io.BytesIO(animation(run, SMALL, fps=5))) as image:
        assert image.format == "GIF"
        assert image.n_frames > 3
