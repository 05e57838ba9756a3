"""How late this machine wakes up a thread that sleeps to a grid, as every real-time loop does."""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

from firmware_protocol.compiled import new_record
from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import on_compilation
from hapsim.errors import HapsimError, UsageError
from hapsim.loop.clocks import GRID, sleep_on_grid
from hapsim.loop.histogram import Histogram, histogram_of

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult

Tell = Callable[[float, str], None]
"""Called with the time (s) since a measurement began, and the function that is being compiled for it, or ""."""

_LOOK_S = 0.05
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 1e5
_MOST_WAKEUPS = 1e12


def require_measurable(rate_hz: float, seconds: float, named: str = "--rates") -> None:
    """Raises UsageError unless the rate is between 1 Hz and 100 kHz, with at least a period in the time. `named`: where
    the rate stands."""
    if not _SLOWEST_HZ <= rate_hz <= _FASTEST_HZ:
        raise UsageError(f"{named}: found {rate_hz:g} Hz, expected {_SLOWEST_HZ:g} to {_FASTEST_HZ:g} Hz")
    if not 1.0 <= rate_hz * seconds <= _MOST_WAKEUPS:
        raise UsageError(
            f"--seconds: found {seconds:g}, expected at least a period of {rate_hz:g} Hz, "
            f"and at most {_MOST_WAKEUPS / rate_hz:g}"
        )


def wake_up_latency(
    rate_hz: float,
    seconds: float,
    on_progress: Tell = lambda _elapsed, _compiling: None,
    *,
    realtime: bool = False,
    on_grants: Callable[[list[PrivilegeResult]], None] = lambda _grants: None,
) -> Histogram:
    """Returns the wake-up latencies (s) of a thread that sleeps to a grid of `rate_hz` for this many `seconds`.

    It counts `rate_hz * seconds` wake-ups, fewer if some came a whole period late. With `realtime` the thread first
    requests real-time scheduling; `on_grants` gets the result. An exception, such as Ctrl-C, ends it at the next
    wake-up. Raises UsageError as `require_measurable` does.
    """
    require_measurable(rate_hz, seconds)
    grid = new_record(GRID)
    grid.period_ns = round(1e9 / rate_hz)
    with on_compilation(lambda name: on_progress(0.0, name)):
        compile_for(sleep_on_grid, grid)
    failures: list[BaseException] = []

    def work() -> None:
        """In a thread of its own, beside which this one hears Ctrl-C and reports progress."""
        try:
            with _punctual(realtime) as grants:
                on_grants(grants)
                now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
                grid.due_ns = now + int(grid.period_ns)
                grid.end_ns = now + round(rate_hz * seconds) * int(grid.period_ns)
                sleep_on_grid(grid)
        except BaseException as failure:
            failures.append(failure)

    thread = threading.Thread(target=work, name="wake-ups")
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_LOOK_S)
            on_progress(int(grid.wakeups) * int(grid.period_ns) * 1e-9, "")
    finally:
        grid.stop = 1
        thread.join()
    for failure in failures:
        if isinstance(failure, HapsimError):
            raise failure
        raise HapsimError(f"the sleeping thread failed: {failure}") from failure
    return histogram_of(grid.lateness, 1e-9)


@contextlib.contextmanager
def _punctual(realtime: bool) -> Iterator[list[PrivilegeResult]]:
    """While open, this thread wakes up as punctually as it may: at the least without the kernel's slack of 50 µs."""
    from hapsim.loop.realtime import no_timer_slack

    no_timer_slack()
    if not realtime:
        yield []
        return
    from hapsim.loop.realtime import realtime as in_real_time

    with in_real_time(threading.get_native_id()) as grants:
        yield list(grants)
