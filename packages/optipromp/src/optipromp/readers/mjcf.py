"""MJCF files, compiled by MuJoCo, in the form of a URDF.

Bodies and sites become links. Further links are inserted for a body of several joints and for a
joint away from its body's origin. Joint values are MuJoCo's, with ``ref``. A free joint becomes
fixed; a free body without other joints is an object and is left out, and so are planes and height
fields. The files that an MJCF names are checked before MuJoCo reads them.
"""

import hashlib
import math
import struct
import tempfile
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from optipromp.core import files
from optipromp.core.arrays import FloatArray
from optipromp.core.arrays import rotation as turned
from optipromp.core.errors import InvalidRequestError, InvalidRobotError, installed_by
from optipromp.core.robots.description import LinkShape, Vector
from optipromp.core.scenes.rotations import from_quaternion
from optipromp.readers import urdf
from optipromp.readers.elements import Node, read_xml
from optipromp.readers.packages import LIMITS, run_limited

SUFFIXES = (".xml", ".mjcf")
_FOLDERS = ("meshdir", "texturedir", "assetdir")  # attributes of <compiler>: folders of assets
MOST_COPIES = 1_000  # of one element, chosen: Menagerie's robots have none
MOST_HEIGHTS = 1_000_000  # of one height field, chosen


def mjcf_files(path: Path, check: Callable[[Path], Path] = Path) -> list[Path] | None:
    """The MJCF file at ``path`` and every file that it names, directly or through others, sorted.

    A name stands for every file of that name in the folders of assets.

    ``check``: called with each other file before it is read. None: a file is not there, or no XML.
    """
    trees = dict[Path, Node]()
    new = {path}
    while new:
        try:
            trees |= {file: read_xml(file) for file in new}
        except InvalidRobotError:
            return None
        nodes = [(file, node) for file, tree in trees.items() for node in _nodes(tree)]
        for file, node in nodes:
            _check_counts(file, node)
        inner = {
            n.attributes.get(key, "") for _, n in nodes if n.tag == "compiler" for key in _FOLDERS
        }
        folders = {file.parent / each for file in trees for each in {"", *inner}}
        named = {
            value
            for _, node in nodes
            for key, value in node.attributes.items()
            if key.startswith("file") and value  # a texture has fileright and others
        }
        found = set(trees)
        for name in named:
            places = {folder / part for folder in folders for part in (name, Path(name).name)}
            there = {place for place in places if files.is_file(place)}
            for place in places - there:
                if files.is_there(place) and not files.is_folder(place):
                    raise InvalidRobotError(f"{path}: {place} is a device or pipe; must be a file")
            if not there:
                return None
            found |= {check(file) for file in there}
        new = {file for file in found if file.suffix.lower() in SUFFIXES} - set(trees)
    return sorted(found)


def _check_counts(path: Path, node: Node) -> None:
    """Refuse an element that MuJoCo would expand beyond :data:`MOST_COPIES` or MOST_HEIGHTS."""
    for keys, most in ((("count",), MOST_COPIES), (("nrow", "ncol"), MOST_HEIGHTS)):
        words = [word for key in keys for word in node.attributes.get(key, "").split()]
        asked = math.prod(int(word) for word in words if word.isdecimal())
        if asked > most:
            raise InvalidRobotError(
                f"{path}:{node.line}: <{node.tag}> asks for {asked:.3g} of {' x '.join(keys)}: "
                f"must be at most {most}"
            )


def _nodes(tree: Node) -> Iterator[Node]:
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        waiting += node.children


FREE, BALL, SLIDE = 0, 1, 2  # mjtJoint
LOOPS = 0, 1  # mjtEq: connect and weld
OBJ_SITE = 6  # mjtObj
_SHAPES = {2: "sphere", 3: "capsule", 4: "box", 5: "cylinder", 6: "box", 7: "mesh"}  # mjtGeom
MOST_BODIES = 1_000  # chosen: a humanoid with hands has 100


