"""Fruits on flexible stems, and objects that stand on something."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
import scipy.linalg

from optipromp.core.arrays import FloatArray, frozen, lengths
from optipromp.core.geometry.shapes import Capsule, Cylinder, Sphere
from optipromp.core.robots.tool_protocol import quaternion
from optipromp.core.scenes.objects import least_stiffness, mass_of, nearest, parents_first
from optipromp.core.scenes.scene import SceneObject, Stem
from optipromp_sim.simulation.disturbances import add_carriage
from optipromp_sim.simulation.engine import add_shape, engine, layers, mass_center
from optipromp_sim.simulation.parameters import SimulationParameters, StemParameters


class StemChain(NamedTuple):
    """A stem as a chain of N pieces."""

    nodes: FloatArray  # (N+1, 3) joints and the end at the fruit, root first [m]
    masses: FloatArray  # (N,) of the pieces [kg]
    fruit: float  # mass of the fruit [kg]
    center: FloatArray  # (3,) of the fruit's mass [m]
    parent: str | None  # id of the object whose stem it grows from; None: it is rooted in the world
    link: int  # piece of that stem from which it grows

    @property
    def middles(self) -> FloatArray:
        """(N, 3) of the pieces [m]."""
        return 0.5 * (self.nodes[:-1] + self.nodes[1:])

    def bowed(self, bow: FloatArray) -> Self:
        """The chain along half a sine wave, whose middle is off the line by ``bow`` (3,) [m]."""
        gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.nodes, axis=0), axis=1)))
        off = np.sin(np.pi * gone / gone[-1])
        off[-1] = 0.0
        return self._replace(nodes=self.nodes + off[:, None] * bow)


def holding(
    nodes: FloatArray, points: FloatArray, masses: FloatArray, gravity: FloatArray, last: int
) -> FloatArray:
    """Torques (N, 3) at the joints up to ``last`` that carry ``masses`` at ``points`` [N m]."""
    beyond = points[None] - nodes[: last + 1, None]
    out = np.zeros((len(nodes) - 1, 3))
    out[: last + 1] = -np.cross(beyond, (masses[:, None] * gravity)[None]).sum(axis=1)
    return out


def carried(
    chains: Mapping[str, StemChain], gravity: FloatArray
) -> tuple[dict[str, FloatArray], dict[str, dict[str, FloatArray]]]:
    """Torques (N, 3) at the joints of the stems that carry others [N m].

    ``chains``: of all stems, by the ids of their fruits. ``gravity``: (3,) [m/s²].

    Returns: The torques that carry the stems which grow from a stem, by the id of that stem's
    fruit. The torques that carry each fruit, by its id and by the id of the carrying stem's fruit.
    """
    stems: dict[str, FloatArray] = {}
    fruits: dict[str, dict[str, FloatArray]] = {}
    for name, chain in chains.items():
        at = chain
        while at.parent is not None:
            below = chains[at.parent]
            own = holding(below.nodes, chain.middles, chain.masses, gravity, at.link)
            stems[at.parent] = stems.get(at.parent, 0.0) + own
            fruits.setdefault(name, {})[at.parent] = holding(
                below.nodes, chain.center[None], np.array([chain.fruit]), gravity, at.link
            )
            at = below
    return stems, fruits


RIPE = (0.80, 0.08, 0.10, 1.0)
UNRIPE = (0.55, 0.72, 0.30, 1.0)
STEM_COLOUR = (0.30, 0.50, 0.18, 1.0)
CAN_GAP = 1e-3  # [m] by which the capsule in a can is shorter than the can
UNSEEN = (0.0, 0.0, 0.0, 0.0)  # colour
SWEEPS = 8  # of the search for a damping time; each brings its ratio nearer by some 3 times
BOUNCE = 0.17  # damping ratio of a fruit that stretches its stem: a guess, as coffee on its pedicel
# [rad] turns of stems that stand still at rest, once their load goes. An elastic stem that holds a
# load off the vertical falls over from 2.7 on, one that holds the bow of a thread from 60 on.
STATED_TURN, BOW_TURN = 2.0, 20.0
# of the joint between stem and fruit: [s] its time constant; all but 1e-4 of a load at once
FIRM = {"solref": [0.004, 1.0], "solimp": [0.9999, 0.9999, 0.001, 0.5, 2.0]}


@dataclass(frozen=True, eq=False)
class BuiltFruit:
    """A fruit as built: the names of its bodies, and the torques that hold its stem up."""

    id: str  # of the scene's object
    key: str  # in the names of its bodies
    mass: float  # [kg]
    nodes: FloatArray  # (N+1, 3) joints and end of the stem, root first [m]; empty without a stem
    # (N, 3) torques at the joints that carry stem and fruit in the scene's pose [N m]
    grown: FloatArray
    bare: FloatArray  # (N, 3) torques at the joints that carry the stem alone [N m]
    abscission: float  # pull that tears the fruit off [N]
    # whether it is one of the scene's objects (not part of a neighbouring cluster)
    shown: bool = True
    # torques (K, 3) at the joints of other stems that carry the fruit, by the ids of the fruits of
    # those stems [N m]
    carried_by: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def has_stem(self) -> bool:
        """Whether the fruit hangs on a stem."""
        return len(self.nodes) > 0


def add_fruit(
    spec: Any, obj: SceneObject, parameters: SimulationParameters, entity: int, stem_entity: int,
    up: FloatArray, *, key: str | None = None, kind: str | None = None, truss: Truss | None = None,
    bow: FloatArray | None = None,
) -> BuiltFruit:  # fmt: skip
    """Add a target or pushable: a free body, welded to the end of its stem where it has one.

    ``entity``, ``stem_entity``: user data of the geoms of fruit and stem. ``up``: (3,) unit,
    opposite to gravity. ``key``: in the names of the bodies; None: the object's id. ``kind``: None
    for an object of the scene. ``truss``: loads that its stem shares with others. ``bow``: (3,)
    from the straight line to the middle of its stem [m], see :func:`bows`.
    """
    mujoco = engine()
    key = obj.id if key is None else key
    mass = _mass(obj, parameters)
    _add_body(spec, obj, parameters, mass, entity, key, kind)
    if obj.stem is None:
        none = frozen(np.zeros((0, 3)))
        return BuiltFruit(obj.id, key, mass, none, none, none, np.inf)
    gravity = -parameters.engine.gravity * up
    straight = chain_of(obj, obj.stem, parameters)
    chain = straight if bow is None else straight.bowed(bow)
    bare, grown = _held(chain, gravity, truss)
    load = _load(straight.nodes, _held(straight, gravity, truss)[1])
    carries = truss is not None and truss.carries is not None
    stiffness = _stiffness(obj, load, parameters.stem, carries=carries)
    heavy = chain.fruit + float(chain.masses.sum()) + (0.0 if truss is None else truss.load)
    *bends, rigid = lengths(np.diff([*straight.nodes, straight.center], axis=0))
    height = (straight.center - straight.nodes[0]) @ up
    upright = least_stiffness(heavy, height, sum(bends), rigid)
    stiffness = max(stiffness, _load(chain.nodes, grown) / BOW_TURN, float(upright))
    nodes = chain.nodes
    grows_from = None if truss is None else truss.grows_from
    if grows_from is None and (parameters.disturbance.in_motion or obj.course is not None):
        grows_from = add_carriage(spec, key, nodes[0])
    _add_chain(spec, obj.stem, chain, stiffness, parameters, key, stem_entity, grows_from)
    if parameters.stem.stretch > 0.0:
        _add_stretch(spec, chain, parameters, gravity, key, truss)
    mouth = obj.rotation.T @ (nodes[-1] - obj.position)
    weld = spec.add_equality(
        name=f"weld:{key}", type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY,
        name1=f"stem:{key}:{len(nodes) - 2}", name2=f"fruit:{key}", active=True,
        **FIRM,
    )  # fmt: skip
    turns = 1.0 if parameters.stem.calyx == "rigid" else 0.0  # MuJoCo's torquescale
    weld.data = [*mouth, *[0.0] * 7, turns, *[0.0] * (len(weld.data) - 11)]
    for k in range(len(nodes) - 1):
        spec.add_exclude(bodyname1=f"fruit:{key}", bodyname2=f"stem:{key}:{k}")
    force = obj.physical.get("abscission_force", parameters.stem.abscission_force)
    return BuiltFruit(
        obj.id, key, mass, frozen(nodes), frozen(grown), frozen(bare), force, kind is None,
        {} if truss is None else truss.carried_by,
    )  # fmt: skip


def _held(
    chain: StemChain, gravity: FloatArray, truss: Truss | None
) -> tuple[FloatArray, FloatArray]:
    """Torques (N, 3) at the joints that hold a chain in place, without and with its fruit [N m]."""
    nodes = chain.nodes
    bare = sum(
        (holding(nodes, middle[None], chain.masses[[k]], gravity, k)  # joints 0 to k carry piece k
         for k, middle in enumerate(chain.middles)),
        np.zeros((len(nodes) - 1, 3)),
    )  # fmt: skip
    fruit = np.array([chain.fruit])
    grown = bare + holding(nodes, chain.center[None], fruit, gravity, len(nodes) - 2)
    if truss is not None and truss.carries is not None:
        bare, grown = bare + truss.carries, grown + truss.carries
    return bare, grown


def bows(objects: Sequence[SceneObject], stem: StemParameters, seed: int) -> dict[str, FloatArray]:
    """Vector (3,) from the line of each straight stem to its middle, across the line, by fruit [m].

    A perfectly straight stem pressed along its line is a strut, and no stem grows so. Length and
    direction are sampled for each stem. A stem of more than two points keeps the form of its scene,
    and a stem that others grow from stays straight.
    """
    carrying = {item.stem.parent for item in objects if item.stem is not None}
    out = {}
    for k, item in enumerate(objects):
        if item.stem is None or len(item.stem.points) > 2 or item.id in carrying:
            continue
        share, turn = np.random.default_rng([seed, 3, k]).random(2)
        line = item.stem.vector
        side = np.cross(line, np.eye(3)[int(np.argmin(np.abs(line)))])
        side /= np.linalg.norm(side)
        other = np.cross(line, side) / np.linalg.norm(line)
        angle = 2.0 * np.pi * turn
        size = stem.bow_least + share * (stem.bow_most - stem.bow_least)
        size *= float(np.linalg.norm(line))
        out[item.id] = size * (np.cos(angle) * side + np.sin(angle) * other)
    return out


def _add_body(
    spec: Any, obj: SceneObject, parameters: SimulationParameters, mass: float, entity: int,
    key: str, kind: str | None,
) -> None:  # fmt: skip
    """The free body of a fruit or object, with its shape."""
    hangs = obj.stem is not None
    group = parameters.fruit if hangs else parameters.thing
    friction = obj.physical.get("friction", group.friction)
    body = spec.worldbody.add_body(
        name=f"fruit:{key}", pos=obj.position, quat=quaternion(obj.rotation)
    )
    body.add_freejoint(name=f"free:{key}")
    look: dict[str, Any] = {
        "rgba": RIPE if obj.role == "target" else UNRIPE,
        "friction": [friction, 0.005, parameters.fruit.rolling_friction],
        "condim": 3 if hangs else 6,
        "solref": [group.contact_time, 1.0],
        "userdata": [float(entity)],
    }
    shape, kind_of = obj.shape, layers("fruit" if hangs else "thing")
    turn, at = np.eye(3), np.zeros(3)
    if not hangs and isinstance(shape, Cylinder) and shape.length > 2.0 * shape.radius + CAN_GAP:
        geoms = add_shape(spec, body, shape, f"fruit:{key}", turn, at, **look, **layers("foot"))
        side = Capsule(shape.radius, shape.length - 2.0 * shape.radius - CAN_GAP)
        look = {**look, "rgba": UNSEEN, "mass": 0.0}
        add_shape(spec, body, side, f"fruit:{key}:side", turn, at, **look, **kind_of)
    else:
        geoms = add_shape(spec, body, shape, f"fruit:{key}", turn, at, **look, **kind_of)
    for geom in geoms:
        geom.mass = mass / len(geoms)


@dataclass(frozen=True, eq=False)
class Truss:
    """A stem's connections to others."""

    # name of the body that the stem grows from, and that body's joint (3,) [m]; None where its root
    # is fixed
    grows_from: tuple[str, FloatArray] | None
    # (N, 3) torques at its joints that carry the stems and fruits that hang on it [N m]; None where
    # none do
    carries: FloatArray | None
    load: float  # mass of these [kg]
    carried_by: Mapping[str, FloatArray]  # see :class:`BuiltFruit`


