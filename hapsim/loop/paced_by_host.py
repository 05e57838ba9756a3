"""When the host is the clock: at each tick the loop sends the force and with it asks for the next position."""

from __future__ import annotations

from hapsim.compiling import inlined
from hapsim.loop.endings import GOES_ON, STOPPED, told_to_end
from hapsim.loop.histogram import note
from hapsim.loop.pacing import next_point
from hapsim.loop.system import now_ns, sleep_until
from hapsim.loop.waiting import SLICE_NS


@inlined
def plan_by_host(loop):
    """What the loop waits for next; GOES_ON, or why it ends before.

    A tick has two waits. At its time the loop looks whether a position came after the tick before was over, and
    answers: in its turn it would leave every later force a sample older than need be. Then it waits for the position
    that this asked for, until the next tick is due. The first position comes without being asked for.
    """
    wait, state, control = loop.wait, loop.state, loop.control
    if state.ticks == 0:
        wait.begun_ns, wait.for_ns, wait.answers = state.sent_ns, control.silence_ns, 0
        return GOES_ON
    if wait.answers:
        wait.begun_ns, wait.for_ns, wait.answers = state.sent_ns, wait.due_ns - state.sent_ns, 0
        return GOES_ON
    ending = told_to_end(loop)
    if ending != GOES_ON:
        return ending
    woken = now_ns(loop.io.scratch)
    if wait.due_ns == 0:
        wait.due_ns = woken + control.period_ns
    while woken < wait.due_ns and not control.stop:
        slice_ends = woken + SLICE_NS
        sleep_until(wait.due_ns if wait.due_ns < slice_ends else slice_ends, loop.io.scratch)
        woken = now_ns(loop.io.scratch)
    if control.stop:
        return STOPPED  # it woke up for that, not for an exchange
    note(loop.histograms.lateness, woken - wait.due_ns)
    wait.begun_ns, wait.for_ns, wait.answers = woken, 0, 1
    wait.due_ns, missed = next_point(wait.due_ns, woken, control.period_ns)
    state.deadline_misses += missed
    return GOES_ON


@inlined
def is_patient(loop):
    """Whether a position that did not come is asked for again: unless the device has been quiet for too long."""
    return loop.state.ticks > 0 and loop.state.sent_ns - loop.state.newest_ns < loop.control.silence_ns
