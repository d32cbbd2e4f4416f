"""Robots by name or by file: a bare URDF, or a YAML file beside one."""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from optipromp.arrays import FloatArray, IntArray, frozen
from optipromp.errors import InvalidRobotError
from optipromp.files import is_file
from optipromp.robots.arm import Arm, choose_arm
from optipromp.robots.chain import Chain, serial_chain
from optipromp.robots.dynamics import dynamics
from optipromp.robots.kept_covers import Cover
from optipromp.robots.kept_mjcf import mjcf_files
from optipromp.robots.meshes import mesh_files
from optipromp.robots.mjcf import is_mjcf, read_mjcf
from optipromp.robots.model import BodySpheres, LeftOut, LinkGeometry, Robot
from optipromp.robots.packages import (
    Check,
    expanded,
    meshes_found,
    only_inside,
    with_meshes_found,
)
from optipromp.robots.robot_file import RobotFile, read_robot_file
from optipromp.robots.self_collision import telescopes, with_self_pairs
from optipromp.robots.spheres import cover_links, finer_cover, stands_on_its_plane
from optipromp.robots.srdf_groups import read_srdf
from optipromp.robots.touching import disabled_pairs, srdf_beside, srdf_files
from optipromp.robots.urdf import UrdfModel, read_urdf

SAME_JOINTS = (
    1e-4  # [m or -] chosen: joints of one robot differ less between files (rounded angles)
)
MOST_JOINTS = 200  # that move, of an arm, chosen: their frames at 20,000 configurations take 0.4 GB
MOST_SPHERES = 2_000  # chosen: their pairs take 0.5 GB and 40 s
_DATA = Path(__file__).resolve().parent / "data"


@lru_cache
def robot_names() -> tuple[str, ...]:
    """The built-in robots."""
    return tuple(sorted(path.stem for path in _DATA.glob("*.yaml")))


@dataclass(frozen=True)
class Choice:
    """What a caller chooses of a robot file or URDF; None leaves it to the file, then to the rule.

    ``tip``: the flange link; ``base``: the link the arm begins at; ``srdf``: a file of groups;
    ``hold``: values [rad or m] of joints that are not of the arm, such as fingers;
    ``package_dirs``: folders that hold packages. Relative paths start where the robot's does.
    ``untrusted``: a file or a message named the robot, not the user. Its files must then lie where
    that file's may, and no xacro is expanded. It is no choice: two that differ in it are equal.
    """

    tip: str | None = None
    base: str | None = None
    srdf: str | Path | None = None
    hold: Mapping[str, float] = field(default_factory=dict)
    package_dirs: tuple[str | Path, ...] = ()
    untrusted: bool = field(default=False, repr=False, compare=False)


NOTHING = Choice()
UNTRUSTED = Choice(untrusted=True)


def load_robot(
    name_or_path: str | Path,
    base_dir: Path | None = None,
    *,
    tip: str | None = None,
    base: str | None = None,
    srdf: str | Path | None = None,
    hold: Mapping[str, float] | None = None,
    package_dirs: Sequence[str | Path] = (),
) -> Robot:
    """A robot without a tool: a built-in one by name, or from a ``.urdf``, xacro, MJCF (``.xml``)
    or robot file.

    A bare URDF has its arm chosen by :func:`optipromp.robots.arm.choose_arm` and spheres from its
    geometry; accelerations and jerks are unlimited; home is zero, or the limits nearest to it.
    Files that have not changed since this process read them are not read again.

    Args:
        name_or_path: of the robot; a relative path starts at ``base_dir``.
        base_dir: default: the working directory.
        tip: the flange link.
        base: the link that the arm begins at; joints before it are held.
        srdf: an SRDF whose groups tell the arm; without it one beside the URDF is read.
        hold: values [rad or m] of joints that are not of the arm, such as the fingers of a gripper;
            the others stand at zero, or at the limit nearest to it.
        package_dirs: folders that hold the packages of ``package://`` names, or are such; searched
            before those over the URDF, on AMENT_PREFIX_PATH and on ROS_PACKAGE_PATH.

    Raises:
        InvalidRobotError: no such robot (the message lists the built-in names), a description that
            cannot be used, a xacro that a robot file names and
            :data:`optipromp.files.ALLOW_XACRO` does not allow, or several arms that are
            alike (the message lists them).
    """
    return load_arm(
        name_or_path, base_dir, Choice(tip, base, srdf, hold or {}, tuple(package_dirs))
    )[0]


