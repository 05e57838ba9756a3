"""The bench of the loop (tools/bench/loop): what it measures against a device is the same run for every loop."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import pytest

sys.path.append(str(Path(__file__).resolve().parents[2] / "tools" / "bench"))

from steadiness.mock import mock_device, scene_with_clock
from steadiness.on_port import run_on_port
from steadiness.record import BUSY, NO_LOAD


def measured(place: Path, load: str, portable: bool, **limit: float) -> dict[str, Any]:
    scene = scene_with_clock("lockstep", place)
    with mock_device(scene, os.sched_getaffinity(0)) as port:
        return run_on_port(str(scene), port, load, portable, **limit)  # type: ignore[arg-type]


@pytest.mark.thorough
def test_so_many_ticks_are_the_same_for_both_loops(tmp_path: Path) -> None:
    compiled, portable = (measured(tmp_path, NO_LOAD, is_portable, ticks=500) for is_portable in (False, True))
    assert compiled["ending"] == "done"
    for what in ("ending", "ticks", "forces_crc32", "positions_crc32"):
        assert compiled[what] == portable[what]
    assert compiled["ticks"] == 500


@pytest.mark.thorough
def test_so_many_seconds_end_by_a_stop_next_to_a_load_that_worked(tmp_path: Path) -> None:
    document = measured(tmp_path, BUSY, portable=True, seconds=0.2)
    assert document["ending"] == "stopped"
    assert document["ticks"] > 0
    assert document["load_turns"] > 0
