"""The legs of a pick to and from files, beside those of the reach.

The folder of a pick is that of its reach (:mod:`optipromp.core.output`), with ``retreat.npz`` and
``carry.npz``: the waypoints of the further legs, and the digest of the reach's waypoints.
"""

import hashlib
from dataclasses import replace
from pathlib import Path

from optipromp.core.errors import InvalidPlanError, InvalidRequestError
from optipromp.core.files import is_there, npz, read_bytes, read_npz, write_atomically
from optipromp.core.output import RATE, load_plan, write_plan
from optipromp.core.planning.legs import CARRY, REACH, RETREAT, Picked, carried, leg, retreat_task
from optipromp.core.planning.result import Plan
from optipromp.core.planning.task import resolve
from optipromp.core.trajectory_files import arrays, from_arrays

OF = "reach_sha256"


def write_pick(picked: Picked, folder: Path, *, rate: float = RATE) -> tuple[str, ...]:
    """Write a pick into ``folder``: its reach as :func:`write_plan` does, then the other legs.

    Returns:
        The names of the files.

    Raises:
        InvalidRequestError: the folder cannot be written; a rate that is not positive.
    """
    names = list(write_plan(picked.reach, folder, rate=rate))
    of = _digest(folder)
    for name in (RETREAT, CARRY):
        if name in picked.legs:
            content = npz({OF: of, **arrays(picked.legs[name].trajectory)}, compressed=True)
            write_atomically(folder / f"{name}.npz", content)
            names.append(f"{name}.npz")
    return tuple(names)


def load_pick(path: Path | str) -> Picked | Plan:
    """Load what :func:`write_pick` or :func:`write_plan` left: a pick, or a plan of one motion.

    Every leg is judged again. Legs of another reach than that of the folder are passed over.

    Raises:
        InvalidPlanError: a leg that the judge refuses.
        OptiPrompError: what :func:`optipromp.core.output.load_plan` raises.
    """
    path = Path(path)
    reach, folder = load_plan(path), path.parent if path.name == "plan.json" else path
    place = reach.scene.place
    if place is None or not reach.success:
        return reach
    legs = {REACH: reach}
    for name in (RETREAT, CARRY):
        file = folder / f"{name}.npz"
        if not is_there(file):
            break
        rows = read_npz(file)
        try:
            curve, of = from_arrays(rows), str(rows[OF])
        except (KeyError, ValueError) as error:
            raise InvalidRequestError(f"{file}: no leg that this version wrote ({error})") from None
        if of != _digest(folder):
            break
        if curve.joint_names != reach.robot.joint_names:
            raise InvalidRequestError(f"{file}: must have the joints of {reach.robot.name}")
        if name == RETREAT:
            task = retreat_task(reach, curve.positions[-1])
        else:
            task = replace(resolve(*carried(legs[RETREAT], place)), risk=reach.risk)
        legs[name] = leg(task, curve, 0.0)
        if not legs[name].success:
            raise InvalidPlanError(f"{file}: judged again: {legs[name].message}")
    return Picked(legs)


def _digest(folder: Path) -> str:
    content = read_bytes(folder / "waypoints.npz", InvalidRequestError)
    return hashlib.sha256(content).hexdigest()