def trusses_of(
    objects: Sequence[SceneObject], parameters: SimulationParameters, up: FloatArray
) -> dict[str, Truss]:
    """The trusses of the stems that grow from others or carry others, by their fruits' ids."""
    hanging = [item for item in objects if item.stem is not None]
    if all(item.stem is None or item.stem.parent is None for item in hanging):
        return {}
    chains: dict[str, StemChain] = {}
    for item in parents_first(hanging):
        assert item.stem is not None
        chain = chain_of(item, item.stem, parameters)
        if chain.parent is not None:
            chain = chain._replace(link=nearest(chains[chain.parent].nodes, chain.nodes[0])[0])
        chains[item.id] = chain
    stems, fruits = carried(chains, -parameters.engine.gravity * up)
    out = {}
    for name, chain in chains.items():
        held = [own[name] for own in fruits.values() if name in own]
        grows = None
        if chain.parent is not None:
            joint = chains[chain.parent].nodes[chain.link]
            grows = f"stem:{chain.parent}:{chain.link}", joint
        if grows is not None or held:
            carries = stems[name] + np.sum(held, axis=0) if held else None
            on_it = (chains[other] for other, own in fruits.items() if name in own)
            load = float(sum(each.fruit + each.masses.sum() for each in on_it))
            out[name] = Truss(grows, carries, load, fruits.get(name, {}))
    return out


