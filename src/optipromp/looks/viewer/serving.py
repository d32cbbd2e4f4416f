"""viser's server, made to accept connections only from pages that it served itself."""

import asyncio
import http
import inspect
import io
import logging
import sys
import warnings
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any
from urllib.parse import urlsplit

import numpy as np
from scipy.spatial.transform import Rotation

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.planning import Plan
from optipromp.core.planning.task import posed
from optipromp.core.robots.model import Robot
from optipromp.core.scenes.scene import Scene
from optipromp.core.shown import printable
from optipromp.looks.appearance.scene import box_distance
from optipromp.looks.viewer.drawn import Moment, motions, placed
from optipromp.looks.viewer.nodes import Nodes

NEEDED = f"a 3-D view needs viser: {installed_by('view')}"
HERE = frozenset({"localhost", "127.0.0.1", "::1"})
ALONE = {"X-Frame-Options": "DENY", "Content-Security-Policy": "frame-ancestors 'none'"}
"""Headers that keep other pages from showing this one in a frame, and so from stealing clicks."""
WORDS = 200  # letters of the line about a broken connection, at most
SILENT = logging.getLogger(f"{__name__}.websockets")
SILENT.setLevel(logging.CRITICAL + 1)  # it would write a traceback of every malformed request


def listening(host: str, port: int) -> Any:
    """A silent viser server, without the tunnel by which any window could publish the page.

    A website that is open in this machine's browser can connect to any port of the machine, and
    viser accepts it. So a request is refused if its ``Origin`` is not the page's address. At an
    address of this machine, a request to any other host name is refused too (DNS rebinding). No
    other page may show this one in a frame. A malformed message ends its connection, with a line on
    standard error.
    """
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
    """Whether a request comes from the page that listens at ``host``, or from no browser.

    ``origin``, ``asked``: the request's headers ``Origin`` and ``Host``.
    """
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


def plan_page(plan: Plan) -> str:
    """The HTML of a plan: the moving arm, fruits as predicted, lines of the tool point."""
    curve = plan.trajectory
    places = {item.id: item.position for item in plan.scene.objects}
    with recording(plan.scene, plan.robot) as (nodes, record):
        for k, motion in enumerate(reversed(motions(plan))):
            points = plan.robot.tool_pose(motion.trajectory.resample(FRAME_RATE).positions)[0]
            nodes.line(motion.name, points, motion.colour, 3.0 if k else 6.0)
        count = min(max(round(FRAME_RATE * curve.duration), 1), FRAMES)
        for time in np.linspace(0.0, curve.duration, count + 1):
            nodes.pose(curve.sample(time)[0][0])
            now = int(np.searchsorted(curve.times, time + 1e-9)) - 1
            for item in placed(plan, Moment(max(now, 0), float(time), "")):
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
