"""The compiled loop, without the GIL: one function, compiled once, for every scene, device, transport and clock."""

from __future__ import annotations

from hapsim.compiling import entry
from hapsim.loop.codes import HEARD, TIMED_OUT
from hapsim.loop.denormals import flush_denormals, restore
from hapsim.loop.endings import GOES_ON, RING_FULL, ending_of
from hapsim.loop.exchange import HOST_CLOCK
from hapsim.loop.paced_by_device import plan_by_device
from hapsim.loop.paced_by_host import is_patient, plan_by_host
from hapsim.loop.system import now_ns
from hapsim.loop.waiting import send_frame, take_newest_position, wait_for_go


@entry
def run_loop(loop):
    """Exchanges until something ends it; returns what did, one of endings.py. RING_FULL alone leaves the device armed.

    `loop`: LOOP of exchange.py. Each time around, a clock says what is waited for and whether it is answered; whatever
    ends it, the last frame disarms the device. Position and force have one place each: they are most of the code.
    """
    mode = flush_denormals()
    wait_for_go(loop)
    loop.state.sent_ns = loop.state.tick_ns = now_ns(loop.io.scratch)
    by_host, wait = loop.control.clock == HOST_CLOCK, loop.wait
    ending, released = GOES_ON, False
    while not released and ending != RING_FULL:
        if ending == GOES_ON:
            ending = plan_by_host(loop) if by_host else plan_by_device(loop)
        if ending == GOES_ON:
            code = take_newest_position(loop, wait.begun_ns, wait.for_ns)
            if code != HEARD and not (by_host and code == TIMED_OUT and is_patient(loop)):
                ending = ending_of(code, loop.control.stop)
        if ending == RING_FULL or (ending == GOES_ON and not wait.answers):
            continue
        released = ending != GOES_ON
        if by_host and loop.state.unanswered:
            loop.state.tick_ns = wait.begun_ns  # else the same position is asked for again, and awaited since then
        code = send_frame(loop, released)
        if code != 0 and not released:
            ending = ending_of(code, 0)
    restore(mode)
    return ending
