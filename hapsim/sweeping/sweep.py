"""sweep: evaluates a scene at every point of a grid, of random samples or of a table, as one xarray Dataset.

Batches of about a tenth of a second go to an executor: this thread, processes of this machine, or the workers of a
cluster. All are executors of `concurrent.futures`, so the sweep needs one code path. Threads are not offered: the code
around the compiled loop holds the interpreter's lock, so two threads are slower than one. Each finished batch is kept
(`parts.py`), so a killed sweep resumes with the missing points. The Dataset is assembled at the end.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hapsim.errors import UsageError
from hapsim.measuring.measurement_options import require_above_zero, require_device_point
from hapsim.prediction.predict import prediction_of
from hapsim.prediction.prediction import Place
from hapsim.running.recorded_run import versions_of_now
from hapsim.scene import Scene
from hapsim.scene.load import SceneSource, as_scene
from hapsim.scene.section import Table
from hapsim.scene.varied import Varied
from hapsim.sweeping.parts import Parts
from hapsim.sweeping.quantities import ERROR, FREQUENCY, KINDS, Task, frequencies, kinds_of, work
from hapsim.sweeping.sweep_points import Points, grid, in_si, listed, require_values
from hapsim.whole_file import file_for_hdf5

if TYPE_CHECKING:
    import xarray

_MOST_ON_WINDOWS = 61  # processes that its system call waits for
_REACHED_S = 10.0


class Here(Executor):
    """An executor that runs each call in the calling thread, at submission."""

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Calls `fn` and returns a finished future."""
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


@contextlib.contextmanager
def executor_of(jobs: int, scheduler: str | None, task: Task, first: Any) -> Iterator[tuple[Executor, int]]:
    """Yields an executor and the number of batches that it runs at a time. `first`: a point. Every worker computes it
    once before it accepts work, so that nothing is compiled later."""
    if scheduler is not None:
        with _cluster(scheduler, task, first) as found:
            yield found
    elif jobs == 1:
        yield Here(), 1
    else:
        context = multiprocessing.get_context("spawn")
        jobs = min(jobs, _MOST_ON_WINDOWS) if sys.platform == "win32" else jobs
        pool = ProcessPoolExecutor(jobs, context, initializer=_begin, initargs=(context.Lock(), task, first))
        try:
            yield pool, jobs
        finally:
            pool.shutdown(cancel_futures=True)


