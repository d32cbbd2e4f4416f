"""Work of studies on this machine's cores, or on a Ray cluster (https://docs.ray.io).

Tasks are names and seeds, so little travels. Every machine of the cluster has this library
installed, in the same version. A task whose worker dies is done again elsewhere.
"""

import os
import pickle
import socket
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures.process import BrokenProcessPool
from typing import Any

from optipromp.core.errors import InvalidRequestError, installed_by
from optipromp.core.processes import THREADS, cores, pickled, run_each
from optipromp_bench.experiments.rows import Row

Progress = Callable[[int, int, Row | None], None]
"""Number of rows that are there, of all, and the newest; None at the beginning."""
RETRIES = 3  # of a task whose worker died: a choice
PATIENCE = 5.0  # [s] for which an address may not answer: a choice
AHEAD = 2  # tasks that wait at every core of the cluster: a choice
_prepared: set[bytes] = set()  # in a worker of Ray: what was prepared there


def over(
    function: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    done: Callable[[int, Any], None],
    *,
    workers: int | None = None,
    ray: str | None = None,
    prepare: Callable[[], object] | None = None,
) -> None:
    """Call ``function(*task)`` for every task; see :func:`optipromp.core.processes.run_each`.

    ``function``: can be pickled, and so can its results. ``tasks``: the arguments of each call.
    ``done``: called here with the index and the result of each task, in the order in which tasks
    end. The result is BrokenProcessPool if the process of a task ended again and again.
    ``workers``: processes of this machine; None: one a core. ``ray``: address of a Ray cluster in
    place of them: ``auto``, ``HOST:PORT``, or ``local``, which begins one here. ``prepare``: called
    once in every process before its first task.
    """
    if ray is None:
        run_each(function, tasks, done, workers=workers or cores(), prepare=prepare)
    elif tasks:
        _on_ray(function, tasks, done, ray, prepare)


def gathered(
    function: Callable[..., Any], tasks: Sequence[tuple[Any, ...]],
    hear: Callable[[int, Any], Iterable[Row]], done: int, total: int, *,
    progress: Progress | None = None, workers: int | None = None, ray: str | None = None,
    prepare: Callable[[], object] | None = None,
) -> None:  # fmt: skip
    """Call ``function(*task)`` for every task as :func:`over` does, and say how far it is.

    ``hear``: makes new rows of the index and the result of a task. ``done``, ``total``: numbers of
    rows that are there before, and of all. ``progress``: called with both and the newest row.
    """
    tell = progress or (lambda *_: None)
    tell(done, total, None)

    def heard(index: int, result: Any) -> None:
        nonlocal done
        if isinstance(result, BrokenProcessPool):
            raise InvalidRequestError(f"{result}; begin again to go on")
        for row in hear(index, result):
            done += 1
            tell(done, total, row)

    over(function, tasks, heard, workers=workers, ray=ray, prepare=prepare)


def _on_ray(
    function: Callable[..., Any],
    tasks: Sequence[tuple[Any, ...]],
    done: Callable[[int, Any], None],
    address: str,
    prepare: Callable[[], object] | None,
) -> None:
    try:
        import ray
    except ImportError:
        raise InvalidRequestError(
            f"--ray needs Ray: {installed_by('optipromp-bench[ray]')}"
        ) from None
    cluster: Any = ray  # its functions have no types
    mine = not cluster.is_initialized()
    if mine:
        try:
            if ":" in address:
                host, _, port = address.rpartition(":")
                socket.create_connection((host.removeprefix("ray://"), int(port)), PATIENCE).close()
            given = {"address": None if address == "local" else address}
            cluster.init(**given, log_to_driver=False, logging_level="ERROR")
        except (ConnectionError, ValueError, RuntimeError, OSError) as error:
            raise InvalidRequestError(
                f"no Ray cluster answers at {address!r} ({error}): begin one by 'ray start "
                "--head', join it by 'ray start --address HOST:PORT', or say --ray local"
            ) from None
    try:
        remote = cluster.remote(max_retries=RETRIES, num_cpus=1)(_call)
        held = cluster.put(pickled((function, prepare)))
        most = AHEAD * max(int(cluster.cluster_resources().get("CPU", 1)), 1)
        queue, under_way = deque(range(len(tasks))), dict[Any, int]()
        try:
            while queue or under_way:
                while queue and len(under_way) < most:
                    index = queue.popleft()
                    under_way[remote.remote(held, pickled(tasks[index]))] = index
                _deliver(cluster, under_way, done)
        except KeyboardInterrupt:
            while under_way:
                _deliver(cluster, under_way, done)
            raise
    finally:
        if mine:
            cluster.shutdown()


def _deliver(ray: Any, under_way: dict[Any, int], done: Callable[[int, Any], None]) -> None:
    """Hand over the result of the next task that ends."""
    (ready, *_), _ = ray.wait(list(under_way), num_returns=1)
    index = under_way.pop(ready)
    try:
        result = pickle.loads(ray.get(ready))
    except ray.exceptions.RayTaskError as error:
        cause = error.cause if isinstance(error.cause, Exception) else error
        cause.add_note(f"while at task {index}")
        raise cause from None
    except ray.exceptions.RayError as error:
        words = f"the process of task {index} ended {RETRIES + 1} times ({type(error).__name__})"
        result = BrokenProcessPool(words)
    done(index, result)


def _call(held: bytes, task: bytes) -> bytes:
    """In a worker of Ray: be ready, and do a task."""
    os.environ.update(THREADS)
    function, prepare = pickle.loads(held)
    if held not in _prepared:
        _prepared.add(held)
        if prepare is not None:
            prepare()
    return pickled(function(*pickle.loads(task)))
