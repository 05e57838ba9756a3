"""Repetition of what runs in real time: where the machine held it up, and nowhere else."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import pytest

from tests import attempts

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="Linux reports how long a thread waits")


def played(monkeypatch: pytest.MonkeyPatch, shares: list[float]) -> int:
    """Returns how many attempts there are if all fail. `shares`: of a second each, spent waiting."""
    now, waited, share = [0.0], [0.0], iter(shares)
    monkeypatch.setattr(attempts.time, "monotonic", lambda: now[0])
    monkeypatch.setattr(attempts, "waited_s", lambda: waited[0])
    tried = 0
    for tried in attempts.attempts():  # noqa: B007
        now[0] += 1.0
        waited[0] += next(share)
    return tried + 1


def test_two_failures_that_nothing_held_up_are_enough(monkeypatch: pytest.MonkeyPatch) -> None:
    assert played(monkeypatch, [0.0, 0.01]) == 2
    assert played(monkeypatch, [0.5, 0.0, 0.03, 0.0]) == 4


def test_a_test_that_is_always_held_up_is_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(pytest.skip.Exception, match="5 of 6 attempts"):
        played(monkeypatch, [0.1, 0.1, 0.0, 0.1, 0.1, 0.1])


def test_the_time_that_a_child_waits_for_a_processor_counts() -> None:
    """Twice as many spinning processes as processors have to wait for each other."""
    spinning = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(2 * (os.cpu_count() or 1))]
    try:
        before, give_up = attempts.waited_s(), time.monotonic() + 60.0
        while attempts.waited_s() - before < 0.1:
            assert time.monotonic() < give_up
            time.sleep(0.02)
    finally:
        for process in spinning:
            process.kill()
            process.wait()
