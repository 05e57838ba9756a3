"""No force is sent that answers a position older than a force may live.

A force acts for its time to live and one sample more; then the device makes it zero by itself and takes no older one
(PROTOCOL.md, section 6). The host has to withhold a force in two cases, and sends zero in its place:

* Where the host is the clock, a device takes the next force as an answer in time however long the host took: the host
  was held up, or asks once more because no position came. Zero leaves while the device still takes an answer to that
  position, and asks for the next one.
* A position arrives later than that, behind others in a buffer on its way. It moves the scene, but is of the past.

`has_expired` says when the force that the device holds is zero already, so that the next one rises from there.
"""

from __future__ import annotations

from hapsim.compiling import inlined


@inlined
def has_expired(state, control, gap, now, since):
    """Whether the last force that left has no more time to live, for the device: by its own samples, or because so much
    time passed since `since` (ns). A position arrives, `gap` samples after the last, at `now` (ns)."""
    state.since_sent = gap + (state.since_sent if state.unanswered else 0)
    return state.since_sent > control.time_to_live + 1 or now - since > control.stale_ns


@inlined
def is_outdated(control, since, now):
    """Whether what was true at `since` (ns) is, at `now`, older than a force lives."""
    return now - since > control.stale_ns
