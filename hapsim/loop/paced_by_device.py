"""The loop when the device is the clock, in real or in virtual time: it sleeps in the kernel until a position comes."""

from __future__ import annotations

from hapsim.compiled import jit
from hapsim.loop.exchange import (
    DONE,
    GONE,
    HEARD,
    RING_FULL,
    STOPPED,
    answer,
    ending_of,
    let_go,
    take_newest_position,
)
from hapsim.loop.ring import full


@jit
def run_paced_by_device(loop):
    """Answers every position until something ends it; returns what did. RING_FULL alone leaves the device armed."""
    while True:
        if loop.control.stop:
            ending = STOPPED
        elif 0 <= loop.control.ticks <= loop.state.ticks:
            ending = DONE
        elif full(loop.ring):
            return RING_FULL
        else:
            code = take_newest_position(loop, loop.control.silence_ns)
            if code == HEARD:
                if answer(loop) == 0:
                    continue
                ending = GONE
            else:
                ending = ending_of(code)
        let_go(loop)
        return ending
