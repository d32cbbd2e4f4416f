"""The controls of a window: state, clock, planning, moving, layers, charts."""

import asyncio
import functools
import html
import io
import socket
from collections.abc import Callable, Collection, Sequence
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.planning import STRATEGIES, Plan, planner_names
from optipromp.core.scenes.scene import Scene
from optipromp.looks.appearance.faces import hex_colour
from optipromp.looks.appearance.scene import SEE_THROUGH, colour_of
from optipromp.looks.page import arrange
from optipromp.looks.page.content import GREEN_AT, Chart, charts
from optipromp.looks.page.replay import Source
from optipromp.looks.page.stage import (
    AHEAD,
    BACK,
    LAYERS,
    NARROW,
    PLANNED,
    SHEET,
    SIDE,
    SPREAD,
    SURE,
    UNSURE,
)
from optipromp.looks.page.tabs import Controls, RecordTab, ReplayTab
from optipromp.looks.page.telling import Told, table
from optipromp.looks.page.window import Window
from optipromp.looks.viewer.drawn import GREEN, PRIMITIVE, RED, motions
from optipromp.looks.viewer.serving import listening
from optipromp.perception.overlay import RIPE, STEM, UNRIPE

SPEEDS = {"1/8": 0.125, "1/4": 0.25, "1/2": 0.5, "1": 1.0, "2": 2.0}
TIME_STEP = 0.02  # [s] of a single step
NOTHING = "nothing"
_PLAYING, _PAUSED = "pause", "play"
_NUMBERS = {  # number fields of options: (label, factor to its unit, least, most, step)
    "static_clearance": ("to static [mm]", 1e3, 0.0, 60.0, 1.0),
    "avoid_clearance": ("to avoid [mm]", 1e3, 0.0, 60.0, 1.0),
    "corridor": ("corridor [mm]", 1e3, 0.0, 20.0, 0.5),
    "max_step": ("largest step [rad]", 1.0, 0.005, 0.2, 0.005),
}
TOUCH = 44  # [pixel] height of what is touched on a phone; a finger needs 40

STYLE = f"""<style>
@media (max-width: {NARROW}px) {{
  .mantine-Paper-root[style*="max-height: 60%"] {{
    width: 100% !important; max-height: {100 * SHEET:.0f}% !important;
  }}
  .mantine-Paper-root [style*="width: 20em"] {{ width: 100% !important; }}
  .mantine-Button-root {{ height: {TOUCH}px !important; min-width: {TOUCH}px; font-size: 15px; }}
  .mantine-Input-input {{
    height: {TOUCH}px !important; min-height: {TOUCH}px !important; font-size: 16px !important;
  }}
  .mantine-Slider-root + * {{ width: 4.2rem !important; }}
  .mantine-Slider-root, .mantine-Slider-trackContainer {{ min-height: {TOUCH}px; }}
  .mantine-Tabs-tab {{ min-height: {TOUCH}px; flex-grow: 1; font-size: 15px; }}
  .mantine-ActionIcon-root {{ width: {TOUCH}px; height: {TOUCH}px; }}
  .mantine-NumberInput-controls {{ display: none; }}
  .mantine-Select-option {{ min-height: {TOUCH}px; }}
  .mantine-Checkbox-inner, .mantine-Checkbox-input {{ width: {TOUCH}px; height: {TOUCH}px; }}
  .status {{ max-height: none !important; }}
}}
</style>"""
"""The page's style sheet: on a phone the controls take the whole width, and fingers hit them."""
CHART_EVERY = 0.1  # [s] between two moves of the charts' needles while the clock runs


