"""When the device is the clock, in real or in virtual time: the loop sleeps in the kernel until a position comes, and
answers each."""

from __future__ import annotations

from hapsim.compiling import inlined
from hapsim.loop.endings import told_to_end


@inlined
def plan_by_device(loop):
    """What the loop waits for next; GOES_ON, or why it ends before."""
    loop.wait.begun_ns = loop.state.sent_ns
    loop.wait.for_ns = loop.control.silence_ns
    loop.wait.answers = 1
    return told_to_end(loop)