def _begin(turn: Any, task: Task, first: Any) -> None:
    """Prepares a process of the pool: it ignores Ctrl-C, which its parent handles, and ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        """Ends this process with its parent."""
        parent = multiprocessing.parent_process()
        assert parent is not None
        parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    with turn:
        ready(task, first)


def ready(task: Task, first: Any) -> None:
    """Compiles or loads the code that a point needs. The processes of this machine take turns, because two must not
    write the same machine code at a time."""
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
        """A plugin that prepares every worker, also one that joins later, before it accepts work."""

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


ENDINGS = (".nc", ".zarr")
_BATCH_S = 0.1
_WAITING = 2  # batches in the queue per worker
_LONG_S = 10.0  # a longer sweep is worth starting processes
_PILOTS = 3  # points from which the time per point is estimated


def sweep(
    scene: SceneSource,
    points: Points | Mapping[str, Any] | Sequence[Mapping[str, Any]],
    *,
    out: str | Path | None = None,
    quantities: tuple[str, ...] = ("predicted", "measured"),
    function: Callable[[Scene], Mapping[str, float]] | None = None,
    channel: int | None = None,
    at: Place = None,
    duration: float | None = None,
    jobs: int | None = 1,
    scheduler: str | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _all: None,
) -> xarray.Dataset:
    """Computes every point of a sweep on the mock, in virtual time, and returns the results.

    Args:
        scene: a Scene, or the path of a scene file. Its clock and port are ignored.
        points: the values of each parameter by path, `{"touch.stiffness": [500, 1000], "device.delay": [0, 1]}`, which
            make a grid; or a list of points, such as `{"touch.stiffness": 500, "device.delay": 1}`.
        out: the .nc or .zarr to write. Until it is complete, OUT.parts holds the finished points, and the same call
            resumes with the missing ones.
        quantities: "predicted", "measured" (k and b), "impedance"; none for `function` alone.
        function: returns further numbers of a scene by name. Several jobs need a function of a module.
        channel: the hand's channel [default: the first].
        at: the hand's position in m or rad, as of `predict` and `measure`; with space: 2, x and y.
        duration: duration of each measurement, s.
        jobs: number of processes; None: all processors if the sweep takes longer than some seconds. A script that uses
            several processes must keep its own work below `if __name__ == "__main__"`.
        scheduler: address of a dask.distributed scheduler; its workers compute the points instead.
        on_progress: called with the number of finished points and of all points.

    A value that fails or does not exist is NaN, with the reason in the variable `error`. A dimension is named by its
    path; samples and tables have one, `point`. If `out` holds this sweep, complete, it is read. Raises UsageError for a
    sweep that is not possible, and if `out` holds anything else.
    """
    try:
        import h5netcdf  # noqa: F401
        import xarray  # noqa: F401
    except ImportError as error:
        raise UsageError(f"a sweep needs xarray and h5netcdf ({error}); install hapsim[sweep]") from error
    scene = as_scene(scene)
    if not isinstance(points, Points):
        points = grid(points) if isinstance(points, Mapping) else listed(points)
    task, points = _task(scene, points, quantities, channel, at, duration, function)
    if jobs is not None and jobs < 1:
        raise UsageError(f"jobs: found {jobs}, expected 1 or more")
    with contextlib.ExitStack() as stack:
        if out is None:
            out = Path(stack.enter_context(tempfile.TemporaryDirectory()), "sweep.nc")
        out = Path(out)
        if out.suffix not in ENDINGS:
            raise UsageError(f"{out}: found the ending '{out.suffix}', expected {' or '.join(ENDINGS)}")
        return _run(task, points, out, jobs, scheduler, on_progress)


def _task(
    scene: Scene,
    points: Points,
    quantities: tuple[str, ...],
    channel: int | None,
    at: Place,
    duration: float | None,
    function: Callable[[Scene], Mapping[str, float]] | None,
) -> tuple[Task, Points]:
    """Returns the task of each point, and the points in SI units. Raises UsageError if it is not possible at any."""
    if not quantities and function is None:
        raise UsageError("quantities: found none, expected some, or a function")
    if unknown := [one for one in quantities if one not in KINDS]:
        raise UsageError(f"quantities: found '{unknown[0]}', expected {', '.join(KINDS)}")
    if "impedance" in quantities and "rate" in points.columns:
        raise UsageError("rate: impedances at several rates have no frequencies in common: sweep each rate by itself")
    require_above_zero("seconds", duration=duration)
    scene, fixed = _in_virtual_time(scene)
    varied = Varied(scene, without=fixed)
    varied.require(points.columns)
    points = in_si(points, varied)
    require_values(points, varied)
    first = next(iter(scene.device_points.values()), None)
    if channel is None and first is not None:
        channel = first.channel
    if scene.ports:
        _require_one_device(scene, quantities, at)
    else:
        require_device_point(scene, 0 if channel is None else channel)
    if at is not None and "impedance" in quantities:
        raise UsageError("at: an impedance is measured where the hand is; omit the place")
    if at is not None and scene.space > 1 and (channel or 0) not in scene.channel_groups[0]:
        raise UsageError(f"at: found channel {channel}; the place is that of the first hand, on another channel")
    if at is not None and not any(path.startswith("device.travel") for path in points.columns):
        prediction_of(scene, at)  # raises beyond the travel
    return Task(varied.document, tuple(quantities), channel or 0, at, duration, function), points


def _in_virtual_time(scene: Scene) -> tuple[Scene, list[str]]:
    """Returns the scene on mocks in virtual time, and the paths that are fixed by that."""
    kept = {"clock": "lockstep", "port": None}
    if not scene.ports:
        return scene.model_copy(update={"device": scene.device.model_copy(update=kept)}), [
            f"device.{one}" for one in kept
        ]
    devices = {name: one.model_copy(update=kept) for name, one in scene.devices.items()}
    fixed = [f"{above}{name}.{one}" for above in ("", "devices.") for name in devices for one in kept]
    return scene.model_copy(update={"devices": Table(devices)}), fixed


def _require_one_device(scene: Scene, quantities: Sequence[str], at: Place) -> None:
    """Raises UsageError for what is swept of one device alone."""
    first = scene.ports[0]
    name = f"name one, such as --device {first}: device.delay is then the name of {first}.delay"
    if others := [one for one in quantities if one != "predicted"]:
        raise UsageError(f"quantities: found {others[0]} of several devices, expected predicted (--check); or {name}")
    if at is not None:
        raise UsageError(f"at: found a place of several devices, expected none; or {name}")


def _run(
    task: Task,
    points: Points,
    out: Path,
    jobs: int | None,
    scheduler: str | None,
    on_progress: Callable[[int, int], None],
) -> xarray.Dataset:
    if (before := _finished_before(task, points, out)) is not None:
        on_progress(len(points), len(points))
        return before
    parts = Parts(out, _manifest(task, points))
    try:
        missing, count = parts.missing(len(points)), len(points)
        on_progress(count - missing.size, count)
        done = count - missing.size
        for numbers, columns in _finished(task, points, missing, jobs, scheduler):
            parts.add(numbers, columns)
            done += numbers.size
            on_progress(done, count)
        dataset = dataset_of(task, points, parts)
        write(dataset, out)
    except BaseException:
        parts.close()
        raise
    parts.remove()
    return dataset


def _finished_before(task: Task, points: Points, out: Path) -> xarray.Dataset | None:
    """Returns the results in `out` if they are those of this sweep, else None."""
    import xarray

    if not out.exists():
        return None
    try:
        if out.suffix == ".zarr":
            found = xarray.open_zarr(out, consolidated=False).load()
        else:
            found = xarray.load_dataset(out, engine="h5netcdf")
    except (OSError, ValueError):
        return None
    is_same = found.attrs == _attributes(task, points) and all(
        path in found.coords and np.array_equal(found[path].values, np.array(values[1]))
        for path, values in _coordinates(points).items()
    )
    return found if is_same else None


def _finished(
    task: Task, points: Points, missing: NDArray[np.int64], jobs: int | None, scheduler: str | None
) -> Iterator[tuple[NDArray[np.int64], dict[str, NDArray[Any]]]]:
    """Yields the numbers and the results of each batch when it is done."""
    if not missing.size:
        return
    pilots, rest = missing[:_PILOTS], missing[_PILOTS:]
    yield pilots, work(task, [points[i] for i in pilots])  # the first run compiles
    if not rest.size:
        return
    begun = time.perf_counter()
    work(task, [points[i] for i in pilots])
    each_s = (time.perf_counter() - begun) / pilots.size
    if jobs is None:
        jobs = (os.cpu_count() or 1) if each_s * rest.size > _LONG_S else 1
    with executor_of(jobs, scheduler, task, points[int(pilots[0])]) as (executor, at_once):
        size = max(1, min(round(_BATCH_S / each_s), rest.size // (4 * at_once)))  # all end at about the same time
        batches = iter([rest[at : at + size] for at in range(0, rest.size, size)])
        under_way: dict[Future[Any], NDArray[np.int64]] = {}
        while True:
            while len(under_way) < _WAITING * at_once and (batch := next(batches, None)) is not None:
                under_way[executor.submit(work, task, [points[i] for i in batch])] = batch
            if not under_way:
                return
            finished, _ = wait(under_way, return_when=FIRST_COMPLETED)
            for future in finished:
                yield under_way.pop(future), future.result()


def _manifest(task: Task, points: Points) -> dict[str, Any]:
    """Returns the description of a sweep. A sweep can be resumed only with the same one."""
    columns = hashlib.sha256(json.dumps(points.columns).encode()).hexdigest()
    function = task.function
    return {
        "scene": task.document,
        "points": {"sizes": points.sizes, "sha256": columns},
        "quantities": list(task.kinds),
        "channel": task.channel,
        "at": task.place,
        "duration": task.duration,
        "function": function and getattr(function, "__qualname__", repr(function)),
        "versions": versions_of_now(),
    }


def dataset_of(task: Task, points: Points, parts: Parts) -> xarray.Dataset:
    """Returns the results as a Dataset, with units and descriptions."""
    import xarray

    scene = Scene.model_validate(task.document)
    variables = {name: one for kind in task.kinds for name, one in kinds_of(scene)[kind].items()}
    columns = parts.together(len(points), variables)
    shape, varied = tuple(points.sizes.values()), Varied(scene)
    units = (scene.units if scene.ports else scene.units_of(task.channel)).si
    coordinates = {path: (*one, {"units": varied.unit(path)}) for path, one in _coordinates(points).items()}
    found: dict[str, Any] = {}
    for name, column in columns.items():
        about = {}
        if name in variables:
            about = {"units": units.name(variables[name].unit), "description": variables[name].description}
        dimensions = (*points.sizes, FREQUENCY)[: len(shape) + column.ndim - 1]
        found[name] = dimensions, column.reshape(*shape, *column.shape[1:]), about
    if "impedance" in task.kinds:
        coordinates[FREQUENCY] = FREQUENCY, frequencies(task), {"units": "Hz"}
    found[ERROR][2]["description"] = "why a value is missing, empty where none is"
    return xarray.Dataset(found, coordinates, _attributes(task, points))


def _coordinates(points: Points) -> dict[str, Any]:
    """Returns the parameters as xarray expects them: the dimensions and values of each."""
    if points.is_grid:
        return {path: ((path,), points.axis(path)) for path in points.columns}
    return {path: (tuple(points.sizes), values) for path, values in points.columns.items()}


def _attributes(task: Task, points: Points) -> dict[str, str]:
    described = {key: json.dumps(value) for key, value in _manifest(task, points).items() if key != "points"}
    return {"title": "hapsim sweep", **described}


def write(dataset: xarray.Dataset, out: Path) -> None:
    """Writes a Dataset, completely or not at all. Raises UsageError if it cannot be written."""
    unfinished = out.with_name(f"{out.name}.parts") / f"{os.urandom(8).hex()}{out.suffix}"
    try:
        if out.suffix == ".zarr":
            dataset.to_zarr(unfinished, mode="w", consolidated=False)
        else:
            with file_for_hdf5(unfinished) as place:
                dataset.to_netcdf(place, engine="h5netcdf")
        unfinished.replace(out)
    except OSError as error:
        raise UsageError(
            f"{out}: cannot be written: {error.strerror or error}. The results are in {unfinished.parent}"
        ) from error
