"""``optipromp check``: is this file right? ``optipromp validate``: is this trajectory?"""

import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import optipromp
from optipromp.cli.command import Report, Shown, command, exit_code
from optipromp.cli.console import grid, headline, say_if_compiling, waiting
from optipromp.cli.robot import ArmOptions
from optipromp.core import files
from optipromp.core.errors import Code, InvalidRequestError, InvalidSceneError
from optipromp.parts import part

if TYPE_CHECKING:
    from optipromp.core.planning import Picked, Plan, Verdict
    from optipromp.core.planning.task import Task
    from optipromp.core.robots.description import Arm
    from optipromp.core.robots.model import Robot
    from optipromp.core.scenes.scene import Scene
    from optipromp.core.trajectory import Trajectory


LISTED = 20  # items of a list in text, a choice: a robot on a base has hundreds of pairs of links
_SCENE_KEYS = frozenset({"objects", "robot", "target", "goal", "approach", "start"})
_PLAN_KEYS = frozenset({"planner", "status", "metrics", "terms"})


class Kind(StrEnum):
    """The kinds of input."""

    SCENE = "scene"
    ROBOT = "robot"
    DEMONSTRATIONS = "demonstrations"
    PRIMITIVE = "primitive"
    PLAN = "plan"
    CROP = "crop"


def kind_of(item: str) -> Kind:
    """The kind of an item by its built-in name, its file name, or its content (YAML, JSON, NPZ)."""
    from optipromp.core.robots.library import robot_names
    from optipromp.core.scenes.io import scene_names

    if item in scene_names():
        return Kind.SCENE
    if item in robot_names():
        return Kind.ROBOT
    path = Path(item)
    if path.name == "plan.json":
        return Kind.PLAN
    if files.is_folder(path):
        return Kind.PLAN if files.is_there(path / "plan.json") else Kind.DEMONSTRATIONS
    if not files.is_there(path):
        names = ", ".join([*scene_names(), *robot_names()])
        raise InvalidRequestError(
            f"no file and nothing built in is called {item}; there is {names}"
        )
    match path.suffix.lower():
        case ".urdf" | ".xml" | ".mjcf" | ".xacro" | ".robot":
            return Kind.ROBOT
        case ".csv" | ".mcap" | ".db3":
            return Kind.DEMONSTRATIONS
        case ".npz":
            from optipromp.core.promp.model import is_primitive

            return Kind.PRIMITIVE if is_primitive(path) else Kind.DEMONSTRATIONS
        case ".yaml" | ".yml" | ".json":
            return _inside(path)
    raise InvalidRequestError(
        f"cannot tell what {item} is: a scene or robot file ends in .yaml, .yml or .json, "
        "a URDF in .urdf, demonstrations in .npz, .csv or .mcap"
    )


def scene_or_plan(item: str, taker: str) -> "Scene | Plan | Picked":
    """The scene, plan or pick of an item; ``taker`` is the name of the command."""
    kind = kind_of(item)
    if kind is Kind.PLAN:
        return optipromp.load_pick(item)
    if kind is Kind.SCENE:
        return optipromp.load_scene(item)
    raise InvalidRequestError(f"{item} is a {kind.value}; {taker} takes a scene or a plan")


def _inside(path: Path) -> Kind:
    from optipromp.core.documents import read_document
    from optipromp.core.scenes.crops import CROP_KEYS

    try:
        content = read_document(path, InvalidSceneError, "a scene")
    except InvalidSceneError:
        return Kind.SCENE  # whose loader says what is wrong, and at which line
    if not isinstance(content, dict):
        return Kind.SCENE
    if content.keys() >= _PLAN_KEYS:
        return Kind.PLAN
    if _SCENE_KEYS & content.keys():
        return Kind.SCENE
    return Kind.CROP if (CROP_KEYS - {"format", "name"}) & content.keys() else Kind.ROBOT


