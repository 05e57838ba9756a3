"""One exchange: positions in, the scene moved, the guarded force out. Shared by both clocks."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.frames import Format, write_to_device
from hapsim.compiled import jit
from hapsim.cordis.program import Program
from hapsim.cordis.tick import start, tick
from hapsim.loop.guard.finite import all_finite
from hapsim.loop.guard.limit import cut
from hapsim.loop.inbox import fetch, frame_waiting
from hapsim.loop.port import send
from hapsim.loop.ring import BRIDGED, HELD, LIMITED, OFF_GRID, UNSENT, Ring, mark_last, publish, push
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
        ("host_is_clock", np.int64),
        ("silence_ns", np.int64),  # a device quiet for longer is gone
        ("time_to_live", np.int64),  # samples that a force may act without being replaced
        ("pulse_first", np.int64),  # the excitation: 1 for a push on the first ticks,
        ("pulse_from", np.int64),  # and pushes from this tick on,
        ("pulse_every", np.int64),  # one every so many ticks (0: none),
        ("pulse_ticks", np.int64),  # each this long,
        ("pulse_channel", np.int64),
        ("pulse_force", np.float64),  # N at most, to one side and to the other in turn
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
        ("max_lateness_ns", np.int64),  # of a wake-up, where the host is the clock
    ],
    align=True,
)


_PER_CHANNEL = (schema.MAX_CHANNELS,)

DESK = np.dtype(
    [
        ("channels", np.int64),
        ("measured", np.float64, _PER_CHANNEL),  # m, the newest position
        ("before", np.float64, _PER_CHANNEL),  # m, the one before
        ("bridge", np.float64, _PER_CHANNEL),  # m, between the two where positions were lost
        ("velocity", np.float64, _PER_CHANNEL),  # m/s, sensed with the newest position; 0 where not asked for
        ("velocity_before", np.float64, _PER_CHANNEL),  # m/s, with the one before
        ("velocity_bridge", np.float64, _PER_CHANNEL),  # m/s, between the two where positions were lost
        ("asked", np.float64, _PER_CHANNEL),  # N, the scene's force
        ("force", np.float64, _PER_CHANNEL),  # N, what excitation and guards make of it
        ("position_counts", np.int64, _PER_CHANNEL),
        ("force_counts", np.int64, _PER_CHANNEL),
        ("position_scale", np.float64, _PER_CHANNEL),  # m per count
        ("velocity_scale", np.float64, _PER_CHANNEL),  # (m/s) per count
        ("force_scale", np.float64, _PER_CHANNEL),  # N per count
        ("force_limit", np.float64, _PER_CHANNEL),  # N
        ("scratch", np.int64, (4,)),  # of the system calls
        ("outbox", np.uint8, (128,)),  # the frame that is being written
    ],
    align=True,
)
"""What one exchange is worked out on. One record instead of a dozen arrays: compiled code passes it as one pointer."""


class Loop(NamedTuple):
    """All that an exchange works on. Everything is allocated before the device is armed."""

    port: Any
    inbox: np.void
    decoder: np.void
    wire: Format
    program: Program
    ring: Ring
    desk: np.void
    control: np.void
    state: np.void


@jit
def take_newest_position(loop, timeout_ns):
    """Waits for a position, takes all that are there and leaves the force that answers the newest.

    Every position moves the scene by one sample, in order, so that its velocities stay true; only the newest is
    answered. Returns HEARD, or TIMED_OUT, HUNG_UP, FAILED, FAULT, BAD_FORCE. Bytes without end that are no position
    do not make the wait any longer.
    """
    give_up = now_ns(loop.desk.scratch) + timeout_ns
    heard = False
    last_look = False
    while True:
        while frame_waiting(loop.inbox, loop.decoder):
            if loop.decoder.type == schema.STATUS:
                loop.state.fault = (loop.decoder.counts[0] >> 8) & 0xFF
                return FAULT
            if not _is_news(loop):
                continue
            if heard:
                loop.state.stale_positions += 1
                mark_last(loop.ring, UNSENT)
            if not _take_position(loop):
                return BAD_FORCE
            heard = True
        if heard:
            return HEARD
        if last_look:
            return TIMED_OUT
        left = give_up - now_ns(loop.desk.scratch)
        last_look = left <= 0
        code = fetch(loop.port, loop.inbox, left)
        if code < 0:
            return code


@jit
def answer(loop):
    """Sends the force that answers the newest position; then shows the tick to the reader."""
    stop = write_to_device(
        loop.wire,
        loop.desk.outbox,
        0,
        schema.FORCE,
        loop.state.sample % schema.SAMPLE_MODULUS,
        loop.control.time_to_live,
        loop.desk.force_counts,
    )
    code = send(loop.port, loop.desk.outbox, stop)
    publish(loop.ring)
    return code


@jit
def let_go(loop):
    """Zero force, at once: the last frame of every loop, whatever ended it."""
    for c in range(loop.desk.channels):
        loop.desk.force_counts[c] = 0
    stop = write_to_device(loop.wire, loop.desk.outbox, 0, schema.DISARM, 0, 0, loop.desk.force_counts)
    send(loop.port, loop.desk.outbox, stop)
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
def _is_news(loop):
    """Whether the decoder holds a position newer than the last. One that comes twice, or after a newer one, is counted
    and passed over: the scene never goes back in time."""
    if loop.decoder.type not in (schema.POSITION, schema.POSITION_HELD):
        return False
    gap = (loop.decoder.number - loop.state.sample) % schema.SAMPLE_MODULUS
    if loop.state.ticks > 0 and (gap == 0 or gap >= schema.SAMPLE_MODULUS // 2):
        loop.state.stale_positions += 1
        return False
    return True


@jit
def _take_position(loop):
    """The decoder's position moves the scene up to its sample; False where the force came out as no number."""
    state = loop.state
    now = now_ns(loop.desk.scratch)
    _read_position(loop)
    if state.ticks == 0:
        start(loop.program, loop.desk.measured)
        state.sample = loop.decoder.number - 1
        state.first_ns = now
    flags = _count_age(loop.decoder, state) | _off_grid(loop.control, state, now)
    gap = (loop.decoder.number - state.sample) % schema.SAMPLE_MODULUS
    if gap > 1:
        state.lost_frames += gap - 1
        flags |= BRIDGED
    _move_scene(loop, gap)
    state.sample += gap
    state.newest_ns = now
    flags |= _set_force(loop.desk, loop.control, state)
    shown = flags & ~_NOT_A_NUMBER
    push(loop.ring, state.sample, now, shown, loop.desk.position_counts, loop.desk.force_counts, loop.desk.asked)
    state.ticks += 1
    return flags & _NOT_A_NUMBER == 0


