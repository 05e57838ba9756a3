"""A new counter needs one entry of `Counts`; every view of a run takes it from there."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

import hapsim

COUNTED = 4321
"""Count set by `another_counter.py`."""


@pytest.mark.thorough
def test_a_counter_is_added_by_one_entry_and_is_then_wherever_a_run_is_shown() -> None:
    program, configs = Path(__file__).with_name("another_counter.py"), Path(hapsim.__file__).with_name("configs")
    command = [sys.executable, str(program), str(configs / "first_touch.yaml")]
    found = json.loads(subprocess.run(command, check=True, capture_output=True, text=True, timeout=120).stdout)
    numbers = {name: found.pop(name) for name in ("report", "record", "JSON", "status", "page")}
    assert numbers == dict.fromkeys(numbers, COUNTED)
    for table in ("table", "status as text"):
        row = next(one for one in found[table].splitlines() if "ticks that were odd" in one)
        assert str(COUNTED) in row.split()
    assert f"{COUNTED} odd" in found["live line"]
    assert found["words on the page"] == "odd"
