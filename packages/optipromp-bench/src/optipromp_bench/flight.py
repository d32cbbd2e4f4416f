"""A second engine: a flying cup among hanging fruits, so that nobody wins by quirks of the first.

The module shares no code with :mod:`optipromp_sim.simulation`: it imports nothing of this
library, reads what scene files hold, and has numbers of its own. There is no arm and no controller:
a cup with its neck and the arm's last link follows the flange, which the Panda's published
Denavit-Hartenberg parameters place. Stems are chains of capsules with ball joints, and the fruit
turns about its calyx. A run succeeds if the target alone ends in the cup and no fruit or stem is
pressed or pulled beyond what the docs say that it bears, also while the cup leaves. Density,
friction and stiffness that a scene's objects tell are taken from there. Hanging fruits and static
boxes, built-in Panda with a cup only.
"""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

if sys.platform.startswith("linux"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # read when MuJoCo is first imported
import mujoco

# Franka Control Interface documentation, robot and interface specifications: a, d [m], α [rad]
PANDA = (
    (0.0, 0.333, 0.0), (0.0, 0.0, -np.pi / 2), (0.0, 0.316, np.pi / 2), (0.0825, 0.0, np.pi / 2),
    (-0.0825, 0.384, -np.pi / 2), (0.0, 0.0, np.pi / 2), (0.088, 0.0, np.pi / 2),
)  # fmt: skip
FLANGE = 0.107  # [m] of the flange beyond the seventh joint
DISC = 0.0315, 0.02  # [m] radius (ISO 9409-1-50-4-M6) and thickness of the flange
LINK = 0.045, 0.09  # [m] radius of the link beyond it, and where that ends

# Numbers of this engine, each other than the main simulation's (docs/simulation.md), all guesses
STEP = 0.0005  # [s]
SEGMENTS = 7
BOW = 0.03  # of a stem that nothing grows from: middle off its line, over its length
MODULUS, THICK, TRUSS = 3e7, 0.003, 0.0045  # [Pa], [m] of a stem's tissue; of one that carries
GROWN = 0.7  # [rad] a leaning stem turns at most once nothing hangs on it
CALYX = 2e-3  # [N m/rad] of the fruit about its calyx
DAMPING = 0.02  # [s] joint damping over joint stiffness: a tenth of critical at 1.5 Hz
SWAY = 3e-4  # [N m s/rad] more at the root
DENSITY, STEM_DENSITY = 1000.0, 900.0  # [kg/m³]
FRICTION = 0.5
BALLS = 7  # that a cone is made of
SOFT = 0.01  # [s] time constant of a contact
WALLS, WALL, NECK = 20, 0.002, 0.010  # pieces of the wall; [m] its thickness, radius of the neck
HOLD = 0.6  # [s] at the end
# What a fruit bears: a matter of the question, not of the engine
FRUIT_FORCE, STEM_FORCE, STEM_TIME, STATIC_FORCE = 10.0, 2.0, 0.05, 0.5  # [N], [N], [s], [N]
TEAR_FORCE = 5.0  # [N] along its stem
SMOOTH = 0.005  # [s] time constant of the filter of forces


def flange(q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (3,) [m] and rotation (3, 3) of a Panda's flange at ``q`` (7,)."""
    place, turn = np.zeros(3), np.eye(3)
    for (a, d, alpha), angle in zip(PANDA, q, strict=True):
        c, s = np.cos(alpha), np.sin(alpha)
        tilt = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        place = place + turn @ (np.array([a, 0.0, 0.0]) + tilt[:, 2] * d)
        c, s = np.cos(angle), np.sin(angle)
        turn = turn @ tilt @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return place + FLANGE * turn[:, 2], turn


def _text(values: Any) -> str:
    return " ".join(f"{value:.9g}" for value in np.ravel(values))


def _cone(tool: Mapping[str, Any]) -> str:
    """The mesh of the cone under the cup's floor, down to the neck; of a flat floor none."""
    radius, length = float(tool["radius"]), float(tool["length"])
    deep = min((radius - NECK) * np.tan(np.deg2rad(tool.get("taper") or 0.0)), length)
    edges, turns = ((radius, length), (NECK, length - deep)), np.arange(60) * np.pi / 30.0
    corners = [(r * np.cos(t), r * np.sin(t), z) for r, z in edges for t in turns]
    return f'<asset><mesh name="cone" vertex="{_text(corners)}"/></asset>' if deep > 0.0 else ""


def _cup(tool: Mapping[str, Any]) -> str:
    """The cup, its cone and neck and the arm's last link, in the flange's frame."""
    radius, height, length = (float(tool[k]) for k in ("radius", "height", "length"))
    inner = 0.5 * float(tool.get("opening") or 2.0 * (radius - WALL))
    middle, half = 0.5 * (radius + inner), 0.5 * (radius - inner)
    width = radius * np.tan(np.pi / WALLS)
    out = [
        f'<geom type="cylinder" size="{NECK}" fromto="0 0 0 0 0 {length}"/>',
        f'<geom type="cylinder" size="{radius} {0.5 * WALL}" pos="0 0 {length + 0.5 * WALL}"/>',
        '<geom type="mesh" mesh="cone"/>' if _cone(tool) else "",
        f'<geom type="cylinder" size="{DISC[0]}" fromto="0 0 0 0 0 {-DISC[1]}"/>',
        f'<geom type="cylinder" size="{LINK[0]}" fromto="0 0 {-DISC[1]} 0 0 {-LINK[1]}"/>',
    ]
    for k in range(WALLS):
        turn = 2.0 * np.pi * k / WALLS
        place = middle * np.cos(turn), middle * np.sin(turn), length + 0.5 * height
        out.append(
            f'<geom type="box" size="{half} {width} {0.5 * height}" pos="{_text(place)}" '
            f'euler="0 0 {turn}"/>'
        )
    return "".join(out)


def _shape(item: Mapping[str, Any], at: np.ndarray) -> tuple[str, float]:
    """A fruit as MJCF ``at`` (3,) from its stem's end, and its mass [kg].

    A cone is a row of balls that share its mass.
    """
    (kind, told), turn = next(iter(item["shape"].items())), item.get("orientation", [1, 0, 0, 0])
    density = item.get("physical", {}).get("density", DENSITY)
    balls = [(np.zeros(3), "")]
    if kind == "ellipsoid":
        size, volume = _text(told["radii"]), 4.0 / 3.0 * np.pi * float(np.prod(told["radii"]))
    elif kind == "cone":
        wide, tip, length = (float(told[k]) for k in ("radius", "tip", "length"))
        share, axis = np.linspace(0.0, 1.0, BALLS), np.zeros(3)
        mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), np.array(turn, dtype=float))
        radii = wide + share * (tip - wide)
        balls = [((0.5 - s) * length * axis, f"{r}") for s, r in zip(share, radii, strict=True)]
        kind, size = "sphere", ""
        volume = np.pi / 3.0 * (2.0 * wide**3 + 2.0 * tip**3)
        volume += np.pi / 3.0 * length * (wide**2 + wide * tip + tip**2)
    elif kind in ("sphere", "capsule"):
        radius, length = float(told["radius"]), float(told.get("length", 0.0))
        size = f"{radius} {0.5 * length}"
        volume = np.pi * radius**2 * (4.0 / 3.0 * radius + length)
    else:
        raise ValueError(f"{item['id']} is a {kind}: only balls, capsules, ellipsoids, cones hang")
    friction = item.get("physical", {}).get("friction", FRICTION)
    out = "".join(
        f'<geom type="{kind}" size="{size or own}" pos="{_text(at + off)}" quat="{_text(turn)}" '
        f'mass="{density * volume / len(balls)}" friction="{friction} 0.003 0.0001" '
        'contype="2" conaffinity="3"/>'
        for off, own in balls
    )
    return out, density * volume


