"""One exchange: takes positions, moves the scene, returns the guarded force. Shared by every loop.

It makes no system call: the caller (compiled_loop.py in the kernel, portable.py in Python) supplies bytes and time.

**No force is sent that answers a position older than a force may live.** A force acts for its time to live and one
sample more. Then the device makes it zero and takes no older one (PROTOCOL.md, section 6). In two cases the host has to
send zero in place of a force:

* The host paces: the device would accept the next force as in time, however long the host took. So zero is sent while
  the device still accepts an answer to that position; it also requests the next one.
* A buffer delayed the position for longer than that. The position moves the scene, but its force comes too late.
"""

from __future__ import annotations

import math

import numpy as np

from firmware_protocol import schema
from firmware_protocol.frames import FRAMING, write_frame
from hapsim.compiling import inlined
from hapsim.compiling.native import array_at
from hapsim.cordis.stored_energy import TANK
from hapsim.cordis.substep_loop import SCENE_SLOT, move_scene
from hapsim.cordis.tick import program_at, start, stored_energy
from hapsim.loop import endings, ring
from hapsim.loop.board_law import BOARD_LAW, NUMBERS
from hapsim.loop.buffers import IO_BUFFER, clip, next_place
from hapsim.loop.counts import words_at
from hapsim.loop.force_history import FORCE_HISTORY, IN_ALL
from hapsim.loop.guards import GUARDS
from hapsim.loop.guards.slew import leave_zero
from hapsim.loop.guide import GUIDE
from hapsim.loop.histogram import HISTOGRAM, note
from hapsim.loop.hooks import HOOKS, TICK, call_hooks
from hapsim.loop.output_words import WORDS_STATE
from hapsim.loop.posted import POSTED, note_taken, take_posted
from hapsim.loop.predictor import PREDICTOR
from hapsim.loop.pulse import PULSES
from hapsim.loop.ring import RING, mark_last, publish, push, withhold_last
from hapsim.loop.simulated_mass import ADMITTANCE
from hapsim.loop.sound import SOUND_RING
from hapsim.loop.sound import publish as publish_sound

_MODULUS_MASK = schema.SAMPLE_MODULUS - 1  # it is a power of two

DEVICE_CLOCK, HOST_CLOCK, NO_CLOCK, MEMORY_CLOCK = range(4)
"""Clocks of a loop: the device, the host, none in virtual time, or the host for a mock in memory."""

CONTROL = np.dtype(
    [
        ("go", np.int64),  # set by another thread once the device is armed
        ("stop", np.int64),  # set by another thread
        ("samples", np.int64),  # how many to run, lost ones included; negative: no limit
        ("lasts_ns", np.int64),  # the longest time on the host's clock
        ("period_ns", np.int64),
        ("clock", np.int64),  # one of the four above
        ("silence_ns", np.int64),  # a device that is quiet for longer is gone
        ("time_to_live", np.int64),  # samples that a force may act without being replaced
        ("stale_ns", np.int64),  # the same with the sample in which it begins to act
        ("pulse_begin", np.int64),  # pushes as an excitation: from this tick on, which counts as the first;
        ("pulse_first", np.int64),  # 1 for one on the first ticks,
        ("pulse_from", np.int64),  # then from this tick on
        ("pulse_every", np.int64),  # with this many ticks from one to the next (0: none),
        ("pulse_ticks", np.int64),  # each of this length,
        ("pulse_channel", np.int64),
        ("pulse_force", np.float64),  # N at most, with alternating sign
        ("wire_samples", np.int64),  # from a position to its force on a wire that makes every force late; else 1
        ("periodic", np.uint64),  # or a periodic excitation on that channel: address of forces in N, one per sample,
        ("periodic_length", np.int64),  # and their count (0: none)
    ],
    align=True,
)

