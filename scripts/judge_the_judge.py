"""Judge the judge: its contacts and distances against Coal's and MuJoCo's.

    python scripts/judge_the_judge.py --still 10000 --moving 2000 --own 10000 --own-moving 2000 \
        --self 10000 --seed 0

Kinematics are Pinocchio's, curves SciPy's, distances Coal's, and in still cases MuJoCo's too. No
code is shared with the judge. Bodies are the makers' meshes (package example-robot-data, extra
``models``) and the solids of the tool; of the SCARA, which has no meshes, its spheres. A case is
one robot, one tool, one object near its surface, and one configuration (``still``) or one random
curve (``moving``). In ``own`` and ``own-moving`` the bodies are the spheres that the judge knows.
``self`` compares contacts between links. A case is missed if the judge calls free what is in
contact by more than 1 mm.
"""

import argparse
import importlib.metadata
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from importlib import resources
from pathlib import Path
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin
import trimesh
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from optipromp import judging
from optipromp.geometry import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    MeshShape,
    PointCloudShape,
    Sphere,
)
from optipromp.robots import (
    Cup,
    FingerGripper,
    FrankaHand,
    MeshTool,
    Scissor,
    load_robot,
    with_tool,
)
from optipromp.scenes import JointGoal, Scene, SceneObject, Stem
from optipromp.trajectory import Trajectory

DEEP = 1e-3  # [m] a contact beyond it must be seen
RIM = 0.03  # [m] of the base's height that its cover leaves out (robots/data/panda.yaml)
END = 0.012  # [m] along the axis of joint 7: what of link 6 is beyond, link 7 alone covers
BOTTOM = 2e-4  # [m] least advance of the oracle along a curve
KINDS = "sphere", "box", "cylinder", "capsule", "half-space", "mesh", "corner", "cloud"
RODS = {"cylinder": coal.Cylinder, "capsule": coal.Capsule}
GEOMS = {"sphere": "sphere", "box": "box", "cylinder": "cylinder", "capsule": "capsule",
         "mesh": "mesh"}  # fmt: skip


@dataclass
class Piece:
    """A convex piece of a body or of an object: kind, sizes or corners, and its pose."""

    kind: str
    size: tuple[float, ...] = ()
    corners: Any = None
    at: Any = field(default_factory=lambda: np.zeros(3))
    turn: Any = field(default_factory=lambda: np.eye(3))
    link: str = ""
    joint: int = 0
    distal: bool = False

    def coals(self) -> Any:
        """The piece for Coal."""
        match self.kind:
            case "sphere":
                return coal.Sphere(self.size[0])
            case "box":
                return coal.Box(*self.size)
            case "half-space":
                return coal.Halfspace(np.array([0.0, 0.0, 1.0]), 0.0)
            case "mesh":
                return hull(self.corners)
        return RODS[self.kind](*self.size)

    def reach(self) -> float:
        """Radius of a ball about ``at`` that holds it [m]."""
        if self.kind == "half-space":
            return np.inf
        if self.kind == "capsule":
            return self.size[0] + 0.5 * self.size[1]
        if self.kind == "sphere":
            return self.size[0]
        return float(np.linalg.norm(self.points(), axis=1).max())

    def points(self) -> Any:
        """Points of its surface in its own frame."""
        if self.corners is not None:
            return self.corners
        if self.kind == "sphere":
            return self.size[0] * np.array([[1, 0, 0], [-0.6, 0.8, 0], [-0.5, -0.5, 0.7071]])
        half = 0.5 * np.array(self.size if self.kind == "box" else
                              (2 * self.size[0], 2 * self.size[0], self.size[1]))  # fmt: skip
        return half * [[x, y, z] for x in (-1, 0, 1) for y in (-1, 1) for z in (-1, 1)]


