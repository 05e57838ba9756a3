"""No force is sent that answers a position which is older than a force may live.

A force acts for its time to live t and one sample more; then a device makes it zero by itself, and no older force is
taken (PROTOCOL.md, section 6). On this side two things would go around that:

* Where the host is the clock, a device takes the next force as an answer in time however long the host took. A host
  that was held up, or that asks once more because no position comes, would send what it worked out from a position of
  long ago: zero force leaves in its place, and asks for the next position all the same; while the device still takes
  an answer to that position, which it does for its time to live.
* A position that arrives later than that, behind others in a buffer on its way, is a position of the past when it is
  read. It moves the scene, zero force answers it, and the device would take no other.

And what the device holds is known here: `has_expired` says when it is zero already, so that the next force rises from
there.
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