def _mass(obj: SceneObject, parameters: SimulationParameters) -> float:
    group = parameters.thing if obj.stem is None else parameters.fruit
    return mass_of(obj, group.density)


def chain_of(obj: SceneObject, stem: Stem, parameters: SimulationParameters) -> StemChain:
    """The chain of a stem; its ``link`` is left at 0."""
    nodes, p = _nodes(obj, stem, parameters), parameters.stem
    pieces = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    masses = p.density * np.pi / 4.0 * p.diameter**2 * pieces
    center = obj.position + obj.rotation @ mass_center(obj.shape)
    return StemChain(nodes, masses, _mass(obj, parameters), center, stem.parent, 0)


def _nodes(obj: SceneObject, stem: Stem, parameters: SimulationParameters) -> FloatArray:
    """Joints of the chain (N+1, 3): the root first, the fruit's surface last."""
    points = np.array(stem.points)
    first = points[1] - points[0]
    length = float(np.linalg.norm(first))
    if isinstance(obj.shape, Sphere) and np.linalg.norm(points[0] - obj.position) < 1e-9:
        points[0] += first * min(obj.radius / length, 0.8)
    points = points[::-1]
    pieces = np.linalg.norm(np.diff(points, axis=0), axis=1)
    p = parameters.stem
    wanted = pieces.sum() / p.segment_length
    total = int(np.clip(np.ceil(wanted), p.least_segments, p.most_segments))
    counts = np.maximum(np.round(total * pieces / pieces.sum()).astype(int), 1)
    nodes = [points[0]]
    for start, end, count in zip(points[:-1], points[1:], counts, strict=True):
        nodes += [start + (end - start) * (i + 1) / count for i in range(count)]
    return np.array(nodes)


