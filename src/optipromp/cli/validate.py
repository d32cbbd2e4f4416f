"""``optipromp validate``: anyone's trajectory, judged in a scene."""

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optipromp.cli.command import Report, Shown, command, exit_code
from optipromp.cli.console import grid, headline, waiting
from optipromp.core.errors import Code

if TYPE_CHECKING:
    from optipromp.core.planning import Verdict
    from optipromp.core.robots.model import Robot
    from optipromp.core.scenes.scene import Scene
    from optipromp.core.trajectory import Trajectory

_LONG, _SLOW = 60.0, 2e-3  # [s], share of a velocity limit: a choice; 1,000 times faster is usual


@command()
def validate(
    trajectory: Annotated[
        Path,
        typer.Argument(
            metavar="TRAJECTORY",
            help="A .csv or .npz file, a bag or .mcap with a JointTrajectory, or a plan's folder.",
        ),
    ],
    scene: Annotated[
        str | None,
        typer.Option(metavar="SCENE", help="A scene file or built-in scene; a plan's own."),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Leave verdict.json and limits.png there.")
    ] = None,
    *,
    risk: Annotated[
        float | None,
        typer.Option(help="Share of promised successes that may be broken; a plan's own, or 0.03."),
    ] = None,
) -> Report:
    """Judge TRAJECTORY in a scene: what is violated, where, when and by how much.

    The curve between the rows is judged too: it meets positions, velocities and
    accelerations of the rows, or is the smoothest through the positions where
    those are not given. Joints are matched by name. The exit code is 0 only
    where nothing is wrong; 1 where something is; 2 when the input is wrong.

    [bold]Examples[/bold]

    \b
    optipromp validate recorded.csv --scene scenario-3
    optipromp validate reach
    optipromp validate moveit.mcap --scene my-scene.yaml --out verdict --json
    """
    from optipromp.core.errors import InvalidRequestError
    from optipromp.core.files import is_file
    from optipromp.core.output import load_plan
    from optipromp.core.planning import PlanOptions, judge, verdict_of
    from optipromp.core.planning.task import posed
    from optipromp.core.scenes.io import load_scene

    if scene is None and not is_file(trajectory / "plan.json"):
        raise InvalidRequestError(f"{trajectory} states no scene: add --scene SCENE")
    with waiting("judging"):
        if scene is None:
            plan = load_plan(trajectory)
            risk = plan.risk if risk is None else PlanOptions(risk=risk).risk
            plan = replace(plan, task=replace(plan.task, risk=risk))
            loaded, robot, curve, found = plan.scene, plan.robot, plan.trajectory, verdict_of(plan)
        else:
            loaded = load_scene(scene)
            robot = posed(loaded)[0]
            curve = read(trajectory, robot)
            risk = PlanOptions.risk if risk is None else risk
            found = judge(loaded, curve, risk=risk)
    slow = max(found.judgement.metrics.velocity_ratio, 1e-12)
    if curve.duration > _LONG and slow < _SLOW:
        told = f"{curve.duration:.0f} s with {100 * slow:.2g} % of the velocity limits"
        warnings.warn(f"{trajectory} takes {told}: are its times milliseconds?", stacklevel=1)
    document = describe(found, curve, loaded, risk)
    if out is not None:
        from optipromp.core.files import json_text, write_atomically
        from optipromp.looks.viewer.figures import limits_figure, png

        figure = limits_figure(curve, robot, found.judgement.violations, loaded.name)
        write_atomically(out / "limits.png", png(figure))
        write_atomically(out / "verdict.json", json_text(document).encode("utf-8"))
    return Report(document, _shown(found, loaded, curve), exit_code(found.status))


def read(path: Path, robot: "Robot") -> "Trajectory":
    """The trajectory in a file or bag."""
    from optipromp.core.files import is_bag
    from optipromp.core.trajectory import read_trajectory

    if is_bag(path):
        from optipromp import ros

        return ros.read_trajectory(path, robot.joint_names)
    return read_trajectory(path, robot.joint_names)


def describe(found: "Verdict", curve: "Trajectory", scene: "Scene", risk: float) -> dict[str, Any]:
    """The verdict as plain values for JSON."""
    from optipromp.core.files import plain

    return dict(plain({
        "scene": scene.name,
        "status": found.status,
        "message": found.message,
        "violations": [vars(violation) for violation in found.judgement.violations],
        "notes": found.judgement.notes,
        "predicted_harm": None if found.prediction is None else vars(found.prediction),
        "risk": risk,
        "rows": curve.n_waypoints,
        "metrics": found.judgement.metrics.to_dict(),
    }))  # fmt: skip


def _shown(found: "Verdict", scene: "Scene", curve: "Trajectory") -> Shown:
    m = found.judgement.metrics
    colour = "green" if found.status is Code.SUCCESS else "red"
    yield headline(
        (scene.name, "bold"),
        f"  {curve.n_waypoints} rows, {curve.duration:.3f} s  ",
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