@command()
def check(item: str, /, out: Path | None = None, *, arm: ArmOptions) -> Report:
    """Check a scene, robot, crop, demonstrations or plan, and say what it holds.

    The kind is found from the file; a primitive that learn wrote is a kind too.
    What is wrong is one line: the code, the file, the field.

    Examples:
        optipromp check scenario-4
        optipromp check my-scene.yaml --out pictures
        optipromp check my-robot.urdf --tip left_tool0
        optipromp check my-robot.urdf --out pictures
        optipromp check recordings/

    Args:
        item (ITEM): A scene or a robot, by a path or a built-in name; or another file or folder.
        out (DIR): Leave pictures there: workspace.png, where the tool gets from the base; of a
            robot cover.png, its body spheres; of a scene scene.png, and scene.html to turn (extra
            'view').
    """
    kind, named = kind_of(item), arm.of(None)
    if kind is Kind.ROBOT:
        from optipromp.core.robots.library import load_arm

        with waiting("reading the robot, covering its links with spheres"):
            robot, found = load_arm(item, choice=named.choice)
        summary = _robot(robot, found)
        if out is not None:
            from optipromp.looks.viewer.figures import cover_figure, png, workspace_figure

            with waiting("drawing"):
                reach = png(workspace_figure(robot, robot.home))
                pictures = {"cover.png": png(cover_figure(robot)), "workspace.png": reach}
                files.write_together(out, pictures)
    elif named:
        raise InvalidRequestError(
            f"{item} is no robot but a {kind}: no --arm, --tip, --base, --srdf, --package-dir or "
            "--robot-arg"
        )
    elif out is not None and kind is not Kind.SCENE:
        raise InvalidRequestError(f"{item} is no robot or scene but a {kind}: no --out")
    else:
        summary = _SUMMARIES[kind](item)
        if out is not None:
            from optipromp.looks.viewer.figures import scene_pictures

            say_if_compiling()
            with waiting("drawing"):
                files.write_together(out, scene_pictures(optipromp.load_scene(item)))
    status, wrong = Code(summary.pop("status", Code.SUCCESS)), summary.pop("message", "")
    told = {key: getattr(value, "to_dict", lambda v=value: v)() for key, value in summary.items()}
    document = {"status": status, "message": wrong, "kind": kind, "item": item, **told}
    lines = [f"  {key.replace('_', ' '):<15} {_words(value)}" for key, value in summary.items()]
    verdict = f" {item}: {f'{status}, {wrong}' if wrong else 'right'}"
    return Report(document, [headline((kind, "bold"), verdict), *lines], exit_code(status))


def _words(value: object) -> str:
    if isinstance(value, dict):
        value = [f"{key} {_words(item)}" for key, item in value.items()]
    if isinstance(value, list | tuple):
        more = f", and {len(value) - LISTED} more (--json)" if len(value) > LISTED else ""
        return (", ".join(_words(item) for item in value[:LISTED]) or "none") + more
    if isinstance(value, float):
        return f"{value:.4g}"
    return "none" if value is None else str(value)


def _scene(item: str) -> dict[str, Any]:
    from optipromp.core.judging import touching
    from optipromp.core.planning import goals
    from optipromp.core.planning.approaches import misfit
    from optipromp.core.planning.task import resolve
    from optipromp.core.robots.model import warn_of_gravity
    from optipromp.looks.appearance import ground_of
    from optipromp.looks.viewer.reach import tool_faces

    scene = optipromp.load_scene(item)
    bound = resolve(scene)
    warn_of_gravity(bound.robot, bound.start[None], scene.up, "at the start")
    floor, tool = ground_of(scene), tool_faces(bound.robot, bound.start)
    low = 0.0 if floor is None else float((tool @ scene.up).min()) - floor
    if low < 0.0:
        warnings.warn(
            f"at the start the tool reaches {-1e3 * low:.0f} mm below the floor that pictures show "
            "under the base, which no plan keeps clear of: state start: or a static floor",
            stacklevel=1,
        )
    if narrow := misfit(bound):
        warnings.warn(narrow, stacklevel=1)
    with waiting("looking whether the tool gets to the goal"):
        reached, why = goals.choose(bound, bound.seed)
    if not len(reached):
        lean = "" if scene.goals else "a plan that leans may reach it; else turn the approach, "
        warnings.warn(f"goal out of reach: {why}; {lean}move the base or the goal", stacklevel=1)
    by_role = {
        role: [item.id for item in scene.objects if item.role == role]
        for role in ("target", "pushable", "avoid", "static")
    }
    inside = touching(bound.scene, bound.robot, bound.start)
    return {
        "status": Code.START_IN_COLLISION if inside else Code.SUCCESS,
        "message": inside and "at the start " + "; ".join(map(str, inside)),
        "name": scene.name,
        "robot": bound.robot.name,
        "tool": scene.tool.kind if scene.tool is not None else None,
        "start": bound.start.tolist(),
        **(_offered(bound) if inside or low < 0.0 else {}),
        **by_role,
        "moving": [item.id for item, _ in scene.movers],
        "goal": ", ".join(type(goal).__name__ for goal in scene.goals) or "the target",
    }


