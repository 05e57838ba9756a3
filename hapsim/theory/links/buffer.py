"""The buffer: two linear systems, the one in touch and the one apart, and the change between them.

In touch it is a spring and a damper; apart it is nothing. That both are stable does not make the whole stable, nor does
a limit cycle need either to be unstable; what bounds it is passivity in touch (Colgate and Schenkel), under which no
change between the two can add energy beyond what one sample of approach does.
"""

from __future__ import annotations

from hapsim.theory.links.shape import Linear


def buffer(stiffness: float, damping: float) -> Linear:
    """The contact while it is touched. N/m, N·s/m."""
    return Linear(stiffness, damping, "is taken as touched all the time; apart, nothing is felt of it")