class Panel(Controls):
    """Builds the controls of a window and keeps them in step with it."""

    def __init__(self, window: Window) -> None:
        super().__init__(window)
        self.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self.gui.set_panel_label(f"OptI-ProMP: {window.scene.name}")
        self.gui.add_html(STYLE)
        self.status = self.gui.add_html("")
        window.say, window.occupy = self._say, self._occupy
        self._clock()
        self.legend = self.gui.add_html("")
        if window.source.seen is not None:
            with self.gui.add_folder("as the camera saw it"):
                self.gui.add_image(window.source.seen, format="jpeg")
                self.gui.add_html(legend(seen()))
        self.tabs = self.gui.add_tab_group()
        for label, build in (
            ("Plan", self._planning),
            ("Move", self._moving),
            ("Show", self._layers),
            ("Plots", self._charts),
        ):
            with self.tabs.add_tab(label):
                build()
        with self.tabs.add_tab("Record"):
            self.recording = RecordTab(self)
        with self.tabs.add_tab("Replay"):
            self.replaying = ReplayTab(self)
        window.told.append(self._refresh)
        window.clocked.append(self._mark)
        window.staged.append(self._explain)

    def _say(self, told: Told) -> None:
        self.status.content = told.html()

    def _occupy(self, on: bool) -> None:
        for button in self.buttons:
            button.disabled = on
        if not on:
            self.recording.enable()

    def _explain(self) -> None:
        """Update the legend."""
        window = self.window
        entries = things(window.scene)
        if window.replayed:
            runs = [replay for replay, _ in window.replayed]
            entries = things(runs[0].scene)
            entries += replayed(looks=any(run.record is not None for run in runs))
        elif window.plan is not None and window.plan.scene is window.scene:
            entries += planned(window.plan, list(filter(window.stage.visible, LAYERS)))
        self.legend.content = legend(entries)
        for name in PLANNED:
            self.layers[name].disabled = bool(window.replayed)

    # -- the clock ------------------------------------------------------------------------------

    def _clock(self) -> None:
        window = self.window
        self.time = self.gui.add_slider("time [s]", 0.0, 1.0, TIME_STEP, 0.0)
        self.on(self.time, "time", self._slid)
        self.steps = self.gui.add_button_group("", (_PAUSED, _PLAYING, "◀ step", "step ▶"))
        self.on(self.steps, "play", self._clicked)
        speed = self.gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
        self.on(speed, "speed", lambda name: setattr(window, "speed", SPEEDS[name]))

    def _slid(self, value: float) -> None:
        self.window.play(False)
        self.window.go(value)

    def _clicked(self, name: str) -> None:
        window = self.window
        if name in (_PLAYING, _PAUSED):
            window.play(name == _PAUSED)
        else:
            window.play(False)
            window.go(window.now + (TIME_STEP if name.startswith("step") else -TIME_STEP))

    # -- planning -------------------------------------------------------------------------------

    def _planning(self) -> None:
        window, gui, now = self.window, self.gui, self.window.settings
        self.planner = gui.add_dropdown("planner", planner_names(), initial_value=now["planner"])
        self.on(self.planner, "planner", lambda v: self._set(planner=v))
        strategy = gui.add_dropdown("strategy", STRATEGIES, initial_value=now["strategy"])
        self.on(strategy, "strategy", lambda v: self._set(strategy=v))
        self.radius = gui.add_slider("gripper radius [mm]", 20.0, 80.0, 1.0, 50.0)
        self.on(
            self.radius,
            "radius",
            lambda v: window.change(arrange.with_radius(window.scene, 1e-3 * v)),
        )
        self.sigma = gui.add_slider("detection σ [mm]", 0.0, 15.0, 0.5, 0.0)
        self.on(
            self.sigma, "sigma", lambda v: window.change(arrange.with_sigma(window.scene, 1e-3 * v))
        )
        with gui.add_folder("options", expand_by_default=False):
            predict = gui.add_checkbox("search in the push model", True)
            self.on(predict, "prediction", lambda v: self._option(prediction=v))
            duration = gui.add_number("duration [s], 0: shortest", 0.0, min=0.0, max=60.0, step=0.5)
            self.on(duration, "duration", lambda v: self._option(duration=v or None))
            for name, (label, factor, least, most, step) in _NUMBERS.items():
                default = round(getattr(window.options, name) * factor, 6)
                number = gui.add_number(label, default, min=least, max=most, step=step)
                self.on(number, name, self._scaled(name, factor))
        self.button("plan again", window.replan)
        self.table = gui.add_html("")

    def _scaled(self, name: str, factor: float) -> Callable[[float], None]:
        return lambda value: self._option(**{name: value / factor})

    def _set(self, **values: Any) -> None:
        self.window.settings |= values
        self.window.replan()

    def _option(self, **values: Any) -> None:
        self.window.options = replace(self.window.options, **values)
        self.window.replan()

    # -- moving and saving ----------------------------------------------------------------------

    def _moving(self) -> None:
        window, gui = self.window, self.gui
        gui.add_markdown("Click a thing in the scene, or choose it here; then drag its handle.")
        names = (NOTHING, *arrange.grips(window.scene))
        self.choice = gui.add_dropdown("handle at", names, initial_value=NOTHING)
        self.on(self.choice, "select", lambda v: window.select("" if v == NOTHING else v))
        self.place = gui.add_vector3("place [m]", (0.0, 0.0, 0.0), step=0.001)
        self.on(self.place, "place", self._placed)
        self.button("scene as it was", window.reset)
        self.name = gui.add_text("name", window.scene.name)
        self.button("save scene", self._save_scene)
        self.button("save plan", self._save_plan)
        self.saved = gui.add_markdown("")

    def _placed(self, value: tuple[float, float, float]) -> None:
        window = self.window
        if window.selected is not None:
            window.change(arrange.moved(window.scene, window.selected, np.array(value)))
            window.select(window.selected.name)

    def _save_scene(self) -> None:
        from optipromp.core.files import check_folder
        from optipromp.core.scenes.io import save_scene

        name = self.named()
        check_folder(self.window.out)
        path = self.window.out / f"{name}.yaml"
        save_scene(replace(self.window.scene, name=name), path)
        self.tell(f"wrote {path}")

    def _save_plan(self) -> None:
        from optipromp.core.output import write_plan

        if self.window.plan is None:
            raise InvalidRequestError("there is no plan of this scene")
        folder = self.window.out / self.named()
        write_plan(self.window.plan, folder)
        self.tell(f"wrote {folder}")

    def tell(self, text: str) -> None:
        """Show a line below the buttons that save."""
        self.saved.content = text

    # -- layers and charts ----------------------------------------------------------------------

    def _layers(self) -> None:
        window = self.window
        self.layers: dict[str, Any] = {}
        for name in LAYERS:
            self.layers[name] = self.gui.add_checkbox(name, window.stage.visible(name))
            self.on(self.layers[name], name, functools.partial(self._layer, name))

    def _layer(self, name: str, shown: bool) -> None:
        window = self.window
        window.stage.layer(name, shown)
        if name == "pushed objects" and not shown and window.plan is not None:
            window.stage.show(window.plan.scene, window.plan.robot)
        self._explain()
        window.go(window.now)

    def _charts(self) -> None:
        self.plots = Plots(self.gui)

    def _refresh(self) -> None:
        """Update table, charts, and the controls of the scene after a plan."""
        window, plan = self.window, self.window.plan
        assert plan is not None and window.near is not None  # noqa: PT018
        self.table.content = table(plan)
        self.gui.set_panel_label(f"OptI-ProMP: {plan.scene.name}")
        self.planner.value = window.settings["planner"]
        names = (NOTHING, *arrange.grips(window.scene))
        if tuple(self.choice.options) != names:
            self.choice.options = names
        radius = arrange.tool_radius(window.scene)
        self.radius.disabled = radius is None
        if radius is not None:
            self.radius.value = 1e3 * radius
        self.sigma.value = 1e3 * arrange.sigma(window.scene)
        self.plots.show(charts(plan, window.near, window.chart_times), window.now)

    def _mark(self) -> None:
        """Update slider and charts after a change of the time."""
        window = self.window
        if window.plan is not None:
            end = round(window.duration, 3)
            if self.time.max != end:
                self.time.max = end
            self.time.value = min(round(window.now, 3), end)
        if window.selected is None:
            self.choice.value = NOTHING
        else:
            self.choice.value = window.selected.name
            self.place.value = tuple(arrange.place(window.scene, window.selected).tolist())
        self.plots.mark(window.now, CHART_EVERY * window.speed if window.worker.running else 0.0)


