"""Why a loop returned."""

from __future__ import annotations

from hapsim.compiling import inlined
from hapsim.loop.codes import BAD_FORCE, DIVERGED, FAILED, FAULT, LEAPT, OFF_RATE, TIMED_OUT, WRONG_SIGN
from hapsim.loop.codes import OUT_OF_TRAVEL as TOO_FAR_OUT

(
    DONE,
    STOPPED,
    RING_FULL,
    SILENT,
    GONE,
    NOT_FINITE,
    DEVICE_STOPPED,
    WRONG_RATE,
    POSITION_LEAPT,
    DIVERGING,
    PORT_FAILED,
    OUT_OF_TRAVEL,
    SIGN_WRONG,
) = range(13)

GOES_ON = -1
"""Nothing ends it yet."""

IN_WORDS = {
    DONE: "done",
    STOPPED: "stopped",
    SILENT: "device silent",
    GONE: "device gone",
    NOT_FINITE: "force not finite",
    DEVICE_STOPPED: "device stopped",
    WRONG_RATE: "wrong rate",
    POSITION_LEAPT: "position leapt",
    DIVERGING: "scene diverging",
    PORT_FAILED: "port failed",
    OUT_OF_TRAVEL: "out of travel",
    SIGN_WRONG: "sign wrong",
}
"""As a report tells it. RING_FULL is no end: the loop goes on once the reader has made room."""


@inlined
def told_to_end(loop):
    """Why the loop ends before its next exchange: GOES_ON, or STOPPED, DONE, RING_FULL."""
    if loop.control.stop:
        return STOPPED
    state, control = loop.state, loop.control
    # Samples that passed, answered or lost; or where they come too slowly, the time on the host's clock.
    if 0 <= control.samples <= state.ticks + state.lost_frames or state.newest_ns - state.first_ns > control.lasts_ns:
        return DONE
    # With a margin, for positions that arrive several at once.
    ring = loop.ring
    return RING_FULL if ring.waits and ring.head - ring.tail > ring.capacity // 2 else GOES_ON


@inlined
def ending_of(code, stop):
    """Why the loop ends, after a wait for a position that ended in `code`; `stop`: somebody stopped it."""
    if stop != 0 and code == TIMED_OUT:
        return STOPPED
    if code == FAULT:
        return DEVICE_STOPPED
    if code == BAD_FORCE:
        return NOT_FINITE
    if code == OFF_RATE:
        return WRONG_RATE
    if code == LEAPT:
        return POSITION_LEAPT
    if code == DIVERGED:
        return DIVERGING
    if code == TOO_FAR_OUT:
        return OUT_OF_TRAVEL
    if code == WRONG_SIGN:
        return SIGN_WRONG
    if code == FAILED:
        return PORT_FAILED
    return SILENT if code == TIMED_OUT else GONE