def is_mjcf(path: Path) -> bool:
    """Whether a file is an MJCF, by its suffix and its root element."""
    if path.suffix.lower() not in SUFFIXES:
        return False
    with suppress(InvalidRobotError):
        return b"<mujoco" in files.read_bytes(path, InvalidRobotError)
    return False


def read_mjcf(path: Path) -> urdf.UrdfModel:
    """Read the MJCF file at ``path``; its meshes are written to the cache folder."""
    try:
        import mujoco
    except ImportError:
        raise InvalidRobotError(
            f"{path}: reading MJCF needs MuJoCo: {installed_by('optipromp[mjcf]')}"
        ) from None
    content = run_limited("compile_mjcf", path, {})
    with tempfile.TemporaryDirectory(prefix="optipromp-") as folder:
        file = Path(folder) / "model.mjb"
        file.write_bytes(content)
        try:
            model = mujoco.MjModel.from_binary_path(str(file))
        except ValueError:  # cut off
            most = LIMITS.output / 1e6
            raise InvalidRobotError(f"{path}: compiles to more than {most:.0f} MB") from None
    if model.nbody > MOST_BODIES:
        raise InvalidRobotError(
            f"{path}: has {model.nbody} bodies: must have at most {MOST_BODIES}"
        )
    try:
        return _Reader(path, model).read()
    except UnicodeDecodeError:
        raise InvalidRobotError(f"{path}: a name in it is no UTF-8: must be") from None


