"""``optipromp learn``: demonstrations in, a movement primitive out."""

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import optipromp
from optipromp.cli.command import Report, Shown, command
from optipromp.cli.console import grid, waiting
from optipromp.cli.robot import ArmOptions, Named
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.files import check_folder, is_bag, write_atomically
from optipromp.parts import part

if TYPE_CHECKING:
    from optipromp.core.promp import Basis, Demonstrations
    from optipromp.core.promp.units import Units

LARGEST_RESIDUAL = 0.05
"""[rad or m] A larger residual of a demonstration gives a warning: 0.05 rad moves the tool of an
arm that reaches 1 m by 50 mm, the radius of the cup."""

NAMELESS = (
    "has joints called joint_1, joint_2 and so on, as columns without names are: 'plan' takes it "
    "for a robot with these names alone; 'learn --robot ROBOT' names columns that are in its order"
)


@command()
def learn(
    demonstrations: Path,
    /,
    out: Path,
    topic: str | None = None,
    prefix: str | None = None,
    em: bool = False,
    bases: int | None = None,
    width: float = 4,
    figure: bool = True,
    unit: Literal["radians", "degrees", "range"] | None = None,
    calibration: Path | None = None,
    rename: list[str] | None = None,
    *,
    robot: str | None = None,
    arm: ArmOptions,
) -> Report:
    """Learn a movement primitive, for plan --demonstrations.

    Prints how far the primitive's bases are from each demonstration, and draws
    the demonstrations with the learnt mean and spread. A bag (.mcap, or a folder
    of rosbag2) is cut into demonstrations where the arm stands still.

    Examples:
        optipromp learn recorded.npz --out reach.npz
        optipromp learn recordings/ --out reach.npz --robot panda --bases 12
        optipromp learn guided.mcap --out reach.npz --robot panda
        optipromp learn so101-set --out reach.npz --unit range --calibration follower.json

    Args:
        demonstrations (DEMOS): NPZ, CSV, a folder of CSVs, or a bag of joint states.
        out (FILE): Where the primitive goes (.npz).
        topic (NAME): Of a bag's joint states (/joint_states).
        prefix (PREFIX): Of a bag's joint names, of one of several arms.
        em: Expectation-maximisation: for uneven recordings.
        bases (N): Number of bases a joint; cross-validated if left out.
        width: Width of a basis; larger is narrower.
        figure: Draw FILE with the suffix .png.
        unit: Of columns of turning joints (radians); range: LeRobot's -100 to 100.
        calibration (FILE): LeRobot's JSON of the arm, for --unit range.
        rename (OLD=NEW): A column's other name; OLD= leaves the column out.
        robot (ROBOT): Put the columns, by name, into this robot's order; columns without names are
            taken to be in it.
    """
    from optipromp.core.promp import residuals

    if out.suffix != ".npz":
        raise InvalidRequestError(f"--out {out}: the file of a primitive ends in .npz")
    check_folder(out.parent)
    with waiting("learning") as say:
        said = unit, calibration, rename or []
        recorded, recording = _read(demonstrations, arm.of(robot), topic, prefix, said)
        basis, held_out = _basis(recorded, bases, width, say)
        promp = (optipromp.fit_em if em else optipromp.fit)(recorded, basis)
        rest = residuals(recorded, basis)
        promp.save(out)
        picture = out.with_suffix(".png") if figure else None
        if picture is not None:
            from optipromp.looks.viewer.figures import png, primitive_figure

            write_atomically(picture, png(primitive_figure(promp, recorded)))
    document: dict[str, Any] = {
        "status": "success",
        "message": _far(recorded, rest),
        "file": str(out),
        "figure": None if picture is None else str(picture),
        "method": "em" if em else "ridge",
        "demonstrations": len(recorded),
        "samples": sum(len(item.times) for item in recorded),
        "joints": promp.joint_names,
        "bases": promp.basis.count,
        "width": promp.basis.width,
        "held_out_residual": held_out,
        "residual": _summary(promp.joint_names, rest),
        "recording": recording and recording.to_dict(),
    }
    if document["message"]:
        warnings.warn(document["message"], stacklevel=1)
    return Report(document, _shown(document))


def read_any(
    path: Path,
    joints: Sequence[str] | None = None,
    topic: str | None = None,
    prefix: str | None = None,
    units: "Units | None" = None,
) -> tuple["Demonstrations", Any]:
    """Demonstrations of a file or folder; of a bag also its cuts."""
    if not is_bag(path):
        for option, value in (("topic", topic), ("prefix", prefix)):
            if value is not None:
                raise InvalidRequestError(f"--{option} {value}: {path} is no bag")
        return optipromp.load_demonstrations(path, units), None
    if units is not None:
        raise InvalidRequestError(
            f"{path} is a bag, in radians: no --unit, --calibration, --rename"
        )
    found = part("load_recording")(path, joints, topic=topic, prefix=prefix or "")
    return found.demonstrations, found


