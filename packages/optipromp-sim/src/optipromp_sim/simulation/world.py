"""A scene and its robot as a MuJoCo model."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

from optipromp.core.arrays import FloatArray, IntArray, frame_along, frozen
from optipromp.core.errors import InvalidRequestError
from optipromp.core.geometry.shapes import Sphere
from optipromp.core.pushing.stems.bending import axis_of, hanging_balls, part
from optipromp.core.robots.grippers import Scissor
from optipromp.core.robots.model import Robot
from optipromp.core.robots.mounted import unmounted
from optipromp.core.scenes.objects import UNSEEN_SPREAD, ObjectMotion, parents_first, rooted
from optipromp.core.scenes.pose import Pose
from optipromp.core.scenes.rotations import to_quaternion
from optipromp.core.scenes.scene import STEM_RADIUS, Scene, SceneObject, Stem
from optipromp_sim.simulation.arm import Drives, add_robot, drives, link_entities
from optipromp_sim.simulation.disturbances import RootMotion, disturbed, root_motion
from optipromp_sim.simulation.engine import NOBODY, Entity, add_shape, engine, layers
from optipromp_sim.simulation.fruits import FIRM, BuiltFruit, Truss, add_fruit, bows, trusses_of
from optipromp_sim.simulation.parameters import SimulationParameters, of_crop

STATIC_COLOUR = (0.62, 0.60, 0.57, 1.0)
AVOID_COLOUR = (0.35, 0.60, 0.30, 0.35)
FLOOR = "floor"  # Name of the plane on which fallen fruits come to rest
FLOOR_DEPTH = 0.5  # [m] of the floor below the base and every object, so that none touches it
SKY = (0.97, 0.95, 0.91), (0.86, 0.79, 0.68)  # warm: cups are pale blue; photographs paint theirs
PICTURE = 1280, 960  # [pixel] largest off-screen picture
CLUSTER_FRUIT_RADIUS = 0.015  # [m] of a real neighbouring cluster: a small strawberry


@dataclass(frozen=True, eq=False)
class Fruit:
    """The places of a target or pushable in the model."""

    id: str  # of the scene's object
    role: str
    built: BuiltFruit
    entity: int  # index into ``World.entities``
    stem_entity: int  # likewise; -1 without a stem
    body: int
    position: int  # first index into qpos
    spin: int  # first index into qvel
    weld: int  # its equality, -1 without a stem
    dofs: IntArray  # of the bends of its stem's joints, in qvel
    last: int  # body of the stem's last segment, -1 without a stem
    along: FloatArray  # (3,) unit, in that body's frame, from the fruit up the stem
    axis: FloatArray  # (2, 3) ends of its axis, in its own frame [m]

    def ends(self, states: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Begin and end (R, 3) of its axis [m] in ``states`` (R, nq)."""
        place = states[:, self.position : self.position + 3]
        spin = states[:, self.position + 3 : self.position + 7]
        w, v = spin[:, :1], spin[:, 1:]
        begin, end = (
            place + each + 2.0 * np.cross(v, np.cross(v, each) + w * each) for each in self.axis
        )
        return begin, end

    def stem(self, data: Any) -> FloatArray:
        """The joints and the end (N+1, 3) of its stem in MuJoCo's ``data``, root first [m]; (0, 3)
        without a stem."""
        nodes, last = self.built.nodes, self.last
        if last < 0:
            return np.zeros((0, 3))
        joints = data.xpos[last + 2 - len(nodes) : last + 1]
        end = joints[-1] + data.xmat[last].reshape(3, 3) @ (nodes[-1] - nodes[-2])
        return np.vstack([joints, end])


class Root(NamedTuple):
    """The places of a moving root in the model."""

    position: int  # first index of its slides into qpos
    spin: int  # likewise into qvel
    fruits: tuple[int, ...]  # indices into ``World.fruits`` of those that hang on it
    # of the scene, as displacements; None: it moves by the world's motion alone
    course: ObjectMotion | None