def load_arm(
    name_or_path: str | Path, base_dir: Path | None = None, choice: Choice = NOTHING
) -> tuple[Robot, Arm]:
    """As :func:`load_robot`, with the arm that was chosen, why, and what else there is."""
    if isinstance(name_or_path, str) and name_or_path in robot_names():
        if choice != NOTHING:
            raise InvalidRobotError(
                f"robot '{name_or_path}' is built in: it takes no tip, base, srdf, hold or packages"
            )
        return _built_in(name_or_path)
    folder = base_dir or Path()
    given = tuple(folder / each for each in choice.package_dirs)
    choice = replace(
        choice,
        srdf=None if choice.srdf is None else folder / choice.srdf,
        package_dirs=given,
    )
    check, seen = only_inside(base_dir, given) if choice.untrusted else (Path, "")
    path = folder / name_or_path
    suffix = path.suffix.lower()
    names = ", ".join(robot_names())
    if suffix not in (".urdf", ".xacro", ".xml", ".mjcf", ".yaml", ".yml"):
        raise InvalidRobotError(
            f"no robot '{name_or_path}'; built-in: {names}; "
            "or the path of a .urdf, .xacro, .xml (MJCF) or .yaml file"
        )
    if not is_file(check(path)):
        raise InvalidRobotError(f"{path}: no such file; built-in robots: {names}")
    return _from_file(path, choice, check, seen)


@lru_cache
def _built_in(name: str) -> tuple[Robot, Arm]:
    return _from_file(_DATA / f"{name}.yaml", NOTHING, Path, "")


def built_in_twin(robot: Robot) -> str | None:
    """The built-in robot with the joints of ``robot``: their names, order, kinds, axes and places.

    The name of the robot does not count, nor do its flange, tool, limits and body.
    """
    for name in robot_names():
        other = load_robot(name)
        if other.joint_names == robot.joint_names and all(
            mine.shape == theirs.shape and np.allclose(mine, theirs, rtol=0.0, atol=SAME_JOINTS)
            for mine, theirs in zip(robot.kinematics, other.kinematics, strict=True)
        ):
            return name
    return None


def files_of(name_or_path: str | Path, choice: Choice = NOTHING) -> list[Path]:
    """The files and folders that a scene reads which names this robot with this choice.

    Raises InvalidRobotError as :func:`load_robot`.
    """
    seen = list[Path]()

    def check(path: Path) -> Path:
        seen.append(path)
        return path

    path = Path(name_or_path)
    entry = RobotFile(format=1, name=path.stem, urdf=path.name)
    if path.suffix.lower() in (".yaml", ".yml"):
        entry = read_robot_file(path)
    _read(entry, path, choice, check)
    given = [*([choice.srdf] if choice.srdf else []), *choice.package_dirs]
    return list(dict.fromkeys([path, *seen, *map(Path, given)]))


Stamps = tuple[tuple[Path, tuple[int, int] | None], ...]
_held: dict[str, tuple[UrdfModel, list[Path], Stamps, tuple[Robot, Arm]]] = {}
_HELD = 16  # robots