def hull(corners: Any) -> Any:
    """The convex hull of points, for Coal."""
    vertices = coal.StdVec_Vec3s()
    vertices.extend([np.array(c, float) for c in corners])
    return coal.Convex.convexHull(vertices, True, "Qt")


def cut(piece: Piece, along: Any, at: float) -> tuple[Piece, Piece]:
    """The parts of a convex body beyond and before a plane."""
    body = trimesh.convex.convex_hull(piece.corners)
    corners = np.array(body.vertices)
    height = corners @ along - at
    i, j = body.edges_unique[height[body.edges_unique].prod(axis=1) < 0.0].T
    share = (height[i] / (height[i] - height[j]))[:, None]
    rim = corners[i] + share * (corners[j] - corners[i])
    beyond, before = (np.concatenate([corners[own], rim]) for own in (height >= 0, height < 0))
    return replace(piece, corners=beyond), replace(piece, corners=before)


def makers() -> Path:
    """The folder of the makers' robots."""
    found = [p for p in importlib.metadata.files("example-robot-data") or []
             if str(p).endswith("robots/panda_description/urdf/panda.urdf")]  # fmt: skip
    return Path(str(found[0].locate())).resolve().parents[2]


def solids(tool: Any, flange: Any) -> list[Piece]:
    """The solids of a tool on a flange; of the Franka hand, the maker's meshes."""
    joint, rotation, translation = flange
    out = []
    if isinstance(tool, FrankaHand):
        folder = makers() / "panda_description" / "meshes" / "collision"
        palm, finger = (trimesh.load(folder / f"{n}.stl", force="mesh") for n in ("hand", "finger"))
        at = np.array([0.0, tool.gripper_radius, 0.0584])
        other = np.array(finger.vertices) * [-1, -1, 1] + at * [1, -1, 1]
        for points in (palm.vertices, finger.vertices + at, other):
            corners = np.array(points) @ tool.rotation.T
            out.append(Piece("mesh", (), trimesh.convex.convex_hull(corners).vertices))
    else:
        for solid in tool.solids():
            one = solid.shape
            match one:
                case Box():
                    piece = Piece("box", one.size)
                case Cylinder():
                    piece = Piece("cylinder", (one.radius, one.length))
                case _:
                    piece = Piece("mesh", (), np.array(one.vertices))
            piece.at, piece.turn = np.array(solid.position), solid.rotation
            out.append(piece)
    for piece in out:
        piece.at, piece.turn = translation + rotation @ piece.at, rotation @ piece.turn
        piece.link, piece.joint, piece.distal = "tool", joint, True
    return out


