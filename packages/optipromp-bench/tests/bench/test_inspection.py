"""inspect-robots: its own checks of what it finds of ours, and picks by its own ``eval``."""

import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("inspect_robots")

from inspect_robots import eval as evaluate
from inspect_robots.approver import ChainApprover, ClampApprover, DeltaLimitApprover
from inspect_robots.compat import check_compatibility
from inspect_robots.conformance import (
    assert_embodiment_conformant,
    assert_guardrail_contribution_conformant,
    check_embodiment,
)
from inspect_robots.mock import NoopPolicy
from inspect_robots.policy import PolicyConfig, PolicyInfo
from inspect_robots.registry import resolve
from inspect_robots.types import Action, ActionChunk

from optipromp.core.planning.task import posed
from optipromp.core.scenes.io import scene_from_dict
from optipromp_bench.episode import joints_for
from optipromp_bench.inspection import Loop, Outcome, Plant, picks

HOME = Path(__file__).resolve().parents[2]


def test_it_finds_ours_by_the_entry_points() -> None:
    stated = tomllib.loads((HOME / "pyproject.toml").read_text("utf-8"))["project"]["entry-points"]
    kinds = {"embodiment": Plant, "policy": Loop, "scorer": Outcome}
    for kind, made in kinds.items():
        assert isinstance(resolve(kind, "optipromp"), made)
        group = "inspect_robots.policies" if kind == "policy" else f"inspect_robots.{kind}s"
        assert stated[group] == {"optipromp": f"optipromp_bench.inspection:{made.__name__}"}
    task = resolve("task", "optipromp-pick", count=2)
    assert [scorer.name for scorer in task.scorers] == ["success_at_end", "optipromp"]


def test_the_plant_is_conformant_without_a_warning_and_fits_the_loop() -> None:
    plant = Plant()
    assert_embodiment_conformant(plant.info)
    assert check_embodiment(plant.info).issues == ()
    assert_guardrail_contribution_conformant(plant, plant.info.action_space)
    report = check_compatibility(Loop(), plant, picks())
    assert report.issues == []
    assert not check_compatibility(NoopPolicy(), plant, picks()).ok


class Upward:
    """The tool goes straight up through what hangs there."""

    info = PolicyInfo("upward", Plant().info.action_space)
    config = PolicyConfig()

    def reset(self, scene: Any) -> None:
        pass

    def act(self, observation: Any) -> ActionChunk:
        scene = scene_from_dict(observation.extra["scene"])
        up, q = 0.09 * scene.frame[2], observation.state["joint_pos"]
        return ActionChunk([Action(joints_for(posed(scene)[0], q, up, scene.frame[2]))])


def run(policy: Any, guard: bool, tmp_path: Path, steps: int = 1000) -> Any:
    plant = Plant()
    space = plant.info.action_space
    gates = plant.contribute_guardrails(space).approvers if guard else ()
    chain = ChainApprover(ClampApprover(space), DeltaLimitApprover(space), *(g for _, g in gates))
    task = replace(picks(preset="limp", count=1, first=200_001), max_steps=steps)
    (log,) = evaluate(task, policy, plant, approver=chain, log_dir=str(tmp_path))
    assert log.status == "success"
    return log


def test_the_loop_picks_and_is_scored(tmp_path: Path) -> None:
    log = run(Loop(), False, tmp_path)
    assert log.results.metrics == {"success_at_end": 1.0, "optipromp": 1.0}


def test_the_guard_keeps_a_policy_that_harms_from_harming(tmp_path: Path) -> None:
    """Within the first 8 s."""
    worth = [run(Upward(), guard, tmp_path, 400).results.metrics for guard in (False, True)]
    assert [each["optipromp"] for each in worth] == [-1.0, 0.0]