def _from_file(path: Path, choice: Choice, check: Check, seen: str) -> tuple[Robot, Arm]:
    """The robot of a file: the one that was read before, unless a file of it has changed.

    ``seen``: what ``check`` depends on.
    """
    key = f"{path.absolute()} {choice}{seen}"
    if held := _held.get(key):
        model, files, stamps, out = held
        if stamps == _stamps([*files, *srdf_files(model)]):
            return out
    if path.suffix.lower() not in (".yaml", ".yml"):
        entry = RobotFile(format=1, name=path.stem, urdf=path.name)
        model = _read(entry, path, choice, check)
        entry = entry.model_copy(update={"name": model.name})
    else:
        entry = read_robot_file(path)
        model = _read(entry, path, choice, check)
    bare = [name for name in model.links if name not in entry.spheres]
    groups = _given_srdf(entry, path, choice)
    named = mjcf_files(model.path) if is_mjcf(model.path) else [model.path]
    files = [path, *(named or ()), *([groups] if groups else []), *mesh_files(model, bare)]
    stamps = _stamps([*files, *srdf_files(model)])
    out = _build(entry, model, path, choice)
    if named is not None and model.path.suffix.lower() != ".xacro":  # it may include others
        while len(_held) >= _HELD:
            _held.pop(next(iter(_held)), None)
        _held[key] = model, files, stamps, out
    return out


def _stamps(files: list[Path]) -> Stamps:
    """Time and size of each file; None for one that is not there."""
    out: list[tuple[Path, tuple[int, int] | None]] = []
    for file in files:
        try:
            status = file.stat()
        except OSError:
            out.append((file, None))
        else:
            out.append((file, (status.st_mtime_ns, status.st_size)))
    return tuple(out)


def _read(entry: RobotFile, path: Path, choice: Choice, check: Check) -> UrdfModel:
    """The model of the entry of a robot file at ``path``, the meshes that cover it found."""
    for name in (entry.urdf, *([entry.srdf] if entry.srdf else []), *entry.package_dirs):
        check(path.parent / name)
    folders = [*choice.package_dirs, *(path.parent / each for each in entry.package_dirs)]
    package_dirs = [Path(folder) for folder in folders]
    urdf = path.parent / entry.urdf
    if is_mjcf(urdf):
        if entry.scale != 1.0:
            raise InvalidRobotError(f"{path}: scale is for URDFs; {entry.urdf} is an MJCF")
        if mjcf_files(urdf, check) is None and choice.untrusted:
            told = f"{path}: {entry.urdf} names a file that is not there or is no XML"
            raise InvalidRobotError(f"{told}: must be there, inside the scene's folder")
        return read_mjcf(urdf)
    content = None
    if urdf.suffix.lower() == ".xacro":
        by_user = urdf == path and not choice.untrusted
        content = expanded(urdf, package_dirs, named_by_user=by_user)
    model = read_urdf(urdf, entry.scale, content)
    covered = [link for link in model.links if link not in entry.spheres]
    model = with_meshes_found(model, covered, package_dirs)
    for file in meshes_found(model):
        check(file)
    return model


def _build(
    entry: RobotFile, model: UrdfModel, path: Path, choice: Choice = NOTHING
) -> tuple[Robot, Arm]:
    arm = _chosen(entry, model, path, choice)
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
    if entry.velocity is None:
        for name in names:
            if model.joints[name].remark:
                warnings.warn(model.joints[name].remark, stacklevel=2)
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
    )
    srdf = _given_srdf(entry, path, choice) or srdf_beside(model)
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
    return replace(robot, left_out=(*given, *robot.left_out)), arm


def _chosen(entry: RobotFile, model: UrdfModel, path: Path, choice: Choice) -> Arm:
    tip, base = choice.tip or entry.flange, choice.base or entry.base
    if tip is not None:
        return choose_arm(model, tip, base)
    groups = _given_srdf(entry, path, choice) or srdf_beside(model)
    return choose_arm(model, None, base, None if groups is None else read_srdf(groups))


def _given_srdf(entry: RobotFile, path: Path, choice: Choice) -> Path | None:
    if choice.srdf is not None:
        return Path(choice.srdf)
    return None if entry.srdf is None else path.parent / entry.srdf


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
