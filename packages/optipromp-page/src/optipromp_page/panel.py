"""The controls of a window: state, clock, planning, moving, layers, charts."""

import asyncio
import functools
import io
import socket
import warnings
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError, is_name
from optipromp.core.files import check_folder, file_name
from optipromp.core.planning import Picked, Plan, planner_names
from optipromp.core.planning.legs import legs_of
from optipromp.core.planning.primitive import is_learnt
from optipromp.core.planning.task import posed
from optipromp.core.promp import Basis, fit
from optipromp.core.promp.demonstrations import save_demonstrations
from optipromp.core.scenes.scene import Scene
from optipromp.looks.viewer.serving import listening
from optipromp_page import content, tabs
from optipromp_page.stage import LAYERS, NARROW, PLANNED, SHEET, Source
from optipromp_page.window import Listener, Window

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


class Panel(Listener):
    """Builds the controls of a window and keeps them in step with it."""

    def __init__(self, window: Window) -> None:
        self.window, self.gui = window, window.client.gui
        self.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        self.gui.set_panel_label(f"OptI-ProMP: {window.scene.name}")
        self.buttons: list[Any] = []
        self.gui.add_html(STYLE)
        self.status = self.gui.add_html("")
        self.clock = Clock(self)
        self.legend = self.gui.add_html("")
        if window.source.seen is not None:
            with self.gui.add_folder("as the camera saw it"):
                self.gui.add_image(window.source.seen, format="jpeg")
                self.gui.add_html(tabs.legend(tabs.seen()))
        group = self.gui.add_tab_group()
        with group.add_tab("Plan"):
            self.planning = PlanTab(self)
        with group.add_tab("Move"):
            self.moving = MoveTab(self)
        with group.add_tab("Show"):
            self.layers = {k: self.gui.add_checkbox(k, window.stage.visible(k)) for k in LAYERS}
            for name, box in self.layers.items():
                self.on(box, name, functools.partial(self.layer, name))
        with group.add_tab("Plots"):
            self.plots = tabs.Plots(self.gui)
        with group.add_tab("Record"):
            self.recording = RecordTab(self)
        with group.add_tab("Replay"):
            self.replaying = ReplayTab(self)

    def button(self, label: str, act: Callable[[], None]) -> Any:
        """Add a button that posts ``act``; it cannot be pressed while something is under way."""
        self.buttons.append(self.gui.add_button(label))
        self.on(self.buttons[-1], label, lambda _: act())
        return self.buttons[-1]

    def on(self, control: Any, kind: str, act: Callable[[Any], None]) -> None:
        """Post ``act`` with the new value when the user changes a control."""

        async def changed(event: Any) -> None:
            if event.client is not None:
                value = event.target.value
                self.window.worker.post(kind, lambda: self.safely(act, value))

        (getattr(control, "on_update", None) or control.on_click)(changed)

    def safely(self, act: Callable[[Any], None], value: Any) -> None:
        """Act; the window shows what is refused."""
        try:
            act(value)
        except OptiPrompError as error:
            self.window.refuse(error)

    def layer(self, name: str, shown: bool) -> None:
        """Show or hide a layer of the plan."""
        self.window.stage.layer(name, shown)
        self.staged()
        self.window.go(self.window.now)

    # -- what the window tells ------------------------------------------------------------------

    def say(self, told: tabs.Told) -> None:
        """Show a message above the controls."""
        self.status.content = told.html()

    def occupy(self, on: bool) -> None:
        """Disable the buttons while long work is under way."""
        for button in self.buttons:
            button.disabled = on
        if not on:
            self.recording.enable()

    def staged(self) -> None:
        """Update the legend."""
        window, runs = self.window, [replay for replay, _ in self.window.runs.shown]
        entries = tabs.things(runs[0].scene if runs else window.scene)
        if runs:
            entries += tabs.replayed(looks=any(run.record is not None for run in runs))
        elif window.shown is not None and window.shown.scene is window.scene:
            layers = set(filter(window.stage.visible, LAYERS))
            if not is_learnt(window.shown.plan.robot, window.asked.demonstrations):
                layers.discard("initial bundle")
            entries += tabs.planned(window.shown.made, layers)
        self.legend.content = tabs.legend(entries)
        for name in PLANNED:
            self.layers[name].disabled = bool(runs)

    def told(self) -> None:
        """Update table, charts, and the controls of the scene after a plan."""
        shown = self.window.shown
        assert shown is not None
        assert shown.around is not None
        self.gui.set_panel_label(f"OptI-ProMP: {shown.plan.scene.name}")
        self.planning.follow(shown.made)
        self.moving.offer()
        self.plots.show(content.charts(shown.made, shown.around), self.window.now)

    def clocked(self) -> None:
        """Update slider, handle, charts and forces after a change of the time."""
        window = self.window
        self.clock.follow()
        self.moving.follow()
        self.plots.mark(window.now, CHART_EVERY * window.speed if window.worker.running else 0.0)
        self.replaying.follow()


