"""The compiled loop, without the GIL: one function, compiled once, for every scene, device, transport and clock.

Between two exchanges it waits in the kernel and never spins: a spinning loop would starve the kernel worker of ordinary
priority that moves a terminal's bytes.
"""

from __future__ import annotations

import numpy as np

from firmware_protocol import schema
from firmware_protocol.decoder import next_frame
from hapsim.compiling import entry, inlined
from hapsim.loop.buffers import AT_ONCE, inbox_at, next_place
from hapsim.loop.clocks import SLICE_NS, may_retry, plan_by_device, plan_by_host, plan_in_memory
from hapsim.loop.endings import RECEIVED, RING_FULL, RUNNING, TIMED_OUT, ending_of
from hapsim.loop.exchange import HOST_CLOCK, MEMORY_CLOCK, compose_frame, flush_unsent, on_force_sent, take_frame
from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.loop.system import flush_denormals, now_ns, restore_denormals, sleep_until
from hapsim.loop.transport import receive, send

_ARMED_CHECK_NS = 50_000


@entry
def run_loop(loop):
    """Runs exchanges until the loop ends; returns a code of endings.py. Only RING_FULL leaves the device armed.

    `loop`: a LOOP. In each round a clock plans the wait and whether the loop answers. The last frame of every loop
    disarms the device. Receiving and sending are called in one place each, because they are most of the code.
    """
    mode = flush_denormals()
    _wait_until_armed(loop)
    loop.state.sent_ns = loop.state.tick_ns = now_ns(loop.io.scratch)
    by_host, in_memory, wait = loop.control.clock == HOST_CLOCK, loop.control.clock == MEMORY_CLOCK, loop.wait
    ending, released = RUNNING, False
    while not released and ending != RING_FULL:
        if ending == RUNNING and in_memory:
            ending = plan_in_memory(loop)
        elif ending == RUNNING:
            ending = plan_by_host(loop) if by_host else plan_by_device(loop)
        if ending == RUNNING:
            code = _take_newest_position(loop, wait.begun_ns, wait.for_ns)
            if code != RECEIVED and not (by_host and code == TIMED_OUT and may_retry(loop)):
                ending = ending_of(code, loop.control.stop)
        if ending == RING_FULL or (ending == RUNNING and not wait.answers):
            continue
        released = ending != RUNNING
        if by_host and loop.state.unanswered:
            loop.state.tick_ns = wait.begun_ns  # not for a repeated request
        code = send_frame(loop, released)
        if not released:
            on_force_sent(loop, now_ns(loop.io.scratch))
        if code != 0 and not released:
            ending = ending_of(code, 0)
    restore_denormals(mode)
    return ending


@inlined
def _wait_until_armed(loop):
    """Waits until the device is armed, or the loop must stop. This wait is compiled, so that a delay of Python after
    arming does not make the first force late."""
    while not loop.control.go and not loop.control.stop:
        sleep_until(now_ns(loop.io.scratch) + _ARMED_CHECK_NS, loop.io.scratch)


@inlined
def take_received_frames(loop, inbox, arrived):
    """Takes every frame among the received bytes. Returns RECEIVED, TIMED_OUT, or a code that ends the loop."""
    result = TIMED_OUT
    while inbox.start < inbox.stop:
        inbox.start, found = next_frame(inbox.decoder, inbox.bytes, inbox.start, inbox.stop)
        code = take_frame(loop, inbox.decoder, arrived) if found else TIMED_OUT
        if code < TIMED_OUT:
            return code
        result |= code
    return result


@inlined
def _take_newest_position(loop, begun, timeout_ns):
    """Waits for a position from `begun` (ns) on, takes all that have arrived, and computes the force that answers the
    newest. All of them move the scene, in order, so that its velocities stay correct.

    Returns RECEIVED, TIMED_OUT, or a code that ends the loop. Bytes without a position do not prolong the wait.
    """
    inbox, last_pass = inbox_at(loop.inbox), False
    arrived, give_up = begun, begun + timeout_ns
    while True:
        code = take_received_frames(loop, inbox, arrived)  # first those of an earlier call
        if code != TIMED_OUT or last_pass:
            return code
        last_pass = arrived >= give_up or loop.control.stop != 0
        left = give_up - arrived
        inbox.start = inbox.stop = at = next_place(inbox.last)
        count = receive(inbox.transport, inbox.bytes, at, AT_ONCE, left if left < SLICE_NS else SLICE_NS)
        arrived = now_ns(loop.io.scratch)
        if count < 0:
            return count
        inbox.stop = inbox.last.at = at + count


@inlined
def send_frame(loop, disarm):
    """Sends the newest force, or at the end of the loop the frame that disarms. Returns 0, HUNG_UP or FAILED."""
    io, stop = loop.io, compose_frame(loop, disarm)
    code = send(inbox_at(loop.inbox).transport, io.outbox, io.sent.at, stop)
    io.sent.at = stop
    if disarm:
        flush_unsent(loop)
    return code


# The exchange without a device: it takes recorded positions at their recorded times. The record also says which forces
# were sent and when, so that the guards ramp them as in the run.

_MASK = schema.SAMPLE_MODULUS - 1


# Words of a replayed row; C positions and C velocities in counts follow, and the positions of points at other ports.
SAMPLE, TIME, FLAGS, FLAGS_BEFORE, TICK, ASKED, SENT, VALUES = range(8)


@entry
def replay_rows(loop, decoder, rows, flushes, ends):
    """Runs one exchange for each row. `loop`: LOOP, whose inbox is not read. `decoder`: DECODER. `rows`: (n, words)
    int64. `flushes`: denormals are zero, as in the compiled loop. `ends`: the last row is the record's last."""
    mode = flush_denormals()
    if not flushes:
        restore_denormals(mode)
    for n in range(rows.shape[0]):
        row = rows[n]
        if loop.state.ticks > 0:
            _replay_sending(loop, row)
        decoder.type = schema.POSITION_HELD if row[FLAGS] & LATE_FORCE else schema.POSITION
        decoder.number = row[SAMPLE] & (_MASK if loop.state.ticks > 0 else -1)  # a record may begin later than its run
        away = loop.io.away_end - loop.io.away_first
        for i in range(row.size - VALUES - away):
            decoder.counts[i] = row[VALUES + i]
        for i in range(away):
            loop.io.away[loop.io.away_first + i] = np.int64(row[row.size - away + i]).view(np.float64)
        take_frame(loop, decoder, row[TIME])
        if ends and n == rows.shape[0] - 1:
            loop.state.unanswered = 1 if row[FLAGS] & UNSENT else 0
            flush_unsent(loop)
    restore_denormals(mode)


@inlined
def _replay_sending(loop, row):
    """Records the sending of the last row's force, if it was sent and when, and of the host's repeated request."""
    state, wait = loop.state, loop.wait
    if loop.control.clock != HOST_CLOCK:
        if not row[FLAGS_BEFORE] & UNSENT:
            on_force_sent(loop, state.newest_ns)
        return
    tick, asked = row[TIME] - row[TICK], row[TIME] - row[ASKED]
    if not row[FLAGS_BEFORE] & UNSENT:
        wait.begun_ns = tick
        compose_frame(loop, False)
        on_force_sent(loop, asked)
        if asked != tick:
            wait.begun_ns = asked
            compose_frame(loop, False)
    state.tick_ns, state.sent_ns = tick, row[TIME] - row[SENT]
