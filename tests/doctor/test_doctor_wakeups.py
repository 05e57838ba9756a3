"""The sleeper keeps its books; how punctual this machine is, no test asks."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from firmware_protocol.compiled import new_record
from hapsim.doctor.exchanges import wake_up_latency
from hapsim.errors import UsageError
from hapsim.loop.clocks import GRID, sleep_on_grid
from hapsim.loop.histogram import histogram_of

SECOND = 1_000_000_000


def grid(**values: int) -> Any:
    record = new_record(GRID)
    for name, value in values.items():
        record[name] = value
    return record


def test_deadline_long_past_is_counted_and_starts_the_grid_anew() -> None:
    now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    made = grid(due_ns=now - SECOND, end_ns=now - 1, period_ns=1000)
    sleep_on_grid(made)
    assert made.wakeups == made.restarts == 1  # and not the million that were missed
    assert made.due_ns >= now + 1000
    assert histogram_of(made.lateness, 1e-9).maximum >= 1.0


def test_every_point_of_a_grid_has_a_wake_up_or_was_missed() -> None:
    over = grid(due_ns=2, end_ns=1, period_ns=1)
    sleep_on_grid(over)
    assert over.wakeups == 0
    now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    period = SECOND // 2000
    made = grid(due_ns=now + period, end_ns=now + 40 * period, period_ns=period)
    sleep_on_grid(made)
    assert histogram_of(made.lateness).total == made.wakeups
    assert made.wakeups == 40 if made.restarts == 0 else made.wakeups < 40
    assert made.due_ns > made.end_ns


def test_stops_at_the_wake_up_after_it_is_asked_to() -> None:
    now = time.clock_gettime_ns(time.CLOCK_MONOTONIC)
    made = grid(due_ns=now, end_ns=now + 3600 * SECOND, period_ns=SECOND // 1000)
    thread = threading.Thread(target=sleep_on_grid, args=(made,), daemon=True)
    thread.start()
    while made.wakeups == 0:
        time.sleep(0.001)
    made.stop = 1
    thread.join(60.0)
    assert not thread.is_alive()
    assert histogram_of(made.lateness).total == made.wakeups


def test_as_many_wake_ups_as_rate_and_time_make_or_fewer() -> None:
    told: list[tuple[float, str]] = []
    lateness = wake_up_latency(500.0, 0.1, lambda elapsed, compiling: told.append((elapsed, compiling)))
    assert 1 <= lateness.total <= 50
    assert lateness.unit == 1e-9
    assert told


def test_an_interruption_ends_the_thread() -> None:
    def interrupt(elapsed: float, compiling: str) -> None:
        if not compiling and elapsed > 0.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        wake_up_latency(1000.0, 3600.0, interrupt)
    assert not [thread for thread in threading.enumerate() if thread.name == "wake-ups"]


def test_what_was_granted_is_reported_before_the_first_wake_up() -> None:
    granted: list[Any] = []
    wake_up_latency(1000.0, 0.01, realtime=True, on_grants=granted.append)
    assert len(granted) == 1
    assert {"SCHED_FIFO", "memory locked"} <= {grant.privilege for grant in granted[0]}


@pytest.mark.parametrize(
    ("rate", "seconds", "found"),
    [
        (0.5, 10.0, "--rates: found 0.5 Hz, expected 1 to 100000 Hz"),
        (2e5, 1.0, "found 200000 Hz"),
        (float("nan"), 1.0, "found nan Hz"),
        (1000.0, 1e-4, "--seconds: found 0.0001, expected at least a period of 1000 Hz"),
        (1000.0, float("inf"), "found inf"),
        (1000.0, float("nan"), "found nan"),
    ],
)
def test_rates_and_times_that_cannot_be_measured_are_refused(rate: float, seconds: float, found: str) -> None:
    with pytest.raises(UsageError, match=found):
        wake_up_latency(rate, seconds)
