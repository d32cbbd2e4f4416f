"""Films and pictures."""

import io

import mujoco
import numpy as np
import pytest
from tests.simulation.bench import Bench

from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning import plan
from optipromp.core.scenes.scene import SceneObject
from optipromp_eyes.pictures import png_file
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate
from optipromp_sim.simulation.film import LINGER, View, axes, film, frames, moments, shot
from optipromp_sim.simulation.studio import SHOWN, dressed
from optipromp_sim.simulation.world import build

SMALL = View(width=160, height=120)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    bench = Bench(tmp_path_factory.mktemp("bench"))
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)))
    return simulate(bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5), 1.0), scene)


def test_a_picture_shows_the_ripe_fruit(run):
    (picture,) = frames(run, np.array([0.0]), SMALL)
    assert picture.shape == (120, 160, 3)
    red, green, blue = (picture[..., i].astype(int) for i in range(3))
    assert ((red > 2 * green) & (red > 2 * blue)).sum() > 10
    assert png_file(picture).startswith(b"\x89PNG")


@pytest.mark.parametrize(("kind", "codec"), [("webm", "vp9"), ("mp4", "h264")])
def test_a_film_can_be_played(run, kind, codec):
    import av

    content = film(run, SMALL, fps=10, **({} if kind == "webm" else {"kind": kind}))
    with av.open(io.BytesIO(content)) as container:
        assert kind in container.format.name
        stream = container.streams.video[0]
        assert stream.codec_context.name.removeprefix("lib") in (codec, f"vpx-{codec}")
        shown = [frame.to_ndarray(format="rgb24") for frame in container.decode(stream)]
        assert (stream.width, stream.height) == (160, 120)
    assert len(shown) == len(moments(run, 10)) + round(10 * LINGER)
    (first,) = frames(run, np.array([0.0]), SMALL, caption=True, fine=False)
    assert np.abs(shown[0].astype(int) - first).mean() < 8.0  # of 255
    assert (View().width, View().height) == (1280, 720)


def test_a_film_without_a_wish_needs_no_encoder_under_the_gpl(run, monkeypatch):
    import av

    asked, add = [], av.container.OutputContainer.add_stream

    class Container:
        def __init__(self, container):
            self.container = container

        def __enter__(self):
            return self

        def __exit__(self, *error):
            self.container.close()

        def mux(self, packet):
            self.container.mux(packet)

        def add_stream(self, codec, **options):
            asked.append(codec)
            if codec == "libx264":
                raise av.codec.codec.UnknownCodecError(codec)
            return add(self.container, codec, **options)

    opened = av.open
    monkeypatch.setattr(av, "open", lambda *a, **k: Container(opened(*a, **k)))
    assert film(run, SMALL, fps=2)[:4] == b"\x1a\x45\xdf\xa3"
    assert asked == ["libvpx-vp9"]
    with pytest.raises(InvalidRequestError, match=r"no encoder libx264.* \.mp4"):
        film(run, SMALL, fps=2, kind="mp4")
    with pytest.raises(InvalidRequestError, match="kind of film is 'avi': valid are webm, mp4"):
        film(run, SMALL, kind="avi")


def test_the_caption_tells_the_outcome_at_the_end(run):
    end = run.rollout.times[[0, -1]]
    bare, told = ([*frames(run, end, SMALL, caption=each)] for each in (False, True))
    for k in (0, 1):
        np.testing.assert_array_equal(bare[k][:90], told[k][:90])
    bars = [picture[100:, 60:].astype(int) for picture in told]  # beside time and force
    green = [int((bar[..., 1] > bar[..., 0] + 60).sum()) for bar in bars]
    assert run.success
    assert green[0] == 0 < green[1]


