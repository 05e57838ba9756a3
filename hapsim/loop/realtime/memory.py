"""Memory that never makes the loop wait: no garbage collection, and no page fault.

A collection takes tens of milliseconds, in which no other Python runs. A page that is not in memory may wait for a
disk. What is mapped is locked (MCL_CURRENT), not what will be (MCL_FUTURE): the loop allocates nothing, while each
further thread would lock its whole stack and heap, 74 MB, and beyond the limit an allocation would fail during a run.
"""

from __future__ import annotations

import errno
import gc
import re
from collections.abc import Iterator
from pathlib import Path

from hapsim.loop.realtime import privilege
from hapsim.loop.realtime.privilege import measure, what_grants

_MCL_CURRENT = 1
_STATUS = Path("/proc/self/status")


def _collector_advice(error: OSError) -> str:
    return f"the garbage collector failed ({error.strerror})"


@measure("garbage collector frozen", _collector_advice, everywhere=True)
def collector_frozen(_thread_id: int) -> Iterator[str]:
    """Collects once, then sets what is left aside and switches collecting off. References still free what they hold."""
    was_enabled, was_frozen = gc.isenabled(), gc.get_freeze_count() > 0
    gc.collect()
    if not was_frozen:  # gc.unfreeze would also thaw what was frozen before
        gc.freeze()
    gc.disable()
    yield f"{gc.get_freeze_count()} objects set aside, no collection"
    if not was_frozen:
        gc.unfreeze()
    if was_enabled:
        gc.enable()


def _lock_advice(error: OSError) -> str:
    import resource

    refused = f"locking {_megabytes('VmSize')} was refused ({error.strerror})"
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if error.errno not in (errno.ENOMEM, errno.EPERM):
        return refused
    if limit == resource.RLIM_INFINITY:
        return f"{refused} though no limit is set: free some memory, or let the container call mlockall"
    takes = what_grants("CAP_IPC_LOCK", "memlock", "unlimited")
    return f"{refused}: the limit is {limit / 1e6:.3g} MB; it takes {takes}"


@measure("memory locked", _lock_advice)
def memory_locked(_thread_id: int) -> Iterator[str]:
    """Locks and reads in what the process has mapped. Undoing unlocks what was locked before, too (munlockall(2))."""
    privilege.call_c("mlockall", _MCL_CURRENT)
    yield _megabytes("VmLck")
    privilege.call_c("munlockall")


def _megabytes(field: str) -> str:
    """Returns a line of the process's status in MB of 10^6 bytes; "all memory" where it cannot be read."""
    try:
        found = re.search(rf"^{field}:\s+(\d+) kB$", _STATUS.read_text(encoding="utf-8"), re.MULTILINE)
    except (OSError, UnicodeDecodeError):
        found = None
    return f"{int(found[1]) * 1024 / 1e6:.0f} MB" if found else "all memory"