STATE = np.dtype(
    [
        ("sample", np.int64),  # number of the newest position, counted from arming
        ("gap", np.int64),  # samples from the one before to it
        *((name, np.int64) for name, place in words_at("at").items() if place == "state"),  # `counts.py` says which
        ("old_positions", np.int64),  # of the stale ones, those that came again or after a newer one
        # Most samples from the position that the acting force answers to the next force: the device reports only that
        # a force was late. No force acts beyond its time to live and one more, so the value ends at two more.
        ("age", np.int64),
        ("fault", np.int64),  # what the device reported when it stopped,
        ("device_state", np.int64),  # its state then,
        ("stopped_ns", np.int64),  # and the time
        ("first_ns", np.int64),  # arrival of the first and of the newest position
        ("newest_ns", np.int64),
        ("since_sent", np.int64),  # samples from the position that the last force to leave answers
        ("withholds", np.int64),  # 1: the composed force is zero because its position is too old
        ("withheld_ns", np.int64),  # since when every answer to a new position is; 0: the last one was not
        ("unanswered", np.int64),  # 1: the newest position's force has not left yet
        ("tick_ns", np.int64),  # where the host paces: when the loop woke up to ask for the next position,
        ("asked_ns", np.int64),  # and for what it sent last, which may ask again
        ("sent_ns", np.int64),  # when the last force had left
        ("due_ns", np.int64),  # where the device paces: when the next position is expected
    ],
    align=True,
)

WAIT = np.dtype(
    [
        ("begun_ns", np.int64),  # the loop waits for a position since then,
        ("for_ns", np.int64),  # at most for this long,
        ("answers", np.int64),  # 1: and then sends a force
        ("due_ns", np.int64),  # where the host paces, or in memory: when the next tick is due
    ],
    align=True,
)

HISTOGRAMS = np.dtype(
    [
        ("lateness", HISTOGRAM),  # ns: of the wake-up, where the host paces; of the position, where the device does
        # ns: from a position's arrival until its force has left; where the host paces, from waking up for the tick
        # until the position has arrived, the force sent in between.
        ("exchange", HISTOGRAM),
        ("age", HISTOGRAM),  # samples, as in STATE
    ],
    align=True,
)

LOOP = np.dtype(
    [
        ("inbox", np.uint64),  # address of an INBOX
        ("framing", FRAMING),  # of the frames to the device
        ("predictor", PREDICTOR),
        ("slot", SCENE_SLOT),
        ("ring", RING),
        ("sound", SOUND_RING),
        ("io", IO_BUFFER),
        ("board_law", BOARD_LAW),
        ("admittance", ADMITTANCE),
        ("words", WORDS_STATE),
        ("control", CONTROL),
        ("guides", GUIDE, (2,)),  # of each coordinate of a hand
        ("state", STATE),
        ("wait", WAIT),
        ("tick", TICK),
        ("hooks", HOOKS),
        *((guard.name, guard.record) for guard in GUARDS),
        ("history", FORCE_HISTORY),
        ("tank", TANK),
        ("pulses", PULSES),
        ("posted", POSTED),
        ("histograms", HISTOGRAMS),
    ],
    align=True,
)
"""Memory of an exchange, allocated before the device is armed."""


@inlined
def take_frame(loop, decoder, now):
    """Takes the decoder's frame, which arrived at `now` (ns). A position moves the scene up to its sample and computes
    the force that answers it.

    Returns RECEIVED, TIMED_OUT for a frame that is ignored, or a code of endings.py that ends the loop. A position that
    comes twice or after a newer one is counted and ignored, since the scene never goes back in time.
    """
    state, io, tick = loop.state, loop.io, loop.tick
    if decoder.type == schema.STATUS:
        state.fault = (decoder.counts[0] >> 8) & 0xFF
        state.device_state = decoder.counts[0] & 0xFF
        state.stopped_ns = now
        return endings.DEVICE_STOPPED
    if decoder.type not in (schema.POSITION, schema.POSITION_HELD):
        return endings.TIMED_OUT
    is_first = state.ticks == 0
    gap = 1 if is_first else (decoder.number - state.sample) & _MODULUS_MASK
    if gap == 0 or gap >= schema.SAMPLE_MODULUS // 2:
        state.stale_positions += 1
        state.old_positions += 1
        return endings.TIMED_OUT
    change = take_posted(loop.posted)
    if state.unanswered:
        state.stale_positions += 1
        mark_last(loop.ring, ring.UNSENT)
    _read_position(io, decoder, is_first)
    _read_away(io, gap, is_first)
    if is_first:
        start(program_at(loop.slot.program), io.measured)
        tick.held = stored_energy(program_at(loop.slot.program), io.measured)
        state.sample = decoder.number - 1
        state.first_ns = state.due_ns = now
    _begin_tick(loop, gap, decoder.type == schema.POSITION_HELD, now)
    call_hooks(loop.hooks.before_scene, tick)
    move_scene(loop.slot, io, gap)
    publish_sound(loop.sound, now)
    call_hooks(loop.hooks.after_scene, tick)
    note_taken(loop.posted, change, state)
    return _answer(loop)


