"""Work on all cores: a pool of processes, for ``plan_many`` and for studies.

No heavy module is imported here, so that a process sets its number of threads before a library
starts threads. Threads are no alternative: a plan is hundreds of short kernels with Python between
them, so Python's lock makes two threads as slow as one.
"""

import functools
import io
import multiprocessing
import os
import pickle
import signal
import threading
import traceback
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkServerContext, SpawnContext
from multiprocessing.process import BaseProcess
from typing import Any, NoReturn, TypeVar, cast

from optipromp.core.errors import InvalidRequestError

T = TypeVar("T")
THREADS = dict.fromkeys(
    ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS",
     "VECLIB_MAXIMUM_THREADS"), "1",
)  # fmt: skip

_function: Callable[..., Any]  # of the tasks; in a helper process only
_told: list[warnings.WarningMessage] = []  # before the first task; in a helper process only


def cores() -> int:
    """The number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def in_threads(function: Callable[..., T], *columns: Iterable[Any]) -> list[T]:
    """``function`` of each row of ``columns``, in order; for work that releases Python's lock."""
    with ThreadPoolExecutor(cores()) as pool:
        return list(pool.map(function, *columns))


def run_each(
    function: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    done: Callable[[int, Any], None],
    *,
    workers: int,
    prepare: Callable[[], object] | None = None,
) -> None:
    """Call ``function(*task)`` for every task, in helper processes of one thread each.

    Ctrl-C lets the tasks under way finish, hands them to ``done`` and raises KeyboardInterrupt. A
    warning of a task is given in this process, so that it is shown, once, as any other.

    ``function``: can be pickled, and so can its results. ``tasks``: the arguments of each call.
    ``done``: called in this thread with the index and the result of each task, in the order in
    which tasks end. The result is BrokenProcessPool if the process of a task ended twice.
    ``workers``: processes; with one worker or one task, everything is called in this process.
    ``prepare``: called once in every process before its first task.
    """
    if min(workers, len(tasks)) <= 1:
        if prepare is not None and tasks:
            prepare()
        for index, task in enumerate(tasks):
            done(index, function(*task))
        return
    settings = pickled((dict(os.environ), function, prepare))
    lost = _run(settings, tasks, range(len(tasks)), done, min(workers, len(tasks)))
    if lost:
        words = "a helper process ended early; its work is repeated"
        warnings.warn(words, RuntimeWarning, stacklevel=3)
    for index in lost:  # each alone, which shows the task that ends its process
        if _run(settings, tasks, [index], done, 1):
            done(index, BrokenProcessPool("the process of this task ended (out of memory?)"))


def _run(
    settings: bytes,
    tasks: Sequence[tuple[Any, ...]],
    indices: Iterable[int],
    done: Callable[[int, Any], None],
    workers: int,
) -> list[int]:
    """Run tasks in helpers, each of which has a pipe of its own: one that ends breaks no other's.

    Returns the indices of the tasks whose processes ended early.
    """
    queue, under_way, lost = deque(indices), dict[Connection, int](), list[int]()
    helpers = dict[Connection, BaseProcess]()
    given: set[tuple[str, type[Warning]]] = set()  # filters that change forget what they showed

    def deliver(index: int, answer: bytes) -> None:
        result, told, error = pickle.loads(answer)
        if error is not None:
            error.add_note(f"while at task {index}")
            raise error
        for words, category in told:
            if (words, category) not in given:
                given.add((words, category))
                warnings.warn(words, category, stacklevel=4)
        done(index, result)

    def ask(end: Connection) -> None:
        if queue:
            under_way[end] = queue.popleft()
            with suppress(OSError):  # it ended: there is no answer either
                end.send_bytes(pickled(tasks[under_way[end]]))

    def begin() -> None:
        end, theirs = _context().Pipe()
        helper = _context().Process(target=_help, args=(theirs, settings))
        helper.start()
        theirs.close()
        helpers[end] = helper
        ask(end)

    try:
        for _ in range(workers):
            begin()
        while under_way:
            for end in cast(list[Connection], wait(list(under_way))):
                try:
                    answer = end.recv_bytes()
                except (EOFError, OSError):
                    lost.append(under_way.pop(end))
                    if queue:
                        begin()
                    continue
                index = under_way.pop(end)
                ask(end)
                deliver(index, answer)
    except KeyboardInterrupt:
        for end, index in under_way.items():
            with suppress(EOFError, OSError):
                end.send_bytes(b"")  # the last one
                deliver(index, end.recv_bytes())
        raise
    finally:
        for end, helper in helpers.items():
            end.close()
            helper.join()
    return lost


@functools.cache
def _context() -> SpawnContext | ForkServerContext:
    """The way in which processes start: from a server that has loaded and compiled everything, if
    the platform has one. The server is ready on return, and ends with this process."""
    context: SpawnContext | ForkServerContext = multiprocessing.get_context("spawn")
    if "forkserver" in multiprocessing.get_all_start_methods():
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["optipromp.core.ready"])
        resource_tracker.ensure_running()  # starting it later would let the signal through again
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            forkserver.ensure_running()  # it and its processes ignore Ctrl-C
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
    first = context.Process(target=int)
    first.start()
    first.join()
    if first.exitcode:
        raise InvalidRequestError(
            'processes cannot start; a script must call this under `if __name__ == "__main__":`, '
            "and workers=1 needs none"
        )
    return context


def _begin(settings: bytes) -> None:
    """In a helper process: leave Ctrl-C to the caller, end when it ends, and be ready."""
    global _function
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_caller, daemon=True).start()
    os.environ.update(THREADS)
    try:
        environment, _function, prepare = pickle.loads(settings)
        os.environ.update(environment | THREADS)
        with warnings.catch_warnings(record=True) as told:
            if prepare is not None:
                prepare()
        _told.extend(told)
    except Exception as error:  # raised by the first task, which reports it to the caller
        _function = functools.partial(_raise, error)


def _raise(error: Exception, *_: Any) -> NoReturn:
    raise error


def _end_with_caller() -> None:
    caller = multiprocessing.parent_process()
    if caller is not None:
        caller.join()
        os._exit(1)


def _help(end: Connection, settings: bytes) -> None:
    """Answer one task after another, in a helper process, until the caller closes the pipe."""
    _begin(settings)
    with suppress(EOFError, OSError):
        while task := end.recv_bytes():
            end.send_bytes(_call(task))


def _call(task: bytes) -> bytes:
    """What a task came to: its result, warnings and error, pickled."""
    try:
        with warnings.catch_warnings(record=True) as told:
            result = _function(*pickle.loads(task))
        told, _told[:] = [*_told, *told], []
        return pickled((result, [(str(each.message), each.category) for each in told], None))
    except BaseException as error:
        error.add_note(f"in a helper process:\n{traceback.format_exc()}")
        with suppress(Exception):
            pickle.loads(answer := pickled((None, [], error)))
            return answer
        return pickled((None, [], RuntimeError(f"{error!r}, which cannot be handed over")))


def pickled(item: object) -> bytes:
    """``item`` pickled; read-only arrays stay read-only."""
    import copyreg

    import numpy as np

    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=pickle.HIGHEST_PROTOCOL)
    pickler.dispatch_table = copyreg.dispatch_table | {np.ndarray: _reduced}
    pickler.dump(item)
    return stream.getvalue()


def _reduced(array: Any) -> Any:
    if array.flags.writeable:
        return array.__reduce_ex__(pickle.HIGHEST_PROTOCOL)
    from optipromp.core.arrays import frozen

    return frozen, (array.copy(), array.dtype)
