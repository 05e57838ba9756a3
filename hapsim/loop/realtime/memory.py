"""All memory of the process locked and read in, so that no page fault waits for a disk within a tick.

What there is is locked (MCL_CURRENT), not what is still to come (MCL_FUTURE): the loop allocates nothing, while the
rest of the process does. Each further thread would lock its whole stack and heap, 74 MB, and beyond the limit an
allocation would fail in the middle of a run.
"""

from __future__ import annotations

import errno
import re
from collections.abc import Callable
from pathlib import Path

from hapsim.loop.realtime import c_library
from hapsim.loop.realtime.login_limits import is_root, login_limit
from hapsim.loop.realtime.privilege import measure

_MCL_CURRENT = 1
_STATUS = Path("/proc/self/status")


def _advise(error: OSError) -> str:
    import resource

    refused = f"locking {_megabytes('VmSize')} was refused ({error.strerror})"
    limit = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    if error.errno not in (errno.ENOMEM, errno.EPERM):
        return refused
    if limit == resource.RLIM_INFINITY:
        return f"{refused} though no limit is set: free some memory, or let the container call mlockall"
    if is_root():
        takes = "CAP_IPC_LOCK (in a container: --cap-add=IPC_LOCK)"
    else:
        takes = f"{login_limit('memlock', 'unlimited')}, or CAP_IPC_LOCK, or root"
    return f"{refused}: the limit is {limit / 1e6:.3g} MB; it takes {takes}"


@measure("memory locked", _advise)
def locked(_thread_id: int) -> tuple[str, Callable[[], object]]:
    """Locks and reads in what the process has mapped. Locks do not add up: undoing unlocks what was locked before it
    too, as munlockall(2) does."""
    c_library.call("mlockall", _MCL_CURRENT)
    return _megabytes("VmLck"), lambda: c_library.call("munlockall")


def _megabytes(field: str) -> str:
    """A line of the process's status in MB of 10^6 bytes; "all memory" where it cannot be read."""
    try:
        found = re.search(rf"^{field}:\s+(\d+) kB$", _STATUS.read_text(encoding="utf-8"), re.MULTILINE)
    except (OSError, UnicodeDecodeError):
        found = None
    return f"{int(found[1]) * 1024 / 1e6:.0f} MB" if found else "all memory"