def _offered(task: "Task") -> dict[str, Any]:
    """A start from which a plan succeeds: the tool before the fruits, on the line of the approach,
    in the configuration that leads to a free goal. Nothing, where there is none."""
    import numpy as np

    from optipromp.core.planning import goals
    from optipromp.core.robots import ik

    if task.scene.target is None:
        return {}
    away, axis = task.scene.approach.camera_distance, task.scene.frame[2]
    line = task.camera - np.array([[0.0], [away], [2.0 * away]]) * axis
    say_if_compiling()
    with waiting("looking for a start"):
        found, blocked = goals.choose(task, 0)
        if blocked:
            warnings.warn(f"no start can be offered: {blocked}", stacklevel=1)
        for goal in () if blocked else found:
            for q in ik.track(task.robot, line, np.tile(axis, (len(line), 1)), goal)[0]:
                start = np.round(q, 3)  # as the summary is printed
                if optipromp.plan(replace(task.scene, start=start)).success:
                    return {"start_offered": start.tolist()}
    return {}


def _robot(robot: "Robot", arm: "Arm") -> dict[str, Any]:
    """The summary of a robot; lengths in metres."""
    import numpy as np

    from optipromp.core.robots.model import warn_of_gravity

    warn_of_gravity(robot, robot.home[None], np.array([0.0, 0.0, 1.0]), "at home")
    spheres = Counter(robot.link_names[i] for i in robot.spheres.link)
    return {
        "name": robot.name,
        "joints": list(robot.joint_names),
        "flange": arm.tip,
        "tool_axis": _tool_axis(robot),
        "base": arm.base,
        "chosen": arm.why,
        "tool": list(arm.tool),
        "instead": list(arm.others),
        "held": list(robot.held_joints),
        "lower": robot.lower.tolist(),
        "upper": robot.upper.tolist(),
        "velocity": robot.velocity.tolist(),
        "acceleration": robot.acceleration.tolist(),
        "links": list(robot.link_names),
        "body_spheres": len(robot.spheres.radius),
        "spheres": dict(spheres),
        "excess": {link: round(value, 4) for link, value in robot.excess.items()},
        "self_pairs": len(robot.self_pairs),
        "may_touch": [f"{one.link} and {one.other} ({one.why})" for one in robot.left_out],
    }


def _tool_axis(robot: "Robot") -> str:
    """The angle between the axis of a mounted tool and that of the last joint, in words."""
    import numpy as np

    axis, last = robot.kinematics.axis[-1], robot.joint_names[int(robot.kinematics.dof[-1])]
    across = abs(float(robot.flange_rotation[:, 2] @ axis))
    turn = round(float(np.degrees(np.arccos(min(across, 1.0)))))
    return f"{turn} degrees from the axis of {last}" if turn else f"along the axis of {last}"


def _demonstrations(item: str) -> dict[str, Any]:
    import numpy as np

    from optipromp.cli.learn import read_any

    recorded, _ = read_any(Path(item))
    if not recorded.named:
        _warn_if_nameless(item, recorded.joint_names)
    lengths = [len(demonstration.times) for demonstration in recorded]
    return {
        "joints": list(recorded.joint_names),
        "demonstrations": len(recorded),
        "samples": sum(lengths),
        "shortest": min(lengths),
        "longest": max(lengths),
        "lowest": np.min([d.positions.min(axis=0) for d in recorded], axis=0).tolist(),
        "highest": np.max([d.positions.max(axis=0) for d in recorded], axis=0).tolist(),
    }


def _warn_if_nameless(item: str, names: tuple[str, ...]) -> None:
    from optipromp.cli.learn import NAMELESS
    from optipromp.core.promp.checks import unnamed

    if unnamed(names):
        warnings.warn(f"{item} {NAMELESS}", stacklevel=1)


