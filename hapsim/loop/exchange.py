"""One exchange: positions in, the scene moved, the guarded force out. Shared by every loop.

No system call is made here: whoever waits (waiting.py in the kernel, portable.py in Python) brings bytes and time.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from firmware_protocol import schema
from firmware_protocol.frames import Format, write_to_device
from hapsim.compiled import inlined, jit_inlined
from hapsim.cordis.program import Program
from hapsim.cordis.tick import settle_grounds, start, tick
from hapsim.loop.codes import BAD_FORCE, FAULT, HEARD, OFF_RATE, TIMED_OUT
from hapsim.loop.guard.finite import is_finite
from hapsim.loop.guard.limit import cut
from hapsim.loop.guard.rate import is_off_rate
from hapsim.loop.histogram import new_histogram, note
from hapsim.loop.inbox import frame_waiting
from hapsim.loop.parameters import Parameters, move_parameters
from hapsim.loop.ring import BRIDGED, HELD, LIMITED, OFF_GRID, UNSENT, Ring, mark_last, publish, push

_MODULUS_MASK = schema.SAMPLE_MODULUS - 1  # it is a power of two

DEVICE_CLOCK, HOST_CLOCK, NO_CLOCK = range(3)  # who keeps the time; nobody in virtual time

CONTROL = np.dtype(
    [
        ("go", np.int64),  # set by another thread once the device is armed
        ("stop", np.int64),  # set by another thread
        ("ticks", np.int64),  # how many to run, negative: until told to stop
        ("period_ns", np.int64),
        ("clock", np.int64),  # DEVICE_CLOCK, HOST_CLOCK, NO_CLOCK
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
        ("fault", np.int64),  # what the device said when it stopped
        ("first_ns", np.int64),  # when the first and the newest position arrived
        ("newest_ns", np.int64),
        ("unanswered", np.int64),  # 1: the newest position's force has not left yet
        ("tick_ns", np.int64),  # when the loop woke up to ask for the next position, where the host is the clock
        ("sent_ns", np.int64),  # when the last force had left
        ("grounds_moved", np.int64),  # with the last sample: with the next their velocity is zero again
        ("due_ns", np.int64),  # when the next position is expected, where the device is the clock
    ],
    align=True,
)


def desk_of(channels: int) -> np.dtype[np.void]:
    """What one exchange is worked out on. One record instead of a dozen arrays: compiled code passes it as one pointer.

    The number of channels is part of its type, so that loops over them are compiled for that number.
    """
    each = (channels,)
    return np.dtype(
        [
            ("measured", np.float64, each),  # m, the newest position
            ("before", np.float64, each),  # m, the one before
            ("bridge", np.float64, each),  # m, between the two where positions were lost
            ("velocity", np.float64, each),  # m/s, sensed with the newest position; 0 where not asked for
            ("velocity_before", np.float64, each),  # m/s, with the one before
            ("velocity_bridge", np.float64, each),  # m/s, between the two where positions were lost
            ("asked", np.float64, each),  # N, the scene's force
            ("position_counts", np.int64, each),
            ("force_counts", np.int64, each),  # what excitation and guards make of it
            ("position_scale", np.float64, each),  # m per count
            ("velocity_scale", np.float64, each),  # (m/s) per count
            ("force_scale", np.float64, each),  # N per count
            ("force_limit", np.float64, each),  # N
            ("scratch", np.int64, (4,)),  # of the system calls
            ("outbox", np.uint8, (128,)),  # the frame that is being written
        ],
        align=True,
    )


class Statistics(NamedTuple):
    """Histograms of every tick (HISTOGRAM of histogram.py)."""

    lateness: np.void
    """ns: of the wake-up, where the host is the clock; of the position, where the device is."""
    exchange: np.void
    """ns: from a position's arrival until its force has left; where the host is the clock, from waking up for the tick
    until the position has arrived, the force sent in between."""
    age: np.void
    """Samples from the position that the acting force answers to the force's change."""


def new_statistics() -> Statistics:
    """Empty histograms."""
    return Statistics(new_histogram(), new_histogram(), new_histogram())


