"""Where a motion of the tool leaves what the models of the push know."""

import itertools

import numpy as np
import pytest

from optipromp.core.planning.task import resolve
from optipromp.core.pushing.model import Combined, Moved, PushModel
from optipromp.core.scenes.io import load_scene
from optipromp.core.scenes.scene import Scene
from optipromp_sim.generate import generate


def model_of(scene: Scene) -> PushModel:
    task = resolve(scene)
    model = task.push_model(task.start)
    assert model is not None
    return model


def led(scene: Scene, *corners: list[float]) -> tuple[Moved, np.ndarray]:
    """Through corners (x_g, y_g, z_g) from the target [m]; and where everything was perceived."""
    at = np.array(corners, dtype=float)
    pieces = [np.linspace(a, b, 60, endpoint=False) for a, b in itertools.pairwise(at)]
    points = scene.target.position + np.vstack([*pieces, at[-1:]]) @ scene.frame
    found = model_of(scene).moved(points, np.tile(scene.frame[2], (len(points), 1)))
    items = {item.id: item.position for item in scene.objects}
    return found, np.array([items[name] for name in found.ids])


@pytest.fixture(scope="module", params=["scenario-3", "shelf"])
def scene(request: pytest.FixtureRequest) -> Scene:
    name = request.param
    return load_scene(name) if name.startswith("scenario") else generate(name, 100)


def test_the_tool_moves_what_is_in_its_way_aside(scene: Scene) -> None:
    found, before = led(scene, [0.0, 0.0, -0.3], [0.0, 0.0, -0.01])
    far = np.linalg.norm(found.positions - before, axis=1)
    assert far.max() > 0.01
    assert np.isfinite(found.turns).all()


def test_combined_models_know_each_object_once(scene: Scene) -> None:
    """The last model's word counts where both know an object."""
    model = model_of(scene)
    points = scene.target.position + np.linspace(-0.3, -0.01, 60)[:, None] * scene.frame[2]
    axes = np.tile(scene.frame[2], (len(points), 1))
    one, both = model.moved(points, axes), Combined(model, model).moved(points, axes)
    assert both.ids == one.ids
    np.testing.assert_array_equal(both.positions, one.positions)
    np.testing.assert_array_equal(both.turns, one.turns)


def test_a_long_fruit_that_nothing_touches_stays() -> None:
    scene = generate("elongated", 20000)
    model = model_of(scene)
    far = model.candidates.camera + np.linspace([0.0, 0.0, -0.05], [0.0, 0.0, -0.01], 20)
    found = model.moved(far, np.tile(scene.frame[2], (20, 1)))
    by_id = {item.id: item.position for item in scene.objects}
    np.testing.assert_allclose(found.positions, [by_id[one] for one in found.ids], atol=1e-6)