class Clock:
    """Controls of the time."""

    def __init__(self, panel: Panel) -> None:
        window, gui = panel.window, panel.gui
        self.window = window
        self.time = gui.add_slider("time [s]", 0.0, 1.0, TIME_STEP, 0.0)
        panel.on(self.time, "time", self._slid)
        steps = gui.add_button_group("", (_PAUSED, _PLAYING, "◀ step", "step ▶"))
        panel.on(steps, "play", self._clicked)
        speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
        panel.on(speed, "speed", lambda name: setattr(window, "speed", SPEEDS[name]))

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

    def follow(self) -> None:
        """Show the present time, of the present duration."""
        if self.window.shown is None:
            return
        self.time.max = end = round(self.window.duration, 3)
        self.time.value = min(round(self.window.now, 3), end)


class PlanTab:
    """Controls of planning; the numbers of the plan."""

    def __init__(self, panel: Panel) -> None:
        self.window, gui, asked = panel.window, panel.gui, panel.window.asked
        self.planner = gui.add_dropdown("planner", planner_names(), initial_value=asked.planner)
        panel.on(self.planner, "planner", lambda v: self.window.ask(planner=v))
        self.radius = gui.add_slider("gripper radius [mm]", 20.0, 80.0, 1.0, 50.0)
        panel.on(self.radius, "radius", functools.partial(self._change, content.with_radius))
        self.sigma = gui.add_slider("detection σ [mm]", 0.0, 15.0, 0.5, 0.0)
        panel.on(self.sigma, "sigma", functools.partial(self._change, content.with_sigma))
        with gui.add_folder("options", expand_by_default=False):
            predict = gui.add_checkbox("search in the push model", True)
            panel.on(predict, "prediction", lambda v: self.option(prediction=v))
            duration = gui.add_number("duration [s], 0: shortest", 0.0, min=0.0, max=60.0, step=0.5)
            panel.on(duration, "duration", lambda v: self.option(duration=v or None))
            for name, (label, factor, least, most, step) in _NUMBERS.items():
                default = round(getattr(asked.options, name) * factor, 6)
                number = gui.add_number(label, default, min=least, max=most, step=step)
                panel.on(number, name, functools.partial(self._scaled, name, factor))
        panel.button("plan again", self.window.replan)
        self.table = gui.add_html("")

    def _scaled(self, name: str, factor: float, value: float) -> None:
        self.option(**{name: value / factor})

    def _change(self, changed: Callable[[Scene, float], Scene], value: float) -> None:
        self.window.ask(scene=changed(self.window.scene, 1e-3 * value))

    def option(self, **values: Any) -> None:
        """Plan with another option."""
        self.window.ask(options=replace(self.window.asked.options, **values))

    def follow(self, made: Plan | Picked) -> None:
        """Show the numbers of a plan, and for what it was made."""
        asked = self.window.asked
        self.table.content = tabs.table(made)
        self.planner.value = asked.planner
        radius = content.tool_radius(asked.scene)
        self.radius.disabled = radius is None
        if radius is not None:
            self.radius.value = 1e3 * radius
        self.sigma.value = 1e3 * content.sigma(asked.scene)


