"""A shape and a tool of the user's own: a class of a few lines each, and everything takes them."""

import subprocess
import sys
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from optipromp.core.geometry import distances, pack
from optipromp.core.geometry.shapes import MeshShape, Primitive, hull_faces
from optipromp.core.planning import Plan, judge, plan
from optipromp.core.robots import Solid, Tool, load_robot, with_tool
from optipromp.core.scenes import Scene, SceneObject
from optipromp.looks.appearance import object_parts
from optipromp_ros.scenes import geometry, read_geometry
from optipromp_sim.generate import generate
from optipromp_sim.simulation import simulate

SIZE = 0.06, 0.08, 0.05


@dataclass(frozen=True)
class Wedge(Primitive):
    """Half of a box of full edge lengths ``size``: what is below its diagonal from -x to +x [m]."""

    size: tuple[float, float, float]

    def mesh(self, around: int = 24) -> MeshShape:
        """Its six corners."""
        corners = [[x, y, z] for x, z in ((-1, -1), (1, -1), (-1, 1)) for y in (-1, 1)]
        points = 0.5 * np.array(self.size) * corners
        return MeshShape(points, hull_faces(points))


class Shovel(Tool):
    """A wedge on a bar with a pin on either side; a fruit of up to 56 mm fits between the pins."""

    point, front, tip, mouth = np.array([0.0, 0.0, 0.14]), 0.12, 0.16, (0.028, 0.033)

    def solids(self) -> tuple[Solid, ...]:
        """The bar, a wedge across it, and two wedges for pins."""
        pin, up = Wedge((0.005, 0.01, 0.04)), (np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0)
        return (
            Solid("bar", Wedge((0.02, 0.10, 0.02)), np.array([0.0, 0.0, 0.05]), up, "neck"),
            Solid("blade", Wedge((0.06, 0.06, 0.02)), np.array([0.0, 0.0, 0.11])),
            Solid("one pin", pin, np.array([0.0305, 0.0, 0.14])),
            Solid("other pin", pin, np.array([-0.0305, 0.0, 0.14])),
        )


@cache
def made() -> tuple[Scene, Plan]:
    """A reach past a wedge, by a shovel."""
    scene = replace(generate("cluster", 5), tool=None)
    at = scene.target.position + [0.0, -0.12, -0.10]
    scene = replace(scene, objects=(*scene.objects, SceneObject("w", "static", Wedge(SIZE), at)))
    return scene, plan(scene, robot=with_tool(load_robot("panda"), Shovel()))


def test_a_wedge_has_the_volume_and_the_distances_of_one() -> None:
    wedge = Wedge(SIZE)
    assert wedge.volume == pytest.approx(0.5 * np.prod(SIZE))
    assert wedge.measure.bound == pytest.approx(0.5 * np.linalg.norm(SIZE))
    normal = np.array([1.0 / SIZE[0], 0.0, 1.0 / SIZE[2]])
    normal /= np.linalg.norm(normal)
    away = np.array([0.002, 0.02])
    found, _ = distances(pack([(wedge, np.zeros(3), np.eye(3))]), away[:, None] * normal)
    np.testing.assert_allclose(found[:, 0], away, atol=1e-3)


def test_planner_and_judge_keep_from_it() -> None:
    scene, result = made()
    assert result.success, result.message
    middle = result.trajectory.positions[len(result.trajectory.positions) // 2]
    tool, _ = result.robot.tool_pose(middle)
    hit = replace(scene, objects=(*scene.objects[:-1], replace(scene.objects[-1], position=tool)))
    told = judge(hit, result.trajectory, robot=result.robot)
    assert any("w" in str(violation).split() for violation in told.judgement.violations)


def test_they_are_simulated_and_drawn() -> None:
    scene, result = made()
    assert simulate(result).outcome.picked
    (part,) = object_parts(scene, scene.objects[-1])
    assert np.ptp(part.vertices, axis=0).tolist() == pytest.approx(SIZE)


def test_a_message_holds_its_mesh() -> None:
    class Item:
        primitives = primitive_poses = planes = plane_poses = ()

    message = type("Object", (Item,), geometry(Wedge(SIZE)))
    ((shape, _),) = read_geometry(message)
    assert shape.volume == pytest.approx(Wedge(SIZE).volume)


FILES = """
from dataclasses import dataclass
from optipromp.core.geometry.shapes import PRIMITIVES, Box, Primitive, hull_faces, MeshShape
from optipromp.core.robots.tools import TOOLS, Cup

@dataclass(frozen=True)
class Brick(Primitive):
    size: tuple[float, float, float]
    def mesh(self, around=24):
        return Box(self.size).mesh()

@dataclass(frozen=True)
class Beaker(Cup):
    radius: float = 0.04

PRIMITIVES["brick"], TOOLS["beaker"] = Brick, Beaker
from optipromp.core.scenes import scene_from_dict, scene_to_dict
brick = {"id": "b", "role": "static", "shape": {"brick": {"size": [0.1, 0.2, 0.3]}},
         "position": [0.5, 0.0, 0.2]}
given = {"name": "s", "robot": "panda", "goal": {"position": [0.5, 0.0, 0.5], "axis": "free"},
         "tool": {"kind": "beaker", "length": 0.2}, "objects": [brick]}
scene = scene_from_dict(given)
assert type(scene.objects[0].shape) is Brick, scene
told = scene_to_dict(scene)
assert (told["tool"], told["objects"]) == (given["tool"], given["objects"])
"""


def test_scene_files_have_both_by_names_that_are_given_before_scenes_are_imported() -> None:
    subprocess.run([sys.executable, "-c", FILES], check=True)
