"""One browser window: its scene, its plan, its clock and its controls; nothing is shared."""

import contextlib
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.errors import OptiPrompError
from optipromp.core.planning import Picked, Plan, PlanOptions, planner_names
from optipromp.core.planning import plan as make_plan
from optipromp.core.planning.legs import curve_of, legs_of, plan_whole
from optipromp.core.planning.options import DEFAULTS
from optipromp.core.planning.task import posed
from optipromp.core.promp import ProMP
from optipromp.core.scenes.scene import Scene
from optipromp.core.trajectory import Trajectory
from optipromp.looks.viewer.drawn import conditioned_on, held, moment
from optipromp.looks.viewer.sentences import complaint
from optipromp.looks.viewer.words import seconds, without_codes
from optipromp_page import content
from optipromp_page.stage import ROLLOUTS_APART, PlanNodes, Replay, Source, View, execute
from optipromp_page.tabs import Told, Tone, of_error, of_plan, of_runs

HASTE = 0.08  # [s] of a plan during a drag, at most; of 0.15 s until the screen shows it
_planning = threading.Lock()  # windows plan one after another: two at once gain nothing


@dataclass(frozen=True, eq=False)
class Asked:
    """What is planned."""

    scene: Scene
    planner: str = "opti-promp"
    demonstrations: ProMP | None = None  # None: the robot's own
    options: PlanOptions = DEFAULTS

    def plan(self, *, live: bool, reach: bool) -> Plan | Picked:
        """The plan; ``live``: the reach alone, in haste."""
        least = replace(self.options, timeout=min(HASTE, self.options.timeout))
        verb = make_plan if live or reach else plan_whole
        return verb(self.scene, planner=self.planner, demonstrations=self.demonstrations,
                    options=least if live else self.options)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Shown:
    """What was made of a scene, how, in words, and what surrounds it, once that is known."""

    made: Plan | Picked
    scene: Scene
    how: str
    around: content.Around | None = None

    @property
    def plan(self) -> Plan:
        """The reach."""
        return legs_of(self.made)["reach"]

    @cached_property
    def curve(self) -> Trajectory:
        """The motion of all legs."""
        return curve_of(self.made)

    def told(self) -> Told:
        """The plan in words, with the pushes that are known."""
        return of_plan(self.made, self.how, self.around.pushed.shifts() if self.around else {})


class Listener:
    """What a window tells its panel."""

    def say(self, told: Told) -> None:
        """Show a message."""

    def occupy(self, on: bool) -> None:
        """Long work begins, or ends."""

    def staged(self) -> None:
        """What is shown is another."""

    def told(self) -> None:
        """A plan is there, and what surrounds it."""

    def clocked(self) -> None:
        """The time is another."""