def _bends(pieces: FloatArray) -> FloatArray:
    """Length of stem (N,) that bends at each joint [m]: half of the ``pieces`` (N,) beside it.

    Scaled so that the tip of a straight chain deflects under a force as a beam's, by S³ / 3EI.
    """
    bends: FloatArray = np.concatenate([[0.5 * pieces[0]], 0.5 * (pieces[:-1] + pieces[1:])])
    to_tip = np.cumsum(pieces[::-1])[::-1]
    scale = float(to_tip[0] ** 3 / (3.0 * (bends @ to_tip**2)))
    return bends * scale


def _load(nodes: FloatArray, grown: FloatArray) -> float:
    r"""Load of a chain :math:`\sum_i |M_i| l_i` [N m² rad].

    ``grown`` (N, 3) are the moments that hold it at its joints [N m], which stand for the lengths
    :math:`l_i`. Over EI, it is the angle by which the stem turns once the moments go.
    """
    pieces = np.linalg.norm(np.diff(nodes, axis=0), axis=1)
    return float(np.linalg.norm(grown, axis=1) @ _bends(pieces))


def _stiffness(obj: SceneObject, load: float, stem: StemParameters, *, carries: bool) -> float:
    """EI of a stem [N m²]: the object's, else the modulus's; no less than its load needs.

    ``load``: of the straight chain, see :func:`_load`. A stem of the modulus's EI turns by at most
    ``stem.grown_turn`` once the load goes, one of the object's EI by :data:`STATED_TURN`.
    """
    if "stem_stiffness" in obj.physical:
        return max(float(obj.physical["stem_stiffness"]), load / STATED_TURN)
    thickness = stem.truss_diameter if carries else stem.diameter
    round_beam = stem.youngs_modulus * np.pi * thickness**4 / 64.0
    return max(round_beam, load / max(stem.grown_turn, 1e-6))


