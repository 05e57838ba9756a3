"""The most memory that this process had while something ran, whatever ran before it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

_SELF = Path("/proc/self")


@contextmanager
def peak_memory() -> Iterator[list[int]]:
    """Yields a list that has afterwards one number: by how many bytes the resident memory exceeded that of the begin.
    Skips the test where the system cannot reset its largest value."""
    grown: list[int] = []
    try:
        (_SELF / "clear_refs").write_text("5", "ascii")
    except OSError:
        pytest.skip("this system does not reset the peak of a process's memory (Linux: /proc/self/clear_refs)")
    before = _bytes("VmRSS")
    yield grown
    grown.append(_bytes("VmHWM") - before)


def _bytes(name: str) -> int:
    lines = (_SELF / "status").read_text("ascii").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith(f"{name}:"))
