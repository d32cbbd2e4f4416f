"""One browser window: its scene, its plan, its clock and its controls; nothing is shared."""

import contextlib
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Picked, Plan, PlanOptions, planner_names
from optipromp.core.planning import plan as make_plan
from optipromp.core.planning.legs import curve_of, legs_of, plan_whole
from optipromp.core.planning.task import posed
from optipromp.core.scenes.scene import Scene
from optipromp.looks.viewer.drawn import conditioned_on, held, moment
from optipromp.looks.viewer.words import seconds, without_codes
from optipromp_page import content
from optipromp_page.sentences import complaint
from optipromp_page.stage import ROLLOUTS_APART, PlanNodes, Replay, Source, execute, look
from optipromp_page.tabs import Told, Tone, of_error, of_plan, of_runs

HASTE = 0.08  # [s] of a plan during a drag, at most; of 0.15 s until the screen shows it
AIMS = 20  # of a view that does not arrive in a page, at most: a choice
ARRIVED = 1e-3  # [m] of a view from where it was placed: a choice
_planning = threading.Lock()  # windows plan one after another: two at once gain nothing


class Window:
    """The state of one window and its actions. Every action is a job of the window's thread
    (:attr:`worker`), posted by the controls. No other ``client`` of viser sees its nodes. Where
    ``source`` has no plan, one is made."""

    def __init__(self, client: Any, source: Source, out: Path) -> None:
        self.client, self.source, self.out = client, source, out
        self.original = self.scene = source.scene
        self.settings: dict[str, Any] = {"planner": "opti-promp"}
        self.options = PlanOptions()
        self.made: Plan | Picked | None = None
        self.plan: Plan | None = None  # the reach of what was made
        self.planned: Scene | None = None  # for which it was made
        self.now, self.speed = 0.0, 1.0
        self.selected: content.Grip | None = None
        self.worker = Worker(self._tick, self._failed)
        self.post = self.worker.post
        self.stage = PlanNodes(client.scene)
        self.stage.on_click = lambda name: self.post("select", lambda: self.select(name))
        self.near: content.Clearances | None = None
        self.chart_times: FloatArray = np.zeros(0)
        self._pushed: content.PushedPlaces | None = None
        self._how = ""  # the plan was made, in words
        self._gizmo: Any = None
        self.dragging: Callable[[FloatArray, str], None] | None = None
        self.since = 0.0  # [s] when the drag that is answered next was received
        # callbacks of the panel
        self.say: Callable[[Told], None] = lambda told: None
        self.occupy: Callable[[bool], None] = lambda on: None  # before and after long work
        self.staged: Callable[[], None] = lambda: None  # after a change of what is shown
        self.told: Callable[[], None] = lambda: None  # after a plan and all that belongs to it
        self.clocked: Callable[[], None] = lambda: None  # after a change of the time
        self.replays: list[Replay] = list(source.replays)
        self.replayed: tuple[tuple[Replay, PlanNodes], ...] = ()
        self.forces = ""  # of the replay, in words
        self._aimed: tuple[Any, ...] | None = None  # what is framed, for which size, from where
        self._arrived, self._aims = False, AIMS

    def start(self) -> None:
        """Show the first scene, and a plan."""
        self.client.camera.on_update(self._reported)
        self.open(self.source.scene, self.source.plan)
        if self.replays:
            self.replay(self.replays[:2])

    def open(self, scene: Scene, plan: Plan | Picked | None = None) -> None:
        """Show another scene with its ``plan``, or with a new one."""
        self.original = self.scene = scene
        self.now = 0.0
        self.select("")
        self.replay(())
        self._begin(scene)
        if plan is None:
            self.replan()
        else:
            if (name := legs_of(plan)["reach"].planner) in planner_names():
                self.settings["planner"] = name
            self._show(plan, "as it was saved")
            self.details()

    def _begin(self, scene: Scene) -> None:
        """Show a scene with the arm at its start, while there is no plan yet."""
        tool = None
        with self.client.atomic():
            try:
                robot, state = posed(scene)
            except OptiPrompError:
                pass  # planning tells it
            else:
                tool = robot.tool_pose(state.q)[0]
                self.stage.show(scene, robot)
                self.stage.pose(state.q)
            self._look(scene, tool)
            self.staged()

    def _look(self, *what: Any) -> None:
        """See :func:`optipromp_page.stage.look`."""
        camera = self.client.camera
        size = camera.image_width, camera.image_height
        look(camera, *what)
        self._aimed = what, size, np.array(camera.position)

    def _reported(self, camera: Any) -> None:
        """Frame the scene again: the page has another size, and its user did not turn the view; or
        the view did not arrive, which a page that opens may not hear."""
        if self._aimed is None:
            return
        what, size, place = self._aimed
        there = np.abs(camera.position - place).max() < ARRIVED
        self._arrived |= there
        other = (camera.image_width, camera.image_height) != size
        if other if there else not self._arrived and self._aims > 0:
            self._aims -= not there
            self.post("look", lambda: self._look(*what))

    @contextlib.contextmanager
    def working(self, words: str = "") -> Iterator[None]:
        """Say that something is under way, and :attr:`occupy` the controls until it ends."""
        if words:
            self.say(Told(f"{words} …", tone=Tone.BUSY))
        self.occupy(True)
        self.client.flush()
        try:
            yield
        finally:
            self.occupy(False)

    # -- planning -------------------------------------------------------------------------------

    def replan(self, *, live: bool = False, since: float | None = None) -> None:
        """Plan the present scene; ``live``: in haste, the reach alone, without :meth:`details`."""
        self.replay(())
        began = time.perf_counter()
        hasty = replace(self.options, timeout=min(HASTE, self.options.timeout))
        options = hasty if live else self.options
        try:
            with contextlib.nullcontext() if live else self.working("planning"), _planning:
                verb = make_plan if live or self.source.reach else plan_whole
                made = verb(self.scene, options=options, **self.settings)
        except OptiPrompError as error:
            self.refuse(error)
            return
        words = f"planned in {seconds(time.perf_counter() - began)}"
        if since is not None:
            words += f", {seconds(time.perf_counter() - since)} after the drag"
        self._show(made, words, haste=live)
        if not live:
            self.post("details", self.details)

    def refuse(self, error: OptiPrompError) -> None:
        """Show an error of the scene or the request, at its cause in the scene."""
        with self.client.atomic():
            at = content.culprit(self.scene, error, self.selected)
            self.stage.say(complaint(error), at)
            self.say(of_error(error))

    def _show(self, made: Plan | Picked, words: str, *, haste: bool = False) -> None:
        plan, *later = legs_of(made).values()
        self.made, self.plan, self.planned, self.curve = made, plan, self.scene, curve_of(made)
        self._pushed = self.near = self.stage.near = None
        self._how, wrong = words, complaint(made)
        with self.client.atomic():
            self.stage.show(plan.scene, plan.robot, haste=haste)
            self.stage.trajectories(made)
            last = [plan, *later][-1]
            at = content.culprit(plan.scene, last, self.selected) if wrong else None
            self.stage.say(wrong, at)
            if not haste:
                self.stage.sides(content.passing(plan))
                self.stage.via(conditioned_on(plan))
                if self.now == 0.0:
                    self.now = moment(plan).time
                self.staged()
            self.go(self.now)
            self.say(of_plan(made, words, {}))

    def details(self) -> None:
        """Show the bundle, candidates, predicted pushes and clearances of the plan."""
        made, plan = self.made, self.plan
        if made is None or plan is None:
            return
        with self.working():
            self.chart_times = np.linspace(0.0, self.curve.duration, content.CHART_ROWS)
            q = self.curve.sample(self.chart_times)[0]
            self.near = content.clearances(plan.scene, plan.robot, q)
            self._pushed = content.pushed(made)
            bundle = content.initial_bundle(plan, self.settings.get("demonstrations"))
            tried = content.candidates(plan) if plan.planner == "opti-promp" else []
            with self.client.atomic():
                self.stage.near = self.near
                self.stage.bundle(bundle)
                threshold = plan.prediction.threshold if plan.prediction else 1.0
                self.stage.candidates(tried, threshold)
                self.stage.ghosts(self._pushed.at(plan.duration))
                if not self.replayed:
                    self.say(of_plan(made, self._how, self._pushed.shifts()))
                self.told()
                self.go(self.now)

    # -- the clock ------------------------------------------------------------------------------

    @property
    def duration(self) -> float:
        """Duration of the plan, or of the replayed plans [s]."""
        if self.replayed:
            return max(replay.duration for replay, _ in self.replayed)
        return 0.0 if self.made is None else self.curve.duration

    def go(self, now: float) -> None:
        """Show the arm and the objects at the time ``now`` [s]."""
        self.now = float(np.clip(now, 0.0, self.duration))
        if self.replayed:
            told = [f"**{r.name}**  \n{r.show(stage, self.now)}" for r, stage in self.replayed]
            self.forces = without_codes("\n\n".join(told))
        elif self.made is not None:
            self.stage.pose(self.curve.at(self.now).q)
            if self._pushed is not None:
                seen = self.stage.visible("pushed objects")
                self.stage.place(self._pushed.at(self.now if seen else 0.0))
            self.stage.place(held(self.made, self.now))
            if self.near is not None:
                self.stage.colour(int(np.abs(self.chart_times - self.now).argmin()))
        self.clocked()

    def play(self, running: bool) -> None:
        """Start the clock, at the end again from the beginning; or stop it."""
        if running and self.now >= self.duration:
            self.go(0.0)
        self.worker.running = running

    def _tick(self, seconds: float) -> None:
        with self.client.atomic():
            self.go(self.now + self.speed * min(seconds, 0.2))
        if self.now >= self.duration:
            self.play(False)
            self.go(self.now)

    # -- executed plans -------------------------------------------------------------------------

    def execute(self) -> None:
        """Execute the plan in the simulation, and replay it."""
        if self.made is None or self.plan is None:
            return
        with self.working(f"executing {self.plan.planner} in the simulation"), _planning:
            count = len(self.replays) + 1
            self.replays.append(execute(self.made, f"{count}: {self.plan.planner}"))
        self.replay(self.replays[-1:])

    def replay(self, chosen: Sequence[Replay]) -> None:
        """Replay executed plans, two side by side; with none, show the plan again."""
        if not chosen and not self.replayed:
            return
        for _, stage in self.replayed:
            for layer in ("forces", "tracks", "path ahead"):
                stage.drop(layer)
            stage.glass(False)
            if stage is not self.stage:
                stage.clear()
        self.replayed = ()
        self.stage.mute(bool(chosen))
        if chosen:
            scene = chosen[0].scene
            apart = -ROLLOUTS_APART * scene.frame[1]
            tool = chosen[0].robot.tool_pose(chosen[0].arrays["q"][0])[0]
            self._look(scene, tool, apart if len(chosen) > 1 else None)
            there = scene.base.rotation @ apart
            stages = [self.stage, *(PlanNodes(self.client.scene, "b", there) for _ in chosen[1:])]
            with self.client.atomic():
                for replay, stage in zip(chosen, stages, strict=True):
                    stage.show(replay.scene, replay.robot)
                    stage.glass(replay.record is not None)
                    stage.say(replay.message, None)
                self.replayed = tuple(zip(chosen, stages, strict=True))
                self.say(of_runs(chosen))
                self.staged()
                self.go(0.0)
        elif self.made is not None and self.plan is not None:
            self.stage.show(self.plan.scene, self.plan.robot)
            self.say(of_plan(self.made, self._how, self._pushed.shifts() if self._pushed else {}))
            self.staged()
            self.go(self.now)

    # -- moving things --------------------------------------------------------------------------

    def select(self, name: str) -> None:
        """Show the handle of one of :func:`optipromp_page.content.grips`; empty: of none."""
        found = content.grips(self.scene)
        self.selected = found.get(name)
        self.release()
        if self.selected is not None:
            self.hold(content.place(self.scene, self.selected), self._dragged)
        self.clocked()

    def hold(self, at: FloatArray, dragged: Callable[[FloatArray, str], None]) -> None:
        """Show a handle at a point (3,); ``dragged`` gets its place, and ``update`` or ``end``."""
        self.dragging = dragged
        name, still = f"{self.stage.root}/handle", {"disable_rotations": True, "depth_test": False}
        gizmo = self.client.scene.add_transform_controls(name, scale=0.12, position=at, **still)
        self._gizmo = gizmo

        async def moved(event: Any) -> None:  # in order: viser awaits it
            since, at = time.perf_counter(), np.array(event.target.position)
            if event.phase != "start" and self.dragging is not None:
                self.dragged(at, event.phase, since)

        self._gizmo.on_update(moved)

    def release(self) -> None:
        """Remove the handle."""
        self.dragging = None
        if self._gizmo is not None:
            self._gizmo.remove()
            self._gizmo = None

    def dragged(self, at: FloatArray, phase: str, since: float) -> None:
        """Post the move of the handle to a point (3,); called from viser's thread."""
        act = self.dragging
        if act is None:
            return
        if phase == "end":
            self.worker.drop("drag")
        self.since = since
        self.post("drag" if phase == "update" else "dropped", lambda: act(at, phase))

    def _dragged(self, at: FloatArray, phase: str) -> None:
        assert self.selected is not None
        self.worker.drop("details")
        try:
            self.scene = content.moved(self.scene, self.selected, at)
        except OptiPrompError as error:
            self.refuse(error)
            return
        self.replan(live=phase == "update", since=self.since)

    def reset(self) -> None:
        """Restore the scene as it was opened."""
        self.scene = self.original
        self.select("")
        self.replan()

    def change(self, scene: Scene) -> None:
        """Plan in a changed scene."""
        self.scene = scene
        self.replan()

    def _failed(self, error: Exception) -> None:
        self.say(Told("Something broke", (f"error: {type(error).__name__}: {error}",), Tone.BAD))