def _primitive(item: str) -> dict[str, Any]:
    promp = optipromp.ProMP.load(Path(item))
    _warn_if_nameless(item, promp.joint_names)
    return {
        "joints": list(promp.joint_names),
        "bases": promp.basis.count,
        "width": promp.basis.width,
        "start": promp.mean_trajectory(2)[0].tolist(),
        "end": promp.mean_trajectory(2)[-1].tolist(),
    }


def _plan(item: str) -> dict[str, Any]:
    from optipromp.core.planning.legs import legs_of

    whole = optipromp.load_pick(Path(item))
    plan = legs_of(whole)["reach"]
    return {
        "status": whole.status,
        "reason": whole.message,
        "predicted_harm": plan.prediction,
        "risk": plan.risk,
        "scene": plan.scene.name,
        "planner": plan.planner,
        "waypoints": plan.trajectory.n_waypoints,
        "duration": whole.duration,
        "legs": {name: leg.status for name, leg in legs_of(whole).items()},
    }


def _crop(item: str) -> dict[str, Any]:
    from optipromp.core.scenes.crops import ROWS, load_crop

    crop = load_crop(item)
    rows = {name: f"{crop[name]:.4g} {ROWS[name][0]}".removesuffix(" 1") for name in crop.rows}
    return {"name": crop.name, **rows, "eyes": dict(crop.eyes), "guesses": list(crop.guesses)}


_SUMMARIES = {
    Kind.SCENE: _scene,
    Kind.CROP: _crop,
    Kind.DEMONSTRATIONS: _demonstrations,
    Kind.PRIMITIVE: _primitive,
    Kind.PLAN: _plan,
}


_LONG, _SLOW = 60.0, 2e-3  # [s], share of a velocity limit: a choice; 1,000 times faster is usual


@command()
def validate(
    trajectory: Path,
    /,
    scene: str | None = None,
    out: Path | None = None,
    *,
    risk: float | None = None,
    controller: Literal["fr3", "franka"] | None = None,
) -> Report:
    """Judge TRAJECTORY in a scene: what is violated, where, when and by how much.

    The curve between the rows is judged too: it meets positions, velocities and
    accelerations of the rows, or is the smoothest through the positions where
    those are not given. Joints are matched by name. The exit code is 0 only
    where nothing is wrong; 1 where something is; 2 when the input is wrong.

    Examples:
        optipromp validate recorded.csv --scene scenario-3
        optipromp validate reach
        optipromp validate moveit.mcap --scene my-scene.yaml --out verdict --json
        optipromp validate reach --controller fr3

    Args:
        trajectory (TRAJECTORY): A .csv or .npz file, a bag or .mcap with a JointTrajectory, or a
            plan's folder.
        scene (SCENE): A scene file or built-in scene; a plan's own.
        out (DIR): Leave verdict.json and limits.png there.
        risk: Share of promised successes that may be broken; a plan's own, or 0.03.
        controller: Also say what would abort the motion of a Franka Research 3 (either name).
    """
    from optipromp.core.planning import verdict_of
    from optipromp.core.planning.legs import curve_of, legs_of
    from optipromp.core.planning.task import posed
    from optipromp.core.planning.verdict import deciding

    if scene is None and not files.is_file(trajectory / "plan.json"):
        raise InvalidRequestError(f"{trajectory} states no scene: add --scene SCENE")
    with waiting("judging"):
        if scene is None:
            made = optipromp.load_pick(trajectory)
            (plan, *_), curve = legs_of(made).values(), curve_of(made)
            loaded, robot, risk = plan.scene, plan.robot, plan.risk if risk is None else risk
            risk = optipromp.PlanOptions(risk=risk).risk
            legs = {
                name: (verdict_of(replace(leg, task=replace(leg.task, risk=risk))), leg.trajectory)
                for name, leg in legs_of(made).items()
            }
        else:
            loaded = optipromp.load_scene(scene)
            robot = posed(loaded)[0]
            curve = read(trajectory, robot)
            risk = optipromp.PlanOptions.risk if risk is None else risk
            legs = {"": (optipromp.judge(loaded, curve, risk=risk), curve)}
            if any(one.kind in ("goal", "axis") for one in legs[""][0].judgement.violations):
                told = "its scene's approach; a plan that leans chose another: validate its folder"
                warnings.warn(f"{trajectory} is judged by {told}", stacklevel=1)
        decides = deciding({name: one for name, (one, _) in legs.items()}).values()
        found = max(decides, key=lambda one: exit_code(one.status))
    slow = max(found.judgement.metrics.velocity_ratio, 1e-12)
    if curve.duration > _LONG and slow < _SLOW:
        told = f"{curve.duration:.0f} s with {100 * slow:.2g} % of the velocity limits"
        warnings.warn(f"{trajectory} takes {told}: are its times milliseconds?", stacklevel=1)
    document, code = describe(found, curve, loaded, risk), exit_code(found.status)
    if len(legs) > 1:
        document["legs"] = {name: describe(*leg, loaded, risk) for name, leg in legs.items()}
    aborts = None if controller is None else part("foreseen")(robot, curve, loaded.up)
    if aborts is not None:
        of_arm = aborts._asdict() | {"violations": [vars(each) for each in aborts.violations]}
        document["controller"] = files.plain({"name": controller} | of_arm)
        code = code or exit_code(Code.INVALID_PLAN if aborts.violations else Code.SUCCESS)
    if out is not None:
        from optipromp.looks.viewer.figures import limits_figure, png

        figure = limits_figure(curve, robot, found.judgement.violations, loaded.name)
        verdict = files.json_text(document).encode("utf-8")
        files.write_together(out, {"limits.png": png(figure), "verdict.json": verdict})
    lines = (line for name, leg in legs.items() for line in _judged(*leg, loaded.name, name))
    return Report(document, [*lines, *_foreseen(aborts)], code)


