"""A robot of a description: its chain, covers and pairs, with what a robot file adds."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.core.errors import InvalidRobotError
from optipromp.core.robots.description import Arm, LeftOut, LinkGeometry
from optipromp.core.robots.library import Choice
from optipromp.core.robots.model import BodySpheres, Robot
from optipromp.core.robots.resolved import MOST_JOINTS, MOST_SPHERES
from optipromp.readers.arm import choose_arm
from optipromp.readers.chain import Chain, serial_chain
from optipromp.readers.covers import Cover, cover_links, finer_cover, stands_on_its_plane
from optipromp.readers.inertials import dynamics
from optipromp.readers.robot_file import RobotFile
from optipromp.readers.self_collision import telescopes, with_self_pairs
from optipromp.readers.srdf import disabled_pairs, read_srdf, srdf_beside
from optipromp.readers.urdf import UrdfModel


def build(
    entry: RobotFile, model: UrdfModel, path: Path, choice: Choice, srdf: Path | None
) -> Robot:
    """The robot of a model with what the robot file ``entry`` adds, and an SRDF.

    Args:
        entry: of a robot file, or of a bare description.
        model: of the description.
        path: of the robot file or of the description.
        choice: of the caller.
        srdf: the one given; without it one beside the description is read.

    Raises:
        InvalidRobotError: these do not fit together.
    """
    srdf = srdf or srdf_beside(model)
    arm = _chosen(entry, model, choice, srdf)
    chain = serial_chain(model, arm.tip, arm.base, {**entry.hold, **choice.hold})
    names = chain.joint_names
    if len(chain.kinematics.kind) > MOST_JOINTS:
        raise InvalidRobotError(
            f"{path}: the arm has {len(chain.kinematics.kind)} joints: must have at most "
            f"{MOST_JOINTS}; choose a base or a tip, or hold some"
        )
    n = len(names)
    unlimited = np.full(n, np.inf)
    home = _per_joint(
        path, "home", entry.home, names, np.clip(np.zeros(n), chain.lower, chain.upper)
    )
    outside = np.flatnonzero((home < chain.lower) | (home > chain.upper))
    if len(outside):
        i = int(outside[0])
        raise InvalidRobotError(
            f"{path}: home of joint '{names[i]}' is {home[i]:g}, outside its limits "
            f"[{chain.lower[i]:g}, {chain.upper[i]:g}]"
        )
    known = set(model.links)
    for link in (*entry.spheres, *(link for pair in entry.allow_self for link in pair)):
        if link not in known:
            shown = ", ".join(list(model.links)[:20])
            raise InvalidRobotError(f"{path}: unknown link '{link}'; links: {shown}")
    covers = _covers(entry, model, chain, arm.base)
    robot = Robot(
        name=entry.name,
        joint_names=names,
        lower=chain.lower,
        upper=chain.upper,
        velocity=_per_joint(path, "velocity", entry.velocity, names, chain.velocity),
        acceleration=_per_joint(path, "acceleration", entry.acceleration, names, unlimited),
        jerk=_per_joint(path, "jerk", entry.jerk, names, unlimited),
        kinematics=chain.kinematics,
        spheres=_body_spheres(entry, model, chain, covers),
        link_names=tuple(model.links),
        self_pairs=frozen(np.zeros((0, 2)), np.int64),
        self_slack=frozen(np.zeros(0)),
        flange_rotation=frozen(chain.flange.rotation),
        flange_translation=frozen(chain.flange.translation),
        tool_point=frozen(chain.flange.translation),
        tool_axis=frozen(chain.flange.rotation[:, 2]),
        gripper_radius=0.0,
        home=home,
        held_joints=chain.held_joints,
        excess=_excess(covers),
        geometry=tuple(
            LinkGeometry(
                link,
                place.segment,
                place.rotation,
                place.translation,
                shapes,
                model.path,
                model.links[link].visuals,
            )
            for link, place in chain.placements.items()
            if (shapes := model.links[link].collisions or model.links[link].visuals)
        ),
        dynamics=dynamics(model, chain),
        arm=arm,
    )
    disabled = [] if srdf is None else disabled_pairs(srdf, model)

    def finer(robot: Robot, loose: IntArray) -> tuple[Robot, FloatArray]:
        for index in np.unique(robot.spheres.link[loose]):
            link, own = robot.link_names[index], np.flatnonzero(robot.spheres.link == index)
            split = np.flatnonzero(np.isin(own, loose)).tolist()
            covers[link] = finer_cover(model, link, covers[link], split)
        spheres = _body_spheres(entry, model, chain, covers)
        return replace(robot, spheres=spheres, excess=_excess(covers)), _parts(covers, chain)

    sliding = [pair for pair in telescopes(robot) if not {pair, pair[::-1]} & {*disabled}]
    allowed = [*entry.allow_self, *disabled, *sliding]
    robot = with_self_pairs(robot, allowed, _parts(covers, chain), finer)
    given = [LeftOut(a, b, "robot file") for a, b in entry.allow_self]
    given += [LeftOut(a, b, srdf.name) for a, b in disabled if srdf is not None]
    given += [LeftOut(a, b, "slide along one direction") for a, b in sliding]
    return replace(robot, left_out=(*given, *robot.left_out))


def _chosen(entry: RobotFile, model: UrdfModel, choice: Choice, srdf: Path | None) -> Arm:
    tip, base = choice.tip or entry.flange, choice.base or entry.base
    if tip is not None:
        return choose_arm(model, tip, base)
    return choose_arm(model, None, base, None if srdf is None else read_srdf(srdf))


def _per_joint(
    path: Path, key: str, given: list[float] | None, names: tuple[str, ...], default: FloatArray
) -> FloatArray:
    if given is not None and len(given) != len(names):
        raise InvalidRobotError(
            f"{path}: {key} has {len(given)} values; the chain has {len(names)} joints "
            f"({', '.join(names[:20])})"
        )
    return frozen(default if given is None else given)


def _covers(entry: RobotFile, model: UrdfModel, chain: Chain, base: str) -> dict[str, Cover]:
    """What covers each link: the spheres that the robot file gives, or a cover of its geometry."""
    bare = {link: at for link, at in chain.placements.items() if link not in entry.spheres}
    still = [link for link, at in bare.items() if at.segment < 0 and link != base]
    fitted = cover_links(model, bare, still)
    given = {link: np.array(rows, dtype=float) for link, rows in entry.spheres.items()}
    covers = fitted | {link: Cover(rows, math.nan) for link, rows in given.items()}
    return {link: covers[link] for link in chain.placements}


def _excess(covers: dict[str, Cover]) -> dict[str, float]:
    """How far each fitted cover reaches beyond its link [m]."""
    known = {link: cover.excess for link, cover in covers.items() if len(cover.spheres)}
    return {link: excess for link, excess in known.items() if math.isfinite(excess)}


def _parts(covers: dict[str, Cover], chain: Chain) -> FloatArray:
    """The parts (c, 4) of all covers, in the frames of the segments; see :class:`Parts`."""
    first, out = 0, [np.zeros((0, 4))]
    for link, cover in covers.items():
        place, own = chain.placements[link], cover.parts
        at = own[:, :3] @ place.rotation.T + place.translation
        out.append(np.column_stack([at, own[:, 3] + first]))
        first += len(cover.spheres)
    return np.concatenate(out)


def _body_spheres(
    entry: RobotFile, model: UrdfModel, chain: Chain, covers: dict[str, Cover]
) -> BodySpheres:
    segment, center, radius, link = [], [np.zeros((0, 3))], [np.zeros(0)], []
    standing = stands_on_its_plane(covers, chain.placements)
    for index, (name, place) in enumerate(chain.placements.items()):
        cover = covers[name].spheres
        if not len(cover):
            continue
        if place.driver:
            raise InvalidRobotError(
                f"{model.path}: link '{name}' hangs on joint '{place.driver}', off the chain and "
                "driven by a joint of the chain; only a serial chain moves. Choose another flange, "
                f"or give '{name}' no spheres in a robot file (spheres: {{{name}: []}})"
            )
        placed = cover[:, :3] @ place.rotation.T + place.translation
        if standing and place.segment < 0 and len(covers[name].parts):
            placed[:, 2] = np.maximum(placed[:, 2], cover[:, 3])
        center.append(placed)
        radius.append(cover[:, 3])
        segment += [place.segment] * len(cover)
        link += [index] * len(cover)
    if not segment and not entry.spheres:
        raise InvalidRobotError(
            f"{model.path}: no link has collision or visual geometry, so nothing could be kept off "
            "an obstacle; give spheres in a robot file"
        )
    if len(segment) > MOST_SPHERES:
        raise InvalidRobotError(
            f"{model.path}: {len(segment)} spheres cover it: must be at most {MOST_SPHERES}; give "
            "its links fewer in a robot file"
        )
    carrier = np.array(segment, dtype=np.int64)
    return BodySpheres(
        segment=frozen(carrier, np.int64),
        center=frozen(np.concatenate(center)),
        radius=frozen(np.concatenate(radius)),
        link=frozen(link, np.int64),
        distal=frozen(carrier == len(chain.kinematics.kind) - 1, np.bool_),
    )