class Arm:
    """A robot with a tool, as this script sees it; ``own``: made of the judge's spheres."""

    def __init__(self, name: str, tool: Any, own: bool) -> None:
        self.name = f"{name} with {type(tool).__name__}"
        self.robot = with_tool(load_robot(name), tool)
        with resources.as_file(resources.files("optipromp.robots") / "data" / f"{name}.urdf") as p:
            self.model = pin.buildModelFromUrdf(str(p))
        self.data = self.model.createData()
        frame = self.model.frames[self.model.getFrameId("flange")]
        flange = frame.parentJoint, frame.placement.rotation, frame.placement.translation
        spheres = self.robot.spheres
        balls = [
            Piece("sphere", (float(r),), None, np.array(c), np.eye(3), self.robot.link_names[k],
                  int(s) + 1, bool(d))
            for s, c, r, k, d in zip(*spheres, strict=True)
        ]  # fmt: skip
        self.pieces = balls
        if not own:
            if name == "panda":
                self.pieces = self._links() + solids(tool, flange)
            else:
                self.pieces = [b for b in balls if b.link != "tool"] + solids(tool, flange)
        self.bodies = [piece.coals() for piece in self.pieces]
        self.joints = np.array([piece.joint for piece in self.pieces])
        self.at = np.array([piece.at for piece in self.pieces])
        self.turn = np.array([piece.turn for piece in self.pieces])
        self.distal = np.array([piece.distal for piece in self.pieces])
        low, high = self.robot.lower, self.robot.upper
        self.reach = np.array([piece.reach() for piece in self.pieces])
        self.low, self.high = np.maximum(low, -np.pi), np.minimum(high, np.pi)
        reach = 0.1 + max(np.linalg.norm(p.at) + np.abs(p.points()).max() for p in self.pieces)
        steps = [np.linalg.norm(j.translation) for j in self.model.jointPlacements][1:]
        steps += [0.51] if name == "scara" else []  # the lift's range
        self.levers = np.array([reach + sum(steps[j + 1 :]) for j in range(self.model.nq)])

    def _links(self) -> list[Piece]:
        folder = makers() / "panda_description" / "meshes" / "collision"
        last, out = self.robot.n_joints, []
        for i in range(last + 1):
            mesh = trimesh.load(folder / f"link{i}.stl", force="mesh")
            corners = np.array(trimesh.convex.convex_hull(mesh).vertices)
            piece = Piece("mesh", (), corners, link=f"link{i}", joint=i, distal=i == last)
            if i == 0:  # without its rim
                piece, _ = cut(piece, np.array([0.0, 0.0, 1.0]), RIM)
            if i == 6:  # its end, in which link 7 turns, counts with link 7
                place = self.model.jointPlacements[7]
                along = place.rotation[:, 2]
                end, piece = cut(piece, along, END + along @ place.translation)
                out.append(replace(end, distal=True))
            out.append(piece)
        return out

    def poses(self, q: Any) -> tuple[Any, Any]:
        """World rotations (k, 3, 3) and positions (k, 3) of the pieces."""
        pin.forwardKinematics(self.model, self.data, q)
        turns = np.array([pose.rotation for pose in self.data.oMi])[self.joints]
        places = np.array([pose.translation for pose in self.data.oMi])[self.joints]
        return turns @ self.turn, places + np.einsum("kij,kj->ki", turns, self.at)


@dataclass
class Thing:
    """An object: what the judge is given, and the pieces that Coal and MuJoCo are."""

    kind: str
    role: str
    item: SceneObject
    pieces: list[Piece]
    out: Any  # away from the robot

    def __post_init__(self) -> None:
        self.bodies = [piece.coals() for piece in self.pieces]
        self.poses = [coal.Transform3s(p.turn, p.at) for p in self.pieces]

    def __str__(self) -> str:
        return f"{self.kind}, {self.role}"

    def moved(self, by: Any) -> "Thing":
        """The same, moved by a vector [m]."""
        pieces = [replace(piece, at=piece.at + by) for piece in self.pieces]
        at, stem = self.item.position + by, self.item.stem
        if stem is not None:
            stem = Stem(stem.points + by)
        return Thing(
            self.kind, self.role, replace(self.item, position=at, stem=stem), pieces, self.out
        )


def polytope(rng: Any, size: float) -> Any:
    """Corners of a random convex body, about its middle."""
    points = rng.normal(size=(12, 3))
    points *= size / np.linalg.norm(points, axis=1)[:, None]
    return points - points.mean(axis=0)


def corner(a: float, b: float) -> tuple[MeshShape, list[Piece]]:
    """A closed mesh of an L, which is not convex, and the two boxes that it is."""
    outline = np.array([[0, 0], [a, 0], [a, b], [b, b], [b, a], [0, a]], float)
    low, high = (np.column_stack([outline, np.full(6, z)]) for z in (-0.5 * a, 0.5 * a))
    lid = [(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)]
    faces = [(f[2], f[1], f[0]) for f in lid] + [tuple(6 + i for i in f) for f in lid]
    for i in range(6):
        j = (i + 1) % 6
        faces += [(i, j, 6 + j), (i, 6 + j, 6 + i)]
    boxes = [Piece("box", (a, b, a), at=np.array([0.5 * a, 0.5 * b, 0.0])),
             Piece("box", (b, a, a), at=np.array([0.5 * b, 0.5 * a, 0.0]))]  # fmt: skip
    return MeshShape(np.concatenate([low, high]), np.array(faces)), boxes


