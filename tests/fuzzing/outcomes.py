"""What comes of a mutant: a typed error, a plan that failed, or a success that is true."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random
from typing import Any

TIMEOUT = 1.0  # [s] of a plan


@dataclass(frozen=True)
class Mutant:
    """Files by name, and what is done with them in their folder."""

    kind: str
    files: dict[str, bytes]
    act: Callable[[Path], str]

    def run(self, folder: Path) -> str:
        """What came of it: a code, or ``success``; raises what is not typed.

        AssertionError: a result that is not valid.
        """
        from optipromp.core.errors import OptiPrompError

        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        try:
            return self.act(folder)
        except OptiPrompError as error:
            code, words = error.code, error.message
        assert words, "a refusal without words"
        return f"error {code}"


def check_plan(result: Any) -> str:
    """The status of a plan; a success is judged again, and its numbers are finite.

    One that begins at the scene's start is judged by what the trajectory alone tells, too.
    """
    from optipromp import judge
    from optipromp.core.planning import verdict_of
    from optipromp.core.trajectory import Trajectory

    assert isinstance(result.trajectory, Trajectory)  # refuses what is not finite
    assert result.message, "a plan without words"
    if not result.success:
        return f"no plan {result.status}"
    verdicts = [verdict_of(result)]
    if result.start is None:
        verdicts.append(judge(result.scene, result.trajectory, robot=result.robot))
    for again in verdicts:
        assert again.status == "success", f"a false success: {again.message}"
        assert again.prediction == result.prediction
    assert all(math.isfinite(v) for v in result.metrics.to_dict().values() if type(v) is float)
    return "success"


def planned(random: Random, scene: Any, **request: Any) -> str:
    from optipromp import PlanOptions, plan

    request = {"options": PlanOptions(timeout=TIMEOUT), "seed": 0} | request
    return check_plan(plan(scene, **request))
