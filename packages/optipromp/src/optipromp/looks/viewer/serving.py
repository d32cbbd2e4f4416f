"""viser's server, made to accept connections only from pages that it served itself."""

import asyncio
import http
import inspect
import io
import logging
import sys
import warnings
from collections.abc import Awaitable, Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout
from dataclasses import replace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray, IntArray, lengths
from optipromp.core.errors import InvalidRequestError, installed_by, printable
from optipromp.core.planning import Picked, Plan
from optipromp.core.planning.legs import curve_of, legs_of
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene, SceneObject
from optipromp.looks.appearance import (
    STEM,
    Part,
    arm_parts,
    box_distance,
    object_parts,
    rgb,
    scenery,
)
from optipromp.looks.viewer.drawn import motions, shown_at

FLAT = {"cast_shadow": False, "receive_shadow": False}  # slow without a graphics card


class Nodes:
    """Nodes under ``/root`` of a scene of viser. ``api``: the scene of a server, or of one of its
    clients. ``root``: name of the first node. ``offset``: (3,) of all nodes in the world [m].
    ``shadows``: whether nodes cast shadows."""

    def __init__(self, api: Any, root: str = "a", offset: Sequence[float] = (0.0, 0.0, 0.0),
                 *, shadows: bool = False) -> None:  # fmt: skip
        self.api, self.root = api, f"/{root}"
        self.offset, self.shadows = np.asarray(offset), shadows
        self.scene: Scene | None = None
        self.robot: Robot | None = None
        self._segments: list[Any] = []
        self._meshes: dict[str, tuple[Part, Any]] = {}
        self._items: dict[str, SceneObject] = {}  # objects whose looks are drawn
        self._stands: dict[str, SceneObject] = {}  # objects at their perceived places
        self.on_click: Callable[[str], None] | None = None

    def clear(self) -> None:
        """Remove every node."""
        self.api.remove_by_name(self.root)
        self._segments = []
        self._meshes, self._items, self._stands = {}, {}, {}
        self.scene = self.robot = None

    def show(self, scene: Scene, robot: Robot, *, haste: bool = False) -> None:
        """Show a scene as perceived, with its robot. In ``haste`` known objects are only moved:
        their looks, and the row that they hang from, are not drawn again."""
        if self.scene is None:
            self.api.configure_default_lights(cast_shadow=self.shadows)
            self.api.add_frame(self.root, show_axes=False, wxyz=scene.base.orientation,
                               position=scene.base.position + self.offset)  # fmt: skip
        if self.robot is not robot:
            self._mount(robot)
        for gone in self._items.keys() - {item.id for item in scene.objects}:
            del self._items[gone]
            self._stands.pop(gone, None)
            for name in [n for n, (part, _) in self._meshes.items() if part.owner == gone]:
                self._meshes.pop(name)[1].remove()
        for item in scene.objects:
            old = self._items.get(item.id)
            if old is None or (old is not item and not haste):
                for part in object_parts(scene, item):
                    self._mesh(part)
                self._items[item.id] = item
                self._stands.pop(item.id, None)
            if self._stands.get(item.id) is not item:
                stem = None if item.stem is None else item.stem.points
                self.put(item, item.position, item.rotation, stem)
                self._stands[item.id] = item
        if not haste:
            wanted = {f"row {part.name}": part for part in scenery(scene)}
            for name in [n for n in self._meshes if n.startswith("row ") and n not in wanted]:
                self._meshes.pop(name)[1].remove()
            for name, part in wanted.items():
                self._mesh(replace(part, name=name))
        self.scene, self.robot = scene, robot

    def _mount(self, robot: Robot) -> None:
        self.api.remove_by_name(f"{self.root}/arm")
        self.api.add_frame(f"{self.root}/arm", show_axes=False)
        self._segments = [
            self.api.add_frame(f"{self.root}/arm/{s}", show_axes=False)
            for s in range(robot.n_segments)
        ]
        for part in arm_parts(robot):
            where = f"{self.root}/arm" + ("" if part.segment < 0 else f"/{part.segment}")
            self._added(where, part)

    def _mesh(self, part: Part) -> None:
        """Send a part of the scene where its looks differ from those that were sent."""
        old, _ = self._meshes.get(part.name, (None, None))
        if (
            old is None
            or (old.colour, old.opacity) != (part.colour, part.opacity)
            or not np.array_equal(old.vertices, part.vertices)
        ):
            node = self._added(f"{self.root}/things", part)
            if part.owner and self.on_click is not None:
                told = self.on_click
                node.on_click(lambda _: told(part.owner))
            self._meshes[part.name] = part, node

    def _added(self, where: str, part: Part) -> Any:
        return self.api.add_mesh_simple(
            f"{where}/{part.name.replace('/', '_')}", part.vertices, part.faces, color=part.colour,
            opacity=part.opacity if part.opacity < 1.0 else None, side="double",
            **({} if self.shadows else FLAT),
        )  # fmt: skip

    def pose(self, q: FloatArray) -> None:
        """Move the arm to ``q`` (n,)."""
        assert self.robot is not None
        origins, rotations = self.robot.segment_frames(q)
        turns = Rotation.from_matrix(rotations).as_quat(scalar_first=True)
        for node, origin, turn in zip(self._segments, origins, turns, strict=True):
            node.position, node.wxyz = origin, turn

    def put(
        self, item: SceneObject, position: FloatArray, rotation: FloatArray, stem: FloatArray | None
    ) -> None:
        """Move an object to ``position`` (3,) and ``rotation`` (3, 3), its stem along (k, 3)."""
        self._stands.pop(item.id, None)
        turn = Rotation.from_matrix(rotation).as_quat(scalar_first=True)
        for part, node in list(self._meshes.values()):
            if part.owner == item.id and not part.name.startswith("stem:"):
                node.position, node.wxyz = position, turn
        if item.stem is not None and stem is not None:
            corners, faces = tube(np.asarray(stem), np.full(len(stem), item.stem.radius), 8)
            self._mesh(Part(f"stem:{item.id}", -1, corners, faces, rgb(STEM), owner=item.id))

    def line(self, name: str, points: FloatArray, colour: str, width: float, **options: Any) -> Any:
        """A line through points (k, 3), ``width`` pixels wide."""
        pieces = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
        return self.api.add_line_segments(
            name, pieces, rgb(colour), thickness=width, thickness_units="screen", **options
        )


