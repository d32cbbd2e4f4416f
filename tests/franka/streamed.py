"""Plans on a simulated FR3 with reflexes, streamed by franky."""

from typing import Any

import numpy as np
from tests.franka.paced import Paced
from tests.franka.server import serving

from optipromp import Plan
from optipromp_loop.control.fr3 import foreseen, torques
from optipromp_loop.control.franka import STIFFNESS

OLD = 0.003  # [s] two of a reference's period at 500 Hz, one of the arm's cycle


def streamed(made: Plan, host: str) -> dict[str, Any]:
    """Stream a plan to an arm that stands at its begin; the reflexes and the errors.

    The errors are of the joints in the records (100 Hz) [rad], and of the tool point at the end
    [m].
    """
    curve, robot = made.trajectory, made.robot
    aborts = foreseen(robot, curve, made.scene.up).violations
    row: dict[str, Any] = {"foreseen": [each.kind for each in aborts], "lag": lag(made)}
    with serving(host, curve.positions[0]) as reflexes, Paced(host, robot) as arm:
        done = arm.execute(curve)
        last = [robot.tool_pose(q)[0] for q in (arm.state().q, curve.positions[-1])]
        return row | {
            "reflexes": list(reflexes), "finished": done.finished, "message": done.reason,
            "joint_error": done.largest_error,
            "end_error": float(np.linalg.norm(last[0] - last[1])),
        }  # fmt: skip


def lag(made: Plan) -> float:
    """The joints' largest error [rad] without friction, by the stiffness of the tracker.

    It feels what inertia asks of the torques, and a reference that is up to OLD old.
    """
    curve, up = made.trajectory, made.scene.up
    times = np.linspace(0.0, curve.duration, int(1e3 * curve.duration) + 1)
    q, velocity, _ = curve.sample(times)
    needed = torques(made.robot, times, q, velocity, up)
    needed -= torques(made.robot, 1e3 * times, q, 0.0 * velocity, up)  # of gravity alone
    return float((np.abs(needed / STIFFNESS) + OLD * np.abs(velocity)).max())
