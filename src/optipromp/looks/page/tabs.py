"""The tabs for recording demonstrations and for replaying executed plans."""

import warnings
from typing import TYPE_CHECKING

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import InvalidRequestError
from optipromp.core.files import check_folder
from optipromp.core.planning.task import posed
from optipromp.looks.page.content import bundle
from optipromp.looks.page.inset import sight
from optipromp.looks.page.record import Recorder

if TYPE_CHECKING:
    from optipromp.looks.page.panel import Panel

LEARNT = "learnt band"
_TELL = "Drag the tool by its handle; the joints follow. Then accept or discard, save, learn."


class RecordTab:
    """Controls of a recording; the window's scene gives robot and start."""

    def __init__(self, panel: "Panel") -> None:
        self.panel, self.window, gui = panel, panel.window, panel.gui
        self.recorder: Recorder | None = None
        self.told = gui.add_markdown(_TELL)
        panel.button("start recording", self.start)
        panel.button("accept", self.accept, self._recorded)
        panel.button("discard", self.discard, self._begun)
        panel.button("save demonstrations", self.save, self._accepted)
        panel.button("learn and show the band", self.learn, self._accepted)
        panel.button("forget what was learnt", self.forget, self._learnt)
        panel.enable()

    def _begun(self) -> bool:
        return self.window.dragging == self._dragged or self._recorded()

    def _recorded(self) -> bool:
        return self.recorder is not None and bool(self.recorder.rows)

    def _accepted(self) -> bool:
        return self.recorder is not None and bool(self.recorder.kept)

    def _learnt(self) -> bool:
        return "demonstrations" in self.window.settings

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

    def _recorder(self) -> Recorder:
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
        self.panel.enable()


class ReplayTab:
    """Controls of executed plans."""

    def __init__(self, panel: "Panel") -> None:
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
