"""The studio of films, photographs and live cameras: a world dressed for pictures, and drawn."""

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.scenes.pose import Pose
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.world import FLOOR, World
from optipromp.looks.appearance import Part, arm_parts, object_parts, scenery
from optipromp.perception.pictures import CameraModel, Image8

EYE = "eye"  # Name of the camera of photographs in MuJoCo's model

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


class Studio:
    """A world dressed for pictures, its state, and the renderers that draw it.

    ``world``: that is drawn; its own ``spec`` stays as it is. ``fine``: whether edges are smoothed,
    which takes twice as long without a graphics card. ``lens``: of the camera :data:`EYE`, placed
    by :meth:`aim`. ``more``: changes MuJoCo's spec before it is compiled.

    Renderers are made at the first picture of their size, and given back by :meth:`close`: what
    changes shadows or textures of :attr:`model` comes before the first picture.
    """

    def __init__(
        self, world: World, *, fine: bool = False, lens: CameraModel | None = None,
        more: Callable[[Any], None] | None = None,
    ) -> None:  # fmt: skip
        own = replace(world, spec=world.spec.copy())
        if lens is not None:
            angle = 2.0 * math.degrees(math.atan(0.5 * lens.height / lens.fy))
            own.spec.worldbody.add_camera(name=EYE, fovy=angle)
        self.model = dressed(own, more)
        self.model.vis.quality.offsamples = 4 if fine else 0
        self._data = engine().MjData(self.model)
        self._renderers: dict[tuple[int, int], Any] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        where: TracebackType | None,
    ) -> None:  # fmt: skip
        self.close()

    def close(self) -> None:
        """Give the renderers back."""
        while self._renderers:
            self._renderers.popitem()[1].close()

    def stand(self, positions: FloatArray) -> None:
        """Bring everything to MuJoCo's first generalised ``positions``; the others stay."""
        self._data.qpos[: len(positions)] = positions
        engine().mj_kinematics(self.model, self._data)
        engine().mj_camlight(self.model, self._data)

    def aim(self, pose: Pose) -> None:
        """Place the camera :data:`EYE`, whose z points forward and y down; after :meth:`stand`."""
        eye = self.model.camera(EYE).id
        self._data.cam_xpos[eye] = pose.position
        self._data.cam_xmat[eye] = (pose.rotation * [1.0, -1.0, -1.0]).ravel()

    def colours(
        self, camera: Any, width: int, height: int, add: Callable[[Any], None] | None = None
    ) -> Image8:
        """The picture (height, width, 3) of a camera of MuJoCo; ``add`` changes MuJoCo's scene."""
        renderer = self.renderer(width, height)
        renderer.update_scene(self._data, camera)
        if add is not None:
            add(renderer.scene)
        return np.array(renderer.render())

    def depths(self, width: int, height: int) -> FloatArray:
        """Depth (height, width) [m] of the last picture of this size."""
        renderer = self.renderer(width, height)
        renderer.enable_depth_rendering()
        depth = renderer.render().astype(np.float64)
        renderer.disable_depth_rendering()
        return np.asarray(depth)

    def geoms(self, width: int, height: int) -> NDArray[np.int32]:
        """The geom of each pixel (height, width) of the last picture of this size; -1: none."""
        renderer = self.renderer(width, height)
        renderer.enable_segmentation_rendering()
        segments = renderer.render().copy()
        renderer.disable_segmentation_rendering()
        geom = segments[:, :, 1] == int(engine().mjtObj.mjOBJ_GEOM)
        return np.where(geom, segments[:, :, 0], -1)

    def renderer(self, width: int, height: int) -> Any:
        """MuJoCo's renderer of pictures of ``width`` x ``height`` pixels."""
        size = width, height
        if size not in self._renderers:
            try:
                made = engine().Renderer(self.model, height=height, width=width)
            except Exception as error:  # whatever the platform's OpenGL raises
                raise InvalidRequestError(
                    f"MuJoCo cannot draw off screen ({error}); on Linux it needs libEGL (Debian: "
                    "apt-get install libegl1), or set MUJOCO_GL"
                ) from None
            self._renderers[size] = made
        return self._renderers[size]