def damping_time(
    chain: StemChain, springs: FloatArray, ratio: float, gravity: float, armature: float
) -> float:
    """Damping over stiffness of a chain's joints at which its slowest swing has a damping ratio.

    The swing is small, about plumb, of the chain's pieces and of the fruit as a ball that turns
    with the last piece: the first mode v of M θ'' + τ S θ' + (S + G) θ = 0, with the ``springs`` S
    (N,) of the joints [N m/rad] and the pull G of ``gravity`` [m/s²]. If damping left v as it is,
    2 ζ ω were τ vᵀSv; τ is scaled until the ratio is that of the damped mode.
    """
    pieces = np.linalg.norm(np.diff(chain.nodes, axis=0), axis=1)
    below = float(np.linalg.norm(chain.center - chain.nodes[-1]))
    turn = np.tril(np.ones((len(pieces), len(pieces))))  # angles of pieces by those of joints
    arms = np.vstack([np.tril(np.tile(pieces, (len(pieces), 1))), pieces])
    arms[:-1][np.diag_indices(len(pieces))] *= 0.5
    arms[-1, -1] += below  # (N+1, N) lengths from the root to the masses, along each piece
    masses = np.append(chain.masses, chain.fruit)
    aside = arms @ turn
    mass = aside.T @ (masses[:, None] * aside) + armature * np.eye(len(pieces))
    mass += 0.4 * chain.fruit * below**2  # of a ball; every joint turns it alike
    stiff = np.diag(springs) + turn.T @ ((gravity * masses @ arms)[:, None] * turn)
    squares, modes = scipy.linalg.eigh(stiff, mass, subset_by_index=[0, 0])
    time = float(2.0 * ratio * np.sqrt(squares[0]) / (springs @ modes[:, 0] ** 2))
    unit, inverse = np.eye(len(mass)), np.linalg.inv(mass)
    for _ in range(SWEEPS):
        damped = np.block([[0.0 * unit, unit], [-inverse @ stiff, -time * inverse * springs]])
        rates = np.linalg.eigvals(damped)
        swing = min(rates[rates.imag > 1e-9 * np.abs(rates)], key=abs, default=-1.0)
        time *= ratio / float(-swing.real / abs(swing))
    return time