def _ends(item: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Where a stem meets its fruit (3,), and its root (3,) [m]."""
    stem = item["stem"]
    points = np.array(stem.get("points") or [item["position"], stem["root"]], dtype=float)
    return points[0], points[-1]


def _arc(line: np.ndarray, name: str, seed: int) -> np.ndarray:
    """Joints (SEGMENTS + 1, 3) of a stem along ``line`` (3,), bowed to a side drawn by its name."""
    rng = np.random.default_rng([seed, *name.encode()])
    side = np.cross(line, rng.standard_normal(3))
    share = np.linspace(0.0, 1.0, SEGMENTS + 1)
    off = BOW * np.linalg.norm(line) * np.sin(np.pi * share) / np.linalg.norm(side)
    return np.asarray(share[:, None] * line + off[:, None] * side)


def _hanging(
    item: Mapping[str, Any], others: list[Mapping[str, Any]], seed: int, taken: str = ""
) -> tuple[str, float]:
    """A fruit on its stem as nested bodies from the root down, and their mass [kg].

    Among the ``others`` are those whose stems grow from this one. ``taken``: the id of the fruit
    that is off its stem.
    """
    calyx, root = _ends(item)
    shape, mass = _shape(item, np.array(item["position"], dtype=float) - calyx)
    line, thin = (calyx - root) / SEGMENTS, float(item["stem"].get("radius", 0.003))
    length = float(np.linalg.norm(calyx - root))
    grown: dict[int, str] = {}
    held = mass
    for other in others:
        if other["stem"].get("parent") != item["id"]:
            continue
        _, begins = _ends(other)
        share = float((begins - root) @ (calyx - root)) / length**2
        k = int(np.clip(share * SEGMENTS, 0, SEGMENTS - 1))
        text, more = _hanging({**other, "begins": begins - root - k * line}, others, seed, taken)
        grown[k], held = grown.get(k, "") + text, held + more
    thick = TRUSS if grown else THICK
    lean = float(np.linalg.norm((calyx - root)[:2])) / length
    tissue = MODULUS * np.pi * thick**4 / 64.0
    bending = max(tissue, held * 9.81 * lean * length**2 / (2.0 * GROWN))
    stiff = item.get("physical", {}).get("stem_stiffness", bending) * SEGMENTS / length
    light = STEM_DENSITY * np.pi * (0.5 * thick) ** 2 * length / SEGMENTS
    name = item["id"]
    pieces = np.diff(_arc(calyx - root, name, seed), axis=0)
    if grown:
        pieces[:] = line
    out = (
        f'<body name="{name}" pos="{_text(pieces[-1])}"><joint name="calyx:{name}" type="ball" '
        f'pos="0 0 0" stiffness="{CALYX}" damping="{DAMPING * CALYX + 1e-5}" armature="1e-6"/>'
        + shape
        + f'<site name="{name}" pos="{_text(np.array(item["position"]) - calyx)}"/></body>'
    )
    out = "" if name == taken else out
    for k in reversed(range(SEGMENTS)):
        stiffness = 2.0 * stiff if k == 0 else stiff
        place = item.get("begins", root) if k == 0 else pieces[k - 1]
        out = (
            f'<body name="{name}:{k}" pos="{_text(place)}"><joint type="ball" '
            f'stiffness="{stiffness}" damping="{DAMPING * stiffness + (SWAY if k == 0 else 0.0)}" '
            f'armature="1e-6"/><geom type="capsule" size="{thin}" '
            f'fromto="0 0 0 {_text(pieces[k])}" '
            f'mass="{light}" contype="4" conaffinity="1"/>{out}{grown.get(k, "")}</body>'
        )
    return out, held + SEGMENTS * light


def _static(item: Mapping[str, Any]) -> str:
    (size,) = (told["size"] for kind, told in item["shape"].items() if kind == "box")
    turn = item.get("orientation", [1, 0, 0, 0])
    return (
        f'<body name="{item["id"]}" pos="{_text(item["position"])}" quat="{_text(turn)}">'
        f'<geom type="box" size="{_text(0.5 * np.array(size))}" contype="8" conaffinity="3"/>'
        "</body>"
    )


Pose = tuple[np.ndarray, np.ndarray]
"""Place (3,) and quaternion (4,)."""


def model_of(
    scene: Mapping[str, Any], seed: int = 0, held: tuple[str, Pose] | None = None
) -> mujoco.MjModel:
    """The world of a scene's document: a cup led by a mocap body, fruits, static boxes.

    ``held``: id and pose in the cup of the fruit that was taken.
    """
    taken, inside = "", ""
    if held is not None:
        taken, (place, turn) = held
        item = next(item for item in scene["objects"] if item["id"] == taken)
        middle = np.array(item["position"], dtype=float) - _ends(item)[0]
        inside = (
            f'<body name="{taken}" pos="{_text(place)}" quat="{_text(turn)}">'
            f'{_shape(item, middle)[0]}<site name="{taken}" pos="{_text(middle)}"/></body>'
        )
    fruits = [item for item in scene["objects"] if item["role"] in ("target", "pushable")]
    bodies = "".join(_static(item) for item in scene["objects"] if item["role"] == "static")
    roots = [item for item in fruits if not item["stem"].get("parent")]
    bodies += "".join(_hanging(item, fruits, seed, taken)[0] for item in roots)
    return mujoco.MjModel.from_xml_string(
        f"""<mujoco><compiler angle="radian"/>
        <option timestep="{STEP}" integrator="implicitfast" cone="pyramidal" iterations="50"/>
        <size memory="32M"/>
        <default><geom friction="{FRICTION} 0.003 0.0001" solref="{SOFT} 1"/></default>
        {_cone(scene["tool"])}<worldbody><body name="lead" mocap="true"/>
        <body name="cup" gravcomp="1"><freejoint/><inertial pos="0 0 0" mass="3"
          diaginertia="0.02 0.02 0.02"/>{_cup(scene["tool"])}{inside}</body>{bodies}</worldbody>
        <equality><weld body1="lead" body2="cup" solref="0.002 1"
          solimp="0.999 0.9999 0.001"/></equality></mujoco>"""
    )


@dataclass(frozen=True)
class Word:
    """What became of a plan."""

    picked: bool  # whether the target is in the cup at the end
    swallowed: tuple[str, ...]  # ids of other fruits in the cup
    harm: tuple[str, ...]  # in words
    # largest force of the cup, or of another fruit, on any fruit but the target [N]
    unripe_peak_force: float

    @property
    def causes(self) -> tuple[str, ...]:
        """Why it is harmed, in words."""
        return (*self.harm, *(f"swallowed {name}" for name in self.swallowed))

    @property
    def success(self) -> bool:
        """The target alone is in the cup, and nothing was harmed."""
        return self.picked and not self.causes

    @property
    def result(self) -> str:
        """``clean``, ``harmed`` or ``missed``: harm counts first."""
        if self.success:
            return "clean"
        return "harmed" if self.causes else "missed"


class _Watch:
    """Forces between the cup and everything else, and between fruits, filtered."""

    def __init__(self, model: mujoco.MjModel, ids: list[str], statics: list[str]) -> None:
        names = [model.body(i).name for i in range(model.nbody)]
        self.model, self.owner = model, np.full(model.nbody, -1)
        self.labels = ["cup"]
        for i, name in enumerate(names):
            base, _, segment = name.rpartition(":")
            label = {"cup": "cup"}.get(name, f"stem of {base}" if segment.isdigit() else name)
            if name == "cup" or name in ids or name in statics or base in ids:
                if label not in self.labels:
                    self.labels.append(label)
                self.owner[i] = self.labels.index(label)
        n = len(self.labels)
        self.of_geom: np.ndarray = self.owner[model.geom_bodyid]
        self.force, self.peak, self.long = np.zeros((3, n, n))
        self.net, self.pull = np.zeros((n, 3)), np.zeros(n)  # on each; away from its stem's root
        self.pressed = False  # whether any force is not zero yet
        hanging = [name for name in ids if f"{name}:{SEGMENTS - 1}" in names and name in names]
        hanging = [k for k in hanging if model.body(k).parentid[0] != model.body("cup").id]
        self.rows: list[int] = [self.labels.index(name) for name in hanging]
        self.calyx = [model.body(name).id for name in hanging]

    def goes_on(self, before: "_Watch") -> None:
        """Take over what was measured before in a model of other bodies."""
        rows = [before.labels.index(label) for label in self.labels]
        for name in ("force", "peak", "long"):
            setattr(self, name, getattr(before, name)[np.ix_(rows, rows)])
        self.net, self.pull, self.pressed = before.net[rows], before.pull[rows], before.pressed

    def add(self, data: mujoco.MjData) -> None:
        owners = self.of_geom[data.contact.geom] if data.ncon else np.zeros((0, 2), dtype=int)
        watched = np.flatnonzero((owners >= 0).all(axis=1))
        if not (self.pressed or len(watched)):
            return
        now, wrench, self.pressed = np.zeros_like(self.force), np.zeros(6), True
        net = np.zeros_like(self.net)
        for k in watched:
            mujoco.mj_contactForce(self.model, data, k, wrench)
            (a, b), size = owners[k], float(np.linalg.norm(wrench[:3]))
            now[a, b] += size
            now[b, a] += size
            force = data.contact.frame[k].reshape(3, 3).T @ wrench[:3]
            net[b] += force
            net[a] -= force
        self.net += (net - self.net) * (STEP / SMOOTH)
        along = data.xpos[self.calyx] - data.xpos[self.model.body_parentid[self.calyx]]
        along /= np.linalg.norm(along, axis=1, keepdims=True)
        pull = np.sum(self.net[self.rows] * along, axis=1)
        self.pull[self.rows] = np.maximum(self.pull[self.rows], pull)
        self.force += (now - self.force) * (STEP / SMOOTH)
        np.maximum(self.peak, self.force, out=self.peak)
        self.long += STEP * (self.force > STEM_FORCE)

    def harm(self, ids: list[str], statics: list[str]) -> tuple[str, ...]:
        """What was pressed beyond what it bears, in words."""
        out = []
        for i, label in enumerate(self.labels):
            most = float(self.peak[i].max())
            if label in ids and most > FRUIT_FORCE:
                out.append(f"{label} pressed by {most:.1f} N")
            if label in ids and self.pull[i] > TEAR_FORCE:
                out.append(f"{label} pulled by {self.pull[i]:.1f} N")
            if label.startswith("stem of ") and self.long[i, 0] > STEM_TIME:
                out.append(f"{label} pressed by {self.peak[i, 0]:.1f} N")
            if label in statics and self.peak[i, 0] > STATIC_FORCE:
                out.append(f"{label} touched")
        return tuple(out)

    def most(self, ids: list[str]) -> float:
        """Largest force on any of the fruits ``ids`` [N]."""
        rows = [i for i, label in enumerate(self.labels) if label in ids]
        return float(self.peak[rows].max()) if rows else 0.0


class Flight:
    """The cup in flight, led from pose to pose.

    ``scene``: a scene's document: built-in Panda, a cup. ``q``: (7,) configuration at the beginning
    [rad]. ``seed``: draws to which side each stem is bowed.
    """

    def __init__(self, scene: Mapping[str, Any], q: np.ndarray, seed: int = 0) -> None:
        if scene["robot"] != "panda" or scene["tool"]["kind"] != "cup":
            raise ValueError("only a cup on the built-in Panda flies here")
        things = scene["objects"]
        self.ids = [item["id"] for item in things if item["role"] in ("target", "pushable")]
        self.statics = [item["id"] for item in things if item["role"] == "static"]
        (self.target,) = (item["id"] for item in things if item["role"] == "target")
        self.tool, self.time = scene["tool"], 0.0
        self._scene, self._seed = scene, seed
        self._lead = self._posed(q, np.zeros(4))
        self._build()

    def _build(self, held: tuple[str, Pose] | None = None) -> None:
        """The world as it is at rest, with the cup at its lead."""
        self.model = model = model_of(self._scene, self._seed, held)
        self.data = data = mujoco.MjData(model)
        self._place, self._turn = data.mocap_pos[0], data.mocap_quat[0]  # views
        start = model.joint(model.body("cup").jntadr[0]).qposadr[0]
        data.qpos[start : start + 7] = np.concatenate(self._lead)
        mujoco.mj_forward(model, data)
        stems = np.ones(model.nv, dtype=bool)
        stems[model.body("cup").dofadr[0] :][:6] = False
        data.qfrc_applied[stems] = data.qfrc_bias[stems]  # as grown: at rest where the scene is
        self._watch = _Watch(model, self.ids, self.statics)

    def take(self) -> None:
        """Cut the target off its stem, and fix the fruit in the cup where it is."""
        before, data, watch = self.model, self.data, self._watch
        cup, fruit = data.body("cup"), data.body(self.target)
        turn, quaternion = cup.xmat.reshape(3, 3), np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, (turn.T @ fruit.xmat.reshape(3, 3)).ravel())
        self._build((self.target, (turn.T @ (fruit.xpos - cup.xpos), quaternion)))
        for body in map(self.model.body, range(self.model.nbody)):
            if body.dofnum[0]:  # each has one joint: the cup is free, all others are balls
                then = before.body(body.name)
                p, v = before.jnt_qposadr[then.jntadr[0]], then.dofadr[0]
                q = self.model.jnt_qposadr[body.jntadr[0]]
                wide = body.dofnum[0] + 1
                self.data.qpos[q : q + wide] = data.qpos[p : p + wide]
                self.data.qvel[body.dofadr[0] :][: wide - 1] = data.qvel[v : v + wide - 1]
        self._place[:], self._turn[:] = self._lead
        mujoco.mj_forward(self.model, self.data)
        self._watch.goes_on(watch)

    @staticmethod
    def _posed(q: np.ndarray, near: np.ndarray) -> Pose:
        """The flange's place (3,) and quaternion (4,), of the two the one closer to ``near``."""
        place, turn = flange(q)
        quaternion = np.zeros(4)
        mujoco.mju_mat2Quat(quaternion, turn.ravel())
        return place, -quaternion if quaternion @ near < 0.0 else quaternion

    def to(self, q: np.ndarray, period: float) -> None:
        """Lead the cup to the pose at ``q`` (7,) within a ``period`` [s], a multiple of STEP."""
        before, after = self._lead, self._posed(q, self._lead[1])
        count = round(period / STEP)
        share = np.arange(count)[:, None] / count
        self._led(*(a + (b - a) * share for a, b in zip(before, after, strict=True)))
        if not np.isfinite(self.data.qpos).all():
            raise RuntimeError("the engine broke down")
        self._lead, self.time = after, self.time + period

    def _led(self, places: np.ndarray, turns: np.ndarray) -> None:
        for self._place[:], self._turn[:] in zip(places, turns, strict=True):
            mujoco.mj_step(self.model, self.data)
            self._watch.add(self.data)

    def along(self, times: np.ndarray, q: np.ndarray) -> Word:
        """Lead the cup along configurations (T, 7) at times (T,) [s], and judge all so far."""
        period = 10 * STEP  # the lead moves in steps of 5 ms, in between by interpolation
        at = np.arange(1, int(np.ceil(times[-1] / period - 1e-9)) + 1) * period
        for row in np.column_stack([np.interp(at, times, column) for column in q.T]):
            self.to(row, period)
        return self.outcome()

    def inside(self, id_: str) -> bool:
        """Whether a fruit's middle is in the cup."""
        body = self.model.body("cup").id
        turn = self.data.xmat[body].reshape(3, 3)
        x, y, z = turn.T @ (self.data.site(id_).xpos - self.data.xpos[body])
        radius, low = float(self.tool["radius"]) - WALL, float(self.tool["length"])
        return bool(np.hypot(x, y) < radius and low < z < low + float(self.tool["height"]))

    def place(self, id_: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A fruit's middle (3,), its rotation (3, 3) since the beginning, and its stem.

        The stem is its joints and its end (SEGMENTS + 1, 3), the root first.
        """
        body = self.data.body(id_)
        stem = [self.data.body(f"{id_}:{k}").xpos for k in range(SEGMENTS)]
        turn = np.array(body.xmat).reshape(3, 3)
        return np.array(self.data.site(id_).xpos), turn, np.array([*stem, body.xpos])

    def pushed(self) -> np.ndarray:
        """Force (3,) of the world on the cup in the last step [N]."""
        total, wrench = np.zeros(3), np.zeros(6)
        cup = self.model.body("cup").id
        for k in range(self.data.ncon):
            contact = self.data.contact[k]
            owners = self.model.geom_bodyid[contact.geom]
            if cup not in owners:
                continue
            mujoco.mj_contactForce(self.model, self.data, k, wrench)
            force = contact.frame.reshape(3, 3).T @ wrench[:3]
            total += force if owners[1] == cup else -force
        return total

    def harm(self) -> tuple[str, ...]:
        """What was harmed so far, in words."""
        return self._watch.harm(self.ids, self.statics)

    def shares(self) -> tuple[float, float]:
        """Largest force on a fruit, and longest press of a stem, over what each bears."""
        stems = [float(t) for n, t in zip(self._watch.labels, self._watch.long[:, 0], strict=True)
                 if n.startswith("stem of ")]  # fmt: skip
        return self._watch.most(self.ids) / FRUIT_FORCE, max(stems, default=0.0) / STEM_TIME

    def outcome(self) -> Word:
        """Stand still for a moment, and judge all that happened."""
        late, inside = HOLD - 0.3, dict.fromkeys(self.ids, True)
        period = 10 * STEP
        for k in range(round(HOLD / period)):
            self._led(*(np.tile(kept, (round(period / STEP), 1)) for kept in self._lead))
            self.time += period
            if k * period >= late:
                for id_ in self.ids:
                    inside[id_] &= self.inside(id_)
        swallowed = tuple(id_ for id_ in self.ids if id_ != self.target and inside[id_])
        others = [id_ for id_ in self.ids if id_ != self.target]
        return Word(inside[self.target], swallowed, self.harm(), self._watch.most(others))