def thing(rng: Any, arm: Arm, q: Any, gap: float) -> Thing:
    """A random object whose distance from the robot at ``q`` is about ``gap`` [m]."""
    kind, role = str(rng.choice(KINDS)), str(rng.choice(["static", "static", "avoid", "pushable"]))
    role = "static" if kind == "half-space" else role
    at, out, far = near(rng, arm, q)
    size = np.exp(rng.uniform(np.log(0.004), np.log(0.15), 3))
    turn = Rotation.random(random_state=rng).as_matrix()
    match kind:
        case "sphere":
            shape, pieces, reach = Sphere(size[0]), [Piece("sphere", (size[0],))], size[0]
        case "box":
            edges = tuple(2.0 * size)
            shape, pieces, reach = Box(edges), [Piece("box", edges)], size.min()
        case "cylinder" | "capsule":
            rod = (size[0], 2.0 * size[1])
            shape = (Cylinder if kind == "cylinder" else Capsule)(*rod)
            pieces, reach = [Piece(kind, rod)], min(size[:2])
        case "half-space":
            shape, pieces, reach = HalfSpace(), [Piece(kind)], far
            side = np.cross(out, [1.0, 0.0, 0.0] if abs(out[0]) < 0.9 else [0.0, 1.0, 0.0])
            side /= np.linalg.norm(side)
            turn = np.column_stack([side, np.cross(-out, side), -out])
        case "mesh":
            corners = polytope(rng, 0.02 + size[0])
            closed = trimesh.convex.convex_hull(corners)
            shape = MeshShape(np.array(closed.vertices), np.array(closed.faces))
            pieces, reach = [Piece("mesh", (), corners)], 0.8 * (0.02 + size[0])
        case "corner":
            shape, pieces = corner(0.03 + size[0], 0.01 + 0.3 * size[0])
            reach = 0.5 * (0.01 + 0.3 * size[0])
        case _:
            points = rng.uniform(-size[0], size[0], (30, 3))
            shape = PointCloudShape(points, 0.01)
            pieces, reach = [Piece("sphere", (0.01,), at=p) for p in points], size[0]
    place = at + out * reach
    for piece in pieces:
        piece.at, piece.turn = place + turn @ piece.at, turn @ piece.turn
    stem = Stem.along(place, np.array([0.0, 0.0, 1.0]), 0.2) if role == "pushable" else None
    what = Thing(kind, role, SceneObject("it", role, shape, place, turn, stem), pieces, out)
    for _ in range(4):
        what = what.moved((gap - distance(arm, q, what)) * out)
    return what


def near(rng: Any, arm: Arm, q: Any) -> tuple[Any, Any, float]:
    """A point of the robot's surface, a direction, and how far the robot goes along it."""
    turns, places = arm.poses(q)
    one = rng.integers(len(arm.pieces))
    points = arm.pieces[one].points() @ turns[one].T + places[one]
    at, out = points[rng.integers(len(points))], rng.normal(size=3)
    out /= np.linalg.norm(out)
    ends = [(p.points() @ r.T + t) @ out for p, r, t in zip(arm.pieces, turns, places, strict=True)]
    return at, out, float(max(e.max() for e in ends) - at @ out)


def distance(arm: Arm, q: Any, what: Thing) -> float:
    """Coal's signed distance [m] of the bodies that must not touch the object."""
    turns, places = arm.poses(q)
    least, request, result = np.inf, coal.DistanceRequest(), coal.DistanceResult()
    away = places[:, None] - [piece.at for piece in what.pieces]
    bound = np.linalg.norm(away, axis=2) - arm.reach[:, None] - [p.reach() for p in what.pieces]
    if what.role != "static":
        bound[arm.distal] = np.inf
    for place in np.argsort(bound, axis=None):
        i, k = divmod(int(place), len(what.pieces))
        if bound[i, k] >= least:
            break
        result.clear()
        pose = coal.Transform3s(turns[i], places[i])
        d = coal.distance(arm.bodies[i], pose, what.bodies[k], what.poses[k], request, result)
        least = min(least, d)
    return float(least)


