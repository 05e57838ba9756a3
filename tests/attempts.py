"""Attempts at what a busy machine may spoil. One in which processes waited for a processor does not count."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

MOST = 6
COUNTED = 2  # attempts that nothing held up: a device that fails both has failed
SHARE = 0.02  # of the time; waking up a thousand times a second takes half of it on a quiet machine


def attempts() -> Iterator[int]:
    """Yields numbers of attempts, to be left when one succeeds: until two that nothing held up have failed. Skips the
    test if each of six was held up."""
    undisturbed = 0
    for number in range(MOST):
        begun, waited = time.monotonic(), waited_s()
        yield number
        undisturbed += waited_s() - waited < SHARE * (time.monotonic() - begun)
        if undisturbed == COUNTED:
            return
    pytest.skip(f"in {MOST - undisturbed} of {MOST} attempts its processes waited for this machine's processors")


def waited_s() -> float:
    """Returns how long this process and those that it started have waited for a processor, s."""
    return 1e-9 * sum(_waited_ns(process) for process in _processes(os.getpid()))


def _waited_ns(process: int) -> int:
    total = 0
    for thread in Path(f"/proc/{process}/task").glob("*/schedstat"):
        try:
            total += int(thread.read_text("ascii").split()[1])
        except OSError:  # it has just ended
            continue
    return total


def _processes(root: int) -> Iterator[int]:
    yield root
    for thread in Path(f"/proc/{root}/task").glob("*/children"):
        try:
            children = thread.read_text("ascii").split()
        except OSError:
            continue
        for child in children:
            yield from _processes(int(child))
