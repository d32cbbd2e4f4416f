"""Roots that move: the carriages that the stems hang on are driven along their motion.

A root moves by the scene's motion of its fruit, and by the sway and the jump of a plant.
"""

from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.laboratory.simulation.disturbances import CARRIAGE_MASS
from optipromp.laboratory.simulation.engine import engine
from optipromp.laboratory.simulation.world import World


class Carriages:
    r"""The carriages of a world's roots along the world's motion.

    MuJoCo integrates :math:`v_{k+1} = v_k + h a_k`, :math:`x_{k+1} = x_k + h v_{k+1}`. A carriage
    has :math:`v_k = (x_k - x_{k-1}) / h` and the force that gives it
    :math:`a_k = (x_{k+1} - 2 x_k + x_{k-1}) / h^2`, so it follows the motion exactly but for the
    pull of its stem; position and velocity are set anew before every step.

    Args:
        world: whose roots move.
        data: at the beginning; roots and fruits are displaced and given their velocities.
    """

    def __init__(self, world: World, data: Any) -> None:
        self._world, self._step = world, float(world.model.opt.timestep)
        self._at = np.array([root.position for root in world.roots])[:, None] + np.arange(3)
        self._dofs = np.array([root.spin for root in world.roots])[:, None] + np.arange(3)
        self._hold = -np.asarray(world.model.opt.gravity)
        self._places = [self._place(k) for k in (-1, 0, 1)]
        velocity = self._velocity()
        for k, root in enumerate(world.roots):
            for index in root.fruits:
                fruit = world.fruits[index]
                data.qpos[fruit.position : fruit.position + 3] += self._places[1][k]
                data.qvel[fruit.spin : fruit.spin + 3] = velocity[k]
        self.drive(data, 0)
        engine().mj_forward(world.model, data)

    def _place(self, step: int) -> FloatArray:
        time, motion = step * self._step, self._world.motion
        courses = [root.course for root in self._world.roots]
        out = np.zeros((len(courses), 3)) if motion is None else motion.position(time)
        for k, course in enumerate(courses):
            if course is not None:
                out[k] += course.at(np.array([time - self._world.parameters.engine.settle]))[0]
        return out

    def _velocity(self) -> FloatArray:
        out: FloatArray = (self._places[1] - self._places[0]) / self._step
        return out

    def drive(self, data: Any, step: int) -> None:
        """Set places, velocities and forces of the carriages for the step after number ``step``."""
        if step > 0:
            self._places = [*self._places[1:], self._place(step + 1)]
        before, now, after = self._places
        data.qpos[self._at] = now
        data.qvel[self._dofs] = self._velocity()
        gain = (after - 2.0 * now + before) / self._step**2
        data.qfrc_applied[self._dofs] = CARRIAGE_MASS * (gain + self._hold)
