"""What a wait for a position comes to, and why a loop ends: one set of numbers, each passed on as it is.

Where bytes are read a positive number is their count.
"""

from __future__ import annotations

from hapsim.compiling import inlined

HEARD = 1
"""A position was taken."""
RUNNING = 1
"""Nothing ends the loop yet."""
TIMED_OUT = 0
"""Nothing came, or nothing among the bytes was a position."""
HUNG_UP = -1
"""The other side of the port is gone."""
FAILED = -2
"""The system refused, and a retry will not help."""
DEVICE_STOPPED = -3
"""The device said that it stopped."""
NOT_FINITE = -4
"""The scene's force is not a number."""
WRONG_RATE = -5
"""The device does not sample at the rate that it declares."""
POSITION_LEAPT = -6
"""A position is where no hand can have moved the device."""
ENERGY_EXCEEDED = -7
"""The energy guard tripped: the scene gives the hand more energy than a passive object, or swings at the limit."""
WRONG_SIGN = -8
"""A motor pushes the wrong way."""
OUT_OF_TRAVEL = -9
"""The device is farther outside its travel than the force reaches."""
SILENT = -10
"""The device has sent no position for too long."""
DONE = -11
STOPPED = -12
RING_FULL = -13
"""The reader has to make room. The device stays armed, and the loop is called again."""

IN_WORDS = {
    DONE: "done",
    STOPPED: "stopped",
    SILENT: "device silent",
    HUNG_UP: "device gone",
    NOT_FINITE: "force not finite",
    DEVICE_STOPPED: "device stopped",
    WRONG_RATE: "wrong rate",
    POSITION_LEAPT: "position leapt",
    ENERGY_EXCEEDED: "scene diverging",
    FAILED: "port failed",
    OUT_OF_TRAVEL: "out of travel",
    WRONG_SIGN: "sign wrong",
}
"""The `ending` of a report."""


@inlined
def ending_before_exchange(loop):
    """RUNNING, or why the loop ends before its next exchange: STOPPED, DONE, RING_FULL."""
    if loop.control.stop:
        return STOPPED
    state, control = loop.state, loop.control
    # Samples that passed, answered or lost; where they come too slowly, the time on the host's clock.
    if 0 <= control.samples <= state.ticks + state.lost_frames or state.newest_ns - state.first_ns > control.lasts_ns:
        return DONE
    # With a margin, for positions that arrive several at once.
    ring = loop.ring
    return RING_FULL if ring.waits and ring.head - ring.tail > ring.capacity // 2 else RUNNING


@inlined
def ending_of(code, stop):
    """Why the loop ends after a wait for a position that came to `code`. `stop`: another thread stopped the loop."""
    if code != TIMED_OUT:
        return code
    return STOPPED if stop != 0 else SILENT
