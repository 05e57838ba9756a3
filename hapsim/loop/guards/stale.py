"""No force is sent that answers a position older than a force may live.

A force acts for its time to live and one sample more; then the device makes it zero and takes no older one
(PROTOCOL.md, section 6). In two cases the host has to send zero in place of a force:

* Where the host paces, a device takes the next force as an answer in time, however long the host took. Zero leaves
  while the device still takes an answer to that position, and asks for the next one.
* A position arrives later than that, delayed in a buffer. It moves the scene, but is of the past.

`has_expired` says when the device's force is zero already, so that the next one rises from there.
"""

from __future__ import annotations

from hapsim.compiling import inlined


@inlined
def has_expired(state, control, gap, now, since):
    """Whether the time to live of the last force that left is over: by the device's samples, or by the time since
    `since` (ns). A position arrives, `gap` samples after the last, at `now` (ns)."""
    state.since_sent = gap + (state.since_sent if state.unanswered else 0)
    return state.since_sent > control.time_to_live + 1 or now - since > control.stale_ns


@inlined
def is_outdated(control, since, now):
    """Whether a position of `since` (ns) is older at `now` than a force may live."""
    return now - since > control.stale_ns
