"""No processor falls into a sleep from which it takes time to wake. All of them draw power for as long as it lasts."""

from __future__ import annotations

import errno
import os
import struct
from collections.abc import Callable

from hapsim.loop.realtime.login_limits import is_root
from hapsim.loop.realtime.privilege import measure

_DEVICE = "/dev/cpu_dma_latency"


def _advise(error: OSError) -> str:
    if error.errno == errno.ENOENT:
        return f"there is no {_DEVICE}; a container needs --device={_DEVICE}, a kernel CONFIG_CPU_IDLE"
    if not isinstance(error, PermissionError):
        return f"{_DEVICE} failed ({error.strerror})"
    if is_root():
        return f"{_DEVICE} was refused to root ({error.strerror}): a container needs --device={_DEVICE}"
    return (
        f"{_DEVICE} may not be written ({error.strerror}): it takes a udev rule that gives it to a group of yours "
        '(KERNEL=="cpu_dma_latency", GROUP="…", MODE="0660" in /etc/udev/rules.d/hapsim.rules), or root'
    )


@measure("power saving off", _advise)
def awake(_thread_id: int) -> tuple[str, Callable[[], object]]:
    """Asks for a wake-up latency of 0 µs. The kernel keeps to it for as long as the file is open."""
    descriptor = os.open(_DEVICE, os.O_WRONLY)
    try:
        os.write(descriptor, struct.pack("=i", 0))
    except OSError:
        os.close(descriptor)
        raise
    return "0 µs of wake-up latency asked of every processor", lambda: os.close(descriptor)