CHART_HEIGHT = 170  # [pixel]
_NEEDLE = "#222222"


class Plots:
    """Charts in a container of their own.

    ``gui``: of a client; the charts stay in the container that is current now.
    """

    def __init__(self, gui: Any) -> None:
        self.gui, self.place = gui, gui.add_folder("over the plan")
        self.charts: list[tuple[Chart, Any]] = []
        self.marked = -np.inf

    def show(self, wanted: Sequence[Chart], now: float) -> None:
        """Show charts; where their curves are the same as before, only the values are sent."""
        if [_shape(chart) for chart in wanted] == [_shape(chart) for chart, _ in self.charts]:
            self.charts = [(c, node) for c, (_, node) in zip(wanted, self.charts, strict=True)]
            for chart, node in self.charts:
                node.data = columns(chart, now)
        else:
            for _, node in self.charts:
                node.remove()
            with self.place:
                self.charts = [(chart, self._add(chart, now)) for chart in wanted]
        self.marked = now

    def mark(self, now: float, least: float) -> None:
        """Move the needles to the time ``now`` [s], if they are more than ``least`` [s] away."""
        if abs(now - self.marked) > least:
            self.marked = now
            for chart, node in self.charts:
                if chart.timed:
                    node.data = columns(chart, now)

    def _add(self, chart: Chart, now: float) -> Any:
        needle = [("now", None, _NEEDLE)] if chart.timed else []
        series = [
            {"label": name, "stroke": colour, "width": 1.5, "points": {"show": False}}
            for name, _, colour in (*chart.curves, *needle)
        ]
        return self.gui.add_uplot(
            columns(chart, now), ({}, *series), title=chart.title, height=CHART_HEIGHT,
            scales={"x": {"time": False}}, legend={"show": len(chart.curves) > 1},
        )  # fmt: skip


