"""Where a scissor cuts: on the target's stem, a distance above the fruit."""

from dataclasses import replace

import numpy as np

from optipromp.core.geometry import distances, pack
from optipromp.core.pushing.path import evenly
from optipromp.core.robots.grippers import Scissor
from optipromp.core.robots.mounted import unmounted
from optipromp.core.robots.tool_protocol import Tool
from optipromp.core.scenes.scene import Scene

ALONG = 0.0005  # [m] chosen: between points of a stem, half of the judge's tolerance of a goal


def aimed_at_stem(scene: Scene, tool: Tool | None) -> Scene:
    """The scene whose approach ends on the target's stem, if the ``tool`` is a scissor.

    The place is the lowest one that is ``cut`` from the fruit; of a stem that is nowhere twice as
    far from the fruit, half of the way to its farthest place. The axis of the approach and the
    place of its end do not vary where the scene states no cone and no lateral distance: turned
    about the stem, the blades would meet the fruit. An approach whose ``shift`` is stated stays as
    it is.
    """
    target, blades, approach = scene.target, unmounted(tool), scene.approach
    if target is None or target.stem is None or not isinstance(blades, Scissor):
        return scene
    if approach.shift.any():
        return scene
    points = evenly(target.stem.points, int(np.ceil(target.stem.length / ALONG)) + 1)
    far, _ = distances(pack([(target.shape, target.position, target.rotation)]), points)
    above = points[int(np.argmax(far >= min(blades.cut, 0.5 * far.max())))]
    cone, aside = (0.0 if value is None else value for value in (approach.cone, approach.aside))
    approach = replace(approach, shift=above - target.position, cone=cone, aside=aside)
    return replace(scene, approach=approach)
