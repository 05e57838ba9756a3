"""What `hapsim run --realtime` requests of the system; each measure is reported as granted or denied.

The call is made and its error read: nothing is guessed from the kernel's name or from limits. A denial costs a
sentence, never the run. To add a measure: write it in `memory.py` or `scheduling.py`, name it in `_MEASURES`.
`no_timer_slack` is not among them: it needs no privilege and serves every run.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from hapsim.loop.realtime.memory import collector_frozen, memory_locked
from hapsim.loop.realtime.privilege import Measure, PrivilegeResult
from hapsim.loop.realtime.scheduling import idle_states_off, no_timer_slack, pinned, scheduled_fifo

__all__ = ["PrivilegeResult", "no_timer_slack", "realtime"]

# Garbage is collected before memory is locked; the thread gets its priority once the rest is in place.
_MEASURES: tuple[Measure, ...] = (collector_frozen, memory_locked, idle_states_off, pinned, scheduled_fifo)

_HELD = threading.Lock()  # two that undid their measures in another order than they began would restore neither


@contextlib.contextmanager
def realtime(thread_id: int) -> Iterator[list[PrivilegeResult]]:
    """While open, every measure that the system grants is in force: for this process, and for its thread with the
    native id `thread_id` (the loop's). Yields a PrivilegeResult for each measure.

    Enter it when everything is allocated and compiled: it takes some tenths of a second, in which memory is read in. On
    leaving, the measures are undone in reverse order, whatever the body raised. Raises nothing for what is denied. Of
    two loops in one process the second is denied it.
    """
    if not _HELD.acquire(blocking=False):
        why = "another loop of this process has it, and gives it back for all when it ends"
        yield [PrivilegeResult("real time", False, why)]
        return
    try:
        with contextlib.ExitStack() as held:
            yield [held.enter_context(measure(thread_id)) for measure in _MEASURES]
    finally:
        _HELD.release()