def _shape(chart: Chart) -> tuple[str, ...]:
    return (chart.title, *(name for name, _, _ in chart.curves))


def columns(chart: Chart, now: float) -> tuple[FloatArray, ...]:
    """Columns of a chart; where it is timed, the last is a needle at ``now``."""
    if not chart.timed:
        return chart.x, *(values for _, values, _ in chart.curves)
    at = int(np.searchsorted(chart.x, now))
    found = [
        np.insert(values, at, [np.interp(now, chart.x, values)] * 3)
        for _, values, _ in chart.curves
    ]
    needle = np.full(len(chart.x) + 3, min(c.min() for c in found))
    needle[at + 1] = max(c.max() for c in found)
    return np.insert(chart.x, at, [now] * 3), *found, needle


ROLES = {
    "target": "target",
    "pushable": "may be pushed aside",
    "avoid": "the arm keeps away",
    "static": "fixed, not to be touched",
}
MOST = 3  # colours of one role
_LINES = {
    "conditioned ProMP": "learnt motion",
    "followed path": "way past the fruits",
    "optimised": "tool path",
}

Entry = tuple[str, str]  # sign as HTML, words


def things(scene: Scene) -> list[Entry]:
    """The colours of the scene's objects, one entry a role."""
    found = []
    for role, words in ROLES.items():
        colours = [colour_of(scene, item) for item in scene.objects if item.role == role]
        opacity = SEE_THROUGH if role == "avoid" else 1.0
        signs = "".join(disc(colour, opacity) for colour in list(dict.fromkeys(colours))[:MOST])
        if signs:
            found.append((signs, words))
    return found


def planned(plan: Plan, shown: Collection[str]) -> list[Entry]:
    """The signs of a plan on those of its layers that are shown."""
    found = []
    if "trajectories" in shown:
        lines = list(motions(plan))[::-1]  # the motion itself first
        words = ["tool path", *(_LINES[motion.name] for motion in lines[1:])]
        found += [(line(m.colour), w) for m, w in zip(lines, words, strict=True)]
    if "initial bundle" in shown:
        found.append((disc(PRIMITIVE, SPREAD), "spread of the learnt motion"))
    if "pushed objects" in shown and plan.push_model is not None:
        found.append((label("n, 9 mm"), "predicted push"))
    if "passing sides" in shown and any(plan.metrics.passage.values()):
        found.append((arrow(hex_colour(SIDE)), "side on which it passes"))
    if "candidate paths" in shown and plan.push_model is not None:
        found.append((scale(GREEN, RED), "ways tried: harmless to harmful"))
    if "body spheres" in shown:
        found.append((scale(RED, GREEN), f"arm: touch to {1e3 * GREEN_AT:.0f} mm away"))
    return found