class _Reader:
    """The state of converting a compiled model to links and joints."""

    def __init__(self, path: Path, model: Any) -> None:
        self.path, self.model = path, model
        self.links: dict[str, urdf.UrdfLink] = {}
        self.joints: dict[str, urdf.UrdfJoint] = {}
        self.names = [model.body(b).name or f"body{b}" for b in range(model.nbody)]
        self.told = ""
        self.loops: dict[int, str] = {}  # the equality that closes a loop, by joint
        self.joint_names = [model.joint(j).name or f"joint{j}" for j in range(model.njnt)]

    def read(self) -> urdf.UrdfModel:
        model, left_out = self.model, set()
        self._refuse_loops()
        marks = self._marks()
        for body in range(model.nbody):
            parent = int(model.body_parentid[body])
            if (body and parent in left_out) or self._is_object(body) or body in marks:
                left_out.add(body)
                continue
            if body:
                self._mount(body, self.names[parent])
            self.links[self.names[body]] = self._link(body)
        for site in range(model.nsite):
            body, name = int(model.site_bodyid[site]), model.site(site).name
            if name and body not in left_out and name not in self.links:
                self.links[name] = urdf.UrdfLink(name, (), ())
                self._fix(
                    name, self.names[body], model.site_pos[site], _matrix(model.site_quat[site])
                )
        return urdf.UrdfModel(
            self.model.names[: self.model.names.index(b"\0")].decode() or self.path.stem,
            self.path,
            self.names[0],
            MappingProxyType(self.links),
            MappingProxyType(self.joints),
            self.told,
        )

    def _marks(self) -> set[int]:
        """Bodies that touch nothing and do not belong to the arm; a warning names them.

        They carry no joint, and are ``mocap`` bodies (one with joints is the base of an arm) or
        never move; all geoms of the latter have neither ``contype`` nor ``conaffinity``.
        """
        model = self.model
        touching = (model.geom_contype != 0) | (model.geom_conaffinity != 0)
        led = {body for part in model.jnt_bodyid for body in self._upward(int(part))}
        bearing = led.union(*(self._upward(int(part)) for part in model.geom_bodyid[touching]))
        fixed = (model.body_weldid == 0) & (model.body_geomnum > 0)
        found = {
            body
            for body in range(1, model.nbody)
            if (model.body_mocapid[body] >= 0 and body not in led)
            or (fixed[body] and body not in bearing)
        }
        if found:
            names = ", ".join(self.names[body] for body in sorted(found))
            self.told = f"{self.path}: {names}: left out, as it touches nothing"
        return found

    def _refuse_loops(self) -> None:
        """Find the joints that ``connect`` and ``weld`` close to loops; they can be held alone."""
        model = self.model
        for e in range(model.neq):
            if int(model.eq_type[e]) not in LOOPS or not model.eq_active0[e]:
                continue
            ends = [int(model.eq_obj1id[e]), int(model.eq_obj2id[e])]
            if int(model.eq_objtype[e]) == int(OBJ_SITE):
                ends = [int(model.site_bodyid[each]) for each in ends]
            paths = [self._upward(each) for each in ends]
            if any(model.body_mocapid[b] >= 0 or self._is_object(b) for p in paths for b in p):
                continue  # a mark or an object that is led
            name = model.equality(e).name or f"equality {e}"
            for body in set(paths[0]) ^ set(paths[1]):
                for j in self._joints_of(body):
                    self.loops.setdefault(j, name)

    def _upward(self, body: int) -> list[int]:
        """A body and those that carry it."""
        out = [body]
        while out[-1]:
            out.append(int(self.model.body_parentid[out[-1]]))
        return out

    def _check_length(self, what: str, values: FloatArray) -> None:
        if not np.abs(values).max() <= urdf.LENGTH_LIMIT:
            told = " ".join(f"{value:g}" for value in values)
            raise InvalidRobotError(
                f"{self.path}: {what} is {told}, beyond {urdf.LENGTH_LIMIT:g} m: millimetres?"
            )

    def _joints_of(self, body: int) -> range:
        first = int(self.model.body_jntadr[body])
        return range(first, first + int(self.model.body_jntnum[body]))

    def _is_object(self, body: int) -> bool:
        """Whether a body is free and carries no other joint."""
        types = self.model.jnt_type
        if not any(types[j] == FREE for j in self._joints_of(body)):
            return False
        inside = {body}
        for other in range(body + 1, self.model.nbody):
            if int(self.model.body_parentid[other]) in inside:
                inside.add(other)
        return not any(types[j] != FREE for each in inside for j in self._joints_of(each))

    def _mount(self, body: int, parent: str) -> None:
        """Attach a body to its parent by its joints in order, and by a fixed joint if needed."""
        model, name = self.model, self.names[body]
        self._check_length(f"body '{name}' pos", model.body_pos[body])
        at, turn = np.array(model.body_pos[body]), _matrix(model.body_quat[body])
        moving = [j for j in self._joints_of(body) if model.jnt_type[j] != FREE]
        origin = np.zeros(3)  # of the present frame, in the body's frame
        for k, j in enumerate(moving):
            anchor, axis = np.array(model.jnt_pos[j]), np.array(model.jnt_axis[j])
            at, origin = at + turn @ (anchor - origin), anchor
            ref = float(model.qpos0[model.jnt_qposadr[j]])
            if model.jnt_type[j] == SLIDE:
                at = at - turn @ axis * ref
            else:
                turn = turn @ turned(axis, -ref)
            last = k == len(moving) - 1 and not anchor.any()
            child = name if last else f"{name}:{self.joint_names[j]}"
            if not last:
                self.links[child] = urdf.UrdfLink(child, (), ())
            self._join(j, parent, child, at, turn, axis)
            parent, at, turn = child, np.zeros(3), np.eye(3)
        if parent != name and (not moving or origin.any()):
            self._fix(name, parent, at - turn @ origin, turn)

    def _join(
        self, j: int, parent: str, child: str, at: FloatArray, turn: FloatArray, axis: FloatArray
    ) -> None:
        model, name = self.model, self.joint_names[j]
        kind, limited = int(model.jnt_type[j]), bool(model.jnt_limited[j])
        ends, fault = (-math.inf, math.inf), ""
        if limited:
            ends = float(model.jnt_range[j][0]), float(model.jnt_range[j][1])
        ends, velocity, told = urdf.within(ends, math.inf, self._kept(j))
        if kind == BALL:
            fault = f"{self.path}: joint '{name}' is a ball joint; an arm has hinges and slides"
        elif kind == SLIDE and not limited:
            fault = f"{self.path}: joint '{name}' slides and has no range [m]"
        elif j in self.loops:
            fault = (
                f"{self.path}: joint '{name}' is in a loop that {self.loops[j]!r} closes; an arm "
                "is a chain: take the equality out, and state couplings under mimic in a robot file"
            )
        self.joints[name] = urdf.UrdfJoint(
            name,
            "prismatic" if kind == SLIDE else "revolute" if ends[1] < math.inf else "continuous",
            parent, child, _vector(at), _rpy(turn), _vector(axis), *ends, velocity,
            self._mimic(j), self._effort(j), fault, told=told and f"{self.path}: {told}",
        )  # fmt: skip

    def _fix(self, child: str, parent: str, at: FloatArray, turn: FloatArray) -> None:
        name = f"{parent} to {child}"
        self.joints[name] = urdf.UrdfJoint(
            name, "fixed", parent, child, _vector(at), _rpy(turn), (1.0, 0.0, 0.0), 0.0, 0.0,
            math.inf, None,
        )  # fmt: skip

    def _mimic(self, j: int) -> urdf.UrdfMimic | None:
        """The joint that joint ``j`` follows by a linear equality, if any."""
        model = self.model
        for e in range(model.neq):
            first, second = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
            linear = not model.eq_data[e, 2:5].any()
            if int(model.eq_type[e]) == 2 and first == j and second >= 0 and linear:  # mjEQ_JOINT
                refs = model.qpos0[model.jnt_qposadr[[first, second]]]
                offset, share = (float(v) for v in model.eq_data[e, :2])
                offset += float(refs[0] - share * refs[1])
                return urdf.UrdfMimic(self.joint_names[second], share, offset)
        return None

    def _effort(self, j: int) -> float:
        """Limit of the torque or force [N m or N] by the range of the joint and its actuators."""
        model, least = self.model, math.inf
        if model.jnt_actfrclimited[j]:
            least = float(np.abs(model.jnt_actfrcrange[j]).max())
        for a in self._actuators(j):
            least = min(least, abs(float(model.actuator_gear[a, 0])) * self._force(a))
        return least or math.inf

    def _actuators(self, j: int) -> list[int]:
        """The actuators on a joint itself."""
        model = self.model
        on = (model.actuator_trntype <= 1) & (model.actuator_trnid[:, 0] == j)
        return [int(a) for a in np.flatnonzero(on)]

    def _kept(self, j: int) -> Iterator[urdf.Kept]:
        """What servos of position and of velocity can ask of a joint: where their force is 0.

        MuJoCo's force: gain control + bias[0] + bias[1] length + bias[2] velocity; both by gear.
        """
        model = self.model
        for a in self._actuators(j):
            gain, bias = float(model.actuator_gainprm[a, 0]), model.actuator_biasprm[a]
            integrates = int(model.actuator_dyntype[a]) == 1
            limited = model.actuator_actlimited if integrates else model.actuator_ctrllimited
            asked = model.actuator_actrange if integrates else model.actuator_ctrlrange
            servo = model.actuator_gaintype[a] == 0 and model.actuator_biastype[a] == 1  # affine
            of, gear = (1 if bias[1] else 2), float(model.actuator_gear[a, 0])
            if servo and limited[a] and bias[of] < 0.0 and gear:
                low, high = sorted((gain * asked[a] + bias[0]) / (-bias[of] * gear))
                name = model.actuator(a).name or f"actuator {a}"
                what = f"joint '{self.joint_names[j]}': {name} by its range"
                yield urdf.Kept(what, float(low), float(high), of == 2)

    def _force(self, a: int) -> float:
        """Limit of the force of actuator ``a`` by its range, and by the control of a motor."""
        model, least = self.model, math.inf
        if model.actuator_forcelimited[a]:
            least = float(np.abs(model.actuator_forcerange[a]).max())
        fixed = not (model.actuator_gaintype[a] or model.actuator_biastype[a])  # no feedback
        if model.actuator_ctrllimited[a] and fixed:
            most = float(np.abs(model.actuator_ctrlrange[a]).max())
            least = min(least, abs(float(model.actuator_gainprm[a, 0])) * most)
        return least

    def _link(self, body: int) -> urdf.UrdfLink:
        model = self.model
        first = int(model.body_geomadr[body])
        solid: dict[bool, list[LinkShape]] = {True: [], False: []}
        for g in range(first, first + int(model.body_geomnum[body])):
            kind = _SHAPES.get(int(model.geom_type[g]))
            if kind is not None:
                collides = bool(model.geom_contype[g] or model.geom_conaffinity[g])
                solid[collides].append(self._geometry(g, kind))
        mass = float(model.body_mass[body])
        xx, yy, zz = (float(v) for v in model.body_inertia[body])
        inertial = urdf.UrdfInertial(
            mass,
            _vector(model.body_ipos[body]),
            _rpy(_matrix(model.body_iquat[body])),
            (xx, 0.0, 0.0, yy, 0.0, zz),
        )
        return urdf.UrdfLink(
            self.names[body], tuple(solid[True]), tuple(solid[False]), inertial if mass else None
        )

    def _geometry(self, g: int, kind: Any) -> LinkShape:
        model = self.model
        size = [float(v) for v in model.geom_size[g]]
        what = f"a geom of body '{self.names[int(model.geom_bodyid[g])]}'"
        self._check_length(f"{what} pos", model.geom_pos[g])
        if kind != "mesh":
            self._check_length(f"{what} size", model.geom_size[g])
        place = _vector(model.geom_pos[g]), _rpy(_matrix(model.geom_quat[g]))
        if kind == "mesh":
            file = _stl(model, int(model.geom_dataid[g]))
            return LinkShape(kind, (1.0, 1.0, 1.0), *place, str(file))
        if kind == "box":  # an ellipsoid is covered by its box
            return LinkShape(kind, tuple(2.0 * s for s in size), *place)
        sizes = (size[0],) if kind == "sphere" else (size[0], 2.0 * size[1])
        return LinkShape(kind, sizes, *place)