def tube(points: FloatArray, radius: FloatArray, around: int = 14) -> tuple[FloatArray, IntArray]:
    """Corners (V, 3) and triangles (F, 3) of a tube of radii (T,) along points (T, 3)."""
    tangent = np.gradient(points, axis=0)
    tangent /= np.maximum(lengths(tangent), 1e-12)[:, None]
    side = np.empty_like(points)
    last = np.eye(3)[int(np.abs(tangent[0]).argmin())]
    for k, t in enumerate(tangent):  # each section's first direction is the last one's, levelled
        last = last - (last @ t) * t
        last /= max(float(np.linalg.norm(last)), 1e-12)
        side[k] = last
    angle = np.linspace(0.0, 2.0 * np.pi, around, endpoint=False)[None, :, None]
    ring = np.cos(angle) * side[:, None] + np.sin(angle) * np.cross(tangent, side)[:, None]
    corners = points[:, None] + np.maximum(radius, 1e-5)[:, None, None] * ring
    a = np.arange((len(points) - 1) * around).reshape(-1, around)
    b = np.roll(a, -1, axis=1)
    faces = np.stack([a, b, b + around, a, b + around, a + around], axis=-1)
    return corners.reshape(-1, 3), faces.reshape(-1, 3)


NEEDED = f"a 3-D view needs viser: {installed_by('optipromp[view]')}"
HERE = frozenset({"localhost", "127.0.0.1", "::1"})
ALONE = {"X-Frame-Options": "DENY", "Content-Security-Policy": "frame-ancestors 'none'"}
"""Headers that keep other pages from showing this one in a frame, and so from stealing clicks."""
WORDS = 200  # letters of the line about a broken connection, at most
SILENT = logging.getLogger(f"{__name__}.websockets")
SILENT.setLevel(logging.CRITICAL + 1)  # it would write a traceback of every malformed request


def listening(host: str, port: int) -> Any:
    """A silent viser server, without the tunnel by which any window could publish the page. A
    website that is open in this machine's browser can connect to any port of the machine, and viser
    accepts it. So a request is refused if its ``Origin`` is not the page's address. At an address
    of this machine, a request to any other host name is refused too (DNS rebinding). No other page
    may show this one in a frame. A malformed message ends its connection, with a line on standard
    error."""
    try:
        import viser
        from websockets.asyncio import server as module
    except ImportError:
        raise InvalidRequestError(NEEDED) from None
    sockets: Any = module
    serve = sockets.serve

    def guarded(
        handler: Handler, *args: Any, process_request: Callable[..., Any], **settings: Any
    ) -> Any:
        async def checked(connection: Any, request: Any) -> Any:
            if not is_own(request.headers.get("Origin"), request.headers.get("Host", ""), host):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "another origin\n")
            answer = process_request(connection, request)
            answer = await answer if inspect.isawaitable(answer) else answer
            if answer is not None:
                answer.headers.update(ALONE)
            return answer

        return serve(_tolerant(handler), *args, process_request=checked, logger=SILENT, **settings)

    # viser has no setting for it, and has called `serve` when its constructor returns
    sockets.serve = guarded
    try:
        with redirect_stdout(io.StringIO()):
            server: Any = viser.ViserServer(host=host, port=port, verbose=False)
    finally:
        sockets.serve = serve
    server.request_share_url = lambda *_, **__: None
    for told in ("Queued a .* on a closed connection", r"\[viser\] .* does not match annotation"):
        warnings.filterwarnings("ignore", told, UserWarning)  # windows close at any moment
    return server