def test_what_is_shown_moves_and_weighs_as_what_is_simulated(run):
    world = build(run.scene, run.robot)
    model = dressed(build(run.scene, run.robot))
    for name in ("nq", "nv", "nbody"):
        assert getattr(model, name) == getattr(world.model, name)
    np.testing.assert_array_equal(model.body_mass, world.model.body_mass)
    np.testing.assert_array_equal(model.body_inertia, world.model.body_inertia)
    looks = [k for k in range(model.ngeom) if model.geom(k).name.startswith("look:")]
    assert looks
    assert not model.geom_contype[looks].any()
    assert not model.geom_conaffinity[looks].any()
    shown = {model.geom(k).name for k in np.flatnonzero(model.geom_group == SHOWN)}
    assert "fruit:ripe" not in shown
    assert {"look:-1:target:ripe", "look:-1:calyx:ripe", "stem:ripe:0"} <= shown


def looked(made, fps):
    """The shot of a film, and at each moment the tool point and the fruits."""
    world = build(made.scene, made.robot)
    model, times = dressed(world), moments(made, fps)
    camera = shot(world, model, made, times, View())
    rows = np.maximum(np.searchsorted(made.rollout.times, times + 1e-9) - 1, 0)
    points = [made.rollout.tool_point[rows, None], made.rollout.fruit_positions[rows]]
    return world, model, camera, rows, np.concatenate(points, axis=1)


def assert_inside(model, camera, points):
    """Points (N, k, 3), of which the first is the tool's, are in the picture of each moment."""
    right, up, back = axes(camera.azimuth, camera.elevation)
    tan = np.tan(0.5 * np.deg2rad(model.vis.global_.fovy))
    away = points - camera.lookat[:, None]
    depth = camera.distance[:, None] - away @ back
    assert (np.abs(away @ up) < tan * depth).all()
    assert (np.abs(away @ right) < tan * depth * 16.0 / 9.0).all()
    caption = -(1.0 - 4.0 / 26.0) * tan * depth[:, 0]
    assert (away[:, 0] @ up > caption).all()  # the tool point is above the caption


@pytest.mark.parametrize("name", ["scenario-4", "table-top", "field"])
def test_tool_and_fruits_stay_in_the_picture(name):
    made = simulate(plan(name if name == "scenario-4" else generate(name, 3)))
    world, model, camera, rows, points = looked(made, 5)
    assert_inside(model, camera, points)
    assert np.abs(np.diff(camera.distance)).max() < 0.2  # it moves calmly
    data, geom = mujoco.MjData(model), np.zeros(1, dtype=np.int32)
    groups = (np.arange(6) == SHOWN).astype(np.uint8)
    target = made.rollout.fruit_ids.index(made.outcome.target)
    own = {model.body(f"segment:{world.robot.n_segments - 1}").id, model.body("tool").id}
    own.add(world.shown[target].body)
    back = axes(camera.azimuth, camera.elevation)[2]
    for k, row in enumerate(rows):
        data.qpos[:] = made.rollout.states[row]
        mujoco.mj_kinematics(model, data)
        eye = camera.lookat[k] + camera.distance[k] * back
        for point in (points[k, 0], points[k, 1 + target]):
            share = mujoco.mj_ray(model, data, eye, point - eye, groups, 1, -1, geom)
            seen = not 0.0 <= share < 1.0 or int(model.geom_bodyid[geom[0]]) in own
            assert seen, (k, model.geom(int(geom[0])).name)


def test_the_camera_does_not_follow_a_fruit_that_falls(bench):
    loose = SceneObject("loose", "pushable", Sphere(0.015), np.array([0.1, 0.0, 0.6]))
    scene = bench.scene(bench.fruit("ripe", (0.0, 0.0, 0.5)), loose)
    made = simulate(bench.line((0.0, 0.0, 0.3), (0.0, 0.0, 0.5), 1.0), scene)
    assert made.rollout.fruit_positions[-1, :, 2].min() < -0.4
    world = build(made.scene, made.robot)
    camera = shot(world, dressed(world), made, moments(made, 5), View())
    assert np.ptp(camera.lookat[:, 2]) < 0.2
    assert camera.distance.max() < 2.0 * camera.distance[0]
