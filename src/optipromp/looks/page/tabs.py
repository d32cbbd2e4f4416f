"""The controls that all tabs share, and the tabs that record demonstrations and replay runs."""

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError, OptiPrompError
from optipromp.core.files import check_folder, file_name
from optipromp.core.planning.task import posed
from optipromp.core.promp import Basis, Demonstrations, ProMP, fit
from optipromp.core.promp.demonstrations import Demonstration, save_demonstrations
from optipromp.core.robots import ik
from optipromp.core.robots.model import Robot
from optipromp.core.shown import is_name
from optipromp.laboratory.simulation.loop_files import LoopRecord
from optipromp.looks.page.content import bundle
from optipromp.looks.page.window import Window
from optipromp.looks.viewer.drawn import GREEN, RED

RECENT = 0.5  # [s] age of a look above which nothing is drawn: the camera is blocked, a choice
_SIDE = 200  # [pixel] of what the camera of a closed loop saw, beside the replay
LEARNT = "learnt band"
_TELL = "Drag the tool by its handle; the joints follow. Then accept or discard, save, learn."


def plain_name(text: str) -> str:
    """The name of a file within the page's folder."""
    name = text.strip()
    if not is_name(name) or name != file_name(name).strip("."):
        raise InvalidRequestError(f"the name {name!r} is not a plain file name")
    return name


class Controls:
    """The controls of a window: each posts what it does, and errors are told on the page."""

    def __init__(self, window: Window) -> None:
        self.window, self.gui = window, window.client.gui
        self.buttons: list[Any] = []
        self.name: Any = None  # the field of the name to save under

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
                self.window.post(kind, lambda: self._safely(act, value))

        (getattr(control, "on_update", None) or control.on_click)(changed)

    def _safely(self, act: Callable[[Any], None], value: Any) -> None:
        try:
            act(value)
        except OptiPrompError as error:
            self.window.refuse(error)

    def named(self) -> str:
        """The name to save under, see :func:`plain_name`."""
        return plain_name(str(self.name.value))


class RecordTab:
    """Controls of a recording; the window's scene gives robot and start."""

    def __init__(self, panel: Controls) -> None:
        self.panel, self.window, gui = panel, panel.window, panel.gui
        self.recorder: Recorder | None = None
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
        known, held = self.recorder, self.window.dragging == self._dragged
        rows, kept = (known.rows, known.kept) if known is not None else ([], [])
        able = rows, held or rows, kept, kept, "demonstrations" in self.window.settings
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
            self.recorder = known = Recorder(robot, state.q)
        known.begin(state.q)
        window.stage.show(window.scene, robot)
        window.stage.pose(state.q)
        window.hold(robot.tool_pose(state.q)[0], self._dragged)
        self._tell("recording: drag the handle")

    def _dragged(self, at: FloatArray, phase: str) -> None:
        recorder = self.recorder
        assert recorder is not None
        reached = recorder.drag(at, self.window.since)
        self.window.stage.pose(recorder.q)
        words = f"{len(recorder.times)} samples" + ("" if reached else ", **out of reach**")
        self._tell(f"recording: {words}")

    def _recorder(self) -> "Recorder":
        if self.recorder is None:
            raise InvalidRequestError("nothing is recorded yet: start recording")
        return self.recorder

    def accept(self) -> None:
        """Keep the recording."""
        count = self._recorder().accept()
        self.window.release()
        self._tell(f"{count} demonstrations; start recording the next, save or learn")

    def discard(self) -> None:
        """Forget the recording."""
        recorder = self._recorder()
        recorder.begin(recorder.q)
        self.window.release()
        self._tell(f"discarded; {len(recorder.kept)} demonstrations")

    def save(self) -> None:
        """Write the accepted demonstrations into the page's folder."""
        name = self.panel.named()
        check_folder(self.window.out)
        path = self.window.out / f"{name}-demonstrations.npz"
        self._recorder().save(path)
        self._tell(f"wrote {path}, for 'optipromp learn'")

    def learn(self) -> None:
        """Learn a primitive, show its tube and plan with it."""
        recorder, window = self._recorder(), self.window
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            promp = recorder.learn()
        window.stage.bundle(bundle(promp, recorder.robot), LEARNT)
        notes = "".join(f"  \n{one.message}" for one in said)
        self._tell(f"learnt from {len(recorder.kept)} demonstrations; plans begin from it{notes}")
        window.settings["demonstrations"] = promp
        window.replan()

    def forget(self) -> None:
        """Plan from the robot's own demonstrations again."""
        self.window.settings.pop("demonstrations", None)
        self.window.stage.drop(LEARNT)
        self._tell(_TELL)
        self.window.replan()

    def _tell(self, text: str) -> None:
        self.told.content = text
        self.enable()


