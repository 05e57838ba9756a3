"""Memory that never makes the loop wait: no garbage collection, and no page fault.

A collection takes tens of milliseconds, in which no other Python runs. A page that is not in memory may wait for a
disk. What is mapped is locked (MCL_CURRENT), not what will be (MCL_FUTURE): the loop allocates nothing, while each
further thread would lock its whole stack and heap, 74 MB, and beyond the limit an allocation would fail during a run.
"""

from __future__ import annotations

import errno
import gc
import math
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


class _GroupLimitError(OSError):
    """More is mapped than the control group may have."""


def memory_limit(root: Path = Path("/"), process: str = "self") -> float:
    """Returns how many bytes of memory the control groups of a process allow, infinity without a limit."""
    limits = [math.inf]
    for _, controllers, group in re.findall("^(.*?):(.*?):(.*)$", _text(root / f"proc/{process}/cgroup"), re.MULTILINE):
        version_2 = not controllers
        if version_2 or "memory" in controllers.split(","):
            top = root / ("sys/fs/cgroup" if version_2 else "sys/fs/cgroup/memory")
            own = top / group.strip("/")
            for place in (own, *own.parents):
                if place.is_relative_to(top):  # a container sees its own group at the top
                    text = _text(place / ("memory.max" if version_2 else "memory.limit_in_bytes")).strip()
                    limits += [float(text)] if text.isdecimal() else []
    return min(limits)


def _mapped_bytes() -> int:
    """Returns what locking reads in, bytes: all that is mapped and not closed to every access."""
    lines = (line.split(maxsplit=2) for line in _text(Path("/proc/self/maps")).splitlines())
    ranges = [span.split("-") for span, access, *_ in lines if not access.startswith("---")]
    return sum(int(end, 16) - int(start, 16) for start, end in ranges)


def _text(file: Path) -> str:
    """The text of a file of the system; "" where there is none."""
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _lock_advice(error: OSError) -> str:
    import resource

    if isinstance(error, _GroupLimitError):
        return f"{error.strerror} MB, and the kernel would end the run: raise its limit (MemoryMax=, docker --memory)"
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
    limit, needed = memory_limit(), _mapped_bytes()
    if limit < needed:  # the kernel would kill the process
        raise _GroupLimitError(
            errno.ENOMEM, f"its control group has {limit / 1e6:.0f} MB, locking takes {needed / 1e6:.0f}"
        )
    privilege.call_c("mlockall", _MCL_CURRENT)
    yield _megabytes("VmLck")
    privilege.call_c("munlockall")


def _megabytes(field: str) -> str:
    """Returns a line of the process's status in MB of 10^6 bytes; "all memory" where it cannot be read."""
    found = re.search(rf"^{field}:\s+(\d+) kB$", _text(_STATUS), re.MULTILINE)
    return f"{int(found[1]) * 1024 / 1e6:.0f} MB" if found else "all memory"
