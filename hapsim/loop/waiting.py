"""What the compiled loops do between two exchanges: wait in the kernel for bytes, send what was composed.

It never spins: bytes of a terminal pass through a kernel worker of ordinary priority, which a spinning loop starves.
"""

from __future__ import annotations

from hapsim.compiled import inlined, part
from hapsim.loop.codes import TIMED_OUT
from hapsim.loop.exchange import compose_disarm, compose_force, digest, never_sent, sent
from hapsim.loop.inbox import fetch
from hapsim.loop.port import send
from hapsim.loop.system import now_ns, sleep_until

SLICE_NS = 100_000_000
"""No wait is longer without a look at whether the loop was told to stop."""


_GLANCE_NS = 50_000


@part
def wait_for_go(loop):
    """Waits until the device is armed, or the loop told to stop. Done in here, the loop needs Python no more once it is
    armed: whatever holds Python up at that moment makes no first force late."""
    while not loop.control.go and not loop.control.stop:
        sleep_until(now_ns(loop.desk.scratch) + _GLANCE_NS, loop.desk.scratch)


@inlined
def take_newest_position(loop, now, timeout_ns):
    """Waits for a position from `now` on, takes all that are there and leaves the force that answers the newest.

    Returns HEARD, or TIMED_OUT, HUNG_UP, FAILED, FAULT, BAD_FORCE. Bytes without end that are no position do not make
    the wait any longer; being told to stop makes it shorter.
    """
    give_up = now + timeout_ns
    last_look = False
    while True:
        code = digest(loop, now)  # at first what the frame before has left
        if code != TIMED_OUT or last_look:
            return code
        last_look = now >= give_up or loop.control.stop != 0
        count = fetch(loop.port, loop.inbox, min(give_up - now, SLICE_NS))
        now = now_ns(loop.desk.scratch)
        if count < 0:
            return count


@inlined
def answer(loop):
    """Sends the force that answers the newest position; 0, or HUNG_UP or FAILED."""
    code = send(loop.port, loop.desk.outbox, compose_force(loop))
    sent(loop, now_ns(loop.desk.scratch))
    return code


@part
def let_go(loop):
    """Zero force, at once."""
    send(loop.port, loop.desk.outbox, compose_disarm(loop))
    never_sent(loop)