@jit
def _read_position(loop):
    """The decoder's position, and its velocity where they are on the wire, in SI units."""
    desk = loop.desk
    for c in range(desk.channels):
        desk.position_counts[c] = loop.decoder.counts[c]
        desk.before[c] = desk.measured[c]
        desk.measured[c] = loop.decoder.counts[c] * desk.position_scale[c]
        if loop.wire.velocity:
            desk.velocity_before[c] = desk.velocity[c]
            desk.velocity[c] = loop.decoder.counts[desk.channels + c] * desk.velocity_scale[c]


@jit
def _count_age(decoder, state):
    """The device tells with each position whether the force of the sample before came in time."""
    if decoder.type == schema.POSITION_HELD:
        state.late_ticks += 1
        state.age += 1
        state.max_age = max(state.max_age, state.age)
        return HELD
    state.age = 1
    state.max_age = max(state.max_age, 1)
    return 0


@jit
def _off_grid(control, state, now):
    """Whether the time from the last position to this one is clearly not a period, where the host keeps the time."""
    if not control.host_is_clock or state.ticks == 0:
        return 0
    error = now - state.newest_ns - control.period_ns
    return OFF_GRID if abs(error) > control.period_ns // 8 else 0


@jit
def _move_scene(loop, samples):
    """Moves the scene by `samples`, its device points along a straight line from the last position to this one, and
    their velocities along one of their own."""
    desk = loop.desk
    for i in range(1, samples):
        for c in range(desk.channels):
            desk.bridge[c] = desk.before[c] + (desk.measured[c] - desk.before[c]) * i / samples
            rise = desk.velocity[c] - desk.velocity_before[c]
            desk.velocity_bridge[c] = desk.velocity_before[c] + rise * i / samples
        tick(loop.program, desk.bridge, desk.velocity_bridge, desk.asked)
    tick(loop.program, desk.measured, desk.velocity, desk.asked)


_NOT_A_NUMBER = 128  # in the flags of `_set_force`


_GOLDEN = 0.6180339887498949  # its multiples are spread evenly over every interval


@jit
def _push(control, tick):
    """The excitation's force at this tick, in N: no two pushes alike, so that no two ring-downs are rounded alike."""
    if control.pulse_first and tick < control.pulse_ticks:
        return control.pulse_force
    since = tick - control.pulse_from
    if since < 0 or since % control.pulse_every >= control.pulse_ticks:
        return 0.0
    count = since // control.pulse_every
    force = control.pulse_force * (1.0 - 0.5 * ((count * _GOLDEN) % 1.0))
    return -force if count & 1 else force


@jit
def _set_force(desk, control, state):
    """Adds the excitation, guards the force and turns it into counts. Returns the row's flags for it."""
    for c in range(desk.channels):
        desk.force[c] = desk.asked[c]
    if control.pulse_every > 0:
        desk.force[control.pulse_channel] += _push(control, state.ticks)
    if not all_finite(desk.force):
        for c in range(desk.channels):
            desk.force_counts[c] = 0
        return _NOT_A_NUMBER
    limited = cut(desk.force, desk.force_limit)
    for c in range(desk.channels):
        counts = np.rint(desk.force[c] / desk.force_scale[c])
        desk.force_counts[c] = np.int64(min(max(counts, -2147483647.0), 2147483647.0))
    state.limited_ticks += 1 if limited else 0
    return LIMITED if limited else 0