Handler = Callable[[Any], Awaitable[None]]


def _tolerant(handler: Handler) -> Handler:
    """A handler of connections that ends a broken one with a line instead of a traceback."""

    def tell(error: BaseException | None) -> None:
        words = printable(f"{type(error).__name__}: {error}")[:WORDS]
        sys.stderr.write(f"a window sent what is no message: {words}\n")

    async def handle(connection: Any) -> None:
        loop = asyncio.get_running_loop()
        loop.set_exception_handler(lambda _, context: tell(context.get("exception")))
        try:
            await handler(connection)
        except Exception as error:  # viser's reader raises whatever goes wrong in it
            tell(error)
            await connection.close(1007, "no message")

    return handle


def is_own(origin: str | None, asked: str, host: str) -> bool:
    """Whether a request comes from the page that listens at ``host``, or from no browser; by its
    headers ``Origin`` and ``Host`` (``asked``)."""
    try:
        name = urlsplit(f"//{asked}").hostname
        own = urlsplit(origin or f"//{asked}").netloc.lower() == asked.lower()
    except ValueError:
        return False
    return own and (host not in HERE or name in HERE)


FRAME_RATE = 12.0  # [Hz] of the recorded motion
FRAMES = 240  # of a motion, at most
REST = 1.0  # [s] of rest before the motion repeats
VIEWS = (-0.6, 0.15), (0.6, 0.15), (-1.4, 0.2), (1.4, 0.2), (np.pi - 0.9, 0.4), (np.pi + 0.9, 0.4)
"""Places of the camera: turn from the direction away from the robot [rad], height over distance."""
SHARES = np.linspace(0.05, 0.95, 40)  # of the line to an object: points checked for others
UNMOVED = 1e-4  # [m] an object that moves by less is not sent again


def scene_page(scene: Scene, robot: Robot | None = None) -> str:
    """The HTML of a scene with its robot at its start."""
    robot, state = posed(scene, robot)
    with recording(scene, robot) as (nodes, record):
        nodes.pose(state.q)
        return str(record.as_html())


def plan_page(made: Plan | Picked) -> str:
    """The HTML of a plan or a pick: the arm that moves, fruits as predicted, lines of the tool."""
    plan, curve = legs_of(made)["reach"], curve_of(made)
    places = {item.id: item.position for item in plan.scene.objects}
    with recording(plan.scene, plan.robot) as (nodes, record):
        for k, motion in enumerate(reversed(motions(made))):
            points = plan.robot.tool_pose(motion.trajectory.resample(FRAME_RATE).positions)[0]
            name = f"{nodes.root}/{motion.name}"
            nodes.line(name, points, motion.colour, 3.0 if k else 6.0)
        count = min(max(round(FRAME_RATE * curve.duration), 1), FRAMES)
        for time in np.linspace(0.0, curve.duration, count + 1):
            nodes.pose(curve.sample(time)[0][0])
            for item in shown_at(made, float(time)):
                if np.linalg.norm(item.position - places[item.item.id]) >= UNMOVED:
                    places[item.item.id] = item.position
                    nodes.put(item.item, item.position, item.rotation, item.stem)
            record.insert_sleep(curve.duration / count)
        record.insert_sleep(REST)
        return str(record.as_html())


@contextmanager
def recording(scene: Scene, robot: Robot) -> Iterator[tuple[Nodes, Any]]:
    """Nodes without a client, and a record of the messages that a client would get."""
    server = listening("127.0.0.1", 0)
    try:
        server.scene.set_up_direction("+z")
        nodes = Nodes(server.scene, "base", shadows=True)
        nodes.show(scene, robot)
        _look(server.initial_camera, scene, robot)
        yield nodes, server.get_scene_serializer()
    finally:
        with redirect_stdout(io.StringIO()):
            server.stop()


def _look(camera: Any, scene: Scene, robot: Robot) -> None:
    """Place the camera where the fewest fruits are hidden; of equals, beyond the row."""
    focus = robot.tool_pose(robot.home)[0]
    if len(scene.objects):
        focus = scene.positions.mean(axis=0)
    middle, up = 0.8 * focus, scene.up
    away = focus - (focus @ up) * up
    away /= max(float(np.linalg.norm(away)), 1e-9)
    reach = 1.05 * max(float(np.linalg.norm(focus)), 0.6)
    eyes = [
        middle + reach * (Rotation.from_rotvec(turn * up).apply(away) + lift * up)
        for turn, lift in VIEWS
    ]
    eye = min(eyes, key=lambda eye: _hidden(scene, eye))
    camera.look_at, camera.position = scene.base @ middle, scene.base @ eye


def _hidden(scene: Scene, eye: FloatArray) -> int:
    """Number of pairs of a static object and a target or pushable that it hides from an eye."""
    seen = [item.position for item in scene.objects if item.role in ("target", "pushable")]
    return sum(
        any(box_distance(item, eye + share * (point - eye)) == 0.0 for share in SHARES)
        for point in seen
        for item in scene.static
    )