def read(path: Path, robot: "Robot") -> "Trajectory":
    """The trajectory in a file or bag."""
    from optipromp.core.trajectory import read_trajectory

    if files.is_bag(path):
        read_bag = part("read_trajectory")
        found: Trajectory = read_bag(path, robot.joint_names, unwind=robot.turns.as_motion)
        return found
    return read_trajectory(path, robot.joint_names, robot.turns.as_motion)


def describe(found: "Verdict", curve: "Trajectory", scene: "Scene", risk: float) -> dict[str, Any]:
    """The verdict as plain values for JSON."""
    return dict(files.plain({
        "scene": scene.name,
        "status": found.status,
        "message": found.message,
        "violations": [vars(violation) for violation in found.judgement.violations],
        "notes": found.judgement.notes,
        "predicted_harm": found.prediction and found.prediction.to_dict(),
        "risk": risk,
        "rows": curve.n_waypoints,
        "metrics": found.judgement.metrics.to_dict(),
    }))  # fmt: skip


def _judged(found: "Verdict", curve: "Trajectory", name: str, leg: str) -> Shown:
    m = found.judgement.metrics
    colour = "green" if found.status is Code.SUCCESS else "red"
    yield headline(
        (name, "bold"),
        f"  {leg}{', ' * bool(leg)}{curve.n_waypoints} rows, {curve.duration:.3f} s  ",
        (found.status, f"bold {colour}"),
    )
    if found.judgement.violations:
        table = grid(("what", "where"), ("when, s", "how much"))
        for violation in found.judgement.violations:
            when = "" if violation.time is None else f"{violation.time:.3f}"
            amount = "" if violation.amount is None else f"{violation.amount:.4g} {violation.unit}"
            table.add_row(violation.kind, violation.subject, when, amount)
        yield table
    yield found.message
    if found.prediction is not None and found.status is not Code.HARM_PREDICTED:
        yield f"{found.prediction}"  # harm is in the message already
    off = f"{m.goal_error:.4f}" if m.goal_axis_error is None else f"{1e3 * m.goal_error:.2f} mm"
    yield (
        f"limits in use: velocity {m.velocity_ratio:.0%}, acceleration {m.acceleration_ratio:.0%}, "
        f"jerk {m.jerk_ratio:.0%}; {off} off the goal"
    )


def _foreseen(aborts: Any) -> Iterator[str]:
    if aborts is not None:
        yield from (f"{each} ({each.kind})" for each in aborts.violations)
        used = ", ".join(f"{what} {share:.0%}" for what, share in aborts.shares.items())
        yield f"limits of an FR3 in use: {used}; power at most {aborts.power:.3g} W"
