"""A bench of one arm."""

import numpy as np

from optipromp.core.geometry.shapes import Sphere
from optipromp.core.planning.task import resolve
from optipromp.core.scenes.scene import Scene, SceneObject, Stem, ToolSpec
from optipromp.core.trajectory import Trajectory
from optipromp_sim.simulation import SimulationParameters, simulate
from optipromp_sim.simulation.steps import Execution
from optipromp_sim.simulation.world import build

URDF = """<robot name="gantry">
  <link name="base"/>
  {joints}
</robot>"""


LINK = """<joint name="{axis}" type="prismatic"><parent link="{parent}"/><child link="l{axis}"/>
  <axis xyz="{vector}"/><limit lower="-1" upper="1" velocity="1" effort="500"/></joint>
  <link name="l{axis}"><collision><geometry><sphere radius="0.02"/></geometry></collision></link>"""


VECTORS = (("x", "base", "1 0 0"), ("y", "lx", "0 1 0"), ("z", "ly", "0 0 1"))


MOUTH = 0.13  # tool point above the flange: 0.10 + 0.05 - 0.02


def clean(made, **more):
    """The run of a plan that succeeds, which harms nothing."""
    assert made.success, made.message
    run = simulate(made, **more)
    assert run.success, run.outcome.message
    return run


class Bench:
    """Scenes around the gantry, and motions of it."""

    def __init__(self, folder):
        self.folder = folder
        joints = "".join(LINK.format(axis=a, parent=p, vector=v) for a, p, v in VECTORS)
        (folder / "gantry.urdf").write_text(URDF.format(joints=joints))
        told = "format: 1\nname: gantry\nurdf: gantry.urdf\nacceleration: none\njerk: none\n"
        (folder / "gantry.yaml").write_text(told)

    def scene(self, *objects, radius=0.03, **further):
        return Scene(
            "bench", "gantry.yaml", objects, tool=ToolSpec("cup", {"radius": radius}),
            base_dir=self.folder, **further,
        )  # fmt: skip

    def fruit(self, id_, position, *, length=0.15, lean=(0.0, 0.0), role="target", **physical):
        """A fruit of radius 15 mm on a straight stem whose root is ``lean`` aside [m]."""
        position = np.array(position, dtype=float)
        root = position + np.array([*lean, length])
        return SceneObject(
            id_, role, Sphere(0.015), position, stem=Stem(np.array([position, root])),
            physical=physical,
        )  # fmt: skip

    def line(self, start, end, seconds=2.0, count=60):
        """Tool point from ``start`` to ``end`` along a line, smoothly."""
        s = np.linspace(0.0, 1.0, count)
        s = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        points = np.array(start) + s[:, None] * (np.array(end) - np.array(start))
        points = points - np.array([0.0, 0.0, MOUTH])
        return Trajectory.through(points, seconds / (count - 1), ("x", "y", "z"))

    def still(self, at=(0.5, 0.5, -0.5)):
        """Standing far away."""
        return self.line(at, at, 1.0, 10)

    def execution(self, scene, parameters=None):
        """A run about to begin, in which nothing moves by itself."""
        parameters = parameters or SimulationParameters()
        robot = resolve(scene).robot
        return Execution(build(scene, robot, parameters), self.still(), 100.0)

    def parameters(self, **groups):
        """The defaults with some changed, by group."""
        return SimulationParameters().changed(**groups)
