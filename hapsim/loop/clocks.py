"""Clocks that pace a loop: the device, whose positions the loop awaits, or the host, with a grid of its own.

If the host paces, each tick sends the force and thereby requests the next position. A mock in memory that runs in real
time samples in lockstep, when it gets its force, on the host's grid: all that a late wake-up does is to delay it.
"""

from __future__ import annotations

import numpy as np

from hapsim.compiling import entry, inlined
from hapsim.loop.endings import RUNNING, STOPPED, ending_before_exchange
from hapsim.loop.histogram import HISTOGRAM, note
from hapsim.loop.system import SCRATCH, now_ns, sleep_until

SLICE_NS = 100_000_000
"""Longest wait between two checks of `control.stop`."""


@inlined
def next_point(due, now, period):
    """Returns (next point of the grid after `due`, 1 if `due` was missed else 0), in ns. `now`: the wake-up for `due`.

    The grid is absolute, so that lateness does not add up. A wake-up that is a whole period late misses its point, and
    the grid starts anew from there: catching up would be a burst.
    """
    return (due + period, 0) if now < due + period else (now + period, 1)


@inlined
def sleep_to(due, now, control, scratch):
    """Sleeps until `due` (ns), or until another thread stops the loop of this CONTROL. Returns the time."""
    while now < due and not control.stop:
        slice_ends = now + SLICE_NS
        sleep_until(due if due < slice_ends else slice_ends, scratch)
        now = now_ns(scratch)
    return now


@inlined
def plan_by_device(loop):
    """Plans the next wait of a loop that the device paces, in real or virtual time. Returns RUNNING or an ending."""
    loop.wait.begun_ns = loop.state.sent_ns
    loop.wait.for_ns = loop.control.silence_ns
    loop.wait.answers = 1
    return ending_before_exchange(loop)


@inlined
def plan_by_host(loop):
    """Plans the next wait of a loop that the host paces. Returns RUNNING or an ending.

    A tick has two waits. When it is due, the loop answers a position that came after the last tick had ended: otherwise
    every later force would be a sample older than necessary. Then the loop waits for the next position, until the next
    tick is due. The first position comes without a request.
    """
    wait, state, control = loop.wait, loop.state, loop.control
    if state.ticks == 0:
        wait.begun_ns, wait.for_ns, wait.answers = state.sent_ns, control.silence_ns, 0
        return RUNNING
    if wait.answers:
        wait.begun_ns, wait.for_ns, wait.answers = state.sent_ns, wait.due_ns - state.sent_ns, 0
        return RUNNING
    wait.for_ns, wait.answers = 0, 1
    return _sleep_to_tick(loop)


@inlined
def plan_in_memory(loop):
    """Plans the next wait of a loop over a mock in memory, in real time: when the tick is due, the position is there.
    Returns RUNNING or an ending."""
    loop.wait.for_ns, loop.wait.answers = loop.control.silence_ns, 1
    return _sleep_to_tick(loop)


@inlined
def _sleep_to_tick(loop):
    """Sleeps until the next tick is due, where the next wait begins, and counts how late that is. Returns RUNNING or an
    ending."""
    ending = ending_before_exchange(loop)
    if ending != RUNNING:
        return ending
    wait, state, control = loop.wait, loop.state, loop.control
    woken = now_ns(loop.io.scratch)
    if wait.due_ns == 0:
        wait.due_ns = woken + control.period_ns
    woken = sleep_to(wait.due_ns, woken, control, loop.io.scratch)
    if control.stop:
        return STOPPED
    note(loop.histograms.lateness, woken - wait.due_ns)
    wait.begun_ns = woken
    wait.due_ns, missed = next_point(wait.due_ns, woken, control.period_ns)
    state.deadline_misses += missed
    return RUNNING


@inlined
def may_retry(loop):
    """Returns whether the host repeats its request for a position: not after too long a silence of the device."""
    return loop.state.ticks > 0 and loop.state.sent_ns - loop.state.newest_ns < loop.control.silence_ns


GRID = np.dtype(
    [
        ("stop", np.int64),  # set by another thread, read after each wake-up
        ("due_ns", np.int64),  # the next point of the grid
        ("end_ns", np.int64),  # the last one
        ("period_ns", np.int64),
        ("wakeups", np.int64),
        ("restarts", np.int64),  # times that the grid started anew, a whole period late
        ("lateness", HISTOGRAM),  # ns
        SCRATCH,
    ],
    align=True,
)
"""A grid without a loop, for measuring wake-up latency."""


@entry
def sleep_on_grid(grid):
    """Sleeps to every point of a GRID and counts the wake-up latencies, in ns."""
    while grid.due_ns <= grid.end_ns and not grid.stop:
        sleep_until(grid.due_ns, grid.scratch)
        now = now_ns(grid.scratch)
        note(grid.lateness, now - grid.due_ns)
        grid.wakeups += 1
        grid.due_ns, missed = next_point(grid.due_ns, now, grid.period_ns)
        grid.restarts += missed
