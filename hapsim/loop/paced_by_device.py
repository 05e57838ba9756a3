"""The loop when the device is the clock, in real or in virtual time: it sleeps in the kernel until a position comes."""

from __future__ import annotations

from hapsim.compiled import inlined, jit
from hapsim.loop.codes import HEARD
from hapsim.loop.denormals import flush_denormals, restore
from hapsim.loop.endings import GOES_ON, GONE, RING_FULL, ending_of, told_to_end
from hapsim.loop.system import now_ns
from hapsim.loop.waiting import answer, let_go, take_newest_position, wait_for_go


@jit
def run_paced_by_device(loop):
    """Answers every position until something ends it; returns what did. RING_FULL alone leaves the device armed."""
    mode = flush_denormals()
    wait_for_go(loop)
    loop.state.sent_ns = now_ns(loop.desk.scratch)
    ending = GOES_ON
    while ending == GOES_ON:
        ending = told_to_end(loop.control, loop.state, loop.ring)
        if ending == GOES_ON:
            ending = _exchange(loop)
    if ending != RING_FULL:
        let_go(loop)
    restore(mode)
    return ending


@inlined
def _exchange(loop):
    """Position in, force out. GOES_ON, or why the loop ends."""
    code = take_newest_position(loop, loop.state.sent_ns, loop.control.silence_ns)
    if code != HEARD:
        return ending_of(code, loop.control.stop)
    return GOES_ON if answer(loop) == 0 else GONE
