"""A world for pictures: the looks of robot and scene over the bodies that collide."""

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np

from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.world import FLOOR, World
from optipromp.looks.appearance import Part, arm_parts, object_parts, scenery

SHOWN, HIDDEN = 2, 4  # MuJoCo's groups of geoms; of these, pictures show the first
GLOSS = {"target": (0.7, 0.6), "pushable": (0.5, 0.5), "floor": (0.0, 0.0)}  # specular, shininess
MATT = 0.25, 0.35
GLOW = 0.35  # share of its colour that the floor shows in the shade


def dressed(world: World, more: Callable[[Any], None] | None = None) -> Any:
    """The world's model with visible parts that touch nothing and weigh nothing.

    Bodies, joints and their order are the world's, so states of one model are states of the other.
    The geoms that a part covers (body spheres, the tool's solids, fruits and objects) are hidden;
    stems, and the fruits of real neighbouring clusters, are shown as they collide. The world's
    ``spec`` changes: build another world for any other use. ``more`` changes it, too, at the end.
    """
    spec, robot, scene = world.spec, world.robot, world.scene
    names = {body.name for body in spec.bodies}
    base = spec.worldbody
    hidden = [FLOOR, "body:", "tool:"]
    for part in arm_parts(robot):
        _add(spec, spec.body(f"segment:{part.segment}") if part.segment >= 0 else base, [part])
    for item in scene.objects:
        bodies = [f"fruit:{item.id}", f"static:{item.id}", f"avoid:{item.id}"]
        name = next((body for body in bodies if body in names), None)
        if name is None:
            continue
        hidden.append(name)
        parts = object_parts(scene, item)
        if not name.startswith("fruit:"):  # its body stands at the origin
            parts = tuple(part.placed(item.position, item.rotation) for part in parts)
        _add(spec, spec.body(name), parts)
    _add(spec, base, scenery(scene))
    for geom in spec.geoms:
        if geom.group != SHOWN:
            covered = any(
                geom.name == name or geom.name.startswith(name + ":" * (name[-1] != ":"))
                for name in hidden
            )
            geom.group = HIDDEN if covered else SHOWN
    if more is not None:
        more(spec)
    model = spec.compile()
    _light(model)
    return model


def _add(spec: Any, body: Any, parts: Iterable[Part]) -> None:
    mujoco = engine()
    for part in parts:
        if len(part.vertices) < 4:  # MuJoCo refuses it
            continue
        name = f"look:{part.segment}:{part.name}"
        kind = part.name.split(":")[0]
        specular, shininess = GLOSS.get(kind, MATT)
        rgba = [*(value / 255.0 for value in part.colour), part.opacity]
        spec.add_material(
            name=name,
            rgba=rgba,
            specular=specular,
            shininess=shininess,
            emission=GLOW if kind == "floor" else 0.0,
        )
        spec.add_mesh(
            name=name,
            uservert=part.vertices.ravel().tolist(),
            userface=part.faces.ravel().astype(np.int32).tolist(),
            inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL,
        )
        body.add_geom(
            name=name, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name, material=name, mass=0.0,
            contype=0, conaffinity=0, group=SHOWN,
        )  # fmt: skip


def _light(model: Any) -> None:
    """Light the model softly."""
    model.vis.headlight.ambient[:] = 0.35
    model.vis.headlight.diffuse[:] = 0.30
    model.vis.headlight.specular[:] = 0.15
    model.vis.map.znear = 0.01
    model.light_castshadow[:] = 0  # a shadow doubles the time of a picture, and speckles
