"""How late this machine wakes up a program that sleeps to a grid: what every real-time loop stands on."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from firmware_protocol.compiled import new_record
from hapsim.compiling.kept import compile_for
from hapsim.compiling.progress import on_compilation
from hapsim.errors import HapsimError, UsageError
from hapsim.loop.clocks import GRID, sleep_on_grid
from hapsim.loop.histogram import Histogram, histogram_of

if TYPE_CHECKING:
    from hapsim.loop.realtime import PrivilegeResult

Tell = Callable[[float, str], None]
"""Told how long (s) one measurement runs by now, and the name of a function that is being compiled for it, or ""."""

_LOOK_S = 0.05
_SLOWEST_HZ, _FASTEST_HZ = 1.0, 1e5
_MOST_WAKEUPS = 1e12


def require_measurable(rate_hz: float, seconds: float, named: str = "--rates") -> None:
    """UsageError where no lateness can be measured at this rate for so many `seconds`; `named`: where the rate stands.

    The rate has to be between 1 Hz and 100 kHz, and there has to be one period in the time.
    """
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
    on_progress: Tell | None = None,
    *,
    realtime: bool = False,
    on_grants: Callable[[list[PrivilegeResult]], None] | None = None,
) -> Histogram:
    """The wake-up latencies (s) of a thread that sleeps to a grid of `rate_hz`, for so many `seconds`.

    It counts `rate_hz * seconds` wake-ups, fewer where some came a whole period late. `realtime`: the thread first asks
    for real-time scheduling; `on_grants` gets what it was granted. Interrupted by an exception, as by Ctrl-C, it
    ends at the next wake-up.

    Raises:
        UsageError: as `require_measurable`.
    """
    require_measurable(rate_hz, seconds)
    grid = new_record(GRID)
    grid.period_ns = round(1e9 / rate_hz)
    tell = on_progress or (lambda *_: None)
    with on_compilation(lambda name: tell(0.0, name)):
        compile_for(sleep_on_grid, grid)
    _sleep_in_thread(grid, round(rate_hz * seconds), tell, realtime, on_grants or (lambda _: None))
    return histogram_of(grid.lateness, 1e-9)


def _sleep_in_thread(
    grid: Any,
    count: int,
    tell: Tell,
    realtime: bool,
    on_grants: Callable[[list[PrivilegeResult]], None],
) -> None:
    """Sleeps in a thread of its own, beside which this one hears Ctrl-C and tells how far it is."""
    failures: list[BaseException] = []

    def _work() -> None:
        try:
            with _punctual(realtime) as grants:
                on_grants(grants)
                _lay(grid, count)
                sleep_on_grid(grid)
        except BaseException as failure:
            failures.append(failure)

    thread = threading.Thread(target=_work, name="wake-ups")
    thread.start()
    try:
        while thread.is_alive():
            thread.join(_LOOK_S)
            tell(int(grid.wakeups) * int(grid.period_ns) * 1e-9, "")
    finally:
        grid.stop = 1
        thread.join()
    if failures:
        raise (
            failures[0]
            if isinstance(failures[0], HapsimError)
            else HapsimError(f"the sleeping thread failed: {failures[0]}")
        ) from failures[0]


def _lay(grid: Any, count: int) -> None:
    """A grid of `count` points from now on."""
    import time

    now, period = time.clock_gettime_ns(time.CLOCK_MONOTONIC), int(grid.period_ns)
    grid.due_ns, grid.end_ns = now + period, now + count * period


@contextlib.contextmanager
def _punctual(realtime: bool) -> Iterator[list[PrivilegeResult]]:
    """While open, this thread wakes up as punctually as it may: at the least without the kernel's slack of 50 µs."""
    from hapsim.loop.realtime.scheduling import no_timer_slack

    no_timer_slack()
    if not realtime:
        yield []
        return
    from hapsim.loop.realtime import realtime as in_real_time

    with in_real_time(threading.get_native_id()) as grants:
        yield list(grants)
