"""What can go wrong, as a tree: each branch is one exit status, each leaf one thing a user can act on.

Each message is a sentence for the user: where, what was found, what was expected, what to do.
"""

from __future__ import annotations

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
    """A failure that hapsim reports as a sentence, without a traceback."""

    exit_status = 1


class UsageError(HapsimError):
    """The command or the call asks for something that is not possible."""

    exit_status = 2


class SceneError(UsageError):
    """A scene file is wrong. The message has a line for each error: ``file:line:column: found, expected``."""


class RunError(HapsimError):
    """A run ended before it was meant to."""

    trace: Any = None
    """The hapsim.recording.trace.Trace of what was recorded until then; None where nothing was."""


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