class Window:
    """The state of one window and its actions. Every action is a job of the window's thread
    (:attr:`worker`), posted by the controls. No other ``client`` of viser sees its nodes. Where
    ``source`` has no plan, one is made."""

    def __init__(self, client: Any, source: Source, out: Path) -> None:
        self.client, self.source, self.out = client, source, out
        self.original = source.scene
        self.asked = Asked(source.scene)
        self.shown: Shown | None = None
        self.now, self.speed = 0.0, 1.0
        self.selected: content.Grip | None = None
        self.panel = Listener()
        self.worker = Worker(self._tick, self._failed)
        self.stage = PlanNodes(client.scene)
        self.stage.on_click = lambda name: self.worker.post("select", lambda: self.select(name))
        self.handle = Handle(self.stage, self.worker)
        self.view = View(client.camera, self.worker.post)
        self.runs = Runs(self.stage, source.replays)

    @property
    def scene(self) -> Scene:
        """The scene that is planned for."""
        return self.asked.scene

    def start(self) -> None:
        """Show the first scene, and a plan."""
        self.open(self.source.scene, self.source.plan)
        if self.runs.known:
            self.replay(self.runs.known[:2])

    def open(self, scene: Scene, plan: Plan | Picked | None = None) -> None:
        """Show another scene with its ``plan``, or with a new one."""
        self.original = scene
        self.asked = replace(self.asked, scene=scene)
        self.now = 0.0
        self.select("")
        self.replay(())
        self._begin(scene)
        if plan is None:
            self.replan()
        else:
            if (name := legs_of(plan)["reach"].planner) in planner_names():
                self.asked = replace(self.asked, planner=name)
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
            self.view.look(scene, tool)
            self.panel.staged()

    @contextlib.contextmanager
    def working(self, words: str = "") -> Iterator[None]:
        """Say that something is under way, and occupy the controls until it ends."""
        if words:
            self.panel.say(Told(f"{words} …", tone=Tone.BUSY))
        self.panel.occupy(True)
        self.client.flush()
        try:
            yield
        finally:
            self.panel.occupy(False)

    # -- planning -------------------------------------------------------------------------------

    def ask(self, **values: Any) -> None:
        """Plan with other values of :class:`Asked`."""
        self.asked = replace(self.asked, **values)
        self.replan()

    def replan(self, *, live: bool = False, since: float | None = None) -> None:
        """Plan the present scene; ``live``: in haste, the reach alone, without :meth:`details`."""
        self.replay(())
        began = time.perf_counter()
        try:
            with contextlib.nullcontext() if live else self.working("planning"), _planning:
                made = self.asked.plan(live=live, reach=self.source.reach)
        except OptiPrompError as error:
            self.refuse(error)
            return
        words = f"planned in {seconds(time.perf_counter() - began)}"
        if since is not None:
            words += f", {seconds(time.perf_counter() - since)} after the drag"
        self._show(made, words, haste=live)
        if not live:
            self.worker.post("details", self.details)

    def refuse(self, error: OptiPrompError) -> None:
        """Show an error of the scene or the request, at its cause in the scene."""
        with self.client.atomic():
            at = content.culprit(self.scene, error, self.selected)
            self.stage.say(complaint(error), at)
            self.panel.say(of_error(error))

    def _show(self, made: Plan | Picked, words: str, *, haste: bool = False) -> None:
        self.shown = shown = Shown(made, self.scene, words)
        self.stage.near = None
        plan, wrong = shown.plan, complaint(made)
        with self.client.atomic():
            self.stage.show(plan.scene, plan.robot, haste=haste)
            self.stage.trajectories(made)
            last = list(legs_of(made).values())[-1]
            at = content.culprit(plan.scene, last, self.selected) if wrong else None
            self.stage.say(wrong, at)
            if not haste:
                self.stage.sides(content.passing(plan))
                self.stage.via(conditioned_on(plan))
                if self.now == 0.0:
                    self.now = moment(plan).time
                self.panel.staged()
            self.go(self.now)
            self.panel.say(shown.told())

    def details(self) -> None:
        """Show the bundle, candidates, predicted pushes and clearances of the plan."""
        if self.shown is None:
            return
        plan = self.shown.plan
        with self.working():
            around = content.around(self.shown.made)
            self.shown = shown = replace(self.shown, around=around)
            bundle = content.initial_bundle(plan, self.asked.demonstrations)
            tried = content.candidates(plan) if plan.planner == "opti-promp" else []
            with self.client.atomic():
                self.stage.near = around.near
                self.stage.bundle(bundle)
                threshold = plan.prediction.threshold if plan.prediction else 1.0
                self.stage.candidates(tried, threshold)
                self.stage.ghosts(around.pushed.at(plan.duration))
                if not self.runs.shown:
                    self.panel.say(shown.told())
                self.panel.told()
                self.go(self.now)

    # -- the clock ------------------------------------------------------------------------------

    @property
    def duration(self) -> float:
        """Duration of the plan, or of the replayed plans [s]."""
        if self.runs.shown:
            return self.runs.duration
        return 0.0 if self.shown is None else self.shown.curve.duration

    def go(self, now: float) -> None:
        """Show the arm and the objects at the time ``now`` [s]."""
        self.now = float(np.clip(now, 0.0, self.duration))
        if self.runs.shown:
            self.runs.go(self.now)
        elif self.shown is not None:
            self.stage.pose(self.shown.curve.at(self.now).q)
            around = self.shown.around
            if around is not None:
                seen = self.stage.visible("pushed objects")
                self.stage.place(around.pushed.at(self.now if seen else 0.0))
            self.stage.place(held(self.shown.made, self.now))
            if around is not None:
                self.stage.colour(int(np.abs(around.times - self.now).argmin()))
        self.panel.clocked()

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
        if self.shown is None:
            return
        planner, known = self.shown.plan.planner, self.runs.known
        with self.working(f"executing {planner} in the simulation"), _planning:
            known.append(execute(self.shown.made, f"{len(known) + 1}: {planner}"))
        self.replay(known[-1:])

    def replay(self, chosen: Sequence[Replay]) -> None:
        """Replay executed plans, two side by side; with none, show the plan again."""
        if not chosen and not self.runs.shown:
            return
        self.runs.clear()
        self.stage.mute(bool(chosen))
        if chosen:
            scene = chosen[0].scene
            apart = -ROLLOUTS_APART * scene.frame[1]
            tool = chosen[0].robot.tool_pose(chosen[0].arrays["q"][0])[0]
            self.view.look(scene, tool, apart if len(chosen) > 1 else None)
            with self.client.atomic():
                self.runs.show(chosen, scene.base.rotation @ apart)
                self.panel.say(of_runs(chosen))
                self.panel.staged()
                self.go(0.0)
        elif self.shown is not None:
            self.stage.show(self.shown.plan.scene, self.shown.plan.robot)
            self.panel.say(self.shown.told())
            self.panel.staged()
            self.go(self.now)

    # -- moving things --------------------------------------------------------------------------

    def select(self, name: str) -> None:
        """Show the handle of one of :func:`optipromp_page.content.grips`; empty: of none."""
        self.selected = content.grips(self.scene).get(name)
        self.handle.release()
        if self.selected is not None:
            self.handle.hold(content.place(self.scene, self.selected), self._dragged)
        self.panel.clocked()

    def _dragged(self, at: FloatArray, phase: str, since: float) -> None:
        assert self.selected is not None
        self.worker.drop("details")
        try:
            scene = content.moved(self.scene, self.selected, at)
        except OptiPrompError as error:
            self.refuse(error)
            return
        self.asked = replace(self.asked, scene=scene)
        self.replan(live=phase == "update", since=since)

    def reset(self) -> None:
        """Restore the scene as it was opened."""
        self.asked = replace(self.asked, scene=self.original)
        self.select("")
        self.replan()

    def _failed(self, error: Exception) -> None:
        self.panel.say(
            Told("Something broke", (f"error: {type(error).__name__}: {error}",), Tone.BAD)
        )