class MoveTab:
    """Controls that move things, and save the scene and its plan."""

    def __init__(self, panel: Panel) -> None:
        self.window, gui = panel.window, panel.gui
        gui.add_markdown("Click a thing in the scene, or choose it here; then drag its handle.")
        self.choice = gui.add_dropdown("handle at", self._names(), initial_value=NOTHING)
        panel.on(self.choice, "select", lambda v: self.window.select("" if v == NOTHING else v))
        self.place = gui.add_vector3("place [m]", (0.0, 0.0, 0.0), step=0.001)
        panel.on(self.place, "place", self._placed)
        panel.button("scene as it was", self.window.reset)
        self.name = gui.add_text("name", self.window.scene.name)
        panel.button("save scene", self._save_scene)
        panel.button("save plan", self._save_plan)
        self.saved = gui.add_markdown("")

    def _names(self) -> tuple[str, ...]:
        return (NOTHING, *content.grips(self.window.scene))

    def offer(self) -> None:
        """Offer the things of the present scene."""
        if tuple(self.choice.options) != self._names():
            self.choice.options = self._names()

    def follow(self) -> None:
        """Show what is selected, and where it is."""
        chosen = self.window.selected
        self.choice.value = NOTHING if chosen is None else chosen.name
        if chosen is not None:
            self.place.value = tuple(content.place(self.window.scene, chosen).tolist())

    def _placed(self, value: tuple[float, float, float]) -> None:
        window = self.window
        if window.selected is not None:
            window.ask(scene=content.moved(window.scene, window.selected, np.array(value)))
            window.select(window.selected.name)

    def path(self, end: str) -> Path:
        """Where to save under the given name (see :func:`plain_name`), which gets an ``end``."""
        name = plain_name(str(self.name.value))
        check_folder(self.window.out)
        return self.window.out / f"{name}{end}"

    def _save_scene(self) -> None:
        from optipromp.core.scenes.io import save_scene

        path = self.path(".yaml")
        save_scene(replace(self.window.scene, name=path.stem), path)
        self.saved.content = f"wrote {path}"

    def _save_plan(self) -> None:
        from optipromp.core.output import write_pick

        if self.window.shown is None:
            raise InvalidRequestError("there is no plan of this scene")
        folder = self.path("")
        write_pick(Picked(dict(legs_of(self.window.shown.made))), folder)
        self.saved.content = f"wrote {folder}"


def plain_name(text: str) -> str:
    """The name of a file within the page's folder. Raises InvalidRequestError: it is none."""
    name = text.strip()
    if not is_name(name) or name != file_name(name).strip("."):
        raise InvalidRequestError(f"the name {name!r} is not a plain file name")
    return name


LEARNT = "learnt band"
_TELL = "Drag the tool by its handle; the joints follow. Then accept or discard, save, learn."


class RecordTab:
    """Controls of a recording; the window's scene gives robot and start."""

    def __init__(self, panel: Panel) -> None:
        self.panel, self.window, gui = panel, panel.window, panel.gui
        self.recorder: tabs.Recorder | None = None
        self.told = gui.add_markdown(_TELL)
        panel.button("start recording", self.start)
        self.further = [
            panel.button("accept", self.accept),
            panel.button("discard", self.discard),
            panel.button("save demonstrations", self.save),
            panel.button("learn and show the band", self.learn),
            panel.button("forget what was learnt", self.forget),
        ]
        self.enable()

    def enable(self) -> None:
        """Let those buttons be pressed that have something to do."""
        known, held = self.recorder, self.window.handle.dragged == self._dragged
        rows, kept = (known.rows, known.kept) if known is not None else ([], [])
        able = rows, held or rows, kept, kept, self.window.asked.demonstrations
        for button, on in zip(self.further, able, strict=True):
            button.disabled = not on

    def start(self) -> None:
        """Move the arm to the scene's start, and show the handle at the tool."""
        window = self.window
        robot, state = posed(window.scene)
        window.replay(())
        window.select("")
        window.play(False)
        known = self.recorder
        if known is None or known.robot.joint_names != robot.joint_names:
            self.recorder = known = tabs.Recorder(robot, state.q)
        known.begin(state.q)
        window.stage.show(window.scene, robot)
        window.stage.pose(state.q)
        window.handle.hold(robot.tool_pose(state.q)[0], self._dragged)
        self._tell("recording: drag the handle")

    def _dragged(self, at: FloatArray, phase: str, since: float) -> None:
        recorder = self.recorder
        assert recorder is not None
        reached = recorder.drag(at, since)
        self.window.stage.pose(recorder.q)
        words = f"{len(recorder.times)} samples" + ("" if reached else ", **out of reach**")
        self._tell(f"recording: {words}")

    def _recorder(self) -> tabs.Recorder:
        if self.recorder is None:
            raise InvalidRequestError("nothing is recorded yet: start recording")
        return self.recorder

    def accept(self) -> None:
        """Keep the recording."""
        count = self._recorder().accept()
        self.window.handle.release()
        self._tell(f"{count} demonstrations; start recording the next, save or learn")

    def discard(self) -> None:
        """Forget the recording."""
        recorder = self._recorder()
        recorder.begin(recorder.q)
        self.window.handle.release()
        self._tell(f"discarded; {len(recorder.kept)} demonstrations")

    def save(self) -> None:
        """Write the accepted demonstrations into the page's folder."""
        path = self.panel.moving.path("-demonstrations.npz")
        save_demonstrations(self._recorder().demonstrations, path)
        self._tell(f"wrote {path}, for 'optipromp learn'")

    def learn(self) -> None:
        """Learn a primitive, show its tube and plan with it."""
        recorder, window = self._recorder(), self.window
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            promp = fit(recorder.demonstrations, Basis())
        window.stage.bundle(content.bundle(promp, recorder.robot), LEARNT)
        notes = "".join(f"  \n{one.message}" for one in said)
        self._tell(f"learnt from {len(recorder.kept)} demonstrations; plans begin from it{notes}")
        window.ask(demonstrations=promp)

    def forget(self) -> None:
        """Plan from the robot's own demonstrations again."""
        self.window.stage.drop(LEARNT)
        self._tell(_TELL)
        self.window.ask(demonstrations=None)

    def _tell(self, text: str) -> None:
        self.told.content = text
        self.enable()


