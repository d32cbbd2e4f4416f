"""What suction cups touch, what scissors cut, and how a tool holds what it has picked."""

import itertools
from typing import Any

import numpy as np

from optipromp.core.arrays import BoolArray, FloatArray, lengths
from optipromp.core.geometry import distances, pack
from optipromp.core.robots.grippers import Scissor, Suction
from optipromp.core.robots.mounted import unmounted
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.core.scenes.scene import JointGoal
from optipromp_sim.simulation.engine import Layer, engine
from optipromp_sim.simulation.world import GRIP, PEDUNCLE, Fruit, World

LIP = 0.003  # [m] chosen: height of the contacts of a lip below its plane, and beyond its radius
ALONG_STEM = 0.001  # [m] chosen: between the points of a stem that may be between the blades
PLACES = 7  # chosen: points between the blades, a side, at which a fruit may be
DEEP = 0.002  # [m] chosen: a fruit this deep between the blades is closed on


def suction_of(world: World) -> Suction | None:
    """The suction cup of a world's robot, if its tool is one."""
    tool = unmounted(world.robot.tool)
    return tool if isinstance(tool, Suction) else None


def scissor_of(world: World) -> Scissor | None:
    """The scissor of a world's robot, if its tool is one."""
    tool = unmounted(world.robot.tool)
    return tool if isinstance(tool, Scissor) else None


def on_lip(
    world: World, contacts: FloatArray, tool_point: FloatArray, tool_axis: FloatArray, fruit: Fruit
) -> BoolArray:
    """Whether a fruit touches the lip of a suction cup (R,), within its radius and angle.

    ``contacts`` (C, 9), ``tool_point`` and ``tool_axis`` (R, 3) as of a :class:`Rollout`.
    """
    cup, tool = suction_of(world), world.robot.tool
    assert cup is not None
    assert tool is not None
    touched = np.zeros(len(tool_point), dtype=np.bool_)
    rows, first, second = (contacts[:, k].astype(np.int64) for k in range(3))
    mine = np.array([entity.kind == "tool" for entity in world.entities])
    on = (mine[first] & (second == fruit.entity)) | (mine[second] & (first == fruit.entity))
    rows, points, forces = rows[on], contacts[on, 3:6], contacts[on, 6:9]
    axis, away = tool_axis[rows], points - tool_point[rows]
    height = np.einsum("ci,ci->c", away, axis)
    aside = np.linalg.norm(away - height[:, None] * axis, axis=1)
    strength = np.linalg.norm(forces, axis=1)
    along = np.abs(np.einsum("ci,ci->c", forces, axis)) / np.maximum(strength, 1e-12)
    held = (
        (height > tool.depth - cup.height - LIP)
        & (height < tool.depth + LIP)
        & (aside < cup.radius + LIP)
        & (along >= np.cos(np.radians(cup.angle)))
    )
    touched[rows[held]] = True
    return touched


def wanted(world: World) -> tuple[str, ...]:
    """The fruits that are to come off: what is taken, else the one whose stem is nearest the goal.

    None of them where no fruit has a stem.
    """
    scene = world.scene
    if scene.target is not None:
        return tuple(item.id for item in scene.taken)
    goal = scene.goals[0]
    if isinstance(goal, JointGoal):
        place = world.robot.tool_pose(goal.joints)[0]
    else:
        place = goal.position
    near = {
        item.id: float(np.linalg.norm(_along(item.stem.points) - place, axis=1).min())
        for item in scene.objects
        if item.stem is not None
    }
    return tuple(sorted(near, key=lambda name: near[name])[:1])


