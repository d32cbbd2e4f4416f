"""``plan_many``: many scenes on all cores.

The calling process plans too, beside ``workers - 1`` helper processes that fetch the rest. Threads
would not do: a plan is hundreds of short kernels with Python between them, and two threads then
take as long as one (0.97 times its speed on two cores).
"""

import contextlib
import io
import multiprocessing
import os
import pickle
import queue
import signal
import threading
import warnings
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from multiprocessing import resource_tracker, spawn
from multiprocessing.connection import Connection
from multiprocessing.context import (
    ForkServerContext,
    ForkServerProcess,
    SpawnContext,
    SpawnProcess,
)
from pathlib import Path
from typing import Any

import numpy as np

from optipromp.arrays import frozen
from optipromp.errors import InvalidRequestError, NoPlanError, OptiPrompError
from optipromp.planning.options import Planner, PlanOptions, Strategy
from optipromp.planning.plan import Plan, check_planner, plan
from optipromp.promp.model import ProMP
from optipromp.robots.model import Robot
from optipromp.scenes.scene import Scene

GUARD = 'if __name__ == "__main__":'
THREADS = (
    "OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)  # fmt: skip
AHEAD = 2  # scenes that a helper holds: one that it plans, and the next

Result = Plan | OptiPrompError


@dataclass(frozen=True, eq=False)
class _Request:
    """What all plans have in common."""

    planner: Planner
    strategy: Strategy
    demonstrations: ProMP | str | Path | None
    seed: int
    options: PlanOptions | None

    def result(self, scene: Scene | str | Path) -> Result:
        try:
            return plan(scene, **vars(self))
        except OptiPrompError as error:
            return error.with_traceback(None)


def plan_many(
    scenes: Sequence[Scene | str | Path],
    options: PlanOptions | None = None,
    *,
    planner: Planner = "opti-promp",
    strategy: Strategy = "joint",
    demonstrations: ProMP | str | Path | None = None,
    seed: int = 0,
    workers: int | None = None,
    progress: Callable[[int, Result], None] | None = None,
) -> list[Result]:
    """Plan a reach in each of many scenes, on all cores.

    Every plan is the one that :func:`optipromp.plan` makes of that scene alone. As with all of
    Python's processes, a script that calls this does so under ``if __name__ == "__main__":``, and
    cost terms of your own (``options.terms``) are of classes that can be imported.

    Args:
        scenes: scenes, names of built-in ones, or scene files.
        options: see :class:`PlanOptions`; for every plan.
        planner, strategy, demonstrations, seed: as :func:`optipromp.plan` takes them.
        workers: processes that plan, this one among them; None: one a core.
        progress: called in this thread after each plan, in the order they are done, with the
            index of its scene and what came of it.

    Returns:
        In the order of ``scenes``: the plan, also one that failed, or the error that
        :func:`optipromp.plan` raises for that scene.

    Raises:
        InvalidRequestError: fewer than one worker; an unknown planner or strategy; options or
            demonstrations that cannot be sent to another process.
    """
    if workers is not None and workers < 1:
        raise InvalidRequestError(f"workers is {workers}; it must be at least 1")
    check_planner(planner, strategy)
    request = _Request(planner, strategy, demonstrations, seed, options)
    work = _Work(list(scenes))
    results: list[Result | None] = [None] * len(work.scenes)
    count = min(workers or cores(), len(work.scenes))
    with _helpers(request, work, count - 1):
        for _ in results:
            index, result = work.next_result(request)
            results[index] = result
            if progress is not None:
                progress(index, result)
    return [result for result in results if result is not None]


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Work:
    """Scenes that nobody has taken yet, and results that the caller has not heard of."""

    def __init__(self, scenes: Sequence[Scene | str | Path]) -> None:
        self.scenes = scenes
        self.waiting = deque(range(len(scenes)))
        self.done: queue.SimpleQueue[tuple[int, Result | BaseException] | str] = queue.SimpleQueue()

    def take(self) -> int | None:
        """The index of a scene that is now the taker's."""
        try:
            return self.waiting.popleft()
        except IndexError:
            return None

    def next_result(self, request: _Request) -> tuple[int, Result]:
        """A result of a helper, or else one made here."""
        while True:
            index = self.take() if self.done.empty() else None
            if index is not None:
                return index, request.result(self.scenes[index])
            item = self.done.get()
            if isinstance(item, str):  # a helper ended, and gave back what it had not planned
                warnings.warn(item, RuntimeWarning, stacklevel=3)
                continue
            index, result = item
            if isinstance(result, Plan | OptiPrompError):
                return index, result
            result.add_note(f"while planning scene {index}")
            raise result


@contextlib.contextmanager
def _helpers(request: _Request, work: _Work, count: int) -> Iterator[None]:
    """Helper processes that take from ``work``; none outlives the block, however it is left."""
    if count < 1:
        yield
        return
    try:
        settings = _packed(_Settings(request, dict(os.environ) | dict.fromkeys(THREADS, "1")))
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise InvalidRequestError(
            f"options or demonstrations cannot be sent to other processes ({error}); "
            "workers=1 needs none"
        ) from error
    spawn.get_preparation_data(__name__)  # raises where a helper that starts imports the script
    context = _context()
    helpers = [_Helper(context, settings, work) for _ in range(count)]
    try:
        for helper in helpers:
            helper.start()
        yield
    finally:
        work.waiting.clear()
        for helper in helpers:
            helper.dismiss()
        for helper in helpers:
            helper.gone()


def _context() -> SpawnContext | ForkServerContext:
    """How helpers start: from a server that has imported and compiled all, where there can be one.

    The first call starts it; it ends with the calling process.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__, "optipromp.planning.ready"])
    return context


class _Helper(threading.Thread):
    """A thread that starts a helper process and feeds it while there is something to take."""

    _starting = threading.Lock()  # the environment is one for all

    def __init__(
        self, context: SpawnContext | ForkServerContext, settings: bytes, work: _Work
    ) -> None:
        super().__init__(daemon=True)
        self.context, self.settings, self.work = context, settings, work
        self.process: SpawnProcess | ForkServerProcess | None = None
        self.over = False

    def run(self) -> None:
        here, there = self.context.Pipe()
        process = self.context.Process(target=_serve, args=(there,), daemon=True)
        with self._starting, single_threads(), _uninterrupted():
            if not self.over:
                try:
                    process.start()
                except Exception as error:
                    self.work.done.put((-1, error))
                    self.over = True
                else:
                    self.process = process
        there.close()
        with contextlib.closing(here):
            if not self.over:
                self._attend(here)

    def dismiss(self) -> None:
        """End the process: it holds nothing that the caller still wants."""
        self.over = True
        if self.process is not None:
            self.process.terminate()

    def gone(self) -> None:
        """Wait until thread and process have ended; one that still starts ends by itself."""
        if self.process is not None:
            self.process.join()
            self.join()

    def _attend(self, connection: Connection) -> None:
        work, held = self.work, deque[int]()
        ready, robot = False, None  # the robot: of the last plan
        try:
            connection.send_bytes(self.settings)
            ready = connection.recv()
            while True:
                while len(held) < AHEAD and (index := work.take()) is not None:
                    held.append(index)
                    connection.send_bytes(_packed(work.scenes[index]))
                if not held:
                    return
                result = pickle.loads(connection.recv_bytes())
                if isinstance(result, _Bare):
                    result = result.whole(work.scenes[held[0]], robot)
                    robot = result.robot
                work.done.put((held.popleft(), result))
        except (EOFError, OSError):
            if held:
                message = "the process that planned it ended (out of memory?)"
                work.done.put((held.popleft(), NoPlanError(message)))
            if held or work.waiting:
                work.waiting.extend(held)
                why = "ended early" if ready else "could not start"
                hint = "" if ready else f"; is plan_many called outside `{GUARD}`?"
                work.done.put(f"a helper process {why}{hint}; the others do its work")
        except BaseException as error:  # the caller shall hear of it
            work.done.put((held.popleft() if held else -1, error))


def _serve(connection: Connection) -> None:
    """A helper's life: plan what comes until nothing does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the caller's
    robot: Robot | None = None
    with contextlib.suppress(EOFError, OSError):  # the caller has ended
        settings = pickle.loads(connection.recv_bytes())
        os.environ.update(settings.environment)
        connection.send(True)
        while True:
            content = connection.recv_bytes()
            try:
                scene = pickle.loads(content)
                result = settings.request.result(scene)
                if isinstance(result, Plan):
                    answer, robot = _packed(_bare(result, scene, robot)), result.robot
                else:
                    answer = _packed(result)
            except Exception as error:  # raised again where plan_many was called
                answer = pickle.dumps(error)
            connection.send_bytes(answer)


@dataclass(frozen=True, eq=False)
class _Settings:
    """What a helper must know; the server that it comes from may have started long ago."""

    request: _Request
    environment: Mapping[str, str]


@dataclass(frozen=True, eq=False)
class _Bare:
    """A plan without what the caller has: the scene that it sent, the robot of the plan before."""

    plan: Plan
    scene: Scene | None
    robot: Robot | None

    def whole(self, sent: Scene | str | Path, before: Robot | None) -> Plan:
        scene, robot = self.scene or sent, self.robot or before
        assert isinstance(scene, Scene)
        assert robot is not None
        return replace(self.plan, scene=scene, robot=robot)


def _bare(result: Plan, scene: Scene | str | Path, robot: Robot | None) -> _Bare:
    return _Bare(
        replace(result, scene=None, robot=None),  # type: ignore[arg-type]
        None if result.scene is scene else result.scene,
        None if result.robot is robot else result.robot,
    )


class _Pickler(pickle.Pickler):
    """Arrays that are read-only stay so on the way."""

    def reducer_override(self, item: Any) -> Any:
        if isinstance(item, np.ndarray) and not item.flags.writeable:
            return frozen, (item.copy(), item.dtype)
        return NotImplemented


def _packed(item: object) -> bytes:
    stream = io.BytesIO()
    _Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL).dump(item)
    return stream.getvalue()


@contextlib.contextmanager
def single_threads() -> Iterator[None]:
    """Processes started within use one thread each."""
    before = {name: os.environ.get(name) for name in THREADS}
    os.environ.update(dict.fromkeys(THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextlib.contextmanager
def _uninterrupted() -> Iterator[None]:
    """Processes that this thread starts within hear no Ctrl-C: it is the caller's."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    resource_tracker.ensure_running()  # starting it would let the signal through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