def _read(
    path: Path, named: Named, topic: str | None, prefix: str | None, said: tuple[Any, Any, Any]
) -> tuple["Demonstrations", Any]:
    """The demonstrations, in the joint order of a robot that is named; of a bag also its cuts."""
    from optipromp.core.promp import Demonstrations
    from optipromp.core.promp.checks import unnamed
    from optipromp.core.promp.demonstrations import turn_apart
    from optipromp.core.promp.units import units_of
    from optipromp.core.robots.kernels import PRISMATIC

    robot = joints = None
    if named.name is not None:
        from optipromp.core.robots.library import load_arm

        robot = load_arm(named.name, choice=named.choice)[0]
        joints = robot.joint_names
    units = None
    if any(said):
        slides = robot.kinematics.dof[robot.kinematics.kind == PRISMATIC] if robot else ()
        units = units_of(*said, {joints[k] for k in slides} if joints else ())
    recorded, recording = read_any(path, joints, topic, prefix, units)
    nameless = unnamed(recorded.joint_names)
    if robot is not None and joints is not None:
        if nameless and len(joints) == recorded.n_joints and recorded.joint_names != joints:
            told = (
                "calls its joints joint_1, joint_2 and so on" if recorded.named else "has no names"
            )
            warnings.warn(
                f"{path} {told}; its columns are taken to be {', '.join(joints)}, in this order",
                stacklevel=1,
            )
            recorded = Demonstrations(recorded.items, joints)
        limits = robot.lower, robot.upper, str(path), robot.turns
        return recorded.for_robot(joints, *limits), recording
    if told := turn_apart(recorded):
        raise InvalidDemonstrationError(
            f"{path}: {told}, and their mean is between: add --robot ROBOT, which puts joints that "
            "may turn onto one turn"
        )
    if nameless and not recorded.named:
        warnings.warn(f"{path} {NAMELESS}", stacklevel=1)
    return recorded, recording


def _basis(
    recorded: "Demonstrations", bases: int | None, width: float, say: Any
) -> tuple["Basis", dict[int, float]]:
    """The basis of ``bases``, or the cross-validated one with the residual of each count tried."""
    from optipromp.core.promp import held_out_residuals

    if bases is not None:
        return optipromp.Basis(bases, width), {}
    if len(recorded) == 1:
        warnings.warn(
            "one demonstration cannot be cross-validated; it gets "
            f"{optipromp.Basis.count} bases a joint (--bases N asks for others)",
            stacklevel=1,
        )
        return optipromp.Basis(width=width), {}
    held_out = held_out_residuals(
        recorded, width=width, progress=lambda count: say(f"cross-validating {count} bases ...")
    )
    return optipromp.Basis(min(held_out, key=lambda count: held_out[count]), width), held_out


def _summary(joints: tuple[str, ...], rest: list[Any]) -> dict[str, Any]:
    """RMS and largest residual, in all and for each joint [rad or m]."""
    import numpy as np

    flat = np.concatenate(rest)
    rms, largest = np.sqrt((flat**2).mean(axis=0)), np.abs(flat).max(axis=0)
    return {
        "rms": float(np.sqrt((flat**2).mean())),
        "largest": float(largest.max()),
        "joints": {
            name: {"rms": float(rms[j]), "largest": float(largest[j])}
            for j, name in enumerate(joints)
        },
    }


def _far(recorded: "Demonstrations", rest: list[Any]) -> str:
    """The warning of the demonstration with the largest residual; empty where that is small."""
    import numpy as np

    largest = [float(np.abs(part).max()) for part in rest]
    worst = int(np.argmax(largest))
    if largest[worst] <= LARGEST_RESIDUAL:
        return ""
    sample, joint = np.unravel_index(int(np.abs(rest[worst]).argmax()), rest[worst].shape)
    beyond = sum(value > LARGEST_RESIDUAL for value in largest)
    return (
        f"the bases are more than {LARGEST_RESIDUAL} rad (or m) from {beyond} of {len(rest)} "
        f"demonstrations; furthest is demonstration {worst}, {recorded.joint_names[joint]}, at "
        f"phase {recorded[worst].phases[sample]:.2f}: {largest[worst]:.3f}. More --bases follow "
        "closer; a demonstration that jumps or pauses is better left out"
    )


def _cuts(recording: dict[str, Any]) -> Iterator[str]:
    """Lines about the motions in a bag: begin and end of each, and whether it was left out."""
    cuts = recording["cuts"]
    found = [cut for cut in cuts if cut["demonstration"]]
    yield (
        f"{len(found)} demonstrations in {recording['messages']} messages of "
        f"{recording['topic']}, cut where the arm stands still:"
    )
    for cut in cuts:
        words = "" if cut["demonstration"] else ", left out: too small"
        words += "" if cut["whole"] else ", the recording begins, ends or has a gap in it"
        yield f"  {cut['start']:.2f} to {cut['end']:.2f} s, range {cut['motion']:.3f}{words}"


def _shown(document: dict[str, Any]) -> Shown:
    from rich.text import Text

    if document["recording"] is not None:
        yield from _cuts(document["recording"])
    held_out, count = document["held_out_residual"], document["bases"]
    chosen = f", cross-validated (held-out RMS {held_out[count]:.4f})" if held_out else ""
    yield (
        f"learnt {len(document['joints'])} joints from {document['demonstrations']} "
        f"demonstrations ({document['samples']} samples) with {count} bases a joint{chosen}"
    )
    table = grid(("residual, rad or m",), ("RMS", "largest"))
    residual = document["residual"]
    for name, row in [*residual["joints"].items(), ("all", residual)]:
        table.add_row(Text(name), f"{row['rms']:.4f}", f"{row['largest']:.4f}")
    yield table
    files = [name for name in (document["file"], document["figure"]) if name is not None]
    yield f"wrote {' and '.join(files)}"
