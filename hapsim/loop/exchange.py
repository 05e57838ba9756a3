"""One exchange: positions in, the scene moved, the guarded force out. Shared by both clocks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from firmware_protocol import schema
from firmware_protocol.frames import Format, write_to_device
from hapsim.compiled import jit
from hapsim.cordis.program import Program
from hapsim.cordis.tick import start, tick
from hapsim.loop.guard.finite import all_finite
from hapsim.loop.guard.limit import cut
from hapsim.loop.inbox import fetch, frame_waiting
from hapsim.loop.port import send
from hapsim.loop.ring import BRIDGED, HELD, LIMITED, UNSENT, Ring, mark_last, publish, push
from hapsim.loop.system import TIMED_OUT, now_ns

# Why the loop returned.
DONE, STOPPED, RING_FULL, SILENT, GONE, NOT_FINITE, DEVICE_STOPPED = range(7)

HEARD = 1  # a position was taken; beside TIMED_OUT, HUNG_UP and FAILED of system.py
FAULT = -3  # the device said that it stopped
BAD_FORCE = -4  # the scene's force is not a number

CONTROL = np.dtype(
    [
        ("stop", np.int64),  # set by another thread
        ("ticks", np.int64),  # how many to run, negative: until told to stop
        ("period_ns", np.int64),
        ("silence_ns", np.int64),  # a device quiet for longer is gone
        ("time_to_live", np.int64),  # samples that a force may act without being replaced
        ("pulse_ticks", np.int64),  # the excitation lasts this many ticks
        ("pulse", np.float64, schema.MAX_CHANNELS),  # N
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("sample", np.int64),  # number of the newest position, counted from arming
        ("ticks", np.int64),
        ("late_ticks", np.int64),
        ("lost_frames", np.int64),
        ("stale_positions", np.int64),
        ("limited_ticks", np.int64),
        ("age", np.int64),  # samples from the position that the acting force answers to the force's change
        ("max_age", np.int64),
        ("fault", np.int64),  # what the device said when it stopped
        ("first_ns", np.int64),  # when the first and the newest position arrived
        ("newest_ns", np.int64),
        ("lateness_ns", np.int64),  # of the newest wake-up, and the longest, where the host is the clock
        ("max_lateness_ns", np.int64),
    ],
    align=True,
)


class Loop(NamedTuple):
    """All that an exchange works on. Everything is allocated before the device is armed."""

    port: Any
    inbox: np.void
    decoder: np.void
    wire: Format
    program: Program
    measured: NDArray[np.float64]  # (channels,) m, the newest
    before: NDArray[np.float64]  # (channels,) m, the one before
    bridge: NDArray[np.float64]  # (channels,) m, between the two where positions were lost
    asked: NDArray[np.float64]  # (channels,) N, the scene's force
    force: NDArray[np.float64]  # (channels,) N, what is left of it after excitation and guards
    position_counts: NDArray[np.int64]
    force_counts: NDArray[np.int64]
    position_scale: NDArray[np.float64]
    force_scale: NDArray[np.float64]
    force_limit: NDArray[np.float64]
    outbox: NDArray[np.uint8]
    scratch: NDArray[np.int64]
    ring: Ring
    control: np.void
    state: np.void


@jit
def take_newest_position(loop, timeout_ns):
    """Waits for a position, takes all that are there and leaves the force that answers the newest.

    Every position moves the scene by one sample, in order, so that its velocities stay true; only the newest is
    answered. Returns HEARD, or TIMED_OUT, HUNG_UP, FAILED, FAULT, BAD_FORCE.
    """
    give_up = now_ns(loop.scratch) + timeout_ns
    heard = False
    while True:
        while frame_waiting(loop.inbox, loop.decoder):
            if loop.decoder.type == schema.STATUS:
                loop.state.fault = (loop.decoder.counts[0] >> 8) & 0xFF
                return FAULT
            if heard:
                loop.state.stale_positions += 1
                mark_last(loop.ring, UNSENT)
            if not _take_position(loop):
                return BAD_FORCE
            heard = True
        if heard:
            return HEARD
        left = give_up - now_ns(loop.scratch)
        code = fetch(loop.port, loop.inbox, left)
        if code < 0 or (code == 0 and left <= 0):
            return code


@jit
def answer(loop):
    """Sends the force that answers the newest position; then shows the tick to the reader."""
    stop = write_to_device(
        loop.wire,
        loop.outbox,
        0,
        schema.FORCE,
        loop.state.sample % schema.SAMPLE_MODULUS,
        loop.control.time_to_live,
        loop.force_counts,
    )
    code = send(loop.port, loop.outbox, stop)
    publish(loop.ring)
    return code


@jit
def let_go(loop):
    """Zero force, at once: the last frame of every loop, whatever ended it."""
    loop.force_counts[:] = 0
    stop = write_to_device(loop.wire, loop.outbox, 0, schema.DISARM, 0, 0, loop.force_counts)
    send(loop.port, loop.outbox, stop)
    publish(loop.ring)


@jit
def ending_of(code):
    """Why the loop ends, after a wait for a position that ended in `code`."""
    if code == FAULT:
        return DEVICE_STOPPED
    if code == BAD_FORCE:
        return NOT_FINITE
    return SILENT if code == TIMED_OUT else GONE


@jit
def _take_position(loop):
    """The decoder's position moves the scene up to its sample; False where the force came out as no number."""
    state = loop.state
    now = now_ns(loop.scratch)
    for c in range(loop.measured.size):
        loop.position_counts[c] = loop.decoder.counts[c]
        loop.before[c] = loop.measured[c]
        loop.measured[c] = loop.decoder.counts[c] * loop.position_scale[c]
    if state.ticks == 0:
        start(loop.program, loop.measured)
        loop.before[:] = loop.measured
        state.sample = loop.decoder.number - 1
        state.first_ns = now
    flags = _count_age(loop)
    gap = (loop.decoder.number - state.sample) % schema.SAMPLE_MODULUS
    if gap > 1:
        state.lost_frames += gap - 1
        flags |= BRIDGED
    _move_scene(loop, gap)
    state.sample += gap
    state.newest_ns = now
    flags |= _set_force(loop)
    push(loop.ring, state.sample, now, flags, loop.position_counts, loop.force_counts, loop.asked)
    state.ticks += 1
    return flags & _NOT_A_NUMBER == 0