def _stl(model: Any, mesh: int) -> Path:
    """The binary STL file of a mesh in the frame of its geom, named by the hash of its content."""
    vert, face = int(model.mesh_vertadr[mesh]), int(model.mesh_faceadr[mesh])
    vertices = model.mesh_vert[vert : vert + int(model.mesh_vertnum[mesh])]
    faces = model.mesh_face[face : face + int(model.mesh_facenum[mesh])]
    rows = np.zeros(len(faces), dtype=[("normal", "<3f4"), ("corners", "<9f4"), ("more", "<u2")])
    rows["corners"] = vertices[faces].reshape(-1, 9)
    content = bytes(80) + struct.pack("<I", len(faces)) + rows.tobytes()
    folder = files.cache_folder() or Path(tempfile.gettempdir()) / "optipromp"
    file = folder / "meshes" / f"{hashlib.sha256(content).hexdigest()}.stl"
    if not files.is_file(file):
        try:
            files.write_atomically(file, content)
        except InvalidRequestError as error:
            raise InvalidRobotError(f"a mesh cannot be left in the cache: {error}") from error
    return file


def _vector(values: FloatArray) -> Vector:
    x, y, z = (float(v) for v in values)
    return x, y, z


def _matrix(quaternion: FloatArray) -> FloatArray:
    """The rotation matrix (3, 3) of a quaternion (4,) w, x, y, z of any length."""
    return from_quaternion(quaternion / np.linalg.norm(quaternion))


def _rpy(turn: FloatArray) -> Vector:
    """URDF angles [rad] of a rotation (3, 3) Rz(yaw) Ry(pitch) Rx(roll)."""
    flat = math.hypot(turn[0, 0], turn[1, 0])
    pitch = math.atan2(-turn[2, 0], flat)
    if flat < 1e-9:  # roll and yaw are about the same axis: yaw is 0
        return math.atan2(-turn[1, 2], turn[1, 1]), pitch, 0.0
    return math.atan2(turn[2, 1], turn[2, 2]), pitch, math.atan2(turn[1, 0], turn[0, 0])
