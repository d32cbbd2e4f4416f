"""A run while it goes on: what was harmed so far, and what the tool holds."""

from dataclasses import dataclass

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray
from optipromp.laboratory.simulation.contacts import ContactLog
from optipromp.laboratory.simulation.world import World

BARE = 0.02  # [m] without a tool, an object this near the tool point counts as picked: a choice


@dataclass(frozen=True)
class HarmSoFar:
    """What was harmed so far; each share is 1 where the thing bears no more."""

    fruit: float = 0.0  # largest force on a fruit over what it bears
    stem: float = 0.0  # longest time for which a stem was pressed over what it bears
    static: float = 0.0  # largest force on a static object over what counts as a contact
    torn: int = 0  # number of fruits that came off
    swallowed: int = 0  # number of other fruits that the tool keeps; an episode counts them

    @property
    def worst(self) -> float:
        """The largest share; at least 1 where a fruit came off or was swallowed."""
        return max(self.fruit, self.stem, self.static, float(self.torn + self.swallowed))

    @property
    def done(self) -> bool:
        """Whether the pick can no longer be clean."""
        return max(self.fruit, self.stem, self.static) > 1.0 or self.torn + self.swallowed > 0


def harm_so_far(world: World, log: ContactLog, torn: int) -> HarmSoFar:
    """The harm of a run by its contacts, as the judgement at the end counts them."""
    limits, entities = world.parameters.thresholds, world.entities
    robot = [k for k, each in enumerate(entities) if each.kind in ("link", "tool")]
    fruits = [fruit.entity for fruit in world.shown]
    stems = [fruit.stem_entity for fruit in world.shown if fruit.stem_entity >= 0]
    static = [k for k, each in enumerate(entities) if each.kind == "static"]
    return HarmSoFar(
        _most(log.peak[fruits]) / limits.fruit_force,
        _most(log.hard[np.ix_(stems, robot)]) / limits.stem_time,
        _most(log.peak[np.ix_(static, robot)]) / limits.static_force,
        torn,
    )


def _most(values: FloatArray) -> float:
    return float(values.max()) if values.size else 0.0


def in_tool(world: World, q: FloatArray, centers: FloatArray) -> BoolArray:
    """Whether the tool holds an object, or, without a tool, the object is near the tool point.

    ``world``: with the robot and its tool. ``q``: (R, n) configurations of the joints. ``centers``:
    (R, 3) positions of the object's centre at these [m].

    Returns: (R,).
    """
    robot = world.robot
    points, _ = robot.tool_pose(q)
    away, tool = centers - points, robot.tool
    if tool is None:
        return np.asarray(np.linalg.norm(away, axis=1) < BARE)
    _, turns = robot.segment_frames(q)
    local = np.einsum("rij,ri->rj", turns[:, -1] @ robot.flange_rotation @ tool.rotation, away)
    below = np.array([0.0, 0.0, world.parameters.thresholds.inside_margin])
    return tool.holds(local) & tool.holds(local + below)