@inlined
def _begin_tick(loop, gap, is_held, now):
    """Counts a position, `gap` samples after the last, and fills the TICK. `is_held`: no force arrived in time."""
    state, control, tick = loop.state, loop.control, loop.tick
    state.deadline_misses += is_held
    state.age = min(state.age + 1, control.time_to_live + 2) if is_held else 1
    note(loop.histograms.age, state.age)
    state.lost_frames += gap - 1
    flags = (ring.LATE_FORCE if is_held else 0) | (ring.BRIDGED if gap > 1 else 0) | _note_time(loop, now, gap)
    state.gap = gap
    state.sample += gap
    since = state.sent_ns if control.clock == HOST_CLOCK else state.newest_ns
    state.since_sent = gap + (state.since_sent if state.unanswered else 0)
    is_over = state.since_sent > control.time_to_live + 1 or now - since > control.stale_ns
    tick.number, tick.sample, tick.gap, tick.age = state.ticks, state.sample, gap, state.age
    tick.now_ns, tick.before_ns, tick.begun_ns = now, state.newest_ns, state.tick_ns
    tick.late = is_held and control.wire_samples == 1  # else the loop is made for that delay
    tick.missed, tick.unsent = state.deadline_misses, state.unanswered
    tick.expired = state.ticks > 0 and is_over
    tick.withheld = flags & ring.WITHHELD != 0
    tick.flags, tick.ending = flags, 0


@inlined
def _read_position(io, decoder, is_first):
    """Converts the decoder's counts to m from the origin (on some channels the place of arming), m/s and m/s²."""
    accelerations = np.uint64(io.channels * (1 + io.velocities))  # behind the positions and the velocities
    hand_forces = np.uint64(io.channels * (1 + io.velocities + io.accelerations))
    for c in range(np.uint64(io.channels)):
        if is_first and io.origin_at_arming[c]:
            io.origin_counts[c] = decoder.counts[c]
        io.position_counts[c] = decoder.counts[c] - io.origin_counts[c]
        io.before[c] = io.measured[c]
        io.measured[c] = io.position_counts[c] * io.position_scale[c]
        if is_first:  # the hand comes from where it is
            io.before[c] = io.measured[c]
        if io.velocities:
            io.velocity_before[c] = io.velocity[c]
            io.velocity_counts[c] = decoder.counts[np.uint64(io.channels) + c]
            io.velocity[c] = io.velocity_counts[c] * io.velocity_scale[c]
            if is_first:
                io.velocity_before[c] = io.velocity[c]
        if io.accelerations:
            io.acceleration_counts[c] = decoder.counts[accelerations + c]
            io.acceleration[c] = io.acceleration_counts[c] * io.acceleration_scale[c]
        if io.hand_forces:
            io.hand_force_counts[c] = decoder.counts[hand_forces + c]
            io.hand_force[c] = io.hand_force_counts[c] * io.hand_force_scale[c]
    if io.words:
        io.inputs = decoder.counts[hand_forces + np.uint64(io.channels * io.hand_forces)] & 0xFFFFFFFF


