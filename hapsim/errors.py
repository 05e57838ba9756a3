"""Exceptions, as a tree: each branch is one exit status, each leaf one problem that a user can act on.

Each message is a sentence for the user: where, what was found, what was expected, what to do.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Container, Mapping
from types import MappingProxyType
from typing import Any

__all__ = [
    "DescriptionError",
    "DeviceError",
    "GuardError",
    "HapsimError",
    "RecordError",
    "RunError",
    "SceneError",
    "UsageError",
]


class HapsimError(Exception):
    """A failure that hapsim reports as a sentence, without a traceback. Its arguments are pieces of the message."""

    exit_status = 1
    sensors: Mapping[str, int] = MappingProxyType({})
    """Indices of the arguments about a sensor, by the name that they have in a report."""

    def __str__(self) -> str:
        return self.shortened(())

    def shortened(self, known: Container[str]) -> str:
        """Returns the message without the pieces of these names."""
        left_out = {at for name, at in self.sensors.items() if name in known}
        pieces = ("a warning above names the sensor" if i in left_out else one for i, one in enumerate(self.args))
        return "".join(map(str, pieces))


class UsageError(HapsimError):
    """The command or the call asks for something that is not possible."""

    exit_status = 2


class SceneError(UsageError):
    """A scene file is wrong. The message has a line for each error: ``file:line:column: found, expected``."""

    files: tuple[str, ...] = ()
    """Files beside it that it names, whose change may mend it."""


class RunError(HapsimError):
    """A run ended before it was meant to."""

    trace: Any = None
    """The hapsim.recording.trace.Trace of what was recorded until then; None where nothing was."""
    held_up = False
    """True if this machine was too slow for it: nothing else is wrong, and it may go on."""


class DeviceError(RunError):
    """The port, the link or the device failed."""

    exit_status = 3


class RecordError(RunError):
    """The run succeeded, but its record is incomplete: the disk is full, or was too slow."""

    exit_status = 2


class DescriptionError(DeviceError):
    """The device answers, but cannot be run as it describes itself: waiting does not help."""


class GuardError(RunError):
    """A guard stopped the force."""

    exit_status = 4


_NO_TEMPORARY = "no usable temporary directory"
_OF_SYSTEM = tuple(
    getattr(errno, name)
    for name in ("EACCES", "EPERM", "EROFS", "ENOSPC", "EDQUOT", "EMFILE", "ENFILE", "EIO", "ENAMETOOLONG", "ELOOP")
    if hasattr(errno, name)
)


def address_space_limit() -> int:
    """Returns how many bytes of address space this process may have (`ulimit -v`); 0 if it is not limited."""
    try:
        import resource

        limit = resource.getrlimit(resource.RLIMIT_AS)[0]
        return 0 if limit == resource.RLIM_INFINITY else limit
    except (ImportError, OSError):  # no such limits on this system
        return 0


def refused_by_system(error: BaseException | None) -> str:
    """Returns what the system refused, and what to do, as a sentence; "" if the error, and its causes, are of another
    kind. What an error's handler raises is an error of its own."""
    while error is not None:
        text = str(error)
        if isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM or _is_unmapped(error):
            limit = address_space_limit()
            limited = f"; the address space is limited to {limit / 1e6:.0f} MB (`ulimit -v`)" if limit else ""
            return f"the system has no more memory for hapsim{limited}"
        if "can't start new thread" in text or getattr(error, "errno", None) == errno.EAGAIN:
            return (
                "the system refused another thread or process. Raise the limit: `ulimit -u`, in a control group "
                "pids.max (systemd: TasksMax=, docker: --pids-limit)"
            )
        if isinstance(error, OSError) and _NO_TEMPORARY in text.lower():
            return "no directory for temporary files can be written: set TMPDIR to one that can"
        if isinstance(error, OSError) and error.errno in _OF_SYSTEM:
            where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
            return f"{where}{error.strerror}"
        error = error.__cause__
    return ""


def _is_unmapped(error: BaseException) -> bool:
    """Returns True if a library could not be loaded for lack of address space."""
    text = str(error)
    unmapped = "failed to map segment" in text or "Could not find/load shared object" in text
    return unmapped and isinstance(error, ImportError | OSError) and address_space_limit() > 0