def _add_chain(
    spec: Any, stem: Stem, chain: StemChain, stiffness: float, parameters: SimulationParameters,
    key: str, entity: int, grows_from: tuple[str, FloatArray] | None,
) -> None:  # fmt: skip
    """Add capsules with ball joints, of stiffness EI over the length that bends at the joint."""
    mujoco = engine()
    p, nodes, masses = parameters.stem, chain.nodes, chain.masses
    bends = _bends(np.linalg.norm(np.diff(nodes, axis=0), axis=1))
    lag, braked = p.damping_time, p.swing_damping
    if p.damping_ratio > 0.0:
        springs = stiffness / bends
        lag = damping_time(chain, springs, p.damping_ratio, parameters.engine.gravity, p.armature)
        braked = 0.0
    lag = max(lag - parameters.engine.timestep, 0.0)  # MuJoCo adds the stiffness x step
    body, before = spec.worldbody, np.zeros(3)
    if grows_from is not None:
        body, before = spec.body(grows_from[0]), grows_from[1]
    for k, bend in enumerate(bends):
        body = body.add_body(
            name=f"stem:{key}:{k}", pos=nodes[k] - (before if k == 0 else nodes[k - 1])
        )
        joint = body.add_joint(
            name=f"bend:{key}:{k}", type=mujoco.mjtJoint.mjJNT_BALL, armature=p.armature
        )
        joint.stiffness[0] = stiffness / bend
        joint.damping[0] = lag * stiffness / bend + (braked if k == 0 else 0.0)
        body.add_geom(
            name=f"stem:{key}:{k}", type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            size=[stem.radius, 0.0, 0.0], fromto=[0.0, 0.0, 0.0, *(nodes[k + 1] - nodes[k])],
            mass=masses[k], rgba=STEM_COLOUR, friction=[p.friction, 0.005, 1e-4], condim=3,
            solref=[parameters.fruit.contact_time, 1.0], userdata=[float(entity)],
            **layers("stem"),
        )  # fmt: skip


def _add_stretch(
    spec: Any, chain: StemChain, parameters: SimulationParameters, gravity: FloatArray, key: str,
    truss: Truss | None,
) -> None:  # fmt: skip
    """Let a stem slide off its root along its first piece, as far as all of it stretches.

    A pull F stretches the length L by F L / EA, times ``stem.stretch``. In the scene's pose the
    spring carries what hangs on it.
    """
    mujoco, p, line = engine(), parameters.stem, np.diff(chain.nodes, axis=0)
    carries = truss is not None and truss.carries is not None
    thickness = p.truss_diameter if carries else p.diameter
    pieces = np.linalg.norm(line, axis=1)
    spring = p.youngs_modulus * np.pi / 4.0 * thickness**2 / (pieces.sum() * p.stretch)
    mass = chain.fruit + float(chain.masses.sum()) + (0.0 if truss is None else truss.load)
    joint = spec.body(f"stem:{key}:0").add_joint(
        name=f"stretch:{key}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=line[0] / pieces[0]
    )
    joint.springref = -mass * float(gravity @ line[0]) / pieces[0] / spring
    joint.stiffness[0] = spring
    numerical = spring * parameters.engine.timestep  # MuJoCo adds the stiffness x step
    joint.damping[0] = max(2.0 * BOUNCE * np.sqrt(spring * mass) - numerical, 0.0)
