"""Which process has a serial port: asked of the kernel when the port is refused, so that no file can be out of date.

The lock that hapsim holds on an open port (flock) is the kernel's, too: a process that is killed leaves none. Linux
tells everybody who took a lock (/proc/locks), and tells of one's own processes, or root of all, what they have open.
"""

from __future__ import annotations

import contextlib
import os
import stat
from collections.abc import Iterator
from pathlib import Path

_PROC = Path("/proc")
_LONGEST = 120  # characters of a command line that a sentence quotes


def who_holds(path: str) -> str:
    """In words that follow a colon, each process that was seen to hold `path`; "" where none was seen. A symbolic link
    stands for what it leads to."""
    try:
        port = os.stat(path)
    except (OSError, ValueError):
        return ""
    locking = [pid for pid in _locking(port) if (_PROC / str(pid)).exists()]
    if locking:
        return " and ".join(f"{_named(pid)} holds its lock" for pid in locking)
    return " and ".join(f"{_named(pid)} has it open" for pid in _opening(port))


def _locking(port: os.stat_result) -> list[int]:
    """Who took a lock on this very file, by the kernel's list: `1: FLOCK  ADVISORY  WRITE 2461 00:1a:3 0 EOF`."""
    wanted = (os.major(port.st_dev), os.minor(port.st_dev), port.st_ino)
    found = []
    for words in map(str.split, _read(_PROC / "locks").splitlines()):
        with contextlib.suppress(ValueError, IndexError):  # another kernel's line, or one that waits ("->")
            major, minor, inode = words[5].split(":")
            if words[1] == "FLOCK" and (int(major, 16), int(minor, 16), int(inode)) == wanted and int(words[4]) > 0:
                found.append(int(words[4]))
    return sorted(set(found))


def _opening(port: os.stat_result) -> Iterator[int]:
    """Those that may be looked at, and have this device open by whatever name."""
    if not stat.S_ISCHR(port.st_mode):
        return
    for process in sorted(int(name) for name in _names(_PROC) if name.isdigit()):
        descriptors = _PROC / str(process) / "fd"
        if any(_is_device(descriptors / name, port.st_rdev) for name in _names(descriptors)):
            yield process


def _is_device(descriptor: Path, number: int) -> bool:
    try:
        if not os.readlink(descriptor).startswith("/dev/"):
            return False  # nothing is asked of a file system that may not answer
        status = os.stat(descriptor)
    except OSError:  # closed meanwhile
        return False
    return stat.S_ISCHR(status.st_mode) and status.st_rdev == number


def _named(process: int) -> str:
    if process == os.getpid():
        return f"this process itself (PID {process})"
    told = "".join(
        one if one.isprintable() else "?"
        for one in _read(_PROC / str(process) / "cmdline").rstrip("\0").replace("\0", " ")
    )
    command = f"{told[:_LONGEST]}…" if len(told) > _LONGEST else told
    return f"PID {process} ({command})" if command else f"PID {process}"


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _names(folder: Path) -> list[str]:
    try:
        return os.listdir(folder)
    except OSError:  # another user's, or it has ended
        return []
