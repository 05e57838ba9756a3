"""A record that was made in real time, replayed: every force is as it was, to the last bit."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import pytest
from recorded_runs import random_scene, recorded

from hapsim.replaying.replay import Record, compare
from tests import thorough

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="pseudo-terminals of Linux")

# A few in the ordinary suite; HAPSIM_POINTS=50 takes fifty, for longer.
SCENES, SECONDS = thorough.points(2, 4), 1.0 if "HAPSIM_POINTS" in os.environ else 0.4


@pytest.mark.parametrize("seed", range(SCENES))
def test_random_scenes_with_changes_lost_positions_and_late_forces(seed: int, tmp_path: Path) -> None:
    trace = recorded(random_scene(seed), tmp_path / "a.trace", seed, SECONDS)
    record = Record(tmp_path / "a.trace")
    found = compare(record, None, None, with_curves=False)
    assert found.difference is None, found.difference.what
    assert found.ticks == trace.report.ticks
    assert found.changes == trace.report.parameter_changes
    assert trace.flags.any(), "nothing was lost or late"
    assert [note for note in record.notes if "marker" in note]