def replayed(*, looks: bool) -> list[Entry]:
    """The signs of an executed plan, ``looks``: of one that looked on its way."""
    found = [(arrow(RED), "force of a touch")]
    if looks:
        found += [
            (line(AHEAD[0]), "way ahead, in the colour of its plan"),
            (line(BACK), "way back"),
            (disc(hex_colour(SURE)), "where it believes a fruit"),
            (disc(hex_colour(UNSURE)), "perhaps a fruit"),
        ]
    return found


def seen() -> list[Entry]:
    """The signs over a picture in which a scene was seen."""
    signs = ((RIPE, "ripe"), (UNRIPE, "unripe"), (STEM, "stem"))
    return [(line(hex_colour(colour)), f"found: {words}") for colour, words in signs]


def legend(entries: Collection[Entry]) -> str:
    """Entries as one block of HTML."""
    items = "".join(
        f'<span style="display:flex;align-items:center;gap:0.35em">'
        f"{sign}{html.escape(words)}</span>"
        for sign, words in entries
    )
    return (
        '<div class="legend" style="display:flex;flex-wrap:wrap;gap:0 0.9em;padding:0.4em 1em;'
        'font-size:0.8em;line-height:1.6">'
        f"{items}</div>"
    )


def disc(colour: str, opacity: float = 1.0) -> str:
    """A thing's colour."""
    return _sign("0.8em", "0.8em", f"border-radius:50%;background:{_seen(colour, opacity)};"
                 f"border:1px solid {colour}")  # fmt: skip


def line(colour: str, opacity: float = 1.0) -> str:
    """A line's colour."""
    return _sign("1.4em", "0.28em", f"background:{_seen(colour, opacity)}")


def scale(first: str, last: str) -> str:
    """Colours from one to another."""
    return _sign("1.8em", "0.28em", f"background:linear-gradient(90deg,{first},#f0c43c,{last})")


def arrow(colour: str) -> str:
    """An arrow's colour."""
    return f'<span style="color:{colour};font-weight:700">→</span>'


def label(words: str) -> str:
    """A label in the picture."""
    return f'<span style="border:1px solid #bbb;padding:0 0.3em;font-size:0.85em">{words}</span>'


def _sign(width: str, height: str, style: str) -> str:
    return (
        f'<span style="display:inline-block;flex:none;box-sizing:border-box;width:{width};'
        f'height:{height};{style}"></span>'
    )


def _seen(colour: str, opacity: float) -> str:
    """A colour with its opacity in two more digits."""
    return f"{colour}{round(255 * opacity):02x}"


class Page:
    """A running server. :meth:`stop` ends it and its threads.

    ``source``: that each window opens with. ``host``: address of the server. ``port``: of the
    server; 0: any free one. ``out``: folder into which windows save.
    """

    def __init__(
        self, source: Source, *, host: str = "localhost", port: int = 0, out: Path = Path("out")
    ) -> None:
        self.source, self.out = source, out
        self.windows: dict[int, Window] = {}
        self.panels: dict[int, Panel] = {}
        self.server = listening(host, usable(host, port))
        self.url = f"http://{host}:{self.server.get_port()}"
        self.server.on_client_connect(self._enter)
        self.server.on_client_disconnect(self._leave)

    # Coroutines, since viser awaits these in the order of events. It gives functions to threads in
    # any order: a window that leaves before it enters would stay for ever.

    async def _enter(self, client: Any) -> None:
        window = Window(client, self.source, self.out)
        self.windows[client.client_id] = window

        def begin() -> None:
            panel = Panel(window)
            if client.client_id in self.windows:  # it may have left meanwhile
                self.panels[client.client_id] = panel
                window.start()

        window.post("start", begin)

    async def _leave(self, client: Any) -> None:
        window = self.windows.pop(client.client_id, None)
        if window is not None:
            await asyncio.to_thread(window.close)
        self.panels.pop(client.client_id, None)

    def stop(self) -> None:
        """Close every window and the server."""
        for window in list(self.windows.values()):
            window.close()
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def usable(host: str, port: int) -> int:
    """The port, or a free one for 0."""
    try:
        family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        raise InvalidRequestError(f"cannot listen at {host}:{port}: {error}") from None
