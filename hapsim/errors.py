"""What can go wrong, as a tree: each branch is one exit status, each leaf one thing a user can act on.

The message of every one of them is a sentence for the user: where, what was found, what was expected, what to do.
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
    """Anything that hapsim tells its user instead of failing with a traceback."""

    exit_status = 1


class UsageError(HapsimError):
    """The command or the call asks for something that cannot be had."""

    exit_status = 2


class SceneError(UsageError):
    """A scene file is wrong. The message holds one line for each fault: ``file:line:column: found, expected``."""


class RunError(HapsimError):
    """A run ended before it was meant to."""

    trace: Any = None
    """The hapsim.recording.trace.Trace of what was recorded until then; None where nothing was."""


class DeviceError(RunError):
    """The port, the link or the device failed."""

    exit_status = 3


class RecordError(RunError):
    """The run went as asked; its record is not what was asked for: the disk is full, or was too slow."""

    exit_status = 2


class DescriptionError(DeviceError):
    """The device answers, and what it says of itself cannot be run: waiting does not help."""


class GuardError(RunError):
    """A guard stopped the force."""

    exit_status = 4