class Loop(NamedTuple):
    """All that an exchange works on. Everything is allocated before the device is armed."""

    port: Any
    inbox: np.void
    decoder: np.void
    wire: Format
    program: Program
    parameters: Parameters
    ring: Ring
    desk: np.void
    control: np.void
    state: np.void
    watch: np.void
    statistics: Statistics


@inlined
def digest(loop, now):
    """Takes every position among the bytes at hand, which arrived at `now` (ns), and works out the force that answers
    the newest: HEARD, or TIMED_OUT, FAULT, BAD_FORCE, OFF_RATE.

    Every position moves the scene by one sample, in order, so that its velocities stay true; only the newest is
    answered.
    """
    heard = TIMED_OUT
    while frame_waiting(loop.inbox, loop.decoder):
        if loop.decoder.type == schema.STATUS:
            loop.state.fault = (loop.decoder.counts[0] >> 8) & 0xFF
            return FAULT
        if not _is_news(loop):
            continue
        if loop.state.unanswered:
            loop.state.stale_positions += 1
            mark_last(loop.ring, UNSENT)
        if not _take_position(loop, now):
            return BAD_FORCE
        if is_off_rate(loop.watch, loop.state.sample, now, loop.control.period_ns):
            return OFF_RATE
        heard = HEARD
    return heard


@inlined
def compose_force(loop):
    """Writes the frame with the force that answers the newest position into the outbox; where it ends."""
    return write_to_device(
        loop.wire,
        loop.desk.outbox,
        0,
        schema.FORCE,
        loop.state.sample & _MODULUS_MASK,
        loop.control.time_to_live,
        loop.desk.force_counts,
    )


@jit_inlined
def compose_disarm(loop):
    """Writes the frame that lets go, with zero force, into the outbox; where it ends. The last frame of every loop,
    whatever ended it."""
    for c in range(loop.desk.measured.size):
        loop.desk.force_counts[c] = 0
    return write_to_device(loop.wire, loop.desk.outbox, 0, schema.DISARM, 0, 0, loop.desk.force_counts)


@jit_inlined
def sent(loop, now):
    """The force has left, at `now` (ns): shows the tick to the reader and counts what it took."""
    if loop.control.clock != HOST_CLOCK:
        note(loop.statistics.exchange, now - loop.state.newest_ns)
    loop.state.sent_ns = now
    loop.state.unanswered = 0
    publish(loop.ring)


@inlined
def never_sent(loop):
    """The loop ends: shows the last tick to the reader, and that its force, if it still waits, never left."""
    if loop.state.unanswered:
        mark_last(loop.ring, UNSENT)
    publish(loop.ring)


