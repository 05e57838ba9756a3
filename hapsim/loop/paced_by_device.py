"""The loop when the device is the clock, in real or in virtual time: it sleeps in the kernel until a position comes."""

from __future__ import annotations

from hapsim.compiled import jit
from hapsim.loop.codes import HEARD
from hapsim.loop.endings import DONE, GONE, RING_FULL, STOPPED, ending_of
from hapsim.loop.ring import full
from hapsim.loop.system import now_ns
from hapsim.loop.waiting import answer, let_go, take_newest_position, wait_for_go


@jit
def run_paced_by_device(loop):
    """Answers every position until something ends it; returns what did. RING_FULL alone leaves the device armed."""
    wait_for_go(loop)
    loop.state.sent_ns = now_ns(loop.desk.scratch)
    while True:
        if loop.control.stop:
            ending = STOPPED
        elif 0 <= loop.control.ticks <= loop.state.ticks:
            ending = DONE
        elif full(loop.ring):
            return RING_FULL
        else:
            code = take_newest_position(loop, loop.state.sent_ns, loop.control.silence_ns)
            if code == HEARD:
                if answer(loop) == 0:
                    continue
                ending = GONE
            else:
                ending = ending_of(code, loop.control.stop)
        let_go(loop)
        return ending
