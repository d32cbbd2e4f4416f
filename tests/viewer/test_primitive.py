"""The figure of a learnt primitive shows what was learnt."""

import numpy as np
import pytest

from optipromp.core.promp import Basis, Demonstration, Demonstrations, fit
from optipromp.looks.viewer.figures import png, primitive_figure


@pytest.mark.parametrize("joints", [1, 3, 7])
def test_a_panel_a_joint_with_every_demonstration_and_the_band(joints: int) -> None:
    rng = np.random.default_rng(0)
    names = (r"$\frac{$", *(f"q{j}" for j in range(1, joints)))
    y = rng.normal(size=(5, 1, joints)) + rng.normal(size=(5, 30, joints)).cumsum(axis=1) / 20
    demos = Demonstrations(tuple(Demonstration(np.arange(30.0), item) for item in y), names)
    promp = fit(demos, Basis(7))
    figure = primitive_figure(promp, demos)
    panels = {panel.get_title(loc="left"): panel for panel in figure.axes if panel.get_visible()}
    assert len(panels) == joints
    at = np.linspace(0.0, 1.0, 201)
    for j, name in enumerate(names):
        panel = panels[name.replace("$", r"\$")]
        *recorded, mean = panel.get_lines()
        for line, item in zip(recorded, y, strict=True):
            np.testing.assert_array_equal(line.get_ydata(), item[:, j])
        np.testing.assert_allclose(mean.get_ydata(), promp.mean_trajectory(at)[:, j])
        (band,) = panel.collections
        corners = band.get_paths()[0].vertices[:, 1]
        deviation = promp.standard_deviation(at)[:, j]
        assert corners.max() == pytest.approx(np.max(mean.get_ydata() + 2 * deviation))
        assert corners.min() == pytest.approx(np.min(mean.get_ydata() - 2 * deviation))
    assert png(figure).startswith(b"\x89PNG")