@dataclass(frozen=True, eq=False)
class World:
    """A compiled model, and what its parts stand for."""

    model: Any  # MjModel
    scene: Scene  # the true one, of which it was built: with its disturbances, and fruits parted
    robot: Robot
    parameters: SimulationParameters
    drives: Drives  # of the robot's segments; their qpos and qvel are the first S
    entities: tuple[Entity, ...]  # of which contacts are counted
    geom_entity: IntArray  # (ngeom,) index into ``entities``
    fruits: tuple[Fruit, ...]  # targets and pushables, then those of real neighbouring clusters
    # pairs of labels of entities that overlap in the scene and so do not collide
    overlapping: tuple[tuple[str, str], ...]
    parted: Mapping[str, float]  # distance by which overlapping fruits were moved apart, by id [m]
    spec: Any  # the MjSpec that the model was compiled from
    roots: tuple[Root, ...] = ()  # that move, by the scene, or by a sway or jump
    # of the roots, in their order, beside the scene's; None without a sway or jump
    motion: RootMotion | None = None
    # of the arm; true places are ``miscalibration @ believed``
    miscalibration: Pose = field(default_factory=Pose)

    @property
    def shown(self) -> tuple[Fruit, ...]:
        """Targets and pushables of the scene."""
        return tuple(fruit for fruit in self.fruits if fruit.built.shown)

    def data(self, q: FloatArray) -> Any:
        """New ``MjData``: the robot at rest at ``q`` (n,), the stems carrying their fruits."""
        mujoco = engine()
        data = mujoco.MjData(self.model)
        data.qpos[: self.robot.n_segments] = self.drives.segments(q)
        for fruit in self.fruits:
            data.qfrc_applied[fruit.dofs] = fruit.built.grown.ravel()
        mujoco.mj_forward(self.model, data)
        return data


def build(
    scene: Scene, robot: Robot, parameters: SimulationParameters | None = None, seed: int = 0
) -> World:
    """Build the world of ``scene`` with ``robot`` (with its tool) in it.

    Hanging fruits that overlap in the scene are moved apart first (``World.parted``). Other pairs
    that overlap (a fruit and the stem of another, in the paper's scenes) would burst apart at the
    first step, so they do not collide (``World.overlapping``). The robot collides with everything.

    ``robot``: whose frame is the world's. ``seed``: of the bows of stems, the fruits of real
    neighbouring clusters, and disturbances.
    """
    parameters = of_crop(parameters or SimulationParameters(), scene.crop)
    scene, parted = apart(grown(scene, seed))
    draft = _Draft(scene, robot, parameters, seed)
    model = draft.compile()
    pairs = draft.overlapping(model)
    if pairs:
        for a, b in pairs:
            draft.exclude(a, b)
        model = draft.compile()
    named = tuple((draft.entities[a].label, draft.entities[b].label) for a, b in pairs)
    world = draft.world(model, named, parted)
    return _moving(world, seed)


def _moving(world: World, seed: int) -> World:
    """The world with its roots and their motion."""
    tops, shaken = world.scene.tops, world.parameters.disturbance.in_motion
    courses = {item.id: course.shifted(-item.position) for item, course in world.scene.movers}
    by: dict[str, list[int]] = {}  # a fruit of a neighbouring cluster has a root of its own
    for index, fruit in enumerate(world.fruits):
        if fruit.built.has_stem and (shaken or fruit.id in courses):
            key = tops.get(fruit.id, "") if fruit.built.shown else fruit.built.key
            by.setdefault(key, []).append(index)
    if not by:
        return world
    joints = [world.model.joint(f"root:{key}:0") for key in by]
    roots = tuple(
        Root(int(joint.qposadr[0]), int(joint.dofadr[0]), tuple(mine),
             courses.get(world.fruits[mine[0]].id))
        for joint, mine in zip(joints, by.values(), strict=True)
    )  # fmt: skip
    bodies = [[world.fruits[k].body for k in root.fruits] for root in roots]
    hanging = [[(world.model.body_pos[b], _reach(world.model, b)) for b in own] for own in bodies]
    motion = None
    if shaken:
        motion = root_motion(world.parameters.disturbance, seed, world.scene.up, hanging)
    slides = np.concatenate([np.arange(root.spin, root.spin + 3) for root in roots])
    own = np.delete(world.model.dof_M0, slides)
    world.model.stat.meaninertia = own.mean()  # by which the solver ends: without the carriages
    return replace(world, roots=roots, motion=motion)