@inlined
def _read_away(io, gap, is_first):
    """Takes where the points at other ports are, `gap` samples after the last position; none in most scenes."""
    for c in range(np.uint64(io.away_first), np.uint64(io.away_end)):
        io.before[c] = io.away[c] if is_first else io.measured[c]
        io.measured[c] = io.away[c]
        io.velocity_before[c] = io.velocity[c]
        io.velocity[c] = (io.measured[c] - io.before[c]) * io.away_rate / gap


@inlined
def _answer(loop):
    """Turns the scene's force into the guarded force, and counts the tick. Returns RECEIVED, or the code that ends the
    loop before that force is sent."""
    state, io, tick = loop.state, loop.io, loop.tick
    is_finite, limited = _set_force(io, loop.control, state, tick.push)
    if tick.withheld:
        state.withheld_forces += 1
        _take_force_away(io)
        limited = False  # nothing is sent of it
    if is_finite:
        call_hooks(loop.hooks.after_limit, tick)
    limited = limited or tick.flags & ring.LIMITED != 0
    state.slewed_ticks += 1 if tick.flags & ring.SLEWED else 0
    state.newest_ns = tick.now_ns
    state.limited_ticks += limited
    push(loop.ring, state, tick.now_ns, tick.flags | ring.LIMITED if limited else tick.flags, io)
    state.ticks += 1
    state.unanswered = 1
    if not is_finite:
        return endings.NOT_FINITE
    return tick.ending if tick.ending != 0 else endings.RECEIVED


@inlined
def compose_frame(loop, disarm):
    """Writes the frame with the newest force, or the one that disarms, into the outbox. Returns where it ends."""
    io = loop.io
    state, control = loop.state, loop.control
    kind, number, argument = schema.FORCE, state.sample & _MODULUS_MASK, control.time_to_live
    state.asked_ns, state.withholds = loop.wait.begun_ns, loop.tick.withheld
    payload = _words_at(io.payload, schema.MAX_WORDS)
    if disarm:
        kind, number, argument = schema.DISARM, 0, 0
        _take_force_away(io)
        io.outputs = 0
        for i in range(np.uint64(loop.framing.words)):
            payload[i] = 0
    elif control.clock == HOST_CLOCK and _is_outdated(control, _held_since(state, control), loop.wait.begun_ns):
        state.withheld_forces += 1
        state.withholds = 1
        _take_force_away(io)
        _leave_zero(loop, io.channels)
        state.limited_ticks -= withhold_last(loop.ring)
    if io.words:  # whatever becomes of the force
        payload[np.uint64(loop.framing.words - 1)] = io.outputs
    return write_frame(loop.framing, io.outbox, next_place(io.sent), kind, number, argument, payload)


@inlined
def _is_outdated(control, since, now):
    """Returns whether a position that arrived at `since` (ns) is older at `now` than a force may live."""
    return now - since > control.stale_ns


@inlined
def _held_since(state, control):
    """Returns the time in ns from which the device counts the time to live, or an earlier one. Only for a host clock.

    A force that is repeated, since no position came, must be zero while the device still accepts it: a sample before
    its time to live ends. A force that is late for its position may find a device at zero. That device counts from the
    force before, less a quarter of a period, because its arrival is not known any better.
    """
    if not state.unanswered:
        return state.newest_ns - control.period_ns
    since = state.sent_ns - (control.period_ns >> 2)
    return since if state.ticks > 1 and since < state.newest_ns else state.newest_ns


@inlined
def _leave_zero(loop, channels):
    """Records in the slew limit and in the history that zero is sent in place of the force."""
    leave_zero(loop.slew, channels)
    for c in range(np.uint64(channels)):
        loop.history.decided[c] = loop.history.decided[np.uint64(IN_ALL) + c] = 0.0
        for i in range(np.uint64(NUMBERS if loop.io.lines else 0)):
            past = loop.board_law.past[i]
            past.decided[c] = past.decided[np.uint64(IN_ALL) + c] = 0.0


