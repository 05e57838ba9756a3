"""What `hapsim run --realtime` asks of the system: one measure a file, each reported as granted or denied.

Nothing is guessed from the kernel's name or from limits: the system call is made and its error read. A measure that is
denied costs a sentence, never the run. To add one: write it as a file beside these and name it in `_MEASURES`.
`no_timer_slack` is no part of them: it needs no privilege and serves every run.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator

from hapsim.loop.realtime.collector import frozen
from hapsim.loop.realtime.memory import locked
from hapsim.loop.realtime.power import awake
from hapsim.loop.realtime.privilege import Measure, PrivilegeResult
from hapsim.loop.realtime.processor import pinned
from hapsim.loop.realtime.scheduling import fifo
from hapsim.loop.realtime.slack import no_timer_slack

__all__ = ["PrivilegeResult", "no_timer_slack", "realtime"]

# What is collected need not be locked, and the thread is put before all others only when the rest is in place.
_HELD = threading.Lock()  # by one at a time: two that undo in another order than they began would leave neither

_MEASURES: tuple[Measure, ...] = (frozen, locked, awake, pinned, fifo)


@contextlib.contextmanager
def realtime(thread_id: int) -> Iterator[list[PrivilegeResult]]:
    """While open, every measure that the system grants is in force: for this process, and for its thread with the
    native id `thread_id` (`threading.get_native_id()` of the loop's thread). Yields a PrivilegeResult for each measure.

    Enter it when everything is allocated and compiled: it takes some tenths of a second, in which memory is read in. On
    leaving, the measures are undone in reverse order, whatever the body raised; what cannot be undone (the thread may
    have ended) is passed over. Raises nothing for what is denied. Of two loops in one process the second is denied it.
    """
    if not _HELD.acquire(blocking=False):
        yield [
            PrivilegeResult(
                "real time", False, "another loop of this process has it, and gives it back for all when it ends"
            )
        ]
        return
    try:
        with contextlib.ExitStack() as held:
            yield [held.enter_context(measure(thread_id)) for measure in _MEASURES]
    finally:
        _HELD.release()