class _Draft:
    """A model under construction."""

    def __init__(
        self, scene: Scene, robot: Robot, parameters: SimulationParameters, seed: int
    ) -> None:
        self.bows = bows(scene.objects, parameters.stem, seed)  # alike whatever the disturbances
        scene, self.miscalibration = disturbed(scene, parameters.disturbance, seed)
        if not self.miscalibration.is_identity:
            turn = self.miscalibration.rotation
            self.bows = {name: turn @ bow for name, bow in self.bows.items()}
        self.scene, self.robot, self.parameters = scene, robot, parameters
        self.entities: list[Entity] = list(link_entities(robot))
        self.fruits: list[tuple[SceneObject, BuiltFruit, int, int]] = []
        self.spec = self._options()
        add_robot(self.spec, robot, parameters, 0)
        self.trusses = trusses_of(scene.objects, parameters, scene.up)
        p, k = parameters.thing, parameters.thing.cluster_stiffness
        for obj in parents_first(scene.objects):
            if obj.role in ("target", "pushable"):
                self._fruit(obj)
            elif obj.role == "static":
                rough = [obj.physical.get("friction", p.friction), 0.005, 1e-4]
                solref = [p.contact_time, 1.0]
                self._solid(obj, rgba=STATIC_COLOUR, friction=rough, solref=solref)
            elif p.avoid_as == "soft":
                rough, solref = [0.1, 0.005, 1e-4], [-k, -2.0 * np.sqrt(k)]
                self._solid(obj, rgba=AVOID_COLOUR, friction=rough, priority=1, solref=solref)
        if p.avoid_as == "fruits":
            rng = np.random.default_rng(seed)
            for obj in scene.avoid:
                self._cluster(obj, rng)
        add_grip(self.spec, scene, robot)
        self._floor()
        self._lights()

    def _options(self) -> Any:
        mujoco = engine()
        spec = mujoco.MjSpec()
        spec.modelname = self.scene.name
        spec.compiler.degree = False
        spec.nuser_geom = 1
        spec.memory = 64 * 1024 * 1024
        option, p = spec.option, self.parameters.engine
        option.timestep = p.timestep
        option.gravity = -p.gravity * self.scene.up
        option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
        option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        option.solver = mujoco.mjtSolver.mjSOL_NEWTON
        option.iterations = int(p.iterations)
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        view = getattr(spec.visual, "global")
        view.offwidth, view.offheight = PICTURE
        return spec

    def _floor(self) -> None:
        up = np.asarray(self.scene.up)
        bounded = (item for item in self.scene.objects if np.isfinite(item.radius))
        low = min((float(item.position @ up) - item.radius for item in bounded), default=0.0)
        self.spec.worldbody.add_geom(
            name=FLOOR, type=engine().mjtGeom.mjGEOM_PLANE, size=[0.0, 0.0, 1.0],
            pos=(min(low, 0.0) - FLOOR_DEPTH) * up, quat=to_quaternion(frame_along(up)),
            userdata=[float(NOBODY)], **layers("floor"),
        )  # fmt: skip

    def _lights(self) -> None:
        mujoco, world = engine(), self.spec.worldbody
        self.spec.add_texture(
            name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=384,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=SKY[0], rgb2=SKY[1],
        )  # fmt: skip
        world.add_light(pos=[1.5, -1.5, 2.5], dir=[-0.5, 0.5, -0.8], diffuse=[0.45] * 3)
        world.add_light(
            pos=[-1.0, 1.5, 2.0], dir=[0.5, -0.6, -0.7], diffuse=[0.2] * 3, castshadow=False
        )

    def _entity(self, kind: Any, name: str) -> int:
        self.entities.append(Entity(kind, name))
        return len(self.entities) - 1

    def _fruit(self, obj: SceneObject) -> None:
        entity = self._entity("fruit" if obj.stem is not None else "thing", obj.id)
        stem = -1 if obj.stem is None else self._entity("stem", obj.id)
        if obj.role == "target" and len(self.scene.taken) > 1:
            self.trusses[obj.id] = self._severed(obj)
        built = add_fruit(
            self.spec, obj, self.parameters, entity, stem, self.scene.up,
            truss=self.trusses.get(obj.id), bow=self.bows.get(obj.id),
        )  # fmt: skip
        self.fruits.append((obj, built, entity, stem))

    def _severed(self, obj: SceneObject) -> Truss:
        """The truss of the target, whose root is a light free body; :func:`add_grip` welds it."""
        assert obj.stem is not None
        if self.parameters.disturbance.in_motion:
            raise InvalidRequestError("approach.truss: simulated on plants that stand; sway none")
        root = self.spec.worldbody.add_body(name=PEDUNCLE, pos=obj.stem.root, explicitinertial=True)
        root.mass, root.inertia = LIGHT, [LIGHT * STEM_RADIUS**2] * 3
        root.add_freejoint(name=PEDUNCLE)
        return replace(self.trusses[obj.id], grows_from=(PEDUNCLE, obj.stem.root))

    def _solid(self, obj: SceneObject, **surface: Any) -> None:
        """A static object, or a neighbouring cluster that yields as a solid."""
        kind: Any = obj.role
        body = self.spec.worldbody.add_body(name=f"{kind}:{obj.id}", mocap=obj.course is not None)
        entity = float(self._entity(kind, obj.id))
        add_shape(
            self.spec, body, obj.shape, f"{kind}:{obj.id}", obj.rotation, obj.position, condim=3,
            userdata=[entity], **layers(kind), **surface,
        )  # fmt: skip

    def _cluster(self, obj: SceneObject, rng: np.random.Generator) -> None:
        """A neighbouring cluster as fruits within the shape's ball, each on a vertical stem."""
        p = self.parameters.thing
        entity = self._entity("avoid", obj.id)
        count = int(p.cluster_fruits)
        reach = max(obj.radius - CLUSTER_FRUIT_RADIUS, 0.0)
        golden = np.pi * (3.0 - np.sqrt(5.0))
        turn = rng.uniform(0.0, 2.0 * np.pi)
        for k in range(count):
            z = 1.0 - 2.0 * (k + 0.5) / count
            flat = np.sqrt(1.0 - z * z)
            direction = np.array(
                [flat * np.cos(turn + k * golden), flat * np.sin(turn + k * golden), z]
            )
            center = obj.position + reach * direction
            root = center + (p.cluster_stem + reach * (1.0 - z)) * self.scene.up
            stem, ball = Stem(np.array([center, root])), Sphere(CLUSTER_FRUIT_RADIUS)
            motion = obj.motion and obj.motion.shifted(center - obj.position)
            fruit = SceneObject(obj.id, "avoid", ball, center, stem=stem, motion=motion)
            built = add_fruit(
                self.spec, fruit, self.parameters, entity, entity, self.scene.up,
                key=f"{obj.id}:{k}", kind="avoid",
            )  # fmt: skip
            self.fruits.append((fruit, built, entity, entity))

    def compile(self) -> Any:
        try:
            return self.spec.compile()
        except ValueError as error:
            told = " ".join(str(error).split())
            raise InvalidRequestError(f"MuJoCo cannot build the scene: {told}") from error

    def overlapping(self, model: Any) -> list[tuple[int, int]]:
        """Pairs of entities that overlap in the scene's pose, the robot left out."""
        mujoco = engine()
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        who = _owners(model)
        out = set()
        for (g1, g2), distance in zip(data.contact.geom, data.contact.dist, strict=True):
            a, b = sorted((int(who[g1]), int(who[g2])))
            if distance < 0.0 and self.entities[a].kind not in ("link", "tool"):
                standing = {self.entities[a].kind, self.entities[b].kind} == {"thing", "static"}
                if a != b and not (standing and distance > -1e-3):  # [m] an object on a board
                    out.add((a, b))
        return sorted(out)

    def exclude(self, a: int, b: int) -> None:
        for one in self._bodies(a):
            for other in self._bodies(b):
                self.spec.add_exclude(bodyname1=one, bodyname2=other)

    def _bodies(self, entity: int) -> list[str]:
        kind, name = self.entities[entity].kind, self.entities[entity].name
        soft = self.parameters.thing.avoid_as == "soft"
        if kind == "static" or (kind == "avoid" and soft):
            return [f"{kind}:{name}"]
        out = []
        for _, built, whole, stem in self.fruits:
            if whole == entity:
                out.append(f"fruit:{built.key}")
            if stem == entity:
                out += [f"stem:{built.key}:{k}" for k in range(len(built.nodes) - 1)]
        return out

    def world(
        self, model: Any, overlapping: tuple[tuple[str, str], ...], parted: Mapping[str, float]
    ) -> World:
        return World(
            model, self.scene, self.robot, self.parameters, drives(self.robot),
            tuple(self.entities), frozen(_owners(model), np.int64),
            tuple(self._located(model, *item) for item in self.fruits), overlapping,
            parted, self.spec, miscalibration=self.miscalibration,
        )  # fmt: skip

    def _located(
        self, model: Any, obj: SceneObject, built: BuiltFruit, entity: int, stem: int
    ) -> Fruit:
        body = model.body(f"fruit:{built.key}").id
        free = model.joint(f"free:{built.key}")
        weld, dofs, last, along = -1, np.zeros(0, dtype=np.int64), -1, np.zeros(3)
        if built.has_stem:
            count = len(built.nodes) - 1
            first = [model.joint(f"bend:{built.key}:{k}").dofadr[0] for k in range(count)]
            dofs = (np.array(first, dtype=np.int64)[:, None] + np.arange(3)).ravel()
            weld = model.equality(f"weld:{built.key}").id
            last = model.body(f"stem:{built.key}:{count - 1}").id
            along = built.nodes[-2] - built.nodes[-1]
            along = along / np.linalg.norm(along)
        return Fruit(
            built.id, obj.role, built, entity, stem, body, int(free.qposadr[0]),
            int(free.dofadr[0]), weld, dofs, last, frozen(along), frozen(axis_of(obj)),
        )  # fmt: skip


