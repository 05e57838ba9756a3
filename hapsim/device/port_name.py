"""A name of the user's choice for a pseudo-terminal: a symbolic link, which a program that is killed leaves behind.

Call `free_name` before opening a pseudo-terminal: the system gives the number of one that is gone to the next, and a
link that was left over would then seem to lead to a port that is in use.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from hapsim.errors import UsageError

_PSEUDO_TERMINAL = re.compile(r"/dev/pts/\d+")


def free_name(name: Path | None) -> None:
    """Removes a link that leads to a pseudo-terminal which is gone. UsageError where the name is taken otherwise."""
    if name is None or not os.path.lexists(name):
        return
    link = leads_to(name)
    if link is None:
        raise UsageError(f"{name}: found a file, a directory or a device, expected a free name for the port")
    if os.path.exists(name) or not _PSEUDO_TERMINAL.fullmatch(link):
        raise UsageError(f"{name}: found a link to {link}, expected a free name for the port; remove an unused link")
    try:
        name.unlink()
    except OSError as error:
        raise _cannot_link(name, error) from error


def give_name(name: Path, port: str) -> None:
    """Makes `name` a link to `port`. UsageError where that is not possible."""
    free_name(name)
    try:
        name.symlink_to(port)
    except OSError as error:
        raise _cannot_link(name, error) from error


def take_name(name: Path, port: str) -> None:
    """Removes the link, if it still leads to `port`."""
    if leads_to(name) == port:
        name.unlink(missing_ok=True)


def leads_to(name: str | Path) -> str | None:
    """Returns what a symbolic link leads to; None where there is no link."""
    try:
        return os.readlink(name)
    except (OSError, ValueError):
        return None


def _cannot_link(name: Path, error: OSError) -> UsageError:
    return UsageError(f"{name}: this link cannot be made: {error.strerror}; choose a name in a directory of yours")