@inlined
def _is_news(loop):
    """Whether the decoder holds a position newer than the last. One that comes twice, or after a newer one, is counted
    and passed over: the scene never goes back in time."""
    if loop.decoder.type not in (schema.POSITION, schema.POSITION_HELD):
        return False
    gap = (loop.decoder.number - loop.state.sample) & _MODULUS_MASK
    if loop.state.ticks > 0 and (gap == 0 or gap >= schema.SAMPLE_MODULUS // 2):
        loop.state.stale_positions += 1
        return False
    return True


@inlined
def _take_position(loop, now):
    """The decoder's position moves the scene up to its sample; False where the force came out as no number."""
    state = loop.state
    _read_position(loop)
    if state.ticks == 0:
        start(loop.program, loop.desk.measured)
        state.sample = loop.decoder.number - 1
        state.first_ns = now
        state.due_ns = now
    flags = _count_age(loop, state) | _off_grid(loop.control, state, now)
    gap = (loop.decoder.number - state.sample) & _MODULUS_MASK
    if gap > 1:
        state.lost_frames += gap - 1
        flags |= BRIDGED
    if loop.control.clock == DEVICE_CLOCK:
        _note_lateness(loop, now, gap)
    elif loop.control.clock == HOST_CLOCK and state.ticks > 0:
        note(loop.statistics.exchange, now - state.tick_ns)
    _move_scene(loop, gap)
    state.sample += gap
    state.newest_ns = now
    flags |= _set_force(loop.desk, loop.control, state)
    shown = flags & ~_NOT_A_NUMBER
    push(loop.ring, state.sample, now, shown, loop.desk.position_counts, loop.desk.force_counts, loop.desk.asked)
    state.ticks += 1
    state.unanswered = 1
    return flags & _NOT_A_NUMBER == 0


@inlined
def _read_position(loop):
    """The decoder's position, and its velocity where they are on the wire, in SI units."""
    desk = loop.desk
    for c in range(desk.measured.size):
        desk.position_counts[c] = loop.decoder.counts[c]
        desk.before[c] = desk.measured[c]
        desk.measured[c] = loop.decoder.counts[c] * desk.position_scale[c]
        if loop.wire.velocity:
            desk.velocity_before[c] = desk.velocity[c]
            desk.velocity[c] = loop.decoder.counts[desk.measured.size + c] * desk.velocity_scale[c]


@inlined
def _count_age(loop, state):
    """The device tells with each position whether the force of the sample before came in time."""
    held = loop.decoder.type == schema.POSITION_HELD
    state.late_ticks += held
    state.age = state.age + 1 if held else 1
    note(loop.statistics.age, state.age)
    return HELD if held else 0


@inlined
def _note_lateness(loop, now, gap):
    """How much later a position came than the earliest ones of late, by the device's own count of samples.

    Nobody tells when the device sampled. The grid of expected arrivals moves to every arrival that is earlier, and a
    little, a 16th of the lateness, after every later one, so that it follows a device whose clock is slow.
    """
    state = loop.state
    late = now - state.due_ns
    note(loop.statistics.lateness, late)
    state.due_ns += (late if late < 0 else late >> 4) + gap * loop.control.period_ns


@inlined
def _off_grid(control, state, now):
    """Whether the time from the last position to this one is clearly not a period, where the host keeps the time."""
    if control.clock != HOST_CLOCK or state.ticks == 0:
        return 0
    error = now - state.newest_ns - control.period_ns
    return OFF_GRID if abs(error) > control.period_ns // 8 else 0


@inlined
def _move_scene(loop, samples):
    """Moves the scene by `samples`, its device points along a straight line from the last position to this one, and
    their velocities along one of their own."""
    desk = loop.desk
    for i in range(1, samples + 1):
        position, velocity = desk.measured, desk.velocity
        if i < samples:
            for c in range(desk.measured.size):
                rise, gain = desk.measured[c] - desk.before[c], desk.velocity[c] - desk.velocity_before[c]
                desk.bridge[c] = desk.before[c] + rise * i / samples
                desk.velocity_bridge[c] = desk.velocity_before[c] + gain * i / samples
            position, velocity = desk.bridge, desk.velocity_bridge
        moved = move_parameters(loop.parameters)
        if moved or loop.state.grounds_moved:
            settle_grounds(loop.program)
            loop.state.grounds_moved = moved
        tick(loop.program, position, velocity, desk.asked)


_NOT_A_NUMBER = 128  # in the flags of `_set_force`


_GOLDEN = 0.6180339887498949  # its multiples are spread evenly over every interval


@inlined
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


@inlined
def _set_force(desk, control, state):
    """Adds the excitation, guards the force and turns it into counts. Returns the row's flags for it."""
    push = _push(control, state.ticks) if control.pulse_every > 0 else 0.0
    sound = True
    limited = False
    for c in range(desk.measured.size):
        wanted = desk.asked[c] + push if c == control.pulse_channel else desk.asked[c]
        sound = sound and is_finite(wanted)
        force = cut(wanted, desk.force_limit[c])
        limited = limited or force != wanted
        counts = np.rint(force / desk.force_scale[c])
        desk.force_counts[c] = np.int64(min(max(counts, -2147483647.0), 2147483647.0))
    if not sound:
        for c in range(desk.measured.size):
            desk.force_counts[c] = 0
        return _NOT_A_NUMBER
    state.limited_ticks += limited
    return LIMITED if limited else 0