def _owners(model: Any) -> IntArray:
    owners: IntArray = np.asarray(model.geom_user)[:, 0].astype(np.int64)
    return owners


def _reach(model: Any, body: int) -> float:
    """Radius about the body's origin of a ball that contains its shape [m]."""
    geoms = slice(model.body_geomadr[body], model.body_geomadr[body] + model.body_geomnum[body])
    away = np.linalg.norm(model.geom_pos[geoms], axis=1)
    return float((away + model.geom_rbound[geoms]).max())


def grown(scene: Scene, seed: int) -> Scene:
    """The scene with a stem drawn by the ``seed`` for each that nobody saw."""
    rng, objects = np.random.default_rng([seed, 40]), []
    for item in scene.objects:
        stem = item.stem
        if stem is not None and stem.unseen:
            across = np.tan(math.radians(stem.tilt or 0.0) * rng.standard_normal(2))
            axes = frame_along(stem.vector / np.linalg.norm(stem.vector))
            way = axes[:, 2] + axes[:, :2] @ across
            length = stem.length * math.exp(UNSEEN_SPREAD * rng.standard_normal())
            item = replace(item, stem=Stem.along(stem.points[0], way, length, stem.radius))
        objects.append(item)
    return replace(scene, objects=tuple(objects)) if scene.assumed else scene