class MuJoCo:
    """The same distance by MuJoCo; a model for each case, of the bodies and the object."""

    def distance(self, arm: Arm, q: Any, what: Thing) -> float:
        """MuJoCo's signed distance [m]."""
        turns, places = arm.poses(q)
        spec, bodies = mujoco.MjSpec(), 0
        for k, piece in enumerate(arm.pieces):
            if what.role == "static" or not arm.distal[k]:
                self._add(spec, piece, turns[k], places[k], f"p{k}")
                bodies += 1
        for k, piece in enumerate(what.pieces):
            self._add(spec, piece, piece.turn, piece.at, f"o{k}")
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return min(
            mujoco.mj_geomDistance(model, data, i, bodies + k, 10.0, None)
            for i in range(bodies) for k in range(len(what.pieces))
        )  # fmt: skip

    def _add(self, spec: Any, piece: Piece, turn: Any, at: Any, name: str) -> None:
        x, y, z, w = Rotation.from_matrix(turn).as_quat()
        kind = getattr(mujoco.mjtGeom, f"mjGEOM_{GEOMS[piece.kind].upper()}")
        size = list(piece.size)
        if piece.kind == "box":
            size = [0.5 * edge for edge in size]
        elif len(size) == 2:
            size[1] *= 0.5
        more: dict[str, Any] = {"size": (size + [0.0] * 3)[:3]}
        if piece.kind == "mesh":
            spec.add_mesh(name=name, uservert=np.ravel(piece.corners).tolist())
            more = {"meshname": name}
        spec.worldbody.add_geom(type=kind, pos=at, quat=[w, x, y, z], **more)


class Curve:
    """A trajectory's quintics by SciPy, and the speed of the robot's surface at most."""

    def __init__(self, arm: Arm, trajectory: Trajectory) -> None:
        rows = np.stack(
            [trajectory.positions, trajectory.velocities, trajectory.accelerations], axis=1
        )
        self.times = np.array(trajectory.times)
        self.curve = BPoly.from_derivatives(self.times, rows)
        cells = np.linspace(self.times[0], self.times[-1], 20 * (len(self.times) - 1) + 1)
        inside = np.linspace(cells[:-1], cells[1:], 9)
        speed = 1.2 * np.abs(self.curve.derivative()(inside)).max(axis=0) @ arm.levers
        self.cells, self.speed = cells, np.maximum(speed, 1e-6)

    def __call__(self, t: float) -> Any:
        """Configuration at a time."""
        return self.curve(t)

    def after(self, t: float, free: float) -> float:
        """The first time after ``t`` at which the surface may have moved by ``free`` [m]."""
        cell = min(int(np.searchsorted(self.cells, t, side="right")) - 1, len(self.speed) - 1)
        while cell < len(self.speed):
            end = self.cells[cell + 1]
            if free < self.speed[cell] * (end - t):
                return t + free / self.speed[cell]
            free -= self.speed[cell] * (end - t)
            t, cell = end, cell + 1
        return np.inf


def deepest(arm: Arm, curve: Curve, what: Thing) -> tuple[float, float]:
    """A distance [m] along a curve, and when: the first below -DEEP, or the least seen.

    Between two looks the surface moves no farther than it must to be in contact by DEEP, or than
    :data:`BOTTOM`.
    """
    t, best, when = 0.0, np.inf, 0.0
    while t <= curve.times[-1] and best >= -DEEP:
        d = distance(arm, curve(t), what)
        if d < best:
            best, when = d, t
        t = curve.after(t, max(abs(d + DEEP), BOTTOM))
    return best, when


