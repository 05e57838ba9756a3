"""Late lines: which of them change what acts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from hapsim.loop.ring import LATE_FORCE
from hapsim.measuring.trace_quality import unbroken

ROWS, LATE = 200, (50, 51, 120)


def trace_of(**changes: Any) -> Any:
    """A swing on 2000 N/m in counts of 1 µm and 1 mN, as a board with counts of 4 N/m follows it; late at LATE."""
    x = np.rint(3000.0 * np.sin(0.1 * np.arange(ROWS)))
    flags = np.zeros(ROWS, np.uint8)
    flags[list(LATE)] = LATE_FORCE
    lines = {"stiffness_counts": np.full((ROWS, 1), 500, "<i2"), "damping_counts": np.full((ROWS, 1), 9, "<u2")}
    columns = {"sample": np.arange(ROWS), "flags": flags, "position_counts": x[:, None].astype("<i4")}
    columns |= {"force_counts": np.rint(-2.001 * x)[:, None].astype("<i4"), "line_counts": lines}
    return SimpleNamespace(**(columns | changes))


def broken_at(trace: Any) -> list[int]:
    return [first for first, _ in unbroken(trace, LATE_FORCE)][1:]


def test_a_late_line_that_is_the_line_before_spoils_nothing_but_a_late_force_does() -> None:
    assert broken_at(trace_of()) == []
    assert broken_at(trace_of(line_counts={})) == list(LATE)


def test_a_late_line_spoils_its_sample_if_a_push_or_another_stiffness_or_damping_is_missed() -> None:
    for row in LATE:  # which shows that the answer to the row before was missed
        pushed = trace_of().force_counts
        pushed[row - 1 :] += 500
        assert broken_at(trace_of(force_counts=pushed)) == [row]
        for name in ("stiffness_counts", "damping_counts"):
            other = trace_of()
            other.line_counts[name][row - 1 :] -= 1
            assert broken_at(other) == [row]