def between_blades(world: World, data: Any) -> tuple[list[int], list[str]]:
    """Bodies of the pieces of stem that closing blades cut, and the fruits that are between them.

    The blades cut from ``depth`` behind the tool point to their tips, in all of their width.
    """
    blades, tool = scissor_of(world), world.robot.tool
    assert blades is not None
    assert tool is not None
    body = world.model.body("tool").id
    turn = data.xmat[body].reshape(3, 3) @ tool.rotation
    point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ tool.point
    half = np.array([0.5 * blades.blade_width, 0.5 * blades.opening, blades.depth])
    pieces, fruits = [], []
    for fruit in world.fruits:
        joints = fruit.stem(data)
        for k in range(len(joints) - 1):
            local = (_along(joints[k : k + 2]) - point) @ turn
            if (np.abs(local) <= half).all(axis=1).any():
                pieces.append(fruit.last + 2 - len(joints) + k)
    grid = np.stack(
        np.meshgrid(*(np.linspace(-1.0, 1.0, PLACES),) * 3, indexing="ij"), axis=-1
    ).reshape(-1, 3)
    places = point + (grid * half) @ turn.T
    shapes = {item.id: item.shape for item in world.scene.objects}
    for fruit in world.shown:
        at = data.qpos[fruit.position : fruit.position + 7]
        solid = pack([(shapes[fruit.id], at[:3], from_quaternion(at[3:]))])
        if float(distances(solid, places)[0].min()) < -DEEP:
            fruits.append(fruit.id)
    return pieces, fruits


def carried_by(world: World, pieces: list[int]) -> BoolArray:
    """Which of the world's fruits hang beyond a piece of stem, by the pieces' bodies (F,)."""
    parents = world.model.body_parentid
    out = np.zeros(len(world.fruits), dtype=np.bool_)
    for row, fruit in enumerate(world.fruits):
        body = fruit.last
        while body > 0 and not out[row]:
            out[row] = body in pieces
            body = int(parents[body])
    return out


def grip(world: World, data: Any, target: Fruit) -> None:
    """Hold the target in the tool from now on.

    A hand holds it as it is, without a contact: how hard fingers press is theirs. A scissor holds
    the end of its stem, about which the fruit turns freely; what was below on the stem is gone. Of
    a truss it holds the stem firmly, with all that grows from it; what was above is gone.
    """
    model, body, truss = world.model, target.body, len(world.scene.taken) > 1
    weld, tool = model.equality(GRIP).id, model.body("tool").id
    data.eq_active[weld] = 1
    if scissor_of(world) is not None:
        joints = target.stem(data)
        pieces = range(target.last + 2 - len(joints), target.last + 1)
        cut = (k for k in between_blades(world, data)[0] if k in pieces)
        first = min(cut, default=pieces.start)
        low, high = (pieces.start, first) if truss else (first, pieces.stop)
        gone = (model.geom_bodyid >= low) & (model.geom_bodyid < high)
        model.geom_contype[gone] = model.geom_conaffinity[gone] = 0
        model.geom_rgba[gone, 3] = 0.0
        if truss:
            data.eq_active[model.equality(PEDUNCLE).id] = 0
            model.eq_obj2id[weld] = body = first
    turn, own = data.xmat[tool].reshape(3, 3), data.xmat[body].reshape(3, 3)
    off = data.xpos[body] - data.xpos[tool]
    if scissor_of(world) is not None and not truss:
        points, robot = _along(joints), world.robot.tool
        assert robot is not None
        away = lengths(points - data.xpos[tool] - turn @ robot.point)
        end = points[int(np.argmin(away))] - data.xpos[tool]
        model.eq_data[weld, :6] = [*turn.T @ end, *own.T @ (end - off)]
        return
    quaternion = np.zeros(4)
    engine().mju_mat2Quat(quaternion, (turn.T @ own).ravel())
    model.eq_data[weld, :10] = [0.0, 0.0, 0.0, *turn.T @ off, *quaternion]
    if world.robot.tool is not None and world.robot.tool.fingers:
        mine = np.flatnonzero(model.geom_bodyid == target.body)
        model.geom_conaffinity[mine] &= ~int(Layer.ROBOT)


def _along(points: FloatArray) -> FloatArray:
    """Points (K, 3), at most :data:`ALONG_STEM` apart, on a line through ``points`` (N, 3)."""
    parts = []
    for a, b in itertools.pairwise(points):
        count = max(2, int(np.ceil(np.linalg.norm(b - a) / ALONG_STEM)) + 1)
        parts.append(a + np.linspace(0.0, 1.0, count)[:, None] * (b - a))
    return np.concatenate(parts)