def said(what: Thing, found: dict[str, float | None]) -> float:
    """The judge's distance for the role [m]."""
    value = found[f"clearance_{what.role}"]
    return np.inf if value is None else value


@lru_cache(maxsize=1)
def prism() -> MeshTool:
    """A tool of a mesh: a solid prism with six sides."""
    angle = np.arange(6) * np.pi / 3
    ring = 0.03 * np.column_stack([np.cos(angle), np.sin(angle)])
    points = [np.column_stack([ring, np.full(6, z)]) for z in (0.0, 0.12)]
    mesh = trimesh.convex.convex_hull(np.concatenate(points))
    return MeshTool((MeshShape(np.array(mesh.vertices), np.array(mesh.faces)),), (0.0, 0.0, 0.13))


def arms(own: bool) -> list[Arm]:
    """Both built-in arms with their tools."""
    cups = Cup(0.05), Cup(0.03, 0.08, 0.2, opening=0.05), Cup(0.08, 0.05, 0.0)
    both = (*cups, FingerGripper(0.08), Scissor(0.05), prism())
    return [Arm("panda", tool, own) for tool in (*both, FrankaHand())] + [
        Arm("scara", tool, own) for tool in both
    ]


@dataclass
class Tally:
    """What was found: both distances of every case, and the cases that were missed."""

    ours: list[float] = field(default_factory=list)
    theirs: list[float] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    touching: int = 0
    called: int = 0

    def add(self, free: bool, ours: float, theirs: float, case: str, measured: bool = True) -> None:
        """One case: whether the judge calls it free, and both distances [m], if measured."""
        self.touching += theirs < -DEEP
        self.called += not free
        if free and theirs < -DEEP:
            self.missed.append(f"{case}: theirs {theirs * 1e3:.2f} mm, ours {ours * 1e3:.2f} mm")
        if measured and (ours > 0.0 or theirs > 0.0):
            self.ours.append(ours)
            self.theirs.append(theirs)

    def __str__(self) -> str:
        both = 1e3 * (np.array(self.ours) - np.array(self.theirs))
        both = both[np.isfinite(both)]
        text = (
            f"in contact by more than 1 mm: {self.touching}; called a contact: {self.called}; "
            f"missed: {len(self.missed)}"
        )
        if not len(both):
            return text
        shown = ", ".join(f"{p:.2f}" for p in np.percentile(both, [1, 5, 50, 95, 99]))
        return (
            f"{text}\n  ours minus theirs [mm]: percentiles 1, 5, 50, 95, 99: {shown}; "
            f"largest {both.max():.3f}"
        )


def still(cases: int, seed: int, own: bool = False, mujocos: bool = True) -> Tally:
    """Random configurations with one object each."""
    tally, every, other = Tally(), arms(own), MuJoCo()
    for k in range(cases):
        rng = np.random.default_rng([seed, 1, k])
        arm = every[k % len(every)]
        q = rng.uniform(arm.low, arm.high)
        what = thing(rng, arm, q, rng.choice([-0.005, 0.02, 0.2]) * rng.random())
        found, contacts = judging.clearances(_scene(q, what), arm.robot, q[None])
        theirs = [distance(arm, q, what)]
        if mujocos and what.kind != "half-space":
            theirs.append(other.distance(arm, q, what))
        free = not any(c.other == "it" for c in contacts)
        # the libraries' depths differ; what either finds counts
        tally.add(free, said(what, found), min(theirs), f"still {k}: {arm.name}, {what}")
    return tally