class Runs:
    """Executed plans of a window, and those that are replayed: the first on its ``stage``."""

    def __init__(self, stage: PlanNodes, known: Sequence[Replay]) -> None:
        self.stage, self.known = stage, list(known)
        self.shown: tuple[tuple[Replay, PlanNodes], ...] = ()
        self.forces = ""  # in words

    @property
    def duration(self) -> float:
        """The longest of those that are replayed [s]."""
        return max(replay.duration for replay, _ in self.shown)

    def show(self, chosen: Sequence[Replay], apart: FloatArray) -> None:
        """Replay plans, a second ``apart`` (3,) of the first [m]."""
        there = apart.tolist()
        stages = [self.stage, *(PlanNodes(self.stage.api, "b", there) for _ in chosen[1:])]
        for replay, stage in zip(chosen, stages, strict=True):
            stage.show(replay.scene, replay.robot)
            stage.glass(replay.record is not None)
            stage.say(replay.message, None)
        self.shown = tuple(zip(chosen, stages, strict=True))

    def go(self, now: float) -> None:
        """Show the time ``now`` [s]."""
        told = [f"**{run.name}**  \n{run.show(stage, now)}" for run, stage in self.shown]
        self.forces = without_codes("\n\n".join(told))

    def clear(self) -> None:
        """Replay nothing."""
        for _, stage in self.shown:
            for layer in ("forces", "tracks", "path ahead"):
                stage.drop(layer)
            stage.glass(False)
            if stage is not self.stage:
                stage.clear()
        self.shown = ()


class Handle:
    """The handle on a window's ``stage`` by which a point is dragged."""

    def __init__(self, stage: PlanNodes, worker: "Worker") -> None:
        self.stage, self.worker = stage, worker
        self.dragged: Callable[[FloatArray, str, float], None] | None = None
        self.gizmo: Any = None

    def hold(self, at: FloatArray, dragged: Callable[[FloatArray, str, float], None]) -> None:
        """Show it at a point (3,). ``dragged`` is posted with each place, ``update`` or ``end``,
        and the time at which it was received [s]."""
        self.dragged = dragged
        name, still = f"{self.stage.root}/handle", {"disable_rotations": True, "depth_test": False}
        self.gizmo = self.stage.api.add_transform_controls(name, scale=0.12, position=at, **still)

        async def moved(event: Any) -> None:  # in order: viser awaits it
            if event.phase != "start":
                self.drag(np.array(event.target.position), event.phase, time.perf_counter())

        self.gizmo.on_update(moved)

    def drag(self, at: FloatArray, phase: str, since: float) -> None:
        """Post the move to a point (3,); called from viser's thread."""
        if (act := self.dragged) is None:
            return
        if phase == "end":
            self.worker.drop("drag")
        kind = "drag" if phase == "update" else "dropped"
        self.worker.post(kind, lambda: act(at, phase, since))

    def release(self) -> None:
        """Remove it."""
        self.dragged = None
        if self.gizmo is not None:
            self.gizmo.remove()
            self.gizmo = None


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
