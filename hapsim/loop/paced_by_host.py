"""The loop when the host is the clock: at each tick it sends the force and with it asks for the next position.

The clock is absolute, so that lateness does not add up. A tick that comes a whole period late starts the grid anew:
catching up would hand the device a burst.
"""

from __future__ import annotations

from hapsim.compiled import inlined, jit, jit_inlined
from hapsim.loop.codes import HEARD, TIMED_OUT
from hapsim.loop.denormals import flush_denormals, restore
from hapsim.loop.endings import GOES_ON, GONE, ending_of, told_to_end
from hapsim.loop.histogram import note
from hapsim.loop.system import now_ns, sleep_until
from hapsim.loop.waiting import SLICE_NS, answer, let_go, take_newest_position, wait_for_go


@jit
def run_paced_by_host(loop):
    """Exchanges once a period until something ends it; returns what did."""
    mode = flush_denormals()
    wait_for_go(loop)
    loop.state.tick_ns = now_ns(loop.desk.scratch)
    ending = _first_position(loop)
    due = now_ns(loop.desk.scratch) + loop.control.period_ns
    while ending == GOES_ON:
        ending = told_to_end(loop.control, loop.state, loop.ring)
        if ending != GOES_ON:
            break
        now = _sleep_until_due(loop, due)
        if loop.control.stop:
            continue  # woken up for that, not for an exchange
        note(loop.statistics.lateness, now - due)
        due = next_due(loop, due, now)
        ending = exchange_before(loop, now, due)
    let_go(loop)
    restore(mode)
    return ending


@inlined
def _sleep_until_due(loop, due):
    """Sleeps until `due`, or until told to stop; the time of waking up."""
    now = now_ns(loop.desk.scratch)
    while now < due and not loop.control.stop:
        sleep_until(min(due, now + SLICE_NS), loop.desk.scratch)
        now = now_ns(loop.desk.scratch)
    return now


@inlined
def _first_position(loop):
    """The device sends position 0 of its own accord when it is armed. GOES_ON, or why the loop ends."""
    code = take_newest_position(loop, now_ns(loop.desk.scratch), loop.control.silence_ns)
    return GOES_ON if code == HEARD else ending_of(code, loop.control.stop)


@inlined
def exchange_before(loop, now, due):
    """Force out, position in, until the next tick is due; a position that does not come by then is asked for again.
    GOES_ON, or why the loop ends.

    One that came after its tick was over is taken first: answered in its turn it would leave every later force a sample
    older than need be.
    """
    code = take_newest_position(loop, now, 0)
    if code not in (HEARD, TIMED_OUT):
        return ending_of(code, loop.control.stop)
    if loop.state.unanswered:
        loop.state.tick_ns = now  # else the same position is asked for again, and has been waited for since then
    if answer(loop) != 0:
        return GONE
    code = take_newest_position(loop, loop.state.sent_ns, max(due - loop.state.sent_ns, 0))
    if code == TIMED_OUT and loop.state.sent_ns - loop.state.newest_ns < loop.control.silence_ns:
        return GOES_ON
    return GOES_ON if code == HEARD else ending_of(code, loop.control.stop)


@jit_inlined
def next_due(loop, due, now):
    """The next point of the grid, or of a new grid where this tick came a whole period late."""
    due += loop.control.period_ns
    if now < due:
        return due
    loop.state.late_ticks += 1
    return now + loop.control.period_ns