class ReplayTab:
    """Controls of executed plans."""

    def __init__(self, panel: Panel) -> None:
        self.window, gui = panel.window, panel.gui
        panel.button("execute this plan", self.window.execute)
        self.choice = gui.add_dropdown("replay", ("none",))
        self.second = gui.add_dropdown("beside", ("none",))
        for control in (self.choice, self.second):
            panel.on(control, "replay", lambda _: self.show())
        self.forces = gui.add_markdown("")
        self.sight = gui.add_html("")

    def show(self) -> None:
        """Replay the chosen runs; with none, show the plan."""
        known = {replay.name: replay for replay in self.window.runs.known}
        names = dict.fromkeys(str(c.value) for c in (self.choice, self.second))
        self.window.replay([known[name] for name in names if name in known])

    def follow(self) -> None:
        """Show the names of the replayed runs and the present forces."""
        runs = self.window.runs
        names = ("none", *(replay.name for replay in runs.known))
        now = [replay.name for replay, _ in runs.shown]
        for control, name in zip((self.choice, self.second), [*now, "none", "none"], strict=False):
            if tuple(control.options) != names:
                control.options = names
            control.value = name
        self.forces.content = runs.forces if now else ""
        records = [run.record for run, _ in runs.shown if run.record is not None]
        self.sight.content = "".join(tabs.sight(record, self.window.now) for record in records)


class Page:
    """A running server. :meth:`stop` ends it and its threads. Each window opens with ``source`` and
    saves into ``out``. ``port``: 0: any free one. Raises InvalidRequestError: it cannot listen."""

    def __init__(
        self, source: Source, *, host: str = "localhost", port: int = 0, out: Path = Path("out")
    ) -> None:
        self.source, self.out = source, out
        self.windows: dict[int, Window] = {}
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
            window.panel = Panel(window)
            if client.client_id in self.windows:  # it may have left meanwhile
                window.start()

        window.worker.post("start", begin)

    async def _leave(self, client: Any) -> None:
        window = self.windows.pop(client.client_id, None)
        if window is not None:
            await asyncio.to_thread(window.worker.stop)

    def stop(self) -> None:
        """Close every window and the server."""
        for window in list(self.windows.values()):
            window.worker.stop()
        with redirect_stdout(io.StringIO()):
            self.server.stop()


def usable(host: str, port: int) -> int:
    """The port, or a free one for 0. Raises InvalidRequestError: nobody can listen there."""
    try:
        family, *_ = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((host, port))
            return int(probe.getsockname()[1])
    except (OSError, OverflowError) as error:
        raise InvalidRequestError(f"cannot listen at {host}:{port}: {error}") from None