def apart(scene: Scene) -> tuple[Scene, dict[str, float]]:
    """The scene with overlapping fruits moved apart, and the distance of each move, by id [m].

    Only hanging fruits are moved; the roots of their stems stay.
    """
    hanging = [
        item
        for item in scene.objects
        if item.stem is not None and item.role in ("target", "pushable")
    ]
    by = {item.id: shift for item, shift in zip(hanging, shifts(hanging), strict=True)}
    far = {name: float(np.linalg.norm(shift)) for name, shift in by.items()}
    far = {name: size for name, size in far.items() if size > 0.0}
    if not far:
        return scene, {}
    objects = (
        item.shifted(by[item.id], "object") if item.id in far else item for item in scene.objects
    )
    return replace(scene, objects=rooted(objects)), far


GRIP = "grip"
"""Name of the weld between the tool and the target; it holds from the pick to the release."""
PEDUNCLE = "peduncle"  # the root of a truss that is cut, and the weld that holds it until then
LIGHT = 1e-3  # [kg] chosen: of that root, about that of a piece of stem


def add_grip(spec: Any, scene: Scene, robot: Robot) -> None:
    """Add the weld, which does not hold yet, after those of the stems; for a tool and a target.

    Of a scissor it is a ball joint, unless it holds a truss: the root of that is welded until then.
    """
    mujoco, truss = engine(), len(scene.taken) > 1
    swings = isinstance(unmounted(robot.tool), Scissor) and not truss
    weld, body = mujoco.mjtEq.mjEQ_WELD, mujoco.mjtObj.mjOBJ_BODY
    if truss:
        spec.add_equality(
            name=PEDUNCLE, type=weld, objtype=body, name1="world", name2=PEDUNCLE, **FIRM
        ).data = [*[0.0] * 10, 1.0, 0.0]  # about the root itself
    if robot.tool is None or scene.target is None:
        return
    spec.add_equality(
        name=GRIP, type=mujoco.mjtEq.mjEQ_CONNECT if swings else weld, active=False, objtype=body,
        name1="tool", name2=f"fruit:{scene.target.id}", **(FIRM if truss else {}),
    )  # fmt: skip


def shifts(objects: Sequence[SceneObject]) -> FloatArray:
    """Motions (N, 3) of N hanging fruits after which no two of them overlap [m]."""
    balls = [hanging_balls(item) for item in objects]
    seen = np.array([own.center for own in balls]).reshape(-1, 3)
    root = np.array([t.stem.points[-1] for t in objects if t.stem is not None]).reshape(-1, 3)
    fruit = seen[None].copy()
    part(
        fruit,
        root[None],
        np.array([own.radius for own in balls]),
        np.array([own.above for own in balls]),
        np.array([own.apart for own in balls]),
    )
    return np.asarray(fruit[0] - seen)
