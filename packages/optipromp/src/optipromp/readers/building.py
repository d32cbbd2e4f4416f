"""The robot of a description: arm, chain, covers of the links, and self-collision pairs.

Covers are spheres that enclose the geometry of links, and reach little beyond it.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frozen
from optipromp.core.errors import InvalidRobotError, printable
from optipromp.core.processes import in_threads
from optipromp.core.robots.description import (
    LeftOut,
    LinkGeometry,
    LinkShape,
    mesh_file,
    mesh_name,
    rotation_of,
)
from optipromp.core.robots.library import Choice
from optipromp.core.robots.model import BodySpheres, Dynamics, Robot
from optipromp.core.robots.resolved import MOST_JOINTS, MOST_SPHERES
from optipromp.core.robots.tool_geometry import cover_box, cover_capsule, cover_cylinder
from optipromp.readers import self_collision
from optipromp.readers.arm import Srdf, choose_arm, linkages, read_srdf, srdf_beside
from optipromp.readers.chain import Chain, serial_chain
from optipromp.readers.fit import MOST_SAMPLES, count_samples, finer, fit_covers
from optipromp.readers.packages import MOST_TRIANGLES, triangles
from optipromp.readers.robot_file import GROWTH, SLIDE, TURN, RobotFile
from optipromp.readers.urdf import SMALLEST, UrdfModel

LOOSE = 0.030  # [m] chosen: excess above which the cover of a mesh gets further spheres
FIXED = 0.060  # [m] chosen: that excess for links that do not move, except the arm's base
PER_MESH = 7.5  # spheres, chosen: mean over the meshes of a robot, 60 for eight links
SHRUNK = 0.3  # chosen: share of the size of what is shown that a link's collision shapes have
FAST_TURN = 50.0  # [rad/s] chosen: a larger limit is in degrees; SCARA wrists reach 45
FAST_SLIDE = 20.0  # [m/s] chosen: a larger limit is in millimetres
MOUNTED = 0.005  # [m] chosen: distance of the lowest fixed point from z = 0, at most, if mounted


class Cover(NamedTuple):
    """Spheres (k, 4), centres and radii [m], and their excess: the largest distance [m] by which
    they reach beyond the geometry.

    ``parts`` (c, 4): see :class:`optipromp.readers.self_collision.Parts`; empty for spheres of
    a robot file.
    """

    spheres: FloatArray
    excess: float
    parts: FloatArray = np.zeros((0, 4))


class Covered(NamedTuple):
    """The key of a cover: kind and size of a shape, its mesh, and whether its link is fixed."""

    kind: str
    size: tuple[float, ...]
    mesh: Path | None
    fixed: bool


def cover_links(
    model: UrdfModel, links: Collection[str], fixed: Collection[str]
) -> dict[str, Cover]:
    """Covers of the links, in their frames, over their collision geometry or else their visual.

    Covers of ``fixed`` links are coarser.
    """
    shapes = {link: model.links[link].collisions or model.links[link].visuals for link in links}
    first, key_of = dict[Covered, tuple[str, LinkShape]](), {}
    for link, shape in ((name, each) for name in links for each in shapes[name]):
        mesh = mesh_file(model.path, link, shape) if shape.kind == "mesh" else None
        key_of[link, shape] = key = Covered(shape.kind, shape.size, mesh, link in fixed)
        first.setdefault(key, (link, shape))  # alike shapes are covered once
    of_key = dict(zip(first, _made(model, first), strict=True))
    covers = {}
    for link, own in shapes.items():
        shown = [(of_key[key_of[link, one]], one) for one in own]
        placed = [_placed(cover.spheres, shape) for cover, shape in shown]
        before = np.cumsum([0, *[len(spheres) for spheres in placed]])
        surfaces = [
            _placed(cover.parts, shape) + [0.0, 0.0, 0.0, first]
            for (cover, shape), first in zip(shown, before[:-1], strict=True)
        ]
        covers[link] = Cover(
            np.concatenate([np.zeros((0, 4)), *placed]),
            max((cover.excess for cover, _ in shown), default=0.0),
            np.concatenate([np.zeros((0, 4)), *surfaces]),
        )
    return covers


def _made(model: UrdfModel, shapes: Mapping[Covered, tuple[str, LinkShape]]) -> list[Cover]:
    """The cover of each shape, in its frame and in the order of ``shapes``.

    The number of spheres is shared among all meshes, so that their covers have about equal excess.
    """
    solids, count = list[FloatArray](), 0
    for link, shape in shapes.values():
        solids.append(_surface(model, link, shape))
        count += len(solids[-1])
        _check_fineness(mesh_name(model.path, link, shape), solids[-1], count)
    meshes = [i for i, key in enumerate(shapes) if key.mesh is not None]
    loose = [FIXED if key.fixed else LOOSE for key in shapes if key.mesh is not None]
    fitted = fit_covers([solids[i] for i in meshes], PER_MESH, loose) if meshes else []
    of_mesh = dict(zip(meshes, fitted, strict=True))
    spheres = [
        of_mesh[i] if i in of_mesh else _cover(shape, LOOSE if key.fixed else 0.0)
        for i, (key, (_, shape)) in enumerate(shapes.items())
    ]
    own = in_threads(self_collision.parts_of_cover, [centers for centers, _ in spheres], solids)
    return [Cover(*cover, part) for cover, part in zip(spheres, own, strict=True)]


def _check_fineness(where: str, surface: FloatArray, count: int) -> None:
    """Refuse a robot of more than MOST_TRIANGLES, and a surface that folds without end."""
    if count > MOST_TRIANGLES:
        raise InvalidRobotError(
            f"{where}: with it the robot's meshes have {count} triangles: must have at most "
            f"{MOST_TRIANGLES}; simplify them, or give the link spheres in a robot file"
        )
    if (points := count_samples(surface)) > MOST_SAMPLES:
        raise InvalidRobotError(
            f"{where}: its triangles are as large as {points / MOST_SAMPLES:.0f} times what can be "
            "covered: it folds over and over; simplify it"
        )


def _surface(model: UrdfModel, link: str, shape: LinkShape) -> FloatArray:
    """The triangles (f, 3, 3) [m] of a shape, in its frame."""
    if shape.kind == "mesh":
        return triangles(model.path, link, shape)
    if shape.kind == "box":
        return self_collision.of_box(np.array(shape.size))
    if shape.kind == "sphere":
        return self_collision.of_rod(shape.size[0], 0.0, shape.size[0])
    radius, length = shape.size
    return self_collision.of_rod(radius, length, radius if shape.kind == "capsule" else 0.0)


def _cover(shape: LinkShape, bulge: float) -> tuple[FloatArray, float]:
    """The spheres (k, 4) of a primitive, and their excess [m]: radius minus depth of the centre.

    The spheres may reach beyond the primitive by ``bulge`` [m] or its :func:`allowance`, whichever
    is larger.
    """
    if shape.kind == "sphere":
        radius = shape.size[0]
        return np.array([[0.0, 0.0, 0.0, radius]]), 0.0
    if shape.kind == "box":
        spheres = cover_box(np.array(shape.size), max(bulge, allowance(min(shape.size) / 2.0)))
        depth = (np.array(shape.size) / 2.0 - np.abs(spheres[:, :3])).min(axis=1)
        return spheres, float((spheres[:, 3] - depth).max())
    radius, length = shape.size
    if shape.kind == "cylinder":
        spheres = cover_cylinder(radius, length, max(bulge, allowance(min(radius, length / 2.0))))
        side = radius - np.hypot(spheres[:, 0], spheres[:, 1])
        depth = np.minimum(side, length / 2.0 - np.abs(spheres[:, 2]))
        return spheres, float((spheres[:, 3] - depth).max())
    tip = np.array([0.0, 0.0, length / 2.0])
    spheres = cover_capsule(-tip, tip, radius, max(bulge, allowance(radius)))
    return spheres, float((spheres[:, 3] - radius).max())


def allowance(half_width: float) -> float:
    """The distance [m] by which a cover may exceed a primitive: 0.01 m or 0.2 half widths."""
    return max(0.01, 0.2 * half_width)


def _placed(cover: FloatArray, shape: LinkShape) -> FloatArray:
    """Rows (k, 4) of a cover, moved from the shape's frame to the link's."""
    centers = cover[:, :3] @ rotation_of(shape.rpy).T + np.array(shape.xyz)
    return np.column_stack([centers, cover[:, 3:]])


def build(
    entry: RobotFile, model: UrdfModel, path: Path, choice: Choice, srdf: Path | None
) -> Robot:
    """The robot of a model, with what a robot file and an SRDF add.

    ``entry``: of a bare description its name and path only. ``path``: the file that messages name.
    ``choice``: precedes that of ``entry``. ``srdf``: None: the SRDF beside the description, if any.
    """
    if (name := printable(entry.name)) != entry.name:
        raise InvalidRobotError(f"{path}: the robot's name '{name[:60]}' holds control characters")
    srdf = srdf or srdf_beside(model)
    said = None if srdf is None else read_srdf(srdf)
    tip, base = choice.tip or entry.flange, choice.base or entry.base
    named = choice.arm
    if named is not None and choice.tip is None and choice.base is None:
        tip = base = None  # the caller's choice precedes that of the file
    arm = choose_arm(model, tip, base, said if tip is None else None, named)
    chain = serial_chain(model, arm.tip, arm.base, {**entry.hold, **choice.hold})
    if len(chain.kinematics.kind) > MOST_JOINTS:
        raise InvalidRobotError(
            f"{path}: the arm has {len(chain.kinematics.kind)} joints: must have at most "
            f"{MOST_JOINTS}; choose a base or a tip, or hold some"
        )
    for joint in said.passive if said else ():
        if joint in chain.joint_names:
            raise InvalidRobotError(
                f"{path}: {srdf} calls joint '{joint}' of the arm passive: nothing drives it; "
                f"choose a tip before it, such as {model.joints[joint].parent} (--tip)"
            )
    home = _home(entry, chain, path)
    for link in (*entry.spheres, *(link for pair in entry.allow_self for link in pair)):
        if link not in model.links:
            shown = ", ".join(list(model.links)[:20])
            raise InvalidRobotError(f"{path}: unknown link '{link}'; links: {shown}")
    covers = _covers(entry, model, chain, arm.base)
    names = chain.joint_names
    slides = chain.kinematics.dof[chain.kinematics.kind == 1].tolist()
    assumed = np.array([SLIDE if k in slides else TURN for k in range(len(names))])
    fastest = _per_joint(path, "acceleration", entry.acceleration, names, assumed)
    geometry = []
    for link, (segment, turn, at, _, rigid) in chain.placements.items():
        looks = model.links[link].visuals
        shapes = model.links[link].collisions or looks
        geometry.append(LinkGeometry(link, segment, turn, at, shapes, model.path, looks, rigid))
    robot = Robot(  # with a bare flange and no self-collision pairs
        name=entry.name,
        joint_names=names,
        lower=chain.lower,
        upper=chain.upper,
        velocity=_per_joint(path, "velocity", entry.velocity, names, chain.velocity),
        acceleration=fastest,
        jerk=_per_joint(path, "jerk", entry.jerk, names, GROWTH * fastest),
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
        geometry=tuple(geometry),
        dynamics=dynamics(model, chain),
        arm=arm,
    )
    robot = _with_pairs(robot, entry, model, chain, covers, said)
    told = [words.removeprefix(str(model.path)) for words in _told(robot, entry, model) if words]
    return replace(robot, told=tuple(told))


def _told(robot: Robot, entry: RobotFile, model: UrdfModel) -> Iterator[str]:
    """The warnings of a robot and of its description, each after its path or empty."""
    moving = [model.joints[name] for name in robot.joint_names]
    yield from (model.told, linkages(model, robot), *(joint.told for joint in moving))
    yield from (joint.remark for joint in moving if entry.velocity is None)
    names = np.array(robot.joint_names)
    most = np.where([j.kind == "prismatic" for j in moving], FAST_SLIDE, FAST_TURN)
    fast = (robot.velocity > most) & np.isfinite(robot.velocity)
    for found, words in (
        (robot.lower == robot.upper, "cannot move: both limits are the same"),
        (fast, f"may move at {robot.velocity[fast].max(initial=0):g} rad/s or m/s: degrees or mm?"),
    ):
        yield f": {', '.join(names[found])} {words}" if found.any() else ""
    for name, link in model.links.items():
        if name in entry.spheres or not (link.collisions and link.visuals):
            continue
        with suppress(InvalidRobotError):  # of a mesh that is only shown
            solid, shown = (_solid(model, name, each) for each in (link.collisions, link.visuals))
            wide = np.maximum(np.ptp(shown, axis=(0, 1)), SMALLEST)
            share = float((np.ptp(solid, axis=(0, 1)) / wide).min())
            if share < SHRUNK:
                yield (
                    f": link '{name}' is solid in {100 * share:.2g} % of the width that is shown: "
                    "only what is solid is kept clear; give it spheres in a robot file"
                )


def _solid(model: UrdfModel, link: str, shapes: Sequence[LinkShape]) -> FloatArray:
    """The triangles (f, 3, 3) [m] of some shapes of a link, in its frame."""
    placed = (_surface(model, link, of) @ rotation_of(of.rpy).T + np.array(of.xyz) for of in shapes)
    return np.concatenate(list(placed))


def _home(entry: RobotFile, chain: Chain, path: Path) -> FloatArray:
    """The home (n,) of the robot file, else the configuration within the limits nearest to zero."""
    names, lower, upper = chain.joint_names, chain.lower, chain.upper
    home = _per_joint(path, "home", entry.home, names, np.clip(np.zeros(len(names)), lower, upper))
    outside = np.flatnonzero((home < lower) | (home > upper))
    if len(outside):
        i = int(outside[0])
        raise InvalidRobotError(
            f"{path}: home of joint '{names[i]}' is {home[i]:g}, outside its limits "
            f"[{lower[i]:g}, {upper[i]:g}]"
        )
    return home


def _with_pairs(
    robot: Robot,
    entry: RobotFile,
    model: UrdfModel,
    chain: Chain,
    covers: dict[str, Cover],
    srdf: Srdf | None,
) -> Robot:
    """The robot with its self-collision pairs; ``covers`` of loose spheres are made finer."""
    disabled = [] if srdf is None else [p for p in srdf.disabled if model.links.keys() >= set(p)]
    slides = [p for p in self_collision.telescopes(robot) if not {p, p[::-1]} & set(disabled)]
    left_out = [("robot file", pair) for pair in entry.allow_self]
    left_out += [(srdf.path.name, pair) for pair in disabled if srdf]
    left_out += [("slide along one direction", pair) for pair in slides]

    def halved(robot: Robot, loose: IntArray) -> tuple[Robot, FloatArray]:
        for index in np.unique(robot.spheres.link[loose]):
            link = robot.link_names[index]
            surface = _solid(model, link, model.links[link].collisions or model.links[link].visuals)
            of_link = np.flatnonzero(robot.spheres.link == index)
            split = np.flatnonzero(np.isin(of_link, loose)).tolist()
            balls, excess = finer(surface, covers[link].spheres, split)
            own = self_collision.parts_of_cover(balls, surface)
            covers[link] = Cover(balls, excess, own)
        spheres = _body_spheres(entry, model, chain, covers)
        return replace(robot, spheres=spheres, excess=_excess(covers)), _parts(covers, chain)

    allowed = [pair for _, pair in left_out]
    robot = self_collision.with_self_pairs(robot, allowed, _parts(covers, chain), halved)
    by_choice = [LeftOut(*pair, why) for why, pair in left_out]
    return replace(robot, left_out=(*by_choice, *robot.left_out))


def _per_joint(
    path: Path, key: str, stated: list[float] | None, names: tuple[str, ...], default: FloatArray
) -> FloatArray:
    """The values (n,) that the robot file states under ``key``, else ``default``.

    Infinite ones where it states limits that are empty.
    """
    if stated == [] and key in ("acceleration", "jerk"):
        return frozen(np.full(len(names), np.inf))
    if stated is not None and len(stated) != len(names):
        raise InvalidRobotError(
            f"{path}: {key} has {len(stated)} values; the chain has {len(names)} joints "
            f"({', '.join(names[:20])})"
        )
    return frozen(default if stated is None else stated)


def _covers(entry: RobotFile, model: UrdfModel, chain: Chain, base: str) -> dict[str, Cover]:
    """The cover of each link: spheres of the robot file, else spheres fitted to its geometry."""
    bare = {link: at for link, at in chain.placements.items() if link not in entry.spheres}
    still = [link for link, at in bare.items() if at.segment < 0 and link != base]
    fitted = cover_links(model, bare, still)
    covers = fitted | {
        link: Cover(np.array(rows, dtype=float), math.nan) for link, rows in entry.spheres.items()
    }
    return {link: covers[link] for link in chain.placements}


def _excess(covers: dict[str, Cover]) -> dict[str, float]:
    """The distance [m] by which each fitted cover reaches beyond its link."""
    return {
        link: cover.excess
        for link, cover in covers.items()
        if len(cover.spheres) and math.isfinite(cover.excess)
    }


def _parts(covers: dict[str, Cover], chain: Chain) -> FloatArray:
    """The parts (c, 4) of all covers, in the frames of the segments; see :class:`Parts`."""
    first, out = 0, [np.zeros((0, 4))]
    for link, cover in covers.items():
        place = chain.placements[link]
        points = cover.parts[:, :3] @ place.rotation.T + place.translation
        out.append(np.column_stack([points, cover.parts[:, 3] + first]))
        first += len(cover.spheres)
    return np.concatenate(out)


def _body_spheres(
    entry: RobotFile, model: UrdfModel, chain: Chain, covers: dict[str, Cover]
) -> BodySpheres:
    """The spheres of all links in the frames of their segments."""
    segment, center, radius, link = [], [np.zeros((0, 3))], [np.zeros(0)], []
    lowest = [  # of each fixed link
        float((surface @ place.rotation[2]).min() + place.translation[2])
        for name, place in chain.placements.items()
        if place.segment < 0 and len(surface := covers[name].parts[:, :3])
    ]
    # a table that the robot stands on does not count as touched: covers are raised over it
    standing = abs(min(lowest, default=np.inf)) <= MOUNTED
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


def dynamics(model: UrdfModel, chain: Chain) -> Dynamics:
    """The dynamics of a chain; the inertials of links add up by the parallel-axis theorem."""
    count = len(chain.effort)
    mass, center, inertia = np.zeros(count), np.zeros((count, 3)), np.zeros((count, 3, 3))
    whole = np.ones(count, dtype=bool)
    bodies = [
        (place, given)
        for name, place in chain.placements.items()
        if place.segment >= 0 and (given := model.links[name].inertial) and given.mass > 0.0
    ]
    middles = [p.rotation @ np.array(given.xyz) + p.translation for p, given in bodies]
    for (place, given), middle in zip(bodies, middles, strict=True):
        mass[place.segment] += given.mass
        center[place.segment] += given.mass * middle
    center[mass > 0.0] /= mass[mass > 0.0, None]
    for (place, given), middle in zip(bodies, middles, strict=True):
        if given.tensor is None:
            whole[place.segment] = False
            continue
        xx, xy, xz, yy, yz, zz = given.tensor
        turn, off = place.rotation @ rotation_of(given.rpy), middle - center[place.segment]
        own = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        inertia[place.segment] += own + given.mass * (off @ off * np.eye(3) - np.outer(off, off))
    inertia[~whole] = 0.0
    return Dynamics(frozen(chain.effort), frozen(mass), frozen(center), frozen(inertia))