@jit
def _count_age(loop):
    """The device tells with each position whether the force of the sample before came in time."""
    state = loop.state
    if loop.decoder.type == schema.POSITION_HELD:
        state.late_ticks += 1
        state.age += 1
        state.max_age = max(state.max_age, state.age)
        return HELD
    state.age = 1
    state.max_age = max(state.max_age, 1)
    return 0


@jit
def _move_scene(loop, samples):
    """Moves the scene by `samples`, its device points along a straight line from the last position to this one."""
    for i in range(1, samples):
        for c in range(loop.measured.size):
            loop.bridge[c] = loop.before[c] + (loop.measured[c] - loop.before[c]) * i / samples
        tick(loop.program, loop.bridge, loop.asked)
    tick(loop.program, loop.measured, loop.asked)


_NOT_A_NUMBER = 128  # in the flags of `_set_force`


@jit
def _set_force(loop):
    """Adds the excitation, guards the force and turns it into counts. Returns the row's flags for it."""
    excited = loop.state.ticks < loop.control.pulse_ticks
    for c in range(loop.force.size):
        loop.force[c] = loop.asked[c] + (loop.control.pulse[c] if excited else 0.0)
    if not all_finite(loop.force):
        loop.force_counts[:] = 0
        return _NOT_A_NUMBER
    limited = cut(loop.force, loop.force_limit)
    for c in range(loop.force.size):
        counts = np.rint(loop.force[c] / loop.force_scale[c])
        loop.force_counts[c] = np.int64(min(max(counts, -2147483647.0), 2147483647.0))
    loop.state.limited_ticks += 1 if limited else 0
    return LIMITED if limited else 0