Job = Callable[[], None]
CLOCK_RATE = 20.0  # [Hz] of a clock that runs


class Worker:
    """Runs jobs one after another. A new job of a kind takes the place of a waiting one. ``tick``:
    called with the seconds since the last call, while :attr:`running` and nothing waits.
    ``failed``: called with the error of a job, which is also printed on standard error."""

    def __init__(self, tick: Callable[[float], None], failed: Callable[[Exception], None]) -> None:
        self._tick, self._failed = tick, failed
        self._jobs: dict[str, Job] = {}
        self._ready = threading.Condition()
        self._alive = True
        self.running = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def post(self, kind: str, job: Job) -> None:
        """Queue a job, in place of a waiting one of its kind."""
        with self._ready:
            self._jobs.pop(kind, None)
            self._jobs[kind] = job
            self._ready.notify_all()

    def drop(self, kind: str) -> None:
        """Forget a waiting job."""
        with self._ready:
            self._jobs.pop(kind, None)

    def stop(self) -> None:
        """End the thread after its present job."""
        with self._ready:
            self._alive = False
            self._jobs.clear()
            self._ready.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(timeout=10.0)

    def _run(self) -> None:
        last = time.monotonic()
        while True:
            with self._ready:
                if not self._jobs and self._alive:
                    self._ready.wait(1.0 / CLOCK_RATE if self.running else None)
                if not self._alive:
                    return
                job = self._jobs.pop(next(iter(self._jobs))) if self._jobs else None
            now = time.monotonic()
            try:
                if job is not None:
                    job()
                elif self.running:
                    self._tick(now - last)
            except Exception as error:  # the window stays, and says so
                traceback.print_exc(file=sys.stderr)
                self._failed(error)
            last = now