def moving(cases: int, seed: int, own: bool = False) -> Tally:
    """Random curves with one object near the way of the robot, mostly between its waypoints."""
    tally, every = Tally(), arms(own)
    for k in range(cases):
        rng = np.random.default_rng([seed, 2, k])
        arm = every[k % len(every)]
        trajectory = curve_of(rng, arm)
        curve = Curve(arm, trajectory)
        q = curve(rng.uniform(0.0, trajectory.duration))
        what = thing(rng, arm, q, 0.0)
        for _ in range(2):  # so that it is touched by little, or nearly
            looks = np.linspace(0.0, trajectory.duration, 40)
            free = rng.uniform(-0.004, 0.004) - min(distance(arm, curve(t), what) for t in looks)
            what = what.moved(free * what.out)
        judgement = judging.judge(_scene(q, what), arm.robot, trajectory)
        free = not any(c.other == "it" for c in judgement.contacts)
        free &= not any(v.kind == "unchecked" for v in judgement.violations)
        ours = said(what, judgement.metrics.to_dict())
        theirs, when = deepest(arm, curve, what)
        text = f"moving {k}: {arm.name}, {what}, at {when:.3f} s"
        tally.add(free, ours, theirs, text, measured=False)
    return tally


def selves(cases: int, seed: int) -> Tally:
    """Random configurations: contacts between links whose spheres the judge keeps apart."""
    tally, every = Tally(), arms(False)
    for k in range(cases):
        rng = np.random.default_rng([seed, 3, k])
        arm = every[k % len(every)]
        robot, q = arm.robot, rng.uniform(arm.low, arm.high)
        names = np.array([robot.link_names[i] for i in robot.spheres.link])
        kept = {frozenset(pair) for pair in names[robot.self_pairs].tolist()}
        goal = Scene("s", "robot", (), goal=JointGoal(q))
        found, contacts = judging.clearances(goal, robot, q[None])
        turns, places = arm.poses(q)
        poses = [coal.Transform3s(*pose) for pose in zip(turns, places, strict=True)]
        least = np.inf
        for i, a in enumerate(arm.pieces):
            for j in range(i):
                if frozenset((a.link, arm.pieces[j].link)) in kept:
                    d = coal.distance(arm.bodies[i], poses[i], arm.bodies[j], poses[j],
                                      coal.DistanceRequest(), coal.DistanceResult())  # fmt: skip
                    least = min(least, d)
        ours = found["clearance_self"]
        tally.add(not contacts, np.inf if ours is None else ours, least, f"self {k}: {arm.name}")
    return tally


def curve_of(rng: Any, arm: Arm) -> Trajectory:
    """A random curve of 2 to 6 waypoints: smooth, or with a state of its own at each."""
    count, names = int(rng.integers(2, 7)), arm.robot.joint_names
    size = np.exp(rng.uniform(np.log(0.02), np.log(1.5)))
    q = rng.uniform(arm.low, arm.high) + size * rng.normal(size=(count, arm.model.nq)).cumsum(0)
    if rng.random() < 0.5:
        return Trajectory.through(q, 0.5, names)
    times = np.cumsum(rng.uniform(0.1, 1.0, count))
    speed, gain = (size * factor * rng.normal(size=q.shape) for factor in (2.0, 8.0))
    return Trajectory(times - times[0], q, speed, gain, names)


def _scene(q: Any, what: Thing) -> Scene:
    return Scene("s", "robot", (what.item,), goal=JointGoal(q))


def main() -> None:
    """Run the cases that are asked for."""
    parser = argparse.ArgumentParser()
    runs: dict[str, Any] = {
        "still": still, "moving": moving, "own": partial(still, own=True, mujocos=False),
        "own-moving": partial(moving, own=True), "self": selves,
    }  # fmt: skip
    for name in (*runs, "seed"):
        parser.add_argument(f"--{name}", dest=name, type=int, default=0)
    asked = vars(parser.parse_args())
    for name, run in runs.items():
        if asked[name]:
            tally = run(asked[name], asked["seed"])
            print(
                f"{name}, {asked[name]} cases: {tally}", *tally.missed[:20], sep="\n  ", flush=True
            )


if __name__ == "__main__":
    main()
