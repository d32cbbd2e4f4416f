"""A camera in a running simulation: colour and depth of what is there now."""

import math
from dataclasses import replace
from types import TracebackType
from typing import Self

import numpy as np

from optipromp.core.errors import InvalidRequestError
from optipromp.laboratory.simulation.detector_parameters import MOUNTS, DetectorParameters
from optipromp.laboratory.simulation.dress import dressed
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.photograph import (
    EYE,
    PhotoParameters,
    exposed,
    painted,
    upright,
)
from optipromp.laboratory.simulation.render import canvas
from optipromp.laboratory.simulation.sight import hand_pose, standing_pose, tool_frame
from optipromp.laboratory.simulation.simulation import Simulation
from optipromp.laboratory.simulation.stereo import StereoParameters, sensed
from optipromp.perception.pictures import CameraModel, DepthPicture


class LiveCamera:
    """Photographs a simulation as it runs; fruits hang where they hang now.

    Args:
        simulation: whose world is shown. Objects to avoid are as its parameters say.
        mount: of the camera: ``beside``, ``palm`` or ``hand``, as for closed loops.
        seed: of light, colours and background, which last, and of each picture's errors of depth.
        parameters: of the camera and the looks; a standing camera has no ``jitter``.
        stereo: of the errors of depth.

    Raises:
        InvalidRequestError: an unknown mount, or MuJoCo cannot draw.
    """

    def __init__(
        self,
        simulation: Simulation,
        mount: str = "beside",
        seed: int = 0,
        parameters: PhotoParameters | None = None,
        stereo: StereoParameters | None = None,
    ) -> None:
        if mount not in MOUNTS:
            raise InvalidRequestError(f"mount is {mount!r}; valid are {', '.join(MOUNTS)}")
        self._simulation = simulation
        p = self._parameters = parameters or PhotoParameters()
        self._stereo, self._rng = stereo or StereoParameters(), np.random.default_rng([seed, 35])
        detector = DetectorParameters(mount=mount)  # type: ignore[arg-type]
        scene = simulation.scene
        standing = upright(standing_pose(scene, detector), scene.up)
        self._pose = standing if mount == "beside" else hand_pose(simulation.robot, detector)
        self._on_tool = mount != "beside"
        middle = 0.5 * (p.width - 1), 0.5 * (p.height - 1)
        self._camera = CameraModel(p.width, p.height, p.focal, p.focal, *middle)
        world = replace(simulation.world, spec=simulation.world.spec.copy())
        angle = 2.0 * math.degrees(math.atan(0.5 * p.height / p.focal))
        world.spec.worldbody.add_camera(name=EYE, fovy=angle)
        self._model = dressed(world)
        self._model.vis.quality.offsamples = 0
        painted(self._model, p, self._rng)
        self._data = engine().MjData(self._model)
        self._renderer = canvas(self._model, p.width, p.height)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None,
        where: TracebackType | None,
    ) -> None:  # fmt: skip
        self._renderer.close()

    @property
    def camera(self) -> CameraModel:
        """The camera where it is now."""
        pose = self._pose
        if self._on_tool:
            pose = tool_frame(self._simulation.robot, self._simulation.state().q) @ pose
        return replace(self._camera, pose=pose)

    def take(self) -> DepthPicture:
        """A picture of what is there now."""
        mujoco, camera, data = engine(), self.camera, self._data
        data.qpos[:] = self._simulation.data.qpos
        mujoco.mj_kinematics(self._model, data)
        mujoco.mj_camlight(self._model, data)
        eye = self._model.camera(EYE).id
        data.cam_xpos[eye] = camera.pose.position
        data.cam_xmat[eye] = (camera.pose.rotation * [1.0, -1.0, -1.0]).ravel()
        self._renderer.update_scene(data, EYE)
        rgb = exposed(self._renderer.render().copy(), self._parameters, self._rng)
        self._renderer.enable_depth_rendering()
        depth = self._renderer.render().astype(np.float64)
        self._renderer.disable_depth_rendering()
        seen = sensed(depth, self._parameters.focal, self._stereo, self._rng)
        return DepthPicture(rgb, seen, camera)
