"""What the compiled loop does between two exchanges: wait in the kernel for bytes, send what was composed.

It never spins: bytes of a terminal pass through a kernel worker of ordinary priority, which a spinning loop starves.
"""

from __future__ import annotations

from firmware_protocol.code_size import compact
from firmware_protocol.decoder import next_frame
from hapsim.compiling import inlined
from hapsim.loop.codes import TIMED_OUT
from hapsim.loop.exchange import compose_frame, flush_unsent, on_force_sent, take_frame
from hapsim.loop.inbox import AT_ONCE, inbox_at
from hapsim.loop.last_bytes import next_place
from hapsim.loop.system import now_ns, sleep_until
from hapsim.loop.transport import receive_at, send_from

SLICE_NS = 100_000_000
"""No wait is longer without a look at whether the loop is to stop."""

_GLANCE_NS = 50_000


@inlined
def wait_for_go(loop):
    """Waits until the device is armed, or the loop told to stop. Done in here, the loop needs Python no more once it is
    armed: whatever holds Python up at that moment makes no first force late."""
    while not loop.control.go and not loop.control.stop:
        sleep_until(now_ns(loop.io.scratch) + _GLANCE_NS, loop.io.scratch)


@inlined
def take_those_at_hand(loop, inbox, arrived):
    """Takes every position among the bytes that have arrived: HEARD, TIMED_OUT, FAULT, BAD_FORCE, LEAPT, OFF_RATE,
    DIVERGED, WRONG_SIGN, OUT_OF_TRAVEL. It asks the system for nothing."""
    heard = TIMED_OUT
    while inbox.start < inbox.stop:
        inbox.start, found = next_frame(inbox.decoder, inbox.bytes, inbox.start, inbox.stop)
        code = take_frame(loop, inbox.decoder, arrived) if found else TIMED_OUT
        if code < TIMED_OUT:
            return code
        heard |= code
    return heard


@inlined
def take_newest_position(loop, begun, timeout_ns):
    """Waits for a position from `begun` (ns) on, takes all that are there and leaves the force that answers the newest.
    Every one of them moves the scene, in order, so that its velocities stay true; only the newest is answered.

    Returns HEARD, or TIMED_OUT, HUNG_UP, FAILED, FAULT, BAD_FORCE, LEAPT, OFF_RATE, DIVERGED, WRONG_SIGN,
    OUT_OF_TRAVEL. Bytes without end that are no position do not make the wait any longer; being told to stop makes it
    shorter.
    """
    compact()
    inbox, last_look = inbox_at(loop.inbox), False
    arrived, give_up = begun, begun + timeout_ns
    while True:
        code = take_those_at_hand(loop, inbox, arrived)  # at first what the frame before has left
        if code != TIMED_OUT or last_look:
            return code
        last_look = arrived >= give_up or loop.control.stop != 0
        left = give_up - arrived
        inbox.start = inbox.stop = at = next_place(inbox.last)
        count = receive_at(inbox.transport, inbox.bytes, at, AT_ONCE, left if left < SLICE_NS else SLICE_NS)
        arrived = now_ns(loop.io.scratch)
        if count < 0:
            return count
        inbox.stop = inbox.last.at = at + count


@inlined
def send_frame(loop, disarm):
    """Sends the force that answers the newest position; or, to `disarm`, zero force, the last frame of every loop
    whatever ended it: 0, or HUNG_UP or FAILED."""
    io, stop = loop.io, compose_frame(loop, disarm)
    code = send_from(inbox_at(loop.inbox).transport, io.outbox, io.sent.at, stop)
    io.sent.at = stop
    if disarm:
        flush_unsent(loop)
    else:
        on_force_sent(loop, now_ns(loop.io.scratch))
    return code
