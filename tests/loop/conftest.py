"""Fixtures of the loop's tests; their helpers are in loop_rig.py."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

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
def leaps_allowed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Disables the leap guard, for scripts with positions that no hand reaches."""
    monkeypatch.setattr(guards, "GUARDS", tuple(one for one in guards.GUARDS if one is not leap.GUARD))
