"""Physical variations: each changes what it names, and nothing else."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from optipromp_bench.experiments.statistics import summary
from optipromp_bench.experiments.study import Study, run_study
from optipromp_bench.experiments.trials import run_trials
from optipromp_sim.generate import generate
from optipromp_sim.simulation.parameters import SimulationParameters
from optipromp_sim.situations import VARIATIONS

USUAL = SimulationParameters()
CHANGED = {
    "stems 3 times softer": {"stem.youngs_modulus", "stem.grown_turn"},
    "stems 3 times stiffer": {"stem.youngs_modulus", "stem.grown_turn"},
    "friction 0.2": {"fruit.friction", "stem.friction", "robot.tool_friction"},
    "friction 0.6": {"fruit.friction", "stem.friction", "robot.tool_friction"},
    "friction 0.8": {"fruit.friction", "stem.friction", "robot.tool_friction"},
    "stems stretch": {"stem.stretch"},
    "fruits half as heavy": {"fruit.density"},
    "fruits 1.5 times as heavy": {"fruit.density"},
    "damping × 0.2": {"stem.damping_time", "stem.swing_damping"},
    "damping × 4": {"stem.damping_time", "stem.swing_damping"},
    "fruits turn freely": {"stem.calyx"},
    "cluster 15 mm aside": {"disturbance.shift"},
    "jump 10 mm in motion": {"disturbance.jump", "disturbance.jump_at"},
    "sway 20 mm": {"disturbance.sway"},
    "arm 5 mm, 1 degree off": {"disturbance.arm_offset", "disturbance.arm_turn"},
    "commands 20 ms late": {"disturbance.command_delay"},
}


def differences(p: SimulationParameters) -> set[str]:
    return {
        f"{group.name}.{item.name}"
        for group in fields(p)
        for item in fields(getattr(p, group.name))
        if getattr(getattr(p, group.name), item.name)
        != getattr(getattr(USUAL, group.name), item.name)
    }


@pytest.mark.parametrize("name", VARIATIONS)
def test_a_variation_changes_what_it_names(name: str) -> None:
    scene = generate("mixed", 3)
    changed, _, _, p, *_ = VARIATIONS[name](scene, 0)
    if name in CHANGED or name == "as assumed":
        assert changed is scene
        assert differences(p) == CHANGED.get(name, set())
        return
    before = [item for item in scene.objects if item.stem is not None]
    after = [item for item in changed.objects if item.stem is not None]
    shift = np.array([b.position - a.position for a, b in zip(before, after, strict=True)])
    roots = np.array([b.stem.root - a.stem.root for a, b in zip(before, after, strict=True)])
    wider = np.array([b.radius / a.radius for a, b in zip(before, after, strict=True)])
    match name:
        case "fruits 10 % smaller" | "fruits 10 % larger":
            np.testing.assert_allclose(wider, 0.9 if "smaller" in name else 1.1)
            assert not shift.any()
        case "tool 5 mm off":
            np.testing.assert_allclose(np.linalg.norm(shift, axis=1), 0.005)
            np.testing.assert_allclose(shift, roots)
            np.testing.assert_allclose(shift @ scene.up, 0.0, atol=1e-12)
        case "fruits 10 mm lower":
            np.testing.assert_allclose(shift, np.tile([0.0, 0.0, -0.01], (len(shift), 1)))
            assert not roots.any()
        case _:
            assert name == "all drawn at random"
            assert len(differences(p)) == 8
            assert 0.9 <= wider.min() <= wider.max() <= 1.1
    assert [o for o in scene.objects if o.stem is None] == [
        o for o in changed.objects if o.stem is None
    ]


@pytest.mark.slow  # executes all variations
def test_one_plan_is_executed_under_every_variation_and_as_assumed_as_ever(tmp_path: Path) -> None:
    study = Study(("cluster",), ("opti-promp",), (9100, 9101), vary=True)
    rows = run_study(study, tmp_path, workers=1)
    assert [row.variation for row in rows] == list(VARIATIONS)
    assert len({(row.plan_status, row.predicted_harm) for row in rows}) == 1
    assert len({row.duration for row in rows}) <= 2  # of a reach that harms there is no way out
    assert len({row.unripe_force for row in rows}) > 5  # the physics was another each time
    alone = Study(("cluster",), ("opti-promp",))
    (usual,) = run_trials(alone, "cluster", 9100, "", ("opti-promp",), "x")
    kept = ("success", "message", "unripe_force", "target_force", "stem_force")
    assert [getattr(usual, k) for k in kept] == [getattr(rows[0], k) for k in kept]
    assert [cell.preset for cell in summary(rows)] == list(VARIATIONS)
    assert run_study(study, tmp_path, workers=1) == [
        replace(row, message=" ".join(row.message.split())) for row in rows
    ]
