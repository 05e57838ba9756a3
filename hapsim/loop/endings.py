"""Codes for the result of a wait and for the end of a loop: one set, passed on unchanged.

A function that reads bytes returns their count as a positive number. Guards have codes of their own, from -20 on
(hapsim.loop.guards).
"""

from __future__ import annotations

from hapsim.compiling import inlined

RECEIVED = 1  # a position was taken
RUNNING = 1  # nothing ends the loop yet
TIMED_OUT = 0  # no bytes came, or no position among them
HUNG_UP = -1  # the other side of the port is gone
FAILED = -2  # the system refused the call, and a retry will not help
DEVICE_STOPPED = -3  # the device reported that it stopped
NOT_FINITE = -4  # the scene's force is not a number
SILENT = -10  # the device has sent no position for too long
DONE = -11
STOPPED = -12
RING_FULL = -13  # the reader must make room; the device stays armed, and the loop is called again
OTHER_PORT = -14  # another port of the scene ended, so this one's force ramped to zero

IN_WORDS = {
    DONE: "done",
    STOPPED: "stopped",
    SILENT: "device silent",
    HUNG_UP: "device gone",
    NOT_FINITE: "force not finite",
    DEVICE_STOPPED: "device stopped",
    OTHER_PORT: "another port ended",
    FAILED: "port failed",
}
"""`ending` of a report by code, if no guard ended the run."""


@inlined
def ending_before_exchange(loop):
    """Returns RUNNING, or the ending before the next exchange: STOPPED, DONE, RING_FULL."""
    if loop.control.stop:
        return STOPPED
    state, control = loop.state, loop.control
    # Samples, answered or lost; if they come too slowly, the time on the host's clock.
    if 0 <= control.samples <= state.ticks + state.lost_frames or state.newest_ns - state.first_ns > control.lasts_ns:
        return DONE
    # Half of the ring is a margin for positions that arrive together.
    ring, sound = loop.ring, loop.sound
    if ring.waits and ring.head - ring.tail > ring.capacity // 2:
        return RING_FULL
    return RING_FULL if sound.waits and sound.pushed - sound.read > sound.capacity // 2 else RUNNING


@inlined
def ending_of(code, stop):
    """Returns the ending after a wait with the result `code`. `stop`: another thread stopped the loop."""
    if code != TIMED_OUT:
        return code
    return STOPPED if stop != 0 else SILENT
