"""The clock of whoever keeps time by this machine: the points of a grid, one after the other."""

from __future__ import annotations

from hapsim.compiling import inlined


@inlined
def next_point(due, now, period):
    """(the point of the grid after `due`, 1 where this one was missed else 0); ns, `now` the time at which it was kept.

    The grid is absolute, so that lateness does not add up. A point that was kept a whole period late or more is missed,
    and the grid starts anew from there: catching up would be a burst.
    """
    following = due + period
    if now < following:
        return following, 0
    return now + period, 1
