"""A name of the user's choice for a pseudo-terminal: a symbolic link, which a program that is killed leaves behind.

The link is judged before this process opens a pseudo-terminal: the system gives the number of one that is gone to the
next, and to a link that was left over its own new port would look like somebody else's.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from hapsim.errors import UsageError

_PSEUDO_TERMINAL = re.compile(r"/dev/pts/\d+")


def free_name(name: Path | None) -> None:
    """Takes a link away that leads to a pseudo-terminal which is gone. UsageError where the name is taken otherwise."""
    if name is None or not os.path.lexists(name):
        return
    why = _why_taken(name)
    if why:
        raise UsageError(f"{name}: cannot be made a name of the port: it is {why}")
    try:
        name.unlink()
    except OSError as error:
        raise _not_made(name, error) from error


def _why_taken(name: Path) -> str:
    """What is there, and what to do; "" for a link that was left over."""
    link = leads_to(name)
    if link is None and not name.is_file():
        return f"{'a directory' if name.is_dir() else 'a device'}; choose another name"
    if link is None:
        return "a file, not a link of hapsim: choose another name, or remove it"
    of_a_terminal = _PSEUDO_TERMINAL.fullmatch(link) is not None
    if os.path.exists(name):
        there = "which a running program has open" if of_a_terminal else "which is there"
    elif of_a_terminal:
        return ""
    else:
        there = "which is not there, but is no port of hapsim's"
    return f"a link to {link}, {there}: choose another name, or remove the link"


def give_name(name: Path, port: str) -> None:
    """Makes `name` a link to `port`. UsageError where that is not possible."""
    free_name(name)
    try:
        name.symlink_to(port)
    except OSError as error:
        raise _not_made(name, error) from error


def take_name(name: Path, port: str) -> None:
    """Takes the link away, if it still leads to `port`."""
    if leads_to(name) == port:
        name.unlink(missing_ok=True)


def leads_to(name: str | Path) -> str | None:
    """What a symbolic link leads to; None where there is no link."""
    try:
        return os.readlink(name)
    except (OSError, ValueError):
        return None


def _not_made(name: Path, error: OSError) -> UsageError:
    remedy = "choose another name, in a directory that is there and that you may write in"
    return UsageError(f"{name}: cannot be made a name of the port: {error.strerror}; {remedy}")
