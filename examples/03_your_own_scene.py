"""A scene of your own, built in Python: a shelf, no stems.

Upright cans stand on a board between two walls. The arm comes in horizontally, so the approach
direction is +x and the lateral one +y. The cans in front are `pushable` and have no stem: both
sides are tried for each of them, and the better plan is kept. Walls and board are `static`.

    python examples/03_your_own_scene.py
"""

import tempfile
from pathlib import Path

import numpy as np

from optipromp import Scene, SceneObject, load_scene, plan, save_scene
from optipromp.core.geometry.shapes import Box, Cylinder
from optipromp.core.scenes import Approach, ToolSpec

BOARD = 0.40  # [m] height of the board's top
CAN = Cylinder(radius=0.02, length=0.08)


def can(name: str, role: str, x: float, y: float) -> SceneObject:
    """A can that stands on the board."""
    return SceneObject(name, role, CAN, np.array([x, y, BOARD + 0.10]))  # type: ignore[arg-type]


def slab(name: str, size: tuple[float, float, float], center: list[float]) -> SceneObject:
    """A piece of the shelf."""
    return SceneObject(name, "static", Box(size), np.array(center))


scene = Scene(
    name="shelf",
    robot="panda",
    tool=ToolSpec("cup", {"radius": 0.035, "height": 0.05, "length": 0.12}),
    start=np.array([0.0, -0.6, 0.0, -2.4, 0.0, 3.3, 0.8]),
    approach=Approach(direction=np.array([1.0, 0.0, 0.0]), lateral=np.array([0.0, 1.0, 0.0])),
    objects=(
        can("wanted", "target", 0.70, 0.0),
        can("in front", "pushable", 0.58, 0.01),
        slab("board", (0.40, 0.80, 0.02), [0.75, 0.0, BOARD - 0.06]),
        slab("left wall", (0.30, 0.02, 0.30), [0.75, 0.35, BOARD + 0.10]),
        slab("right wall", (0.30, 0.02, 0.30), [0.75, -0.35, BOARD + 0.10]),
    ),
)

with tempfile.TemporaryDirectory() as folder:
    path = Path(folder) / "shelf.yaml"
    save_scene(scene, path)
    print(path.read_text())
    scene = load_scene(path)

result = plan(scene)
print(f"{scene.name}: {result.status} {result.message}")
for name, offset in result.metrics.M_p.items():
    print(f"passes {name} at {1e3 * (offset or 0.0):+.1f} mm")
print(f"clearance from the shelf: {1e3 * (result.metrics.clearance_static or 0.0):.1f} mm")
if not result.success:
    raise SystemExit(1)
