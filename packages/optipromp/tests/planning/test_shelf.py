"""Plans of a hand through packs on a shelf, as the judge sees them."""

import pytest

from optipromp.core import judging
from optipromp.core.errors import Code
from optipromp.core.planning import plan
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.scene import Scene
from optipromp_sim.generate import generate


@pytest.fixture(scope="module", params=[5, 7])
def scene(request: pytest.FixtureRequest) -> Scene:
    """Wrist or forearm end in the place of a pack."""
    return generate("shelf", request.param)


def test_a_link_where_a_pack_stood_makes_no_plan_invalid(scene: Scene) -> None:
    made = plan(scene)
    assert made.status == Code.SUCCESS, made.message
    assert not made.contacts
    again = judging.judge(made.scene, made.robot, made.trajectory, resolve(scene).state)
    assert not again.violations
    for note in again.notes:
        assert "stood" in note
        assert note in made.message