class ReplayTab:
    """Controls of executed plans."""

    def __init__(self, panel: Controls) -> None:
        self.window, gui = panel.window, panel.gui
        panel.button("execute this plan", self.window.execute)
        self.choice = gui.add_dropdown("replay", ("none",))
        self.second = gui.add_dropdown("beside", ("none",))
        for control in (self.choice, self.second):
            panel.on(control, "replay", lambda _: self.show())
        self.forces = gui.add_markdown("")
        self.sight = gui.add_html("")
        self.window.clocked.append(self.follow)

    def show(self) -> None:
        """Replay the chosen runs; with none, show the plan."""
        known = {replay.name: replay for replay in self.window.replays}
        names = dict.fromkeys(str(c.value) for c in (self.choice, self.second))
        self.window.replay([known[name] for name in names if name in known])

    def follow(self) -> None:
        """Show the names of the replayed runs and the present forces."""
        names = ("none", *(replay.name for replay in self.window.replays))
        now = [replay.name for replay, _ in self.window.replayed]
        for control, name in zip((self.choice, self.second), [*now, "none", "none"], strict=False):
            if tuple(control.options) != names:
                control.options = names
            control.value = name
        text = self.window.forces if now else ""
        if self.forces.content != text:
            self.forces.content = text
        records = [run.record for run, _ in self.window.replayed if run.record is not None]
        drawn = "".join(sight(record, self.window.now) for record in records)
        if self.sight.content != drawn:
            self.sight.content = drawn


def sight(record: LoopRecord, now: float) -> str:
    """The last look until ``now`` [s] as HTML: its cone of view with the detections in it.

    The picture is the camera's, its x axis to the right. Targets are red, other fruits green.
    """
    found = record.sight(now)
    if found is None:
        return ""
    age, view, discs = found
    wide = math.tan(0.5 * view)
    circles = "".join(
        f'<circle cx="{x:.4f}" cy="{y:.4f}" r="{r:.4f}" fill="none" stroke-width="{0.015 * wide}" '
        f'stroke="{RED if target else GREEN}"/>'
        for x, y, r, target in (discs.tolist() if age <= RECENT else ())
    )
    words = f"the camera, {1e3 * age:.0f} ms ago" if age <= RECENT else "the camera sees nothing"
    return (
        f'<figure class="sight" style="margin:0.5em 1em;font-size:0.8em"><svg width="{_SIDE}" '
        f'height="{_SIDE}" viewBox="{-wide} {-wide} {2 * wide} {2 * wide}">'
        f'<circle r="{wide}" fill="#f1f3f5"/>{circles}</svg>'
        f"<figcaption>{words}</figcaption></figure>"
    )


MISSED = 1e-3  # [m] from the handle to the tool; a pose that misses by more is out of reach
SHORTEST = 1e-3  # [s] between two samples, at least
LONGEST_PAUSE = 0.2  # [s] between two samples, at most: longer pauses of the hand are shortened
FEWEST_SAMPLES = 5  # of a demonstration


@dataclass
class Recorder:
    """Demonstrations of one robot, and the one that is being recorded.

    Attributes:
        robot: whose joints are recorded.
        q: (n,) present configuration.
        times, rows: of the demonstration under way: [s] and (n,) each.
        kept: accepted demonstrations.
        last: time of the last sample [s].
    """

    robot: Robot
    q: FloatArray
    times: list[float] = field(default_factory=list)
    rows: list[FloatArray] = field(default_factory=list)
    kept: list[Demonstration] = field(default_factory=list)
    last: float = 0.0

    def begin(self, q: FloatArray) -> None:
        """Start anew from ``q`` (n,)."""
        self.q, self.times, self.rows = np.array(q), [], []

    def drag(self, point: FloatArray, now: float) -> bool:
        """Follow the handle to ``point`` (3,) [m] at the time ``now`` [s]; False if out of reach.

        The tool keeps its direction. Out of reach, the arm stays where it is.
        """
        if not self.times:
            self.times, self.rows, self.last = [0.0], [self.q], now - SHORTEST
        axis = self.robot.tool_pose(self.rows[0])[1]
        found, error = ik.track(self.robot, np.asarray(point)[None], axis[None], self.q)
        if error[0] > MISSED:
            return False
        self.q = found[0]
        if now >= self.last + SHORTEST:
            self.times.append(self.times[-1] + min(now - self.last, LONGEST_PAUSE))
            self.rows.append(self.q)
            self.last = now
        return True

    def accept(self) -> int:
        """Keep the demonstration under way; returns the number of demonstrations."""
        if len(self.times) < FEWEST_SAMPLES:
            raise InvalidRequestError(
                f"the recording has {len(self.times)} samples: drag the tool further"
            )
        self.kept.append(Demonstration(np.array(self.times), np.array(self.rows)))
        self.times, self.rows = [], []
        return len(self.kept)

    @property
    def demonstrations(self) -> Demonstrations:
        """The accepted demonstrations."""
        return Demonstrations(tuple(self.kept), self.robot.joint_names)

    def learn(self) -> ProMP:
        """A primitive learnt from the accepted demonstrations."""
        return fit(self.demonstrations, Basis())

    def save(self, path: Path) -> None:
        """Write the demonstrations as ``optipromp learn`` reads them."""
        save_demonstrations(self.demonstrations, path)
