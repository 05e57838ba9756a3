"""The compiled loop, without the GIL: one function, compiled once, for every scene, device, transport and clock.

Between two exchanges it waits in the kernel and never spins: the bytes of a terminal pass through a kernel worker of
ordinary priority, which a spinning loop starves.
"""

from __future__ import annotations

from firmware_protocol import schema
from firmware_protocol.compiled import compact
from firmware_protocol.decoder import next_frame
from hapsim.compiling import entry, inlined
from hapsim.loop.buffers import AT_ONCE, inbox_at, next_place
from hapsim.loop.clocks import SLICE_NS, may_ask_again, plan_by_device, plan_by_host
from hapsim.loop.endings import HEARD, RING_FULL, RUNNING, TIMED_OUT, ending_of
from hapsim.loop.exchange import HOST_CLOCK, compose_frame, flush_unsent, on_force_sent, take_frame
from hapsim.loop.ring import LATE_FORCE, UNSENT
from hapsim.loop.system import flush_denormals, now_ns, restore, sleep_until
from hapsim.loop.transport import receive, send

_ARMED_CHECK_NS = 50_000


@entry
def run_loop(loop):
    """Exchanges until something ends the loop; returns a code of endings.py. Only RING_FULL leaves the device armed.

    `loop`: a LOOP. In each round a clock plans the wait and whether the loop answers; the last frame of every loop
    disarms the device. Receiving and sending are called in one place each, because they are most of the code.
    """
    mode = flush_denormals()
    _wait_until_armed(loop)
    loop.state.sent_ns = loop.state.tick_ns = now_ns(loop.io.scratch)
    by_host, wait = loop.control.clock == HOST_CLOCK, loop.wait
    ending, released = RUNNING, False
    while not released and ending != RING_FULL:
        if ending == RUNNING:
            ending = plan_by_host(loop) if by_host else plan_by_device(loop)
        if ending == RUNNING:
            code = _take_newest_position(loop, wait.begun_ns, wait.for_ns)
            if code != HEARD and not (by_host and code == TIMED_OUT and may_ask_again(loop)):
                ending = ending_of(code, loop.control.stop)
        if ending == RING_FULL or (ending == RUNNING and not wait.answers):
            continue
        released = ending != RUNNING
        if by_host and loop.state.unanswered:
            loop.state.tick_ns = wait.begun_ns  # not where the same position is asked for again
        code = _send_frame(loop, released)
        if code != 0 and not released:
            ending = ending_of(code, 0)
    restore(mode)
    return ending


@inlined
def _wait_until_armed(loop):
    """Waits until the device is armed, or the loop is to stop. Compiled code waits, so that a delay of Python after
    arming does not make the first force late."""
    while not loop.control.go and not loop.control.stop:
        sleep_until(now_ns(loop.io.scratch) + _ARMED_CHECK_NS, loop.io.scratch)


@inlined
def take_received_frames(loop, inbox, arrived):
    """Takes every frame among the received bytes: HEARD, TIMED_OUT, or a code that ends the loop."""
    heard = TIMED_OUT
    while inbox.start < inbox.stop:
        inbox.start, found = next_frame(inbox.decoder, inbox.bytes, inbox.start, inbox.stop)
        code = take_frame(loop, inbox.decoder, arrived) if found else TIMED_OUT
        if code < TIMED_OUT:
            return code
        heard |= code
    return heard


@inlined
def _take_newest_position(loop, begun, timeout_ns):
    """Waits for a position from `begun` (ns) on, takes all that have arrived, and computes the force that answers the
    newest. All of them move the scene, in order, so that its velocities stay true.

    Returns HEARD, TIMED_OUT, or a code that ends the loop. Bytes without a position do not prolong the wait.
    """
    compact()
    inbox, last_look = inbox_at(loop.inbox), False
    arrived, give_up = begun, begun + timeout_ns
    while True:
        code = take_received_frames(loop, inbox, arrived)  # at first those left from before
        if code != TIMED_OUT or last_look:
            return code
        last_look = arrived >= give_up or loop.control.stop != 0
        left = give_up - arrived
        inbox.start = inbox.stop = at = next_place(inbox.last)
        count = receive(inbox.transport, inbox.bytes, at, AT_ONCE, left if left < SLICE_NS else SLICE_NS)
        arrived = now_ns(loop.io.scratch)
        if count < 0:
            return count
        inbox.stop = inbox.last.at = at + count


@inlined
def _send_frame(loop, disarm):
    """Sends the newest force, or at the end of the loop zero force that disarms: 0, HUNG_UP or FAILED."""
    io, stop = loop.io, compose_frame(loop, disarm)
    code = send(inbox_at(loop.inbox).transport, io.outbox, io.sent.at, stop)
    io.sent.at = stop
    if disarm:
        flush_unsent(loop)
    else:
        on_force_sent(loop, now_ns(loop.io.scratch))
    return code


# The exchange without a device: recorded positions come in, at their recorded times. What a record has of the forces
# that left, and when, decides as it did then whether a guard has them rise from zero.

_MASK = schema.SAMPLE_MODULUS - 1


# Words of a row that is replayed; C positions and C velocities in counts follow.
SAMPLE, TIME, FLAGS, FLAGS_BEFORE, TICK, ASKED, SENT, VALUES = range(8)


@entry
def replay_rows(loop, decoder, rows, flushes, ends):
    """Exchanges once for each row. `loop`: LOOP, whose inbox is not read; `decoder`: DECODER. `rows`: (n, 7 + 2 C)
    int64. `flushes`: whether denormal numbers are zero, as in the compiled loop; `ends`: whether the last row is the
    record's last."""
    mode = flush_denormals()
    if not flushes:
        restore(mode)
    for n in range(rows.shape[0]):
        row = rows[n]
        if loop.state.ticks > 0:
            _leave_again(loop, row)
        decoder.type = schema.POSITION_HELD if row[FLAGS] & LATE_FORCE else schema.POSITION
        decoder.number = row[SAMPLE] & _MASK
        for i in range(row.size - VALUES):
            decoder.counts[i] = row[VALUES + i]
        take_frame(loop, decoder, row[TIME])
        if ends and n == rows.shape[0] - 1:
            loop.state.unanswered = 1 if row[FLAGS] & UNSENT else 0
            flush_unsent(loop)
    restore(mode)


@inlined
def _leave_again(loop, row):
    """The force of the row before leaves, where it did, and when it did; and again where the host asked again."""
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
