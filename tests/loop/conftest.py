"""Fixtures of the loop's tests; their helpers are in loop_rig.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from firmware_protocol import client
from hapsim.loop import guards
from hapsim.loop.guards import leap
from hapsim.running.compile_ahead import UNITS

sys.path.insert(0, str(Path(__file__).parent))


@pytest.fixture(scope="session", autouse=True)
def _serving_is_compiled() -> None:
    """A mock in a thread answers only once it is compiled, which is longer than a host waits for an answer."""
    for name in ("port", "mock"):
        UNITS[name].compile()


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A host that waits for no answer longer than some hundredths of a second."""
    monkeypatch.setattr(client, "ANSWER_S", 0.02)
    monkeypatch.setattr(client, "RELEASE_S", 0.02)
    monkeypatch.setattr(client, "FIRST_TRIES", 2)


@pytest.fixture
def leaps_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disables the leap guard, for scripts with positions that no hand reaches."""
    monkeypatch.setattr(guards, "GUARDS", tuple(one for one in guards.GUARDS if one is not leap.GUARD))
