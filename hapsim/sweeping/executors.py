"""Where the batches of a sweep are worked out: here, in processes of this machine, or by the workers of a cluster.

All are executors of `concurrent.futures`, so the sweep has one way through. Threads are none of them: what surrounds
the compiled loop holds the interpreter's lock, and two threads are slower than one.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import Any

from hapsim.errors import UsageError
from hapsim.sweeping.quantities import Task, work

_LOOK_S = 1.0
_REACHED_S = 10.0


class Here(Executor):
    """Works out everything in the calling thread, when it is submitted."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Returns a future that is done."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextlib.contextmanager
def executor_of(jobs: int, scheduler: str | None, task: Task, first: Any) -> Iterator[tuple[Executor, int]]:
    """Yields an executor and how many batches it works out at a time. `first`: a point; every worker works it out once
    before it accepts work, so that nothing is compiled later."""
    if scheduler is not None:
        with _cluster(scheduler, task, first) as found:
            yield found
    elif jobs == 1:
        yield Here(), 1
    else:
        context = multiprocessing.get_context("spawn")
        pool = ProcessPoolExecutor(jobs, context, initializer=_begin, initargs=(os.getpid(), task, first))
        try:
            yield pool, jobs
        finally:
            pool.shutdown(cancel_futures=True)


def _begin(parent: int, task: Task, first: Any) -> None:
    """Readies a process of the pool: it ignores Ctrl-C, which its parent answers, and ends when its parent is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == parent:
            threading.Event().wait(_LOOK_S)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    ready(task, first)


def ready(task: Task, first: Any) -> None:
    """Compiles, or loads, what a point needs: one process of this machine after the other, since two must not write the
    same machine code at a time."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(ImportError, OSError, StopIteration):
            import fcntl

            from firmware_protocol.code_cache import private_roots

            place, flags = next(private_roots())[0] / "sweep.lock", os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW
            descriptor = os.open(place, flags, 0o600)
            stack.callback(os.close, descriptor)
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        work(task, [first])


@contextlib.contextmanager
def _cluster(scheduler: str, task: Task, first: Any) -> Iterator[tuple[Executor, int]]:
    try:
        from distributed import Client, WorkerPlugin
    except ImportError as error:
        raise UsageError("--scheduler: it needs dask.distributed; install hapsim[dask]") from error

    class Ready(WorkerPlugin):
        """Runs on every worker, and on each that joins, before it accepts work."""

        name = "hapsim"

        def setup(self, worker: Any) -> None:  # noqa: ARG002
            ready(task, first)

    try:
        client = Client(scheduler, timeout=_REACHED_S)
    except (OSError, ValueError) as error:
        raise UsageError(f"--scheduler {scheduler}: cannot be reached: {error}") from error
    with client:
        client.register_plugin(Ready())
        yield client.get_executor(pure=False), max(sum(client.nthreads().values()), 1)