@inlined
def on_force_sent(loop, now):
    """Records that the force was sent at `now` (ns), and publishes the tick."""
    if loop.control.clock != HOST_CLOCK:
        note(loop.histograms.exchange, now - loop.state.newest_ns)
    state = loop.state
    if state.unanswered and state.withholds == 0:
        state.withheld_ns = 0
    elif state.unanswered and state.withheld_ns == 0:
        state.withheld_ns = now
    state.sent_ns = now
    state.unanswered = 0
    publish(loop.ring)


@inlined
def flush_unsent(loop):
    """Publishes the last tick at the end of the loop, marked if its force was never sent."""
    if loop.state.unanswered:
        mark_last(loop.ring, ring.UNSENT)
    publish(loop.ring)


@inlined
def _note_time(loop, now, gap):
    """Counts the lateness of a position, `gap` samples after the last. Returns the row's flags for it.

    A device that paces does not report when it sampled. Its lateness is relative to the earliest recent arrivals, by
    its own count of samples. The grid of expected arrivals moves to every earlier arrival, and by a 16th of the
    lateness after a later one, so that it follows a device with a slow clock.
    """
    state, control, period = loop.state, loop.control, loop.control.period_ns
    if loop.control.clock == DEVICE_CLOCK:
        late = now - (state.due_ns + (gap - 1) * period)
        note(loop.histograms.lateness, late)
        state.due_ns += (late if late < 0 else late >> 4) + gap * period
        if _is_outdated(control, 0, late):
            return ring.WITHHELD
    elif loop.control.clock == HOST_CLOCK and state.ticks > 0:
        note(loop.histograms.exchange, now - state.tick_ns)
        if abs(now - state.newest_ns - period) > period // 8:
            return ring.OFF_GRID | (ring.WITHHELD if _is_outdated(control, state.tick_ns, now) else 0)
    return 0


_doubles_at, _words_at = array_at(np.float64), array_at(np.int64)
_GOLDEN = 0.6180339887498949  # its multiples are spread evenly over every interval


@inlined
def _excitation(control, state):
    """Returns the excitation's force in N. All pushes differ, so that no two ring-downs are rounded alike. A periodic
    excitation follows the device's count of samples: lost positions do not shift it."""
    if control.pulse_every == 0:
        if control.periodic_length == 0:
            return 0.0
        at = np.uint64(state.sample % control.periodic_length)
        return _doubles_at(control.periodic, control.periodic_length)[at]
    tick = state.ticks - control.pulse_begin
    if control.pulse_first and 0 <= tick < control.pulse_ticks:
        return control.pulse_force
    since = tick - control.pulse_from
    if since < 0 or since % control.pulse_every >= control.pulse_ticks:
        return 0.0
    count = since // control.pulse_every
    force = control.pulse_force * (1.0 - 0.5 * ((count * _GOLDEN) % 1.0))
    return -force if count & 1 else force


@inlined
def _set_force(io, control, state, guided):
    """Adds excitation and the guides' forces (N, by channel), limits the force, converts it to counts. Returns (whether
    it is finite, whether it was clipped)."""
    pulse = _excitation(control, state)
    for c in range(np.uint64(io.channels)):
        io.excitation[c] = guided[c]
    io.excitation[np.uint64(control.pulse_channel)] += pulse
    if control.periodic_length > 0:
        io.as_hand[np.uint64(control.pulse_channel)] = pulse
    sound, limited = True, False
    for c in range(np.uint64(io.channels)):
        wanted = io.asked[c] + io.excitation[c]
        sound = sound and math.isfinite(wanted)
        force = clip(wanted, io.force_limit[c])
        limited = limited or force != wanted
        counts = np.rint(force / io.force_scale[c])
        io.force_counts[c] = np.int64(clip(counts, 2147483647.0))
    if not sound:
        _take_force_away(io)
        return False, False
    return True, limited


@inlined
def _take_force_away(io):
    for i in range(np.uint64(3 * io.channels if io.lines else io.channels)):
        io.force_counts[i] = 0
